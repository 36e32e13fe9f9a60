"""When a motion is where on its curve: as fast as limits allow, at rest at both ends.

The fastest timing within velocities and accelerations (TOPP-RA, Pham and Pham 2018, by toppra)
jumps in its acceleration. A moving average over some milliseconds turns the jumps into slopes,
which bounds the jerk; a little more time for the whole motion then keeps every limit.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.interpolate import BSpline, PPoly, make_interp_spline

from ..checks import Array
from ..errors import InvalidInputError, LegibilityError, MissingExtraError
from ..robots.limits import Limits

_INTERVALS = 200
"""Parts of the curve, in each of which d²s/dt² is constant before it is averaged."""

_SCALES = (10.0, 100.0, 1.0, 0.1)
"""Units of v² to solve in, over the greatest v² that is allowed."""

_TINY = 1e-12
"""Length of a derivative below which it bounds nothing [m or rad]."""

_SIDES = 8
"""Pairs of sides of the polygon inside the circle that bounds a point's acceleration."""

_STEP, _MOST = 5e-4, 50_000
"""Time between two checks of the limits [s], and most checks of a motion."""

_CHECKS = 200
"""Checks by which the moving average is chosen."""

_MARGIN, _BRAKING_MARGIN = 1e-3, 1e-2
"""Share of the limits that is left for what lies between two checks; of velocities that hang on
angles more, since these change meanwhile."""

_WINDOWS, _SHORTEST, _LONGEST = 16, 0.004, 0.6
"""Lengths of the moving average to choose from: their number, the shortest [s], and the longest
over the time of the motion."""


def over_time(spline: BSpline, rates: Array) -> Array:
    """Position, velocity, acceleration and jerk along a spline, `(4, T, C)`.

    Args:
        spline: positions `(T, C)` at s `(T,)`.
        rates: s and its first three derivatives in time, `(4, T)`.
    """
    speed, change, jerk = rates[1:, :, None]
    place, slope, bend, twist = (spline(rates[0], nu) for nu in range(4))
    return np.stack([
        place,
        slope * speed,
        bend * speed**2 + slope * change,
        twist * speed**3 + 3 * bend * speed * change + slope * jerk,
    ])  # fmt: skip


@dataclass(frozen=True)
class Course:
    """What keeps limits along a curve: the joints of an arm, or a point.

    Attributes:
        spline: its positions `(T, C)` at s `(T,)` from 0 to 1.
        limits: of all its C joints, or of a point with C coordinates.
    """

    spline: BSpline
    limits: Limits

    @classmethod
    def through(cls, places: Array, positions: Array, limits: Limits) -> Course:
        """The quintic spline through `positions (N, C)` at s = `places (N,)`."""
        return cls(make_interp_spline(places, positions, k=5), limits)

    def over_time(self, rates: Array) -> Array:
        """See `over_time`."""
        return over_time(self.spline, rates)

    def shares(self, rates: Array) -> Array:
        """The greatest velocity, acceleration and jerk over their limits, `(3,)`."""
        place, *derivatives = self.over_time(rates)
        limits = self._velocity(place), self.limits.acceleration, self.limits.jerk
        pairs = zip(derivatives, limits, strict=True)
        return np.array([(self._size(x) / limit).max() for x, limit in pairs])

    def _velocity(self, place: Array) -> Array:
        """The greatest velocity at positions `(T, C)`, of each joint or of the point."""
        velocity = self.limits.velocity_at(place)
        if self.limits.braking is None:
            return velocity
        if (velocity <= 0).any():
            row, joint = np.argwhere(velocity <= 0)[0]
            raise InvalidInputError(
                f"joint {joint + 1} comes too near to an end of its range, at "
                f"{place[row, joint]:.3f} rad, where the limits let it move no more"
            )
        return (1 - _BRAKING_MARGIN) * velocity

    def bounds(self, s: Array) -> tuple[Array, Array, Array]:
        """What bounds the timing at `s (N,)`: its accelerations, and its greatest speed.

        With the speed v = ds/dt and u = d²s/dt² the accelerations are below their limits where
        `|first u + second v²| ≤ 1`.

        Returns:
            first and second `(N, M)`, and the greatest v², `(N,)`.
        """
        place, slope, bend, twist = (self.spline(s, nu) for nu in range(4))
        limits = self.limits
        speed = self._velocity(place) / np.maximum(self._size(slope), _TINY)
        jerk = (limits.jerk / np.maximum(self._size(twist), _TINY)) ** (1 / 3)
        highest = np.minimum(speed, jerk).reshape(len(s), -1).min(1) ** 2
        if limits.joints:
            return slope / limits.acceleration, bend / limits.acceleration, highest
        # A point's acceleration lies in the plane of the slope and the bend.
        length = self._size(slope)
        along = slope / np.maximum(length, _TINY)[:, None]
        forward = (bend * along).sum(-1)
        aside = self._size(bend - forward[:, None] * along)
        angles = np.pi * np.arange(_SIDES) / _SIDES
        within = limits.acceleration * np.cos(np.pi / (2 * _SIDES))
        first = np.cos(angles) * length[:, None] / within
        second = (np.cos(angles) * forward[:, None] + np.sin(angles) * aside[:, None]) / within
        return first, second, highest

    def _size(self, vectors: Array) -> Array:
        """Of each joint `(T, C)`, or of the vectors of a point `(T,)`."""
        return np.abs(vectors) if self.limits.joints else np.linalg.norm(vectors, axis=-1)


@dataclass(frozen=True)
class Timing:
    """How s runs from 0 to 1 over time.

    Attributes:
        place: s over a time of its own.
        length: of that time [s].
        bound: duration that velocities and accelerations alone would allow [s].
        duration: of the motion [s].
    """

    place: PPoly
    length: float
    bound: float
    duration: float

    @classmethod
    def averaged(cls, times: Array, speeds: Array, window: float) -> Timing:
        """The moving average over `window` [s] of s whose ds/dt at `times (N,)` [s] is `speeds`."""
        knots = np.unique(np.concatenate([times, times + window]))

        def change(at: Array) -> Array:
            ahead, behind = (np.interp(t, times, speeds, 0, 0) for t in (at, at - window))
            return (ahead - behind) / window

        value = change(knots)
        slope = np.diff(value) / np.diff(knots)
        place = PPoly(np.stack([slope, value[:-1]]), knots).antiderivative(2)
        place.c /= place(knots[-1])  # rounding
        return cls(place, knots[-1], times[-1], knots[-1])

    def rates(self, times: Array) -> Array:
        """s and its first three derivatives at `times (T,)` [s], `(4, T)`."""
        scale = self.length / self.duration
        now = np.clip(times, 0, self.duration) * scale
        return np.stack([self.place(now, nu) * scale**nu for nu in range(4)])


def fastest_timing(courses: Sequence[Course]) -> Timing:
    """The timing of a motion, from rest to rest, that keeps the limits of all `courses`.

    Raises:
        InvalidInputError: a joint comes too near to an end of its range.
        LegibilityError: no timing was found.
        MissingExtraError: toppra is not installed.
    """
    s, speeds = _without_jerk(courses)
    steps = 2 * np.diff(s) / (speeds[1:] + speeds[:-1])
    times = np.concatenate([[0], np.cumsum(steps)])
    shortest = min(_SHORTEST, times[-1] / 100)
    windows = np.geomspace(shortest, _LONGEST * times[-1], _WINDOWS)
    tried = [_stretched(courses, Timing.averaged(times, speeds, w), _CHECKS) for w in windows]
    best = min(tried, key=lambda timing: timing.duration)
    return _stretched(courses, best, min(int(best.duration / _STEP) + 2, _MOST))


def _stretched(courses: Sequence[Course], timing: Timing, number: int) -> Timing:
    """The same with the duration that the limits need at `number` equally spaced times."""
    rates = timing.rates(np.linspace(0, timing.duration, number))
    shares = np.max([course.shares(rates) for course in courses], axis=0) / (1 - _MARGIN)
    longer = float((shares ** (1 / np.arange(1, 4))).max())
    return replace(timing, duration=timing.duration * longer)


def _without_jerk(courses: Sequence[Course]) -> tuple[Array, Array]:
    """The fastest timing within velocities and accelerations: s `(N,)`, and ds/dt `(N,)` there."""
    toppra = _import_toppra()
    s = np.linspace(0, 1, _INTERVALS + 1)
    first, second, most = zip(*(course.bounds(s) for course in courses), strict=True)
    first, second, highest = *(np.concatenate(x, 1) for x in (first, second)), np.min(most, axis=0)
    both = np.eye(first.shape[1])
    line = toppra.SplineInterpolator([0, 1], [[0.0], [1.0]])  # the bounds know the curve
    for factor in _SCALES:  # the solver's own tolerances depend on the unit of v²
        unit = factor * highest.max()
        # Bounded at both ends of each interval: bounded at one, the acceleration chatters.
        form = toppra.constraint.linear_constraint.canlinear_colloc_to_interpolate(
            unit * first, unit * second, np.zeros_like(first), np.concatenate([both, -both]),
            np.ones(2 * len(both)), None, np.stack([0 * s, highest / unit], axis=1), s,
            identical=True,
        )  # fmt: skip
        bounds = toppra.constraint.LinearConstraint()
        bounds.identical, bounds.compute_constraint_params = True, lambda *_, form=form: form
        solver = toppra.algorithm.TOPPRA([bounds], line, gridpoints=s, solver_wrapper="seidel")
        speeds = solver.compute_parameterization(0, 0)[1]
        if speeds is not None and np.isfinite(speeds).all() and (speeds[1:-1] > 0).all():
            return s, speeds * np.sqrt(unit)
    raise LegibilityError("no timing of the motion was found that keeps the limits")


@functools.cache
def _import_toppra() -> Any:
    """toppra, loaded on first use."""
    try:
        import toppra
    except ModuleNotFoundError as cause:
        raise MissingExtraError(
            "toppra is not installed: pip install 'legibility[timing]'"
        ) from cause
    return toppra
