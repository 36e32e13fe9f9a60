"""An obstacle's signed distance is that of geometry, in NumPy and in PyTorch."""

import copy
import json
import pickle

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from legibility import Ball, Box, Polygon
from legibility.errors import InvalidSceneError
from legibility.obstacles import Solids, obstacle_from_dict, solids_of

seeds = st.integers(0, 2**32 - 1)
dims = st.sampled_from([2, 3])


def turn(rng, dim):
    """A random rotation matrix."""
    matrix = np.linalg.qr(rng.normal(size=(dim, dim)))[0]
    matrix[0] *= np.linalg.det(matrix)
    return matrix


def random_ball(rng, dim):
    return Ball(rng.uniform(-1, 1, dim), rng.uniform(0.05, 0.5))


def random_box(rng, dim):
    rotation = turn(rng, dim) if rng.random() < 0.5 else rng.uniform(-4, 4)
    return Box(rng.uniform(-1, 1, dim), rng.uniform(0.1, 1, dim), rotation)


def random_polygon(rng):
    angles = np.sort(rng.uniform(0, 2 * np.pi, rng.integers(3, 8)))
    ellipse = np.stack([np.cos(angles), rng.uniform(0.3, 1) * np.sin(angles)], axis=-1)
    vertices = rng.uniform(0.1, 0.6) * ellipse + rng.uniform(-1, 1, 2)
    return Polygon(vertices[:: rng.choice([-1, 1])])


def random_obstacle(rng, dim):
    makers = [random_ball, random_box] + [lambda r, _: random_polygon(r)] * (dim == 2)
    return makers[rng.integers(len(makers))](rng, dim)


def random_solids(rng, dim):
    return [random_obstacle(rng, dim) for _ in range(rng.integers(1, 5))]


def surface(obstacle, rng, num=20_000):
    """Points `(num, D)` on an obstacle's surface."""
    if isinstance(obstacle, Ball):
        direction = rng.normal(size=(num, obstacle.dim))
        direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
        return obstacle.center + obstacle.radius * direction
    if isinstance(obstacle, Box):
        points = rng.uniform(-0.5, 0.5, (num, obstacle.dim))
        face = rng.integers(obstacle.dim, size=num)
        points[np.arange(num), face] = rng.choice([-0.5, 0.5], num)
        return obstacle.center + (points * obstacle.size) @ obstacle.rotation.T
    ends = np.roll(obstacle.vertices, -1, axis=0)
    side = rng.integers(len(ends), size=num)
    along = rng.random((num, 1))
    return (1 - along) * obstacle.vertices[side] + along * ends[side]


def is_inside(obstacle, points):
    """By half-spaces, not by distance."""
    if isinstance(obstacle, Ball):
        return ((points - obstacle.center) ** 2).sum(-1) < obstacle.radius**2
    if isinstance(obstacle, Box):
        local = (points - obstacle.center) @ obstacle.rotation
        return (np.abs(local) < obstacle.size / 2).all(-1)
    a, b = obstacle.vertices, np.roll(obstacle.vertices, -1, axis=0)
    edge, offset = b - a, points[:, None] - a
    return (edge[:, 0] * offset[..., 1] - edge[:, 1] * offset[..., 0] > 0).all(-1)


class TestDistance:
    @given(seeds, dims)
    def test_is_that_from_points_of_the_surface(self, seed, dim):
        rng = np.random.default_rng(seed)
        obstacle = random_obstacle(rng, dim)
        points, skin = rng.uniform(-2, 2, (15, dim)), surface(obstacle, rng)
        gaps = np.linalg.norm(points[:, None] - skin, axis=-1).min(-1)
        distance = obstacle.signed_distance(points)
        np.testing.assert_array_equal(distance < 0, is_inside(obstacle, points))
        assert (np.abs(distance) <= gaps + 1e-9).all()
        assert (gaps - np.abs(distance) < 0.03).all()
        np.testing.assert_allclose(obstacle.signed_distance(skin), 0, atol=1e-9)

    @pytest.mark.parametrize(
        ("obstacle", "point", "distance"),
        [
            (Ball([1, 1], 0.5), [4, 5], 4.5),
            (Ball([1, 1], 0.5), [1, 1], -0.5),
            (Ball([0, 0, 1], 0.5), [0, 0, 3], 1.5),
            (Box([1, 1], [2, 4]), [5, 7], 5),
            (Box([1, 1], [2, 4]), [1.5, 1], -0.5),
            (Box([0, 0], [2, 4], np.pi / 2), [0, 3], 2),
            (Box([0, 0, 0], [2, 4, 6], np.pi / 2), [3, 0, 7], np.hypot(1, 4)),
            (Box([0, 0], [2, 2], np.pi / 4), [2, 0], 2 - 2**0.5),
            (Polygon([[0, 0], [4, 0], [0, 4]]), [4, 4], 8**0.5),
            (Polygon([[0, 0], [4, 0], [0, 4]]), [-3, -4], 5),
            (Polygon([[0, 0], [0, 4], [4, 0]]), [1, 0.5], -0.5),
        ],
    )
    def test_by_hand(self, obstacle, point, distance):
        assert obstacle.signed_distance(point) == pytest.approx(distance, abs=1e-12)

    @given(seeds, dims)
    def test_moves_turns_and_scales_with_the_obstacles(self, seed, dim):
        rng = np.random.default_rng(seed)
        rotation, shift, scale = turn(rng, dim), rng.normal(size=dim), rng.uniform(0.01, 100)

        def moved(points):
            return scale * points @ rotation.T + shift

        def other(obstacle):
            if isinstance(obstacle, Ball):
                return Ball(moved(obstacle.center), scale * obstacle.radius)
            if isinstance(obstacle, Polygon):
                return Polygon(moved(obstacle.vertices))
            return Box(moved(obstacle.center), scale * obstacle.size, rotation @ obstacle.rotation)

        obstacles, points = random_solids(rng, dim), rng.uniform(-2, 2, (20, dim))
        here, slope = solids_of(obstacles, dim).nearest(points)
        there, turned = solids_of([other(o) for o in obstacles], dim).nearest(moved(points))
        np.testing.assert_allclose(there, scale * here, atol=1e-9 * scale)
        np.testing.assert_allclose(turned, slope @ rotation.T, atol=1e-6)

    @given(seeds, dims)
    def test_of_several_is_the_least_and_a_margin_is_less(self, seed, dim):
        rng = np.random.default_rng(seed)
        obstacles, points = random_solids(rng, dim), rng.uniform(-2, 2, (20, dim))
        balls = rng.uniform(-1, 1, (2, dim))
        each = [o.signed_distance(points) - 0.1 for o in obstacles]
        each += [np.linalg.norm(points - ball, axis=-1) - 0.2 for ball in balls]
        solids = solids_of(obstacles, dim, 0.1, balls, 0.2)
        np.testing.assert_allclose(solids.distance(points), np.min(each, axis=0), atol=1e-12)

    @pytest.mark.parametrize("dim", [2, 3])
    def test_without_obstacles_everything_is_far(self, dim):
        assert (solids_of([], dim).distance(np.eye(dim) * 1e3) > 1e5).all()

    @given(seeds, dims)
    def test_kilometres_away(self, seed, dim):
        rng = np.random.default_rng(seed)
        ball, points = random_ball(rng, dim), rng.uniform(-2, 2, (20, dim))
        far = Ball(ball.center + 1e6, ball.radius)
        np.testing.assert_allclose(
            far.signed_distance(points + 1e6), ball.signed_distance(points), atol=1e-8
        )

    @given(seeds, dims)
    def test_leading_axes(self, seed, dim):
        rng = np.random.default_rng(seed)
        obstacle, points = random_obstacle(rng, dim), rng.uniform(-2, 2, (2, 3, 4, dim))
        distance = obstacle.signed_distance(points)
        assert distance.shape == (2, 3, 4)
        assert obstacle.signed_distance(points[1, 2, 3]) == pytest.approx(distance[1, 2, 3])
        assert obstacle.signed_distance(points[:0]).shape == (0, 3, 4)


class TestGradient:
    @given(seeds, dims)
    def test_is_that_of_finite_differences(self, seed, dim):
        rng = np.random.default_rng(seed)
        solids = solids_of(random_solids(rng, dim), dim, 0.05)
        points, step = rng.uniform(-2, 2, (30, dim)), 1e-6
        _, slope = solids.nearest(points)
        pairs = [(solids.distance(points + e), solids.distance(points - e))
                 for e in step * np.eye(dim)]  # fmt: skip
        here = solids.distance(points)
        expected = np.stack([(a - b) / (2 * step) for a, b in pairs], axis=-1)
        # Where the distance has a crease between the two the gradient is of one side.
        smooth = np.all([np.abs(a + b - 2 * here) < 1e-8 for a, b in pairs], axis=0)
        assert smooth.sum() > 20
        np.testing.assert_allclose(slope[smooth], expected[smooth], atol=1e-4)
        np.testing.assert_allclose(np.linalg.norm(slope[smooth], axis=-1), 1, atol=1e-9)

    @given(seeds, dims)
    def test_distance_is_1_lipschitz(self, seed, dim):
        rng = np.random.default_rng(seed)
        solids = solids_of(random_solids(rng, dim), dim)
        points, others = rng.uniform(-2, 2, (2, 50, dim))
        gap = np.linalg.norm(points - others, axis=-1)
        assert (np.abs(solids.distance(points) - solids.distance(others)) <= gap + 1e-9).all()
        assert (np.linalg.norm(solids.nearest(points)[1], axis=-1) <= 1 + 1e-9).all()

    @given(seeds, dims)
    def test_leads_out(self, seed, dim):
        """A step of the depth along the gradient ends on the surface."""
        rng = np.random.default_rng(seed)
        obstacle = random_obstacle(rng, dim)
        points = rng.uniform(-2, 2, (50, dim))
        distance, slope = solids_of([obstacle], dim).nearest(points)
        out = points - distance[:, None] * slope
        np.testing.assert_allclose(obstacle.signed_distance(out), 0, atol=1e-7)

    @pytest.mark.parametrize(
        ("obstacle", "point"),
        [
            (Ball([0, 0], 1), [0, 0]),
            (Box([0, 0], [2, 2]), [0, 0]),
            (Box([0, 0], [2, 2]), [1, 1]),
            (Polygon([[0, 0], [4, 0], [0, 4]]), [2, 0]),
            (Polygon([[0, 0], [4, 0], [0, 4]]), [0, 0]),
        ],
        ids=repr,
    )
    def test_at_creases_and_on_the_surface_it_leads_somewhere(self, obstacle, point):
        distance, slope = solids_of([obstacle], 2).nearest(np.array([point], dtype=float))
        assert np.isfinite(distance).all()
        assert 0.1 < np.linalg.norm(slope) <= 1 + 1e-12


class TestTorch:
    @staticmethod
    def tensors(solids, dtype=torch.float64):
        return Solids(*(torch.as_tensor(array, dtype=dtype) for array in solids))

    @given(seeds, dims)
    def test_equals_numpy(self, seed, dim):
        rng = np.random.default_rng(seed)
        solids = solids_of(random_solids(rng, dim), dim, 0.02, rng.uniform(-1, 1, (2, dim)), 0.1)
        points = rng.uniform(-2, 2, (20, dim))
        expected = solids.nearest(points)
        for dtype, tolerance in ((torch.float64, 1e-6), (torch.float32, 1e-4)):
            distance, slope = self.tensors(solids, dtype).nearest(torch.tensor(points, dtype=dtype))
            assert distance.dtype == slope.dtype == dtype
            np.testing.assert_allclose(distance, expected[0], atol=tolerance / 10)
            np.testing.assert_allclose(slope, expected[1], atol=tolerance)

    @given(seeds, dims)
    def test_gradient_is_that_of_autograd(self, seed, dim):
        rng = np.random.default_rng(seed)
        solids = self.tensors(solids_of(random_solids(rng, dim), dim))
        points = torch.tensor(rng.uniform(-2, 2, (20, dim)), requires_grad=True)
        distance, slope = solids.nearest(points)
        (expected,) = torch.autograd.grad(distance.sum(), points)
        np.testing.assert_allclose(slope.detach(), expected, atol=1e-6)

    @given(seeds, dims)
    def test_a_batch_of_scenes_equals_the_loop(self, seed, dim):
        rng = np.random.default_rng(seed)
        each = [
            solids_of([random_ball(rng, dim), random_box(rng, dim)]
                      + [Polygon([[0, 0], [rng.random() + 0.1, 0], [0, 1]])] * (dim == 2), dim)
            for _ in range(3)
        ]  # fmt: skip
        points = rng.uniform(-2, 2, (3, 10, dim))
        batch = Solids(*(np.stack(arrays) for arrays in zip(*each, strict=True)))
        distance, slope = batch.nearest(points)
        for i, solids in enumerate(each):
            one = solids.nearest(points[i])
            np.testing.assert_allclose(distance[i], one[0], atol=1e-12)
            np.testing.assert_allclose(slope[i], one[1], atol=1e-12)
        tensor = self.tensors(batch).distance(torch.tensor(points))
        np.testing.assert_allclose(tensor, distance, atol=1e-9)


class TestValues:
    @given(seeds, dims)
    def test_round_trips(self, seed, dim):
        obstacle = random_obstacle(np.random.default_rng(seed), dim)
        for again in (
            obstacle_from_dict(json.loads(json.dumps(obstacle.to_dict()))),
            copy.copy(obstacle),
            copy.deepcopy(obstacle),
            pickle.loads(pickle.dumps(obstacle)),
            eval(repr(obstacle)),
        ):
            assert again == obstacle
            assert hash(again) == hash(obstacle)
            for array in vars(again).values():
                assert not isinstance(array, np.ndarray) or not array.flags.writeable

    def test_files_may_tilt_a_box(self):
        matrix = turn(np.random.default_rng(0), 3)
        content = {"box": {"center": [0, 0, 0], "size": [1, 2, 3], "rotation": matrix.tolist()}}
        assert obstacle_from_dict(content) == Box([0, 0, 0], [1, 2, 3], matrix)
        yawed = {"box": {"center": [0, 0, 0], "size": [1, 2, 3], "yaw": 0.3}}
        assert obstacle_from_dict(yawed) == Box([0, 0, 0], [1, 2, 3], 0.3)

    def test_equality(self):
        assert Ball([0, 1], 1) == Ball((0.0, 1.0), np.float32(1))
        assert Ball([-0.0, 1], 1) == Ball([0, 1], 1)
        assert Ball([0, 1], 1) != Ball([0, 1], 2)
        assert Ball([0, 1], 1) != Box([0, 1], [1, 1])
        assert Ball([0, 1], 1) != "ball"
        assert Box([0, 0], [1, 1]) == Box([0, 0], [1, 1], 0)

    def test_do_not_follow_the_arrays_they_were_made_from_and_cannot_be_changed(self):
        center = np.array([0.0, 0])
        ball = Ball(center, 1)
        center += 1
        assert ball == Ball([0, 0], 1)
        with pytest.raises(ValueError, match="read-only"):
            ball.center[0] = 1
        with pytest.raises(AttributeError):
            ball.radius = 2

    def test_a_polygon_may_go_round_either_way_and_have_straight_corners(self):
        square = [[0, 0], [1, 0], [2, 0], [2, 2], [0, 2]]
        for vertices in (square, square[::-1]):
            assert Polygon(vertices).signed_distance([1, 0.5]) == pytest.approx(-0.5)

    def test_reprs_are_short(self):
        assert repr(Ball([0, 1], 0.5)) == "Ball(center=[0.0, 1.0], radius=0.5)"
        box = Box([0, 1], [1, 2], 0.3)
        assert repr(box) == "Box(center=[0.0, 1.0], size=[1.0, 2.0], rotation=0.3)"
        assert repr(Polygon([[0, 0], [1, 0], [0, 1]])).startswith("Polygon(vertices=[[0.0, 0.0], [")


EYE = np.eye(2).tolist()
BAD = {
    "radius 0": (lambda: Ball([0, 0], 0), "radius must be a number above 0, got 0"),
    "radius negative": (lambda: Ball([0, 0], -1), "radius must be a number above 0, got -1"),
    "radius NaN": (lambda: Ball([0, 0], np.nan), "radius must be finite, got nan"),
    "radius none": (lambda: Ball([0, 0], None), "radius must"),
    "centre of 4": (lambda: Ball([0] * 4, 1), "center must have 2 or 3 numbers a point"),
    "centre inf": (lambda: Ball([0, np.inf], 1), "center must be finite, got inf"),
    "centre text": (lambda: Box("here", [1, 1]), "center must be an array of numbers"),
    "flat box": (lambda: Box([0, 0], [1, 0]), "size must be above 0 along each axis"),
    "size of 3": (lambda: Box([0, 0], [1, 1, 1]), "size must have 2 numbers a point"),
    "size number": (lambda: Box([0, 0], 1), "size must have 1 axes"),
    "mirror": (lambda: Box([0, 0], [1, 1], [[1, 0], [0, -1]]), "rotation must be a yaw or"),
    "shear": (lambda: Box([0, 0], [1, 1], [[1, 1], [0, 1]]), "rotation must be a yaw or"),
    "rotation of 3": (lambda: Box([0, 0], [1, 1], np.eye(3)), "rotation must be a yaw or"),
    "euler": (lambda: Box([0] * 3, [1] * 3, [0, 0, 1]), "rotation must be a yaw or"),
    "rotation NaN": (lambda: Box([0, 0], [1, 1], np.nan), "rotation must be finite"),
    "two vertices": (lambda: Polygon(EYE), "vertices must be at least 3, got 2"),
    "3D vertices": (lambda: Polygon(np.eye(3)), "vertices must have 2 numbers a point"),
    "no area": (lambda: Polygon([[0, 0], [1, 1], [2, 2]]), "those of a convex polygon, in order"),
    "twice": (lambda: Polygon([[0, 0], [1, 0], [1, 0], [0, 1]]), "those of a convex polygon"),
    "dent": (lambda: Polygon([[0, 0], [2, 0], [0.5, 0.5], [0, 2]]), "those of a convex polygon"),
    "bow": (lambda: Polygon([[0, 0], [1, 1], [1, 0], [0, 1]]), "those of a convex polygon"),
    "star": (
        lambda: Polygon([[np.cos(a), np.sin(a)] for a in np.arange(5) * 4 * np.pi / 5]),
        "those of a convex polygon",
    ),
}


@pytest.mark.parametrize(("make", "message"), BAD.values(), ids=BAD)
def test_bad_obstacles_are_named(make, message):
    with pytest.raises(InvalidSceneError, match=message):
        make()


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "one key, ball, box or polygon, got None"),
        ([0, 0], "one key"),
        ({}, "one key"),
        ({"sphere": {}}, "one key"),
        ({"ball": {}, "box": {}}, "one key"),
        ({1: {}}, "one key"),
        ({"ball": [0, 0]}, "a ball has the keys center, radius, got"),
        ({"ball": {"center": [0, 0]}}, "a ball has the keys center, radius, got"),
        ({"ball": {"center": [0, 0], "radius": 1, "colour": 2}}, "a ball has the keys"),
        ({"box": {"center": [0, 0], "size": [1, 1], "yaw": 0, "rotation": EYE}}, "a box has the"),
        ({"box": {"size": [1, 1]}}, "a box has the keys center, rotation, size, yaw, got"),
        ({"polygon": {"vertices": []}}, "vertices must be an array of numbers"),
        ({"polygon": None}, "vertices must"),
    ],
    ids=repr,
)
def test_contents_that_are_not_an_obstacle(content, message):
    with pytest.raises(InvalidSceneError, match=message):
        obstacle_from_dict(content)


def test_points_of_another_dimension():
    with pytest.raises(ValueError, match="points must have 2 numbers a point"):
        Ball([0, 0], 1).signed_distance([0, 0, 0])
