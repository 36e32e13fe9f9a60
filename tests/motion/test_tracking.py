"""A robot keeps its place on its path, whatever the path does."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from legibility.motion.tracking import PathTracker, feedback_action

WORKSPACE = np.array([[-0.1, -0.1], [1.1, 1.1]])
LIMIT = 0.05

SHAPES = {
    "straight": [[0.1 * i, 0.5] for i in range(10)],
    "loop": [
        [0.0, 0.2], [0.3, 0.2], [0.6, 0.25], [0.8, 0.5], [0.6, 0.8],
        [0.35, 0.75], [0.3, 0.5], [0.4, 0.2], [0.5, 0.05], [0.8, 0.0],
    ],
    "hairpin": [
        [0.0, 0.5], [0.25, 0.5], [0.5, 0.5], [0.75, 0.5], [0.95, 0.52],
        [0.95, 0.56], [0.75, 0.58], [0.5, 0.58], [0.25, 0.58], [0.0, 0.58],
    ],
    "figure of eight": [
        [0.5, 0.5], [0.7, 0.7], [0.9, 0.5], [0.7, 0.3], [0.5, 0.5],
        [0.3, 0.7], [0.1, 0.5], [0.3, 0.3], [0.45, 0.45], [0.55, 0.6],
    ],
}  # fmt: skip


def tracker(*names):
    return PathTracker(np.array([SHAPES[n] for n in names], dtype=float), LIMIT, WORKSPACE)


def walk(found, noise, seed, step=0.02):
    """Places and progress of a robot that moves along the path itself, a little beside it."""
    rng = np.random.default_rng(seed)
    true = np.arange(0, found.lengths[0] + step, step)
    places = found.points(true[None])[0]
    places[1:] += rng.normal(0, noise, places[1:].shape)
    seen = []
    for before, now in itertools.pairwise(places):
        found.update(now[None], before[None])
        seen.append(found.progress[0])
    return np.minimum(true[1:], found.lengths[0]), np.array(seen)


@pytest.mark.parametrize("shape", SHAPES)
@given(noise=st.sampled_from([0.0, 0.001, 0.003]), seed=st.integers(0, 99))
@settings(max_examples=12, deadline=None)
def test_the_place_is_kept(shape, noise, seed):
    true, seen = walk(tracker(shape), noise, seed)
    assert (np.diff(seen) >= 0).all()
    assert np.abs(seen - true).max() < 0.03


@given(seed=st.integers(0, 10_000))
@settings(max_examples=30, deadline=None)
def test_progress_never_falls_and_never_passes_the_end(seed):
    rng = np.random.default_rng(seed)
    found = tracker(*SHAPES)
    before = rng.uniform(*WORKSPACE, (len(SHAPES), 2))
    last = found.progress
    for _ in range(30):
        now = np.clip(before + rng.normal(0, 0.05, before.shape), *WORKSPACE)
        found.update(now, before)
        assert (found.progress >= last).all()
        assert (found.progress - last <= 1.5 * np.linalg.norm(now - before, axis=1) + LIMIT).all()
        assert (found.remaining >= 0).all()
        before, last = now, found.progress


def test_points_run_from_start_to_goal_and_stay_there():
    found = tracker(*SHAPES)
    ends = np.array([[s[0], s[-1]] for s in SHAPES.values()])
    np.testing.assert_allclose(found.points(np.zeros((4, 1)))[:, 0], ends[:, 0], atol=1e-12)
    beyond = found.lengths[:, None] + [0, 0.1, 5]
    np.testing.assert_allclose(found.points(beyond), np.repeat(ends[:, 1:], 3, axis=1), atol=1e-12)
    assert (found.points(np.linspace(0, 1, 50)[None] * found.lengths[:, None]) >= -0.1).all()


def test_arc_length_is_arc_length():
    found = tracker("loop")
    points = found.points(np.linspace(0, 1, 200)[None] * found.lengths)[0]
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    np.testing.assert_allclose(steps, found.lengths[0] / 199, rtol=0.02)


def test_of_and_replace():
    found = tracker("straight", "loop", "hairpin")
    found.progress[:] = [0.1, 0.2, 0.3]
    part = found.of(np.array([2, 0]))
    np.testing.assert_array_equal(part.progress, [0.3, 0.1])
    np.testing.assert_array_equal(part.lengths, found.lengths[[2, 0]])
    part.progress[:] = 0
    np.testing.assert_array_equal(found.progress, [0.1, 0.2, 0.3])
    found.replace(np.array([1]), np.array([SHAPES["straight"]], dtype=float))
    np.testing.assert_array_equal(found.progress, [0.1, 0, 0.3])
    assert found.lengths[1] == found.lengths[0]


def test_a_path_without_length_is_the_goal():
    point = np.full((1, 10, 2), 0.3)
    found = PathTracker(point, LIMIT, WORKSPACE)
    found.update(np.array([[0.4, 0.3]]), np.array([[0.4, 0.3]]))
    assert np.isfinite(found.ahead(np.array([0.0, 0.1]))).all()
    action = feedback_action(found, np.array([[0.4, 0.3]]))
    assert np.isfinite(action).all()
    assert action[0, 0] < 0


@given(seed=st.integers(0, 10_000))
@settings(max_examples=30, deadline=None)
def test_feedback_is_within_the_limit_and_leads_ahead(seed):
    rng = np.random.default_rng(seed)
    found = tracker(*SHAPES)
    found.progress = rng.uniform(0, 1, 4) * found.lengths
    places = rng.uniform(*WORKSPACE, (4, 2))
    action = feedback_action(found, places)
    assert (np.abs(action) <= LIMIT * (1 + 1e-12)).all()
    ahead = found.ahead(np.minimum(0.5 * LIMIT, 0.5 * found.remaining)[:, None])[:, 0]
    assert ((action * (ahead - places)).sum(1) >= 0).all()
