import functools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from legibility.checks import Array
from legibility.curves import arc_length, path_curve, resample, turning
from legibility.errors import InvalidSceneError
from legibility.intent.metrics import SCORE_POINTS
from legibility.intent.observer import Observer
from legibility.models.projection import Begun, cost_and_slopes, headed, project, start_turns
from legibility.models.room import CURVE_POINTS
from legibility.motion.archive import build_archive
from legibility.motion.bezier import bezier_trajectories
from legibility.motion.path import least_margin
from legibility.obstacles import Ball, Box, Polygon
from legibility.scene import TOUCH, Scene

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
    moved, feasible = project(paths[None], scene, 0, observer, wanted, longest=1.2)
    assert feasible.all()
    free, _ = project(paths[None], scene, 0, observer, wanted)
    lengths = [
        np.linalg.norm(np.diff(path_curve(p[0], 200), axis=0), axis=-1).sum() for p in (moved, free)
    ]
    assert lengths[0] < 1.25 < lengths[1]


@given(cases, st.sampled_from([0, 1, 5, CURVE_POINTS - 1]))
@settings(max_examples=12, deadline=None)
def test_slopes_are_those_of_the_cost(drawing, number):
    """By finite differences, whatever part of the motion comes before the curve."""
    scene, observer, paths = drawing
    rng, field = np.random.default_rng(number), observer.field(scene)
    steps = rng.normal(0.01, 0.004, (number, scene.dim))
    before = np.broadcast_to(
        scene.start - np.cumsum(steps, axis=0)[::-1], (len(paths), *steps.shape)
    )
    way = np.zeros_like(paths)
    way[:, 1:-1] = rng.normal(size=way[:, 1:-1].shape)

    def at(share: float) -> tuple[Array, ...]:
        curves = path_curve(paths + share * way, CURVE_POINTS)
        motions = np.concatenate([before, curves], axis=1)
        return motions, *cost_and_slopes(motions, field, 0, observer.alpha)

    (motions, cost, length, slope, tangents), higher, lower = at(0), at(1e-6), at(-1e-6)
    rises, growths = ((higher[i] - lower[i]) / 2e-6 for i in (1, 2))
    np.testing.assert_allclose((slope * way[:, 1:-1]).sum((1, 2)), rises, atol=1e-5)
    change = np.diff(path_curve(way, CURVE_POINTS), axis=1)
    np.testing.assert_allclose((tangents * change).sum((1, 2)), growths, atol=1e-5)
    np.testing.assert_allclose(length, arc_length(motions))
    np.testing.assert_allclose(cost, -observer.score(motions, scene, 0), rtol=0.02)


@given(cases, st.integers(0, 99))
@settings(max_examples=12, deadline=None)
def test_headed_paths_set_out_in_the_direction(drawing, seed):
    scene, _, paths = drawing
    heading = np.random.default_rng(seed).normal(size=scene.dim)
    heading /= np.linalg.norm(heading)
    bent = headed(paths, heading)
    np.testing.assert_array_equal(bent[:, [0, -1]], paths[:, [0, -1]])
    assert start_turns(bent, heading).max() < 1e-6
    first = path_curve(bent, 20_001)[:, :2]  # the curves themselves
    way = first[:, 1] - first[:, 0]
    assert ((way @ heading) / np.linalg.norm(way, axis=-1)).min() > 1 - 1e-4
    np.testing.assert_allclose(headed(bent, heading), bent, atol=1e-12)
    np.testing.assert_array_equal(headed(paths, 0 * heading), paths)


def test_start_turns_are_angles_to_the_direction():
    angles = np.array([0.0, 0.3, 1.5, 3.0, -0.3])
    ends = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    paths = np.linspace(0, 1, 10)[:, None] * ends[:, None]
    for heading in ([1.0, 0.0], [0.0, 1.0]):
        expected = np.arccos(ends @ heading)
        np.testing.assert_allclose(start_turns(paths, np.array(heading)), expected, atol=1e-7)


class TestBegun:
    """The rest of a motion under way."""

    @staticmethod
    def motion(seed: int, dim: int) -> tuple[Scene, Observer, Array, Array]:
        """A scene, the first part of a curve of its archive and paths from there to the goal."""
        rng = np.random.default_rng(1000 + seed)
        while True:
            scene, observer = cluttered(rng, dim), OBSERVERS[seed % 2]
            try:
                archive = build_archive(scene, observer=observer, cells=14, max_candidates=4096)
            except InvalidSceneError:
                continue
            curve = bezier_trajectories(archive.controls[[rng.integers(len(archive))]], 60)[0]
            states = curve[: rng.integers(8, 35)]
            here = scene.starting_at(states[-1])
            return scene, observer, states, drawn(rng, here, observer, np.linspace(-1, 1, 11))

    @pytest.mark.parametrize("moving", [True, False])
    @pytest.mark.parametrize("dim", [2, 3])
    def test_rests_come_clear_head_on_and_have_the_score_of_the_whole(self, dim, moving):
        """Measured over 60 scenes: clear 97 %, ahead 98 %, median error 0.001, missed by 6 %."""
        clear, turns, errors = [], [], []
        for seed in range(8):
            scene, observer, states, paths = self.motion(seed, dim)
            heading = (states[-1] - states[-2]) / np.linalg.norm(states[-1] - states[-2])
            begun = Begun(scene, states, heading if moving else 0 * heading)
            here, before = scene.starting_at(states[-1]), resample(states, SCORE_POINTS)[:-1]

            def whole(paths: Array, scene=scene, before=before, observer=observer) -> Array:
                first = np.broadcast_to(before, (len(paths), *before.shape))
                motions = np.concatenate([first, path_curve(paths, SCORE_POINTS)], axis=1)
                return observer.score(motions, scene, 0)

            own = whole(headed(paths, heading))
            wanted = (own + np.median(own)) / 2
            given_paths = headed(paths, begun.heading)
            moved, free = project(given_paths, here, 0, observer, wanted, begun=begun)
            np.testing.assert_array_equal(moved[:, [0, -1]], paths[:, [0, -1]])
            margin = least_margin(here, 0, moved[free])
            assert (margin >= -TOUCH * scene.diagonal).all()
            clear.append(free)
            turns.append(start_turns(moved, heading)[free])
            errors.append(np.abs(np.log(whole(moved) / wanted))[free])
        assert np.concatenate(clear).mean() > 0.9
        ahead = (np.concatenate(turns) < 0.1).mean()
        assert ahead > 0.9 if moving else ahead < 0.5
        assert np.median(np.concatenate(errors)) < 0.01
        assert (np.concatenate(errors) > 0.02).mean() < 0.2

    @given(cases)
    @settings(max_examples=6, deadline=None)
    def test_at_the_start_and_at_rest_it_changes_nothing(self, drawing):
        scene, observer, paths = drawing
        wanted = scores(paths, scene, observer) - 0.01
        begun = Begun(scene, scene.start[None], np.zeros(scene.dim))
        plain, free = project(paths, scene, 0, observer, wanted)
        same, also = project(paths, scene, 0, observer, wanted, begun=begun)
        np.testing.assert_allclose(same, plain, atol=1e-9)
        np.testing.assert_array_equal(also, free)

    def test_the_length_of_the_whole_is_limited(self):
        scene = Scene([0, 0.5], [[1, 0.5], [0.5, 1]], [[-1, -1], [2, 2]])
        states = np.linspace([0, 0.5], [0.3, 0.5], 9)
        here = scene.starting_at(states[-1])
        bow = 0.5 - 0.15 * np.sin(np.linspace(0, np.pi, 10))
        paths = np.stack([np.linspace(0.3, 1, 10), bow], axis=-1)[None]
        begun, observer = Begun(scene, states, np.array([1.0, 0.0])), Observer()
        wanted = 0.2 * scores(paths, here, observer)
        lengths = []
        for longest in (1.1, None):
            moved, free = project(paths, here, 0, observer, wanted, longest, begun)
            assert free.all()
            lengths.append(0.3 + float(arc_length(path_curve(moved[0], 200))))
        assert lengths[0] < 1.13 < lengths[1]


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
