"""A scene's archive at a glance: ready-made curves take the place of a search.

A library holds, for each cell of the grid of an empty room, the cell's smoothest curve and a few
that run elsewhere. In a scene each cell takes its first curve that keeps clear, where an archive
searches. What is missed are curves that only a search finds, such as those through a narrow gap.

`python -m legibility.motion.library` makes the files of the default detour again.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from safetensors.numpy import load_file, save_file

from ..checks import Array
from ..curves import arc_length, farthest_from_segment
from ..files import atomic_path
from ..frame import Frame
from ..intent.metrics import SCORE_POINTS, score_weights
from ..intent.observer import DEFAULT_OBSERVER, Observer
from ..scene import Scene
from .archive import Archive, shortest_curve
from .bezier import bending_energy, bezier_trajectories, crosses_itself, straight_controls
from .curve_grid import CurveGrid, free, random_controls, reachable, varied_controls, with_ends

_CELLS = {2: 20, 3: 8}  # along the straight line, by dimension
_CURVES = 4  # of a cell at most
_APART = 0.1  # least distance between two of a cell, in lengths of the straight line
_BATCH, _BATCHES = 1024, 150  # random curves to choose from; half of them are variations
_POINTS = 24  # of a curve, at equal arc length, for lengths and scores
_LEAST_COST = 1e-300


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
    grid = CurveGrid(room, 0, detour, _CELLS[dim])
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
            i = rows[far[0]]
            chosen.append(i)
            gap = np.minimum(gap, np.abs(points[rows] - points[i]).max((1, 2)))
    return CurveLibrary(detour, controls[keep[chosen]], cells[chosen])


@functools.lru_cache(maxsize=1024)
@np.errstate(under="ignore")
def rough_archive(scene: Scene, target: int, observer: Observer) -> Archive:
    """The archive of a scene by the curves of its library, in a tenth of the time; cached.

    Raises:
        InvalidSceneError: no curve leads to the target.
    """
    archive = _geometry(scene, target, observer.detour)
    curves = bezier_trajectories(archive.controls, _POINTS)
    potential = observer.field(scene).potential(curves, target)
    scores = -potential @ score_weights(_POINTS, observer.alpha)
    # The last is the motion at ℓ = 0, whose score is that of an archive; the others follow.
    anchor = bezier_trajectories(archive.anchor[None], SCORE_POINTS)
    anchor_score = float(observer.score(anchor, scene, target)[0])
    scores *= anchor_score / min(scores[-1], -_LEAST_COST)
    scores[-1] = anchor_score
    labels = observer.labels(scores, anchor_score)
    return replace(
        archive, observer=observer, scores=scores, labels=labels, anchor_score=anchor_score
    )


@functools.lru_cache(maxsize=256)
def _geometry(scene: Scene, target: int, detour: float) -> Archive:
    """The curves of a scene, the motion at ℓ = 0 last, without scores and labels."""
    library = curve_library(scene.dim, detour)
    anchor, shortest, _ = shortest_curve(scene, target)
    frame, longest = Frame.of(scene, target), detour * shortest
    controls = library.controls
    if shortest > frame.scale:
        # Curves may be longer where the straight line is blocked: stretch them to the new region.
        region, own = (np.ptp(reachable(frame, x), axis=0) for x in (longest, detour * frame.scale))
        middle = np.eye(scene.dim)[0] / 2
        inner = (controls[:, 1:3] - middle) * region / own + middle
        controls = with_ends(inner, controls[0])
    controls = frame.frame_to_world(controls)
    controls[:, [0, -1]] = anchor[[0, -1]]
    first = np.flatnonzero(np.diff(library.cells, prepend=-1))
    last = np.append(first[1:], len(library))
    taken, tried = [np.empty(0, dtype=np.intp)], 0
    while len(first):
        tried += len(first)
        clear = free(scene, target, controls[first])
        if shortest > frame.scale:
            curves = bezier_trajectories(controls[first], _POINTS)
            clear &= arc_length(curves) <= longest
        taken.append(first[clear])
        first, last = first[~clear] + 1, last[~clear]
        first, last = first[first < last], last[first < last]
    controls = np.concatenate([controls[np.sort(np.concatenate(taken))], anchor[None]])
    points = bezier_trajectories(controls, _POINTS)
    nothing = np.zeros(len(controls))
    return Archive(
        scene=scene,
        target=target,
        observer=DEFAULT_OBSERVER,
        controls=controls,
        descriptors=farthest_from_segment(points, scene.start, scene.target(target)),
        energies=bending_energy(controls),
        scores=nothing,
        labels=nothing,
        anchor=anchor,
        anchor_score=0.0,
        num_candidates=tried,
        cells_reached=int(library.cells[-1]) + 1,
    )


def _file(dim: int) -> Path:
    return Path(__file__).with_name(f"curves-{dim}d.safetensors")


def main() -> None:
    """Write the libraries of the default detour into the package."""
    for dim in _CELLS:
        make_library(dim, DEFAULT_OBSERVER.detour).save(_file(dim))


if __name__ == "__main__":
    main()
