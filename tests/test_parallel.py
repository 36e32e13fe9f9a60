"""Every item is worked on once, by whom it may be, whatever becomes of single workers."""

import signal
import socket
import subprocess
import sys
import time
from functools import partial

import pytest
import torch
from jobs import Job, Shards, process

from legibility.data.shards import make_shards
from legibility.errors import InvalidInputError, MissingExtraError, WorkerError
from legibility.parallel import pool, threads

SQUARES = [(i, i**2) for i in range(20)]

mortal = pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="no SIGKILL on this system")


@pytest.fixture(scope="module")
def scheduler():
    """The address of a Dask cluster of two workers."""
    distributed = pytest.importorskip(
        "distributed", reason="Dask is NOT TESTED: the extra cluster is missing"
    )
    options = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": None}
    with distributed.LocalCluster(**options, silence_logs=60) as cluster:
        yield cluster.scheduler_address


@pytest.fixture(params=["processes", "cluster"])
def two(request):
    """Two workers, as `pool` takes them."""
    if request.param == "processes":
        return {"workers": 2}
    return {"cluster": request.getfixturevalue("scheduler")}


class TestEach:
    def test_one_worker_is_this_process(self):
        with pool() as each:
            assert list(each(lambda number: number**2, range(20))) == SQUARES

    def test_two_workers_are_others(self, two):
        with pool(**two) as each:
            assert sorted(each(Job(), range(20))) == SQUARES
            assert list(each(Job(), [])) == []
            assert not {pid for _, pid in each(process, range(4))} & {process(0)}

    def test_an_exception_is_itself(self, two):
        with pool(**two) as each:
            with pytest.raises(TimeoutError, match="no 7"):
                list(each(Job(fails=7), range(20)))
            assert sorted(each(Job(), range(20))) == SQUARES

    def test_leaving_early_ends_the_rest(self, two):
        started = time.monotonic()
        with pool(**two) as each:
            for _ in each(time.sleep, [0, *[2] * 20]):
                break
        assert time.monotonic() - started < 15

    @mortal
    def test_a_worker_that_is_killed_loses_nothing_and_nothing_comes_twice(self, two, tmp_path):
        note = tmp_path / "killed"
        with pool(**two) as each:
            assert sorted(each(Job(kills=7, note=note), range(20))) == SQUARES
        assert note.exists()

    @mortal
    def test_an_item_that_kills_every_worker(self):
        with pool(2) as each, pytest.raises(WorkerError, match="died again and again"):
            list(each(Job(kills=3), range(4)))


@mortal
def test_shards_are_the_same_bytes_though_a_worker_was_killed(two, tmp_path):
    names = [f"{i}.parquet" for i in range(6)]
    make = partial(make_shards, manifest="m.json", config={}, names=names, counts={})
    counts, note = [], tmp_path / "killed"
    make(tmp_path / "one", make=Shards())
    make(tmp_path / "two", make=Shards(kills=3, note=note), **two,
         progress=lambda *count: counts.append(count))  # fmt: skip
    assert note.exists()
    assert counts == [(n, 6) for n in range(7)]
    for name in ("m.json", *names):
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes()
    assert len(list((tmp_path / "two").iterdir())) == 7


SCRIPT = """
import sys
from legibility.parallel import pool
print(__name__)
with pool(2, *sys.argv[1:]) as each:
    print(sorted(each(abs, [-1, -2])))
"""


class TestScriptWithoutGuard:
    """A script that starts workers at its top level, which each worker may import."""

    def run(self, folder, *arguments):
        (folder / "script.py").write_text(SCRIPT)
        line = [sys.executable, str(folder / "script.py"), *arguments]
        return subprocess.run(line, capture_output=True, text=True, timeout=120)

    def test_processes_do_not_import_it(self, tmp_path):
        finished = self.run(tmp_path)
        assert (finished.returncode, finished.stderr) == (0, "")
        assert finished.stdout == "__main__\n[(0, 1), (1, 2)]\n"

    def test_a_local_cluster_is_an_error(self, tmp_path):
        pytest.importorskip("distributed", reason="Dask is NOT TESTED: the extra is missing")
        finished = self.run(tmp_path, "local")
        assert finished.returncode == 1
        last = finished.stderr.splitlines()[-1]
        assert last.startswith("legibility.errors.WorkerError: the local cluster did not start")
        assert "below `if __name__ == '__main__':`" in last
        assert finished.stdout.count("__mp_main__") <= 2


class TestRefuses:
    @pytest.mark.parametrize("workers", [0, -1, 1.5, "2", True])
    def test_workers(self, workers):
        with pytest.raises(InvalidInputError, match="workers"), pool(workers):
            pass

    @pytest.mark.parametrize("address", ["", "localhost", "here", "http://localhost:1"])
    def test_what_is_no_address(self, address):
        with pytest.raises(InvalidInputError, match="cluster must be"), pool(1, address):
            pass

    def test_workers_of_a_cluster_that_has_its_own(self):
        with pytest.raises(InvalidInputError, match="its own"), pool(2, "tcp://localhost:1"):
            pass

    @pytest.mark.parametrize("place", ["127.0.0.1:{free}", "nowhere.invalid:1", "127.0.0.1"])
    def test_a_scheduler_that_is_not_there(self, place):
        pytest.importorskip("distributed", reason="Dask is NOT TESTED: the extra is missing")
        with socket.socket() as found:
            found.bind(("127.0.0.1", 0))
            free = found.getsockname()[1]
        address = f"tcp://{place.format(free=free)}"
        message = f"no Dask scheduler answers at {address}"
        with pytest.raises(WorkerError, match=message), pool(1, address):
            pass

    def test_no_dask(self, monkeypatch):
        monkeypatch.setitem(sys.modules, "distributed", None)
        message = r"legibility\[cluster\]"
        with pytest.raises(MissingExtraError, match=message), pool(2, "local"):
            pass


def test_threads_are_put_back():
    before = torch.get_num_threads()
    with threads(before + 1):
        assert torch.get_num_threads() == before + 1
        assert threads(1)(torch.get_num_threads)() == 1
        assert torch.get_num_threads() == before + 1
    with pytest.raises(ZeroDivisionError), threads(before + 1):
        _ = 1 / 0
    assert torch.get_num_threads() == before
