"""Progress along a path, the stretch ahead, and a feedback controller that follows it."""

from __future__ import annotations

import copy

import numpy as np
from numpy.typing import NDArray

from ..checks import Array
from ..curves import arc_length, path_curve, resample

NOMINAL_GAIN = 0.75
"""Share of a commanded displacement that the controller assumes is realised."""

_POINTS = 257
_SEARCH = 33
_LEEWAY = 0.2
_SPEED = 0.5
_APPROACH = 0.5


class PathTracker:
    """Progress along `B` paths, which never falls and grows no faster than the robot moves.

    It is the nearest point of a short stretch ahead, so loops, hairpins and paths that cross
    themselves do not confuse it.

    Args:
        paths: `(B, K + 2, D)` [m], start, waypoints, goal.
        limit: largest displacement of one step along an axis [m].
        workspace: `(2, D)` [m], into which the curves are clipped.

    Attributes:
        lengths: `(B,)` [m], of the curves.
        progress: `(B,)` [m], arc length travelled along them.
    """

    def __init__(self, paths: Array, limit: float, workspace: Array) -> None:
        self.limit = limit
        self.workspace = workspace
        self._curves = self._dense(paths)
        self.lengths = arc_length(self._curves)
        self.progress = np.zeros(len(paths))

    def _dense(self, paths: Array) -> Array:
        return resample(np.clip(path_curve(paths, _POINTS), *self.workspace), _POINTS)

    def replace(self, rows: NDArray[np.intp], paths: Array) -> None:
        """Give `rows` (indices) new `paths (N, K + 2, D)` that start at the robots."""
        self._curves[rows] = self._dense(paths)
        self.lengths[rows] = arc_length(self._curves[rows])
        self.progress[rows] = 0

    def of(self, rows: NDArray[np.intp]) -> PathTracker:
        """A tracker of `rows` (indices) only, with their current progress."""
        part = copy.copy(self)
        for name in ("_curves", "lengths", "progress"):
            setattr(part, name, getattr(self, name)[rows])
        return part

    @np.errstate(under="ignore")
    def points(self, arc: Array) -> Array:
        """Points `(B, P, D)` [m] at arc lengths `(B, P)` [m]; beyond the end it is the goal."""
        size = self._curves.shape[1] - 1
        place = np.clip(arc / self.lengths[:, None], 0, 1) * size
        left = np.minimum(place.astype(np.intp), size - 1)
        rows = np.arange(len(arc))[:, None]
        low, high = self._curves[rows, left], self._curves[rows, left + 1]
        return low + (place - left)[..., None] * (high - low)

    def ahead(self, offsets: Array) -> Array:
        """Points `(B, P, D)` [m] at arc lengths `offsets (P,)` or `(B, P)` [m] ahead."""
        return self.points(self.progress[:, None] + offsets)

    @np.errstate(under="ignore")
    def update(self, positions: Array, previous: Array) -> None:
        """The robots have moved from `previous` to `positions (B, D)` [m]."""
        moved = np.linalg.norm(positions - previous, axis=-1)
        window = 1.5 * moved + _LEEWAY * self.limit
        arc = self.progress[:, None] + window[:, None] * np.linspace(0, 1, _SEARCH)
        gaps = ((self.points(arc) - positions[:, None]) ** 2).sum(-1)
        nearest = np.take_along_axis(arc, gaps.argmin(1)[:, None], axis=1)[:, 0]
        self.progress = np.minimum(nearest, self.lengths)

    @property
    def remaining(self) -> Array:
        """Remaining length `(B,)` [m]."""
        return self.lengths - self.progress

    def distance(self, positions: Array) -> Array:
        """Distance `(B,)` [m] of `positions (B, D)` from the places on the paths."""
        return np.linalg.norm(self.ahead(np.zeros(1))[:, 0] - positions, axis=-1)


@np.errstate(under="ignore")
def feedback_action(tracker: PathTracker, positions: Array) -> Array:
    """Displacements `(B, D)` [m] to a point half the limit ahead on the path, slower at the goal.

    A step beyond the limit is scaled, not clipped.
    """
    step = np.minimum(_SPEED * tracker.limit, _APPROACH * tracker.remaining)
    wanted = (tracker.ahead(step[:, None])[:, 0] - positions) / NOMINAL_GAIN
    return wanted / np.maximum(1, np.abs(wanted).max(-1, keepdims=True) / tracker.limit)
