"""Curves as points `(..., T, D)`: length, resampling at equal arc length, splines, deviation."""

import functools
import math

import numpy as np

from .checks import Array

NUM_WAYPOINTS = 8
"""K, the waypoints of a path between start and goal (paper, section V.C)."""


@np.errstate(under="ignore")
def cumulative_length(trajectory: Array) -> Array:
    """Length [m] from the start to each point, `(..., T)`."""
    steps = np.linalg.norm(np.diff(trajectory, axis=-2), axis=-1)
    return np.concatenate([np.zeros_like(steps[..., :1]), np.cumsum(steps, axis=-1)], axis=-1)


@np.errstate(under="ignore")
def arc_length(trajectory: Array) -> Array:
    """Length [m] of each trajectory, `(...)`."""
    return np.linalg.norm(np.diff(trajectory, axis=-2), axis=-1).sum(-1)


@np.errstate(under="ignore")
def turning(trajectory: Array) -> Array:
    """Total angle [rad] that the steps of each trajectory turn through, `(...)`.

    0 is straight, 2π a full circle. Turns between which the trajectory rests do not count, so
    `resample` it first.
    """
    steps = np.diff(trajectory, axis=-2)
    length = np.linalg.norm(steps, axis=-1, keepdims=True)
    steps = np.divide(steps, length, out=np.zeros(steps.shape), where=length != 0)
    before, after = steps[..., :-1, :], steps[..., 1:, :]
    apart, along = (np.linalg.norm(x, axis=-1) for x in (after - before, after + before))
    moving = (length[..., :-1, 0] != 0) & (length[..., 1:, 0] != 0)
    return np.where(moving, 2 * np.arctan2(apart, along), 0.0).sum(-1)


def equal_arc_positions(cumulative: Array, num_points: int) -> Array:
    """Fractional indices `(..., num_points)` in [0, T − 1] at equal steps of arc length.

    `cumulative (..., T)` is `cumulative_length`; a curve without length is read at equal steps of
    its index.
    """
    *batch, size = cumulative.shape
    if not cumulative.size:
        return np.zeros((*batch, num_points))
    flat = cumulative.reshape(-1, size)
    total = flat[:, -1:]
    index = np.arange(size, dtype=np.float64)
    progress = np.divide(
        flat, total, out=np.tile(index / (size - 1), (len(flat), 1)), where=total > 0
    )
    # All rows in one call: row i owns the interval [2i, 2i + 1], far enough from its neighbours.
    offset = 2.0 * np.arange(len(flat))[:, None]
    wanted = np.linspace(0, 1, num_points)
    positions = np.interp(
        (wanted + offset).ravel(), (progress + offset).ravel(), np.tile(index, len(flat))
    )
    return positions.reshape(*batch, num_points)


@np.errstate(under="ignore")
def resample(trajectory: Array, num_points: int) -> Array:
    """`num_points` points at equal arc length along each trajectory, `(..., num_points, D)`.

    Linear between the given points; the two ends stay where they are.
    """
    positions = equal_arc_positions(cumulative_length(trajectory), num_points)
    *batch, size, dim = trajectory.shape
    left = np.minimum(positions.astype(np.intp), size - 2)
    weight = (positions - left)[..., None]
    flat = trajectory.reshape(-1, dim)
    rows = left + size * np.arange(math.prod(batch)).reshape(*batch, 1)
    low, high = flat[rows], flat[rows + 1]
    points = low + weight * (high - low)
    points[..., [0, -1], :] = trajectory[..., [0, -1], :]  # free of rounding
    return points


def spaced(trajectory: Array, spacing: float) -> Array:
    """The points of one trajectory `(T, D)` [m] at every `spacing` [m] of its length.

    The end is left out unless it is at a multiple of the spacing, or the trajectory is shorter.
    """
    cumulative = cumulative_length(trajectory)
    moving = np.concatenate([[True], np.diff(cumulative) > 0])
    number = int(cumulative[-1] / spacing + 1e-9) + 1
    if number < 2:
        return trajectory[[0, -1]]
    wanted = np.minimum(spacing * np.arange(number), cumulative[-1])
    columns = [np.interp(wanted, cumulative[moving], x[moving]) for x in trajectory.T]
    return np.stack(columns, axis=-1)


@functools.lru_cache(maxsize=32)
def spline_matrix(num_knots: int, num_points: int) -> Array:
    """`(num_points, num_knots)`: the not-a-knot cubic spline through at least 4 equal knots.

    A product with it is a batch of paths. The same as SciPy's `CubicSpline`, whose import takes
    longer than loading a model and planning.
    """
    values = np.eye(num_knots)
    slopes = np.diff(values, axis=0)
    # The derivatives at the knots, in units of their spacing, make the second derivative continuous
    # there, and the third at the first and last inner knot.
    system = 4 * values + np.eye(num_knots, k=1) + np.eye(num_knots, k=-1)
    system[0, :2], system[-1, -2:] = (1, 2), (2, 1)
    wanted = np.empty_like(values)
    wanted[1:-1] = 3 * (slopes[:-1] + slopes[1:])
    wanted[0], wanted[-1] = (5 * slopes[0] + slopes[1]) / 2, (5 * slopes[-1] + slopes[-2]) / 2
    derivatives = np.linalg.solve(system, wanted)
    places = np.linspace(0, num_knots - 1, num_points)
    left = np.minimum(places.astype(np.intp), num_knots - 2)
    t = (places - left)[:, None]
    matrix = (
        (1 + 2 * t) * (1 - t) ** 2 * values[left]
        + t * (1 - t) ** 2 * derivatives[left]
        + t**2 * (3 - 2 * t) * values[left + 1]
        + t**2 * (t - 1) * derivatives[left + 1]
    )
    matrix.setflags(write=False)
    return matrix


@np.errstate(under="ignore")
def farthest_from_segment(trajectory: Array, start: Array, end: Array) -> Array:
    """The most deviating point `(..., D)` of each trajectory from the straight line start–end.

    One in the middle if the trajectory is that line to rounding.
    """
    direction = end - start
    squared = direction @ direction
    # One coordinate at a time: sums over a short last axis are slow in NumPy.
    axes = [(trajectory[..., d] - start[d], direction[d]) for d in range(len(start))]
    along = np.clip(sum(offset * (v / squared) for offset, v in axes), 0, 1)
    gaps = np.asarray(sum((offset - along * v) ** 2 for offset, v in axes))
    straight = gaps.max(-1) < 1e-18 * squared
    index = np.where(straight, gaps.shape[-1] // 2, np.argmax(gaps, axis=-1))[..., None, None]
    return np.take_along_axis(trajectory, index, axis=-2)[..., 0, :]


@np.errstate(under="ignore")
def path_curve(path: Array, num_points: int) -> Array:
    """The smooth curve `(..., num_points, D)` through a path `(..., K + 2, D)` [m]."""
    return spline_matrix(path.shape[-2], num_points) @ path
