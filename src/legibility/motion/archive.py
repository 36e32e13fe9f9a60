"""The quality-diversity archive: all ways to reach a goal, scored and labelled (paper, V.B).

MAP-Elites (Mouret & Clune 2015) over cubic Béziers: random curves first, then variations of the
elites until hardly any new cell fills. A curve belongs to the cell of the workspace that its most
deviating point lies in, and a cell keeps its smoothest curve.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..checks import Array, count, finite_array, positive, seed_or_entropy, target_index
from ..curves import farthest_from_segment
from ..errors import InvalidInputError, InvalidSceneError
from ..intent.field import InformationPotentialField
from ..intent.labels import label_knots
from ..intent.metrics import SCORE_POINTS
from ..intent.observer import DEFAULT_OBSERVER, Observer
from ..scene import Scene
from .bezier import bending_energy, bezier_trajectories, straight_controls

_BATCH = 1024
_REACH = 1 / 3
"""Margin around the workspace in which control points are drawn, as a share of its side: a cubic
Bézier gets three quarters of the way to its control points, so it can touch the walls."""

DEFAULT_CELLS = {2: 48, 3: 16}
"""Cells along each axis of the workspace, by dimension."""


@dataclass(frozen=True, eq=False)
class Archive:
    """The elites of one scene and target, in the order of their cells.

    Attributes:
        scene: the scene.
        target: index of the intended goal.
        observer: whose scores and labels these are.
        controls: `(N, 4, D)` [m], control points of the cubic Béziers.
        trajectories: `(N, T, D)` [m], at equal arc length.
        descriptors: `(N, D)` [m], the most deviating point of each.
        energies: `(N,)` [m²], bending energy, which a cell minimises.
        scores: `(N,)`, `legibility_score`, higher = more legible.
        labels: `(N,)` in [−1, 1].
        straight_score: the straight line's score, where the anchored label is 0.
        num_candidates: curves tried, including those that left the workspace.
        cells_reached: cells that any candidate fell into.
    """

    scene: Scene
    target: int
    observer: Observer
    controls: Array
    trajectories: Array
    descriptors: Array
    energies: Array
    scores: Array
    labels: Array
    straight_score: float
    num_candidates: int
    cells_reached: int

    def __len__(self) -> int:
        return len(self.scores)

    @property
    def field(self) -> InformationPotentialField:
        """The observer's field of the scene."""
        return self.observer.field(self.scene)

    @property
    def coverage(self) -> float:
        """Cells filled, as a share of the cells that any candidate reached."""
        return len(self) / self.cells_reached

    @np.errstate(under="ignore")
    def label_of(self, scores: ArrayLike) -> Array:
        """The achieved label of any scores `(...)`: monotone in the score, clipped to [−1, 1].

        Linear between the archive's scores, through the straight line's at ℓ = 0 if anchored.
        """
        return np.interp(finite_array("scores", scores), *self._knots)

    @np.errstate(under="ignore")
    def score_of(self, labels: ArrayLike) -> Array:
        """The inverse of `label_of`: the score `(...)` at which a label is read."""
        knots, values = self._knots
        return np.interp(finite_array("labels", labels), values, knots)

    @property
    def _knots(self) -> tuple[Array, Array]:
        if self.observer.label == "rank":
            return label_knots(self.scores, self.labels)
        return label_knots(np.append(self.scores, self.straight_score), np.append(self.labels, 0.0))

    def nearest(self, legibility: float) -> int:
        """Index of the trajectory whose label is nearest; of equals, the smoothest."""
        level = float(finite_array("legibility", legibility, ndim=0))
        gaps = np.abs(self.labels - level)
        ties = np.flatnonzero(gaps <= gaps.min() + 1e-12)
        return int(ties[np.argmin(self.energies[ties])])


class CurveGrid:
    """MAP-Elites' container: `cells` along each axis of the workspace, each with its elite."""

    def __init__(self, scene: Scene, target: int, cells: int) -> None:
        self.scene, self.goal = scene, scene.target(target)
        self.low, self.high = scene.workspace
        self.cells = cells
        size = cells**scene.dim
        self.energies = np.full(size, np.inf)
        self.controls = np.zeros((size, 4, scene.dim))
        self.descriptors = np.zeros((size, scene.dim))
        self.reached = np.zeros(size, dtype=bool)

    @property
    def filled(self) -> NDArray[np.intp]:
        """Indices of the cells that hold a curve, rising."""
        return np.flatnonzero(np.isfinite(self.energies))

    def cell_of(self, descriptors: Array) -> NDArray[np.intp]:
        """Flat index `(...)` of the cell of each point `(..., D)`; points outside go to the rim."""
        index = ((descriptors - self.low) / (self.high - self.low) * self.cells).astype(np.intp)
        index = np.clip(index, 0, self.cells - 1)
        return index @ self.cells ** np.arange(len(self.low))[::-1]

    def add(self, controls: Array) -> int:
        """Place `controls (N, 4, D)`; returns how many cells were filled for the first time."""
        trajectories = bezier_trajectories(controls, SCORE_POINTS)
        descriptors = farthest_from_segment(trajectories, self.scene.start, self.goal)
        in_bounds = ((descriptors >= self.low) & (descriptors <= self.high)).all(-1)
        cells = self.cell_of(descriptors)
        self.reached[cells[in_bounds]] = True
        least, most = trajectories.min(axis=1), trajectories.max(axis=1)
        inside = ((least >= self.low) & (most <= self.high)).all(-1)
        controls, descriptors, cells = controls[inside], descriptors[inside], cells[inside]
        energies = bending_energy(controls)
        # The smoothest of each cell in this batch competes with the cell's elite.
        order = np.lexsort((energies, cells))
        cells, first = np.unique(cells[order], return_index=True)
        best = order[first]
        better = energies[best] < self.energies[cells]
        cells, best = cells[better], best[better]
        new = int(np.isinf(self.energies[cells]).sum())
        self.energies[cells], self.controls[cells] = energies[best], controls[best]
        self.descriptors[cells] = descriptors[best]
        return new


@np.errstate(under="ignore")
def build_archive(
    scene: Scene,
    target: int = 0,
    *,
    observer: Observer = DEFAULT_OBSERVER,
    seed: int | np.random.SeedSequence | None = 0,
    cells: int | None = None,
    random_candidates: int = 4096,
    max_candidates: int = 65_536,
    patience: float = 0.002,
) -> Archive:
    """Cover all ways from the start to goal `target` with smooth curves, score and label them.

    Args:
        scene: the scene.
        target: index of the intended goal.
        observer: scores and labels the curves.
        seed: of the random curves; None draws from the system's entropy.
        cells: cells along each axis; `DEFAULT_CELLS` of the dimension if not given.
        random_candidates: curves with random control points, drawn first.
        max_candidates: most curves in all.
        patience: variation ends after four batches in a row whose new cells are fewer than this
            share of those filled.

    Raises:
        InvalidInputError: an argument is out of its range.
    """
    if not isinstance(scene, Scene):
        raise InvalidSceneError(f"scene must be a legibility.Scene, got {type(scene).__name__}")
    target = target_index(target, scene.num_goals)
    if not isinstance(observer, Observer):
        raise InvalidInputError(f"observer must be a legibility.Observer, got {observer!r}")
    cells = count("cells", DEFAULT_CELLS[scene.dim] if cells is None else cells, low=2)
    random_candidates = count("random_candidates", random_candidates)
    max_candidates = count("max_candidates", max_candidates, low=random_candidates)
    positive("patience", patience)
    if not isinstance(seed, np.random.SeedSequence):
        seed = seed_or_entropy("seed", seed)

    rng = np.random.default_rng(seed)
    grid = CurveGrid(scene, target, cells)
    straight = straight_controls(scene.start, grid.goal)
    grid.add(straight[None])
    tried, idle = 1, 0
    while tried < max_candidates and idle < 4:
        size = min(_BATCH, max_candidates - tried)
        exploring = tried < random_candidates
        draw = random_controls(rng, scene, size) if exploring else _varied_controls(rng, grid, size)
        controls = np.tile(straight, (size, 1, 1))
        controls[:, 1:3] = draw
        new = grid.add(controls)
        tried += size
        idle = 0 if exploring or new >= patience * len(grid.filled) else idle + 1

    filled = grid.filled
    controls = grid.controls[filled]
    trajectories = bezier_trajectories(controls, SCORE_POINTS)
    scores = observer.score(trajectories, scene, target)
    straight_score = float(scores[np.argmin(grid.energies[filled])])  # its energy is 0
    return Archive(
        scene=scene,
        target=target,
        observer=observer,
        controls=controls,
        trajectories=trajectories,
        descriptors=grid.descriptors[filled],
        energies=grid.energies[filled],
        scores=scores,
        labels=observer.labels(scores, straight_score),
        straight_score=straight_score,
        num_candidates=tried,
        cells_reached=int(grid.reached.sum()),
    )


def random_controls(rng: np.random.Generator, scene: Scene, size: int) -> Array:
    """Inner control points `(size, 2, D)` drawn uniformly in bounds."""
    low, high = _bounds(scene)
    return rng.uniform(low, high, (size, 2, scene.dim))


def _varied_controls(rng: np.random.Generator, grid: CurveGrid, size: int) -> Array:
    """Inner control points of varied elites (the line operator of Vassiliades & Mouret 2018).

    An elite is moved along its difference from another and by a little isotropic noise.
    """
    low, high = _bounds(grid.scene)
    filled = grid.filled
    parents = grid.controls[rng.choice(filled, size)][:, 1:3]
    others = grid.controls[rng.choice(filled, size)][:, 1:3]
    along = rng.normal(0, 0.2, (size, 1, 1))
    noise = rng.normal(0, 0.02, parents.shape) * (high - low)
    return np.clip(parents + along * (others - parents) + noise, low, high)


def _bounds(scene: Scene) -> tuple[Array, Array]:
    low, high = scene.workspace
    margin = _REACH * (high - low)
    return low - margin, high + margin
