"""Demonstrations lie beside their dataset, under the same rules."""

import hashlib
import shutil

import numpy as np
import pytest
from arms import UR5E, ur5e

from legibility.data import demonstrations
from legibility.data.configuration import DatasetConfig, DemonstrationsConfig
from legibility.data.dataset import Dataset, generate
from legibility.data.demonstrations import Demonstrations, demonstrate
from legibility.envs.block_reach_2d import BlockReach2DVector
from legibility.errors import DatasetError, InvalidInputError
from legibility.files import write_document

SHARD = 4
TINY = DatasetConfig(
    scenes=SHARD + 3, views=2, cells=6, per_scene=9, candidates=4096, regime="obstacles"
)
SHOWN = DemonstrationsConfig(demonstrations=2, pushed=0.5)


def hashes(folder):
    return {
        p.name: hashlib.sha256(p.read_bytes()).hexdigest() for p in folder.glob("demonstrations*")
    }


@pytest.fixture(scope="module", autouse=True)
def small_shards():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(demonstrations, "SHARD", SHARD)
        yield


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
    assert len(shown.paths) == len(shown.actions) == len(shown) <= 2 * TINY.scenes
    assert len(shown) > 0.7 * 2 * TINY.scenes  # the guard may stop one that was pushed
    assert 0.2 < shown.pushed.mean() < 0.8
    low, high = shown.workspace
    followed = []
    for states, actions, path in zip(shown.states, shown.actions, shown.paths, strict=True):
        assert len(states) == len(actions) + 1
        assert (np.abs(actions) <= shown.limit + 1e-6).all()
        assert ((states >= low - 1e-6) & (states <= high + 1e-6)).all()
        gaps = np.abs(data.waypoints - path[1:-1]).max((2, 3))
        row, _ = np.unravel_index(np.argmin(gaps), gaps.shape)
        assert gaps.min() < 1e-6
        followed.append(row)
        scene = data.scenes[row]
        np.testing.assert_allclose(states[0], scene.start, atol=1e-6)
        np.testing.assert_allclose(path[[0, -1]], [scene.start, scene.goals[0]], atol=1e-6)
        assert np.linalg.norm(states[-1] - scene.goals[0]) <= 0.0201
    numbers = np.bincount(followed, minlength=len(data.scenes))
    assert not numbers[1::2].any()  # the first view of each scene
    assert numbers.max() <= 2


def test_the_guard_knows_the_obstacles(made, monkeypatch):
    """Undisturbed, the controller touches nothing on feasible paths."""
    data = Dataset.load(made)
    touched = []

    class Watched(BlockReach2DVector):
        def step(self, actions):
            result = super().step(actions)
            touched.append(self.contact.copy())
            return result

    monkeypatch.setattr(demonstrations, "vector_type", lambda *_: Watched)
    inner = data.waypoints[::2, 4].astype(np.float64)
    ends = np.stack([[s.start, s.goals[0]] for s in data.scenes[::2]])
    paths = np.concatenate([ends[:, :1], inner, ends[:, 1:]], axis=1)
    config = DemonstrationsConfig(demonstrations=1, noise=0.0, push=0.0)
    size = len(paths)
    demonstrations._roll(
        config, None, data.scenes[::2], paths, np.zeros(size, bool), list(range(size))
    )  # fmt: skip
    assert not np.any(touched)


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
    config = DatasetConfig(
        dim=3, scenes=2, views=1, cells=6, per_scene=3, candidates=4096, regime="dragan"
    )
    generate(config, tmp_path)
    shown = demonstrate(tmp_path, DemonstrationsConfig(demonstrations=2))
    assert len(shown) == 4
    assert shown.config.noise == pytest.approx(0.06 * shown.limit)
    for path, states in zip(shown.paths, shown.states, strict=True):
        np.testing.assert_allclose(states[0], path[0], atol=1e-4)
        assert np.linalg.norm(states[-1] - path[-1]) <= 0.02


def test_any_arm_demonstrates(tmp_path):
    """Which one, the manifest says by its name, and not by its file."""
    arm = ur5e(name="ours")
    content = {"model": str(arm.model), "name": "ours", **UR5E}
    limits = {"velocity": [3.0] * 6, "acceleration": [10.0] * 6, "jerk": [1000.0] * 6}
    write_document(file := tmp_path / "arm.yaml", {**content, "limits": limits})
    source = DatasetConfig(
        scenes=1, dim=3, per_scene=4, cells=6, candidates=4096, goals=(2, 2), seed=2
    )
    generate(source, folder := tmp_path / "data")
    shutil.copytree(folder, other := tmp_path / "other")
    shown = demonstrate(folder, DemonstrationsConfig(demonstrations=2, arm=str(file)))
    assert shown.config.arm == "ours"
    assert len(shown) == 2
    panda = demonstrate(other, DemonstrationsConfig(demonstrations=2))
    assert panda.config.arm is None
    assert not np.allclose(shown.states[0][5], panda.states[0][5], atol=1e-5)
    with pytest.raises(InvalidInputError, match="arm must be one of panda"):
        demonstrate(folder, DemonstrationsConfig(demonstrations=2, arm="ur5"))
