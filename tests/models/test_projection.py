import functools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from legibility.checks import Array
from legibility.curves import path_curve, resample, turning
from legibility.errors import InvalidSceneError
from legibility.intent.observer import Observer
from legibility.models.projection import project
from legibility.motion.archive import build_archive
from legibility.motion.bezier import bezier_trajectories
from legibility.obstacles import Ball, Box, Polygon
from legibility.scene import Scene

OBSERVERS = (Observer(), Observer(kind="gaussian", prior="uniform"))


def cluttered(rng: np.random.Generator, dim: int) -> Scene:
    """A random scene with 1 to 4 obstacles, most of them near the straight line."""
    while True:
        scene = Scene.random(rng, dim=dim)
        obstacles = []
        for _ in range(int(rng.integers(1, 5))):
            radius = rng.uniform(0.04, 0.12) * scene.diagonal
            center = rng.uniform(*scene.workspace)
            if rng.random() < 0.6:
                center = scene.start + rng.uniform(0.15, 0.85) * (scene.goals[0] - scene.start)
                center = center + rng.normal(0, radius / 2, dim)
            kind = rng.integers(0, 3 if dim == 2 else 2)
            if kind == 0:
                obstacle = Ball(center, radius)
            elif kind == 1:
                obstacle = Box(center, rng.uniform(0.7, 2, dim) * radius, rng.uniform(0, np.pi))
            else:
                angles = np.arange(5) * 2 * np.pi / 5 + rng.uniform(-0.4, 0.4, 5)
                corners = np.stack([np.cos(angles), np.sin(angles)], -1)
                obstacle = Polygon(center + radius * corners)
            points = np.concatenate([scene.start[None], scene.goals])
            if obstacle.signed_distance(points).min() > 0.03 * scene.diagonal:
                obstacles.append(obstacle)
        if obstacles:
            margin = float(rng.choice([0, 0.01])) * scene.diagonal
            return Scene(scene.start, scene.goals, scene.workspace, obstacles, clearance=margin)


def drawn(rng: np.random.Generator, scene: Scene, observer: Observer, labels: Array) -> Array:
    """Paths `(B, 10, D)` as of a model that does not see the obstacles, a little noisy."""
    empty = Scene(scene.start, scene.goals, scene.workspace)
    archive = build_archive(empty, observer=observer, cells=14, max_candidates=4096)
    near = [np.argsort(np.abs(archive.labels - label))[rng.integers(4)] for label in labels]
    paths = np.ascontiguousarray(bezier_trajectories(archive.controls[near], 10))
    length = np.linalg.norm(scene.goals[0] - scene.start)
    paths[:, 1:-1] += rng.normal(0, 0.004 * length, paths[:, 1:-1].shape)
    return paths


@functools.lru_cache(maxsize=32)
def case(seed: int, dim: int) -> tuple[Scene, Observer, Array]:
    rng = np.random.default_rng(seed)
    scene, observer = cluttered(rng, dim), OBSERVERS[seed % 2]
    return scene, observer, drawn(rng, scene, observer, np.linspace(-1, 1, 11).repeat(2))


def scores(paths: Array, scene: Scene, observer: Observer) -> Array:
    return observer.score(path_curve(paths, 200), scene, 0)


cases = st.tuples(st.integers(0, 4), st.sampled_from([2, 3])).map(lambda x: case(*x))


@given(cases)
@settings(max_examples=12)
def test_only_paths_in_contact_move_and_none_gets_worse(drawing):
    scene, observer, paths = drawing
    given_paths = paths.copy()
    moved, feasible = project(paths, scene, 0, observer)
    np.testing.assert_array_equal(paths, given_paths)
    assert np.isfinite(moved).all()
    np.testing.assert_array_equal(moved[:, [0, -1]], paths[:, [0, -1]])
    before, after = (scene.margin_at(path_curve(p, 46), 0).min(-1) for p in (paths, moved))
    assert (after >= np.minimum(before, 0) - 1e-9).all()
    clear = scene.margin_at(path_curve(paths, 1001), 0).min(-1) > 0.002 * scene.diagonal
    np.testing.assert_array_equal(moved[clear], paths[clear])
    assert feasible[clear].all()
    # What it calls feasible is feasible, to the accuracy of the check at sharp corners.
    margin = scene.margin_at(path_curve(moved[feasible], 1001), 0)
    assert (margin >= -0.002 * scene.diagonal).all()


@given(cases)
@settings(max_examples=6)
def test_a_second_projection_changes_nothing(drawing):
    scene, observer, paths = drawing
    moved, feasible = project(paths, scene, 0, observer)
    again, still = project(moved[feasible], scene, 0, observer)
    np.testing.assert_array_equal(again, moved[feasible])
    assert still.all()


@given(cases, st.sampled_from([0.01, 1024.0]), st.sampled_from([0.0, 8.0]))
@settings(max_examples=8)
def test_scale_and_place_do_not_matter(drawing, scale, shift):
    scene, observer, paths = drawing

    def there(points: Array) -> Array:
        return points * scale + shift * scale

    obstacles = []
    for o in scene.obstacles:
        if isinstance(o, Ball):
            obstacles.append(Ball(there(o.center), o.radius * scale))
        elif isinstance(o, Box):
            obstacles.append(Box(there(o.center), o.size * scale, o.rotation))
        else:
            obstacles.append(Polygon(there(o.vertices)))
    elsewhere = Scene(
        there(scene.start), there(scene.goals), there(scene.workspace), obstacles,
        clearance=scene.clearance * scale,
    )  # fmt: skip
    # Only the mean: rounding may decide which way a path takes that stands on the ridge.
    here, feasible = project(paths, scene, 0, observer)
    moved, also = project(there(paths), elsewhere, 0, observer)
    np.testing.assert_allclose(also.mean(), feasible.mean(), atol=0.1)
    gaps = np.abs(moved - there(here)).max((1, 2)) / scale
    assert np.median(gaps) < 1e-6
    assert (gaps < 1e-6).mean() > 0.8


@pytest.mark.parametrize("exact", [False, True])
def test_each_row_is_moved_on_its_own(exact):
    scene, observer, paths = case(2, 2)
    wanted = scores(paths, scene, observer) - 0.01 if exact else None
    together, _ = project(paths, scene, 0, observer, wanted)
    for i in range(0, len(paths), 5):
        row = slice(i, i + 1)
        alone, _ = project(paths[row], scene, 0, observer, wanted[row] if exact else None)
        assert np.abs(alone - together[row]).max() < 1e-6 * scene.diagonal


def test_no_path_gets_longer_than_the_detour():
    scene = Scene([0, 0.5], [[1, 0.5], [0.5, 1]], [[-1, -1], [2, 2]])
    observer = Observer(detour=1.2)
    paths = np.stack([np.linspace(0, 1, 10), 0.5 - 0.2 * np.sin(np.linspace(0, np.pi, 10))], -1)
    wanted = scores(paths[None], scene, observer) * 0.2
    moved, feasible = project(paths[None], scene, 0, observer, wanted, shortest=1.0)
    assert feasible.all()
    free, _ = project(paths[None], scene, 0, observer, wanted)
    lengths = [
        np.linalg.norm(np.diff(path_curve(p[0], 200), axis=0), axis=-1).sum() for p in (moved, free)
    ]
    assert lengths[0] < 1.25 < lengths[1]


@pytest.mark.parametrize(("dim", "most_turning"), [(2, 0.8), (3, 0.4)])
def test_paths_come_clear_and_keep_their_label(dim, most_turning):
    rng = np.random.default_rng(dim)
    labels = np.linspace(-1, 1, 11).repeat(2)
    before, after, errors, turns = [], [], [], []
    while len(before) < 6:
        scene, observer = cluttered(rng, dim), OBSERVERS[len(before) % 2]
        try:
            archive = build_archive(scene, observer=observer, cells=14, max_candidates=4096)
        except InvalidSceneError:  # no way past the obstacles
            continue
        paths = drawn(rng, scene, observer, labels)
        moved, feasible = project(paths, scene, 0, observer, archive.score_of(labels))
        before.append(scene.feasible(path_curve(paths, 200), 0).mean())
        after.append(scene.feasible(path_curve(moved, 200), 0).mean())
        if not archive.degenerate:
            achieved = archive.label_of(scores(moved[feasible], scene, observer))
            errors.append(np.abs(achieved - labels[feasible]).mean())
        turns.append(
            np.subtract(
                *(turning(resample(path_curve(p, 200), 100)) for p in (moved, paths))
            ).mean()
        )
    assert np.mean(before) < 0.9
    assert np.mean(after) > 0.95
    assert np.mean(errors) < 0.04
    assert np.mean(turns) < most_turning
