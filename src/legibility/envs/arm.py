"""An arm in either simulator: its task space, the events counted, and what its links touch."""

from abc import abstractmethod
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from ..checks import Array
from ..robots.arm import PANDA
from .block_reach import BlockReachVector
from .guard import Planes

BLOCK = 0.04
"""Edge of a block [m]."""


class ArmVector(BlockReachVector):
    """Many arms, each in its own simulation. A subclass moves them: `_place` and `_drive`.

    The position is that of the grasp point between the fingertips; the gripper points down.
    Obstacles stop no arm. Whether it touches them is found with MuJoCo's model of it for either
    simulator, so they need the extra `panda`.
    """

    metadata = {**BlockReachVector.metadata, "render_fps": 25}  # noqa: RUF012
    dim = 3
    max_displacement = 0.02
    block_radius = BLOCK / 2 * 3**0.5
    events = (
        "table_contacts", "self_collisions", "joint_limit_violations", "velocity_limit_violations",
    )  # fmt: skip
    counted = (*events, "obstacle_contacts")
    overshoot = 0.05
    substeps: ClassVar[int] = 20
    """Physics steps in a control step, 2 ms each."""
    arm = PANDA

    @abstractmethod
    def _drive(self, indices: NDArray, targets: Array) -> Array:
        """Send arms `indices (N,)` to `targets (N, D)` [m] for one control step.

        Add to `counts` the physics steps with each of `events`; return the positions `(N, D)`.
        """

    def _move(self, command: Array, noise: Array, alive: NDArray) -> tuple[Array, NDArray]:
        low, high = self.workspace
        wanted = self.positions + command
        wall = alive & ((wanted < low - 1e-9) | (wanted > high + 1e-9)).any(-1)
        targets = np.clip(wanted + noise, low, high)
        reached = self.positions.copy()
        if alive.any():
            reached[alive] = self._drive(np.flatnonzero(alive), targets[alive])
            self._count_obstacles(np.flatnonzero(alive).tolist())
        return reached, wall

    def _count_obstacles(self, indices: list[int]) -> None:
        """Count the arms that touch an obstacle at the end of the control step."""
        meeting = [index for index in indices if self.scenes[index].obstacles]
        if not meeting:
            return
        angles = self.joint_angles
        for index in meeting:
            gaps = self.arm.obstacle_gaps(self.scenes[index].obstacles, angles[index : index + 1])
            self.counts["obstacle_contacts"][index] += gaps[0] < 0

    @property
    def planes(self) -> Planes | None:
        """See `BlockReachVector.planes`."""
        if not any(scene.obstacles for scene in self.scenes):
            return None
        return Planes.of([
            next(self.arm.nearby(scene.obstacles, pose[None]))
            for scene, pose in zip(self.scenes, self.joint_angles, strict=True)
        ])  # fmt: skip
