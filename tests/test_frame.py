"""The start–target frame forgets where a scene lies, how it is turned and how large it is."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from legibility import Scene
from legibility.frame import Frame, axes_along

seeds = st.integers(0, 2**32 - 1)
dims = st.sampled_from([2, 3])


def random_scene(seed, dim, num_goals=3):
    return Scene.random(np.random.default_rng(seed), dim=dim, num_goals=num_goals)


def assert_is_rotation(matrix):
    np.testing.assert_allclose(matrix @ matrix.T, np.eye(len(matrix)), atol=1e-12)
    assert np.linalg.det(matrix) == pytest.approx(1)


@given(seeds, dims, st.integers(0, 2))
def test_start_is_the_origin_and_the_target_one_along_the_first_axis(seed, dim, target):
    scene = random_scene(seed, dim)
    frame = Frame.of(scene, target)
    np.testing.assert_array_equal(frame.world_to_frame(scene.start), np.zeros(dim))
    np.testing.assert_allclose(
        frame.world_to_frame(scene.goals[target]), np.eye(dim)[0], atol=1e-12
    )


@given(seeds, dims)
def test_rotation_is_one(seed, dim):
    assert_is_rotation(Frame.of(random_scene(seed, dim), 0).rotation)


@given(seeds)
def test_second_axis_is_horizontal_in_3d(seed):
    rotation = Frame.of(random_scene(seed, 3), 0).rotation
    assert rotation[1, 2] == pytest.approx(0, abs=1e-12)
    assert rotation[2, 2] >= 0  # the third points up


@pytest.mark.parametrize("sign", [-1, 1])
def test_vertical_line(sign):
    start = [-0.1, 0.1, 0.2]
    scene = Scene(start, [(-0.1, 0.1, 0.2 + 0.15 * sign), [0, -0.2, 0.05]])
    frame = Frame.of(scene, 0)
    assert_is_rotation(frame.rotation)
    np.testing.assert_allclose(frame.world_to_frame(scene.goals[0]), [1, 0, 0], atol=1e-12)


@given(seeds, dims)
def test_round_trip(seed, dim):
    frame = Frame.of(random_scene(seed, dim), 1)
    points = np.random.default_rng(seed).normal(size=(4, 5, dim))
    for there, back in (
        (frame.world_to_frame, frame.frame_to_world),
        (frame.frame_to_world, frame.world_to_frame),
    ):
        np.testing.assert_allclose(back(there(points)), points, atol=1e-12)


@given(seeds, dims, st.floats(1e-3, 1e3), st.floats(-1e4, 1e4))
def test_moved_and_scaled_scenes_look_the_same(seed, dim, scale, offset):
    scene = random_scene(seed, dim)
    large = Scene(*(scale * x + offset for x in (scene.start, scene.goals, scene.workspace)))
    points = np.random.default_rng(seed).normal(size=(4, 5, dim))
    one, other = Frame.of(scene, 0), Frame.of(large, 0)
    length = np.linalg.norm(scene.goals[0] - scene.start)
    assert one.scale == pytest.approx(length)
    assert other.scale == pytest.approx(scale * length)
    rounding = 1e-13 * (1 + abs(offset) / scale) / length
    np.testing.assert_allclose(
        other.world_to_frame(scale * points + offset), one.world_to_frame(points),
        atol=1e3 * rounding,
    )  # fmt: skip


@given(seeds, st.floats(-np.pi, np.pi))
def test_turned_scenes_look_the_same(seed, yaw):
    """About the vertical; in the plane in any way."""
    turn = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
    direction = np.random.default_rng(seed).normal(size=(5, 3))
    expected = axes_along(direction) @ turn.T
    np.testing.assert_allclose(axes_along(direction @ turn.T), expected, atol=1e-9)
    flat, plane = direction[:, :2], turn[:2, :2]
    np.testing.assert_allclose(axes_along(flat @ plane.T), axes_along(flat) @ plane.T, atol=1e-9)


@pytest.mark.parametrize("dim", [2, 3])
def test_a_direction_of_no_length_is_the_first_axis(dim):
    np.testing.assert_array_equal(axes_along(np.zeros(dim)), np.eye(dim))
    for row in axes_along(np.random.default_rng(0).normal(size=(5, dim))):
        assert_is_rotation(row)


def test_frames_are_kept():
    scene = random_scene(0, 2)
    assert Frame.of(scene, 0) is Frame.of(random_scene(0, 2), 0)
    assert Frame.of(scene, 0) is not Frame.of(scene, 1)
