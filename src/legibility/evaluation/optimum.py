"""How much of what is possible: scores beside the best motion of equal length, and beside a bound.

The best motion is the result of an optimiser, which may have missed a better one. The bound is
certified: no motion of that length, through any obstacles, can score more.
"""

from functools import partial
from typing import Any, NamedTuple

import numpy as np

from ..checks import Array
from ..curves import NUM_WAYPOINTS, arc_length, path_curve, spline_matrix
from ..data.configuration import SceneStream
from ..intent.field import Field
from ..intent.metrics import SCORE_POINTS, score_weights
from ..intent.observer import Observer
from ..models.projection import cost_and_slopes
from ..models.room import CURVE_POINTS, Room
from ..modulator import Modulator
from ..motion.archive import Archive, scene_archive
from ..motion.bezier import bezier_trajectories
from ..parallel import threads
from ..scene import Scene
from ..seeds import plan_seeds
from .common import Progress, each_of, rounded, silent
from .configuration import OptimumConfig
from .eyes import observers
from .statistics import summary

EYES = ("dragan", "gaussian", "paper")
"""The observers that the dial is turned for, of `evaluation.eyes`."""

ENDS = {"1": 1, "-1": -1}
"""The ends of the dial, and the sign of what they maximise."""

_SLACK = 1e-3  # by which an optimum may be longer, and come nearer to a wall, as polylines measure
_GAP = 0.02  # [nat], to which a potential is known in a bound
_ROUNDING = 1e-6  # of lengths
_CELLS, _MOST_CELLS = 8, 50_000  # along each side of the first grid of a bound, and in all


class Bounds(NamedTuple):
    """What motions of at most a length can score.

    Attributes:
        best: the score of the best motion that was found.
        most: a score that none exceeds. At ℓ = −1 both are least instead of most.
    """

    best: float
    most: float


def evaluate_optimum(
    modulator: Modulator,
    config: OptimumConfig,
    *,
    workers: int = 1,
    cluster: str | None = None,
    progress: Progress = silent,
) -> dict[str, Any]:
    """Compare plans at ±1 with the best motions of their length, in empty rooms.

    Arguments as of `evaluate_dial`; the metrics do not depend on the number of workers.

    Returns:
        `rows`: for each of `EYES` and each of `ENDS`, over scenes that have something to gain, the
        share of the way from ℓ = 0 to the best motion, `of_optimum`, and to the bound, `of_bound`,
        of the model's plan and of the archive's best curve within that length, `archive_…`; and
        the `length` of the plan over the straight line; `scenes`: the same of each.
    """
    source = config.stream(modulator.config.dim)
    measure = partial(_measure, modulator, source, config)
    scenes = each_of(range(config.scenes), measure, workers, cluster, progress)
    rows: dict[str, Any] = {}
    for eyes in EYES:
        for end in ENDS:
            found = [scene[eyes][end] for scene in scenes if scene[eyes][end] is not None]
            rows.setdefault(eyes, {})[end] = {
                name: summary(np.array([row[name] for row in found])) for name in found[0]
            } if found else None  # fmt: skip
    return {"rows": rows, "scenes": scenes}


@threads(1)
def _measure(
    modulator: Modulator, source: SceneStream, config: OptimumConfig, index: int
) -> dict[str, Any]:
    scene = source.scene(index)
    (seed,) = plan_seeds(config.seed, index, 1)
    rows: dict[str, Any] = {}
    for eyes, observer in observers(scene, modulator.config.observer).items():
        if eyes not in EYES:
            continue
        archive = scene_archive(scene, 0, observer)
        ends = list(ENDS.values())
        path = modulator.plan(scene, 0, ends, seed=seed, observer=observer, exact=config.exact)
        rows[eyes] = {
            end: _shares(archive, sign, path.waypoints[i], config.starts)
            for i, (end, sign) in enumerate(ENDS.items())
        }
    return {"scene": index, **rounded(rows)}


def _shares(archive: Archive, sign: int, waypoints: Array, starts: int) -> dict[str, float] | None:
    """The metrics of one plan; None where there is nothing worth the name to gain."""
    scene, observer = archive.scene, archive.observer
    curve = path_curve(waypoints, SCORE_POINTS)
    length, score = float(arc_length(curve)), float(observer.score(curve, scene, archive.target))
    found = best_within(archive, sign, length, waypoints, starts)
    lengths = arc_length(archive.trajectories)
    able = lengths <= length * (1 + _SLACK)
    zero = archive.anchor_score
    own = max(sign * archive.scores[able], default=sign * zero)
    gain, most = sign * (found.best - zero), sign * (found.most - zero)
    if gain < 0.05:
        return None
    return {
        "of_optimum": sign * (score - zero) / gain,
        "of_bound": sign * (score - zero) / most,
        "archive_of_optimum": (own - sign * zero) / gain,
        "archive_of_bound": (own - sign * zero) / most,
        "length": length / archive.shortest_length,
    }


def best_within(
    archive: Archive, sign: int, length: float, waypoints: Array, starts: int = 8
) -> Bounds:
    """The best score of motions of at most a length [m] in an empty room, and its bound.

    Args:
        archive: of the scene, whose elites the optimiser starts from.
        sign: 1 for the most legible motions, −1 for the most ambiguous ones.
        length: [m].
        waypoints: `(K + 2, D)` [m], a path to start from as well.
        starts: number of elites to start from.
    """
    scene, target, observer = archive.scene, archive.target, archive.observer
    order = np.argsort(-sign * archive.scores, kind="stable")
    lengths = arc_length(archive.trajectories)
    order = order[lengths[order] <= length * (1 + _SLACK)][: 8 * starts : 8]
    begins = [waypoints, *bezier_trajectories(archive.controls[order], NUM_WAYPOINTS + 2)]
    best = -np.inf
    for begin in begins:
        best = max(best, _optimised(scene, target, observer, sign, length, begin))
    return Bounds(sign * best, bound(scene, target, observer, sign, length))


def _optimised(
    scene: Scene, target: int, observer: Observer, sign: int, length: float, begin: Array
) -> float:
    """The score, times the sign, that a path reaches by sequential quadratic programming."""
    from scipy.optimize import minimize

    room = Room.of(scene, target, observer)
    ends = (begin[[0, -1]] - scene.start) / room.scale
    matrix = spline_matrix(NUM_WAYPOINTS + 2, CURVE_POINTS)
    walls = np.kron(matrix[:, 1:-1], np.eye(scene.dim))
    changes = np.diff(matrix[:, 1:-1], axis=0)
    longest, (low, high) = length / room.scale, room.workspace

    def path(x: Array) -> Any:
        return np.concatenate([ends[:1], x.reshape(-1, scene.dim), ends[1:]])

    def measured(x: Array) -> tuple[Array, Array, Array, Array]:
        return cost_and_slopes((matrix @ path(x))[None], room.field, target, observer.alpha)

    def cost(x: Array) -> tuple[float, Array]:
        value, _, slope, _ = measured(x)
        return sign * float(value[0]), sign * slope[0].ravel()

    def spare(x: Array) -> Any:
        points = matrix @ path(x)
        walls = np.concatenate([points - low, high - points]).ravel()
        return np.append(walls, longest - float(arc_length(points)))

    def spare_slope(x: Array) -> Any:
        stretch = changes.T @ measured(x)[3][0]
        return np.concatenate([walls, -walls, -stretch.reshape(1, -1)])

    first = ((begin[1:-1] - scene.start) / room.scale).ravel()
    found = minimize(
        cost, first, jac=True, method="SLSQP", options={"maxiter": 100, "ftol": 1e-7},
        constraints={"type": "ineq", "fun": spare, "jac": spare_slope},
    )  # fmt: skip
    best = -np.inf
    for x in (first, found.x):
        if np.isfinite(x).all() and spare(x).min() >= -_SLACK:
            curve = path_curve(path(x) * room.scale + scene.start, SCORE_POINTS)
            best = max(best, sign * float(observer.score(curve, scene, target)))
    return best


def bound(scene: Scene, target: int, observer: Observer, sign: int, length: float) -> float:
    """A score that no motion of at most a length [m] exceeds; if the sign is −1, falls below.

    At progress t such a motion is at most tL from the start and (1 − t) L from the target. Branch
    and bound encloses the potential's extreme in that lens, cut by the workspace. The log odds
    against the target, `log(exp(φ) − 1)`, change by at most `steepest` a length.
    """
    room = Room.of(scene, target, observer)
    field = room.field
    gaps = field.goals - field.goals[target]
    steepest = 2 * field.beta + float(np.linalg.norm(gaps @ field.precision, axis=-1).max())
    reach = max(1.0, length / room.scale)
    ends = np.stack([np.zeros(scene.dim), field.goals[target]])

    def extreme(t: float) -> float:
        lens = _Lens(room.workspace, ends, np.array([t, 1 - t]) * reach + _ROUNDING)
        return _extreme(field, target, sign, steepest, lens)

    extremes = np.array([extreme(t) for t in np.linspace(0, 1, SCORE_POINTS).tolist()])
    return -float(score_weights(SCORE_POINTS, observer.alpha) @ extremes)


class _Lens(NamedTuple):
    """Where two balls, about `ends (2, D)` with `radii (2,)`, and a box meet."""

    box: Array
    ends: Array
    radii: Array

    def apart(self, points: Array) -> Array:
        """How far points `(N, D)` are from the farther ball, `(N,)`."""
        return (np.linalg.norm(points[:, None] - self.ends, axis=-1) - self.radii).max(-1)


def _extreme(field: Field, target: int, sign: int, steepest: float, lens: _Lens) -> float:
    """A potential that none in the lens falls below, or if the sign is −1 exceeds."""
    small = int(np.argmin(lens.radii))
    low = np.maximum(lens.box[0], lens.ends[small] - lens.radii[small])
    high = np.minimum(lens.box[1], lens.ends[small] + lens.radii[small])
    half = np.maximum(high - low, _ROUNDING) / (2 * _CELLS)
    axes = [a + h * (2 * np.arange(_CELLS) + 1) for a, h in zip(low, half, strict=True)]
    cells = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(low))
    corners = np.stack(np.meshgrid(*[(-0.5, 0.5)] * len(low)), axis=-1).reshape(-1, len(low))
    while True:
        around = float(np.linalg.norm(half)) * (1 + 1e-9)
        cells = cells[lens.apart(cells) <= around]
        potential = field.potential(cells, target)
        # Near 0 and far above it the logarithm of exp(φ) − 1 is φ's own, or φ.
        odds = np.where(potential > 30, potential, np.log(np.maximum(np.expm1(potential), 1e-300)))
        most = np.logaddexp(0, odds - sign * steepest * around)
        best = int(np.argmin(sign * most))
        if abs(potential[best] - most[best]) <= _GAP or len(cells) > _MOST_CELLS:
            return float(most[best])
        # A cell whose bound another's middle surpasses cannot hold the extreme.
        known = sign * potential[lens.apart(cells) <= 0]
        cells = cells[sign * most <= known.min(initial=np.inf)]
        cells = (cells[:, None] + corners * half).reshape(-1, len(low))
        half = half / 2
