"""Paths on which a link of an arm would touch an obstacle are drawn again, or replaced."""

import dataclasses

import numpy as np
import pytest
from rooms import BESIDE, OVER

import legibility as lg
from legibility.drivers import Feedback
from legibility.envs.block_reach_2d import BlockReach2DVector
from legibility.envs.fleet import Fleet
from legibility.errors import InvalidInputError, InvalidSceneError
from legibility.motion.path import Path, straight_waypoints
from legibility.obstacles import Ball
from legibility.parts import finished
from legibility.robots.arm import PANDA
from legibility.rollout import follow
from legibility.whole_arm import MARGIN, arm_can_pass, checked_arm, keeps_off, paths_off_obstacles

OBSERVER = lg.Observer()
PLANE = lg.Scene([0, 0.5], [[0.8, 0.6], [1, 0.3]], obstacles=[Ball([0.5, 0.9], 0.1)])


def straight(scene):
    line = straight_waypoints(scene.start, scene.goals[0])
    return Path.through(line, scene, 0, np.array(0.0), OBSERVER)


def least_gap(points, scene):
    """Least gap [m] between the Panda and obstacles with its grasp point at `points (P, 3)`."""
    return PANDA.obstacle_gaps(scene.obstacles, PANDA.postures(points)).min()


class TestDrawnAgain:
    class Touching:
        """An arm that touches an obstacle on the first `times` paths on which it is checked."""

        def __init__(self, times):
            self.left = times

        def postures(self, points, near=None):
            return np.zeros((len(points), 7))

        def obstacle_gaps(self, obstacles, angles):
            return np.full(len(angles), -0.01 if self.left > 0 else 0.1)

        def touches(self, obstacles, position):
            return []

    class Planner:
        """Plans straight lines and counts them as checks of the arm of robot 1."""

        def __init__(self, times, scene=PLANE):
            touching = TestDrawnAgain.Touching(times + 1)
            self.arms, self.scene, self.asked = [None, touching, None], scene, []

        def __call__(self, rows, seed):
            self.asked.append((rows, seed))
            self.arms[1].left -= 1
            return [straight(self.scene) for _ in rows]

    @pytest.mark.parametrize("touching", [0, 1, 3])
    def test_only_what_touches_is_drawn_again_by_another_seed(self, touching):
        plan = self.Planner(touching)
        paths = paths_off_obstacles(plan.arms, plan, 5)
        assert not any(path.replaced for path in paths)
        assert [rows for rows, _ in plan.asked] == [[0, 1, 2]] + [[1]] * touching
        seeds = [seed for _, seed in plan.asked]
        assert len({*seeds}) == len(seeds)

    def test_without_a_free_path_it_is_refused(self, monkeypatch):
        monkeypatch.setattr("legibility.whole_arm._free_curves", lambda *_, **__: iter(()))
        plan = self.Planner(99)
        with pytest.raises(InvalidSceneError, match=r"cannot pass .* to the target goals\[0\]"):
            paths_off_obstacles(plan.arms, plan, 5)

    def test_without_obstacles_nothing_is_checked(self):
        plan = self.Planner(99, dataclasses.replace(PLANE, obstacles=()))
        assert len(paths_off_obstacles(plan.arms, plan, 5)) == 3
        assert len(plan.asked) == 1


def test_a_point_passes():
    assert arm_can_pass(BlockReach2DVector.arm, PLANE, OBSERVER)
    assert finished(keeps_off(None, straight(PLANE)))


class TestCheckedArm:
    def test_an_arm_or_its_name(self):
        assert checked_arm(None, 2) is checked_arm(None, 3) is None
        assert checked_arm("panda", 3) is checked_arm(PANDA, 3) is PANDA

    @pytest.mark.parametrize(
        ("arm", "dim", "match"),
        [
            ("ur5e", 3, "arm must be one of panda, .* got 'ur5e'"),
            (3, 3, r"arm must be a legibility\.Arm or a name, got 3"),
            ("panda", 2, "an arm moves in 3-D, the scene is 2-D"),
        ],
    )
    def test_refuses(self, arm, dim, match):
        with pytest.raises(InvalidInputError, match=match):
            checked_arm(arm, dim)


class TestPanda:
    @pytest.fixture
    def kind(self):
        for extra in ("mujoco", "mink"):
            pytest.importorskip(extra, reason="the extra named panda is not installed")
        from legibility.envs.panda import PandaBlockReachVector

        return PandaBlockReachVector

    def fleet(self, kind, scene):
        env = kind(1)
        env.reset(seed=0, options={"scene": scene, "target": 0})
        return env, Fleet(env, 0)

    def test_the_archive_stands_in_and_its_motion_touches_nothing(self, kind):
        env, fleet = self.fleet(kind, BESIDE)
        line = straight(BESIDE)
        assert line.feasible
        assert not finished(keeps_off(PANDA, line))
        paths = paths_off_obstacles(fleet.arms, lambda rows, *_: [line] * len(rows), 0)
        assert paths[0].replaced
        assert paths[0].feasible
        assert finished(keeps_off(PANDA, paths[0]))
        assert least_gap(paths[0].trajectory(), BESIDE) > MARGIN / 2
        assert abs(paths[0].achieved) < 0.5
        (rollout,) = follow(fleet, paths, Feedback())
        assert rollout.success
        assert rollout.counts["obstacle_contacts"] == rollout.contacts == 0
        env.close()

    def test_the_guard_keeps_the_hand_off_whatever_the_path(self, kind):
        env, fleet = self.fleet(kind, BESIDE)
        (rollout,) = follow(fleet, [straight(BESIDE)], Feedback())
        assert rollout.corrections > 0
        assert rollout.counts["obstacle_contacts"] == rollout.contacts == 0
        env.close()

    def test_what_touches_at_the_target_is_named(self, kind):
        env, fleet = self.fleet(kind, OVER)
        with pytest.raises(InvalidSceneError, match=r"at the target .* touches obstacles\[0\]"):
            paths_off_obstacles(fleet.arms, lambda rows, *_: [straight(OVER)] * len(rows), 0)
        env.close()

    def test_scenes_that_it_can_pass(self, kind):
        assert arm_can_pass(kind.arm, BESIDE, OBSERVER)
        assert not arm_can_pass(kind.arm, OVER, OBSERVER)
