"""Cubic Bézier curves (Hwang et al. 2003), many at a time, discretised at equal arc length."""

import functools

import numpy as np

from ..checks import Array
from ..curves import equal_arc_positions

_QUADRATURE_POINTS = 33
"""Parameters at which the arc length is tabulated."""


@functools.lru_cache(maxsize=8)
def _bernstein(num_points: int) -> Array:
    """`(num_points, 4)`: the Bernstein polynomials at equal steps of the parameter."""
    u = np.linspace(0, 1, num_points)
    v = 1 - u
    return np.stack([v**3, 3 * u * v**2, 3 * u**2 * v, u**3], axis=-1)


def bezier_points(controls: Array, num_points: int) -> Array:
    """Points `(..., num_points, D)` at equal parameter steps, of `controls (..., 4, D)` [m]."""
    return _bernstein(num_points) @ controls


def bezier_stretches(controls: Array, first: Array, width: float, num_points: int) -> Array:
    """As `bezier_points`, of the stretch `[first, first + width]` of the parameter of each curve.

    `(N, num_points, D)`; `first (N,)`.
    """
    u = (first[:, None] + width * np.linspace(0, 1, num_points))[..., None]
    p0, p1, p2, p3 = (controls[:, i, None] for i in range(4))
    cubic, quadratic, linear = p3 - p0 + 3 * (p1 - p2), 3 * (p0 - 2 * p1 + p2), 3 * (p1 - p0)
    return ((u * cubic + quadratic) * u + linear) * u + p0


@np.errstate(under="ignore")
def bezier_trajectories(controls: Array, num_points: int) -> Array:
    """`(N, num_points, D)` at equal steps of arc length, of curves `controls (N, 4, D)` [m].

    The parameter is read off a table of the arc length; the points lie on the curve, the first and
    last exactly on its ends. In memory the coordinates come first: the array is not C-contiguous.
    """
    table = bezier_points(controls, _QUADRATURE_POINTS)
    steps = np.diff(table, axis=-2)
    cumulative = np.zeros(table.shape[:-1])
    np.cumsum(np.sqrt(np.einsum("...d,...d->...", steps, steps)), axis=-1, out=cumulative[..., 1:])
    u = equal_arc_positions(cumulative, num_points) / (_QUADRATURE_POINTS - 1)
    # One coordinate at a time, contiguous in memory, as it is read.
    points = np.empty((controls.shape[-1], *u.shape))
    for d in range(len(points)):
        p0, p1, p2, p3 = (controls[:, i, d, None] for i in range(4))
        cubic, quadratic, linear = p3 - p0 + 3 * (p1 - p2), 3 * (p0 - 2 * p1 + p2), 3 * (p1 - p0)
        points[d] = ((u * cubic + quadratic) * u + linear) * u + p0
    points = np.moveaxis(points, 0, -1)
    points[..., -1, :] = controls[..., 3, :]
    return points


@np.errstate(all="ignore")
def bezier_bounds(controls: Array) -> tuple[Array, Array]:
    """Low and high corner `(N, D)` of the box around each of the curves `controls (N, 4, D)` [m].

    In closed form: a coordinate is extreme at an end or where its derivative, a quadratic, is 0.
    """
    p0, p1, p2, p3 = np.moveaxis(controls, -2, 0)
    cubic, quadratic, linear = p3 - p0 + 3 * (p1 - p2), 3 * (p0 - 2 * p1 + p2), 3 * (p1 - p0)
    root = np.sqrt(quadratic**2 - 3 * cubic * linear)  # not a number if there is no extreme
    sum_of_both = -(quadratic + np.copysign(root, quadratic))
    extremes = [p0, p3]
    for u in (sum_of_both / (3 * cubic), linear / sum_of_both):
        u = np.where((u > 0) & (u < 1), u, 0)
        extremes.append(((u * cubic + quadratic) * u + linear) * u + p0)
    return np.minimum.reduce(extremes), np.maximum.reduce(extremes)


@np.errstate(under="ignore")
def bending_energy(controls: Array) -> Array:
    """`∫₀¹ ‖B″(u)‖² du` of curves `controls (..., 4, D)`, `(...)` [m²]; lower = smoother.

    In closed form: with A = p₀ − 2p₁ + p₂ and C = p₁ − 2p₂ + p₃ it is 12 (A·A + A·C + C·C). Zero
    only for the straight line at constant speed.
    """
    p0, p1, p2, p3 = np.moveaxis(controls, -2, 0)
    a, c = p0 - 2 * p1 + p2, p1 - 2 * p2 + p3
    return 12 * ((a * a).sum(-1) + (a * c).sum(-1) + (c * c).sum(-1))


@np.errstate(all="ignore")
def crosses_itself(controls: Array) -> np.ndarray:
    """Whether each of the curves `controls (N, 4, D)` crosses itself, `(N,)` bool.

    In closed form: with `B(u) = a u³ + b u² + c u + d`, B(u) = B(v) for u ≠ v means
    `a (p² − q) + b p + c = 0`, where p = u + v and q = u v. A curve in 3D is judged as seen from
    where it is flattest.
    """
    p0, p1, p2, p3 = np.moveaxis(controls, -2, 0)
    parts = np.stack([p3 - p0 + 3 * (p1 - p2), 3 * (p0 - 2 * p1 + p2), 3 * (p1 - p0)], axis=-2)
    if controls.shape[-1] == 3:
        _, plane = np.linalg.eigh(parts.swapaxes(-1, -2) @ parts)
        parts = parts @ plane[..., 1:]
    a, b, c = np.moveaxis(parts, -2, 0)

    def cross(x: Array, y: Array) -> Array:
        return x[..., 0] * y[..., 1] - x[..., 1] * y[..., 0]

    turn = cross(a, b)
    total = -cross(a, c) / turn
    product = total**2 - cross(b, c) / turn
    root = np.sqrt(total**2 - 4 * product)  # not a number where u and v are complex
    return (total - root >= 0) & (total + root <= 2) & (root > 0)


def straight_controls(start: Array, goal: Array) -> Array:
    """`(4, D)`: the straight line from `start` to `goal` at constant speed."""
    controls = start + np.linspace(0, 1, 4)[:, None] * (goal - start)
    controls[-1] = goal  # free of rounding
    return controls
