"""Demonstrations lie beside their dataset, under the same rules."""

import hashlib
import shutil

import numpy as np
import pytest

from legibility.data import demonstrations
from legibility.data.configuration import DatasetConfig, DemonstrationsConfig
from legibility.data.dataset import Dataset, generate
from legibility.data.demonstrations import Demonstrations, demonstrate
from legibility.data.shards import SHARD
from legibility.errors import DatasetError, InvalidInputError

TINY = DatasetConfig(scenes=SHARD + 3, cells=8, per_scene=9)
SHOWN = DemonstrationsConfig(demonstrations=2, pushed=0.5)


def hashes(folder):
    return {
        p.name: hashlib.sha256(p.read_bytes()).hexdigest() for p in folder.glob("demonstrations*")
    }


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("shown")
    generate(TINY, folder)
    demonstrate(folder, SHOWN)
    return folder


@pytest.fixture
def copy(made, tmp_path):
    return shutil.copytree(made, tmp_path / "copy")


def test_content(made):
    shown, data = Demonstrations.load(made), Dataset.load(made)
    assert shown.config == SHOWN.within(data.config)
    assert shown.dataset == TINY
    assert len(shown) == 2 * TINY.scenes == len(shown.paths) == len(shown.actions)
    assert 0.2 < shown.pushed.mean() < 0.8
    low, high = shown.workspace
    for i, (states, actions, path) in enumerate(
        zip(shown.states, shown.actions, shown.paths, strict=True)
    ):
        scene = data.scenes[i // 2]
        assert len(states) == len(actions) + 1
        assert (np.abs(actions) <= shown.limit + 1e-6).all()
        assert ((states >= low - 1e-6) & (states <= high + 1e-6)).all()
        np.testing.assert_allclose(states[0], scene.start, atol=1e-6)
        np.testing.assert_allclose(path[[0, -1]], [scene.start, scene.goals[0]], atol=1e-6)
        assert np.linalg.norm(states[-1] - scene.goals[0]) <= 0.0201
        assert np.abs(path[1:-1] - data.waypoints[i // 2]).max((1, 2)).min() < 1e-6
    # One from each half of the levels.
    assert (shown.labels[0::2] <= shown.labels[1::2] + 1e-6).all()


def test_the_same_bytes_for_any_number_of_workers(made, copy):
    for file in copy.glob("demonstrations*"):
        file.unlink()
    demonstrate(copy, SHOWN, workers=2)
    assert hashes(copy) == hashes(made)


def test_goes_on_where_it_stopped(made, copy):
    (copy / "demonstrations-00001.parquet").unlink()
    manifest = (copy / "demonstrations.json").read_text()
    (copy / "demonstrations.json").write_text(
        manifest.replace('"complete": true', '"complete": false')
    )
    with pytest.raises(DatasetError, match="not complete"):
        Demonstrations.load(copy)
    done = []
    demonstrate(copy, SHOWN, progress=lambda *count: done.append(count))
    assert done == [(1, 2), (2, 2)]
    assert hashes(copy) == hashes(made)


def test_a_part_of_the_scenes(made, tmp_path):
    folder = shutil.copytree(made, tmp_path / "part")
    for file in folder.glob("demonstrations*"):
        file.unlink()
    part = demonstrate(folder, DemonstrationsConfig(demonstrations=1, demonstrated=5))
    assert len(part) == 5


def test_refuses(copy, tmp_path):
    with pytest.raises(DatasetError, match="another configuration"):
        demonstrate(copy, DemonstrationsConfig(demonstrations=3))
    with pytest.raises(DatasetError, match="cannot read"):
        demonstrate(tmp_path / "nothing", SHOWN)
    with pytest.raises(DatasetError, match="cannot read"):
        Demonstrations.load(tmp_path)
    (copy / "demonstrations-00000.parquet").write_bytes(b"other")
    with pytest.raises(DatasetError, match="not as it was written"):
        Demonstrations.load(copy)


def test_nobody_arrives(made, tmp_path, monkeypatch):
    folder = shutil.copytree(made, tmp_path / "none")
    for file in folder.glob("demonstrations*"):
        file.unlink()
    roll = demonstrations._roll
    monkeypatch.setattr(
        demonstrations, "_roll", lambda *args: (roll(*args)[0], np.zeros(len(args[2]), bool))
    )
    with pytest.raises(InvalidInputError, match="lower noise or push"):
        demonstrate(folder, SHOWN)
    assert not list(folder.glob("demonstrations-*"))


def test_an_arm_demonstrates_in_solid_scenes(tmp_path):
    pytest.importorskip("mujoco", reason="the extra named panda is not installed")
    generate(DatasetConfig(dim=3, scenes=2, cells=6, per_scene=3), tmp_path)
    shown = demonstrate(tmp_path, DemonstrationsConfig(demonstrations=2))
    assert len(shown) == 4
    assert shown.config.noise == pytest.approx(0.06 * shown.limit)
    for path, states in zip(shown.paths, shown.states, strict=True):
        np.testing.assert_allclose(states[0], path[0], atol=1e-4)
        assert np.linalg.norm(states[-1] - path[-1]) <= 0.02
