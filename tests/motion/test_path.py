"""A path: its curve passes its waypoints inside the workspace, and the observer reads it."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import legibility as lg
from legibility.curves import arc_length
from legibility.errors import InvalidInputError
from legibility.intent.metrics import SCORE_POINTS
from legibility.motion.path import Path, scene_archive, straight_waypoints

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
    def test_inside_nothing_changes(self):
        waypoints = bent(SCENES[2], 0.02)
        path = through(waypoints, SCENES[2])
        np.testing.assert_array_equal(path.waypoints, waypoints)
        assert not path.clipped
        assert path.waypoints.shape == (10, 2)
        assert np.shape(path.clipped) == ()

    def test_clipped_where_the_curve_leaves_the_workspace(self):
        wild = np.stack([straight_waypoints(SCENES[2].start, SCENES[2].goals[0])] * 2)
        wild[1, 4] = [0.4, 3.0]
        path = through(wild, SCENES[2], legibility=[0.0, 0.0])
        assert path.clipped.tolist() == [False, True]
        np.testing.assert_array_equal(path.waypoints[0], wild[0])
        assert path.waypoints[1, 4].tolist() == [0.4, 1.1]


@pytest.mark.parametrize("dim", [2, 3])
class TestTrajectory:
    @given(seed=st.integers(0, 10_000), size=st.sampled_from([0.01, 0.3]),
           num_points=st.sampled_from([2, 3, 48, 200]))  # fmt: skip
    @settings(max_examples=20)
    def test_is_inside_and_ends_exactly(self, dim, seed, size, num_points):
        scene = SCENES[dim]
        trajectory = through(bent(scene, size, seed), scene).trajectory(num_points)
        assert trajectory.shape == (num_points, dim)
        assert scene.contains(trajectory, tolerance=0).all()
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
    scene, observer = SCENES[dim], lg.Observer(0.3, 1.0, "rank")
    path = through(bent(scene, 0.02), scene, observer=observer)
    field = lg.InformationPotentialField(scene.goals, 0.3)
    score = lg.metrics.legibility_score(path.trajectory(SCORE_POINTS), field, 0, 1.0)
    assert path.score == pytest.approx(score, rel=1e-9)
    assert path.field is observer.field(scene)
    archive = lg.build_archive(scene, 0, observer=observer)
    assert path.achieved == archive.label_of(path.score)


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

        def build(*args, observer):
            calls.append((*args, observer))
            return object()

        monkeypatch.setattr("legibility.motion.path.build_archive", build)
        scene_archive.cache_clear()
        yield calls
        scene_archive.cache_clear()

    def test_is_built_once_on_first_use(self, built):
        path, same = (through(bent(SCENES[2], size), SCENES[2]) for size in (0.01, 0.02))
        assert not built
        assert path.archive is same.archive
        assert built == [(SCENES[2], 0, OBSERVER)]

    def test_other_targets_and_observers_have_others(self, built):
        waypoints = bent(SCENES[2], 0.01)
        for target, observer in ((0, OBSERVER), (1, OBSERVER), (0, lg.Observer(alpha=1.0))):
            _ = through(waypoints, SCENES[2], target, observer=observer).archive
        assert len(built) == 3

    def test_only_the_last_are_kept(self, built):
        for seed in range(40):
            scene_archive(lg.Scene.random(np.random.default_rng(seed)), 0, OBSERVER)
        assert scene_archive.cache_info().currsize == 32
