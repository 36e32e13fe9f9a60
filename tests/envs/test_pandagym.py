"""The arm in panda-gym keeps what its docstring promises; `test_arms` has the laws of both arms."""

import copy
import gc
import itertools
import subprocess
import sys

import numpy as np
import pytest
from episodes import equal, safe, toward
from hypothesis import given, settings
from hypothesis import strategies as st

from legibility import Scene
from legibility.envs import pandagym
from legibility.envs.pandagym import JOINT_LIMITS, PandaGymBlockReach, PandaGymBlockReachVector
from legibility.errors import InvalidInputError, MissingExtraError
from legibility.scene import DEFAULT_WORKSPACE

pytest.importorskip(
    "panda_gym", reason="panda-gym is NOT TESTED: pip install 'legibility[pandagym]' (Python 3.11)"
)

LOW, HIGH = np.array(DEFAULT_WORKSPACE[3])
SCENE = Scene([-0.2, -0.1, 0.3], [[0, 0.15, 0.02], [0, -0.1, 0.06]])

seeds = st.integers(0, 2**32 - 1)


@pytest.fixture(scope="module")
def world():
    return pandagym._World()


class TestSimulator:
    def test_same_interface_in_mujoco(self):
        pytest.importorskip("mujoco", reason="MuJoCo is NOT TESTED: the extra panda is missing")
        panda = pytest.importorskip("legibility.envs.panda")
        ours, theirs = PandaGymBlockReach(), panda.PandaBlockReach()
        assert ours.observation_space == theirs.observation_space
        assert ours.action_space == theirs.action_space
        first, second = (e.reset(seed=0, options={"scene": SCENE}) for e in (ours, theirs))
        for one, other in zip(first, second, strict=True):
            assert {k: type(v) for k, v in one.items()} == {k: type(v) for k, v in other.items()}
        assert first[0]["position"] == pytest.approx(second[0]["position"], abs=1e-3)

    def test_pictures(self):
        pytest.importorskip("mujoco", reason="pictures are NOT TESTED: the extra panda is missing")
        env = PandaGymBlockReachVector(2, render_mode="rgb_array")
        other = PandaGymBlockReachVector(2)
        for each in (env, other):
            each.reset(seed=0, options={"scene": [SCENE, None]})
        before = env.render()
        for picture in before:
            assert picture.dtype == np.uint8
            assert picture.shape == (480, 480, 3)
        assert (before[0] != before[1]).any()
        red, green = (_share_of(before[0], color) for color in ((193, 18, 31), (0, 158, 115)))
        assert 0.0005 < red < 0.02
        assert 0.0005 < green < 0.02
        for _ in range(3):  # looking changes nothing
            actions = toward(env)
            assert equal(env.step(actions), other.step(actions))
        assert (env.render()[0] != before[0]).any()
        env.reset(seed=0, options={"scene": [SCENE, None]})
        assert np.array_equal(env.render()[0], before[0])
        assert other.render() is None

    def test_nothing_is_printed(self):
        code = (
            "from legibility.envs.pandagym import PandaGymBlockReachVector as E; e = E(1); E(1);"
            "e.reset(seed=0); print('done')"
        )
        found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
        assert (found.returncode, found.stdout, found.stderr) == (0, "done\n", "")

    def test_copies(self):
        for env in (PandaGymBlockReach(), PandaGymBlockReachVector(1)):
            with pytest.raises(InvalidInputError, match="cannot be copied"):
                copy.deepcopy(env)

    def test_missing(self, monkeypatch):
        for module in ("panda_gym", "panda_gym.pybullet", "panda_gym.envs.robots.panda"):
            monkeypatch.setitem(sys.modules, module, None)
        monkeypatch.setattr(pandagym, "_IDLE", [])
        message = (
            r"pip install 'legibility\[pandagym\]'; its pybullet has .* up to Python 3\.11 only"
        )
        with pytest.raises(MissingExtraError, match=message):
            PandaGymBlockReach()

    def test_contact_leaves_no_trace(self, world):
        world.place(LOW)
        before = [world.place(SCENE.start), *(world.drive(LOW, 20) for _ in range(5))]
        world.place(np.array([-0.1, 0, 0.02]))
        pressed = [world.drive(np.array([-0.1, 0, -0.03]), 20)[1][0] for _ in range(4)]
        assert pressed[-1] == 20
        after = [world.place(SCENE.start), *(world.drive(LOW, 20) for _ in range(5))]
        assert equal(before[0], after[0])
        assert all(
            np.array_equal(b[0], a[0]) and b[1] == a[1]
            for b, a in zip(before[1:], after[1:], strict=True)
        )

    def test_worlds_are_used_again(self, monkeypatch):
        monkeypatch.setattr(pandagym, "_IDLE", [])
        env = PandaGymBlockReachVector(2)
        worlds = {id(world) for world in env._worlds}
        env.close()
        env.close()
        other = PandaGymBlockReachVector(2)
        assert {id(world) for world in other._worlds} == worlds
        del other
        gc.collect()
        assert {id(world) for world in pandagym._IDLE} == worlds


def _share_of(picture, color):
    """The share of pixels whose hue is that of `color`, in light or shade."""
    pixels = picture / np.maximum(picture.sum(-1, keepdims=True), 1)
    return (np.abs(pixels - np.array(color) / sum(color)).max(-1) < 0.03).mean()


class TestArm:
    def test_every_corner_can_be_reached(self, world):
        sides = (np.linspace(low, high, 4) for low, high in zip(LOW, HIGH, strict=True))
        for position in np.array(list(itertools.product(*sides))):
            found = world.place(position)
            assert found == pytest.approx(position, abs=1e-4)
            angles = world.joints()
            assert (JOINT_LIMITS[0] + 0.02 < angles).all()
            assert (angles < JOINT_LIMITS[1] - 0.02).all()
            orientation = world.client.getLinkState(world.body, world.arm.ee_link)[1]
            assert 2 * np.hypot(*orientation[1:3]) < 0.05  # a tilt of 3°
            _, counted = world.drive(found, 20)
            assert counted == [0, 0, 0, 0]
            world.place(SCENE.start)
            world.place(position)
            assert np.array_equal(world.joints(), angles)

    @settings(max_examples=5)
    @given(seeds)
    def test_safe_actions_are_safe(self, seed):
        env = PandaGymBlockReachVector(1, max_episode_steps=1000)
        env.reset(seed=seed)
        rng = np.random.default_rng(seed)
        for step in range(120):
            if step % 12 == 0:  # far out of the workspace, as often as not
                aim = rng.uniform(LOW - 0.2, HIGH + 0.2)
            env.done[:] = False
            observation, *_ = env.step(safe(env, aim - env.positions))
            assert observation in env.observation_space
            beyond = np.maximum(LOW - env.positions, env.positions - HIGH).max()
            assert beyond < 0.025
        assert not any(number.any() for number in env.counts.values())

    @settings(max_examples=8)
    @given(seeds, st.floats(0.004, 0.02))
    def test_most_of_a_command_is_realised_and_stopping_is_quick(self, seed, size):
        rng = np.random.default_rng(seed)
        env = PandaGymBlockReachVector(1)
        scene = Scene(rng.uniform(LOW + 0.07, HIGH - 0.07), SCENE.goals)
        env.reset(seed=0, options={"scene": scene})
        action = rng.standard_normal((1, 3))
        action *= size / np.abs(action).max()
        for _ in range(3):
            before = env.positions.copy()
            env.step(action)
        moved = env.positions - before
        assert 0.4 < (moved * action).sum() / (action**2).sum() < 1.05
        before = env.positions.copy()
        for _ in range(5):
            env.step(np.zeros((1, 3)))
        lag = env.lag_range[1]
        assert np.linalg.norm(env.positions - before) < lag / (1 - lag) * np.linalg.norm(moved)

    def test_what_is_counted(self, world):
        world.place(np.array([-0.1, 0, 0.2]))
        for joint, angle in enumerate(world.joints()):
            world.client.resetJointState(world.body, joint, angle, 3.0)
        assert world.drive(np.array([-0.1, 0, 0.2]), 20)[1][3] > 0
        world.place(np.array([-0.1, 0, 0.2]))
        world.set_joints(np.array([0, 0, 0, -3.06, 0, 1.5, 0.8]))
        assert world.drive(np.array([-0.1, 0, 0.2]), 1)[1][1:3] == [1, 0]
        world.place(np.array([-0.1, 0, 0.2]))
        world.set_joints(np.array([2.95, 0.4, 0, -1.85, 0, 2.26, 0.8]))
        assert world.drive(np.array([-0.1, 0, 0.2]), 1)[1][1:3] == [0, 1]
