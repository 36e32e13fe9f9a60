"""The start–target frame forgets where a scene lies, how it is turned and how large it is."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from legibility import InformationPotentialField, Scene
from legibility.models.frame import (
    DEPTH,
    FIELD_CHANNELS,
    WINDOW,
    Frame,
    scene_image,
    scene_vector,
    vector_size,
)

seeds = st.integers(0, 2**32 - 1)
dims = st.sampled_from([2, 3])


def random_scene(seed, dim, num_goals=3):
    return Scene.random(np.random.default_rng(seed), dim=dim, num_goals=num_goals)


def moved(scene, offset, scale=1.0, turn=False):
    """The whole scene scaled, turned by 90° about z if wanted, and moved."""

    def move(points):
        points = np.array(points) * scale
        if turn:
            points[..., :2] = np.stack([-points[..., 1], points[..., 0]], axis=-1)
        return points + offset

    corners = move(scene.workspace)
    return Scene(move(scene.start), move(scene.goals), [corners.min(0), corners.max(0)])


def vertical_scene(sign):
    start, goal = np.array([-0.1, 0.1, 0.2]), np.array([-0.1, 0.1, 0.2 + 0.15 * sign])
    return Scene(start, [goal, [0, -0.2, 0.05]])


class TestFrame:
    @given(seeds, dims, st.integers(0, 2))
    def test_start_is_the_origin_and_the_target_one_along_the_first_axis(self, seed, dim, target):
        scene = random_scene(seed, dim)
        frame = Frame.of(scene, target)
        np.testing.assert_array_equal(frame.world_to_frame(scene.start), np.zeros(dim))
        np.testing.assert_allclose(
            frame.world_to_frame(scene.goals[target]), np.eye(dim)[0], atol=1e-12
        )

    @given(seeds, dims)
    def test_rotation_is_one(self, seed, dim):
        rotation = Frame.of(random_scene(seed, dim), 0).rotation
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(dim), atol=1e-12)
        assert np.linalg.det(rotation) == pytest.approx(1)

    @given(seeds)
    def test_second_axis_is_horizontal_in_3d(self, seed):
        rotation = Frame.of(random_scene(seed, 3), 0).rotation
        assert rotation[1, 2] == pytest.approx(0, abs=1e-12)
        assert rotation[2, 2] >= 0  # the third points up

    @pytest.mark.parametrize("sign", [-1, 1])
    def test_vertical_line(self, sign):
        scene = vertical_scene(sign)
        frame = Frame.of(scene, 0)
        np.testing.assert_allclose(frame.rotation @ frame.rotation.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(frame.rotation) == pytest.approx(1)
        np.testing.assert_allclose(frame.world_to_frame(scene.goals[0]), [1, 0, 0], atol=1e-12)
        assert np.isfinite(scene_image(scene, 0, field_of(scene), 8)).all()

    @given(seeds, dims)
    def test_round_trip(self, seed, dim):
        frame = Frame.of(random_scene(seed, dim), 1)
        points = np.random.default_rng(seed).normal(size=(4, 5, dim))
        np.testing.assert_allclose(
            frame.frame_to_world(frame.world_to_frame(points)), points, atol=1e-12
        )
        np.testing.assert_allclose(
            frame.world_to_frame(frame.frame_to_world(points)), points, atol=1e-12
        )

    @given(seeds, dims)
    def test_distances_are_in_lengths_of_the_straight_line(self, seed, dim):
        scene = random_scene(seed, dim)
        frame = Frame.of(scene, 0)
        points = np.random.default_rng(seed).normal(size=(2, dim))
        length = np.linalg.norm(scene.goals[0] - scene.start)
        assert frame.scale == pytest.approx(length)
        assert np.linalg.norm(np.diff(frame.world_to_frame(points), axis=0)) == pytest.approx(
            np.linalg.norm(np.diff(points, axis=0)) / length
        )


def field_of(scene, sigma=0.15):
    return InformationPotentialField(scene.goals, sigma)


class TestWhatTheNetworkSees:
    @pytest.mark.parametrize(("dim", "slices"), [(2, 1), (3, DEPTH)])
    @pytest.mark.parametrize("resolution", [8, 16])
    def test_shapes(self, dim, slices, resolution):
        scene = random_scene(0, dim)
        image = scene_image(scene, 0, field_of(scene), resolution)
        vector = scene_vector(scene, 0, field_of(scene))
        assert image.shape == (FIELD_CHANNELS * slices, resolution, resolution)
        assert vector.shape == (vector_size(dim),)
        assert image.dtype == vector.dtype == np.float32

    @given(seeds, dims, st.integers(2, 6), st.floats(0.03, 0.5))
    def test_image_is_that_of_the_field_and_the_walls(self, seed, dim, goals, sigma):
        scene = random_scene(seed, dim, goals)
        field, frame = field_of(scene, sigma), Frame.of(scene, 1)
        sizes = (8, 8, DEPTH)[:dim]
        axes = [
            low + (np.arange(size) + 0.5) / size * (high - low)
            for (low, high), size in zip(WINDOW[:dim], sizes, strict=True)
        ]
        points = np.stack(np.meshgrid(*axes[::-1], indexing="ij")[::-1], axis=-1)
        points = frame.frame_to_world(points)
        potential, (low, high) = field.potential(points, 1), scene.workspace
        wall = np.minimum(points - low, high - points).min(axis=-1) / frame.scale
        expected = [np.exp(-potential), np.log1p(potential) / 2, np.tanh(2 * wall)]
        image = scene_image(scene, 1, field, 8).reshape(3, *sizes[::-1])
        np.testing.assert_allclose(image, expected, atol=1e-6)

    @given(seeds, dims)
    def test_finite_and_about_unit_scale(self, seed, dim):
        scene = random_scene(seed, dim, 6)
        field = field_of(scene, 0.15 if dim == 2 else 0.08)
        image, vector = scene_image(scene, 0, field, 8), scene_vector(scene, 0, field)
        assert np.isfinite(image).all()
        assert np.isfinite(vector).all()
        assert np.abs(image).max() < 5
        assert np.abs(vector).max() < 10

    @given(seeds, dims, st.floats(0.05, 20), st.floats(-3, 3), st.booleans())
    def test_image_of_the_moved_turned_and_scaled_scene_is_the_same(
        self, seed, dim, scale, offset, turn
    ):
        scene = random_scene(seed, dim)
        other = moved(scene, offset, scale, turn)
        np.testing.assert_allclose(
            scene_image(other, 1, field_of(other, 0.15 * scale), 8),
            scene_image(scene, 1, field_of(scene), 8),
            atol=1e-5,
        )

    @given(seeds, dims, st.floats(0.05, 20), st.floats(-3, 3))
    def test_vector_of_the_moved_and_scaled_scene_is_the_same(self, seed, dim, scale, offset):
        scene = random_scene(seed, dim)
        other = moved(scene, offset, scale)
        np.testing.assert_allclose(
            scene_vector(other, 1, field_of(other, 0.15 * scale)),
            scene_vector(scene, 1, field_of(scene)),
            atol=1e-5,
        )

    @given(seeds, dims)
    def test_vector_of_the_turned_scene_names_the_same_box(self, seed, dim):
        """The half-axes are the same arrows, under other names."""
        scene = random_scene(seed, dim)
        vectors = [scene_vector(s, 1, field_of(s)) for s in (scene, moved(scene, 0.3, 1.0, True))]
        boxes = []
        for vector in vectors:
            axes = vector[dim:-1].reshape(dim, dim).astype(np.float64)
            boxes.append(axes @ axes.T)
        np.testing.assert_allclose(vectors[1][:dim], vectors[0][:dim], atol=1e-5)
        np.testing.assert_allclose(boxes[1], boxes[0], atol=1e-5)
        assert vectors[1][-1] == pytest.approx(vectors[0][-1], abs=1e-6)

    def test_vector_gives_the_corners_of_the_workspace(self):
        scene = random_scene(3, 2)
        vector = scene_vector(scene, 0, field_of(scene)).astype(np.float64)
        centre, axes = vector[:2], vector[2:6].reshape(2, 2)
        corner = Frame.of(scene, 0).frame_to_world(centre + axes.sum(1))
        np.testing.assert_allclose(corner, scene.workspace[1], atol=1e-6)
        length = np.linalg.norm(scene.goals[0] - scene.start)
        assert vector[-1] == pytest.approx(np.log(length / 0.15), abs=1e-6)

    def test_another_sigma_another_target_another_wall_are_seen(self):
        scene = random_scene(3, 2)
        wider = Scene(scene.start, scene.goals, [[-0.2, -0.1], [1.1, 1.1]])
        plain = scene_image(scene, 0, field_of(scene), 8)
        for other in (
            scene_image(scene, 0, field_of(scene, 0.2), 8),
            scene_image(scene, 1, field_of(scene), 8),
            scene_image(wider, 0, field_of(wider), 8),
        ):
            assert np.abs(other - plain).max() > 0.01

    @pytest.mark.parametrize("dim", [2, 3])
    def test_pixels_lie_where_the_window_says(self, dim):
        """Row = second axis, column = first, depth slice = third; centres of the pixels."""
        scene, resolution = random_scene(7, dim), 16
        field, frame = field_of(scene), Frame.of(scene, 0)
        image = scene_image(scene, 0, field, resolution)
        image = image.reshape(FIELD_CHANNELS, *(DEPTH,) * (dim - 2), resolution, resolution)
        index = (3, 11, 5)[:dim]  # along the frame's axes
        sizes = (resolution, resolution, DEPTH)[:dim]
        point = np.array(
            [low + (i + 0.5) * (high - low) / n
             for i, n, (low, high) in zip(index, sizes, WINDOW, strict=False)]
        )  # fmt: skip
        point = frame.frame_to_world(point)
        pixel = image[(slice(None), *index[::-1])]
        low, high = scene.workspace
        wall = np.minimum(point - low, high - point).min() / frame.scale
        potential = field.potential(point, 0)
        expected = [field.posterior(point)[0], np.log1p(potential) / 2, np.tanh(2 * wall)]
        np.testing.assert_allclose(pixel, expected, atol=1e-5)
