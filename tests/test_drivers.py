"""Drivers: stage 2, the controller that demonstrated, and a replay in open loop."""

import numpy as np
import pytest
import torch

from legibility.drivers import Feedback, Policy, Replay, RobotStates
from legibility.models.configuration import PathPolicyConfig
from legibility.models.diffusion import noise_schedule
from legibility.models.path_policy import PathPolicy
from legibility.motion.tracking import PathTracker, feedback_action

LIMIT = 0.05
WORKSPACE = np.array([[-0.1, -0.1], [1.1, 1.1]])


def paths(bend=0.2):
    """Two paths `(2, 10, 2)`, one to the right that bulges and one straight up."""
    t = np.linspace(0, 1, 10)
    right = np.stack([t, 0.5 + bend * np.sin(np.pi * t)], axis=-1)
    return np.stack([right, np.stack([0 * t, t], axis=-1)])


def states(rows=(0, 1), bend=0.2, moved=0.0, idle=0):
    """The robots of `rows` at the starts of their paths, or `moved` [m] along the first axis."""
    rows, curves = np.array(rows), paths(bend)
    tracker = PathTracker(curves, LIMIT, WORKSPACE).of(rows)
    starts = curves[rows, 0]
    positions, waited = starts + np.array([moved, 0]), np.full(len(rows), idle)
    return RobotStates(rows, positions, starts, curves[rows, -1], tracker, waited)


def drawn(driver, robots):
    """The chunks of the robots in one array."""
    return np.stack(list(driver(robots)))


@pytest.fixture(scope="module")
def network():
    torch.manual_seed(0)
    model = PathPolicy(PathPolicyConfig(channels=(8, 16), condition=16, execute=3))
    torch.nn.init.normal_(model.unet.outlet.weight, std=0.3)
    model.signal.copy_(noise_schedule(100))
    return model.eval().requires_grad_(False)


class TestPolicy:
    def test_a_chunk_for_each_robot_that_asks(self, network):
        driver = Policy(network)
        assert driver.with_path
        assert drawn(driver, states()).shape == (2, 3, 2)
        assert drawn(driver, states((1,))).shape == (1, 3, 2)

    def test_a_robot_that_is_held_gets_half_a_chunk(self, network):
        driver, waiting, held = Policy(network), states(idle=4), states(idle=5)
        assert drawn(driver, waiting).shape == (2, 3, 2)
        assert drawn(driver, held).shape == (2, 4, 2)
        np.testing.assert_array_equal(drawn(driver, held)[:, :3], drawn(driver, waiting))

    def test_a_robot_of_another_limit_moves_on_the_same_way(self, network):
        robots, size = states(moved=0.02), 0.4
        tracker = PathTracker(size * paths(), size * LIMIT, size * WORKSPACE)
        places = (size * x for x in (robots.positions, robots.previous, robots.goals))
        small = RobotStates(robots.rows, *places, tracker, robots.idle)
        chunks = drawn(Policy(network), robots)
        np.testing.assert_allclose(drawn(Policy(network), small), size * chunks, atol=1e-6)
        assert np.abs(chunks).max() > 0.01

    def test_the_same_state_gives_the_same_actions(self, network):
        driver = Policy(network)
        actions = drawn(driver, states())
        torch.manual_seed(7)  # which is no one's concern
        np.testing.assert_array_equal(actions, drawn(driver, states()))
        assert np.abs(actions - drawn(driver, states(moved=0.01))).max() > 1e-4

    def test_it_sees_the_path(self, network):
        bent, straight = (drawn(Policy(network), states(bend=bend)) for bend in (0.2, 0.0))
        assert np.abs(bent - straight)[0].max() > 1e-4
        np.testing.assert_allclose(bent[1], straight[1], atol=1e-6)

    def test_without_the_path_it_sees_the_goal_alone(self, network):
        blind = [Policy(network, with_path=False) for _ in range(2)]
        assert not blind[0].with_path
        bent, straight = (drawn(d, states(bend=b)) for d, b in zip(blind, (0.2, 0.0), strict=True))
        np.testing.assert_array_equal(bent, straight)

    def test_steps_of_the_sampler(self, network):
        own, more = (drawn(Policy(network, steps), states()) for steps in (None, 20))
        same = drawn(Policy(network, network.config.sampling_steps), states())
        np.testing.assert_array_equal(own, same)
        assert np.abs(own - more).max() > 1e-4


def test_feedback_is_the_controllers_next_action():
    robots = states(moved=0.01)
    actions = Feedback()(robots)
    assert actions.shape == (2, 1, 2)
    np.testing.assert_array_equal(actions[:, 0], feedback_action(robots.tracker, robots.positions))


class TestReplay:
    @pytest.mark.parametrize("gain", [1.0, 0.75])
    def test_the_displacements_of_the_path_over_the_gain(self, gain):
        robots = states()
        actions = Replay(LIMIT, gain)(robots)
        places = robots.positions[:, None] + gain * np.cumsum(actions, axis=1)
        np.testing.assert_allclose(places[:, -1], robots.goals, atol=1e-9)
        lengths = gain * np.linalg.norm(actions, axis=-1)
        assert lengths.max() <= LIMIT / 2 * (1 + 1e-4)
        previous = robots.positions
        for place in places.swapaxes(0, 1):
            robots.tracker.update(place, previous)
            assert robots.tracker.distance(place).max() < 1e-3
            previous = place

    def test_once(self):
        driver = Replay(LIMIT)
        assert driver(states((0,))).any()
        again = driver(states())
        assert not again[0].any()
        assert again[1].any()
        assert not driver(states()).any()

    def test_it_never_looks(self):
        np.testing.assert_array_equal(Replay(LIMIT)(states()), Replay(LIMIT)(states(moved=0.1)))
