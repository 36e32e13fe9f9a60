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


@np.errstate(under="ignore")
def bending_energy(controls: Array) -> Array:
    """`∫₀¹ ‖B″(u)‖² du` of curves `controls (..., 4, D)`, `(...)` [m²]; lower = smoother.

    In closed form: with A = p₀ − 2p₁ + p₂ and C = p₁ − 2p₂ + p₃ it is 12 (A·A + A·C + C·C). Zero
    only for the straight line at constant speed.
    """
    p0, p1, p2, p3 = np.moveaxis(controls, -2, 0)
    a, c = p0 - 2 * p1 + p2, p1 - 2 * p2 + p3
    return 12 * ((a * a).sum(-1) + (a * c).sum(-1) + (c * c).sum(-1))


def straight_controls(start: Array, goal: Array) -> Array:
    """`(4, D)`: the straight line from `start` to `goal` at constant speed."""
    controls = start + np.linspace(0, 1, 4)[:, None] * (goal - start)
    controls[-1] = goal  # free of rounding
    return controls
