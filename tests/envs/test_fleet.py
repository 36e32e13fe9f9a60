"""One interface to every environment of ours: wrappers and vectors are right or refused by name."""

import gymnasium
import numpy as np
import pytest
from gymnasium import wrappers
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers import vector as vector_wrappers

import legibility as lg
from legibility.drivers import Feedback
from legibility.envs.block_reach_2d import BlockReach2DVector
from legibility.envs.fleet import Fleet, is_vector
from legibility.errors import InvalidInputError
from legibility.motion.path import Path, straight_waypoints
from legibility.obstacles import Box
from legibility.robots.arm import PANDA
from legibility.rollout import follow

pytestmark = pytest.mark.filterwarnings("ignore:.*precision lowered by casting")
NAME = "legibility/BlockReach2D-v0"
SCENE = lg.Scene([0, 0.5], [[0.8, 0.6], [1, 0.3]])


def make(**options):
    return gymnasium.make(NAME, **options)


def vector(size=3, mode="vector_entry_point", **options):
    return gymnasium.make_vec(NAME, num_envs=size, vectorization_mode=mode, **options)


def followed(env, **options):
    """The motions of all robots along straight lines."""
    fleet = Fleet(env, 0)
    paths = [
        Path.through(straight_waypoints(s.start, s.goals[t]), s, t, np.array(0.0), lg.Observer())
        for s, t in zip(fleet.scenes, fleet.targets, strict=True)
    ]
    return follow(fleet, paths, Feedback(), **options)


def moved(env, seed=5):
    """The same after a reset."""
    env.reset(seed=seed)
    return followed(env)


def check_same(rollouts, expected):
    for one, other in zip(rollouts, expected, strict=True):
        assert one.path.scene == other.path.scene
        assert (one.success, one.reason) == (other.success, other.reason)
        np.testing.assert_allclose(one.states, other.states, rtol=0, atol=1e-12)
        np.testing.assert_allclose(one.actions, other.actions, rtol=0, atol=1e-12)


def plain(env):
    return env


def flat(env):
    """An environment whose observation is one array."""
    module = vector_wrappers if is_vector(env) else wrappers
    return module.FlattenObservation(env)


def short(env):
    """A few steps of an environment, as drawing takes its time."""
    return wrappers.TimeLimit(env, 4)


def picture(env):
    """The same with a picture as its observation."""
    return wrappers.AddRenderObservation(short(env))


def arrays():
    import torch

    return {"env_xp": np, "target_xp": torch}


def fixed(value):
    return lambda _: value


def halved(action):
    return action / 2


RIGHT = {
    "DelayObservation": (plain, {"delay": 2}),
    "DtypeObservation": (flat, {"dtype": np.float32}),
    "DiscretizeObservation": (flat, {"bins": 3}),
    "FilterObservation": (plain, {"filter_keys": ["goals"]}),
    "FlattenObservation": (plain, {}),
    "FrameStackObservation": (plain, {"stack_size": 2}),
    "GrayscaleObservation": (picture, {}),
    "TransformObservation": (plain, {"func": fixed(None), "observation_space": None}),
    "NormalizeObservation": (flat, {}),
    "AddRenderObservation": (short, {}),
    "ResizeObservation": (picture, {"shape": (8, 8)}),
    "ReshapeObservation": (flat, {"shape": (26, 1)}),
    "RescaleObservation": (flat, {"min_obs": np.float64(0), "max_obs": np.float64(1)}),
    "TimeAwareObservation": (plain, {}),
    "ClipAction": (plain, {}),
    "ClipReward": (plain, {"max_reward": -0.5}),
    "TransformReward": (plain, {"func": fixed("good")}),
    "NormalizeReward": (plain, {}),
    "TimeLimit": (plain, {"max_episode_steps": 399}),
    "Autoreset": (plain, {}),
    "PassiveEnvChecker": (plain, {}),
    "OrderEnforcing": (plain, {}),
    "RecordEpisodeStatistics": (plain, {}),
    "AddWhiteNoise": (picture, {"probability_of_noise_per_pixel": 0.1}),
    "ObstructView": (picture, {"obstructed_pixels_ratio": 0.1, "obstruction_width": 4}),
    "RenderCollection": (short, {}),
    "RecordVideo": (short, {"video_folder": "videos"}),
    "HumanRendering": (short, {}),
    "ArrayConversion": (plain, arrays),
    "NumpyToTorch": (plain, {}),
}
REFUSED = {
    "MaxAndSkipObservation": (flat, {"skip": 2}),
    "DiscretizeAction": (plain, {"bins": 3}),
    "TransformAction": (plain, {"func": halved, "action_space": None}),
    "RescaleAction": (plain, {"min_action": np.float64(-1), "max_action": np.float64(1)}),
    "StickyAction": (plain, {"repeat_action_probability": 0.9}),
    "RepeatAction": (plain, {"num_repeats": 2}),
}
ELSEWHERE = {"vector", "AtariPreprocessing"}  # a module; for games of an Atari alone
VECTOR_RIGHT = {
    "VectorizeTransformObservation": (
        plain,
        {"wrapper": wrappers.TransformObservation, "func": dict, "observation_space": None},
    ),
    "VectorizeTransformReward": (plain, {"wrapper": wrappers.TransformReward, "func": fixed(1.0)}),
    "DictInfoToList": (plain, {}),
    "TransformObservation": (plain, {"func": fixed(None)}),
    "FilterObservation": (plain, {"filter_keys": ["position"]}),
    "FlattenObservation": (plain, {}),
    "ReshapeObservation": (flat, {"shape": (26, 1)}),
    "RescaleObservation": (flat, {"min_obs": np.float64(0), "max_obs": np.float64(1)}),
    "DtypeObservation": (flat, {"dtype": np.float32}),
    "NormalizeObservation": (flat, {}),
    "ClipAction": (plain, {}),
    "TransformReward": (plain, {"func": fixed("good")}),
    "ClipReward": (plain, {"max_reward": -0.5}),
    "NormalizeReward": (plain, {}),
    "RecordEpisodeStatistics": (plain, {}),
    "RecordVideo": (plain, {"video_folder": "videos"}),
    "HumanRendering": (plain, {}),
    "ArrayConversion": (plain, arrays),
    "NumpyToTorch": (plain, {}),
}
VECTOR_REFUSED = {
    "VectorizeTransformAction": (
        plain,
        {"wrapper": wrappers.TransformAction, "func": halved, "action_space": None},
    ),
    "TransformAction": (plain, {"func": halved}),
    "RescaleAction": (plain, {"min_action": np.float64(-1), "max_action": np.float64(1)}),
}
VECTOR_ELSEWHERE = {"GrayscaleObservation", "ResizeObservation"}  # no vector observes pictures
EITHER = {"JaxToNumpy", "JaxToTorch"}  # made for environments in JAX
NEEDS = {
    "HumanRendering": "pygame", "RecordVideo": "moviepy", "ResizeObservation": "cv2",
    "JaxToNumpy": "jax", "JaxToTorch": "jax", "NumpyToTorch": "array_api_compat",
    "ArrayConversion": "array_api_compat",
}  # fmt: skip
"""Packages that Gymnasium asks for."""


def wrapped(env, module, name, prepare=plain, options=()):
    """`env` in a wrapper; skipped where a package is missing."""
    if name in NEEDS:
        pytest.importorskip(NEEDS[name], reason=f"{name} needs {NEEDS[name]}")
    options = options() if callable(options) else dict(options)
    return getattr(module, name)(prepare(env), **options)


def of(module, names):
    """Those names that this version of Gymnasium has."""
    return sorted(set(names) & set(module.__all__))


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """Where videos may go; windows open nowhere."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")


@pytest.fixture(scope="module")
def rollouts():
    """As many robots as there are, each alone, in no wrapper but those of `gymnasium.make`."""
    return [moved(make(), seed) for seed in (5, 6, 7)]


class TestWrappers:
    def test_all_are_known(self):
        assert set(wrappers.__all__) <= {*RIGHT, *REFUSED, *EITHER, *ELSEWHERE}

    @pytest.mark.parametrize("name", of(wrappers, RIGHT))
    def test_right(self, name, rollouts):
        prepare, options = RIGHT[name]
        env = wrapped(make(render_mode="rgb_array"), wrappers, name, prepare, options)
        expected = rollouts[0]
        if prepare in (short, picture):
            expected = moved(short(make()))
            assert expected[0].reason == "time"
        check_same(moved(env), expected)

    @pytest.mark.parametrize("name", of(wrappers, REFUSED))
    def test_refused(self, name):
        env = wrapped(make(), wrappers, name, *REFUSED[name])
        with pytest.raises(InvalidInputError, match=name):
            moved(env)

    @pytest.mark.parametrize("name", of(wrappers, EITHER))
    def test_right_or_refused(self, name, rollouts):
        env = wrapped(make(), wrappers, name)
        try:
            check_same(moved(env), rollouts[0])
        except InvalidInputError as error:
            assert name in str(error)  # noqa: PT017

    def test_an_action_wrapper_that_changes_nothing_is_right(self, rollouts):
        env = wrappers.RescaleAction(make(), -0.05, 0.05)
        check_same(moved(wrappers.StickyAction(env, 0.0)), rollouts[0])

    def test_the_innermost_is_named_as_well(self):
        env = wrappers.RecordEpisodeStatistics(wrappers.RescaleAction(make(), -1.0, 1.0))
        with pytest.raises(InvalidInputError, match="RecordEpisodeStatistics<RescaleAction"):
            moved(env)

    def test_a_wrapper_that_fails_is_named(self):
        class Broken(gymnasium.Wrapper):
            def step(self, action):
                raise KeyError("speed")

        with pytest.raises(InvalidInputError, match=r"KeyError\('speed'\).*Broken"):
            moved(Broken(make()))

    def test_a_wrapper_that_delays_actions(self):
        class Late(gymnasium.ActionWrapper):
            last = np.zeros(2)

            def action(self, action):
                action, self.last = self.last, action
                return action

        with pytest.raises(InvalidInputError, match="delay or repeat actions: <Late"):
            moved(Late(make()))


@pytest.mark.parametrize("mode", ["vector_entry_point", "sync"])
class TestVectorWrappers:
    def test_all_are_known(self, mode):
        known = {*VECTOR_RIGHT, *VECTOR_REFUSED, *EITHER, *VECTOR_ELSEWHERE}
        assert set(vector_wrappers.__all__) <= known

    @pytest.mark.parametrize("name", of(vector_wrappers, VECTOR_RIGHT))
    def test_right(self, mode, name, rollouts):
        if (mode, name) == ("vector_entry_point", "NormalizeObservation"):
            pytest.skip("Gymnasium itself refuses a vector that does not reset itself")
        env = vector(3, mode, render_mode="rgb_array")
        env = wrapped(env, vector_wrappers, name, *VECTOR_RIGHT[name])
        check_same(moved(env), [r for (r,) in rollouts])

    @pytest.mark.parametrize("name", of(vector_wrappers, VECTOR_REFUSED))
    def test_refused(self, mode, name):
        env = wrapped(vector(3, mode), vector_wrappers, name, *VECTOR_REFUSED[name])
        with pytest.raises(InvalidInputError, match=name):
            moved(env)

    @pytest.mark.parametrize("name", of(vector_wrappers, EITHER))
    def test_right_or_refused(self, mode, name, rollouts):
        env = wrapped(vector(3, mode), vector_wrappers, name)
        try:
            check_same(moved(env), [r for (r,) in rollouts])
        except InvalidInputError as error:
            assert name in str(error)  # noqa: PT017


class TestVectors:
    @pytest.mark.parametrize("size", [1, 2])
    @pytest.mark.parametrize("mode", ["vector_entry_point", "sync"])
    def test_right(self, mode, size, rollouts):
        env = vector(size, mode)
        assert is_vector(env)
        check_same(moved(env), [r for (r,) in rollouts[:size]])

    def test_motions_of_several_lengths_end_in_their_own_last_states(self, rollouts):
        """An environment that resets itself meanwhile changes nothing."""
        lengths = [len(r.states) for (r,) in rollouts]
        assert len(set(lengths)) == 3
        again = moved(vector(3, "sync"))
        assert [len(r.states) for r in again] == lengths
        for rollout in again:
            assert rollout.reason == "reached"
            goal = rollout.path.scene.goals[rollout.path.target]
            assert np.linalg.norm(rollout.states[-1] - goal) <= 0.02

    @pytest.mark.parametrize("mode", [AutoresetMode.SAME_STEP, AutoresetMode.DISABLED])
    def test_other_ways_to_reset_are_refused(self, mode):
        env = vector(2, "sync", vector_kwargs={"autoreset_mode": mode})
        with pytest.raises(InvalidInputError, match=f"got {mode}"):
            moved(env)

    def test_wrappers_of_its_environments_are_named(self):
        env = vector(2, "sync", wrappers=(lambda e: wrappers.RepeatAction(e, 2),))
        with pytest.raises(InvalidInputError, match="RepeatAction"):
            moved(env)

    def test_an_asynchronous_one_is_refused(self):
        env = vector(2, "async")
        try:
            with pytest.raises(InvalidInputError, match="got AsyncVectorEnv"):
                Fleet(env, 0)
        finally:
            env.close()

    def test_several_environments_in_one_are_refused(self):
        pytest.importorskip("mujoco", reason="the extra named panda is not installed")
        pytest.importorskip("panda_gym", reason="the extra named pandagym is not installed")
        names = ["PandaBlockReach", "PandaGymBlockReach"]
        envs = [lambda name=name: gymnasium.make(f"legibility/{name}-v0") for name in names]
        env = gymnasium.vector.SyncVectorEnv(envs, observation_mode="different")
        with pytest.raises(InvalidInputError, match="vector of one environment"):
            Fleet(env, 0)
        env.close()


class TestReset:
    @pytest.mark.parametrize("new", [make, lambda: vector(2), lambda: vector(2, "sync")])
    def test_never_reset_is_reset(self, new):
        fleet, env = Fleet(new(), 7), new()
        env.reset(seed=7)
        assert fleet.scenes == Fleet(env, 0).scenes

    @pytest.mark.parametrize("new", [make, lambda: vector(2), lambda: vector(2, "sync")])
    def test_an_episode_that_ended(self, new):
        env = new()
        moved(env)
        with pytest.raises(InvalidInputError, match="reset the environment before executing"):
            Fleet(env, 0)
        moved(env)  # which resets it

    @pytest.mark.parametrize("mode", [None, "vector_entry_point", "sync"])
    def test_an_episode_that_ran_out_of_time(self, mode):
        if mode == "sync":
            env = vector(2, mode, wrappers=(short,))
        else:
            env = short(make()) if mode is None else BlockReach2DVector(2, max_episode_steps=4)
        assert [(r.reason, len(r.actions)) for r in moved(env)] == [("time", 4)] * len(moved(env))
        for _ in range(2):  # it stays ended, however often it is stepped
            with pytest.raises(InvalidInputError, match="reset the environment before executing"):
                Fleet(env, 0)
            if mode == "sync":
                return  # a step resets it
            env.step(np.zeros(env.action_space.shape))

    def test_limits_on_time_of_their_own(self):
        limits = iter([10, 1000])
        env = vector(2, "sync", wrappers=(lambda e: wrappers.TimeLimit(e, next(limits)),))
        env.reset(seed=0, options={"scene": SCENE})
        for _ in range(9):
            env.step(np.zeros((2, 2)))
        assert [r.reason for r in followed(env)] == ["time", "reached"]

    def test_goes_on_in_the_middle_of_an_episode(self):
        env = make()
        env.reset(seed=3, options={"scene": SCENE})
        env.step(np.array([0.02, 0.0]))
        fleet = Fleet(env, 0)
        assert fleet.positions[0, 0] > 0
        assert followed(env)[0].success

    def test_a_closed_environment(self):
        env = make()
        env.reset(seed=0)
        fleet = Fleet(env, 0)
        env.close()
        with pytest.raises(InvalidInputError, match="closed"):
            fleet.step(np.zeros((1, 2)), np.ones(1, dtype=bool))

    def test_wrappers_that_were_not_reset_are_named(self):
        env = wrappers.RecordEpisodeStatistics(make())
        env.unwrapped.reset(seed=0)
        with pytest.raises(InvalidInputError, match="RecordEpisodeStatistics"):
            followed(env)


class TestState:
    def test_of_each_robot(self):
        env = BlockReach2DVector(3)
        env.reset(seed=0, options={"target": [0, 1, 0]})
        fleet = Fleet(env, 0)
        assert fleet.size == 3
        assert fleet.scenes == env.scenes
        np.testing.assert_array_equal(fleet.targets, [0, 1, 0])
        for goal, scene, target in zip(fleet.goals, env.scenes, [0, 1, 0], strict=True):
            np.testing.assert_array_equal(goal, scene.goals[target])
        np.testing.assert_array_equal(fleet.positions, env.positions)
        assert fleet.joint_angles.shape == (3, 0)
        assert not fleet.wall_contacts.any()
        assert fleet.step_seconds == pytest.approx(0.05)
        assert (fleet.limit, fleet.counts) == (0.05, {})

    def test_targets(self):
        env = vector(3)
        env.reset(seed=0)
        fleet = Fleet(env, 0)
        fleet.set_targets(np.array([0, 1, 1]))
        np.testing.assert_array_equal(fleet.targets, [0, 1, 1])
        with pytest.raises(InvalidInputError, match="target"):
            fleet.set_targets(np.array([1, 0, 99]))
        np.testing.assert_array_equal(fleet.targets, [0, 1, 1])

    @pytest.mark.parametrize("mode", ["vector_entry_point", "sync"])
    def test_contacts_and_safe_actions_of_each_robot(self, mode):
        solid = Box([0.1, 0.5], [0.1, 0.2])
        rooms = lg.Scene(SCENE.start, SCENE.goals, obstacles=[solid]), SCENE
        env = vector(2, mode)
        if mode == "sync":
            for one, scene in zip(env.envs, rooms, strict=True):
                one.reset(seed=0, options={"scene": scene})
        else:
            env.reset(seed=0, options={"scene": rooms})
        fleet, right = Fleet(env, 0), np.full((2, 2), [0.05, 0.0])
        positions = np.full((2, 2), [0.03, 0.5])
        sent = fleet.safe(right, positions, 0 * positions)
        assert sent[0] == pytest.approx([0.02, 0], abs=2e-6)
        assert sent[1].tolist() == [0.05, 0]
        contacts = []
        for _ in range(3):
            fleet.step(right, np.ones(2, dtype=bool))
            contacts.append(fleet.contacts.tolist())
        assert contacts[0] == [False, False]
        assert contacts[-1] == [True, False]
        assert fleet.arms == [None, None]

    @pytest.mark.parametrize("mode", ["vector_entry_point", "sync"])
    def test_whole_arms(self, mode):
        for extra in ("mujoco", "mink"):
            pytest.importorskip(extra, reason="the extra named panda is not installed")
        env = gymnasium.make_vec(
            "legibility/PandaBlockReach-v0", num_envs=2, vectorization_mode=mode
        )
        env.reset(seed=0)
        assert Fleet(env, 0).arms == [PANDA, PANDA]
        env.close()

    @pytest.mark.parametrize("env", [None, 5, "2d", BlockReach2DVector])
    def test_other_things_are_refused(self, env):
        with pytest.raises(InvalidInputError, match="must be an environment of legibility"):
            Fleet(env, 0)

    def test_other_environments_are_refused(self):
        for env in (gymnasium.make("CartPole-v1"), gymnasium.make_vec("CartPole-v1", num_envs=2)):
            with pytest.raises(InvalidInputError, match="must be an environment of legibility"):
                Fleet(env, 0)
