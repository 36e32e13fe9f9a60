"""Béziers are what geometry says, at equal arc length."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import simpson

from legibility.curves import arc_length, resample
from legibility.motion.bezier import (
    bending_energy,
    bezier_bounds,
    bezier_points,
    bezier_stretches,
    bezier_trajectories,
    crosses_itself,
    straight_controls,
)

seeds = st.integers(0, 2**32 - 1)
dims = st.sampled_from([2, 3])


def random_controls(seed, num, dim):
    return np.random.default_rng(seed).uniform(-0.5, 1.5, (num, 4, dim))


@given(seeds, dims, st.integers(2, 60))
def test_ends_are_exact(seed, dim, num_points):
    controls = random_controls(seed, 3, dim)
    trajectories = bezier_trajectories(controls, num_points)
    assert trajectories.shape == (3, num_points, dim)
    np.testing.assert_array_equal(trajectories[:, [0, -1]], controls[:, [0, -1]])


@given(seeds, dims)
def test_arc_length_is_equal_as_on_the_densely_resampled_curve(seed, dim):
    controls = random_controls(seed, 4, dim)
    dense = bezier_points(controls, 20_001)
    gaps = np.linalg.norm(bezier_trajectories(controls, 48) - resample(dense, 48), axis=-1)
    assert (gaps.max(-1) < 0.003 * arc_length(dense)).all()


@given(seeds, dims)
def test_points_lie_on_the_curve(seed, dim):
    controls = random_controls(seed, 1, dim)
    dense = bezier_points(controls[0], 4001)
    spacing = np.linalg.norm(np.diff(dense, axis=0), axis=-1).max()
    for point in bezier_trajectories(controls, 12)[0]:
        assert np.linalg.norm(dense - point, axis=-1).min() < 0.51 * spacing


@given(seeds, dims)
def test_curve_stays_in_the_convex_hull_of_its_control_points(seed, dim):
    controls = random_controls(seed, 3, dim)
    directions = np.random.default_rng(seed).normal(size=(dim, 200))
    points = bezier_trajectories(controls, 40) @ directions
    assert (points.max(-2) <= (controls @ directions).max(-2) + 1e-12).all()


@given(seeds, dims)
def test_reversed_controls_reverse_the_trajectory(seed, dim):
    controls = random_controls(seed, 3, dim)
    np.testing.assert_allclose(
        bezier_trajectories(controls[:, ::-1], 30),
        bezier_trajectories(controls, 30)[:, ::-1],
        atol=1e-9,
    )


@given(seeds, dims)
def test_curve_moves_and_scales_with_its_control_points(seed, dim):
    controls = random_controls(seed, 3, dim)
    np.testing.assert_allclose(
        bezier_trajectories(3 * controls + 0.7, 30),
        3 * bezier_trajectories(controls, 30) + 0.7,
        atol=1e-10,
    )


def test_bernstein_sum_by_hand():
    controls = np.array([[0.0, 0], [0, 1], [1, 1], [1, 0]])
    np.testing.assert_allclose(bezier_points(controls, 3), [[0, 0], [0.5, 0.75], [1, 0]])


def test_batch_equals_the_loop():
    controls = random_controls(0, 50, 3)
    together = bezier_trajectories(controls, 20)
    for one, trajectory in zip(controls, together, strict=True):
        np.testing.assert_allclose(bezier_trajectories(one[None], 20)[0], trajectory, atol=1e-10)


def test_curve_of_no_length_stays_where_it_is():
    np.testing.assert_array_equal(bezier_trajectories(np.ones((1, 4, 2)), 7), np.ones((1, 7, 2)))


def test_no_curves():
    assert bezier_trajectories(np.zeros((0, 4, 2)), 7).shape == (0, 7, 2)
    assert bending_energy(np.zeros((0, 4, 2))).shape == (0,)


@given(seeds, dims)
def test_bending_energy_is_the_integral_of_the_squared_second_derivative(seed, dim):
    controls = random_controls(seed, 5, dim)
    points = bezier_points(controls, 101)
    second = np.diff(points, n=2, axis=-2) * 100**2  # exact for a cubic
    squared = (second**2).sum(-1)
    inner = simpson(squared, dx=0.01, axis=-1)
    # The cubic's second derivative is linear in u: extrapolate it to the two missing ends.
    ends = np.stack([2 * second[:, 0] - second[:, 1], 2 * second[:, -1] - second[:, -2]], axis=1)
    rims = ((ends**2).sum(-1) + squared[:, [0, -1]]).sum(-1) / 2 * 0.01
    np.testing.assert_allclose(bending_energy(controls), inner + rims, rtol=1e-3)


@given(seeds, dims)
def test_bending_energy_ignores_place_and_direction_and_grows_with_the_square(seed, dim):
    controls = random_controls(seed, 5, dim)
    rotation = np.linalg.qr(np.random.default_rng(seed).normal(size=(dim, dim)))[0]
    energy = bending_energy(controls)
    assert (energy > 0).all()
    np.testing.assert_allclose(bending_energy(controls @ rotation + 2), energy, rtol=1e-9)
    np.testing.assert_allclose(bending_energy(controls[:, ::-1]), energy, rtol=1e-12)
    np.testing.assert_allclose(bending_energy(2 * controls), 4 * energy, rtol=1e-12)


@given(seeds, dims)
def test_straight_line_has_no_energy_and_constant_speed(seed, dim):
    start, goal = np.random.default_rng(seed).uniform(-1, 1, (2, dim))
    controls = straight_controls(start, goal)
    assert controls.shape == (4, dim)
    np.testing.assert_array_equal(controls[[0, -1]], [start, goal])
    assert bending_energy(controls) < 1e-28
    expected = np.linspace(start, goal, 21)
    np.testing.assert_allclose(bezier_trajectories(controls[None], 21)[0], expected, atol=1e-12)


@pytest.mark.parametrize("shape", [(), (3,), (2, 3)])
def test_leading_axes(shape):
    controls = np.random.default_rng(0).normal(size=(*shape, 4, 2))
    assert bezier_points(controls, 9).shape == (*shape, 9, 2)
    energies = bending_energy(controls)
    assert energies.shape == shape
    for index in np.ndindex(shape):
        assert energies[index] == pytest.approx(bending_energy(controls[index]), rel=1e-12)


@given(seeds, dims)
def test_bounds_hold_the_curve_and_touch_it(seed, dim):
    controls = random_controls(seed, 20, dim)
    controls[:10, 1:3] = controls[:10, [0, 3]]  # coordinates that rise all the way
    low, high = bezier_bounds(controls)
    points = bezier_points(controls, 2001)
    assert (points >= low[:, None] - 1e-12).all()
    assert (points <= high[:, None] + 1e-12).all()
    np.testing.assert_allclose(low, points.min(1), atol=1e-5)
    np.testing.assert_allclose(high, points.max(1), atol=1e-5)


@pytest.mark.parametrize("offset", [0, 1e6])
def test_bounds_of_straight_and_degenerate_curves(offset):
    ends = np.random.default_rng(0).uniform(-1, 1, (50, 2, 2)) + offset
    ends[:10, 1, 0] = ends[:10, 0, 0]  # along an axis
    ends[10:20, 1] = ends[10:20, 0]  # a point
    low, high = bezier_bounds(np.stack([straight_controls(*pair) for pair in ends]))
    np.testing.assert_allclose(low, ends.min(1), atol=1e-15 * (1 + 10 * offset))
    np.testing.assert_allclose(high, ends.max(1), atol=1e-15 * (1 + 10 * offset))
    np.testing.assert_array_equal(low[:10, 0], ends[:10, 0, 0])
    quadratic = np.array([[[0, 0], [1, 1], [2, 1], [3, 0]]], dtype=float)  # y without a cubic term
    assert bezier_bounds(quadratic)[1].tolist() == [[3, 0.75]]


@given(seeds, dims, st.floats(0, 0.9))
def test_a_stretch_lies_on_the_curve(seed, dim, first):
    controls = random_controls(seed, 3, dim)
    first = np.array([0, first, 0.75])
    stretches = bezier_stretches(controls, first, 0.1, 5)
    for control, u, stretch in zip(controls, first, stretches, strict=True):
        v = (u + 0.1 * np.linspace(0, 1, 5))[:, None]
        weights = [(1 - v) ** 3, 3 * v * (1 - v) ** 2, 3 * v**2 * (1 - v), v**3]
        expected = sum(w * p for w, p in zip(weights, control, strict=True))
        np.testing.assert_allclose(stretch, expected, atol=1e-12)


def crossing_by_segments(controls, num_points=300):
    """Whether two segments of the polyline that are not neighbours cross."""
    points = bezier_points(controls, num_points)
    a, d = points[:-1], np.diff(points, axis=0)
    offset = a[None] - a[:, None]

    def cross(x, y):
        return x[..., 0] * y[..., 1] - x[..., 1] * y[..., 0]

    with np.errstate(all="ignore"):
        both = cross(d[:, None], d[None])
        s, t = cross(offset, d[None]) / both, cross(offset, d[:, None]) / both
    i, j = np.nonzero((s >= 0) & (s < 1) & (t >= 0) & (t < 1))
    return bool((np.abs(i - j) > 1).any())


def test_curves_cross_themselves_where_their_polylines_do():
    controls = np.random.default_rng(0).uniform(-1, 1, (300, 4, 2))
    found = crosses_itself(controls)
    assert 20 < found.sum() < 280
    np.testing.assert_array_equal(found, [crossing_by_segments(c) for c in controls])


@given(seeds, st.floats(0.01, 100))
def test_crossing_does_not_mind_place_size_and_direction(seed, scale):
    controls = np.random.default_rng(seed).uniform(-1, 1, (50, 4, 2))
    found = crosses_itself(controls)
    np.testing.assert_array_equal(crosses_itself(controls[:, ::-1]), found)
    np.testing.assert_array_equal(crosses_itself(scale * controls + 7), found)
    # ... in any plane in 3D
    turn = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    solid = np.concatenate([controls, np.zeros((50, 4, 1))], axis=-1) @ turn
    np.testing.assert_array_equal(crosses_itself(solid), found)


@given(seeds, dims, st.sampled_from([0, 1e3, 1e6]))
def test_straight_lines_do_not_cross_themselves(seed, dim, offset):
    ends = np.random.default_rng(seed).uniform(-1, 1, (50, 2, dim)) + offset
    assert not crosses_itself(np.stack([straight_controls(*pair) for pair in ends])).any()
    assert crosses_itself(np.zeros((0, 4, dim))).shape == (0,)
