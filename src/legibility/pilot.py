"""What robots do next: their progress along their paths, and when they need new ones."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .checks import Array
from .curves import NUM_WAYPOINTS
from .drivers import Driver, RobotStates
from .errors import InvalidInputError
from .models.continuation import Rest
from .models.projection import Begun
from .motion.path import Path
from .motion.tracking import NOMINAL_GAIN, PathTracker
from .scene import Scene

_PROGRESS = 0.2
_MOVING = 0.1  # least displacement, in limits, that has a direction


class Pilot:
    """Moves `B` robots along their paths, whoever steps them.

    Args:
        paths: a path for each, from its position.
        driver: moves them.
        positions: `(B, D)` [m].
        limit: largest displacement of an action along each axis [m].
        workspace: `(2, D)` [m].

    Attributes:
        paths: that are followed.
        tracker: the robots' places on them.
        positions: `(B, D)` [m].
        displacements: `(B, D)` [m], of the last step.
        deviation: `(B,)` [m], distance from the path.
        idle: `(B,)`, steps since a robot made progress, along its path or without one to the goal.
    """

    def __init__(
        self,
        paths: Sequence[Path],
        driver: Driver,
        positions: Array,
        limit: float,
        workspace: Array,
    ) -> None:
        size = len(paths)
        self.paths, self.driver, self.limit = list(paths), driver, limit
        waypoints = np.stack([path.waypoints for path in paths])
        self.tracker = PathTracker(waypoints, limit, workspace)
        self.goals = waypoints[:, -1].copy()
        self.positions, self.displacements = positions, np.zeros_like(positions)
        self._previous = positions.copy()
        self.deviation = np.zeros(size)
        self.idle = np.zeros(size, dtype=int)
        self._chunks: list[Array] = [np.empty((0, self.goals.shape[1]))] * size
        self._least = np.full(size, np.inf)  # left to go [m] when it last fell by _PROGRESS
        self._sent = np.zeros_like(positions)

    def start(self, positions: Array) -> None:
        """The robots begin at `positions (B, D)` [m], near the starts of their paths."""
        self.positions, self._previous = positions, positions.copy()
        self.deviation = self.tracker.distance(positions)

    def wanted(self, active: NDArray[np.bool_]) -> Array:
        """The next displacement that the driver wants, `(B, D)` [m]; 0 where not `active (B,)`."""
        rows = np.flatnonzero(active & np.array([not len(c) for c in self._chunks]))
        if len(rows):
            robots = RobotStates(
                rows, self.positions[rows], self._previous[rows], self.goals[rows],
                self.tracker.of(rows), self.idle[rows],
            )  # fmt: skip
            for row, chunk in zip(rows, self.driver(robots), strict=True):
                if not len(chunk):
                    raise InvalidInputError(f"the driver {self.driver!r} gave no displacement")
                self._chunks[row] = chunk
        wanted = np.zeros_like(self.positions)
        for row in np.flatnonzero(active):
            wanted[row], self._chunks[row] = self._chunks[row][0], self._chunks[row][1:]
        return wanted

    def moved(self, positions: Array, actions: Array) -> None:
        """The robots are at `positions (B, D)` [m] after `actions (B, D)` [m]."""
        self._previous, self.positions, self._sent = self.positions.copy(), positions, actions
        self.displacements = self.positions - self._previous
        self.tracker.update(self.positions, self._previous)
        self.deviation = self.tracker.distance(self.positions)
        if self.driver.with_path:
            remaining = self.tracker.remaining + self.deviation
        else:
            remaining = np.linalg.norm(self.positions - self.goals, axis=-1)
        closer = remaining < self._least - _PROGRESS * self.limit
        self._least = np.where(closer, remaining, self._least)
        self.idle = np.where(closer, 0, self.idle + 1)

    def rest(self, row: int, scene: Scene, now: Scene, states: Array) -> Rest:
        """What is to be replaced by a new rest of the motion of a robot.

        Args:
            row: of the robot.
            scene: as it is now, with the start of the motion.
            now: the same, whatever its start.
            states: `(T, D)` [m], its positions so far.
        """
        tracker = self.tracker.of(np.array([row]))
        arc = np.linspace(tracker.progress, tracker.lengths, NUM_WAYPOINTS + 2, axis=1)
        # What was sent, as a push is no direction of motion; nothing if the robot stands.
        size = float(np.linalg.norm(self._sent[row]))
        moving = min(size, float(np.linalg.norm(self.displacements[row]))) > _MOVING * self.limit
        heading = self._sent[row] / size if moving else np.zeros_like(self._sent[row])
        return Rest(Begun(scene, states, heading), now, tracker.points(arc)[0], self.paths[row])

    def take(self, row: int, path: Path, *, fresh: bool) -> None:
        """Let a robot follow a path from where it is; its idle steps count from now if `fresh`.

        The driver sees what the robot did by itself in the last step, not by a push.
        """
        self.paths[row] = path
        self.tracker.replace(np.array([row]), path.waypoints[None])
        self.goals[row] = path.waypoints[-1]
        self._chunks[row] = self._chunks[row][:0]
        self._previous[row] = self.positions[row] - NOMINAL_GAIN * self._sent[row]
        if fresh:
            self._least[row], self.idle[row] = np.inf, 0
