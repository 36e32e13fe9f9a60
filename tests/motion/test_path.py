"""A path: its curve passes its waypoints inside the workspace, and the observer reads it."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import legibility as lg
from legibility.curves import arc_length
from legibility.errors import InvalidInputError
from legibility.intent.metrics import SCORE_POINTS
from legibility.motion import archive
from legibility.motion.path import Path, straight_waypoints

SCENES = {
    2: lg.Scene([0, 0.5], [[0.8, 0.6], [1, 0.3]]),
    3: lg.Scene([-0.2, -0.2, 0.3], [[0, 0.1, 0.02], [0.05, -0.1, 0.06], [-0.1, 0.2, 0.02]]),
}
OBSERVER = lg.Observer()


def through(waypoints, scene, target=0, legibility=0.5, observer=OBSERVER):
    return Path.through(np.asarray(waypoints), scene, target, np.asarray(legibility), observer)


def bent(scene, size, seed=0):
    """Waypoints from the start to goal 0, each moved by about `size` [m]."""
    waypoints = straight_waypoints(scene.start, scene.goals[0])
    waypoints[1:-1] += np.random.default_rng(seed).normal(0, size, (8, scene.dim))
    return waypoints


class TestThrough:
    def test_nothing_changes(self):
        waypoints = bent(SCENES[2], 0.02)
        path = through(waypoints, SCENES[2])
        np.testing.assert_array_equal(path.waypoints, waypoints)
        assert np.shape(path.replaced) == np.shape(path.feasible) == np.shape(path.clearance) == ()
        assert path.feasible
        assert not path.replaced

    def test_a_wild_path_is_not_feasible(self):
        wild = np.stack([straight_waypoints(SCENES[2].start, SCENES[2].goals[0])] * 2)
        wild[1, 4] = [0.4, 3.0]
        path = through(wild, SCENES[2], legibility=[0.0, 0.0])
        assert path.feasible.tolist() == [True, False]
        assert path.clearance[0] == pytest.approx(0.1)
        assert path.clearance[1] < -1

    def test_obstacles_and_their_clearance(self):
        base, line = SCENES[2], straight_waypoints(SCENES[2].start, SCENES[2].goals[0])
        ball = [lg.Ball([0.4, 0.7], 0.1)]
        apart = 0.15 / np.sqrt(1 + 0.125**2) - 0.1  # of the line y = 0.5 + x / 8
        for clearance, feasible in ((0.0, True), (apart - 1e-3, True), (apart + 1e-3, False)):
            scene = lg.Scene(base.start, base.goals, None, ball, clearance=clearance)
            path = through(line, scene)
            assert path.feasible == feasible
            assert path.clearance == pytest.approx(apart, abs=1e-4)


@pytest.mark.parametrize("dim", [2, 3])
class TestTrajectory:
    @given(seed=st.integers(0, 10_000), size=st.sampled_from([0.01, 0.3]),
           num_points=st.sampled_from([2, 3, 48, 200]))  # fmt: skip
    @settings(max_examples=20)
    def test_ends_exactly(self, dim, seed, size, num_points):
        scene = SCENES[dim]
        trajectory = through(bent(scene, size, seed), scene).trajectory(num_points)
        assert trajectory.shape == (num_points, dim)
        np.testing.assert_array_equal(trajectory[[0, -1]], [scene.start, scene.goals[0]])

    def test_passes_the_waypoints(self, dim):
        path = through(bent(SCENES[dim], 0.01), SCENES[dim])
        np.testing.assert_allclose(path.trajectory(91)[::10], path.waypoints, atol=1e-12)

    def test_length(self, dim):
        scene = SCENES[dim]
        straight = through(straight_waypoints(scene.start, scene.goals[0]), scene)
        distance = np.linalg.norm(scene.goals[0] - scene.start)
        assert straight.length == pytest.approx(distance, rel=1e-9)
        path = through(bent(scene, 0.02), scene)
        assert path.length == arc_length(path.trajectory()) > distance


@pytest.mark.parametrize("dim", [2, 3])
def test_read_by_its_observer(dim):
    scene, observer = (
        SCENES[dim],
        lg.Observer(kind="gaussian", prior="uniform", sigma=0.3, alpha=1.0, label="rank"),
    )
    path = through(bent(scene, 0.02), scene, observer=observer)
    field = lg.InformationPotentialField(scene.goals, 0.3)
    score = lg.metrics.legibility_score(path.trajectory(SCORE_POINTS), field, 0, 1.0)
    assert path.score == pytest.approx(score, rel=1e-9)
    assert path.field is observer.field(scene)
    judge = lg.build_archive(scene, 0, observer=observer)
    assert path.achieved == judge.label_of(path.score)


def test_rows_are_paths():
    paths = through(
        np.stack([bent(SCENES[2], 0.05, seed) for seed in range(3)]), SCENES[2],
        legibility=[-1.0, 0.0, 1.0],
    )  # fmt: skip
    assert paths.trajectory(7).shape == (3, 7, 2)
    for i in range(3):
        path = paths[i]
        np.testing.assert_array_equal(path.waypoints, paths.waypoints[i])
        assert path.score == pytest.approx(paths.score[i], rel=1e-9)
        assert path.length == pytest.approx(paths.length[i], rel=1e-9)
        assert path.legibility == paths.legibility[i]
        assert path.achieved == pytest.approx(paths.achieved[i], abs=1e-6)
        assert path.observer is paths.observer


def test_paths_are_rows():
    paths = through(
        np.stack([bent(SCENES[2], 0.05, seed) for seed in range(3)]), SCENES[2],
        legibility=[-1.0, 0.0, 1.0],
    )  # fmt: skip
    joined = Path.of([paths[i] for i in (2, 0, 1)])
    for i, row in enumerate((2, 0, 1)):
        for name in ("waypoints", "legibility", "replaced", "score"):
            np.testing.assert_array_equal(getattr(joined[i], name), getattr(paths[row], name))
    assert (joined.scene, joined.target, joined.observer) == (SCENES[2], 0, OBSERVER)


def test_levels_are_counted():
    scene = SCENES[2]
    path = through(np.stack([bent(scene, 0.02)] * 3), scene, legibility=[-1, 0, 1])
    assert len(path) == len(list(path)) == 3
    with pytest.raises(IndexError, match="3 levels, got index 3"):
        path[3]
    with pytest.raises(InvalidInputError, match="one level only"):
        through(bent(scene, 0.02), scene)[0]


@pytest.mark.parametrize("num_points", [0, 1, 2.5, "many"])
def test_number_of_points(num_points):
    with pytest.raises(InvalidInputError, match="num_points"):
        through(bent(SCENES[2], 0.0), SCENES[2]).trajectory(num_points)


class TestArchive:
    @pytest.fixture
    def built(self, monkeypatch):
        """The scenes, targets and observers of which archives are asked; nothing is built."""
        calls = []

        class Built:
            def seen_by(self, observer):
                return Built()

        def build(scene, target, observer, *_):
            calls.append((scene, target, observer.detour))
            yield
            return Built()

        monkeypatch.setattr(archive, "_built", build)
        for cache in (archive.scene_archive, archive._geometry):
            cache.cache_clear()
        yield calls
        for cache in (archive.scene_archive, archive._geometry):
            cache.cache_clear()

    def test_is_built_once_on_first_use(self, built):
        path, same = (through(bent(SCENES[2], size), SCENES[2]) for size in (0.01, 0.02))
        assert not built
        assert path.archive is same.archive
        assert built == [(SCENES[2], 0, OBSERVER.detour)]

    def test_other_targets_and_observers_have_others(self, built):
        waypoints = bent(SCENES[2], 0.01)
        others = (lg.Observer(alpha=1.0), lg.Observer(detour=2.0))
        found = [
            through(waypoints, SCENES[2], target, observer=observer).archive
            for target, observer in ((0, OBSERVER), (1, OBSERVER), *((0, o) for o in others))
        ]
        assert len(set(map(id, found))) == 4
        # Observers of one detour share the curves.
        assert built == [(SCENES[2], 0, 2.5), (SCENES[2], 1, 2.5), (SCENES[2], 0, 2.0)]

    def test_only_the_last_are_kept(self, built):
        for seed in range(80):
            archive.scene_archive(lg.Scene.random(np.random.default_rng(seed)), 0, OBSERVER)
        assert len(archive.scene_archive) == 64
        assert len(archive._geometry) == 32
