"""The arm in MuJoCo keeps what its docstring promises."""

import copy
import pickle

import gymnasium
import numpy as np
import pytest
from episodes import FakeWindow, equal, played, row, safe, toward
from gymnasium.utils.env_checker import check_env
from hypothesis import given, settings
from hypothesis import strategies as st

from legibility import Scene
from legibility.envs.arm import JOINT_LIMITS, ArmVector
from legibility.envs.panda import PandaBlockReach, PandaBlockReachVector
from legibility.errors import InvalidInputError, InvalidSceneError
from legibility.scene import DEFAULT_WORKSPACE

for extra in ("mujoco", "mink"):
    pytest.importorskip(extra, reason="the arm is NOT TESTED: pip install 'legibility[panda]'")

ID = "legibility/PandaBlockReach-v0"
LOW, HIGH = np.array(DEFAULT_WORKSPACE[3])
SCENE = Scene([-0.2, -0.1, 0.3], [[0, 0.15, 0.02], [0, -0.1, 0.06]])

seeds = st.integers(0, 2**32 - 1)
rough = st.fixed_dictionaries(
    {},
    optional={
        "noise": st.floats(0, 0.01),
        "push": st.floats(0, 0.2),
        "shift": st.floats(0, 0.2),
        "num_goals": st.integers(2, 6),
        "response": st.floats(0.012, 0.025),
        "delay": st.floats(0, 0.008),
    },
)


def beyond(env):
    """How far out of the workspace the arms are at most [m]."""
    return np.maximum(LOW - env.positions, env.positions - HIGH).max()


def counted(env):
    return {name: int(number.sum()) for name, number in env.counts.items()}


NOTHING = dict.fromkeys(ArmVector.counted, 0)


@pytest.fixture
def plain(monkeypatch):
    """Pictures cost nothing."""
    image = np.zeros((480, 480, 3), dtype=np.uint8)
    monkeypatch.setattr(PandaBlockReachVector, "_picture", lambda self, index: image)
    monkeypatch.setattr("legibility.envs.render.Window", FakeWindow)


class TestGymnasium:
    @pytest.mark.filterwarnings("error")
    def test_check_env(self, plain):
        check_env(gymnasium.make(ID).unwrapped)
        check_env(gymnasium.make(ID, max_goals=3, render_mode="rgb_array").unwrapped)

    @pytest.mark.filterwarnings("error")
    def test_make_vec(self):
        env = gymnasium.make_vec(ID, num_envs=3)
        assert isinstance(env, PandaBlockReachVector)
        observation, _ = env.reset(seed=3)
        assert observation in env.observation_space
        for _ in range(3):
            observation, *rest, info = env.step(env.action_space.sample())
            assert observation in env.observation_space
            assert [x.shape for x in (*rest, info["distance"])] == [(3,)] * 4
        env.close()
        with pytest.raises(InvalidInputError, match="the environment is closed"):
            env.reset()

    def test_interface_of_an_arm(self):
        env = PandaBlockReach()
        assert env.action_space == gymnasium.spaces.Box(-0.02, 0.02, (3,), np.float64)
        shapes = {name: space.shape for name, space in env.observation_space.items()}
        assert shapes == {"position": (3,), "goals": (6, 3), "present": (6,), "target": ()}
        _, info = env.reset(seed=0)
        assert set(info) == {
            "is_success", "distance", "speed", "wall_contact", "disturbed", *ArmVector.counted,
        }  # fmt: skip

    @pytest.mark.parametrize("copied", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
    def test_copies_go_on_alike(self, copied):
        env = PandaBlockReachVector(2)
        env.reset(seed=1, options={"noise": 0.002, "push": 0.1})
        for _ in range(5):
            env.step(toward(env))
        other = copied(env)
        for _ in range(5):
            assert equal(env.step(toward(env)), other.step(toward(other)))


class TestEpisodes:
    @settings(max_examples=5)
    @given(seeds, seeds, rough)
    def test_same_seed_same_bits_whatever_was_before(self, seed, other, options):
        env = PandaBlockReachVector(2)
        first = played(env, seed, options=options)
        played(env, other)
        assert equal(first, played(env, seed, options=options))
        assert equal(first, played(PandaBlockReachVector(2), seed, options=options))

    @settings(max_examples=5)
    @given(seeds, rough)
    def test_a_vector_is_so_many_single_ones(self, seed, options):
        many = PandaBlockReachVector(5, max_episode_steps=18)
        results = [many.reset(seed=seed, options=options)]
        plan = []
        for _ in range(15):
            plan.append(toward(many))
            results.append(many.step(plan[-1]))
        for i in (0, 4):
            one = PandaBlockReach()
            assert equal(one.reset(seed=seed + i, options=options), row(results[0], i))
            for actions, result in zip(plan, results[1:], strict=True):
                assert equal(one.step(actions[i]), row(result, i))

    def test_what_has_ended_stands_still(self):
        env = PandaBlockReachVector(2, max_episode_steps=30)
        near = Scene([0, 0.15, 0.03], SCENE.goals)
        env.reset(seed=0, options={"scene": [near, SCENE]})
        env.step(np.zeros((2, 3)))
        assert env.done.tolist() == [True, False]
        before, angles = env.positions.copy(), env.joint_angles
        env.step(np.full((2, 3), 0.01))
        assert np.array_equal(env.positions[0], before[0])
        assert np.array_equal(env.joint_angles[0], angles[0])
        assert (env.positions[1] != before[1]).all()

    def test_success(self):
        env = PandaBlockReachVector(6)
        env.reset(seed=1, options={"scene": SCENE, "target": [0, 1] * 3})
        for _ in range(80):
            env.step(toward(env))
        assert env.success.all()
        assert counted(env) == NOTHING

    @pytest.mark.parametrize(("options", "error", "message"), [
        ({"gain": 0.7}, InvalidInputError, "response, delay; unknown"),
        ({"response": 0.05}, InvalidInputError, "response must be a number from 0.012 to 0.025"),
        ({"delay": -1}, InvalidInputError, "delay must be a number from 0 to 0.008, got -1"),
        ({"scene": Scene([0, 0.5], [[0.8, 0.6], [1, 0.3]])}, InvalidSceneError,
         "must be 3-D here, got 2-D"),
        ({"scene": Scene([0, 0, 0.2], [[0, 0, 0.1], [0, 0.1, 0.1]], [[-1] * 3, [1] * 3])},
         InvalidSceneError, r"workspace must be \[\[-0.3, -0.3, 0.02\].*got \[\[-1.0"),
    ])  # fmt: skip
    def test_bad_options(self, options, error, message):
        with pytest.raises(error, match=message):
            PandaBlockReach().reset(options=options)

    @pytest.mark.parametrize("goal", [[0.3, 0, 0.1], [0, 0, -0.05], [-0.6, 0, 0.2]])
    def test_goals_out_of_reach(self, goal):
        with pytest.raises(
            InvalidSceneError, match=r"goals\[1\] .* lies outside the workspace \[\["
        ):
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
        for values, (low, high) in (
            (env.responses, env.response_range), (env.delays, env.delay_range),
        ):  # fmt: skip
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
