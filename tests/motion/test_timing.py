"""The timing of any curve keeps its limits, from rest to rest, and wastes little time."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from legibility.errors import MissingExtraError
from legibility.motion import timing
from legibility.motion.timing import Course, fastest_timing
from legibility.robots.limits import LIMITS, Limits

pytest.importorskip("toppra", reason="timing is NOT TESTED: pip install 'legibility[timing]'")

seeds = st.integers(0, 2**32 - 1)


def course(seed, joints):
    """Through random places: with joints an arm's, of its own limits each, else a point's."""
    rng = np.random.default_rng(seed)
    size = joints or 2
    points = np.cumsum(rng.normal(0, 0.2, (10, size)) + 0.1, axis=0)
    shape = size if joints else ()
    limits = Limits(*(rng.uniform(low, 4 * low, shape) for low in (0.3, 1, 10)))
    return Course.through(np.linspace(0, 1, 10), points, limits)


def differences(positions, order, step):
    """Of a motion that rests before and after."""
    rest = np.repeat(positions[[0, -1]], 5, axis=0)
    return np.diff(np.concatenate([rest[:5], positions, rest[5:]]), n=order, axis=0) / step**order


@settings(max_examples=15, deadline=None)
@given(seeds, st.sampled_from([0, 1, 7]))
def test_finite_differences_keep_the_limits(seed, joints):
    one = course(seed, joints)
    found = fastest_timing([one])
    times = np.append(np.arange(0, found.duration, 1e-3), found.duration)[
        : int(found.duration * 1e3)
    ]
    positions = one.over_time(found.rates(times))[0]
    for order, limit in enumerate(
        (one.limits.velocity, one.limits.acceleration, one.limits.jerk), 1
    ):
        change = differences(positions, order, 1e-3)[: -5 - order]
        size = np.abs(change) if joints else np.linalg.norm(change, axis=-1)
        assert (size / limit).max() <= 1


@settings(max_examples=10, deadline=None)
@given(seeds, st.sampled_from([0, 7]))
def test_derivatives_are_those_of_the_positions(seed, joints):
    one = course(seed, joints)
    found = fastest_timing([one])
    step = found.duration / 5_000
    times = np.arange(5_001) * step
    values = one.over_time(found.rates(times))
    for order in (0, 1):
        derived = np.gradient(values[order], step, axis=0)[1:-1]
        off = np.abs(derived - values[order + 1, 1:-1]).max()
        assert off < 1e-2 * np.abs(values[order + 1]).max()
    s = found.rates(times)[0]
    assert (np.diff(s) >= 0).all()
    assert s[[0, -1]] == pytest.approx([0, 1], abs=1e-9)
    assert values[1:3][:, [0, -1]] == pytest.approx(0, abs=1e-6)  # at rest at both ends


@settings(max_examples=10, deadline=None)
@given(seeds)
def test_without_a_bound_on_jerk_it_is_nearly_the_fastest(seed):
    """Of the fastest within velocities and accelerations; some limit is in use at most times."""
    one = course(seed, 7)
    limits = Limits(one.limits.velocity, one.limits.acceleration, np.full(7, 1e6))
    free = Course(one.spline, limits)
    found = fastest_timing([free])
    assert found.bound < found.duration < 1.15 * found.bound
    _, velocity, acceleration, _ = free.over_time(found.rates(np.linspace(0, found.duration, 997)))
    used = np.maximum(
        (np.abs(velocity) / limits.velocity).max(-1),
        (np.abs(acceleration) / limits.acceleration).max(-1),
    )
    assert (used > 0.8).mean() > 0.7


def test_a_straight_line_takes_the_time_of_a_trapezium():
    """One metre at 0.5 m/s, 2 m/s², 1000 m/s³: v / a + d / v, and a little for the jerk."""
    line = Course.through(np.linspace(0, 1, 10), np.linspace([0, 0], [0.6, 0.8], 10),
                          Limits(0.5, 2, 1000))  # fmt: skip
    assert fastest_timing([line]).duration == pytest.approx(0.25 + 2, abs=0.02)


def test_all_courses_keep_their_limits():
    both = course(1, 7), course(2, 0)
    found = fastest_timing(both)
    rates = found.rates(np.linspace(0, found.duration, 2000))
    shares = [one.shares(rates).max() for one in both]
    assert 0.99 < max(shares) <= 1
    assert found.bound >= max(fastest_timing([one]).bound for one in both) * 0.999


def test_velocities_that_hang_on_angles():
    limits = LIMITS["fr3"]
    ends = np.array([[0, 0, 0, -1.6, 0, 2.5, 0], [2.6, 1.6, 0, -0.3, 0, 2.5, 0]])
    shares = np.linspace(0, 1, 10)[:, None]
    one = Course.through(shares[:, 0], ends[0] + shares * (ends[1] - ends[0]), limits)
    found = fastest_timing([one])
    place, velocity, *_ = one.over_time(found.rates(np.linspace(0, found.duration, 3000)))
    assert (np.abs(velocity) / limits.velocity_at(place)).max() <= 1
    free = Course(one.spline, Limits(limits.velocity, limits.acceleration, limits.jerk))
    assert fastest_timing([free]).duration < found.duration


def test_missing(monkeypatch):
    import sys

    timing._import_toppra.cache_clear()
    monkeypatch.setitem(sys.modules, "toppra", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'legibility\[timing\]'"):
        fastest_timing([course(0, 0)])
