"""Limits are those that Franka publishes, and bad ones are refused."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from legibility.errors import InvalidInputError
from legibility.robots.limits import LIMITS, Limits


def test_names():
    assert list(LIMITS) == ["panda", "fr3", "moveit-panda", "point"]
    assert {name: limits.joints for name, limits in LIMITS.items()} == {
        "panda": 7, "fr3": 7, "moveit-panda": 7, "point": 0
    }  # fmt: skip
    panda, careful = Limits.named("panda"), Limits.named("moveit-panda")
    assert panda.jerk == pytest.approx(500 * panda.acceleration)
    assert careful.acceleration == pytest.approx(panda.acceleration / 4)
    with pytest.raises(InvalidInputError, match=r"one of panda, fr3, moveit-panda, point, got 'ur"):
        Limits.named("ur5e")


@given(st.floats(-1, 1), st.integers(0, 6))
def test_a_joint_of_the_fr3_can_brake_before_its_end(share, joint):
    """With the deceleration of the law, k / 2, it stops before it leaves the range."""
    limits = LIMITS["fr3"]
    (high, k, _), (low, *_) = limits.braking[:, :, joint]
    angles = np.array([[0, 0, 0, -1.6, 0, 2.53, 0]])
    angle = angles[0, joint] = (high + low) / 2 + share * (high - low) / 2
    velocity = limits.velocity_at(angles)[0]
    assert velocity[joint] <= limits.velocity[joint]
    assert max(velocity[joint], 0) ** 2 / k <= min(high - angle, angle - low) + 1e-9
    assert velocity[joint] > 0 or abs(share) > 0.98
    others = np.arange(7) != joint
    assert velocity[others] == pytest.approx(limits.velocity[others])


def test_other_velocities_do_not_hang_on_angles():
    limits = LIMITS["panda"]
    assert limits.velocity_at(np.zeros((5, 7))) is limits.velocity


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((0, 1, 1), "velocity must be above 0, got 0"),
        (([1, 1], [1, -2], [1, 1]), "acceleration must be above 0, got -2"),
        (([1, 1], [1, 1], [1]), r"limits must be numbers or lists of one size: .*'jerk': \(1,\)"),
        (([1, 1], [1, 1], np.nan), "jerk must be finite"),
        (([], [], []), "limits must be numbers or lists of one size"),
        (([1, 1], [1, 1], [1, 1], np.ones((2, 3, 3))), r"braking must be \(2, 3, J\), got shape"),
        ((1, 1, 1, None, "fast"), "tip must be the Limits of a point, got 'fast'"),
        ((1, 1, 1, None, LIMITS["panda"]), "tip must be the Limits of a point"),
        ((1, 1, 1, None, LIMITS["point"]), "the limits of a point have no tip and no braking"),
        ((1, 1, 1, np.zeros((2, 3))), "the limits of a point have no tip and no braking"),
    ],
)
def test_refuses(arguments, message):
    with pytest.raises(InvalidInputError, match=message):
        Limits(*arguments)
