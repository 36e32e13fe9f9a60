"""The grid of an archive, and the curves that are drawn for it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..checks import Array
from ..curves import arc_length, farthest_from_segment
from ..frame import Frame
from ..intent.metrics import SCORE_POINTS
from ..scene import TOUCH, Scene
from .bezier import (
    bending_energy,
    bezier_bounds,
    bezier_stretches,
    bezier_trajectories,
    crosses_itself,
)

REACH = 1 / 3
"""Margin in which control points are drawn around the region that curves may reach, as a share of
its side: a cubic Bézier gets three quarters of the way to its control points."""

LARGEST_REACH = 8 / 3  # one with an S-bend gets less than a third of the way

_STRETCHES = (24, 8, 8, 8)  # parts into which a curve, then a stretch near an obstacle, is cut


class CurveGrid:
    """MAP-Elites' container over the region that motions of a length can reach.

    Args:
        scene: the scene.
        target: index of the intended goal.
        longest: length of a curve [m].
        cells: along the straight line.
        reach: margin in which control points are drawn, as a share of the region's side.
    """

    def __init__(
        self, scene: Scene, target: int, longest: float, cells: int, reach: float = REACH
    ) -> None:
        self.scene, self.target, self.goal = scene, target, scene.target(target)
        self.longest, self.frame = longest, Frame.of(scene, target)
        self.low, self.high = reachable(self.frame, longest)
        self.bounds = draw_bounds(scene, target, longest, reach)
        self.cells = np.ceil((self.high - self.low) * cells - 1e-9).astype(np.intp)
        self.cells[1:] |= 1  # odd, so that no border between cells is on the straight line
        size = int(np.prod(self.cells))
        self.energies = np.full(size, np.inf)
        self.controls = np.zeros((size, 4, scene.dim))
        self.reached = np.zeros(size, dtype=bool)

    @property
    def filled(self) -> NDArray[np.intp]:
        """Indices of the cells that hold a curve, rising."""
        return np.flatnonzero(np.isfinite(self.energies))

    def cell_of(self, descriptors: Array) -> NDArray[np.intp]:
        """Flat index `(...)` of the cell of each point `(..., D)` [m]; others go to the rim."""
        share = (self.frame.world_to_frame(descriptors) - self.low) / (self.high - self.low)
        index = np.clip((share * self.cells).astype(np.intp), 0, self.cells - 1)
        return index @ np.append(np.cumprod(self.cells[:0:-1])[::-1], 1)

    def add(self, controls: Array) -> int:
        """Place `controls (N, 4, D)`; returns how many cells were filled for the first time."""
        trajectories = bezier_trajectories(controls, SCORE_POINTS)
        keep = arc_length(trajectories) <= self.longest * (1 + 1e-9)
        controls, trajectories = controls[keep], trajectories[keep]
        descriptors = farthest_from_segment(trajectories, self.scene.start, self.goal)
        cells = self.cell_of(descriptors)
        self.reached[cells[self.scene.contains(descriptors)]] = True
        # Only a curve that is smoother than its cell's elite is worth the other checks.
        energies = bending_energy(controls)
        keep = np.flatnonzero(energies < self.energies[cells])
        keep = keep[~crosses_itself(controls[keep])]
        keep = keep[free(self.scene, self.target, controls[keep])]
        controls, cells, energies = controls[keep], cells[keep], energies[keep]
        # The smoothest of each cell in this batch takes the cell.
        order = np.lexsort((energies, cells))
        cells, first = np.unique(cells[order], return_index=True)
        best = order[first]
        new = int(np.isinf(self.energies[cells]).sum())
        self.energies[cells], self.controls[cells] = energies[best], controls[best]
        return new


def free(scene: Scene, target: int, controls: Array) -> np.ndarray:
    """Whether each curve `controls (N, 4, D)` keeps clear of walls and obstacles, `(N,)` bool.

    A stretch of a curve touches nothing if its ends are together farther from everything solid than
    it is long. Others are cut finer.
    """
    low, high = bezier_bounds(controls)
    clear = scene.contains(low) & scene.contains(high)
    if not scene.obstacles and not scene.goal_radius:
        return clear
    solids, least = scene.solids(target), -TOUCH * scene.diagonal
    rows = np.flatnonzero(clear)
    first, width = np.zeros(len(rows)), 1.0
    for parts in _STRETCHES:
        points = bezier_stretches(controls[rows], first, width, parts + 1)
        distance = solids.distance(points.reshape(-1, scene.dim)).reshape(points.shape[:-1])
        clear[rows[distance.min(-1) < least]] = False
        length = 1.1 * np.linalg.norm(np.diff(points, axis=-2), axis=-1)  # of an arc above a chord
        near = (distance[:, :-1] + distance[:, 1:] < length) & clear[rows, None]
        width /= parts
        row, part = np.nonzero(near)
        rows, first = rows[row], first[row] + width * part
    return clear


def reachable(frame: Frame, longest: float) -> tuple[Array, Array]:
    """Low and high corner in the frame of all points on motions of at most that length [m].

    They lie in an ellipse whose foci are start and target.
    """
    ratio = longest / frame.scale
    half = np.full(len(frame.origin), np.sqrt(max(ratio**2 - 1, 0)) / 2)
    half[0] = ratio / 2
    half = np.maximum(half, 1e-3)  # at a detour of 1 there is the straight line only
    centre = np.zeros(len(half))
    centre[0] = 0.5
    return centre - half, centre + half


def draw_bounds(scene: Scene, target: int, longest: float, reach: float) -> tuple[Array, Array]:
    """Low and high corner [m] of the box from which control points are drawn."""
    frame = Frame.of(scene, target)
    low, high = reachable(frame, longest)
    middle = frame.frame_to_world((low + high) / 2)
    half = np.sqrt((frame.rotation.T**2) @ (high - low) ** 2) / 2 * frame.scale
    low = np.maximum(middle - half, scene.workspace[0])
    high = np.minimum(middle + half, scene.workspace[1])
    return low - reach * (high - low), high + reach * (high - low)


def random_controls(rng: np.random.Generator, grid: CurveGrid, size: int) -> Array:
    """Inner control points `(size, 2, D)` [m] drawn uniformly around the region of a grid."""
    return rng.uniform(*grid.bounds, (size, 2, grid.scene.dim))


def varied_controls(rng: np.random.Generator, grid: CurveGrid, size: int) -> Array:
    """Inner control points of varied elites (the line operator of Vassiliades & Mouret 2018).

    An elite is moved along its difference from another and by a little isotropic noise.
    """
    low, high = grid.bounds
    filled = grid.filled
    parents = grid.controls[rng.choice(filled, size)][:, 1:3]
    others = grid.controls[rng.choice(filled, size)][:, 1:3]
    along = rng.normal(0, 0.2, (size, 1, 1))
    noise = rng.normal(0, 0.02, parents.shape) * (high - low)
    return np.clip(parents + along * (others - parents) + noise, low, high)


def with_ends(inner: Array, anchor: Array) -> Array:
    """Controls `(N, 4, D)` of inner control points `(N, 2, D)` between the ends of `anchor`."""
    controls = np.tile(anchor, (len(inner), 1, 1))
    controls[:, 1:3] = inner
    return controls
