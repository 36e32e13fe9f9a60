"""The Franka Panda in both simulators: its limits, its task space and the events counted."""

from abc import abstractmethod
from collections.abc import Sequence
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..checks import Array, finite_array
from ..errors import InvalidInputError
from .block_reach import BlockReachVector

JOINT_LIMITS = np.array([
    [-2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973],
    [2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973],
])  # fmt: skip
"""Least and greatest angle of each joint, `(2, 7)` [rad] (Franka's documentation)."""

VELOCITY_LIMITS = np.array([2.175, 2.175, 2.175, 2.175, 2.61, 2.61, 2.61])
"""Greatest speed of each joint, `(7,)` [rad/s] (Franka's documentation)."""

HOME = np.array([0.0, 0.41, 0.0, -1.85, 0.0, 2.26, 0.79])
"""Angles `(7,)` [rad] at which inverse kinematics start: the gripper down over the table."""

BLOCK = 0.04
"""Edge of a block [m]."""

BASE = np.array([-0.6, 0.0, 0.0])
"""Where the arm stands on the table [m]."""


class ArmVector(BlockReachVector):
    """Many arms, each in its own simulation. A subclass moves them: `_place` and `_drive`.

    The position is that of the grasp point between the fingertips; the gripper points down.
    """

    metadata = {**BlockReachVector.metadata, "render_fps": 25}  # noqa: RUF012
    dim = 3
    max_displacement = 0.02
    block_radius = BLOCK / 2 * 3**0.5
    counted = (
        "table_contacts", "self_collisions", "joint_limit_violations", "velocity_limit_violations",
    )  # fmt: skip
    overshoot = 0.05
    substeps: ClassVar[int] = 20
    """Physics steps in a control step, 2 ms each."""

    @abstractmethod
    def _drive(self, indices: NDArray, targets: Array) -> Array:
        """Send arms `indices (N,)` to `targets (N, D)` [m] for one control step.

        Add to `counts` the physics steps with each event; return the positions reached `(N, D)`.
        """

    def _move(self, command: Array, noise: Array, alive: NDArray) -> tuple[Array, NDArray]:
        low, high = self.workspace
        wanted = self.positions + command
        wall = alive & ((wanted < low - 1e-9) | (wanted > high + 1e-9)).any(-1)
        targets = np.clip(wanted + noise, low, high)
        reached = self.positions.copy()
        if alive.any():
            reached[alive] = self._drive(np.flatnonzero(alive), targets[alive])
        return reached, wall

    def arm_contacts(
        self, trajectories: ArrayLike, indices: Sequence[int] | None = None
    ) -> NDArray[np.int64]:
        """See `BlockReachVector.arm_contacts`.

        Both simulators use the model and the inverse kinematics of MuJoCo, so that obstacles need
        the extra `panda`. The base, which never moves, does not count.

        Raises:
            InvalidInputError: the trajectories or their number are wrong.
            MissingExtraError: MuJoCo is not installed.
        """
        curves = finite_array("trajectories", trajectories, ndim=3, last=3)
        chosen = list(range(self.num_envs)) if indices is None else list(indices)
        if len(chosen) != len(curves):
            raise InvalidInputError(
                f"trajectories must be one for each of {len(chosen)} robots, got {len(curves)}"
            )
        contacts = np.zeros(len(curves), dtype=np.int64)
        for row, (index, curve) in enumerate(zip(chosen, curves, strict=True)):
            if obstacles := self.scenes[index].obstacles:
                from .panda_model import arm_contacts

                contacts[row] = arm_contacts(obstacles, curve)
        return contacts
