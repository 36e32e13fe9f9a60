"""Recorded motions: positions as a sensor gave them, with rests at both ends and noise."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..checks import Array, finite_array, target_index, trajectory_array
from ..curves import arc_length
from ..errors import InvalidInputError

_LEAST = 10  # points below which noise cannot be told from the shape
_MOST = 512  # points of a motion that are smoothed; more are averaged
_FINEST = 48  # parts of a recording: noise may be correlated over less than one
_REST, _LEAST_REST = 5.0, 1e-3  # radius of a rest, over the noise and over the motion's extent
_MOST_WEIGHT = 10.0  # of the mean of a rest, over that of one point
_EXACT = 1e-7  # noise over the motion's extent that is rounding
_AS_IT_IS = 1.002  # excess of length of a motion that needs no smoothing


@dataclass(frozen=True, eq=False)
class Recording:
    """One recorded motion.

    Attributes:
        positions: `(T, D)` [m], at least two, D from 2 to 3.
        times: `(T,)` [s], rising; if not given, the positions are at equal time steps.
        name: what it is called in tables and messages.
        target: index of the intended goal, if known.
        scene: name of the scene that it was recorded in, if there are several.
        notes: what else is known of it, such as its participant, by name.

    Raises:
        InvalidInputError: a value out of its range, named with the recording.
    """

    positions: Array
    times: Array | None = None
    name: str = "1"
    target: int | None = None
    scene: str | None = None
    notes: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        def put(name: str, value: Any) -> None:
            object.__setattr__(self, name, value)

        where = f"positions of recording {self.name!r}"
        positions = trajectory_array(self.positions, name=where)
        if positions.ndim != 2 or positions.shape[-1] not in (2, 3):
            raise InvalidInputError(f"{where} must be (T, 2) or (T, 3), got {positions.shape}")
        put("positions", positions)
        if self.times is not None:
            times = finite_array(f"times of recording {self.name!r}", self.times, ndim=1)
            if len(times) != len(positions):
                raise InvalidInputError(
                    f"times of recording {self.name!r} must be {len(positions)}, one for each "
                    f"position, got {len(times)}"
                )
            if (falling := np.flatnonzero(np.diff(times) <= 0)).size:
                raise InvalidInputError(
                    f"times of recording {self.name!r} must rise, got {times[falling[0] + 1]} "
                    f"after {times[falling[0]]}"
                )
            put("times", times)
        if self.target is not None:
            put("target", target_index(self.target, np.iinfo(np.int64).max))

    def __len__(self) -> int:
        return len(self.positions)

    @property
    def dim(self) -> int:
        """D."""
        return self.positions.shape[-1]

    @functools.cached_property
    def noise(self) -> float:
        """Standard deviation [m] of the noise along an axis.

        From the median of third differences, which hardly see a smooth motion or a few corners
        (Gasser, Sroka and Jennen-Steinmetz, Biometrika 1986), over steps of up to 1/48 of the
        recording, since noise may be correlated from point to point.
        """
        return _noise(self._even[0])

    @property
    def motion(self) -> Array:
        """The motion alone, `(M, D)` [m], at equal time steps: without rests and noise.

        A rest is what lies within five standard deviations of the noise, or a thousandth of the
        motion's extent, of where the recording begins or ends; its median stands for it. Between
        the rests runs the smoothing spline (Reinsch, Numer. Math. 1967; FITPACK) whose residual is
        the noise. Where noise adds less than 0.2 % to the length, the points stay as they are.

        Raises:
            InvalidInputError: nothing moves.
        """
        return self._moving[0]

    @property
    def motion_times(self) -> Array:
        """Times `(M,)` of `motion` [s], or indices of the recording if it has no times."""
        return self._moving[1]

    @property
    def lost(self) -> float:
        """Share of the length between the rests that is taken for noise, in [0, 1)."""
        return self._moving[2]

    @functools.cached_property
    def _even(self) -> tuple[Array, Array]:
        """The positions at equal time steps, and these times."""
        steps, points = len(self), self.positions
        times = np.arange(float(steps)) if self.times is None else self.times
        even = np.linspace(times[0], times[-1], steps)
        if np.abs(times - even).max() > 1e-3 * (even[1] - even[0]):
            points = np.stack([np.interp(even, times, column) for column in points.T], axis=-1)
        return points, even

    @functools.cached_property
    def _moving(self) -> tuple[Array, Array, float]:
        points, even = self._even
        steps = len(points)
        radius = max(_REST * self.noise, _LEAST_REST * float(np.linalg.norm(np.ptp(points, 0))))
        first, start = _rest(points, radius)
        last, end = _rest(points[::-1], radius)
        if first + last > steps:
            raise InvalidInputError(
                f"recording {self.name!r} must move, but all of it lies within {radius:.3g} m of "
                f"{start.tolist()}"
            )
        moving = slice(first - 1, steps - last + 1)
        points, even = points[moving].copy(), even[moving]
        points[0], points[-1] = start, end
        smooth = _smoothed(points, even, self.noise, np.sqrt([first, last]))
        length, kept = arc_length(points), arc_length(smooth)
        if length <= _AS_IT_IS * kept:
            return points, even, 0.0
        return smooth, np.linspace(even[0], even[-1], len(smooth)), float(1 - kept / length)


def _noise(points: Array) -> float:
    """See `Recording.noise`, of points at equal time steps."""
    found, step, size = 0.0, 1, len(points)
    while size >= _LEAST and (step == 1 or step * _FINEST <= size):
        a, b, c, d = (points[i * step : size - (3 - i) * step] for i in range(4))
        medians = np.median(np.abs(d - 3 * c + 3 * b - a), axis=0)
        found = max(found, np.sqrt((medians**2).mean() / 20) / 0.6745)  # if normally distributed
        step *= 2
    return float(found)


def _rest(points: Array, radius: float) -> tuple[int, Array]:
    """How many `points (T, D)` from the first on lie within `radius` of their median, and it."""
    center, number = points[0], 1
    for _ in range(3):
        far = np.linalg.norm(points - center, axis=-1) > radius
        number = max(1, int(np.argmax(far))) if far.any() else len(points)
        center = np.median(points[:number], axis=0)
    return number, center


def _smoothed(points: Array, times: Array, noise: float, weights: Array) -> Array:
    """Points at equal times of the spline that misses `points` by the noise.

    `weights (2,)` are those of the two ends beside the others.
    """
    from scipy.interpolate import make_splprep  # slow to import

    inner, inner_times = points[1:-1], times[1:-1]
    size = -(-len(inner) // _MOST)
    if size > 1:
        first = np.arange(0, len(inner), size)
        number = np.diff(first, append=len(inner))
        inner = np.add.reduceat(inner, first) / number[:, None]
        inner_times = np.add.reduceat(inner_times, first) / number
        noise = _noise(inner)
    if len(inner) < _LEAST or noise < _EXACT * float(np.linalg.norm(np.ptp(points, axis=0))):
        return points
    points = np.concatenate([points[:1], inner, points[-1:]])
    at = np.concatenate([times[:1], inner_times, times[-1:]])
    weight = np.ones(len(points))
    weight[[0, -1]] = np.minimum(weights, _MOST_WEIGHT)
    residual: Any = points.size * noise**2  # SciPy's stubs want an integer
    spline, _ = make_splprep(points.T, w=weight, u=at, s=residual)
    return spline(np.linspace(at[0], at[-1], len(points))).T
