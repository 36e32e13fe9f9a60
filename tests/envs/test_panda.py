"""The arm in MuJoCo keeps what its docstring promises; `test_arms` has the laws of both arms."""

import copy
import pickle

import numpy as np
import pytest
from episodes import equal, safe, toward
from hypothesis import given, settings
from hypothesis import strategies as st

from legibility import Scene
from legibility.envs.arm import ArmVector
from legibility.envs.panda import PandaBlockReach, PandaBlockReachVector
from legibility.envs.pandagym import JOINT_LIMITS
from legibility.errors import InvalidInputError, InvalidSceneError
from legibility.scene import DEFAULT_WORKSPACE

for extra in ("mujoco", "mink"):
    pytest.importorskip(extra, reason="the arm is NOT TESTED: pip install 'legibility[panda]'")

LOW, HIGH = np.array(DEFAULT_WORKSPACE[3])
SCENE = Scene([-0.2, -0.1, 0.3], [[0, 0.15, 0.02], [0, -0.1, 0.06]])

seeds = st.integers(0, 2**32 - 1)


def beyond(env):
    """The greatest distance of an arm from the workspace [m]."""
    return np.maximum(LOW - env.positions, env.positions - HIGH).max()


def counted(env):
    return {name: int(number.sum()) for name, number in env.counts.items()}


NOTHING = dict.fromkeys(ArmVector.counted, 0)


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
def test_copies_go_on_alike(copied):
    env = PandaBlockReachVector(2)
    env.reset(seed=1, options={"noise": 0.002, "push": 0.1})
    for _ in range(5):
        env.step(toward(env))
    other = copied(env)
    for _ in range(5):
        assert equal(env.step(toward(env)), other.step(toward(other)))


@pytest.mark.parametrize(("options", "message"), [
    ({"response": 0.05}, "response must be a number from 0.012 to 0.025"),
    ({"delay": -1}, "delay must be a number from 0 to 0.008, got -1"),
])  # fmt: skip
def test_bad_options(options, message):
    with pytest.raises(InvalidInputError, match=message):
        PandaBlockReach().reset(options=options)


@pytest.mark.parametrize("goal", [[0.3, 0, 0.1], [0, 0, -0.05], [-0.6, 0, 0.2]])
def test_goals_out_of_reach(goal):
    with pytest.raises(InvalidSceneError, match=r"goals\[1\] .* lies outside the workspace \[\["):
        Scene(SCENE.start, [[0, 0, 0.1], goal])


class TestArm:
    @settings(max_examples=5)
    @given(seeds, st.floats(0.2, 1))
    def test_safe_motions_are_safe(self, seed, ease):
        """Smooth commands, as wild as they may be, many toward walls and corners."""
        env = PandaBlockReachVector(8, max_episode_steps=1000)
        env.reset(seed=seed)
        rng = np.random.default_rng(seed)
        way = np.zeros((8, 3))
        for _ in range(50):
            way = (1 - 0.3 * ease) * way + 0.3 * ease * rng.normal(0, 0.03, (8, 3))
            env.done[:] = False
            observation, *_ = env.step(safe(env, np.clip(way, -0.01, 0.01)))
            assert observation in env.observation_space
            assert beyond(env) < 0.002
        assert counted(env) == NOTHING

    @settings(max_examples=4)
    @given(seeds)
    def test_whatever_is_commanded_limits_hold(self, seed):
        env = PandaBlockReachVector(8, max_episode_steps=1000)
        env.reset(seed=seed)
        rng = np.random.default_rng(seed)
        for _ in range(50):  # full speed one way, and the next moment another
            env.done[:] = False
            env.step(safe(env, rng.choice([-0.02, 0.02], (8, 3))))
            assert beyond(env) < 0.01
            angles = env.joint_angles
            assert ((angles > JOINT_LIMITS[0]) & (angles < JOINT_LIMITS[1])).all()
        assert counted(env) == NOTHING

    @settings(max_examples=10)
    @given(seeds, st.floats(0.001, 0.015), st.floats(0.012, 0.025), st.floats(0, 0.008))
    def test_most_of_a_command_is_realised_and_stopping_is_quick(self, seed, size, response, delay):
        rng = np.random.default_rng(seed)
        env = PandaBlockReachVector(8, max_episode_steps=1000)
        scenes = [Scene(rng.uniform(LOW + 0.07, HIGH - 0.07), [LOW, HIGH]) for _ in range(8)]
        env.reset(options={"scene": scenes, "response": response, "delay": delay})
        actions = rng.standard_normal((8, 3))
        actions *= size / np.abs(actions).max(axis=-1, keepdims=True)
        for _ in range(3):
            before = env.positions.copy()
            env.step(actions)
        moved = env.positions - before
        share = (moved * actions).sum(-1) / (actions**2).sum(-1)
        assert ((share > 0.5) & (share < 0.95)).all()
        before = env.positions.copy()
        for _ in range(5):
            env.step(np.zeros((8, 3)))
            coasted = np.linalg.norm(env.positions - before, axis=-1)
            lag = env.lag_range[1]
            assert (coasted < lag / (1 - lag) * np.linalg.norm(moved, axis=-1)).all()
        assert counted(env) == NOTHING

    def test_hidden_robots_differ(self):
        env = PandaBlockReachVector(64)
        env.reset(seed=0)
        for name, (low, high) in env.drawn.items():
            values = env.hidden[name]
            assert low <= values.min() < low + 0.1 * (high - low)
            assert high - 0.1 * (high - low) < values.max() <= high

    def test_what_is_counted(self):
        env = PandaBlockReachVector(3)
        env.reset(options={"scene": Scene([-0.1, 0, 0.2], SCENE.goals)})
        env._speeds[0] = 3
        env._angles[1] = env._reference[1] = env._command[1] = [2.95, 0.4, 0, -1.85, 0, 2.26, 0.8]
        env._angles[2] = env._reference[2] = env._command[2] = [0, 0.4, 0, -3.06, 0, 1.5, 0.8]
        env.step(np.zeros((3, 3)))
        assert env.counts["velocity_limit_violations"][0] > 0
        assert env.counts["joint_limit_violations"][1] > 0
        assert env.counts["self_collisions"][2] > 0
        env.reset(options={"reset_mask": np.array([True, False, False])})
        assert {name: int(n[0]) for name, n in env.counts.items()} == NOTHING
        assert env.counts["self_collisions"][2] > 0
