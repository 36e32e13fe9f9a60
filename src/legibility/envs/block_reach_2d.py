"""The 2-D block reaching task: a point end effector among coloured blocks, in metres."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..checks import Array, bounded
from .block_reach import BlockReach, BlockReachVector

__all__ = ["BlockReach2D", "BlockReach2DVector"]


class BlockReach2DVector(BlockReachVector):
    """Many `BlockReach2D` at once; see there, and `BlockReachVector` for how they are stepped."""

    dim = 2
    max_displacement = 0.05
    gain_range = (0.65, 0.85)
    lag_range = (0.0, 0.3)
    robot_options = ("gain", "lag")

    def __init__(self, num_envs: int = 1, **settings: Any) -> None:
        super().__init__(num_envs, **settings)
        self._gain, self._lag = np.zeros((2, num_envs, 1))

    @property
    def gains(self) -> Array:
        """`(B,)`, the hidden share of a command that is realised in the end; for analyses."""
        return self._gain[:, 0].copy()

    def _draw_robot(self, rng: np.random.Generator, options: Mapping[str, Any]) -> dict[str, Any]:
        gain, lag = rng.uniform(*self.gain_range), rng.uniform(*self.lag_range)
        return {
            "gain": bounded("gain", options.get("gain", gain), 0, 1),
            "lag": bounded("lag", options.get("lag", lag), 0, self.lag_range[1]),
        }

    def _begin(self, index: int, robot: dict[str, Any]) -> None:
        self._gain[index], self._lag[index] = robot["gain"], robot["lag"]

    def _place(self, index: int, position: Array) -> Array:
        return position

    def _move(
        self, command: Array, noise: Array, alive: NDArray[Any]
    ) -> tuple[Array, NDArray[Any]]:
        low, high = self.workspace
        moved = (1 - self._lag) * self._gain * command + self._lag * self.velocities
        wanted = self.positions + moved
        wall = alive & ((wanted < low - 1e-12) | (wanted > high + 1e-12)).any(-1)
        reached = np.where(alive[:, None], np.clip(wanted + noise, low, high), self.positions)
        return reached, wall

    def _picture(self, index: int) -> NDArray[np.uint8]:
        from .render import draw_scene

        return draw_scene(self.scenes[index], int(self.targets[index]), self.positions[index])


class BlockReach2D(BlockReach):
    """A point end effector moves in the plane toward one of several coloured blocks.

    ## Description
    The plane is the unit square with a margin, `[-0.1, 1.1]²` in metres, seen from above. The
    observer does not know which block is meant; how the robot moves may tell.

    ## Action Space
    `Box(-0.05, 0.05, (2,), float64)`: a commanded displacement [m] for one control step (0.05 s).
    The world realises only part of it, and late, as an end-effector controller does: the robot
    moves by `v' = (1 − λ) γ a + λ v`, v being its last displacement. The gain γ, uniform in
    [0.65, 0.85], and the lag λ, uniform in [0, 0.3], are drawn for each episode and not observed.

    ## Observation Space
    A `Dict`:

    * `position`: `Box((2,))` [m], the end effector.
    * `goals`: `Box((6, 2))` [m], the blocks; rows beyond their number are 0.
    * `present`: `MultiBinary(6)`, which rows are blocks.
    * `target`: `Discrete(6)`, index of the block that is meant.

    ## Rewards
    Minus the distance to the target [m].

    ## Starting State
    A scene of `Scene.random`: start and 2 to 6 blocks anywhere, at least 0.12 of the diagonal
    apart. The robot is at rest.

    ## Episode End
    * Termination: success. The end effector is within 0.02 m of the target's centre and moved by
      at most 0.01 m in this step, so it is at rest or passes slowly (0.2 m/s). The step of a push
      or a shift is no success yet.
    * Truncation: 400 steps.

    `info` has `is_success`, `distance` [m], `speed` [m/s], `wall_contact` (the motion, noise aside,
    would have left the workspace and was stopped at its wall), `disturbed` (a push or a shift in
    this step).

    ## Arguments
    `reset(seed=…, options={…})` takes

    * `scene`: a `Scene` in the default workspace; drawn if not given.
    * `target`: index of the intended goal; 0 if not given.
    * `num_goals`: of a scene that is drawn; 2 to 6 if not given.
    * `noise`: standard deviation [m] of each step's displacement; 0 if not given.
    * `push`: once half the straight line's length is travelled, the robot is displaced by so much
      [m] in a random direction, at most to the wall; 0 if not given.
    * `shift`: the same of the target block; it stays if another is in its place.
    * `gain`, `lag`: γ and λ, to fix what is otherwise drawn.
    """

    batch_type = BlockReach2DVector
