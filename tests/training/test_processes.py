"""Several processes train as one does, and go on after one of them was killed."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import legibility as lg
from legibility.data.configuration import DatasetConfig
from legibility.data.dataset import generate
from legibility.models.checkpoint import load_tensors
from legibility.training.loop import CHECKPOINT, LOG

pytest.importorskip("accelerate", reason="the extra named train is not installed")
psutil = pytest.importorskip("psutil")

SOURCE = str(Path(lg.__file__).parents[1])
WORDS = (
    "-m legibility train path --scenes 4 --per-scene 4 --warmup 2 --validate-every 1000000"
    " --checkpoint-every 1 --channels 8 16 --condition 16 --encoder-width 8 --resolution 16"
    " --device cpu"
)


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    folder = tmp_path_factory.mktemp("data")
    generate(DatasetConfig(scenes=5, cells=8, per_scene=17), folder)
    return folder


def start(processes, steps, data, out):
    launcher = ["-m", "torch.distributed.run", "--standalone", f"--nproc-per-node={processes}"]
    return subprocess.Popen(
        [sys.executable, *(launcher if processes > 1 else []), *WORDS.split(),
         "--steps", str(steps), "--data", data, "--validation", data, "--out", out],
        env={**os.environ, "PYTHONPATH": SOURCE, "OMP_NUM_THREADS": "1"},
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip


def finish(run):
    out, err = run.communicate(timeout=300)
    assert run.returncode == 0, err
    return out


def losses(folder):
    rows = [json.loads(line) for line in (folder / LOG).read_text().splitlines()]
    return [[row["step"], row["loss"], row["velocity"], row["label"], row["wall"]] for row in rows]


@pytest.fixture(scope="module")
def alone(data, tmp_path_factory):
    """The folder of a run of 10 steps by one process."""
    folder = tmp_path_factory.mktemp("alone")
    finish(start(1, 10, data, folder))
    return folder


def test_two_take_the_steps_of_one(data, alone, tmp_path):
    printed = finish(start(2, 10, data, tmp_path))
    assert printed.count("parameters after 10 steps") == 1
    made = json.loads((tmp_path / "weights" / "config.json").read_text())
    assert '"processes": 2' in json.dumps(made)
    assert len(losses(tmp_path)) == 10
    np.testing.assert_allclose(losses(tmp_path), losses(alone), rtol=1e-3, atol=1e-5)
    one, two = (load_tensors(folder / CHECKPOINT)[0] for folder in (alone, tmp_path))
    for name in one:
        if name.startswith("model."):
            np.testing.assert_allclose(two[name], one[name], atol=2e-3, err_msg=name)


LEAVES = """
import weakref, torch
from torch.distributed import distributed_c10d
from legibility.training import Team
team = Team.join("cpu")
group = weakref.ref(distributed_c10d._get_default_group())
import torch._dynamo
assert team.mean([torch.tensor([float(team.rank)])])[0] == 0.5
team.leave()
assert group() is None
print("left")
"""


def test_nothing_is_left_of_a_group_that_ended(tmp_path):
    (tmp_path / "leaves.py").write_text(LEAVES)
    run = subprocess.run(
        [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node=2",
         str(tmp_path / "leaves.py")],
        env={**os.environ, "PYTHONPATH": SOURCE, "OMP_NUM_THREADS": "1"},
        capture_output=True, text=True, timeout=200,
    )  # fmt: skip
    assert run.returncode == 0, run.stderr
    assert run.stdout.count("left") == 2


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="no SIGKILL on this system")
def test_one_killed_ends_the_run_and_the_same_command_resumes(data, tmp_path):
    run = start(2, 60, data, tmp_path)
    deadline = time.monotonic() + 200
    while not (tmp_path / CHECKPOINT).exists() and run.poll() is None:
        assert time.monotonic() < deadline
        time.sleep(0.05)
    (second,) = (p for p in psutil.Process(run.pid).children() if p.environ().get("RANK") == "1")
    second.kill()
    run.communicate(timeout=200)
    assert run.returncode != 0
    done = load_tensors(tmp_path / CHECKPOINT)[1]["step"]
    assert 0 < done < 60
    before = losses(tmp_path)[:done]
    finish(start(2, 60, data, tmp_path))
    after = losses(tmp_path)
    assert [row[0] for row in after] == list(range(1, 61))
    assert after[:done] == before
