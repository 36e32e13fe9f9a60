"""The quality-diversity archive: all ways to reach a goal, scored and labelled (paper, V.B).

MAP-Elites (Mouret & Clune 2015) over cubic Béziers: random curves first, then variations of the
elites until hardly any new cell fills. A curve belongs to the cell that its most deviating point
lies in, and a cell keeps its smoothest curve. Curves that touch an obstacle or a wall, that are
longer than the detour allows, or that cross themselves are dropped. The cells lie in the
start–target frame and cover the ellipse of all points that a motion within the detour can reach, so
that a workspace changes a label only where it cuts this region.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..checks import Array, count, finite_array, positive, seed_or_entropy
from ..curves import arc_length, farthest_from_segment, turning
from ..errors import InvalidInputError, InvalidSceneError
from ..frame import Frame
from ..intent.field import Field
from ..intent.labels import label_knots
from ..intent.metrics import SCORE_POINTS
from ..intent.observer import DEFAULT_OBSERVER, Observer
from ..parts import Parts, cached_parts, finished
from ..scene import Scene
from .bezier import bezier_points, bezier_trajectories, crosses_itself, straight_controls
from .curve_grid import (
    LARGEST_REACH,
    REACH,
    CurveGrid,
    draw_bounds,
    free,
    random_controls,
    varied_controls,
    with_ends,
)
from .library import curve_library

_BATCH = 1024
_RANDOM, _MOST, _PATIENCE = 4096, 65_536, 0.002  # defaults of `build_archive`
_FINE = 4 * SCORE_POINTS  # points on which a length is measured
_SHORTEST, _CHILDREN = 8, 128  # curves kept in the search for the shortest, and their variations
_SPREAD = 0.2  # of the first of these, in lengths of the straight line

DEFAULT_CELLS = {2: 28, 3: 11}
"""Cells along the straight line, by dimension."""

_NEAR = 0.05  # greatest distance of labels that count as near to a level

SMALLEST_RANGE = 0.05
"""Nats between the two ends of a side of the dial below which its labels rank little."""


@dataclass(frozen=True, eq=False)
class Archive:
    """The elites of one scene and target, in the order of their cells.

    Attributes:
        scene: the scene.
        target: index of the intended goal.
        observer: whose scores and labels these are.
        controls: `(N, 4, D)` [m], control points of the cubic Béziers.
        energies: `(N,)` [m²], bending energy, which a cell minimises.
        scores: `(N,)`, `legibility_score`, higher = more legible.
        labels: `(N,)` in [−1, 1].
        anchor: `(4, D)` [m], control points of the motion at ℓ = 0: the straight line, or the
            shortest feasible curve where that is blocked.
        anchor_score: its score, where the anchored label is 0.
        num_candidates: curves tried, including those that were dropped.
        cells_reached: cells that any candidate fell into.
    """

    scene: Scene
    target: int
    observer: Observer
    controls: Array
    energies: Array
    scores: Array
    labels: Array
    anchor: Array
    anchor_score: float
    num_candidates: int
    cells_reached: int

    def __len__(self) -> int:
        return len(self.scores)

    @property
    def field(self) -> Field:
        """The observer's field of the scene."""
        return self.observer.field(self.scene)

    @functools.cached_property
    def trajectories(self) -> Array:
        """`(N, T, D)` [m], the curves at equal arc length."""
        return bezier_trajectories(self.controls, SCORE_POINTS)

    @functools.cached_property
    def descriptors(self) -> Array:
        """`(N, D)` [m], the most deviating point of each curve."""
        goal = self.scene.target(self.target)
        return farthest_from_segment(self.trajectories, self.scene.start, goal)

    @property
    def blocked(self) -> bool:
        """Whether something is in the way of the straight line."""
        straight = straight_controls(self.scene.start, self.scene.goals[self.target])
        return not np.array_equal(straight, self.anchor)

    @property
    def range(self) -> tuple[float, float]:
        """How far the scores reach below and above that of ℓ = 0 [nat]."""
        low, high = float(self.scores.min()), float(self.scores.max())
        return max(0.0, self.anchor_score - low), max(0.0, high - self.anchor_score)

    @property
    def degenerate(self) -> bool:
        """Whether a side of the dial spans so little (`SMALLEST_RANGE`) that labels say little."""
        return min(self.range) < SMALLEST_RANGE

    @functools.cached_property
    def shortest_length(self) -> float:
        """Length [m] of the motion at ℓ = 0."""
        return float(arc_length(bezier_trajectories(self.anchor[None], _FINE))[0])

    def seen_by(self, observer: Observer) -> Archive:
        """The same curves, scored and labelled by another observer of the same detour."""
        if not isinstance(observer, Observer):
            raise InvalidInputError(f"observer must be a legibility.Observer, got {observer!r}")
        if observer.detour != self.observer.detour:
            raise InvalidInputError(
                f"the archive holds curves of detour {self.observer.detour:g}, the observer's is "
                f"{observer.detour:g}"
            )
        scores, anchor_score = _scored(
            observer, self.scene, self.target, self.controls, self.trajectories, self.anchor
        )
        labels = observer.labels(scores, anchor_score)
        return replace(
            self, observer=observer, scores=scores, labels=labels, anchor_score=anchor_score
        )

    @property
    def coverage(self) -> float:
        """Cells filled, as a share of the cells that any candidate reached."""
        return len(self) / self.cells_reached

    @np.errstate(under="ignore")
    def label_of(self, scores: ArrayLike) -> Array:
        """The achieved label of any scores `(...)`: monotone in the score, clipped to [−1, 1].

        Linear between the archive's scores, through that of ℓ = 0 if anchored.
        """
        return np.interp(finite_array("scores", scores), *self._knots)

    @np.errstate(under="ignore")
    def score_of(self, labels: ArrayLike) -> Array:
        """The inverse of `label_of`: the score `(...)` at which a label is read."""
        knots, values = self._knots
        return np.interp(finite_array("labels", labels), values, knots)

    @functools.cached_property
    def _knots(self) -> tuple[Array, Array]:
        if self.observer.label == "rank":
            return label_knots(self.scores, self.labels)
        return label_knots(np.append(self.scores, self.anchor_score), np.append(self.labels, 0.0))

    def nearest(self, legibility: float) -> int:
        """Index of the trajectory whose label is nearest; of equals, the smoothest."""
        level = float(finite_array("legibility", legibility, ndim=0))
        gaps = np.abs(self.labels - level)
        ties = np.flatnonzero(gaps <= gaps.min() + 1e-12)
        return int(ties[np.argmin(self.energies[ties])])

    def near(self, level: float) -> NDArray[np.intp]:
        """Indices of the trajectories with labels near a level, or the nearest; smoothest first."""
        gaps = np.abs(self.labels - level)
        near = np.flatnonzero(gaps <= max(_NEAR, gaps.min()))
        return near[np.argsort(self.energies[near], kind="stable")]

    def turning_near(self, level: float) -> Array:
        """Angle [rad] that each of the trajectories near a level turns through."""
        return turning(bezier_points(self.controls[self.near(level)], SCORE_POINTS))


@np.errstate(under="ignore")
def build_archive(
    scene: Scene,
    target: int = 0,
    *,
    observer: Observer = DEFAULT_OBSERVER,
    seed: int | np.random.SeedSequence | None = 0,
    cells: int | None = None,
    random_candidates: int = _RANDOM,
    max_candidates: int = _MOST,
    patience: float = _PATIENCE,
) -> Archive:
    """Cover all ways from the start to goal `target` with smooth curves, score and label them.

    Args:
        scene: the scene.
        target: index of the intended goal.
        observer: scores and labels the curves, and bounds their detour.
        seed: of the random curves; None draws from the system's entropy.
        cells: cells along the straight line; `DEFAULT_CELLS` of the dimension if not given.
        random_candidates: curves with random control points, drawn first.
        max_candidates: most curves in all.
        patience: variation ends after four batches in a row whose new cells are fewer than this
            share of those filled.

    Raises:
        InvalidInputError: an argument is out of its range.
        InvalidSceneError: a motion cannot end at the target, or no curve to it was found.
    """
    if not isinstance(scene, Scene):
        raise InvalidSceneError(f"scene must be a legibility.Scene, got {type(scene).__name__}")
    target = scene.check_target(target)
    if not isinstance(observer, Observer):
        raise InvalidInputError(f"observer must be a legibility.Observer, got {observer!r}")
    cells = count("cells", DEFAULT_CELLS[scene.dim] if cells is None else cells, low=2)
    random_candidates = count("random_candidates", random_candidates)
    max_candidates = count("max_candidates", max_candidates, low=random_candidates)
    positive("patience", patience)
    if not isinstance(seed, np.random.SeedSequence):
        seed = seed_or_entropy("seed", seed)
    return finished(
        _built(scene, target, observer, seed, cells, random_candidates, max_candidates, patience)
    )


def _built(
    scene: Scene,
    target: int,
    observer: Observer,
    seed: int | np.random.SeedSequence,
    cells: int,
    random_candidates: int = _RANDOM,
    max_candidates: int = _MOST,
    patience: float = _PATIENCE,
) -> Parts[Archive]:
    """See `build_archive`."""
    rng = np.random.default_rng(seed)
    anchor, shortest, reach = yield from shortest_curve.parts(scene, target)
    grid = CurveGrid(scene, target, observer.detour * shortest, cells, reach)
    grid.add(anchor[None])
    tried, idle = 1, 0
    while tried < max_candidates and idle < 4:
        size = min(_BATCH, max_candidates - tried)
        exploring = tried < random_candidates
        draw = random_controls if exploring else varied_controls
        new = grid.add(with_ends(draw(rng, grid, size), anchor))
        tried += size
        idle = 0 if exploring or new >= patience * len(grid.filled) else idle + 1
        yield

    filled = grid.filled
    controls = grid.controls[filled]
    trajectories = bezier_trajectories(controls, SCORE_POINTS)
    scores, anchor_score = _scored(observer, scene, target, controls, trajectories, anchor)
    return Archive(
        scene=scene,
        target=target,
        observer=observer,
        controls=controls,
        energies=grid.energies[filled],
        scores=scores,
        labels=observer.labels(scores, anchor_score),
        anchor=anchor,
        anchor_score=anchor_score,
        num_candidates=tried,
        cells_reached=int(grid.reached.sum()),
    )


def _scored(
    observer: Observer,
    scene: Scene,
    target: int,
    controls: Array,
    trajectories: Array,
    anchor: Array,
) -> tuple[Array, float]:
    """The scores of curves `controls (N, 4, D)`, and that of the curve `anchor (4, D)`.

    They are equal, free of rounding, where the curves are.
    """
    curve = bezier_trajectories(anchor[None], SCORE_POINTS)
    scores = observer.score(np.concatenate([trajectories, curve]), scene, target)
    scores, anchor_score = scores[:-1], scores[-1]
    scores[(controls == anchor).all((1, 2))] = anchor_score
    return scores, float(anchor_score)


@cached_parts(maxsize=64)
def shortest_curve(scene: Scene, target: int) -> Parts[tuple[Array, float, float]]:
    """The straight line `(4, D)`, or the shortest feasible curve where it is blocked.

    Variations of the shortest of the library, or of random curves in a region that grows until some
    are feasible.

    Returns:
        The curve, its length [m], and the margin (`REACH`) in which such curves were found.
    """
    straight = straight_controls(scene.start, scene.target(target))
    straight.setflags(write=False)
    frame = Frame.of(scene, target)
    if free(scene, target, straight[None])[0]:
        return straight, frame.scale, REACH
    rng = np.random.default_rng(0)
    best, lengths, reach = np.empty((0, 4, scene.dim)), np.empty(0), REACH

    def keep_shortest(controls: Array) -> None:
        nonlocal best, lengths
        length = arc_length(bezier_trajectories(controls, SCORE_POINTS))
        order = np.argsort(length, kind="stable")
        if len(best) == _SHORTEST:
            order = order[length[order] < lengths[-1]]
        found: list[int] = []
        for few in np.array_split(order, max(1, len(order) // 64)):  # the shortest first
            few = few[free(scene, target, controls[few])]
            found += few[~crosses_itself(controls[few])].tolist()
            if len(found) >= _SHORTEST:
                break
        best = np.concatenate([best, controls[found]])
        lengths = np.concatenate([lengths, length[found]])
        order = np.argsort(lengths, kind="stable")[:_SHORTEST]
        best, lengths = best[order], lengths[order]

    library = curve_library(scene.dim, DEFAULT_OBSERVER.detour)
    for rows in np.array_split(library.by_length, len(library) // 256):
        keep_shortest(library.between(frame, straight, rows))
        yield
        if len(best) == _SHORTEST:
            break
    growth = 1.0
    while len(best) < _SHORTEST and growth <= 32:
        reach = min(growth * REACH, LARGEST_REACH)
        bounds = draw_bounds(scene, target, 2.5 * growth * frame.scale, reach)
        for _ in range(4):
            keep_shortest(with_ends(rng.uniform(*bounds, (_BATCH, 2, scene.dim)), straight))
            yield
        growth *= 2
    if not len(best):
        raise InvalidSceneError(
            f"no curve (a cubic Bézier) was found from the start {scene.start.tolist()} to the "
            f"target goals[{target}] {scene.goals[target].tolist()} past the obstacles and within "
            "the workspace"
        )
    for generation in range(16):
        parents = best[rng.integers(0, len(best), _CHILDREN)][:, 1:3]
        noise = rng.normal(0, _SPREAD * frame.scale * 0.75**generation, parents.shape)
        keep_shortest(with_ends(parents + noise, straight))
        yield
    anchor = best[0]
    anchor.setflags(write=False)
    return anchor, float(lengths[0]), reach


def passable(scene: Scene, target: int) -> bool:
    """Whether some curve leads to goal `target`."""
    try:
        shortest_curve(scene, scene.check_target(target))
    except InvalidSceneError:
        return False
    return True


@cached_parts(maxsize=32)
def _geometry(scene: Scene, target: int, detour: float) -> Parts[Archive]:
    watching = replace(DEFAULT_OBSERVER, detour=detour)
    return (yield from _built(scene, target, watching, 0, DEFAULT_CELLS[scene.dim]))


def forget_archives() -> None:
    """Forget cached archives and shortest curves, to time what it takes to make them."""
    for cached in (shortest_curve, _geometry, scene_archive):
        cached.cache_clear()


@cached_parts(maxsize=64)
def scene_archive(scene: Scene, target: int, observer: Observer) -> Parts[Archive]:
    """The archive of a scene, cached; observers of one detour share its curves."""
    archive = yield from _geometry.parts(scene, target, observer.detour)
    return archive.seen_by(observer)
