"""Resampling keeps the curve; lengths and deviations are those of geometry."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import CubicSpline
from segments import distance_to_segment

from legibility import curves

seeds = st.integers(0, 2**32 - 1)
dims = st.sampled_from([2, 3])


def polyline(seed, size, dim):
    return np.random.default_rng(seed).normal(size=(size, dim))


def refine(points, rng, num_points):
    """The same polyline with `num_points` more points somewhere on its segments."""
    segment = rng.integers(0, len(points) - 1, num_points)
    weight = rng.random(num_points)
    extra = points[segment] + weight[:, None] * (points[segment + 1] - points[segment])
    order = np.argsort(np.concatenate([np.arange(len(points)), segment + weight]), kind="stable")
    return np.concatenate([points, extra])[order]


@given(seeds, st.integers(2, 40), st.integers(2, 60), dims)
def test_ends_are_kept_exactly(seed, size, num_points, dim):
    points = polyline(seed, size, dim)
    result = curves.resample(points, num_points)
    assert result.shape == (num_points, dim)
    np.testing.assert_array_equal(result[[0, -1]], points[[0, -1]])


@given(seeds, dims)
def test_spacing_along_the_curve_is_equal(seed, dim):
    points = polyline(seed, 6, dim)
    num_points = 31
    knots = curves.cumulative_length(points)
    at = np.linspace(0, knots[-1], num_points)
    expected = np.stack([np.interp(at, knots, axis) for axis in points.T], axis=-1)
    np.testing.assert_allclose(curves.resample(points, num_points), expected, atol=1e-12)


@given(seeds, st.integers(2, 30), dims)
def test_identity_on_an_equally_spaced_curve(seed, size, dim):
    rng = np.random.default_rng(seed)
    steps = rng.normal(size=(size - 1, dim))
    steps *= 0.1 / np.linalg.norm(steps, axis=-1, keepdims=True)
    points = np.concatenate([np.zeros((1, dim)), np.cumsum(steps, axis=0)])
    np.testing.assert_allclose(curves.resample(points, size), points, atol=1e-12)


@given(seeds, dims)
def test_refining_a_polyline_changes_nothing(seed, dim):
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(5, dim))
    finer = refine(points, rng, 40)
    np.testing.assert_allclose(curves.arc_length(finer), curves.arc_length(points), rtol=1e-12)
    np.testing.assert_allclose(
        curves.resample(finer, 20), curves.resample(points, 20), rtol=0, atol=1e-11
    )


@given(seeds, dims)
def test_reversing_the_curve_reverses_the_points(seed, dim):
    points = polyline(seed, 7, dim)
    np.testing.assert_allclose(
        curves.resample(points[::-1], 15), curves.resample(points, 15)[::-1], atol=1e-12
    )


@given(seeds)
def test_repeated_points_are_as_good_as_one(seed):
    points = polyline(seed, 5, 2)
    rests = np.repeat(points, [3, 1, 4, 2, 5], axis=0)
    np.testing.assert_allclose(
        curves.resample(rests, 20), curves.resample(points, 20), rtol=0, atol=1e-12
    )


def test_curve_without_length_stays_where_it_is():
    np.testing.assert_array_equal(curves.resample(np.ones((4, 3)), 7), np.ones((7, 3)))


@pytest.mark.parametrize("batch", [(1,), (3,), (2, 3), (0,)])
def test_leading_axes_equal_the_loop(batch):
    points = np.random.default_rng(0).normal(size=(*batch, 9, 3))
    result = curves.resample(points, 13)
    assert result.shape == (*batch, 13, 3)
    for index in np.ndindex(batch):
        np.testing.assert_allclose(result[index], curves.resample(points[index], 13), atol=1e-12)


def test_many_rows_are_as_exact_as_one():
    points = np.random.default_rng(0).normal(size=(50_000, 6, 2))
    last = curves.resample(points[-1], 8)
    np.testing.assert_allclose(curves.resample(points, 8)[-1], last, rtol=0, atol=1e-8)


def test_input_is_not_changed():
    points = polyline(0, 9, 2)
    before = points.copy()
    curves.resample(points, 5)
    np.testing.assert_array_equal(points, before)


def test_lengths():
    points = np.array([[0, 0], [3, 4], [3, 10]])
    assert curves.arc_length(points) == 11
    assert curves.cumulative_length(points).tolist() == [0, 5, 11]


def test_spline_passes_its_knots_and_is_exact_for_cubics():
    matrix = curves.spline_matrix(6, 51)
    np.testing.assert_allclose(matrix[::10], np.eye(6), atol=1e-12)
    t = np.linspace(0, 1, 51)
    cubic = 1 - 2 * t + 3 * t**2 - 4 * t**3
    np.testing.assert_allclose(matrix @ cubic[::10], cubic, atol=1e-12)
    np.testing.assert_allclose(matrix.sum(-1), 1, atol=1e-12)


@pytest.mark.parametrize("knots", [4, 5, 6, 10, 17])
def test_spline_is_that_of_scipy(knots):
    for points in (2, 10, 48, 257):
        expected = CubicSpline(np.linspace(0, 1, knots), np.eye(knots))(np.linspace(0, 1, points))
        np.testing.assert_allclose(curves.spline_matrix(knots, points), expected, atol=1e-14)


def test_spline_matrix_is_shared_and_read_only():
    assert curves.spline_matrix(10, 50) is curves.spline_matrix(10, 50)
    with pytest.raises(ValueError, match="read-only"):
        curves.spline_matrix(10, 50)[0] = 0


@given(seeds, dims)
def test_path_curve_passes_its_waypoints(seed, dim):
    path = np.random.default_rng(seed).normal(size=(3, 10, dim))
    curve = curves.path_curve(path, 91)
    assert curve.shape == (3, 91, dim)
    np.testing.assert_allclose(curve[:, ::10], path, atol=1e-12)


def test_farthest_point_is_measured_from_the_segment_and_not_its_line():
    points = np.array([[0.5, 2.0], [-3.0, 4.0], [4.0, 3.9], [0.2, 0.0]])
    for order, index in (([0, 1, 2, 3], 1), ([0, 2, 3], 2), ([0, 3], 0)):
        farthest = curves.farthest_from_segment(points[order], np.zeros(2), np.array([1.0, 0.0]))
        assert farthest.tolist() == points[index].tolist()


@given(seeds, dims)
def test_farthest_point_is_farther_than_all_others(seed, dim):
    points = np.random.default_rng(seed).normal(size=(3, 12, dim))
    start, end = points[0, 0], points[0, -1]
    farthest = curves.farthest_from_segment(points, start, end)
    distance = distance_to_segment(points, start, end)
    np.testing.assert_allclose(distance_to_segment(farthest, start, end), distance.max(-1))


def test_a_line_does_not_turn_and_a_circle_turns_all_the_way():
    along = np.linspace(0, 1, 200)[:, None]
    assert curves.turning(along * [[3.0, 1.0, -2.0]]) == pytest.approx(0, abs=1e-6)
    angle = 2 * np.pi * along
    circle = np.concatenate([np.cos(angle), np.sin(angle)], axis=1)
    assert curves.turning(circle) == pytest.approx(2 * np.pi * 198 / 199)
    there_and_back = np.concatenate([circle[:100], circle[:99][::-1]])
    assert curves.turning(there_and_back) == pytest.approx(2 * 98 * 2 * np.pi / 199 + np.pi)


@given(seeds, st.integers(2, 30), dims, st.floats(0.1, 10))
def test_turning_is_of_the_shape(seed, size, dim, scale):
    rng = np.random.default_rng(seed)
    points = polyline(seed, size, dim)
    found = curves.turning(points)
    assert 0 <= found <= np.pi * (size - 2) + 1e-9
    axes = np.linalg.qr(rng.normal(size=(dim, dim)))[0]
    moved = scale * points @ axes + rng.normal(size=dim)
    for same in (moved, points[::-1], refine(points, rng, 20)):
        assert curves.turning(same) == pytest.approx(found, abs=1e-4)
    stacked = curves.turning(np.stack([points, points[::-1]]))
    np.testing.assert_allclose(stacked, found, atol=1e-9)


def test_standing_still_is_not_turning():
    assert curves.turning(np.zeros((5, 2))) == 0
    corner = np.array([[0, 0], [1, 0], [1, 1]])
    assert curves.turning(corner) == pytest.approx(np.pi / 2)
    assert curves.turning(corner[[0, 0, 1, 2, 2]]) == pytest.approx(np.pi / 2)
    assert np.isnan(curves.turning(np.array([[0, 0], [1, 0], [1, 1], [np.nan, 0]])))
