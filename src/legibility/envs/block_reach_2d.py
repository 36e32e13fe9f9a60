"""The 2-D block reaching task: a point end effector among coloured blocks, in metres."""

import numpy as np
from numpy.typing import NDArray

from ..checks import Array
from .block_reach import BlockReachVector
from .single import BlockReach


class BlockReach2DVector(BlockReachVector):
    """Many `BlockReach2D`; `BlockReachVector` describes how they are stepped."""

    dim = 2
    max_displacement = 0.05
    block_radius = 0.03 * 2**0.5
    drawn = {"gain": (0.65, 0.85), "lag": BlockReachVector.lag_range}  # noqa: RUF012
    allowed = {"gain": (0.0, 1.0)}  # noqa: RUF012

    def _place(self, index: int, position: Array) -> Array:
        return position

    def _move(self, command: Array, noise: Array, alive: NDArray) -> tuple[Array, NDArray]:
        low, high = self.workspace
        gain, lag = self.hidden["gain"][:, None], self.hidden["lag"][:, None]
        moved = (1 - lag) * gain * command + lag * self.velocities
        wanted = self.positions + moved
        wall = alive & ((wanted < low - 1e-12) | (wanted > high + 1e-12)).any(-1)
        reached = np.where(alive[:, None], np.clip(wanted + noise, low, high), self.positions)
        return reached, wall

    def _picture(self, index: int) -> NDArray[np.uint8]:
        from .render import draw_scene

        return draw_scene(self.scenes[index], int(self.targets[index]), self.positions[index])


class BlockReach2D(BlockReach):
    """A point end effector moves in 2-D toward one of several coloured blocks.

    ## Description
    The workspace is the unit square with a margin, `[-0.1, 1.1]²` in metres, seen from above. The
    observer does not know which block is the target and infers it from the motion. Obstacles of the
    scene are drawn, and contacts with them and with the other blocks are counted, but stop nothing.

    ## Action Space
    `Box(-0.05, 0.05, (2,), float64)`: a commanded displacement [m] for one control step (0.05 s).
    Like an end-effector controller, the robot realises only part of it, with a lag: it moves by
    `v' = (1 − λ) γ a + λ v`, where v is its last displacement. The gain γ, uniform in
    [0.65, 0.85], and the lag λ, uniform in [0, 0.3], are drawn for each episode and not observed.

    ## Observation Space
    A `Dict`:

    * `position`: `Box((2,))` [m], the end effector.
    * `goals`: `Box((6, 2))` [m], the blocks; rows beyond their number are 0.
    * `present`: `MultiBinary(6)`, which rows are blocks.
    * `target`: `Discrete(6)`, index of the intended block.

    ## Rewards
    Minus the distance to the target [m].

    ## Starting State
    A scene of `Scene.random`: start and 2 to 6 blocks anywhere, at least 0.12 of the diagonal
    apart, with the blocks' size as its `goal_radius`. The robot is at rest.

    ## Episode End
    * Termination: success. The end effector is within 0.02 m of the target's centre and moved by
      at most 0.01 m in this step, so it is at rest or passes slowly (0.2 m/s). The step of a push
      or a shift does not count.
    * Truncation: 400 steps.

    `info` has `is_success`, `distance` [m], `speed` [m/s], `wall_contact` (without noise the motion
    would have left the workspace; the wall stopped it), `contact` (this step led into an obstacle,
    or within the scene's `goal_radius` of a block that is not the target), `disturbed` (a push or a
    shift in this step).

    ## Arguments
    `reset(seed=…, options={…})` takes

    * `scene`: a `Scene` in the default workspace; drawn by default.
    * `target`: index of the intended goal; 0 by default.
    * `num_goals`: of a scene that is drawn; 2 to 6 by default.
    * `noise`: standard deviation [m] of each step's displacement; 0 by default.
    * `push`: once half the straight line's length is travelled, the robot is displaced by this
      distance [m] in a random direction, at most to the wall; 0 by default.
    * `shift`: the same for the target block, which stays if something is in its new place.
    * `gain`, `lag`: γ and λ; drawn by default.

    ## Version History
    * v0: the first.
    """

    batch_type = BlockReach2DVector
