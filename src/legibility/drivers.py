"""Drivers: what turns a place on a path into the next displacements of a robot."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from .checks import Array
from .models.path_policy import Observation, PathPolicy
from .motion.tracking import PathTracker, feedback_action

if TYPE_CHECKING:
    from .models.onnx import OnnxPathPolicy


_IDLE = 5


@dataclass(frozen=True, eq=False)
class RobotStates:
    """The robots that need their next actions, `N` of the `B` that are executed together.

    Attributes:
        rows: `(N,)`, their indices among the `B`.
        positions: `(N, D)` [m].
        previous: `(N, D)` [m], one step before.
        goals: `(N, D)` [m], the intended goals.
        tracker: their places on their paths.
        idle: `(N,)`, steps since they made progress, along the path or without one to the goal.
    """

    rows: NDArray[np.intp]
    positions: Array
    previous: Array
    goals: Array
    tracker: PathTracker
    idle: NDArray[np.intp]


class Driver(Protocol):
    """Moves robots.

    Attributes:
        with_path: whether it follows the path; otherwise progress is measured to the goal.
    """

    with_path: bool

    def __call__(self, robots: RobotStates) -> Iterable[Array]:
        """The next displacements of each robot, N times `(C, D)` [m]."""
        ...


class Policy:
    """Stage 2; with `with_path=False` it sees only the goal.

    All lengths are in limits, so a robot of another limit moves on the same way. One that has made
    no progress for five steps, as at a hairpin, executes half a chunk.
    """

    def __init__(
        self, model: PathPolicy | OnnxPathPolicy, steps: int | None = None, with_path: bool = True
    ) -> None:
        self.model, self.steps, self.with_path = model, steps, with_path

    def __call__(self, robots: RobotStates) -> Iterable[Array]:
        """See `Driver`."""
        config, limit = self.model.config, robots.tracker.limit
        observation = Observation.of(
            robots.positions, robots.previous, robots.goals, limit,
            robots.tracker if self.with_path else None,
        )  # fmt: skip
        chunks = self.model.act(observation, self.steps) * (limit / config.limit)
        long = max(config.execute, config.chunk // 2)
        number = np.where(robots.idle < _IDLE, config.execute, long)
        return [chunk[:n] for chunk, n in zip(chunks, number, strict=True)]


class Feedback:
    """The feedback controller that made the demonstrations."""

    with_path = True

    def __call__(self, robots: RobotStates) -> Array:
        """See `Driver`."""
        return feedback_action(robots.tracker, robots.positions)[:, None]


class Replay:
    """The path's own displacements over a gain, in open loop: once, then the robot stands still.

    Args:
        limit: twice the length of a displacement [m].
        gain: share of a displacement that the robot is assumed to realise.
    """

    with_path = True

    def __init__(self, limit: float, gain: float = 1.0) -> None:
        self.limit, self.gain = limit, gain
        self._sent: set[int] = set()

    def __call__(self, robots: RobotStates) -> Array:
        """See `Driver`."""
        step, tracker = self.limit / 2, robots.tracker
        number = int(np.ceil(tracker.lengths.max() / step)) + 1
        arc = np.minimum(step * np.arange(number), tracker.lengths[:, None])
        actions = np.diff(tracker.points(arc), axis=1) / self.gain
        rows = robots.rows.tolist()
        actions[[row in self._sent for row in rows]] = 0
        self._sent.update(rows)
        return actions
