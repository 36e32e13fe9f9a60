"""Paths without learning: nearest to ℓ, in bounds, the same from the same seed."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import legibility as lg
from legibility.baselines.planners import archive_path, candidates_within, search, straight_path
from legibility.errors import InvalidInputError

OBSERVER = lg.Observer()


def scene_of(seed, dim=2, num_goals=3):
    return lg.Scene.random(np.random.default_rng(seed), dim=dim, num_goals=num_goals)


def test_the_straight_line_is_straight():
    scene = scene_of(0)
    path = straight_path(scene, 1, 0.7, OBSERVER)
    assert path.length == pytest.approx(np.linalg.norm(scene.goals[1] - scene.start))
    np.testing.assert_array_equal(path.waypoints[[0, -1]], [scene.start, scene.goals[1]])
    assert path.feasible


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("label", ["anchored", "rank"])
def test_search_finds_what_is_asked(dim, label):
    scene = scene_of(3, dim)
    observer = lg.Observer(label=label)
    paths = [search(scene, 0, level, observer, 2000, 0) for level in (-1, -0.5, 0, 0.5, 1)]
    scores = [float(p.score) for p in paths]
    assert scores == sorted(scores)
    for path in paths:
        assert scene.contains(path.trajectory(100), 2e-3).all()
        np.testing.assert_allclose(path.waypoints[0], scene.start)
        np.testing.assert_allclose(path.waypoints[-1], scene.goals[0])
    if label == "anchored":
        assert paths[2].length == pytest.approx(np.linalg.norm(scene.goals[0] - scene.start))


@given(seed=st.integers(0, 200), goals=st.integers(2, 6), target=st.integers(0, 1))
@settings(max_examples=15, deadline=None)
def test_more_candidates_are_not_less_legible(seed, goals, target):
    """A search that draws on begins with the same curves."""
    scene = scene_of(seed, num_goals=goals)
    few, many = (search(scene, target, 1.0, OBSERVER, n, seed) for n in (50, 500))
    straight = straight_path(scene, target, 1.0, OBSERVER)
    slack = 1e-3 * abs(float(straight.score)) + 1e-9  # eight points of a curve are not all of it
    assert many.score >= straight.score - slack
    assert np.isfinite(few.waypoints).all()


def test_search_repeats_itself():
    scene = scene_of(5)
    first, second = (search(scene, 0, 0.8, OBSERVER, 300, 7).waypoints for _ in range(2))
    np.testing.assert_array_equal(first, second)
    assert (first != search(scene, 0, 0.8, OBSERVER, 300, 8).waypoints).any()
    with pytest.raises(InvalidInputError, match="num_candidates"):
        search(scene, 0, 0.8, OBSERVER, 0, 7)


def test_the_archives_own_paths():
    archive = lg.build_archive(scene_of(1), cells=12, random_candidates=512, max_candidates=2048)
    best = archive_path(archive, 1.0)
    assert best.score == pytest.approx(archive.scores.max(), rel=0.05, abs=1e-3)
    assert best.score > archive_path(archive, 0.0).score > archive_path(archive, -1.0).score


def test_search_keeps_clear_of_obstacles():
    empty = scene_of(2)
    middle = (empty.start + empty.goals[0]) / 2
    scene = lg.Scene(empty.start, empty.goals, obstacles=[lg.Ball(middle, 0.05)], clearance=0.02)
    for level in (-1, 1):
        path = search(scene, 0, level, OBSERVER, 1000, 0)
        gaps = scene.obstacles[0].signed_distance(path.trajectory(100))
        assert gaps.min() > 0.01  # of a curve through eight points of a free one


def test_more_time_is_more_candidates(monkeypatch):
    """The clock is that of a machine that takes a microsecond for a curve."""
    clock = [0.0]

    def draw(scene, target, level, observer, num_candidates, seed):
        clock[0] += 1e-6 * num_candidates

    monkeypatch.setattr("legibility.baselines.planners.search", draw)
    monkeypatch.setattr("legibility.baselines.planners.time.perf_counter", lambda: clock[0])
    found = [candidates_within(time, scene_of(1), 0, OBSERVER) for time in (1e-6, 1.0, 40.0)]
    assert found == [64, 724, 32_768]
