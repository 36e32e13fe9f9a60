"""Projection: moves paths out of contact and keeps, or meets, their legibility score.

A path may be the rest of a motion under way: then the score is that of the whole motion, and the
path starts in the direction of motion.

A path's curve is a spline, linear in its K inner waypoints. So one step of Gauss–Newton on them is
a small linear system, solved for many paths at a time. It weighs contact along the curve, the error
of the score, excess length, jerk, the turn at the start, and the change of the second differences,
which keeps the shape.
"""

from __future__ import annotations

import functools
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ..checks import Array
from ..curves import NUM_WAYPOINTS, arc_length, resample, spline_matrix
from ..intent.field import Field
from ..intent.observer import Observer
from ..parts import Parts, finished
from ..scene import Scene
from .room import CURVE_POINTS, PAD, SLACK, Room

_PARTS = 32  # of a step between two points of a curve, where it is near to something
_CONTACT, _LENGTH, _TURN = 10.0, 1000.0, 1000.0  # weights of squares
_STIFF, _SUPPLE = (300.0, 60.0), (30.0, 3.0)  # those of score and jerk
_MISSED = 0.02  # error of log(−score) of a stiff path above which a supple one is tried
_GROWTH = 1.7  # of the weight of contact from step to step
_STEPS, _AT_ONCE = 10, 2  # at most, and in a part
_LONGEST_STEP, _LARGEST_ERROR = 0.15, 0.5
_TOLERANCE = 1e-3  # of log(−score)
_LEAST_COST = 1e-12
_STRAIGHT = 0.03  # turn [rad] at the start that is not worth another step
_TOUCHING = 1e6  # merit of a path in contact
_TINY = 1e-30
_SMOOTHING = 0.3  # λ of `smoothed`


class Begun(NamedTuple):
    """A motion under way.

    Attributes:
        scene: in which the observer sees it: with the start of the motion.
        states: `(T, D)` [m], the positions so far; the last is the present one.
        heading: `(D,)`, direction of motion of length 1, or 0 at rest.
    """

    scene: Scene
    states: Array
    heading: Array


def smoothed(paths: Array) -> Array:
    """Paths `(B, K + 2, D)` without the waves that a network may draw; the ends stay.

    The waypoints x of least `‖x − drawn‖² + λ ‖third differences of x‖²`: a zigzag keeps a
    fifteenth of its size away from the ends, a bow over the whole path changes by 3 % at most.
    """
    return np.concatenate([paths[:, :1], _smoother() @ paths, paths[:, -1:]], axis=1)


@functools.lru_cache(maxsize=1)
def _smoother() -> np.ndarray:
    """`(K, K + 2)`."""
    third = np.diff(np.eye(NUM_WAYPOINTS + 2), n=3, axis=0)
    stiff = _SMOOTHING * third.T @ third
    inner = slice(1, -1)
    right = -stiff[inner]
    right[:, inner] = 0
    right += np.eye(NUM_WAYPOINTS + 2)[inner]
    return np.linalg.solve(np.eye(NUM_WAYPOINTS) + stiff[inner, inner], right)


def project(
    paths: Array,
    scene: Scene,
    target: int,
    observer: Observer,
    wanted: Array | None = None,
    longest: float | None = None,
    begun: Begun | None = None,
    waves: bool = False,
) -> tuple[Array, np.ndarray]:
    """Paths moved out of contact that have the score wanted, and whether each is out of it.

    A path that keeps clear by `SLACK` and has its score is returned as it is. One that cannot be
    made so is returned as near to it as was found.

    Args:
        paths: `(B, K + 2, D)` [m], from the start to the goal.
        scene: the scene.
        target: index of the intended goal.
        observer: whose score it is.
        wanted: `(B,)`, the score that each path should have; its own if not given.
        longest: length [m] that is allowed; the length is free if it is not given.
        begun: the motion that the paths go on with; their scene starts at its last position. Score
            and length are those of the whole.
        waves: whether the waves of a path are kept, too, and not smoothed.

    Returns:
        `(B, K + 2, D)` [m], and whether each keeps clear by that much, `(B,)` bool.
    """
    return finished(projected(paths, scene, target, observer, wanted, longest, begun, waves))


def projected(
    paths: Array,
    scene: Scene,
    target: int,
    observer: Observer,
    wanted: Array | None = None,
    longest: float | None = None,
    begun: Begun | None = None,
    waves: bool = False,
) -> Parts[tuple[Array, np.ndarray]]:
    """`project` in parts."""
    room = Room.of(scene, target, observer)
    if begun is not None:
        seen = observer.field(begun.scene).seen_from(scene.start, room.scale)
        room = replace(room, field=seen)
    drawn = (paths - scene.start) / room.scale
    task = _Task(room, drawn, wanted, observer, longest, begun, waves)
    rows = np.arange(len(paths))
    best, merit = yield from _descend(task, task.drawn, rows, task.first)
    rows = np.flatnonzero(merit > _MISSED)
    if len(rows):
        yield
        more, merits = yield from _descend(task, task.drawn[rows], rows, weights=_SUPPLE)
        better = merits < merit[rows]
        best[rows[better]], merit[rows[better]] = more[better], merits[better]
    rows = np.flatnonzero(merit >= _TOUCHING)
    if len(rows):
        yield
        more, merits = yield from _descend(task, best[rows], rows, weights=(0.0, _SUPPLE[1]))
        better = merits < merit[rows]
        best[rows[better]], merit[rows[better]] = more[better], merits[better]
    moved = (best != task.drawn).any((-2, -1))
    result = paths.copy()
    result[moved, 1:-1] = best[moved, 1:-1] * room.scale + scene.start
    return result, merit < _TOUCHING


def cost_and_slopes(
    points: Array, field: Field, target: int, alpha: float
) -> tuple[Array, Array, Array, Array]:
    """`−L_p` (paper, eq. 4) and length of motions `(B, P + T, D)` that end in curves, `(B,)` each.

    And the gradient `(B, K, D)` of the first in the waypoints of the curves, the last T points, and
    the tangents `(B, T − 1, D)`, the gradient of the length in their steps. As `legibility_score`,
    which resamples the motion, to 0.001.
    """
    potential, slope = field.potential_and_gradient(points, target)
    steps = points[:, 1:] - points[:, :-1]
    lengths = np.sqrt(np.einsum("btd,btd->bt", steps, steps) + _TINY)
    progress = np.zeros(potential.shape)
    np.cumsum(lengths, axis=1, out=progress[:, 1:])
    length = progress[:, -1].copy()
    progress /= length[:, None]
    decay = np.exp(-alpha * progress)
    width = np.empty_like(progress)  # twice that of the trapezoidal rule
    np.subtract(progress[:, 2:], progress[:, :-2], out=width[:, 1:-1])
    width[:, 0], width[:, -1] = progress[:, 1], 1 - progress[:, -2]
    weights = decay * width
    total = weights.sum(-1, keepdims=True)
    weights /= total
    cost = np.einsum("bt,bt->b", weights, potential)
    # The weights' own derivative: a step that grows shifts the progress of all points.
    over = potential - cost[:, None]
    density = decay * over / total
    shift = -alpha * weights * over
    shift[:, 1:-1] += density[:, :-2] - density[:, 2:]
    shift[:, [0, -1]] = 0
    after = np.cumsum(shift[:, :0:-1], axis=1)[:, ::-1]
    after -= np.einsum("bt,bt->b", shift, progress)[:, None]
    after /= length[:, None]
    first = points.shape[1] - CURVE_POINTS
    tangents = steps[:, first:] / lengths[:, first:, None]
    matrices = _matrices(points.shape[-1], 0.0)
    slope = matrices.spline.T @ (weights[..., None] * slope)[:, first:]
    slope += matrices.change.T @ (after[:, first:, None] * tangents)
    return np.maximum(cost, _LEAST_COST), length, slope, tangents


class _Curves(NamedTuple):
    """The curves of paths, with T points each.

    Attributes:
        points: `(B, T, D)`.
        gap: `(B, T)`, distance from solids less the pad.
        normal: `(B, T, D)`, its gradient.
        error: `(B,)`, of log(−score).
        slope: `(B, K D)`, its gradient in the waypoints.
        excess: `(B,)`, log of the length over the longest allowed.
        stretch: `(B, K D)`, its gradient.
    """

    points: Array
    gap: Array
    normal: Array
    error: Array
    slope: Array
    excess: Array
    stretch: Array


class _Task:
    """What paths in a room should become.

    Attributes:
        drawn: `(B, K + 2, D)`, as they are.
        cost: `(B,)`, log(−score) wanted.
        longest: `(B,)`, log of the length allowed.
        waves: whether the third differences drawn are kept, and not made small.
        before: `(P, D)`, points of the motion so far.
        heading: `(D,)`, direction in which they start; 0 if any will do.
        first: their curves.
    """

    def __init__(
        self,
        room: Room,
        drawn: Array,
        wanted: Array | None,
        observer: Observer,
        longest: float | None,
        begun: Begun | None,
        waves: bool,
    ) -> None:
        self.room, self.drawn, self.alpha, self.waves = room, drawn, observer.alpha, waves
        self.before, self.heading = np.empty((0, drawn.shape[-1])), np.zeros(drawn.shape[-1])
        if begun is not None:
            self.heading = begun.heading
            states = (begun.states - begun.states[-1]) / room.scale
            if arc_length(states) > _TINY:
                self.before = resample(states, CURVE_POINTS)[:-1]
        self.cost = self.longest = np.zeros(len(drawn))
        first = self.curves(drawn, np.arange(len(drawn)))
        self.cost = first.error
        if wanted is not None:
            self.cost = np.log(np.maximum(-wanted, _LEAST_COST))
        self.longest = np.full(len(drawn), np.inf)
        if longest is not None:
            self.longest[:] = np.log(longest / room.scale)
        self.first = first._replace(
            error=first.error - self.cost, excess=first.excess - self.longest
        )

    def curves(self, paths: Array, rows: np.ndarray) -> _Curves:
        """The curves of `paths (B, K + 2, D)`, of which each is of one of the `rows (B,)`."""
        room, size = self.room, NUM_WAYPOINTS * paths.shape[-1]
        matrices = _matrices(paths.shape[-1], 0.0)
        points = motion = matrices.curve @ paths
        if len(self.before):
            before = np.broadcast_to(self.before, (len(paths), *self.before.shape))
            motion = np.concatenate([before, points], axis=1)
        cost, length, slope, tangents = cost_and_slopes(motion, room.field, room.target, self.alpha)
        # Near enough for contact between two points, or for the pad.
        reach = max(PAD, 2 * length.max() / CURVE_POINTS)
        gap, normal = room.nearest(points.reshape(-1, points.shape[-1]), reach)
        excess = np.log(length) - self.longest[rows]
        stretch = np.zeros((len(paths), size))
        if (excess > 0).any():
            stretch = (matrices.change.T @ tangents).reshape(-1, size) / length[:, None]
        return _Curves(
            points,
            gap.reshape(points.shape[:-1]) - room.pad,
            normal.reshape(points.shape),
            np.log(cost) - self.cost[rows],
            slope.reshape(-1, size) / cost[:, None],
            excess,
            stretch,
        )

    def merit(self, paths: Array, curves: _Curves, below: Array) -> Array:
        """How far each of `paths (B, K + 2, D)` is from what it should be, `(B,)`.

        The error of its score, or at least `_TOUCHING` if it touches anything; where it is not less
        than `below (B,)` it may be too low.
        """
        room = self.room
        clear = np.minimum(curves.gap + room.pad, room.to_walls(curves.points))
        worst = (clear - room.slack).min(-1)
        merit = np.abs(curves.error) + 10 * np.maximum(curves.excess, 0)
        if self.heading.any():
            merit += np.maximum(start_turns(paths, self.heading) - _STRAIGHT, 0)
        check = (worst >= 0) & (merit < below)
        if check.any():
            # Between two points, where they are so near to something that the curve could touch it.
            steps = curves.points[:, 1:] - curves.points[:, :-1]
            apart = np.sqrt(np.einsum("btd,btd->bt", steps, steps))
            near = clear[:, 1:] + clear[:, :-1] < 1.1 * apart + 2 * SLACK
            row, step = np.nonzero(near & check[:, None])
            if len(row):
                between = _matrices(paths.shape[-1], 0.0).between[step] @ paths[row]
                slack = np.minimum(room.slack[1:], room.slack[:-1])[step]
                np.minimum.at(worst, row, room.clearance(between).min(-1) - slack)
        return np.where(worst < 0, _TOUCHING - worst, merit)

    def step(
        self,
        paths: Array,
        rows: np.ndarray,
        curves: _Curves,
        contact: float,
        weights: tuple[float, float],
    ) -> Array:
        """The paths after a step of Gauss–Newton, given the weights of contact, score and jerk."""
        room, dim, (score, jerk) = self.room, paths.shape[-1], weights
        size, matrices = NUM_WAYPOINTS * dim, _matrices(dim, jerk)
        points, gap, normal, error, slope, excess, stretch = curves
        error = np.clip(error, -_LARGEST_ERROR, _LARGEST_ERROR)
        # The score yields to contact.
        trust = np.where((gap + room.pad).min(-1) < 0, score * _CONTACT / contact, score)
        system = matrices.stiffness + (trust[:, None] * slope)[:, :, None] * slope[:, None, :]
        pull = matrices.smooth if self.waves else matrices.shape
        force = (pull @ self.drawn[rows] - matrices.smooth @ paths).reshape(-1, size)
        force -= (trust * error)[:, None] * slope
        if (excess > 0).any():
            weight = _LENGTH * (excess > 0)[:, None]
            system += weight[..., None] * stretch[:, :, None] * stretch[:, None, :]
            force -= weight * excess[:, None] * stretch
        if self.heading.any():
            aside = np.eye(dim) - np.outer(self.heading, self.heading)
            outward = _TURN * matrices.start[1:-1]
            system += np.kron(np.outer(outward, matrices.start[1:-1]), aside)
            sideways = (matrices.start @ paths) @ aside
            force -= (outward[:, None] * sideways[:, None]).reshape(-1, size)
        # A matrix and a vector at each point, of the solids and of the walls.
        active = normal * (gap < 0)[..., None]
        metric = active[..., :, None] * active[..., None, :]
        push = np.clip(points, room.low, room.high) - points
        metric[..., range(dim), range(dim)] += push != 0
        push -= active * gap[..., None]
        dense = metric.reshape(len(paths), CURVE_POINTS, -1).swapaxes(1, 2) @ matrices.outer
        dense = dense.reshape(-1, dim, dim, NUM_WAYPOINTS, NUM_WAYPOINTS)
        system += contact * dense.transpose(0, 3, 1, 4, 2).reshape(-1, size, size)
        force += contact * (matrices.spline.T @ push).reshape(-1, size)
        change = np.linalg.solve(system, force[..., None]).reshape(-1, NUM_WAYPOINTS, dim)
        most = np.abs(change).max((1, 2), keepdims=True)
        paths = paths.copy()
        paths[:, 1:-1] += change * np.minimum(1, _LONGEST_STEP / np.maximum(most, _TINY))
        return paths


def start_turns(paths: Array, heading: Array) -> Array:
    """Angles `(B,)` [rad] between a direction `(D,)` and that in which `paths` set out."""
    tangents = _matrices(paths.shape[-1], 0.0).start @ paths
    along = tangents @ heading
    aside = np.linalg.norm(tangents - along[:, None] * heading, axis=-1)
    return np.arctan2(aside, along)


def headed(paths: Array, heading: Array) -> Array:
    """Paths `(B, K + 2, D)` bent so that they set out in a direction `(D,)` of length 1.

    Their ends stay; so do all of them if the direction is 0.
    """
    if not heading.any():
        return paths
    start = _matrices(paths.shape[-1], 0.0).start
    places = np.linspace(0, 1, NUM_WAYPOINTS + 2)
    bend = places * (1 - places) ** 3
    tangents = start @ paths
    speeds = np.linalg.norm(tangents, axis=-1, keepdims=True)
    return paths + bend[:, None] / (start @ bend) * (speeds * heading - tangents)[:, None]


def _descend(
    task: _Task,
    paths: Array,
    rows: np.ndarray,
    curves: _Curves | None = None,
    weights: tuple[float, float] = _STIFF,
) -> Parts[tuple[Array, Array]]:
    """The best paths on the way from `paths (B, K + 2, D)`, and their merits `(B,)`.

    Args:
        task: what they should become.
        paths: each of one of the `rows (B,)`.
        rows: of the task.
        curves: theirs, if known.
        weights: of score and jerk.
    """
    best, merit = paths.copy(), np.full(len(paths), np.inf)
    left, before = np.arange(len(paths)), np.full(len(paths), np.inf)
    for i in range(_STEPS + 1):
        if i and i % _AT_ONCE == 0:
            yield
        if i or curves is None:
            curves = task.curves(paths, rows)
        found = task.merit(paths, curves, merit[left])
        better = found < merit[left]
        into = left[better]
        best[into], merit[into] = paths[better], found[better]
        going = found > _TOLERANCE
        if i > 3:  # a path that is free and hardly improves stays
            going &= (found >= _TOUCHING) | (found < 0.7 * before[left])
        before[left] = found
        if i == _STEPS or not going.any():
            break
        if not going.all():
            left, paths, rows = left[going], paths[going], rows[going]
            curves = _Curves(*(x[going] for x in curves))
        paths = task.step(paths, rows, curves, _CONTACT * _GROWTH ** max(0, i - 2), weights)
    return best, merit


class _Matrices(NamedTuple):
    """Constants of paths in D dimensions.

    Attributes:
        curve: `(T, K + 2)`, of the points.
        between: `(T − 1, P − 1, K + 2)`, of points between them.
        spline: `(T, K)`, of the waypoints' part of the points.
        change: `(T − 1, K)`, of the steps between points.
        outer: `(T, K K)`, outer products of the spline's rows.
        start: `(K + 2,)`, the derivative at the start, between two waypoints 1.
        shape: `(K, K + 2)`, gradient of half the squared second differences.
        smooth: `(K, K + 2)`, the same with that of the third ones.
        stiffness: `(K D, K D)`, of both.
    """

    curve: Array
    between: Array
    spline: Array
    change: Array
    outer: Array
    start: Array
    shape: Array
    smooth: Array
    stiffness: Array


@functools.lru_cache(maxsize=8)
def _matrices(dim: int, jerk: float) -> _Matrices:
    """Those of `dim` dimensions, given the weight of jerk, which only the last two depend on."""
    fine = spline_matrix(NUM_WAYPOINTS + 2, _PARTS * (CURVE_POINTS - 1) + 1)
    curve = np.ascontiguousarray(fine[::_PARTS])
    between = fine[:-1].reshape(CURVE_POINTS - 1, _PARTS, -1)[:, 1:]
    spline = np.ascontiguousarray(curve[:, 1:-1])
    outer = (spline[:, :, None] * spline[:, None, :]).reshape(CURVE_POINTS, -1)
    # The spline is one cubic up to its third knot; this difference of a cubic is exact.
    parts = _PARTS * (CURVE_POINTS - 1) / (NUM_WAYPOINTS + 1)  # of the fine one between two knots
    start = np.array([-11, 18, -9, 2]) / 6 @ fine[:4] * parts
    second, third = (np.diff(np.eye(NUM_WAYPOINTS + 2), n=n, axis=0) for n in (2, 3))
    shape = (second.T @ second)[1:-1]
    smooth = shape + jerk * (third.T @ third)[1:-1]
    stiffness = np.kron(smooth[:, 1:-1], np.eye(dim)).astype(np.float64)
    return _Matrices(
        curve, between, spline, np.diff(spline, axis=0), outer, start, shape, smooth, stiffness
    )
