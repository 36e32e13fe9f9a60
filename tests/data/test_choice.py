"""Paths chosen from an archive are flat along ℓ, short and clear of obstacles, for any observer."""

import numpy as np
import pytest

import legibility as lg
from legibility.curves import arc_length, path_curve
from legibility.data import dataset
from legibility.data.dataset import Choice
from legibility.intent.metrics import SCORE_POINTS
from legibility.motion.archive import build_archive


class TestSelect:
    SCENE = lg.Scene(
        [0, 0.5], [[0.8, 0.6], [1, 0.3]], obstacles=[lg.Ball([0.4, 0.62], 0.08)]
    )  # fmt: skip

    @pytest.fixture(scope="class")
    @staticmethod
    def archive():
        return build_archive(TestSelect.SCENE, cells=20, max_candidates=8192)

    @staticmethod
    def select(archive, num, efficiency=0.1, seed=0, seen=None):
        rng = np.random.default_rng(seed)
        return Choice.of(archive).select(seen or archive, np.linspace(-1, 1, num), efficiency, rng)

    def test_reproducible(self, archive):
        one, other = (self.select(archive, 17) for _ in range(2))
        for name, values in one.items():
            np.testing.assert_array_equal(other[name], values)

    @pytest.mark.parametrize("observer", [lg.Observer(), lg.Observer.paper(2)], ids=str)
    def test_scores_and_labels_are_the_archives(self, archive, observer):
        """Of the curve through the waypoints, for any observer; it keeps off the obstacle."""
        seen = archive.seen_by(observer)
        found = self.select(archive, 17, seen=seen)
        ends = np.tile([self.SCENE.start, self.SCENE.goals[0]], (17, 1, 1))
        paths = np.concatenate([ends[:, :1], found["waypoints"], ends[:, 1:]], axis=1)
        curves = path_curve(paths, SCORE_POINTS)
        assert self.SCENE.feasible(curves, 0).all()
        np.testing.assert_allclose(observer.score(curves, self.SCENE, 0), found["scores"])
        np.testing.assert_array_equal(seen.label_of(found["scores"]), found["labels"])

    def test_more_efficient_is_shorter(self, archive):
        lengths = []
        for efficiency in (0.01, 100.0):
            found = self.select(archive, 65, efficiency)
            curves = dataset.bezier_trajectories(found["controls"], 200)
            lengths.append(arc_length(curves).mean())
        assert lengths[0] < 0.97 * lengths[1]

    def test_labels_rise_with_the_level(self, archive):
        labels = self.select(archive, 33)["labels"]
        assert (np.diff(labels) > -0.04).all()

    @pytest.mark.parametrize("cells", [2, 3])
    def test_of_a_tiny_archive(self, cells):
        tiny = build_archive(
            self.SCENE, cells=cells, random_candidates=1024, max_candidates=1024
        )  # fmt: skip
        found = self.select(tiny, 9)
        assert found["labels"].shape == (9,)
        assert np.isfinite(found["waypoints"]).all()

    def test_where_every_path_touches(self, archive, monkeypatch):
        """The Béziers are free, the splines through eight of their points need not be."""
        monkeypatch.setattr(
            lg.Scene, "feasible", lambda scene, curves, target: np.zeros(len(curves), dtype=bool)
        )
        assert len(Choice.of(archive).paths) == len(archive)
