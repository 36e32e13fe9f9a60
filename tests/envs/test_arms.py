"""Laws that the arm keeps in both simulators."""

import gymnasium
import numpy as np
import pytest
from episodes import FakeWindow, equal, played, row, safe, toward
from gymnasium.utils.env_checker import check_env
from hypothesis import given, settings
from hypothesis import strategies as st
from rooms import room

from legibility import Scene
from legibility.envs import ENVIRONMENTS, vector_type
from legibility.envs.arm import ArmVector
from legibility.errors import InvalidInputError, InvalidSceneError
from legibility.obstacles import Ball, Box
from legibility.robots.arm import checked_points

SCENE = Scene([-0.2, -0.1, 0.3], [[0, 0.15, 0.02], [0, -0.1, 0.06]])
NEEDS = {"panda": ("mujoco", "mink"), "pandagym": ("panda_gym",)}

seeds = st.integers(0, 2**32 - 1)
rough = st.fixed_dictionaries(
    {},
    optional={
        "noise": st.floats(0, 0.01),
        "push": st.floats(0, 0.2),
        "shift": st.floats(0, 0.2),
        "num_goals": st.integers(2, 6),
    },
)


@pytest.fixture(scope="module", params=NEEDS)
def name(request):
    for module in NEEDS[request.param]:
        pytest.importorskip(module, reason=f"NOT TESTED: pip install 'legibility[{request.param}]'")
    return request.param


@pytest.fixture(scope="module")
def vector(name):
    return vector_type(name, 3)


@pytest.fixture(scope="module")
def identifier(name):
    return f"legibility/{ENVIRONMENTS[name].partition(':')[2]}-v0"


@pytest.fixture(scope="module")
def single(identifier):
    return lambda **options: gymnasium.make(identifier, **options).unwrapped


class TestGymnasium:
    @pytest.mark.filterwarnings("error")
    def test_check_env(self, single, vector, monkeypatch):
        image = np.zeros((480, 480, 3), dtype=np.uint8)
        monkeypatch.setattr(vector, "_picture", lambda self, index: image)
        monkeypatch.setattr("legibility.envs.render.Window", FakeWindow)
        check_env(single())
        check_env(single(max_goals=3, render_mode="rgb_array"))

    @pytest.mark.filterwarnings("error")
    def test_make_vec(self, identifier, vector):
        env = gymnasium.make_vec(identifier, num_envs=2)
        assert isinstance(env, vector)
        observation, _ = env.reset(seed=3)
        assert observation in env.observation_space
        for _ in range(3):
            observation, *rest, info = env.step(env.action_space.sample())
            assert observation in env.observation_space
            assert [x.shape for x in (*rest, info["distance"])] == [(2,)] * 4
        env.close()
        env.close()
        with pytest.raises(InvalidInputError, match="the environment is closed"):
            env.reset()

    def test_interface_of_an_arm(self, single):
        env = single()
        assert env.action_space == gymnasium.spaces.Box(-0.02, 0.02, (3,), np.float64)
        shapes = {name: space.shape for name, space in env.observation_space.items()}
        assert shapes == {"position": (3,), "goals": (6, 3), "present": (6,), "target": ()}
        _, info = env.reset(seed=0)
        assert set(info) == {
            "is_success", "distance", "speed", "wall_contact", "contact", "disturbed",
            *ArmVector.counted,
        }  # fmt: skip


class TestEpisodes:
    @settings(max_examples=4)
    @given(seeds, seeds, rough)
    def test_same_seed_same_bits_whatever_was_before(self, vector, seed, other, options):
        env = vector(1)
        first = played(env, seed, options=options)
        played(env, other)
        assert equal(first, played(env, seed, options=options))
        assert equal(first, played(vector(1), seed, options=options))

    @settings(max_examples=4)
    @given(seeds, rough)
    def test_a_vector_equals_single_environments(self, vector, single, seed, options):
        many = vector(3, max_episode_steps=18)
        results = [many.reset(seed=seed, options=options)]
        plan = []
        for _ in range(15):
            plan.append(toward(many))
            results.append(many.step(plan[-1]))
        for i in (0, 2):
            one = single()
            assert equal(one.reset(seed=seed + i, options=options), row(results[0], i))
            for actions, result in zip(plan, results[1:], strict=True):
                assert equal(one.step(actions[i]), row(result, i))

    def test_an_ended_episode_stands_still(self, vector):
        env = vector(2, max_episode_steps=30)
        near = Scene([0, 0.15, 0.03], SCENE.goals)
        env.reset(seed=0, options={"scene": [near, SCENE]})
        env.step(np.zeros((2, 3)))
        assert env.done.tolist() == [True, False]
        before, angles = env.positions.copy(), env.joint_angles
        env.step(np.full((2, 3), 0.01))
        assert np.array_equal(env.positions[0], before[0])
        assert np.array_equal(env.joint_angles[0], angles[0])
        assert (env.positions[1] != before[1]).all()

    def test_success(self, vector):
        env = vector(2)
        env.reset(seed=1, options={"scene": SCENE, "target": [0, 1]})
        for _ in range(80):
            env.step(toward(env))
        assert env.success.all()
        assert not any(number.any() for number in env.counts.values())

    def test_a_rollout_may_go_on_from_its_own_position(self, vector):
        """Pushed to a wall, an arm overshoots it; a scene takes its position as a start."""
        env = vector(4)
        env.reset(seed=0, options={"push": 1.0})
        for _ in range(60):
            env.step(toward(env))
        inside = np.clip(env.positions, *env.workspace)
        scenes = [Scene(at, s.goals) for at, s in zip(inside, env.scenes, strict=True)]
        again, _ = env.reset(seed=1, options={"scene": scenes})
        assert again["position"] == pytest.approx(inside, abs=1e-4)

    def test_pictures_show_obstacles(self, vector):
        solid = Box([0.0, 0.0, 0.2], [0.1, 0.06, 0.1])
        scene = Scene(SCENE.start, SCENE.goals, obstacles=[solid])
        env = vector(2, render_mode="rgb_array")
        env.reset(seed=0, options={"scene": [scene, SCENE]})
        first, second = env.render()
        assert (first != second).any(-1).mean() > 0.002

    def test_the_whole_arm_is_checked(self, vector):
        """The forearm touches what the gripper does not come near."""
        solid = Ball([-0.35, 0.1, 0.45], 0.05)
        scene = Scene(SCENE.start, SCENE.goals, obstacles=[solid])
        line = np.linspace(SCENE.start, SCENE.goals[0], 30)
        assert solid.signed_distance(line).min() > 0.1
        env = vector(2)
        env.reset(seed=0, options={"scene": [scene, SCENE]})
        points = checked_points(line)
        assert points[[0, -1]] == pytest.approx(line[[0, -1]])
        gaps = env.arm.obstacle_gaps(scene.obstacles, env.arm.postures(points))
        assert 0 < (gaps < 0).sum() < 20
        touching = points[gaps.argmin()]
        assert env.arm.touches(scene.obstacles, touching) == [("link4", 0)]
        assert env.arm.touches(SCENE.obstacles, touching) == []
        with pytest.raises(InvalidInputError, match="position must have 1 axes"):
            env.arm.touches(scene.obstacles, line)

    def test_planes_stand_before_the_arm(self, vector):
        solid = Ball([-0.2, 0.05, 0.37], 0.04)  # beside the hand
        scene = Scene(SCENE.start, SCENE.goals, obstacles=[solid])
        env = vector(2)
        env.reset(seed=0, options={"scene": SCENE})
        assert env.planes is None
        env.reset(seed=0, options={"scene": [scene, SCENE]})
        normals, gaps = env.planes
        assert (gaps[1] == np.inf).all()
        nearest = gaps[0].argmin()
        assert np.linalg.norm(normals[0, nearest]) == pytest.approx(1)
        assert normals[0, nearest, 1] < 0  # away from the ball, on its left
        away = SCENE.start + np.outer([0, 0.01], normals[0, nearest])
        moved = env.arm.obstacle_gaps(scene.obstacles, env.arm.postures(away))
        assert moved[-1] - moved[0] == pytest.approx(0.01, abs=2e-3)

    def test_arms_in_obstacles_are_counted(self, vector):
        solids = [Ball([-0.3, 0.0, 0.45], 0.05), Ball([-0.1, -0.1, 0.3], 0.06)]
        scenes = [Scene(SCENE.start, SCENE.goals, obstacles=[solid]) for solid in solids]
        scenes.append(SCENE)
        env = vector(3)
        _, info = env.reset(seed=0, options={"scene": scenes})
        assert info["obstacle_contacts"].tolist() == [0, 0, 0]
        contacts = np.zeros(3)
        for _ in range(12):
            *_, info = env.step(np.full((3, 3), [0.015, 0.0, 0.0]))
            contacts += info["contact"]
        assert contacts[0] == contacts[2] == info["obstacle_contacts"][2] == 0
        assert contacts[1] > 3
        assert info["obstacle_contacts"][0] > 0
        assert info["obstacle_contacts"][1] >= contacts[1]
        alone = vector(1)
        alone.reset(seed=2, options={"scene": scenes[2]})
        for _ in range(12):
            alone.step(np.full((1, 3), [0.015, 0.0, 0.0]))
        assert np.array_equal(alone.positions[0], env.positions[2])

    def test_guarded_grippers_touch_nothing(self, vector):
        rng = np.random.default_rng(0)
        scenes = [room(rng, 3, 3, size=0.1) for _ in range(4)]
        env = vector(4, max_episode_steps=1000)
        env.reset(seed=0, options={"scene": scenes})
        for step in range(60):
            if step % 12 == 0:
                way = rng.normal(0, 0.02, (4, 3))
            env.done[:] = False
            env.step(safe(env, way))
            deepest = min(
                s.solids(0).distance(x[None])[0] for s, x in zip(scenes, env.positions, strict=True)
            )
            assert deepest > -0.003  # as far as arms overshoot

    @pytest.mark.parametrize(("options", "error", "message"), [
        ({"gain": 0.7}, InvalidInputError, r"unknown: \['gain'\]"),
        ({"scene": Scene([0, 0.5], [[0.8, 0.6], [1, 0.3]])}, InvalidSceneError,
         "must be 3-D .* here, got 2-D"),
        ({"scene": Scene([0, 0, 0.2], [[0, 0, 0.1], [0, 0.1, 0.1]], [[-1] * 3, [1] * 3])},
         InvalidSceneError, r"workspace must be \[\[-0.3, -0.3, 0.02\].*got \[\[-1.0"),
    ])  # fmt: skip
    def test_bad_options(self, single, options, error, message):
        with pytest.raises(error, match=message):
            single().reset(options=options)
