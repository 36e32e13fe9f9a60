"""Whatever the driver does, its actions are made safe and every rollout ends with a reason."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pictures import rollout_of
from rooms import room

import legibility as lg
from legibility.drivers import Feedback, Replay
from legibility.envs.block_reach_2d import BlockReach2DVector
from legibility.envs.fleet import Fleet
from legibility.errors import InvalidInputError
from legibility.motion.path import Path
from legibility.obstacles import Ball, Box
from legibility.rollout import follow

LIMIT = 0.05
SCENE = lg.Scene([0, 0.5], [[0.8, 0.6], [1, 0.3]])


def bent(scene, bend):
    """A path from the scene's start to goal 0 that bulges by `bend` of its length."""
    line = np.linspace(scene.start, scene.goals[0], 10)
    side = np.array([-1.0, 1.0]) * (scene.goals[0] - scene.start)[::-1]
    waypoints = line + bend * np.sin(np.linspace(0, np.pi, 10))[:, None] * side
    waypoints[[0, -1]] = scene.start, scene.goals[0]
    return Path.through(waypoints, scene, 0, np.array(0.5), lg.Observer())


def robots(size=6, seed=0, **options):
    """Robots in random scenes, where nothing is in the way, and a path for each."""
    env = BlockReach2DVector(size)
    scenes = [lg.Scene.random(np.random.default_rng(seed + i)) for i in range(size)]
    env.reset(seed=seed, options={"scene": scenes, **options})
    fleet = Fleet(env, 0)
    return fleet, [bent(s, 0.3 * (-1) ** i) for i, s in enumerate(fleet.scenes)]


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
        fleet, paths = robots(seed=seed, noise=noise)
        rollouts = follow(fleet, paths, Feedback())
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

    def test_the_same_again(self):
        first, again = (follow(*robots(seed=3, noise=0.002), Feedback()) for _ in range(2))
        for a, b in zip(first, again, strict=True):
            np.testing.assert_array_equal(a.states, b.states)
            np.testing.assert_array_equal(a.actions, b.actions)

    def test_a_robot_does_not_depend_on_the_others(self):
        scenes = [lg.Scene.random(np.random.default_rng(i)) for i in range(4)]
        motions = []
        for part in (scenes, scenes[2:3]):
            env = BlockReach2DVector(len(part))
            first = scenes.index(part[0])
            env.reset(seed=[first + i for i in range(len(part))], options={"scene": part})
            motions.append(follow(Fleet(env, 0), [bent(s, 0.2) for s in part], Feedback()))
        np.testing.assert_allclose(motions[0][2].states, motions[1][0].states, atol=1e-12)

    def test_a_pushed_robot_goes_back_to_its_path(self):
        rollouts = follow(*robots(push=0.1), Feedback())
        check_safe(rollouts)
        assert all(r.success and not r.replans for r in rollouts)
        assert max(r.deviation.max() for r in rollouts) > 0.05


def test_read_by_the_observer_of_the_path():
    (rollout,) = follow(*robots(size=1), Feedback())
    path = rollout.path
    field = path.observer.field(path.scene)
    np.testing.assert_array_equal(rollout.posterior, field.posterior(rollout.states))
    alpha = path.observer.alpha
    score = lg.metrics.legibility_score(rollout.trajectory(), field, path.target, alpha=alpha)
    assert rollout.score == pytest.approx(float(score), rel=1e-12)
    archive = lg.build_archive(path.scene, path.target)
    assert rollout.achieved == pytest.approx(float(archive.label_of(rollout.score)), abs=1e-9)
    assert -1 <= rollout.achieved <= 1


class Wild:
    """A driver that commands anything."""

    with_path = True

    def __init__(self, command):
        self.command, self.rng = command, np.random.default_rng(0)

    def __call__(self, robots):
        values = {
            "nan": np.nan, "inf": np.inf, "huge": 1e300, "nothing": 0.0,
            "away": 1.0, "random": self.rng.normal(0, 0.2, (len(robots.rows), 3, 2)),
        }  # fmt: skip
        return np.broadcast_to(values[self.command], (len(robots.rows), 3, 2)).copy()


@pytest.mark.parametrize("command", ["nan", "inf", "huge", "nothing", "away", "random"])
def test_any_command_is_made_safe_and_the_rollout_ends_early(command):
    rollouts = follow(*robots(size=16), Wild(command))
    check_safe(rollouts)
    assert not any(r.wall_contacts for r in rollouts)
    assert {r.reason for r in rollouts if not r.success} <= {"stalled", "lost"}
    assert sum(r.success for r in rollouts) < 8


def test_a_driver_is_asked_only_for_robots_that_need_actions():
    class Chunks(Feedback):
        asked = []  # noqa: RUF012

        def __call__(self, robots):
            self.asked.append(robots.rows.tolist())
            assert len(robots.positions) == len(robots.previous) == len(robots.goals)
            assert len(robots.tracker.lengths) == len(robots.rows)
            return np.repeat(super().__call__(robots), 2, axis=1)

    rollouts = follow(*robots(size=4), Chunks())
    steps = [len(r.actions) for r in rollouts]
    for row, number in enumerate(steps):
        assert sum(row in rows for rows in Chunks.asked) == -(-number // 2)


class TestObstacles:
    def test_what_is_in_the_way_is_never_touched_and_counted(self):
        """A path right through obstacles: the robot goes as far as it can, and that is told."""
        scenes = [room(np.random.default_rng(i), 3) for i in range(24)]
        env = BlockReach2DVector(24)
        env.reset(seed=0, options={"scene": scenes})
        rollouts = follow(Fleet(env, 0), [bent(s, 0.2) for s in scenes], Feedback())
        check_safe(rollouts)
        assert not any(r.contacts for r in rollouts)
        blocked = [s.margin_at(r.path.trajectory(), 0).min() < -0.01
                   for s, r in zip(scenes, rollouts, strict=True)]  # fmt: skip
        assert 3 < sum(blocked) < 24
        for rollout, scene, in_the_way in zip(rollouts, scenes, blocked, strict=True):
            assert scene.margin_at(rollout.states, 0).min() >= -1e-9
            assert rollout.corrections > 0 or not in_the_way
            assert rollout.success or in_the_way

    def test_a_path_with_clearance_is_followed(self):
        solid = Ball([0.4, 0.45], 0.15)
        scene = lg.Scene(SCENE.start, SCENE.goals, obstacles=[solid])
        env = BlockReach2DVector(8)
        env.reset(seed=0, options={"scene": scene})
        for rollout in follow(Fleet(env, 0), [bent(scene, 0.25)] * 8, Feedback()):
            assert rollout.success
            assert rollout.contacts == rollout.corrections == 0
            assert rollout.deviation.max() < 0.015

    def test_contacts_after_a_push_into_an_obstacle(self):
        solid = Box([0.4, 0.5], [0.3, 0.2])
        scene = lg.Scene([0, 0.5], [[0.8, 0.6], [1, 0.3]], obstacles=[solid])
        env = BlockReach2DVector(16)
        env.reset(seed=0, options={"scene": scene, "push": 0.15})
        rollouts = follow(Fleet(env, 0), [bent(scene, 0.2)] * 16, Feedback())
        pushed = [solid.signed_distance(r.states).min() < -1e-6 for r in rollouts]
        assert 0 < sum(pushed) < 16
        for rollout, inside in zip(rollouts, pushed, strict=True):
            assert (rollout.contacts > 0) == inside
            assert solid.signed_distance(rollout.states[-1]) >= -1e-9


def test_open_loop_falls_short():
    rollouts = follow(*robots(size=16), Replay(LIMIT))
    check_safe(rollouts)
    assert sum(r.success for r in rollouts) < 8


class TestReasons:
    def test_stalled_after_two_seconds_without_progress(self):
        (rollout,) = follow(*robots(size=1), Wild("nothing"))
        assert rollout.reason == "stalled"
        assert len(rollout.actions) * rollout.step_seconds == pytest.approx(2, abs=0.1)

    def test_lost_far_from_the_path(self):
        fleet, _ = robots(size=1, scene=SCENE)
        (rollout,) = follow(fleet, [bent(SCENE, 0)], Wild("away"))
        assert rollout.reason == "lost"
        assert rollout.deviation[-1] > 6 * LIMIT > rollout.deviation[-2]

    def test_time(self):
        env = BlockReach2DVector(2, max_episode_steps=5)
        env.reset(seed=0, options={"scene": SCENE})
        for rollout in follow(Fleet(env, 0), [bent(SCENE, 0)] * 2, Feedback()):
            assert rollout.reason == "time"
            assert len(rollout.actions) == 5


class TestReplanning:
    def straight(self):
        """A planner of straight lines, and the calls to it."""
        calls = []

        def plan(row, rest):
            calls.append((row, rest))
            return bent(lg.Scene(rest.begun.states[-1], rest.begun.scene.goals), 0)

        return plan, calls

    def test_after_a_push(self):
        fleet, paths = robots(push=0.1)
        plan, calls = self.straight()
        rollouts = follow(fleet, paths, Feedback(), replan=plan, tolerance=0.05)
        check_safe(rollouts)
        assert all(r.success for r in rollouts)
        assert calls
        for row, rollout in enumerate(rollouts):
            assert len(rollout.replans) == sum(row == other for other, _ in calls)

    def test_when_the_goal_moves(self):
        fleet, paths = robots(shift=0.1)
        plan, _ = self.straight()
        rollouts = follow(fleet, paths, Feedback(), replan=plan, tolerance=0.05)
        assert all(r.success for r in rollouts)
        assert all(len(r.replans) >= 1 for r in rollouts)
        fleet, paths = robots(shift=0.1)
        assert not all(r.success for r in follow(fleet, paths, Feedback()))

    @pytest.mark.parametrize("options", [{"push": 0.1}, {"shift": 0.1}], ids=str)
    def test_the_planner_is_told_of_the_motion_so_far(self, options):
        fleet, paths = robots(**options)
        plan, calls = self.straight()
        rollouts = follow(fleet, paths, Feedback(), replan=plan, tolerance=0.05)
        told = dict(reversed(calls))  # the first of each robot
        assert len(told) > 3
        for row, rest in told.items():
            rollout, path = rollouts[row], paths[row]
            steps = rollout.replans[0]
            np.testing.assert_array_equal(rest.begun.scene.goals, fleet.scenes[row].goals)
            np.testing.assert_array_equal(rest.begun.scene.start, path.scene.start)
            np.testing.assert_array_equal(rest.begun.states, rollout.states[: steps + 1])
            sent = rollout.actions[steps - 1]
            assert rest.begun.heading == pytest.approx(sent / np.linalg.norm(sent))
            assert rest.path is path
            # What is left of the path lies on it.
            curve = np.clip(path.trajectory(2000), *path.scene.workspace)
            apart = np.linalg.norm(curve - rest.remaining[:, None], axis=-1).min(1)
            assert apart.max() < 2e-3
            assert rest.remaining[-1] == pytest.approx(path.waypoints[-1])

    def test_not_without_a_reason(self):
        fleet, paths = robots()
        rollouts = follow(
            fleet, paths, Feedback(), replan=lambda *_: pytest.fail("it replanned"), tolerance=0.05
        )
        assert all(r.success and not r.replans for r in rollouts)


class TestRefuses:
    def test_a_path_from_elsewhere(self):
        fleet, paths = robots(size=2)
        with pytest.raises(InvalidInputError, match="must start at the robot"):
            follow(fleet, paths[::-1], Feedback())

    @pytest.mark.parametrize(
        ("change", "match"),
        [
            (lambda w: w[:5], "waypoints of shape"),
            (lambda w: np.pad(w, ((0, 0), (0, 1))), "waypoints of shape"),
            (lambda w: w * np.nan, "must be finite"),
        ],
    )
    def test_broken_waypoints(self, change, match):
        fleet, (path,) = robots(size=1)
        broken = Path(
            path.scene, 0, path.legibility, change(path.waypoints), np.False_, path.observer
        )
        with pytest.raises(InvalidInputError, match=match):
            follow(fleet, [broken], Feedback())


def test_jerk_is_that_of_the_positions():
    """Of a parabola none; of x = t³ [m] six."""
    times = np.arange(40)[:, None] * 0.05
    for power, expected in ((1, 0), (2, 0), (3, 6)):
        states = np.concatenate([times**power, 0 * times], axis=-1)
        assert rollout_of(None, states).jerk == pytest.approx(expected, abs=1e-6)
    assert rollout_of(None, states[:3]).jerk == 0
