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
    """Skip the slow drawing; `TestDrawing` covers it."""
    if request.cls is None:
        monkeypatch.setattr(doctor, "_BACKENDS", {})


@pytest.fixture
def plane(monkeypatch):
    """The 2-D environment alone; the arms' simulators are slow."""
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
    """Whether the core works, and the state and remedy of each part by its group and name."""
    assert cli("doctor --json found.json") == status
    result = json.loads(Path("found.json").read_text())["result"]
    assert result["works"] is (status == 0)
    return {(row["part"], row["name"]): (row["state"], row["remedy"]) for row in result["parts"]}


def test_report(here, cli, capsys):
    parts = examined(cli)
    text = capsys.readouterr().out
    assert parts["machine", "legibility"] == (legibility.__version__, "")
    python = ".".join(map(str, sys.version_info[:3]))
    assert parts["machine", "Python"][0].startswith(f"{python} (")
    assert re.search(r", [1-9]\d* cores$", parts["machine", "system"][0])
    torch, remedy = parts["machine", "torch"]
    assert re.search(r", (CPU|CUDA .*), [1-9]\d* threads", torch)
    assert remedy == ""
    weights, remedy = parts["weights", "block-reach-2d"]
    assert re.fullmatch(r"path.safetensors [\d.]+ MB, policy.safetensors [\d.]+ MB", weights)
    assert remedy == ""
    assert parts["environment", "2d"] == ("works", "")
    assert ("films as .mp4", "ffmpeg") in parts
    for name in (legibility.__version__, "block-reach-2d", "path.safetensors", "torch", "ffmpeg"):
        assert name in text
    assert text.endswith("the core works\n")


def test_packages_are_those_of_the_distribution(here, cli, plane):
    parts = examined(cli)
    distribution = metadata.distribution("legibility")
    groups = [part for part, _ in parts if part == "core" or part.startswith("extra ")]
    extras = distribution.metadata.get_all("Provides-Extra")
    assert groups[0] == "core"
    assert set(groups) == {"core", *(f"extra {extra}" for extra in extras)}
    assert len(groups) == len(distribution.requires)
    assert parts["core", "numpy"] == (metadata.version("numpy"), "")
    assert ("extra dev", "pyright") in parts


def test_missing_extras(here, cli, capsys, absent):
    absent("panda-gym", "mujoco")
    parts = examined(cli)
    text = " ".join(capsys.readouterr().out.split())
    for extra, package in (("pandagym", "panda-gym"), ("panda", "mujoco")):
        remedy = f"missing: pip install 'legibility[{extra}]'"
        assert parts[f"extra {extra}", package] == ("–", remedy)
        assert f"pip install 'legibility[{extra}]'" in parts["environment", extra][1]
        assert remedy in text
    assert not any(part == "MuJoCo's pictures" for part, _ in parts)


def test_versions_that_do_not_fit(here, cli, plane, capsys, monkeypatch):
    monkeypatch.setattr(metadata, "version", lambda name: "0.0.1")
    remedy = "<3,>=2.0 is wanted: pip install --upgrade 'legibility'"
    assert examined(cli)["core", "numpy"] == ("0.0.1", remedy)
    text = capsys.readouterr().out
    assert remedy in text
    assert re.search(r"is wanted: pip install --upgrade 'legibility\[viewer\]'", text)


def test_sources_without_a_distribution(here, cli, plane, monkeypatch):
    def missing(name):
        raise metadata.PackageNotFoundError(name)

    monkeypatch.setattr(metadata, "distribution", missing)
    groups = {part for part, _ in examined(cli)}
    assert groups == {"machine", "environment", "weights", "films as .mp4"}


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
    part = {
        "weights": "weights block-reach-2d", "networks": "weights block-reach-2d",
        "environment": "environment 2d", "gymnasium": "environment 2d",
    }[what]  # fmt: skip
    examined(cli, status=2)
    output = capsys.readouterr()
    assert "films as .mp4" in output.out
    assert output.err.startswith(f"legibility: error: the core does not work: {part}: ")
    assert output.err.count("\n") == 1
    if what in ("weights", "environment"):
        assert output.err.endswith(": the weights are spoilt\n")


def test_torch_that_cannot_be_loaded(monkeypatch):
    monkeypatch.setitem(sys.modules, "torch", None)
    torch = list(doctor._machine())[-1]
    assert torch[:3] == ("machine", "torch", "–")
    assert "torch" in torch.remedy


def test_file_that_cannot_be_written(here, refused):
    assert "cannot write the JSON file" in refused("doctor --json .")


class TestDrawing:
    """Each backend draws in a process of its own, which it may end."""

    @pytest.fixture(autouse=True)
    def mujoco(self):
        pytest.importorskip("mujoco", reason="MuJoCo is NOT TESTED: the extra panda is missing")

    def test_every_backend_is_tried(self):
        parts = doctor._renderers()
        backends = ["egl", "osmesa", "glfw"] if sys.platform == "linux" else ["glfw"]
        assert [part.name for part in parts] == backends
        for part in parts:
            assert (part.state, bool(part.remedy)) in (("works", False), ("–", True))

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
    def test_error_of_a_renderer(self, script, expected, monkeypatch):
        monkeypatch.setattr(doctor, "_DRAW", script)
        if expected and "picture" in expected:
            monkeypatch.setattr(doctor, "_PATIENCE", 1.0)
        part = doctor._attempt("MuJoCo's pictures", "glfw", doctor._draw)
        assert part.state == ("–" if expected else "works")
        assert part.remedy.endswith(f" ({expected})" if expected else "")

    def test_remedy(self, monkeypatch):
        monkeypatch.setattr(doctor, "_DRAW", "raise SystemExit('no libOSMesa')")
        osmesa = doctor._attempt("MuJoCo's pictures", "osmesa", doctor._draw)
        assert osmesa.remedy == "apt-get install libosmesa6 (no libOSMesa)"
        monkeypatch.setattr(doctor.shutil, "which", lambda name: None)
        (ffmpeg,) = doctor._ffmpeg()
        assert ffmpeg.state == "–"
        assert "apt-get install ffmpeg" in ffmpeg.remedy
