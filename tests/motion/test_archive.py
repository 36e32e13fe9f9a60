"""The archive is MAP-Elites, its elites are what they say they are, and its labels are a dial."""

import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from segments import distance_to_segment

import legibility as lg
from legibility.curves import arc_length, farthest_from_segment
from legibility.errors import InvalidInputError
from legibility.intent.metrics import DEFAULT_ALPHA, SCORE_POINTS
from legibility.motion.archive import DEFAULT_CELLS, Archive, CurveGrid, build_archive
from legibility.motion.bezier import bending_energy, bezier_trajectories, straight_controls

PAPER = lg.Scene([0, 0.5], [[0.8, 0.6], [1, 0.3]])
levels = st.floats(-1, 1)


def random_scene(seed, dim, num_goals=None):
    return lg.Scene.random(np.random.default_rng(seed), dim=dim, num_goals=num_goals)


def random_controls(rng, scene, num, target=0):
    """Curves from start to goal whose inner control points may lie beyond the workspace."""
    controls = np.tile(straight_controls(scene.start, scene.target(target)), (num, 1, 1))
    low, high = scene.workspace
    controls[:, 1:3] = rng.uniform(low - 0.3 * (high - low), high + 0.3 * (high - low),
                                   (num, 2, scene.dim))  # fmt: skip
    return controls


@pytest.fixture(scope="module", params=[(2, "anchored"), (2, "rank"), (3, "anchored")], ids=str)
def archive(request):
    dim, label = request.param
    observer, cells = lg.Observer(label=label), 20 if dim == 2 else 8
    return build_archive(random_scene(5, dim, 4), 1, seed=3, observer=observer, cells=cells)


@pytest.fixture(scope="module", params=[(2, 24), (2, 7), (3, 8)], ids=str)
def ours_and_pyribs(request):
    """Our grid and the elites of pyribs' archive, by rising cell, fed with the same curves."""
    archives = pytest.importorskip("ribs.archives")
    dim, cells = request.param
    rng = np.random.default_rng(dim)
    scene = random_scene(dim, dim)
    low, high = scene.workspace
    ours = CurveGrid(scene, 0, cells)
    theirs = archives.GridArchive(
        solution_dim=(4, dim),
        dims=[cells] * dim,
        ranges=list(zip(low, high, strict=True)),
        dtype=np.float64,
    )
    for _ in range(4):  # several batches: elites compete within and between them
        controls = random_controls(rng, scene, 2000)
        ours.add(controls)
        trajectories = bezier_trajectories(controls, SCORE_POINTS)
        inside = ((trajectories >= low) & (trajectories <= high)).all((1, 2))
        assert 0 < inside.sum() < 2000
        controls, trajectories = controls[inside], trajectories[inside]
        descriptors = farthest_from_segment(trajectories, scene.start, scene.target(0))
        theirs.add(controls, -bending_energy(controls), descriptors)
    data = theirs.data()
    return ours, {name: values[np.argsort(data["index"])] for name, values in data.items()}


class TestAgreesWithPyribs:
    def test_cells(self, ours_and_pyribs):
        ours, theirs = ours_and_pyribs
        assert len(theirs["index"]) > 40
        np.testing.assert_array_equal(ours.filled, theirs["index"])

    def test_objectives(self, ours_and_pyribs):
        ours, theirs = ours_and_pyribs
        np.testing.assert_array_equal(-ours.energies[ours.filled], theirs["objective"])

    def test_solutions(self, ours_and_pyribs):
        ours, theirs = ours_and_pyribs
        np.testing.assert_array_equal(ours.controls[ours.filled], theirs["solution"])


@given(st.integers(0, 10_000), st.sampled_from([2, 3]))
@settings(max_examples=10)
def test_grid_does_not_mind_the_order_or_the_batches(seed, dim):
    scene = random_scene(seed, dim)
    controls = random_controls(np.random.default_rng(seed), scene, 300)
    once, often = CurveGrid(scene, 0, 6), CurveGrid(scene, 0, 6)
    once.add(controls)
    new = [often.add(part) for part in np.array_split(controls[::-1], 7)]
    assert sum(new) == len(often.filled)
    np.testing.assert_array_equal(once.energies, often.energies)
    np.testing.assert_array_equal(once.controls, often.controls)
    np.testing.assert_array_equal(once.reached, often.reached)
    assert once.add(controls) == 0


def test_grid_counts_cells_that_only_invalid_curves_reach():
    grid = CurveGrid(PAPER, 0, 12)
    controls = straight_controls(PAPER.start, PAPER.target(0))[None].copy()
    controls[0, 1:3] = [[0.4, 2.6], [-1.6, 0.55]]  # out at the top, its extreme descriptor too
    assert grid.add(controls) == 0
    assert not len(grid.filled)


@given(st.integers(0, 2**32 - 1))
def test_cell_of_a_point_contains_it(seed):
    grid = CurveGrid(PAPER, 0, 12)
    points = np.random.default_rng(seed).uniform(*PAPER.workspace, (50, 2))
    index = np.stack(np.unravel_index(grid.cell_of(points), (12, 12)), axis=-1)
    side = (PAPER.workspace[1] - PAPER.workspace[0]) / 12
    low = PAPER.workspace[0] + index * side
    assert ((points >= low - 1e-12) & (points <= low + side + 1e-12)).all()


def test_rim_belongs_to_the_outermost_cells():
    grid = CurveGrid(PAPER, 0, 12)
    low, high = PAPER.workspace
    assert grid.cell_of(np.array([low, high, low - 1, high + 1])).tolist() == [0, 143, 0, 143]


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("seed", [0, 1, 2, 3])
def test_variation_fills_more_cells_than_plain_random_sampling(seed, dim):
    scene = random_scene(seed, dim)
    found = build_archive(scene, seed=seed)
    same = {"random_candidates": found.num_candidates, "max_candidates": found.num_candidates}
    plain = build_archive(scene, seed=seed, **same)
    assert plain.num_candidates == found.num_candidates
    assert len(found) > len(plain)
    assert found.cells_reached > plain.cells_reached
    # ... and what both filled is smoother.
    assert np.median(found.energies) < 0.9 * np.median(plain.energies)


@pytest.mark.parametrize("dim", [2, 3])
def test_coverage(dim):
    found = build_archive(random_scene(11, dim))
    assert found.cells_reached <= DEFAULT_CELLS[dim] ** dim
    assert 0.95 < found.coverage == len(found) / found.cells_reached <= 1


class TestElites:
    def test_shapes(self, archive):
        num, dim = len(archive), archive.scene.dim
        assert archive.controls.shape == (num, 4, dim)
        assert archive.trajectories.shape == (num, SCORE_POINTS, dim)
        assert archive.descriptors.shape == (num, dim)
        assert archive.energies.shape == archive.scores.shape == archive.labels.shape == (num,)
        assert archive.field.sigma == {2: 0.15, 3: 0.08}[dim]
        assert archive.field is archive.observer.field(archive.scene)
        assert (archive.observer.alpha, archive.target) == (DEFAULT_ALPHA, 1)

    def test_they_run_from_start_to_goal_inside_the_workspace(self, archive):
        scene = archive.scene
        np.testing.assert_array_equal(archive.trajectories[:, 0] - scene.start, 0)
        np.testing.assert_array_equal(archive.trajectories[:, -1] - scene.goals[1], 0)
        assert scene.contains(archive.trajectories, tolerance=0).all()

    def test_they_are_the_curves_of_their_controls(self, archive):
        np.testing.assert_allclose(
            archive.trajectories, bezier_trajectories(archive.controls, SCORE_POINTS), atol=1e-12
        )

    def test_points_are_at_equal_arc_length(self, archive):
        chords = np.linalg.norm(np.diff(archive.trajectories, axis=1), axis=-1)
        assert (chords.max(1) < 1.1 * arc_length(archive.trajectories) / (SCORE_POINTS - 1)).all()

    def test_descriptor_is_the_most_deviating_point(self, archive):
        scene = archive.scene
        distance = distance_to_segment(archive.trajectories, scene.start, scene.goals[1])
        own = distance_to_segment(archive.descriptors, scene.start, scene.goals[1])
        np.testing.assert_allclose(own, distance.max(1), atol=1e-12)
        gaps = np.linalg.norm(archive.trajectories - archive.descriptors[:, None], axis=-1)
        assert (gaps.min(1) < 1e-11).all()

    def test_each_lies_in_a_cell_of_its_own_in_the_order_of_the_cells(self, archive):
        cells = 20 if archive.scene.dim == 2 else 8
        index = CurveGrid(archive.scene, 1, cells).cell_of(archive.descriptors)
        assert (np.diff(index) > 0).all()

    def test_energies_are_bending_energies(self, archive):
        np.testing.assert_array_equal(archive.energies, bending_energy(archive.controls))

    def test_scores_are_legibility_scores(self, archive):
        np.testing.assert_array_equal(
            archive.scores,
            lg.metrics.legibility_score(archive.trajectories, archive.field, 1, DEFAULT_ALPHA),
        )

    def test_the_straight_line_is_one_of_them(self, archive):
        scene = archive.scene
        straight = np.linspace(scene.start, scene.goals[1], SCORE_POINTS)
        found = np.flatnonzero(archive.energies < 1e-20)
        assert len(found) == 1
        np.testing.assert_allclose(archive.trajectories[found[0]], straight, atol=1e-12)
        assert archive.scores[found[0]] == archive.straight_score
        assert archive.straight_score == pytest.approx(
            lg.metrics.legibility_score(straight, archive.field, 1), rel=1e-9
        )

    def test_it_is_never_less_smooth_than_what_a_fresh_draw_offers(self, archive):
        """Elites have been chosen: random curves of the same cells are rougher."""
        scene = archive.scene
        cells = 20 if scene.dim == 2 else 8
        grid = CurveGrid(scene, 1, cells)
        grid.add(random_controls(np.random.default_rng(0), scene, 2000, target=1))
        own = np.full(cells**scene.dim, np.inf)
        own[grid.cell_of(archive.descriptors)] = archive.energies
        assert np.mean(own[grid.filled] <= grid.energies[grid.filled]) > 0.95


class TestLabels:
    def test_are_the_label_functions(self, archive):
        expected = (
            lg.labels.rank_label(archive.scores)
            if archive.observer.label == "rank"
            else lg.labels.anchored_label(archive.scores, archive.straight_score)
        )
        np.testing.assert_array_equal(archive.labels, expected)

    def test_label_of_the_scores_are_the_labels(self, archive):
        np.testing.assert_allclose(archive.label_of(archive.scores), archive.labels, atol=1e-12)

    def test_both_ends_are_reached_and_nothing_is_beyond(self, archive):
        assert archive.labels.min() == -1 == archive.labels[np.argmin(archive.scores)]
        assert archive.labels.max() == 1 == archive.labels[np.argmax(archive.scores)]
        assert archive.label_of([-1e6, 0.0]).tolist() == [-1, 1]

    def test_label_of_is_monotone_and_keeps_shapes(self, archive):
        scores = np.linspace(archive.scores.min() - 1, archive.scores.max() + 1, 4001)
        found = archive.label_of(scores)
        assert (np.diff(found) >= 0).all()
        assert archive.label_of(scores.reshape(-1, 1)).shape == (4001, 1)
        assert np.shape(archive.label_of(-1.0)) == ()

    @given(level=levels)
    def test_score_of_is_the_inverse(self, archive, level):
        assert archive.label_of(archive.score_of(level)) == pytest.approx(level, abs=1e-6)

    @given(level=levels)
    def test_nearest_is_nearest(self, archive, level):
        index = archive.nearest(level)
        gaps = np.abs(archive.labels - level)
        assert isinstance(index, int)
        assert gaps[index] <= gaps.min() + 1e-9

    @pytest.mark.parametrize("score", [np.nan, np.inf, "high", None])
    def test_scores_that_are_none(self, archive, score):
        for method in (archive.label_of, archive.score_of):
            with pytest.raises(InvalidInputError):
                method(score)

    @pytest.mark.parametrize("level", [np.nan, np.inf, "high", None, [0.5]])
    def test_nearest_to_no_number(self, archive, level):
        with pytest.raises(InvalidInputError):
            archive.nearest(level)

    @pytest.mark.parametrize("dim", [2, 3])
    @pytest.mark.parametrize("seed", range(8))
    def test_anchored_labels_have_the_straight_line_alone_at_zero(self, seed, dim):
        found = build_archive(random_scene(seed, dim), seed=seed, cells=10)
        assert (found.labels == 0).sum() == 1
        assert found.energies[found.labels == 0] < 1e-20
        assert found.nearest(0) == np.argmin(found.energies)
        assert (found.labels.min(), found.labels.max()) == (-1, 1)
        assert found.label_of(found.straight_score) == 0

    def test_nearest_takes_the_smoothest_of_equals(self):
        args = {"scene": PAPER, "target": 0, "observer": lg.Observer(label="rank")}
        size = {"straight_score": 0.0, "num_candidates": 3, "cells_reached": 3}
        curves = dict.fromkeys(["controls", "trajectories", "descriptors"], np.zeros((3, 1)))
        scores = {"scores": np.array([0.0, 0.0, 1.0]), "labels": np.array([-0.5, -0.5, 1.0])}
        found = Archive(**args, **size, **curves, **scores, energies=np.array([2.0, 1.0, 0.0]))
        assert found.nearest(-0.5) == 1
        assert found.nearest(-1) == 1
        assert found.nearest(0.25) == 2  # all are as far: the smoothest of all
        assert found.nearest(0.2) == 1

    def test_rank_and_anchored_order_the_same_curves_alike(self):
        one, other = (
            build_archive(PAPER, cells=16, observer=lg.Observer(label=label))
            for label in ("rank", "anchored")
        )
        np.testing.assert_array_equal(one.scores, other.scores)
        np.testing.assert_array_equal(np.argsort(one.labels), np.argsort(other.labels))
        assert (one.labels != other.labels).any()


class TestReproducible:
    @pytest.mark.parametrize("dim", [2, 3])
    def test_same_seed_same_archive(self, dim):
        scene = random_scene(1, dim)
        one, other = (build_archive(scene, seed=7, cells=8) for _ in range(2))
        for name in ("controls", "trajectories", "scores", "labels", "energies"):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
        assert one.num_candidates == other.num_candidates

    def test_other_seed_other_archive(self):
        one, other = (build_archive(PAPER, seed=seed, cells=8) for seed in (0, 1))
        assert not np.array_equal(one.scores, other.scores)

    def test_seed_sequence_is_a_seed_too(self):
        seed = np.random.SeedSequence([1, 2, 3])
        one, other = (build_archive(PAPER, seed=seed, cells=8) for _ in range(2))
        np.testing.assert_array_equal(one.scores, other.scores)

    def test_other_seed_reads_the_same_score_alike(self):
        """The dial does not hang on the seed of the archive."""
        one, other = (build_archive(PAPER, seed=seed) for seed in (0, 1))
        scores = one.score_of(np.linspace(-1, 1, 41))
        assert np.abs(one.label_of(scores) - other.label_of(scores)).max() < 0.03


class TestSettings:
    def test_3d_default_cells(self):
        found = build_archive(random_scene(3, 3))
        index = CurveGrid(found.scene, 0, DEFAULT_CELLS[3]).cell_of(found.descriptors)
        assert (np.diff(index) > 0).all()
        assert len(found) > 1000

    def test_target_and_observer_are_used(self):
        found = build_archive(PAPER, 1, observer=lg.Observer(sigma=0.3, alpha=1.0), cells=8)
        np.testing.assert_array_equal(found.trajectories[:, -1] - PAPER.goals[1], 0)
        field = lg.InformationPotentialField(PAPER.goals, 0.3)
        np.testing.assert_array_equal(
            found.scores, lg.metrics.legibility_score(found.trajectories, field, 1, 1.0)
        )

    def test_candidates_are_counted_and_limited(self):
        found = build_archive(PAPER, random_candidates=100, max_candidates=1500, cells=48)
        assert found.num_candidates == 1500

    def test_more_patience_tries_more(self):
        tried = [build_archive(PAPER, cells=24, patience=p).num_candidates for p in (0.5, 1e-4)]
        assert tried[0] < tried[1]

    @given(st.integers(0, 2**32 - 1), st.sampled_from([2, 3]), st.sampled_from([0, 1]))
    @settings(max_examples=200)
    def test_straight_line_between_the_walls_is_kept(self, seed, dim, corner):
        """Rounding must not push it out of the workspace."""
        rng = np.random.default_rng(seed)
        workspace = np.sort(rng.uniform(-1, 1, (2, dim)), axis=0)
        start, goal, other = rng.uniform(*workspace, (3, dim))
        start[0], goal[:2] = workspace[corner, 0], workspace[corner, :2]
        scene = lg.Scene(start, [goal, other], workspace)
        grid = CurveGrid(scene, 0, 6)
        assert grid.add(straight_controls(scene.start, scene.target(0))[None]) == 1

    @pytest.mark.parametrize("seed", range(12))
    def test_goals_on_the_table(self, seed):
        """A goal on the workspace's wall is not the end of the straight line's place at ℓ = 0."""
        rng = np.random.default_rng(seed)
        (low, high), height = np.array(lg.scene.DEFAULT_WORKSPACE[3]), 0.02
        start, goal, other = rng.uniform(low, high, (3, 3))
        goal[2] = other[2] = height
        found = build_archive(lg.Scene(start, [goal, other]), cells=4)
        assert (found.energies < 1e-20).sum() == 1
        assert found.labels[np.argmin(found.energies)] == 0

    def test_workspace_of_another_unit(self):
        """A scene 1024 times as large has the same archive, 1024 times as large."""
        large = lg.Scene(PAPER.start * 1024, PAPER.goals * 1024, PAPER.workspace * 1024)
        one = build_archive(PAPER, cells=8)
        other = build_archive(large, cells=8, observer=lg.Observer(sigma=0.15 * 1024))
        np.testing.assert_array_equal(other.trajectories, one.trajectories * 1024)
        np.testing.assert_allclose(other.scores, one.scores, rtol=1e-12)
        np.testing.assert_allclose(other.labels, one.labels, atol=1e-12)

    @pytest.mark.parametrize(
        "wrong",
        [
            {"target": 2},
            {"target": -1},
            {"target": 0.0},
            {"target": None},
            {"observer": None},
            {"observer": "paper"},
            {"observer": lg.Observer},
            {"cells": 0},
            {"cells": 1},
            {"cells": 8.0},
            {"cells": True},
            {"seed": -1},
            {"seed": 1.5},
            {"seed": "lucky"},
            {"random_candidates": 0},
            {"max_candidates": 10},
            {"patience": 0},
            {"patience": np.nan},
        ],
        ids=str,
    )
    def test_bad_input(self, wrong):
        with pytest.raises(InvalidInputError, match=next(iter(wrong))):
            build_archive(PAPER, **{"cells": 4, **wrong})

    @pytest.mark.parametrize("scene", [None, PAPER.to_dict(), "scene.yaml"])
    def test_something_that_is_no_scene(self, scene):
        with pytest.raises(InvalidInputError, match="scene"):
            build_archive(scene)


THROUGHPUT = """
import time
import numpy as np
import legibility as lg

def best(function, repeats=6):
    times = []
    for _ in range(repeats):
        started = time.process_time()  # what other processes do does not count
        function()
        times.append(time.process_time() - started)
    return min(times)

def yardstick():
    rng = np.random.default_rng(0)
    x = rng.random((1024, 48))
    for _ in range(20):
        np.interp(np.sort(x.ravel()), np.arange(48) / 48, x[0])
        np.exp(x), np.sqrt(x), x @ x.T[:, :48]

scene = lg.Scene([0, .5], [[.8, .6], [1, .3]])
archive = lg.build_archive(scene)
tried = archive.num_candidates
curves = np.resize(archive.trajectories, (8192, *archive.trajectories.shape[1:]))
made = best(lambda: lg.build_archive(scene)) / tried
scored = best(lambda: lg.metrics.legibility_score(curves, archive.field, 0)) / len(curves)
print(1 / (made + scored), best(yardstick))
"""


def test_candidates_cost_little_more_than_their_arithmetic():
    """Generated, resampled and placed by `build_archive`, and each of them scored.

    About 4700 of them take as long as a fixed piece of NumPy, on any machine and one core.
    """
    threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    path = {"PYTHONPATH": str(next(iter(lg.__path__)).removesuffix("/legibility"))}
    run = subprocess.run(
        [sys.executable, "-c", THROUGHPUT], env={**threads, **path}, capture_output=True, text=True
    )
    assert run.returncode == 0, run.stderr
    rate, yardstick = map(float, run.stdout.split())
    assert rate * yardstick > 2000, f"{rate:,.0f} candidates/s, yardstick {yardstick * 1e3:.0f} ms"
