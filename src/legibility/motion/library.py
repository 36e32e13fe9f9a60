"""Ready-made curves for any scene: those of the archive of an empty room.

A library holds the smoothest curve of each cell of the grid and a few others of the cell that run
elsewhere, which can take its place where it touches something.

`python -m legibility.motion.library` makes the files of the default detour again.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from safetensors.numpy import load_file, save_file

from ..checks import Array
from ..curves import arc_length, farthest_from_segment
from ..files import atomic_path
from ..frame import Frame
from ..intent.metrics import SCORE_POINTS
from ..intent.observer import DEFAULT_OBSERVER
from ..scene import Scene
from .bezier import bending_energy, bezier_trajectories, crosses_itself, straight_controls
from .curve_grid import CurveGrid, random_controls, varied_controls, with_ends

LIBRARY_CELLS = {2: 20, 3: 8}
"""Cells along the straight line, by dimension."""

_CURVES = 4  # of a cell at most
_APART = 0.1  # least distance between two of a cell, in lengths of the straight line
_BATCH, _BATCHES = 1024, 150  # random curves to choose from; half of them are variations


@dataclass(frozen=True, eq=False)
class CurveLibrary:
    """Curves in the start–target frame, `N` of them, cell by cell and the smoothest first.

    Attributes:
        detour: the longest is so many times the straight line.
        controls: `(N, 4, D)`, control points of cubic Béziers.
        cells: `(N,)` int, the cell of each, rising.
    """

    detour: float
    controls: Array
    cells: NDArray[np.intp]

    def __len__(self) -> int:
        return len(self.cells)

    @functools.cached_property
    def by_length(self) -> NDArray[np.intp]:
        """Indices of the curves, the shortest first."""
        lengths = arc_length(bezier_trajectories(self.controls, SCORE_POINTS))
        return np.argsort(lengths, kind="stable")

    def between(self, frame: Frame, ends: Array, rows: NDArray[np.intp]) -> Array:
        """Control points `(M, 4, D)` [m] of some curves in a frame, from and to those of `ends`."""
        return with_ends(frame.frame_to_world(self.controls[rows, 1:3]), ends)

    def save(self, file: Path) -> None:
        """Write the curves to a file of tensors."""
        tensors = {
            "controls": self.controls[:, 1:3].astype(np.float32),
            "cells": self.cells.astype(np.int32),
        }
        with atomic_path(file) as temporary:
            save_file({k: np.ascontiguousarray(v) for k, v in tensors.items()}, temporary)


@functools.lru_cache(maxsize=8)
def curve_library(dim: int, detour: float) -> CurveLibrary:
    """The library of a detour: read from the package, or made in a few seconds."""
    if detour != DEFAULT_OBSERVER.detour:
        return make_library(dim, detour)
    tensors = load_file(_file(dim))
    ends = straight_controls(np.zeros(dim), np.eye(dim)[0])
    controls = with_ends(tensors["controls"].astype(np.float64), ends)
    return CurveLibrary(detour, controls, tensors["cells"].astype(np.intp))


def make_library(dim: int, detour: float) -> CurveLibrary:
    """Choose the curves of a library among random ones and their variations.

    Args:
        dim: 2 or 3.
        detour: length of the longest curve over that of the straight line.
    """
    start, goal, wall = np.zeros(dim), np.eye(dim)[0], np.full(dim, 100.0)
    room = Scene(start, [goal, 5 * np.eye(dim)[1]], [-wall, wall])
    straight = straight_controls(start, goal)
    grid = CurveGrid(room, 0, detour, LIBRARY_CELLS[dim])
    grid.add(straight[None])
    rng = np.random.default_rng(0)
    drawn = [straight[None]]
    for batch in range(_BATCHES):
        draw = random_controls if batch < _BATCHES // 2 else varied_controls
        drawn.append(with_ends(draw(rng, grid, _BATCH), straight))
        grid.add(drawn[-1])
    controls = np.concatenate(drawn)
    trajectories = bezier_trajectories(controls, SCORE_POINTS)
    keep = (arc_length(trajectories) <= detour) & ~crosses_itself(controls)
    keep = np.flatnonzero(keep & (controls != straight).any((1, 2)))
    cells = grid.cell_of(farthest_from_segment(trajectories[keep], start, goal))
    order = np.lexsort((bending_energy(controls[keep]), cells))
    cells, keep = cells[order], keep[order]
    points = trajectories[keep][:, :: SCORE_POINTS // 16]
    chosen: list[int] = []
    for rows in np.split(np.arange(len(cells)), np.flatnonzero(np.diff(cells)) + 1):
        gap = np.full(len(rows), np.inf)
        for _ in range(_CURVES):
            far = np.flatnonzero(gap > _APART)
            if not len(far):
                break
            i = int(rows[far[0]])
            chosen.append(i)
            gap = np.minimum(gap, np.abs(points[rows] - points[i]).max((1, 2)))
    return CurveLibrary(detour, controls[keep[chosen]], cells[chosen])


def _file(dim: int) -> Path:
    return Path(__file__).with_name(f"curves-{dim}d.safetensors")


def main() -> None:
    """Write the libraries of the default detour into the package."""
    for dim in LIBRARY_CELLS:
        make_library(dim, DEFAULT_OBSERVER.detour).save(_file(dim))


if __name__ == "__main__":
    main()
