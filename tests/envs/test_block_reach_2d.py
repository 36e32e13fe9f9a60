"""The environment does what its docstring says, one at a time and many at once."""

import copy
import itertools
import pickle
import warnings

import gymnasium
import numpy as np
import pytest
from episodes import equal, row
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode
from hypothesis import assume, example, given
from hypothesis import strategies as st

from legibility import Scene
from legibility.envs.block_reach_2d import BlockReach2D, BlockReach2DVector
from legibility.errors import InvalidInputError, InvalidSceneError
from legibility.obstacles import Ball, Box
from legibility.scene import DEFAULT_WORKSPACE

ID = "legibility/BlockReach2D-v0"
LOW, HIGH = np.array(DEFAULT_WORKSPACE[2])
SCENE = Scene([0, 0.5], [[0.8, 0.6], [1, 0.3]])
EXACT = {"gain": 1.0, "lag": 0.0}

seeds = st.integers(0, 2**32 - 1)
rough = st.fixed_dictionaries(
    {},
    optional={
        "noise": st.floats(0, 0.02),
        "push": st.floats(0, 0.3),
        "shift": st.floats(0, 0.3),
        "num_goals": st.integers(2, 6),
        "target": st.integers(0, 1),
        "gain": st.floats(0, 1),
        "lag": st.floats(0, 0.3),
    },
)


def toward(env, gain=0.5):
    """Actions that go to the targets and overshoot now and then."""
    targets = np.stack([s.goals[t] for s, t in zip(env.scenes, env.targets, strict=True)])
    return gain * (targets - env.positions)


def vector(num_envs=1, options=None, seed=0, **arguments):
    env = BlockReach2DVector(num_envs, **arguments)
    env.reset(seed=seed, options=options)
    return env


class FakeWindow:
    shown = 0
    closed = 0

    def __init__(self, image, interval):
        assert interval == pytest.approx(0.05)

    def show(self, image):
        assert image.ndim == 3
        FakeWindow.shown += 1

    def close(self):
        FakeWindow.closed += 1


@pytest.fixture
def window(monkeypatch):
    monkeypatch.setattr("legibility.envs.render.Window", FakeWindow)
    monkeypatch.setattr(FakeWindow, "shown", 0)
    monkeypatch.setattr(FakeWindow, "closed", 0)
    return FakeWindow


class TestGymnasium:
    @pytest.mark.filterwarnings("error")
    def test_check_env(self, window):
        check_env(gymnasium.make(ID).unwrapped)
        check_env(gymnasium.make(ID, max_goals=3, render_mode="rgb_array").unwrapped)
        assert window.shown == 4  # a reset and a rendering each

    @pytest.mark.filterwarnings("error")
    def test_make_warns_of_nothing(self):
        with gymnasium.make(ID) as env:
            assert isinstance(env.unwrapped, BlockReach2D)
            env.action_space.seed(0)
            for seed in range(3):
                env.reset(seed=seed)
                for _ in range(5):
                    observation, reward, terminated, truncated, info = env.step(
                        env.action_space.sample()
                    )
                    assert observation in env.observation_space
                    assert [type(x) for x in (reward, terminated, truncated)] == [float, bool, bool]
                    assert {type(x) for x in info.values()} == {float, bool}

    @pytest.mark.filterwarnings("error")
    @pytest.mark.parametrize("mode", ["vector_entry_point", "sync", None])
    def test_make_vec(self, mode):
        env = gymnasium.make_vec(ID, num_envs=8, vectorization_mode=mode)
        observation, _ = env.reset(seed=3)
        assert observation in env.observation_space
        for _ in range(3):
            observation, *rest, info = env.step(env.action_space.sample())
            assert observation in env.observation_space
            assert [x.shape for x in (*rest, info["distance"])] == [(8,)] * 4
        env.close()
        env.close()
        if mode != "sync":
            assert isinstance(env, BlockReach2DVector)
            assert env.max_episode_steps == 400
            assert env.metadata["autoreset_mode"] is AutoresetMode.DISABLED

    def test_vector_and_synchronous_vector_agree(self):
        ours = gymnasium.make_vec(ID, num_envs=3)
        theirs = gymnasium.make_vec(ID, num_envs=3, vectorization_mode="sync")
        options = {"noise": 0.01, "push": 0.1}
        assert equal(
            ours.reset(seed=4, options=options)[0], theirs.reset(seed=4, options=options)[0]
        )
        while not ours.done.any():  # then they differ: theirs are reset by the next step
            actions = toward(ours)
            first, second = ours.step(actions), theirs.step(actions)
            assert equal(first[:4], second[:4])
            assert all(np.array_equal(first[4][name], second[4][name]) for name in first[4])

    @pytest.mark.parametrize("mode", ["human", "ansi", "rgb", ["rgb_array"]])
    def test_render_modes_that_are_not_there(self, mode):
        with pytest.raises(InvalidInputError, match="render_mode must be one of"):
            BlockReach2DVector(2, render_mode=mode)
        if mode != "human":
            with pytest.raises(InvalidInputError, match="render_mode must be one of"):
                BlockReach2D(render_mode=mode)

    def test_human_mode_shows_every_step(self, window):
        env = gymnasium.make(ID, render_mode="human")
        env.reset(seed=0)
        for shown in range(1, 4):
            assert window.shown == shown
            env.step(np.zeros(2))
        assert env.render() is None
        env.close()
        env.close()
        assert window.closed == 1

    def test_pictures(self):
        with gymnasium.make(ID, render_mode="rgb_array") as env:
            env.reset(seed=0)
            before = env.render()
            assert before.dtype == np.uint8
            assert before.shape == (480, 480, 3)
            env.step(np.array([0.05, 0.05]))
            assert (env.render() != before).any()
        env = gymnasium.make_vec(ID, num_envs=3, render_mode="rgb_array")
        env.reset(seed=0)
        pictures = env.render()
        assert np.array_equal(pictures[0], before)
        assert len(pictures) == 3
        assert (pictures[1] != pictures[2]).any()
        assert vector(2).render() is None

    def test_lists_of_pictures(self):
        with gymnasium.make(ID, render_mode="rgb_array_list") as env:
            env.reset(seed=0)
            env.step(np.zeros(2))
            assert len(env.render()) == 2

    @pytest.mark.parametrize("copied", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
    def test_copies_go_on_alike(self, copied):
        for env, actions in (
            (gymnasium.make(ID), np.array([0.03, -0.01])),
            (BlockReach2DVector(3), np.full((3, 2), 0.02)),
        ):
            env.reset(seed=1, options={"noise": 0.01, "push": 0.1, "shift": 0.1})
            env.step(actions)
            other = copied(env)
            for _ in range(30):
                assert equal(env.step(actions), other.step(actions))
            assert equal(env.reset(), other.reset())


BAD = {
    "unknown": ({"nose": 0.1}, r"options of reset are scene, .*; unknown: \['nose'\]"),
    "not a scene": ({"scene": SCENE.to_dict()}, "must be a legibility.Scene, got dict"),
    "3-D": (
        {"scene": Scene([0, 0, 0.1], [[0, 0.1, 0.1], [0, 0.2, 0.1]])},
        "2-D with .* here, got 3-D",
    ),
    "workspace": (
        {"scene": Scene([0, 0], [[0.5, 0], [1, 1]], [[-1, -1], [1, 1]])},
        r"workspace must be \[\[-0.1, -0.1\], \[1.1, 1.1\]\], got \[\[-1.0",
    ),
    "7 goals": (
        {"scene": Scene([0, 0], [[0.1 * i, 0.5] for i in range(7)])},
        "at most 6 goals here, got .* with 7",
    ),
    "many goals": ({"num_goals": 7}, "num_goals must be at most 6, got 7"),
    "one goal": ({"num_goals": 1}, "num_goals must be an integer of at least 2, got 1"),
    "half goals": ({"num_goals": 2.5}, "num_goals must be an integer of at least 2, got 2.5"),
    "no such target": ({"scene": SCENE, "target": 2}, "index from 0 to 1, got 2"),
    "target drawn": ({"num_goals": 3, "target": 3}, "index from 0 to 2, got 3"),
    "negative target": ({"target": -1}, "got -1"),
    "named target": ({"target": "red"}, "target must be an integer, got 'red'"),
    "gain": ({"gain": 1.1}, "gain must be a number from 0 to 1, got 1.1"),
    "gain NaN": ({"gain": np.nan}, "gain must be finite, got nan"),
    "lag": ({"lag": 0.31}, "lag must be a number from 0 to 0.3, got 0.31"),
    "noise": ({"noise": -0.1}, "noise must be a number from 0 to 0.05, got -0.1"),
    "push": ({"push": -1}, "push must be a number of at least 0, got -1"),
    "shift": ({"shift": np.inf}, "shift must be finite, got inf"),
    "no push": ({"push": None}, "push must be an array of numbers, got None"),
    "not a mapping": ([("push", 0.1)], "options must be a mapping, got list"),
}


class TestReset:
    @given(seeds, rough)
    def test_same_seed_same_episode(self, seed, options):
        envs = [BlockReach2DVector(2), BlockReach2DVector(2)]
        envs[1].reset(seed=0)
        for _ in range(20):
            envs[1].step(toward(envs[1]))
        assert equal(*(env.reset(seed=seed, options=options) for env in envs))
        for _ in range(25):
            actions = toward(envs[0])
            assert equal(*(env.step(actions) for env in envs))
        assert equal(*(env.reset(options=options) for env in envs))

    @given(seeds, rough)
    def test_a_vector_is_so_many_single_ones(self, seed, options):
        many = BlockReach2DVector(3, max_episode_steps=60)
        results = [many.reset(seed=seed, options=options)]
        plan = []
        for _ in range(50):
            plan.append(toward(many))
            results.append(many.step(plan[-1]))
        for i in range(3):
            one = BlockReach2D()
            assert equal(one.reset(seed=seed + i, options=options), row(results[0], i))
            for actions, result in zip(plan, results[1:], strict=True):
                assert equal(one.step(actions[i]), row(result, i))

    @given(seeds, st.lists(st.booleans(), min_size=3, max_size=3), st.none() | seeds)
    def test_mask_resets_only_what_it_names(self, seed, mask, again):
        env = vector(3, {"noise": 0.01, "push": 0.2}, seed)
        for _ in range(5):
            env.step(toward(env))
        other = copy.deepcopy(env)
        before = copy.deepcopy(env._observation())
        observation, info = env.reset(seed=again, options={"reset_mask": np.array(mask)})
        stepped, untouched = env.step(np.zeros((3, 2))), other.step(np.zeros((3, 2)))
        for i, reset in enumerate(mask):
            if reset:
                assert observation["position"][i].tolist() == env.scenes[i].start.tolist()
                assert info["speed"][i] == 0
                assert not equal(row(observation, i), row(before, i))
                if again is not None:
                    assert equal(row(observation, i), BlockReach2D().reset(seed=again + i)[0])
            else:
                assert equal(row(observation, i), row(before, i))
                assert equal(row(stepped, i), row(untouched, i))

    def test_masks_that_do_not_fit(self):
        with pytest.raises(InvalidInputError, match="must select all in the first reset"):
            BlockReach2DVector(2).reset(options={"reset_mask": np.array([True, False])})
        env = vector(2)
        for mask in ([True], [0, 1], np.ones((2, 1), dtype=bool), "ab", 1):
            with pytest.raises(InvalidInputError, match="reset_mask must be 2 booleans"):
                env.reset(options={"reset_mask": mask})

    @pytest.mark.parametrize("wrap", [list, tuple, np.array])
    def test_seeds_as_a_list(self, wrap):
        first, second = BlockReach2DVector(3), BlockReach2DVector(3)
        assert equal(first.reset(seed=5), second.reset(seed=wrap([5, 6, 7])))
        assert equal(first.reset(seed=np.int64(5)), second.reset(seed=5))
        assert equal(BlockReach2D().reset(seed=np.int64(5)), BlockReach2D().reset(seed=5))

    def test_none_among_seeds_goes_on(self):
        first, second = vector(2, seed=5), vector(2, seed=5)
        expected = first.reset()
        found = second.reset(seed=[9, None])
        assert not equal(row(found, 0), row(expected, 0))
        assert equal(row(found, 1), row(expected, 1))

    @pytest.mark.parametrize("seed", [-1, 2**63, 1.5, "7", True, [1], [1, -1], ["a", "b"]])
    def test_seeds_that_are_none(self, seed):
        with pytest.raises(InvalidInputError, match="seed must be"):
            BlockReach2DVector(2).reset(seed=seed)
        with pytest.raises(InvalidInputError, match="seed must be"):
            BlockReach2D().reset(seed=seed)

    def test_options_choose_the_episode(self):
        env = BlockReach2D()
        observation, info = env.reset(seed=0, options={"scene": SCENE, "target": 1})
        assert observation["position"].tolist() == SCENE.start.tolist()
        assert observation["goals"].tolist() == [*SCENE.goals.tolist(), *[[0, 0]] * 4]
        assert observation["present"].tolist() == [1, 1, 0, 0, 0, 0]
        assert observation["target"] == 1
        assert info == {
            "is_success": False,
            "distance": pytest.approx(np.hypot(1, 0.2)),
            "speed": 0.0,
            "wall_contact": False,
            "contact": False,
            "disturbed": False,
        }

    @given(seeds, st.integers(2, 6))
    def test_number_of_goals(self, seed, number):
        observation, _ = BlockReach2D().reset(seed=seed, options={"num_goals": number})
        assert observation["present"].sum() == number

    @given(seeds, st.integers(2, 12))
    def test_scenes_hold_no_more_goals_than_there_is_room_for(self, seed, most):
        env = vector(4, seed=seed, max_goals=most)
        assert all(2 <= s.num_goals <= min(most, 6) for s in env.scenes)

    @given(seeds, st.integers(0, 3))
    def test_a_drawn_scene_starts_away_from_its_target(self, seed, target):
        env = vector(1, {"target": target, "num_goals": 4}, seed)
        assert np.linalg.norm(env.scenes[0].start - env.scenes[0].goals[target]) >= 0.24 * 1.2

    def test_one_option_for_each(self):
        other = Scene([0.5, 0.5], [[0, 0], [1, 1], [1, 0]])
        env = vector(
            2,
            {
                "scene": [SCENE, other],
                "target": np.array([1, 2]),
                "gain": (0.3, 0.9),
                "lag": [0.0, 0.2],
                "push": np.zeros(2),
            },
        )
        assert env.scenes == [SCENE, other]
        assert env.targets.tolist() == [1, 2]
        assert env.hidden["gain"].tolist() == [0.3, 0.9]
        env.step(np.full((2, 2), 0.01))
        assert env.velocities == pytest.approx(np.array([[0.003] * 2, [0.0072] * 2]))

    @given(seeds)
    def test_what_is_drawn(self, seed):
        env = vector(8, seed=seed)
        fixed = vector(8, {"scene": SCENE, "lag": 0.0}, seed)
        assert (env.hidden["gain"] >= 0.65).all()
        assert (env.hidden["gain"] <= 0.85).all()
        assert len(set(env.hidden["gain"])) == 8
        assert env.hidden["gain"].tolist() == fixed.hidden["gain"].tolist()
        env.step(np.full((8, 2), 0.001))
        slowed = 1 - env.velocities[:, 0] / (0.001 * env.hidden["gain"])
        assert ((slowed > -1e-9) & (slowed < 0.3 + 1e-9)).all()

    @pytest.mark.parametrize(("options", "message"), BAD.values(), ids=BAD)
    def test_bad_options_are_named_and_change_nothing(self, options, message):
        for env in (BlockReach2D(), BlockReach2DVector(2)):
            env.reset(seed=3, options={"noise": 0.01})
            other = copy.deepcopy(env)
            for seed in (None, 8):
                with pytest.raises(InvalidInputError, match=message):
                    env.reset(seed=seed, options=options)
            actions = np.full(env.action_space.shape, 0.02)
            assert equal(env.step(actions), other.step(actions))
            assert equal(env.reset(), other.reset())

    def test_an_error_in_the_last_environment_changes_nothing_in_the_first(self):
        env = vector(2, seed=3)
        other = copy.deepcopy(env)
        with pytest.raises(InvalidInputError, match="push must be a number of at least 0, got -1"):
            env.reset(options={"push": [0.1, -1.0]})
        with pytest.raises(InvalidSceneError, match="got str"):
            env.reset(seed=1, options={"scene": [SCENE, "scene"]})
        assert equal(env.step(np.zeros((2, 2))), other.step(np.zeros((2, 2))))
        assert equal(env.reset(), other.reset())

    @pytest.mark.parametrize("name", ["scene", "target", "gain", "push"])
    def test_lists_of_another_length(self, name):
        with pytest.raises(InvalidInputError, match=f"{name} must be one for all or 2, got 3"):
            BlockReach2DVector(2).reset(options={name: [0, 0, 0]})

    @pytest.mark.parametrize(
        "arguments",
        [{"num_envs": 0}, {"num_envs": 1.0}, {"max_goals": 1}, {"max_episode_steps": 0}],
    )
    def test_bad_arguments(self, arguments):
        (name,) = arguments
        with pytest.raises(InvalidInputError, match=f"{name} must be an integer of at least"):
            BlockReach2DVector(**arguments)


class TestStep:
    @given(
        seeds,
        st.floats(0, 1),
        st.floats(0, 0.3),
        st.lists(st.tuples(*[st.floats(-0.06, 0.06)] * 2), min_size=1, max_size=6),
    )
    def test_realised_displacement(self, seed, gain, lag, actions):
        scene = Scene([0.5, 0.5], [[-0.1, -0.1], [1.1, 1.1]])  # no wall and no goal within reach
        env = vector(1, {"scene": scene, "gain": gain, "lag": lag}, seed)
        velocity = np.zeros(2)
        for action in actions:
            before = env.positions[0]
            velocity = (1 - lag) * gain * np.clip(action, -0.05, 0.05) + lag * velocity
            observation, reward, *_, info = env.step([action])
            assert env.positions[0] - before == pytest.approx(velocity, abs=1e-12)
            assert env.velocities[0] == pytest.approx(velocity, abs=1e-12)
            assert observation["position"].tolist() == env.positions.tolist()
            assert info["speed"][0] == pytest.approx(20 * np.linalg.norm(velocity), abs=1e-9)
            distance = np.linalg.norm(env.positions[0] - scene.goals[0])
            assert info["distance"][0] == pytest.approx(distance) == -reward[0]
            assert not info["wall_contact"][0]

    @given(st.floats(0, 0.03), st.floats(0, 0.04), st.floats(0, 2 * np.pi))
    @example(0.0199, 0.0099, 1.0)
    @example(0.0201, 0.0099, 1.0)
    @example(0.0199, 0.0101, 1.0)
    def test_success_is_near_and_slow(self, distance, step, angle):
        goal, way = np.array([0.5, 0.5]), np.array([np.cos(angle), np.sin(angle)])
        away = distance + step
        assume(min(away, abs(distance - 0.02), abs(step - 0.01)) > 1e-5)
        scene = Scene(goal - away * way, [goal, [1, 1]])
        env = vector(1, EXACT | {"scene": scene})
        _, _, success, truncated, info = env.step([step * way])
        assert success[0] == (distance <= 0.02 and step <= 0.01)
        assert info["is_success"][0] == success[0] == env.success[0] == env.done[0]
        assert not truncated[0]
        _, _, success, *_ = env.step([[0, 0]])
        assert success[0] == (distance <= 0.02)

    def test_success_is_of_the_target(self):
        scene = Scene([0.5, 0.49], [[1, 1], [0.5, 0.5]])
        assert not vector(1, EXACT | {"scene": scene}).step([[0, 0.008]])[2][0]
        assert vector(1, EXACT | {"scene": scene, "target": 1}).step([[0, 0.008]])[2][0]

    def test_a_disturbed_step_is_no_success(self):
        scene = Scene([0.5, 0.49], [[0.5, 0.5], [1, 1]])
        env = vector(1, EXACT | {"scene": scene, "push": 0.001})
        for success in (False, True):
            _, _, terminated, _, info = env.step([[0, 0.008]])
            assert info["disturbed"][0] == (not success)
            assert terminated[0] == info["is_success"][0] == success

    def test_time_is_up_after_400_steps(self):
        one, many = gymnasium.make(ID), gymnasium.make_vec(ID, num_envs=2)
        one.reset(seed=0)
        many.reset(seed=0)
        for step in range(1, 401):
            _, _, terminated, truncated, _ = one.step(np.zeros(2))
            assert (terminated, truncated) == (False, step == 400)
            _, _, terminated, truncated, _ = many.step(np.zeros((2, 2)))
            assert not terminated.any()
            assert truncated.tolist() == [step == 400] * 2
        assert many.done.all()
        assert not many.success.any()

    def test_what_has_ended_stands_still(self):
        near = Scene([0.5, 0.49], [[0.5, 0.5], [1, 1]])
        env = vector(
            3, EXACT | {"scene": [near, SCENE, SCENE], "noise": 0.001}, max_episode_steps=5
        )
        ended = np.zeros(3, dtype=bool)
        for step in range(8):
            before = env.positions
            _, reward, terminated, truncated, info = env.step([[0, 0.005]] * 3)
            assert (env.positions == before).all(-1).tolist() == ended.tolist()
            assert (reward == 0).tolist() == ended.tolist()
            assert not (terminated & truncated).any()
            assert info["is_success"].tolist() == terminated.tolist() == env.success.tolist()
            ended = terminated | truncated
            assert ended.tolist() == env.done.tolist() == [True, step >= 4, step >= 4]
        assert env.success.tolist() == [True, False, False]
        _, info = env.reset(options={"scene": SCENE, "reset_mask": np.array([True, True, False])})
        assert env.success.tolist() == info["is_success"].tolist() == [False] * 3
        assert env.done.tolist() == [False, False, True]
        for step in range(1, 6):
            _, _, terminated, truncated, _ = env.step([[0, 0.005]] * 3)
            assert not terminated.any()
            assert truncated.tolist() == [step == 5, step == 5, True]

    def test_what_stands_still_touches_no_wall(self):
        scene = Scene([1.09, 0.5], [[1.1, 0.5], [0, 0]])
        env = vector(1, EXACT | {"scene": scene})
        contacts = [env.step([[action, 0]])[-1]["wall_contact"][0] for action in (0.008, 0.05)]
        assert env.success[0]
        assert contacts == [False, False]

    def test_out_of_time_at_the_goal_is_no_success_later(self):
        scene = Scene([0.46, 0.5], [[0.5, 0.5], [1, 1]])
        env = vector(1, EXACT | {"scene": scene}, max_episode_steps=1)
        for _ in range(3):
            _, _, terminated, truncated, info = env.step([[0.04, 0]])
            assert info["distance"][0] < 0.02
            assert (terminated[0], truncated[0], info["is_success"][0]) == (False, True, False)

    @given(seeds, rough)
    def test_observations_are_of_the_space(self, seed, options):
        env, one = BlockReach2DVector(3), BlockReach2D()
        rng = np.random.default_rng(seed)
        assert env.reset(seed=seed, options=options)[0] in env.observation_space
        assert one.reset(seed=seed, options=options)[0] in one.observation_space
        way = rng.uniform(-1, 1, (3, 2))
        for _ in range(40):
            actions = 0.1 * way + rng.normal(0, 0.02, (3, 2))
            assert env.step(actions)[0] in env.observation_space
            assert one.step(actions[0])[0] in one.observation_space

    @given(seeds, st.booleans())
    def test_walls(self, seed, noisy):
        env = vector(4, {"noise": 0.02, "push": 0.5} if noisy else {}, seed)
        way = np.random.default_rng(seed).uniform(-0.1, 0.1, (4, 2))
        for _ in range(50):
            gain, lag = (env.hidden[name][:, None] for name in ("gain", "lag"))
            before, last = env.positions, env.velocities
            alive = ~env.done
            *_, info = env.step(way)
            assert ((env.positions >= LOW) & (env.positions <= HIGH)).all()
            wanted = before + (1 - lag) * gain * np.clip(way, -0.05, 0.05) + lag * last
            out = ((wanted < LOW - 1e-9) | (wanted > HIGH + 1e-9)).any(-1)
            inside = ((wanted >= LOW) & (wanted <= HIGH)).all(-1)
            assert info["wall_contact"][alive & out].all()
            assert not info["wall_contact"][~alive | inside].any()
            if not noisy:
                assert env.positions[alive] == pytest.approx(np.clip(wanted, LOW, HIGH)[alive])
                assert env.velocities == pytest.approx(env.positions - before)  # stopped, it rests

    @given(seeds, st.floats(0.01, 0.3))
    def test_push(self, seed, push):
        env = vector(1, EXACT | {"scene": SCENE, "push": push}, seed)
        travelled, half = 0.0, np.hypot(0.8, 0.1) / 2
        pushed = []
        for _ in range(40):
            before = env.positions[0]
            _, _, success, _, info = env.step([[0.02, 0]])
            moved = env.positions[0] - before
            if info["disturbed"][0]:
                pushed.append(moved - [0.02, 0])
                assert travelled + 0.02 >= half > travelled
                assert env.velocities[0] == pytest.approx([0.02, 0])
                assert not success[0]
            elif not env.done[0] and not info["wall_contact"][0]:
                assert moved == pytest.approx([0.02, 0])
            travelled += 0.02
        assert len(pushed) == 1
        assert np.linalg.norm(pushed[0]) == pytest.approx(push)

    @given(seeds, st.floats(0.01, 0.3))
    def test_shift(self, seed, shift):
        env = vector(1, EXACT | {"scene": SCENE, "shift": shift, "target": 1}, seed)
        for _ in range(40):
            before = env.positions[0]
            observation, *_, info = env.step([[0.02, 0]])
            if info["disturbed"][0]:
                assert env.positions[0] - before == pytest.approx([0.02, 0])
                break
            assert observation["goals"][0, :2].tolist() == SCENE.goals.tolist()
        goals = env.scenes[0].goals
        assert observation["goals"][0, :2].tolist() == goals.tolist()
        assert goals[0].tolist() == SCENE.goals[0].tolist()
        moved = np.linalg.norm(goals[1] - SCENE.goals[1])
        assert moved <= shift + 1e-12
        if ((goals[1] > LOW) & (goals[1] < HIGH)).all():
            assert moved == pytest.approx(shift)
        distance = np.linalg.norm(env.positions[0] - goals[1])
        assert info["distance"][0] == pytest.approx(distance)

    def test_pushes_go_anywhere(self):
        env = vector(64, EXACT | {"scene": Scene([0.5, 0.5], [[0.52, 0.5], [1, 1]]), "push": 0.1})
        before = env.positions
        *_, info = env.step(np.full((64, 2), 0.02))
        assert info["disturbed"].all()
        pushed = (env.positions - before - 0.02) / 0.1
        assert np.linalg.norm(pushed, axis=-1) == pytest.approx(np.ones(64))
        assert np.linalg.norm(pushed.mean(axis=0)) < 0.4

    def test_a_block_is_not_shifted_onto_another(self):
        scene = Scene([0.5, 0.5], [[0.9, 0.9], [1.1, 1.1]])
        env = vector(32, EXACT | {"scene": scene, "shift": 1e6})
        for _ in range(20):
            env.step(np.full((32, 2), 0.02))
        ends = {tuple(s.goals[0].tolist()) for s in env.scenes}
        assert {(0.9, 0.9), (-0.1, -0.1), (-0.1, 1.1), (1.1, -0.1)} <= ends
        assert (1.1, 1.1) not in ends

    @given(seeds)
    def test_noise_has_its_standard_deviation(self, seed):
        scene = Scene([0.5, 0.5], [[-0.1, -0.1], [1.1, 1.1]])
        env = vector(8, EXACT | {"scene": scene, "noise": 0.002}, seed)
        moved = []
        for _ in range(60):
            env.step(np.zeros((8, 2)))
            moved.append(env.velocities)
        assert np.std(moved) == pytest.approx(0.002, rel=0.15)

    def test_another_target_from_now_on(self):
        env = vector(2, {"scene": SCENE})
        env.set_target(1, 1)
        observation, reward, *_ = env.step(np.zeros((2, 2)))
        assert observation["target"].tolist() == [0, 1]
        assert reward == pytest.approx(-np.linalg.norm(SCENE.goals - SCENE.start, axis=-1))
        for index, target, message in ((0, 2, "0 to 1, got 2"), (2, 0, "at most 1, got 2")):
            with pytest.raises(InvalidInputError, match=message):
                env.set_target(index, target)
        with pytest.raises(InvalidInputError, match="index must be an integer"):
            env.set_target(-1, 0)

    @pytest.mark.parametrize(
        ("action", "message"),
        [
            ([np.nan, 0], "finite, got nan"),
            ([0, np.inf], "finite, got inf"),
            ([0, 0, 0], "3"),
            ([0], "1"),
            (0.0, r"\(\)|2"),
            ("up", "array of numbers"),
            (None, "axes|array|finite|shape"),
        ],
    )
    def test_bad_actions_change_nothing(self, action, message):
        one, many = BlockReach2D(), vector(2)
        one.reset(seed=0)
        for env, name, value in ((one, "action", action), (many, "actions", [action, action])):
            other = copy.deepcopy(env)
            with pytest.raises(InvalidInputError, match=f"^{name} must .*({message})"):
                env.step(value)
            actions = np.zeros(env.action_space.shape)
            assert equal(env.step(actions), other.step(actions))

    def test_actions_for_another_number(self):
        with pytest.raises(InvalidInputError, match=r"shape \(2, 2\), got \(3, 2\)"):
            vector(2).step(np.zeros((3, 2)))

    def test_whole_numbers_and_single_precision_are_actions(self):
        first, second = vector(1), vector(1)
        for _ in range(3):
            first.step([[1, 0]])
            second.step(np.array([[0.05, 0]], dtype=np.float32))
        assert first.positions == pytest.approx(second.positions, abs=1e-8)

    def test_reset_comes_first(self):
        for env in (BlockReach2D(render_mode="rgb_array"), gymnasium.make(ID)):
            for act in (lambda: env.step(np.zeros(2)), env.render):  # noqa: B023
                with pytest.raises(ResetNeeded):
                    act()
        many = BlockReach2DVector(2, render_mode="rgb_array")
        for act in (
            lambda: many.step(np.zeros((2, 2))),
            many.render,
            lambda: many.set_target(0, 0),
        ):
            with pytest.raises(ResetNeeded):
                act()

    def test_closed_for_good(self):
        for env in (BlockReach2D(render_mode="rgb_array"), BlockReach2DVector(2)):
            env.reset(seed=0)
            env.close()
            env.close()
            with pytest.raises(InvalidInputError, match="the environment is closed"):
                env.reset()
            with pytest.raises(InvalidInputError, match="the environment is closed"):
                env.step(np.zeros(env.action_space.shape))
            act = env.render if env.render_mode else lambda: env.set_target(0, 0)  # noqa: B023
            with pytest.raises(InvalidInputError, match="the environment is closed"):
                act()

    def test_what_is_returned_stays(self):
        env = vector(2, {"shift": 0.2, "noise": 0.01})
        results = [env.step(np.full((2, 2), 0.02)) for _ in range(3)]
        copies = copy.deepcopy(results)
        for _ in range(30):
            env.step(toward(env))
        env.reset()
        assert all(itertools.starmap(equal, zip(results, copies, strict=True)))


class TestObstacles:
    SCENE = Scene(
        [0, 0.5], [[1, 0.5], [0.5, 0.8]], obstacles=[Box([0.3, 0.5], [0.1, 0.2])],
        goal_radius=0.05, clearance=0.01,
    )  # fmt: skip

    def test_contacts_stop_nothing_and_are_counted(self):
        env = vector(2, {"scene": [self.SCENE, SCENE], "gain": 0.8, "lag": 0.0})
        inside = 0
        for _ in range(40):
            before = env.positions[0]
            *_, info = env.step(np.full((2, 2), [0.05, 0.0]))
            touched = info["contact"]
            assert (touched == env.contact).all()
            expected = before[0] < 0.35 - 1e-6 and env.positions[0, 0] > 0.25 + 1e-6
            assert touched.tolist() == [expected, False]
            inside += touched[0]
        assert inside == 3
        assert env.positions[0, 0] == pytest.approx(1.1)
        env.reset(seed=0)
        assert not env.contact.any()

    def test_blocks_are_touched_unless_they_are_the_target(self):
        env = vector(2, {"scene": self.SCENE, "target": [0, 1], "push": 0.0})
        env.positions[:] = [0.5, 0.74]
        *_, info = env.step(np.full((2, 2), [0.0, 0.02]))
        assert info["contact"].tolist() == [True, False]
        env.set_target(0, 1)
        *_, info = env.step(np.zeros((2, 2)))
        assert info["contact"].tolist() == [False, False]

    def test_a_robot_at_rest_or_ended_touches_nothing_new(self):
        env = vector(1, {"scene": self.SCENE}, max_episode_steps=1)
        env.positions[:] = [0.3, 0.5]
        assert env.step(np.zeros((1, 2)))[-1]["contact"].tolist() == [True]
        assert env.step(np.zeros((1, 2)))[-1]["contact"].tolist() == [False]

    def test_a_moved_target_keeps_the_room(self):
        env = vector(8, {"scene": self.SCENE, "shift": 0.1})
        for _ in range(25):
            env.step(0.8 * np.array([s.goals[0] for s in env.scenes]) - 0.8 * env.positions)
        assert all((scene.goals[0] != self.SCENE.goals[0]).any() for scene in env.scenes)
        for scene in env.scenes:
            assert scene.obstacles == self.SCENE.obstacles
            assert (scene.goal_radius, scene.clearance) == (0.05, 0.01)

    def test_a_target_is_not_shifted_into_an_obstacle(self):
        cage = [Box([1, y], [0.6, 0.02]) for y in (0.47, 0.53)]
        scene = Scene([0, 0.5], [[1, 0.5], [0.5, 0.8]], obstacles=cage)
        env = vector(20, {"scene": scene, "shift": 0.03})
        for _ in range(40):
            env.step(np.full((20, 2), [0.05, 0.0]))
        moved = [s for s in env.scenes if (s.goals[0] != scene.goals[0]).any()]
        assert 0 < len(moved) < 20
        assert all(s.check_target(0) == 0 for s in moved)

    def test_targets_in_obstacles_are_refused(self):
        blocked = Scene([0, 0.5], [[1, 0.5], [0.3, 0.5]], obstacles=[Ball([0.3, 0.5], 0.1)])
        with pytest.raises(InvalidSceneError, match=r"obstacles\[0\] lies over the target"):
            BlockReach2D().reset(options={"scene": blocked, "target": 1})
        env = vector(1, {"scene": blocked})
        with pytest.raises(InvalidSceneError, match=r"obstacles\[0\] lies over the target"):
            env.set_target(0, 1)
        assert env.targets.tolist() == [0]

    @given(seeds)
    def test_drawn_scenes_have_blocks_of_their_size(self, seed):
        env = vector(1, seed=seed)
        (scene,) = env.scenes
        assert scene.goal_radius == env.block_radius
        assert not scene.obstacles
        assert all(scene.check_target(i) == i for i in range(scene.num_goals))
        assert scene.margin_at(scene.start, 0) >= 0

    def test_a_point_has_no_arm(self):
        env = vector(2, {"scene": self.SCENE})
        assert env.arm is None
        assert env.planes is None


def test_importing_the_package_registers_it_once():
    import legibility

    assert ID in gymnasium.registry
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        gymnasium.make(ID).close()
    assert "BlockReach2D" not in dir(legibility.envs)
