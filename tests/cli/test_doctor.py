"""The doctor reports every part, and never fails because of one."""

import json
import re
import sys
from importlib import metadata
from pathlib import Path

import pytest

import legibility
from legibility.cli import doctor
from legibility.errors import CheckpointError


@pytest.fixture(autouse=True)
def nothing_drawn(request, monkeypatch):
    """Drawing takes a while; `TestDrawing` suffices."""
    if request.cls is None:
        monkeypatch.setattr(doctor, "_BACKENDS", {})


@pytest.fixture
def plane(monkeypatch):
    """The 2-D environment alone, for the arms' simulators take a while."""
    from legibility import envs

    monkeypatch.setattr(envs, "ENVIRONMENTS", {"2d": envs.ENVIRONMENTS["2d"]})


@pytest.fixture
def absent(monkeypatch):
    """Pretend that packages are not installed."""

    def remove(*names):
        version = metadata.version

        def found(name):
            if name in names:
                raise metadata.PackageNotFoundError(name)
            return version(name)

        monkeypatch.setattr(metadata, "version", found)
        modules = [name.replace("-", "_") for name in names]
        loaded = [m for m in sys.modules if m.partition(".")[0] in modules]
        for module in (*modules, *loaded):
            monkeypatch.setitem(sys.modules, module, None)
        monkeypatch.setattr("legibility.envs.pandagym._IDLE", [])  # nor was there one before

    return remove


def examined(cli, status=0):
    assert cli("doctor --json found.json") == status
    return json.loads(Path("found.json").read_text())["result"]


def test_report(here, cli, capsys):
    found = examined(cli)
    text = capsys.readouterr().out
    assert found["works"] is True
    assert found["system"]["legibility"] == legibility.__version__
    assert found["system"]["python"] == ".".join(map(str, sys.version_info[:3]))
    assert found["system"]["cores"] >= 1
    assert found["torch"]["error"] is None
    assert found["torch"]["build"] == "CPU" or found["torch"]["build"].startswith("CUDA ")
    assert found["torch"]["threads"] >= 1
    weights = found["weights"]["block-reach-2d"]
    assert weights["error"] is None
    assert set(weights["files"]) == {"path.safetensors", "policy.safetensors"}
    assert all(size > 1e5 for size in weights["files"].values())
    assert found["environments"]["2d"] == {"id": "legibility/BlockReach2D-v0", "error": None}
    for name in (legibility.__version__, "block-reach-2d", "path.safetensors", "torch", "ffmpeg"):
        assert name in text
    assert text.endswith("the core works\n")


def test_packages_are_those_of_the_distribution(here, cli, plane):
    found = examined(cli)["packages"]
    distribution = metadata.distribution("legibility")
    assert next(iter(found)) == "core"
    assert set(found) == {"core", *distribution.metadata.get_all("Provides-Extra")}
    assert sum(map(len, found.values())) == len(distribution.requires)
    assert found["core"]["numpy"] == {
        "wanted": "<3,>=2.0",
        "version": metadata.version("numpy"),
        "problem": None,
    }
    assert "pyright" in found["dev"]


def test_missing_extras(here, cli, capsys, absent):
    absent("panda-gym", "mujoco")
    found = examined(cli)
    text = " ".join(capsys.readouterr().out.split())
    assert found["works"] is True
    for extra, package in (("pandagym", "panda-gym"), ("panda", "mujoco")):
        assert found["packages"][extra][package]["version"] is None
        assert found["packages"][extra][package]["problem"] == "missing"
        error = found["environments"][extra]["error"]
        assert f"pip install 'legibility[{extra}]'" in error
        assert f"missing: pip install 'legibility[{extra}]'" in text
    assert found["gl"] == {}


def test_versions_that_do_not_fit(here, cli, plane, capsys, monkeypatch):
    monkeypatch.setattr(metadata, "version", lambda name: "0.0.1")
    found = examined(cli)
    assert found["packages"]["core"]["numpy"]["problem"] == "<3,>=2.0 is wanted"
    text = capsys.readouterr().out
    assert "<3,>=2.0 is wanted: pip install --upgrade 'legibility'" in text
    assert re.search(r"is wanted: pip install --upgrade 'legibility\[viewer\]'", text)


def test_sources_without_a_distribution(here, cli, plane, monkeypatch):
    def missing(name):
        raise metadata.PackageNotFoundError(name)

    monkeypatch.setattr(metadata, "distribution", missing)
    assert examined(cli)["packages"] == {}


@pytest.mark.parametrize("what", ["weights", "networks", "environment", "gymnasium"])
def test_a_core_that_does_not_work(what, here, cli, plane, capsys, monkeypatch):
    def broken(*_, **__):
        raise CheckpointError("the weights are\nspoilt")

    if what == "weights":
        monkeypatch.setattr("legibility.models.pretrained.load_stages", broken)
    elif what == "networks":
        monkeypatch.setitem(sys.modules, "legibility.models.pretrained", None)
    elif what == "environment":
        monkeypatch.setattr("legibility.envs.block_reach_2d.BlockReach2D.step", broken)
    else:
        monkeypatch.setitem(sys.modules, "gymnasium", None)
    found = examined(cli, status=2)
    output = capsys.readouterr()
    assert found["works"] is False
    assert "parts that work" in output.out
    assert output.err.startswith("legibility: error: the ")
    assert output.err.count("\n") == 1
    if what in ("weights", "environment"):
        assert output.err.endswith("does not work: the weights are spoilt\n")


def test_torch_that_cannot_be_loaded(monkeypatch):
    monkeypatch.setitem(sys.modules, "torch", None)
    found = doctor._torch()
    assert found == {"error": found["error"]}
    assert "torch" in found["error"]
    assert ("torch", found["error"]) in doctor._machine_rows(
        {"system": doctor._system(), "torch": found}
    )


def test_file_that_cannot_be_written(here, refused):
    assert "cannot write the JSON file" in refused("doctor --json .")


class TestDrawing:
    """Each backend in a process of its own, which may do whatever it likes."""

    @pytest.fixture(autouse=True)
    def mujoco(self):
        pytest.importorskip("mujoco", reason="MuJoCo is NOT TESTED: the extra panda is missing")

    def test_every_backend_is_tried(self):
        backends = doctor._backends()
        assert backends == (["egl", "osmesa", "glfw"] if sys.platform == "linux" else ["glfw"])
        assert all(error is None or error for error in map(doctor._renderer_error, backends))

    @pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
    @pytest.mark.parametrize(
        ("script", "expected"),
        [
            ("print('fine')", None),
            ("raise RuntimeError('no\\nlibrary')", "library"),
            ("import os; os.abort()", "MuJoCo ended with status -6"),
            ("import time; time.sleep(60)", "no picture after 1 s"),
        ],
    )
    def test_what_may_come_of_it(self, script, expected, monkeypatch):
        monkeypatch.setattr(doctor, "_DRAW", script)
        if expected and "picture" in expected:
            monkeypatch.setattr(doctor, "_PATIENCE", 1.0)
        assert doctor._renderer_error("glfw") == expected

    def test_remedy(self):
        result = {
            "environments": {},
            "weights": {},
            "gl": {"osmesa": "no libOSMesa", "egl": None},
            "ffmpeg": None,
        }
        osmesa, egl, ffmpeg = doctor._working_rows(result)
        assert osmesa[2:] == ("–", "apt-get install libosmesa6 (no libOSMesa)")
        assert egl[2:] == ("works", "")
        assert "apt-get install ffmpeg" in ffmpeg[3]
