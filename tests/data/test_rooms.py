"""Random rooms, obstacles and observers are valid and spread as they should."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import legibility as lg
from legibility.data.rooms import add_obstacles, default_like, random_observer, random_room
from legibility.intent.observer import KINDS
from legibility.obstacles import Ball, Box, Polygon

seeds = st.integers(0, 2**32 - 1)
dims = st.sampled_from([2, 3])
LIKE = lg.Observer(alpha=1.0, detour=2.0, label="rank")


def room(seed, dim, obstacles=(0, 4)):
    rng = np.random.default_rng(seed)
    return random_room(rng, dim=dim, goals=(2, 8), obstacles=obstacles)


class TestRooms:
    @given(seeds, dims)
    def test_start_and_target_are_free_and_apart(self, seed, dim):
        scene = room(seed, dim)
        assert scene.check_target(0) == 0
        ends = np.stack([scene.start, scene.goals[0]])
        assert scene.feasible(ends, 0)
        assert 2 <= scene.num_goals <= 8
        assert len(scene.obstacles) <= 4
        assert np.linalg.norm(ends[1] - ends[0]) >= 0.2 * 0.2 * scene.diagonal

    @given(seeds, dims)
    def test_size_and_aspect(self, seed, dim):
        scene = room(seed, dim, (0, 0))
        sides = np.diff(scene.workspace, axis=0)[0]
        assert sides.max() <= 4 * sides.min() * (1 + 1e-9)
        assert 0.2 * (1 - 1e-9) <= scene.diagonal <= 6 * (1 + 1e-9)
        assert scene.goal_radius <= 0.1 * scene.diagonal
        assert scene.clearance <= 0.02 * scene.diagonal

    @pytest.mark.parametrize("dim", [2, 3])
    def test_they_spread(self, dim):
        rooms = [room(seed, dim) for seed in range(100)]
        sides = np.stack([np.diff(scene.workspace, axis=0)[0] for scene in rooms])
        assert np.ptp(np.log([scene.diagonal for scene in rooms])) > np.log(15)
        assert (sides.max(1) / sides.min(1)).max() > 2.5
        assert {scene.num_goals for scene in rooms} == set(range(2, 9))
        assert 0.3 < np.mean([scene.goal_radius > 0 for scene in rooms]) < 0.7
        assert 0.1 < np.mean([scene.clearance > 0 for scene in rooms]) < 0.5
        kinds = {type(obstacle) for scene in rooms for obstacle in scene.obstacles}
        assert kinds == {Ball, Box, Polygon} if dim == 2 else kinds == {Ball, Box}


@given(seeds, dims, st.floats(0, 0.02))
@settings(max_examples=15)
def test_obstacles_keep_off_start_and_goals_and_are_added(seed, dim, clearance):
    rng = np.random.default_rng(seed)
    plain = lg.Scene.random(rng, dim=dim, num_goals=3)
    before = lg.Scene(plain.start, plain.goals, plain.workspace, clearance=clearance)
    once = add_obstacles(rng, before, (1, 1))
    scene = add_obstacles(rng, once, (2, 3))
    assert scene.obstacles[: len(once.obstacles)] == once.obstacles
    assert len(scene.obstacles) <= 4
    points = np.concatenate([scene.start[None], scene.goals])
    for obstacle in scene.obstacles:
        assert obstacle.signed_distance(points).min() > clearance
    bare = lg.Scene(scene.start, scene.goals, scene.workspace, clearance=scene.clearance)
    assert bare == before


@pytest.mark.parametrize("dim", [2, 3])
def test_most_obstacles_bar_the_way(dim):
    """Of three scenes with two obstacles, in one at least they lie over the straight line."""
    blocked = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        scene = add_obstacles(rng, lg.Scene.random(rng, dim=dim), (2, 2))
        line = np.linspace(scene.start, scene.goals[0], 100)
        blocked.append(not scene.feasible(line, 0))
    assert np.mean(blocked) > 1 / 3


class TestObservers:
    @given(seeds, dims)
    def test_any_has_a_field_and_keeps_the_scale(self, seed, dim):
        rng = np.random.default_rng(seed)
        scene = random_room(rng, dim=dim, goals=(2, 8), obstacles=(0, 0))
        observer = random_observer(rng, scene, LIKE)
        assert observer.scale == LIKE.scale
        field = observer.field(scene)
        posterior = field.posterior(scene.start)
        assert posterior.sum() == pytest.approx(1)
        if observer.prior == "neutral":
            np.testing.assert_allclose(posterior, 1 / scene.num_goals, rtol=1e-6)
        if observer.kind == "boltzmann":
            assert 0.25 - 1e-9 <= observer.beta * scene.size / 20 <= 3 + 1e-9
        else:
            assert 6**-0.5 - 1e-9 <= observer.sigma / (0.15 * scene.size) <= 6**0.5 + 1e-9
            values = np.linalg.eigvalsh(field.precision)
            assert values[-1] / values[0] <= 16 * (1 + 1e-6)

    def test_they_spread(self):
        rng = np.random.default_rng(0)
        scene = lg.Scene.random(rng, num_goals=4)
        observers = [random_observer(rng, scene, LIKE) for _ in range(200)]
        for kind in KINDS:
            priors = [o.prior for o in observers if o.kind == kind]
            named = [p if isinstance(p, str) else "weights" for p in priors]
            assert {"neutral", "uniform", "weights"} == set(named)
            assert len(priors) > 60
        seen = [o for o in observers if o.viewpoint is not None]
        assert len(seen) > 30
        assert np.ptp([o.depth for o in seen]) > 2

    def test_default_like(self):
        observer = default_like(lg.Observer(kind="gaussian", alpha=1.0, detour=2.0, label="rank"))
        assert observer == LIKE
