"""A scene's archive at a glance: the curves of a library take the place of a search.

Each cell takes its first curve that keeps clear. Where few do, a short search goes on from them.
What is missed are curves that only a long one finds, such as those through a narrow gap.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..curves import arc_length
from ..frame import Frame
from ..intent.metrics import SCORE_POINTS, score_weights
from ..intent.observer import DEFAULT_OBSERVER, Observer
from ..parts import Parts, cached_parts
from ..scene import Scene
from .archive import Archive, shortest_curve
from .bezier import bending_energy, bezier_trajectories, crosses_itself
from .curve_grid import CurveGrid, free, random_controls, reachable, varied_controls, with_ends
from .library import LIBRARY_CELLS, curve_library

_POINTS = 24  # of a curve, at equal arc length, for lengths and scores
_FEW = 0.5  # share of the library's cells below which a search goes on
_BATCH, _BATCHES, _RANDOM = 1024, 6, 2  # of curves in it, the first of which are random
_LEAST_COST = 1e-300
_AT_ONCE = 512  # curves in a part


@cached_parts(maxsize=1024)
def rough_archive(scene: Scene, target: int, observer: Observer) -> Parts[Archive]:
    """The archive of a scene by the curves of its library, with little search or none; cached.

    Raises:
        InvalidSceneError: no curve to the target was found.
    """
    archive = yield from _geometry.parts(scene, target, observer.detour)
    curves, field = bezier_trajectories(archive.controls, _POINTS), observer.field(scene)
    potential = np.empty(curves.shape[:-1])
    for few in np.array_split(np.arange(len(curves)), -(-len(curves) // _AT_ONCE)):
        potential[few] = field.potential(curves[few], target)
        yield
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


def forget_rough_archives() -> None:
    """Forget cached archives, to time what it takes to make them."""
    for cached in (_geometry, rough_archive):
        cached.cache_clear()


@cached_parts(maxsize=256)
def _geometry(scene: Scene, target: int, detour: float) -> Parts[Archive]:
    """The curves of a scene, the motion at ℓ = 0 last, without scores and labels."""
    library = curve_library(scene.dim, detour)
    anchor, shortest, reach = yield from shortest_curve.parts(scene, target)
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
    yield
    at_once = _AT_ONCE // (4 if scene.obstacles else 1)  # their distance takes its time
    taken, tried, cells = [np.empty(0, dtype=np.intp)], 1, len(first)
    while len(first):
        tried += len(first)
        clear = np.empty(len(first), dtype=bool)
        for few in np.array_split(np.arange(len(first)), -(-len(first) // at_once)):
            clear[few] = free(scene, target, controls[first[few]])
            yield
        if shortest > frame.scale:
            curves = bezier_trajectories(controls[first], _POINTS)
            clear &= (arc_length(curves) <= longest) & ~crosses_itself(controls[first])
        taken.append(first[clear])
        first, last = first[~clear] + 1, last[~clear]
        first, last = first[first < last], last[first < last]
    controls = controls[np.sort(np.concatenate(taken))]
    if len(controls) < _FEW * cells:
        grid = CurveGrid(scene, target, longest, LIBRARY_CELLS[scene.dim], reach)
        found = np.concatenate([controls, anchor[None]])
        for few in np.array_split(found, -(-len(found) // _AT_ONCE)):
            grid.add(few)
            yield
        rng = np.random.default_rng(0)
        for batch in range(_BATCHES):
            draw = random_controls if batch < _RANDOM else varied_controls
            curves = with_ends(draw(rng, grid, _BATCH), anchor)
            yield
            for few in np.split(curves, _BATCH // _AT_ONCE):
                grid.add(few)
                yield
        tried += _BATCHES * _BATCH
        cells = max(cells, int(grid.reached.sum()))
        controls = grid.controls[grid.filled]
        controls = controls[(controls != anchor).any((1, 2))]
    controls = np.concatenate([controls, anchor[None]])
    nothing = np.zeros(len(controls))
    return Archive(
        scene=scene,
        target=target,
        observer=DEFAULT_OBSERVER,
        controls=controls,
        energies=bending_energy(controls),
        scores=nothing,
        labels=nothing,
        anchor=anchor,
        anchor_score=0.0,
        num_candidates=tried,
        cells_reached=cells + 1,  # and that of ℓ = 0
    )
