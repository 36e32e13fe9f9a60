"""A network's inputs forget where a scene lies, how it is turned and how large it is."""

import dataclasses

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

import legibility as lg
from legibility.data.rooms import random_observer, random_room
from legibility.frame import Frame
from legibility.models.conditions import Conditions
from legibility.models.inputs import (
    DEPTH,
    FIELD_CHANNELS,
    WINDOW,
    scene_image,
    scene_solids,
    scene_vector,
    solid_features,
    vector_size,
)

seeds = st.integers(0, 2**32 - 1)
dims = st.sampled_from([2, 3])


def drawn(seed, dim, obstacles=(1, 4)):
    """A random room and observer."""
    rng = np.random.default_rng(seed)
    scene = random_room(rng, dim=dim, goals=(2, 5), obstacles=obstacles)
    return scene, random_observer(rng, scene, lg.Observer())


def conditions(scene, observer, target=0):
    return Conditions.of([scene], [target], [observer], 8)


def visited(dim, seed=0, size=60):
    """Points in the frame, about what a path may visit, `(1, K, D)`."""
    rng = np.random.default_rng(seed)
    return torch.from_numpy((rng.random((1, size, dim)) * 3 - 1).astype(np.float32))


def many_corners(rng, scene):
    """The scene with a polygon of nine corners instead of other obstacles."""
    angles = np.linspace(0, 2 * np.pi, 9, endpoint=False) + rng.uniform(0, 1)
    circle = np.stack([np.cos(angles), 0.6 * np.sin(angles)], axis=-1)
    size = 0.2 * np.linalg.norm(scene.goals[0] - scene.start)
    polygon = lg.Polygon((scene.start + scene.goals[0]) / 2 + size * circle)
    return lg.Scene(scene.start, scene.goals, scene.workspace, [polygon])


def moved(scene, observer, offset, scale=1.0, turns=0):
    """Scene and observer scaled, turned by quarters of a turn about z, and moved."""
    dim, turn = scene.dim, np.eye(scene.dim)
    for _ in range(turns):
        quarter = np.eye(dim)
        quarter[:2, :2] = [[0, -1], [1, 0]]
        turn = quarter @ turn

    def move(points):
        return scale * np.asarray(points) @ turn.T + offset

    obstacles = []
    for o in scene.obstacles:
        if isinstance(o, lg.Ball):
            obstacles.append(lg.Ball(move(o.center), o.radius * scale))
        elif isinstance(o, lg.Box):
            obstacles.append(lg.Box(move(o.center), o.size * scale, turn @ o.rotation))
        else:
            obstacles.append(lg.Polygon(move(o.vertices)))
    corners = move(scene.workspace)
    other = lg.Scene(
        move(scene.start), move(scene.goals), [corners.min(0), corners.max(0)], obstacles,
        scene.goal_radius * scale, scene.clearance * scale,
    )  # fmt: skip
    changes = {}
    if observer.sigma is not None:
        changes["sigma"] = observer.sigma * scale
    if observer.beta is not None:
        changes["beta"] = observer.beta / scale
    if observer.viewpoint is not None:
        changes["viewpoint"] = tuple(move(observer.viewpoint).tolist())
    return other, dataclasses.replace(observer, **changes)


def same(found, expected):
    """To the rounding of float32 over what large log odds and a scaling leave of it."""
    torch.testing.assert_close(found, expected, rtol=2e-3, atol=2e-3)


class TestConditionsAreTheScenes:
    @given(seeds, dims, st.integers(0, 1))
    @settings(max_examples=30)
    def test_potential(self, seed, dim, target):
        scene, observer = drawn(seed, dim, (0, 0))
        inside = visited(dim, seed)
        world = Frame.of(scene, target).frame_to_world(inside[0].double().numpy())
        found = conditions(scene, observer, target).potential(inside)[0]
        expected = observer.field(scene).potential(world, target)
        np.testing.assert_allclose(found, expected, rtol=2e-3, atol=2e-3)

    @given(seeds, dims, st.integers(0, 1))
    @settings(max_examples=30)
    def test_margin(self, seed, dim, target):
        scene, observer = drawn(seed, dim)
        inside, frame = visited(dim, seed), Frame.of(scene, target)
        expected = scene.margin_at(frame.frame_to_world(inside[0].double().numpy()), target)
        found = conditions(scene, observer, target)
        for margin in (found.margin(inside), found.margin_and_gradient(inside)[0]):
            np.testing.assert_allclose(
                margin[0] * frame.scale, expected, atol=1e-4 * scene.diagonal
            )

    @given(seeds)
    @settings(max_examples=15)
    def test_margin_outside_of_polygons_of_many_corners(self, seed):
        """Inside a polygon that was cut, it is that of a part: negative, but less deep."""
        rng = np.random.default_rng(seed)
        scene = many_corners(rng, lg.Scene([0.1, 0.1], [[0.9, 0.8], [0.2, 0.9]]))
        inside, frame = visited(2, seed), Frame.of(scene, 0)
        expected = scene.margin_at(frame.frame_to_world(inside[0].double().numpy()), 0)
        found = conditions(scene, lg.Observer()).margin(inside)[0].numpy() * frame.scale
        outside = expected > 0
        np.testing.assert_allclose(found[outside], expected[outside], atol=1e-4)
        assert (found[~outside] < 1e-4).all()
        assert (found >= expected - 1e-4).all()

    @given(seeds, dims)
    @settings(max_examples=15)
    def test_gradients_are_autograds(self, seed, dim):
        scene, observer = drawn(seed, dim)
        seen, points = conditions(scene, observer), visited(dim, seed).requires_grad_()
        for found in (seen.potential_and_gradient, seen.margin_and_gradient):
            value, gradient = found(points)
            (expected,) = torch.autograd.grad(value.sum(), points)
            gaps = (gradient - expected).norm(dim=-1) / (1 + expected.norm(dim=-1))
            # At a ridge, which rounding may place on either side, any of several is one.
            assert gaps.median() < 1e-3
            assert (gaps < 1e-2).float().mean() > 0.9

    @given(seeds, dims)
    @settings(max_examples=15)
    def test_image(self, seed, dim):
        scene, observer = drawn(seed, dim)
        field, frame = observer.field(scene), Frame.of(scene, 1)
        sizes = (8, 8, DEPTH)[:dim]
        axes = [
            low + (np.arange(size) + 0.5) / size * (high - low)
            for (low, high), size in zip(WINDOW[:dim], sizes, strict=True)
        ]
        points = np.stack(np.meshgrid(*axes[::-1], indexing="ij")[::-1], axis=-1)
        points = frame.frame_to_world(points)
        potential = field.potential(points, 1)
        margin = scene.margin_at(points, 1) / frame.scale
        expected = [np.exp(-potential), np.log1p(potential) / 2, np.tanh(2 * margin)]
        image = scene_image(scene, 1, field, 8).reshape(3, *sizes[::-1])
        np.testing.assert_allclose(image, expected, rtol=1e-4, atol=1e-5)

    def test_vector_gives_the_corners_of_the_workspace_and_the_observer(self):
        scene = lg.Scene.random(np.random.default_rng(3))
        length = np.linalg.norm(scene.goals[0] - scene.start)
        vector = scene_vector(scene, 0, lg.Observer(beta=7.0).field(scene)).astype(np.float64)
        centre, axes = vector[:2], vector[2:6].reshape(2, 2)
        corner = Frame.of(scene, 0).frame_to_world(centre + axes.sum(1))
        np.testing.assert_allclose(corner, scene.workspace[1], atol=1e-6)
        np.testing.assert_allclose(vector[6:], [0, 0, 0, 0, 7 * length], rtol=1e-6)
        gaussian = scene_vector(scene, 0, lg.Observer.paper(2).field(scene))
        size = np.log1p(2 * (length / 0.15) ** 2)
        np.testing.assert_allclose(gaussian[6:], [0.5, 0, 0.5, size, 0], rtol=1e-6, atol=1e-6)


class TestMovedTurnedAndScaled:
    @given(seeds, dims, st.floats(0.05, 20), st.floats(-3, 3), st.integers(0, 3))
    @settings(max_examples=30)
    def test_the_conditions_are_the_same(self, seed, dim, scale, offset, turns):
        """The half-axes of workspace and boxes are the same arrows, perhaps under other names."""
        scene, observer = drawn(seed, dim)
        scene, observer = moved(scene, observer, -scene.start)  # without its large coordinates
        other, theirs = moved(scene, observer, offset * scale, scale, turns)
        one, two = conditions(scene, observer), conditions(other, theirs)
        for name in ("image", "slopes", "intercepts", "distractors", "solid_features"):
            a, b = (getattr(c, name) for c in (one, two))
            same(b, a)
        axes = dim + dim * dim
        box = slice(None) if turns == 0 else slice(axes, None)
        same(two.vector[:, box], one.vector[:, box])
        points = visited(dim, seed)
        same(two.potential(points), one.potential(points))
        same(two.margin(points), one.margin(points))


class TestBatches:
    @pytest.mark.parametrize("dim", [2, 3])
    def test_each_scene_is_what_it_is_alone(self, dim):
        """However many goals and obstacles of whichever kinds the others have."""
        pairs = [drawn(seed, dim, (0, 0) if seed % 3 == 0 else (1, 4)) for seed in range(8)]
        scenes, observers = zip(*pairs, strict=True)
        together = Conditions.of(scenes, [0] * 8, observers, 8)
        points = visited(dim).expand(8, -1, -1)
        for name in ("potential_and_gradient", "margin_and_gradient"):
            found = getattr(together, name)(points)
            for i, (scene, observer) in enumerate(pairs):
                alone = getattr(conditions(scene, observer), name)(points[:1])
                for one, other in zip(found, alone, strict=True):
                    torch.testing.assert_close(one[i], other[0], rtol=1e-4, atol=1e-4)
        for i, (scene, observer) in enumerate(pairs):
            alone = conditions(scene, observer)
            kept = together.solid_features[i][together.solid_features[i, :, -1] > 0]
            own = alone.solid_features[0][alone.solid_features[0, :, -1] > 0]
            torch.testing.assert_close(kept, own)
            assert torch.equal(together.image[i], alone.image[0])
            assert torch.equal(together.vector[i], alone.vector[0])

    @pytest.mark.parametrize("dim", [2, 3])
    def test_solids_that_are_not_there_never_count(self, dim):
        scene = lg.Scene.random(np.random.default_rng(0), dim=dim)
        seen, far = conditions(scene, lg.Observer()), 1e3 * visited(dim)
        assert not seen.solid_features.any()
        assert (seen.solids.distance(far) > 1e5).all()
        inward = seen.margin_and_gradient(far)[1]
        torch.testing.assert_close(inward.norm(dim=-1), torch.ones(1, far.shape[1]))


class TestShapes:
    @pytest.mark.parametrize(("dim", "slices"), [(2, 1), (3, DEPTH)])
    @pytest.mark.parametrize("resolution", [8, 16])
    def test_image_and_vector(self, dim, slices, resolution):
        scene, observer = drawn(0, dim)
        field = observer.field(scene)
        image, vector = scene_image(scene, 0, field, resolution), scene_vector(scene, 0, field)
        assert image.shape == (FIELD_CHANNELS * slices, resolution, resolution)
        assert vector.shape == (vector_size(dim),)
        assert image.dtype == vector.dtype == np.float32

    @given(seeds, dims)
    @settings(max_examples=20)
    def test_solids(self, seed, dim):
        """A row of features for each place of a solid; each that is there is marked."""
        scene, _ = drawn(seed, dim)
        *arrays, features = scene_solids(scene, 0)
        assert features.shape[1] == solid_features(dim)
        balls = scene.num_goals - 1 if scene.goal_radius else 0
        assert features[:, -1].sum() >= len(scene.obstacles) + balls
        assert all(np.isfinite(array).all() for array in (*arrays, features))

    @pytest.mark.parametrize("sign", [-1, 1])
    def test_vertical_line(self, sign):
        start, goal = np.array([-0.1, 0.1, 0.2]), np.array([-0.1, 0.1, 0.2 + 0.15 * sign])
        seen = conditions(lg.Scene(start, [goal, [0, -0.2, 0.05]]), lg.Observer())
        assert torch.isfinite(seen.image).all()
        assert torch.isfinite(seen.vector).all()

    @pytest.mark.parametrize("dim", [2, 3])
    def test_pixels_lie_where_the_window_says(self, dim):
        """Row = second axis, column = first, depth slice = third; centres of the pixels."""
        scene, observer = drawn(7, dim)
        resolution, field, frame = 16, observer.field(scene), Frame.of(scene, 0)
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
        margin, potential = scene.margin_at(point, 0) / frame.scale, field.potential(point, 0)
        expected = [field.posterior(point)[0], np.log1p(potential) / 2, np.tanh(2 * margin)]
        np.testing.assert_allclose(pixel, expected, rtol=1e-4, atol=1e-5)

    def test_another_observer_target_wall_or_obstacle_is_seen(self):
        scene, observer = lg.Scene.random(np.random.default_rng(3)), lg.Observer()
        wider = lg.Scene(scene.start, scene.goals, [[-0.2, -0.1], [1.1, 1.1]])
        ball = lg.Ball((scene.start + scene.goals[0]) / 2, 0.02)
        barred = lg.Scene(scene.start, scene.goals, obstacles=[ball])
        plain = conditions(scene, observer).image
        for other in (
            conditions(scene, lg.Observer(beta=3.0)),
            conditions(scene, observer, 1),
            conditions(wider, observer),
            conditions(barred, observer),
        ):
            assert (other.image - plain).abs().max() > 0.01
