"""Whoever drives: what is sent is safe, and every rollout ends with a reason."""

import gymnasium
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from legibility.execution import Feedback, Fleet, Replay, follow

import legibility as lg
from legibility.envs.block_reach_2d import BlockReach2DVector
from legibility.errors import InvalidInputError
from legibility.motion.path import Path

NAME = "legibility/BlockReach2D-v0"
LIMIT = 0.05


def bent(scene, bend):
    """A path from the scene's start to goal 0 that bulges by `bend` of its length."""
    line = scene.start + np.linspace(0, 1, 10)[:, None] * (scene.goals[0] - scene.start)
    side = np.array([-1.0, 1.0]) * (scene.goals[0] - scene.start)[::-1]
    waypoints = line + bend * np.sin(np.linspace(0, np.pi, 10))[:, None] * side
    waypoints[[0, -1]] = scene.start, scene.goals[0]
    waypoints = np.clip(waypoints, *scene.workspace)
    field = lg.InformationPotentialField(scene.goals, 0.15)
    return Path(scene, 0, np.array(0.5), waypoints, np.False_, field, 3.0, "anchored")


def fleet(size=6, seed=0, **options):
    env = BlockReach2DVector(size)
    env.reset(seed=seed, options=options)
    found = Fleet(env, 0)
    return found, [bent(s, 0.3 * (-1) ** i) for i, s in enumerate(found.scenes)]


def check_safe(rollouts):
    for rollout in rollouts:
        assert np.isfinite(rollout.actions).all()
        assert (np.abs(rollout.actions) <= LIMIT).all()
        assert rollout.path.scene.contains(rollout.states).all()
        assert rollout.reason in ("reached", "stalled", "lost", "time")
        assert rollout.success == (rollout.reason == "reached")
        assert len(rollout.states) == len(rollout.actions) + 1 == len(rollout.deviation) + 1


class TestFeedback:
    @given(seed=st.integers(0, 10_000), noise=st.sampled_from([0.0, 0.003]))
    @settings(max_examples=10, deadline=None)
    def test_reaches_the_goal_near_the_path(self, seed, noise):
        robots, paths = fleet(seed=seed, noise=noise)
        rollouts = follow(robots, paths, Feedback())
        check_safe(rollouts)
        for rollout, path in zip(rollouts, paths, strict=True):
            assert rollout.reason == "reached"
            assert rollout.wall_contacts == 0
            assert np.linalg.norm(rollout.states[-1] - path.waypoints[-1]) <= 0.02
            assert rollout.deviation.mean() < 0.01
            np.testing.assert_array_equal(rollout.states[0], path.waypoints[0])
            assert rollout.posterior.shape == (len(rollout.states), path.scene.num_goals)
            assert rollout.trajectory(50).shape == (50, 2)
            assert rollout.legibility == 0.5
            assert np.isfinite(rollout.score)
            assert -1 <= rollout.achieved <= 1

    def test_the_same_again(self):
        first, again = (follow(*fleet(seed=3, noise=0.002), Feedback()) for _ in range(2))
        for a, b in zip(first, again, strict=True):
            np.testing.assert_array_equal(a.states, b.states)
            np.testing.assert_array_equal(a.actions, b.actions)

    def test_a_pushed_robot_goes_back_to_its_path(self):
        rollouts = follow(*fleet(push=0.1), Feedback())
        check_safe(rollouts)
        assert all(r.success and not r.replans for r in rollouts)
        assert max(r.deviation.max() for r in rollouts) > 0.05


class Wild:
    """A driver that says anything."""

    with_path = True

    def __init__(self, kind):
        self.kind, self.rng = kind, np.random.default_rng(0)

    def __call__(self, rows, positions, previous, goals, tracker):
        values = {
            "nan": np.nan, "inf": np.inf, "huge": 1e300, "nothing": 0.0,
            "away": 1.0, "random": self.rng.normal(0, 0.2, (len(rows), 3, 2)),
        }  # fmt: skip
        return np.broadcast_to(values[self.kind], (len(rows), 3, 2)).copy()


@pytest.mark.parametrize("kind", ["nan", "inf", "huge", "nothing", "away", "random"])
def test_whatever_the_driver_says_it_is_safe_and_ends_early(kind):
    rollouts = follow(*fleet(size=16), Wild(kind))
    check_safe(rollouts)
    assert not any(r.wall_contacts for r in rollouts)
    assert {r.reason for r in rollouts if not r.success} <= {"stalled", "lost"}
    assert sum(r.success for r in rollouts) < 8


def test_open_loop_falls_short():
    rollouts = follow(*fleet(size=16), Replay(LIMIT))
    check_safe(rollouts)
    assert sum(r.success for r in rollouts) < 8


class TestPlanningAgain:
    def straight(self, robots):
        def plan_again(rows, positions):
            asked.append((rows, positions))
            scenes = [
                lg.Scene(x, robots.scenes[r].goals) for r, x in zip(rows, positions, strict=True)
            ]
            return [bent(scene, 0) for scene in scenes]

        asked = []
        return plan_again, asked

    def test_after_a_push(self):
        robots, paths = fleet(push=0.1)
        plan_again, asked = self.straight(robots)
        rollouts = follow(robots, paths, Feedback(), plan_again=plan_again, tolerance=0.05)
        check_safe(rollouts)
        assert all(r.success for r in rollouts)
        assert asked
        assert sum(len(r.replans) for r in rollouts) == sum(len(rows) for rows, _ in asked)

    def test_when_the_goal_moves(self):
        robots, paths = fleet(shift=0.1)
        plan_again, _ = self.straight(robots)
        rollouts = follow(robots, paths, Feedback(), plan_again=plan_again, tolerance=0.05)
        assert all(r.success for r in rollouts)
        assert all(len(r.replans) >= 1 for r in rollouts)
        robots, paths = fleet(shift=0.1)
        assert not all(r.success for r in follow(robots, paths, Feedback()))


class TestFleet:
    def test_one_face_for_all_environments(self):
        """The same scenes and gains give the same states, however the environments are made."""
        scene = lg.Scene([0, 0.5], [[0.8, 0.6], [1, 0.3]])
        options = {"scene": scene, "target": 0}
        single = gymnasium.make(NAME)
        own = gymnasium.make_vec(NAME, num_envs=2, vectorization_mode="vector_entry_point")
        sync = gymnasium.make_vec(NAME, num_envs=2, vectorization_mode="sync")
        found = []
        for env in (single, own, sync):
            env.reset(seed=5, options=options)
            robots = Fleet(env, 0)
            found.append(follow(robots, [bent(scene, 0.2)] * robots.size, Feedback())[0])
            env.close()
        for other in found[1:]:
            np.testing.assert_allclose(other.states, found[0].states, atol=1e-12)

    def test_never_reset_is_reset(self):
        env = gymnasium.make(NAME)
        scene = Fleet(env, 7).scenes[0]
        env.reset(seed=7)
        assert scene == env.unwrapped.batch.scenes[0]

    def test_refuses(self):
        with pytest.raises(InvalidInputError, match="environment of legibility"):
            Fleet(gymnasium.make("CartPole-v1"), 0)
        robots, paths = fleet()
        follow(robots, paths, Feedback())
        with pytest.raises(InvalidInputError, match="reset the environment"):
            Fleet(robots._env, 0)

    def test_a_closed_environment(self):
        env = gymnasium.make(NAME)
        env.reset(seed=0)
        robots = Fleet(env, 0)
        env.close()
        with pytest.raises(InvalidInputError, match="closed"):
            follow(robots, [bent(robots.scenes[0], 0)], Feedback())

    def test_a_path_from_elsewhere(self):
        robots, paths = fleet(size=2)
        with pytest.raises(InvalidInputError, match="must start at the robot"):
            follow(robots, paths[::-1], Feedback())

    def test_targets(self):
        robots, _ = fleet(size=3)
        robots.set_targets(np.array([0, 1, 1]))
        np.testing.assert_array_equal(robots.targets, [0, 1, 1])
        with pytest.raises(InvalidInputError, match="target"):
            robots.set_targets(np.array([0, 1, 99]))
