"""Paths on which a link of an arm would touch an obstacle are drawn again, or replaced."""

import dataclasses

import numpy as np
import pytest

import legibility as lg
from legibility.drivers import Feedback
from legibility.envs.block_reach_2d import BlockReach2DVector
from legibility.envs.fleet import Fleet
from legibility.errors import InvalidSceneError
from legibility.motion.path import Path, straight_waypoints
from legibility.obstacles import Ball
from legibility.rollout import follow
from legibility.whole_arm import MARGIN, arm_can_pass, drawn_off_obstacles, paths_off_obstacles

OBSERVER = lg.Observer()
PLANE = lg.Scene([0, 0.5], [[0.8, 0.6], [1, 0.3]], obstacles=[Ball([0.5, 0.9], 0.1)])
START, GOALS = [-0.2, -0.2, 0.25], [[0.0, 0.15, 0.06], [0.0, -0.1, 0.06]]
BESIDE = lg.Scene(START, GOALS, obstacles=[Ball([-0.1, -0.02, 0.24], 0.04)])  # in the hand's way
OVER = lg.Scene(START, GOALS, obstacles=[Ball([0.0, 0.15, 0.2], 0.04)])  # over the target


def straight(scene):
    line = straight_waypoints(scene.start, scene.goals[0])
    return Path.through(line, scene, 0, np.array(0.0), OBSERVER)


class TestDrawnAgain:
    class Arms:
        """Three robots; the arm of robot 1 touches on its first paths."""

        size, positions, joint_angles = 3, np.zeros((3, 2)), np.zeros((3, 7))

        def __init__(self, touching, scene=PLANE):
            self.scenes, self.touching, self.asked = [scene] * 3, touching, []

        def plan(self, rows, positions, seed):
            assert len(positions) == len(rows)
            self.asked.append((rows, seed))
            return [straight(self.scenes[0]) for _ in rows]

        def arm_gaps(self, trajectory, row):
            touches = row == 1 and len(self.asked) <= self.touching
            return trajectory, np.full(len(trajectory), -0.01 if touches else np.inf)

        def arm_touches(self, position, row):
            return []

    @pytest.mark.parametrize("touching", [0, 1, 3])
    def test_only_what_touches_is_drawn_again_by_another_seed(self, touching):
        arms = self.Arms(touching)
        paths = paths_off_obstacles(arms, arms.plan, 5)
        assert not any(path.replaced for path in paths)
        assert [rows for rows, _ in arms.asked] == [[0, 1, 2]] + [[1]] * touching
        seeds = [seed for _, seed in arms.asked]
        assert len({*seeds}) == len(seeds)

    def test_the_rest_of_a_motion_is_not_refused(self):
        arms = self.Arms(99)
        found = drawn_off_obstacles(arms, arms.plan, [1, 2], np.zeros((2, 2)), 5)
        assert len(found) == 2
        assert [rows for rows, _ in arms.asked] == [[1, 2], [1], [1], [1]]

    def test_without_a_free_path_it_is_refused(self, monkeypatch):
        monkeypatch.setattr("legibility.whole_arm._free_curves", lambda *_, **__: iter(()))
        arms = self.Arms(99)
        with pytest.raises(InvalidSceneError, match=r"cannot pass .* to the target goals\[0\]"):
            paths_off_obstacles(arms, arms.plan, 5)

    def test_without_obstacles_nothing_is_checked(self):
        arms = self.Arms(99, dataclasses.replace(PLANE, obstacles=()))
        assert len(paths_off_obstacles(arms, arms.plan, 5)) == 3
        assert len(arms.asked) == 1


def test_a_point_passes():
    assert arm_can_pass(BlockReach2DVector, PLANE, OBSERVER)


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
        assert fleet.arm_gaps(line.trajectory(), 0)[1].min() < 0
        paths = paths_off_obstacles(fleet, lambda rows, *_: [line] * len(rows), 0)
        assert paths[0].replaced
        assert paths[0].feasible
        assert fleet.arm_gaps(paths[0].trajectory(), 0)[1].min() > MARGIN / 2
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
            paths_off_obstacles(fleet, lambda rows, *_: [straight(OVER)] * len(rows), 0)
        env.close()

    def test_scenes_that_it_can_pass(self, kind):
        assert arm_can_pass(kind, BESIDE, OBSERVER)
        assert not arm_can_pass(kind, OVER, OBSERVER)
