"""How fast a robot may move: greatest velocities, accelerations and jerks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..checks import Array, finite_array, one_of
from ..errors import InvalidInputError


@dataclass(frozen=True, eq=False)
class Limits:
    """Greatest velocity, acceleration and jerk of each joint of an arm, or of a moving point.

    Attributes:
        velocity: `(J,)` [rad/s], or a number [m/s], the speed of a point.
        acceleration: `(J,)` [rad/s²], or a number [m/s²].
        jerk: `(J,)` [rad/s³], or a number [m/s³].
        braking: `(2, 3, J)`, where the velocity has to fall toward the joints' ends: at an angle q
            it is at most `√(k (end − q)) − c` upward and `√(k (q − end)) − c` downward, of which
            the lesser counts both ways. The rows of either are end [rad], k [rad/s²] and c [rad/s].
        tip: limits of the grasp point of an arm, beside those of its joints.

    Raises:
        InvalidInputError: a limit is not above 0, or their numbers differ.
    """

    velocity: Array
    acceleration: Array
    jerk: Array
    braking: Array | None = None
    tip: Limits | None = None

    def __init__(
        self,
        velocity: ArrayLike,
        acceleration: ArrayLike,
        jerk: ArrayLike,
        braking: ArrayLike | None = None,
        tip: Limits | None = None,
    ) -> None:
        given = {"velocity": velocity, "acceleration": acceleration, "jerk": jerk}
        arrays = {name: finite_array(name, value) for name, value in given.items()}
        for name, array in arrays.items():
            if array.ndim > 1 or array.shape != arrays["velocity"].shape or not array.size:
                shapes = {key: value.shape for key, value in arrays.items()}
                raise InvalidInputError(f"limits must be numbers or lists of one size: {shapes}")
            if (array <= 0).any():
                raise InvalidInputError(f"{name} must be above 0, got {array.min():g}")
            object.__setattr__(self, name, array)
        if braking is not None:
            braking = finite_array("braking", braking)
            if braking.shape != (2, 3, *arrays["velocity"].shape):
                raise InvalidInputError(f"braking must be (2, 3, J), got shape {braking.shape}")
        if tip is not None and (not isinstance(tip, Limits) or tip.velocity.ndim or tip.tip):
            raise InvalidInputError(f"tip must be the Limits of a point, got {tip!r}")
        if not arrays["velocity"].ndim and (tip or braking is not None):
            raise InvalidInputError("the limits of a point have no tip and no braking")
        object.__setattr__(self, "braking", braking)
        object.__setattr__(self, "tip", tip)

    @classmethod
    def named(cls, name: str) -> Limits:
        """The limits of one of `LIMITS`.

        Raises:
            InvalidInputError: there are none of that name.
        """
        return LIMITS[one_of("limits", name, LIMITS)]

    @property
    def joints(self) -> int:
        """J, 0 of a point."""
        return len(self.velocity) if self.velocity.ndim else 0

    def velocity_at(self, positions: Array) -> Array:
        """The greatest velocity at joint angles `positions (T, J)` [rad], `(T, J)`.

        Where it does not hang on them it is `velocity`, and beyond a joint's end it is below 0.
        """
        if self.braking is None:
            return self.velocity
        (high, k_up, c_up), (low, k_down, c_down) = self.braking
        up = np.sqrt(np.maximum(k_up * (high - positions), 0)) - c_up
        down = np.sqrt(np.maximum(k_down * (positions - low), 0)) - c_down
        return np.minimum(np.minimum(up, down), self.velocity)


_PANDA = np.array([15, 7.5, 10, 12.5, 15, 20, 20])

LIMITS = {
    "panda": Limits([2.175] * 4 + [2.61] * 3, _PANDA, 500 * _PANDA),
    "fr3": Limits(
        [2.62, 2.62, 2.62, 2.62, 5.26, 4.18, 5.26], [10.0] * 7, [5000.0] * 7,
        braking=[
            [
                [2.7501, 1.7918, 2.9065, -0.1458, 2.8101, 4.5205, 3.0196],
                [12, 5.17, 7, 8, 34, 11, 34],
                [0.3, 0.2, 0.2, 0.3, 0.35, 0.35, 0.35],
            ],
            [
                [-2.7501, -1.7918, -2.9065, -3.0481, -2.8101, 0.54092, -3.0196],
                [12, 5.17, 7, 8, 34, 11, 34],
                [0.3, 0.2, 0.2, 0.3, 0.35, 0.35, 0.35],
            ],
        ],
    ),
    "moveit-panda": Limits([2.175] * 4 + [2.61] * 3, _PANDA / 4, [300.0] * 7),
    "point": Limits(0.5, 2.0, 20.0),
}  # fmt: skip
"""Limits by name. `panda` and `fr3` are what Franka's control interface enforces on the Panda and
on the Franka Research 3 (frankarobotics.github.io/docs). `moveit-panda` has the accelerations of
MoveIt's configuration of the Panda, a quarter of Franka's, and a cautious jerk. `point` is a point
that moves calmly beside people."""
