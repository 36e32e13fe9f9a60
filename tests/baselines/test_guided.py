"""The guided policy in closed loop: it keeps away from the other goals, and for how long."""

import dataclasses

import numpy as np
import pytest
import torch

import legibility as lg
from legibility.baselines.guided import GuidedPolicy
from legibility.drivers import RobotStates
from legibility.models.configuration import GoalPolicyConfig
from legibility.models.diffusion import noise_schedule
from legibility.models.goal_policy import GoalPolicy
from legibility.motion.tracking import PathTracker

SCENES = [
    lg.Scene([0, 0.5], [[0.8, 0.6], [1, 0.3]]),
    lg.Scene([0, 0.5], [[1, 0.3], [0.8, 0.6], [0.5, 1.0], [0.2, 0.1]]),
]


def make(**guidance):
    torch.manual_seed(0)
    model = GoalPolicy(GoalPolicyConfig(channels=(8, 16), condition=16, **guidance))
    torch.nn.init.normal_(model.unet.outlet.weight, std=0.3)
    torch.nn.init.normal_(model.no_goal)
    model.signal.copy_(noise_schedule(100))
    return model.eval()


def act(driver, rows=(0, 1)):
    rows = np.array(rows)
    starts = np.stack([s.start for s in SCENES])
    goals = np.stack([s.goals[0] for s in SCENES])
    tracker = PathTracker(np.zeros((2, 10, 2)), 0.05, SCENES[0].workspace)
    return driver(
        RobotStates(rows, starts[rows], starts[rows], goals[rows], tracker.of(rows), 0 * rows)
    )


def test_a_chunk_for_each_robot_that_asks():
    driver = GuidedPolicy(make(guidance=2.0), SCENES, [0, 0], seed=0)
    assert not driver.with_path
    assert act(driver).shape == (2, 4, 2)
    assert act(driver, (1,)).shape == (1, 4, 2)
    np.testing.assert_array_equal(driver.chunks, [1, 2])


@pytest.mark.parametrize("guidance", [0.0, 3.0])
def test_other_goals_count_only_with_guidance(guidance):
    model = make(guidance=guidance)
    moved = [
        dataclasses.replace(s, goals=np.append(s.goals[:1], s.goals[1:] + 0.05, axis=0))
        for s in SCENES
    ]
    first, second = (act(GuidedPolicy(model, s, [0, 0], seed=0)) for s in (SCENES, moved))
    assert np.allclose(first, second) == (guidance == 0)


def test_guidance_falls_with_every_chunk():
    faded = GuidedPolicy(make(guidance=8.0, guidance_decay=0.1), SCENES, [0, 0], seed=0)
    plain = GuidedPolicy(make(), SCENES, [0, 0], seed=0)
    apart = [np.abs(act(faded) - act(plain)).max() for _ in range(7)]
    assert apart[0] > 1e-3
    assert apart[-1] < 1e-3 * apart[0] + 1e-6


def test_robots_do_not_depend_on_their_neighbours():
    """A scene with fewer goals is padded; the padding does not count."""
    model = make(guidance=3.0, guidance_share=0.9)
    both = act(GuidedPolicy(model, SCENES, [0, 0], seed=0))
    alone = GuidedPolicy(model, SCENES[:1], [0], seed=0)
    starts, goals = SCENES[0].start[None], SCENES[0].goals[:1]
    tracker = PathTracker(np.zeros((1, 10, 2)), 0.05, SCENES[0].workspace)
    actions = alone(RobotStates(np.array([0]), starts, starts, goals, tracker, np.array([0])))
    np.testing.assert_allclose(actions[0], both[0], atol=1e-6)
