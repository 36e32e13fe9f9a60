"""The archive is MAP-Elites, its elites are what they say they are, and its labels are a dial."""

import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from segments import distance_to_segment

import legibility as lg
from legibility.curves import arc_length, farthest_from_segment, turning
from legibility.errors import InvalidInputError, InvalidSceneError
from legibility.intent.metrics import DEFAULT_ALPHA, SCORE_POINTS
from legibility.motion.archive import (
    SMALLEST_RANGE,
    Archive,
    build_archive,
    passable,
    scene_archive,
)
from legibility.motion.bezier import (
    bending_energy,
    bezier_points,
    bezier_trajectories,
    crosses_itself,
    straight_controls,
)
from legibility.motion.curve_grid import CurveGrid, free

PAPER = lg.Scene([0, 0.5], [[0.8, 0.6], [1, 0.3]])
BLOCKED = lg.Scene([0, 0.5], [[0.8, 0.6], [1, 0.3]], obstacles=[lg.Ball([0.4, 0.52], 0.1)])
CLUTTERED = lg.Scene(
    [0, 0.5],
    [[0.8, 0.6], [1, 0.3]],
    None,
    [
        lg.Ball([0.4, 0.55], 0.1),
        lg.Box([0.5, 0.2], [0.2, 0.1], 0.4),
        lg.Polygon([[0.5, 0.8], [0.7, 0.8], [0.6, 1]]),
    ],
    goal_radius=0.03,
    clearance=0.01,
)
SOLID = lg.Scene(
    [-0.25, 0.2, 0.3],
    [[0.05, -0.1, 0.1], [0, 0.2, 0.04], [-0.1, -0.2, 0.04]],
    None,
    [lg.Ball([-0.1, 0.05, 0.2], 0.05), lg.Box([-0.15, -0.1, 0.1], [0.1, 0.1, 0.2], 0.5)],
    goal_radius=0.03,
)
levels = st.floats(-1, 1)


def random_scene(seed, dim, num_goals=None):
    return lg.Scene.random(np.random.default_rng(seed), dim=dim, num_goals=num_goals)


def grid_of(archive):
    """An empty grid like that of the fixture."""
    longest = archive.observer.detour * archive.shortest_length
    return CurveGrid(archive.scene, 1, longest, 12 if archive.scene.dim == 2 else 6)


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
    observer, cells = lg.Observer(label=label), 12 if dim == 2 else 6
    return build_archive(random_scene(5, dim, 4), 1, seed=3, observer=observer, cells=cells)


@pytest.fixture(scope="module", params=[(2, 24), (2, 7), (3, 8)], ids=str)
def ours_and_pyribs(request):
    """Our grid and the elites of pyribs' archive, by rising cell, fed with the same curves."""
    archives = pytest.importorskip("ribs.archives")
    dim, cells = request.param
    rng = np.random.default_rng(dim)
    scene = random_scene(dim, dim)
    longest = 2 * np.linalg.norm(scene.goals[0] - scene.start)
    ours = CurveGrid(scene, 0, longest, cells)
    theirs = archives.GridArchive(
        solution_dim=(4, dim),
        dims=ours.cells.tolist(),
        ranges=list(zip(ours.low, ours.high, strict=True)),
        dtype=np.float64,
    )
    for _ in range(4):  # several batches: elites compete within and between them
        controls = random_controls(rng, scene, 2000)
        ours.add(controls)
        trajectories = bezier_trajectories(controls, SCORE_POINTS)
        kept = (
            free(scene, 0, controls)
            & (arc_length(trajectories) <= longest)
            & ~crosses_itself(controls)
        )
        assert 0 < kept.sum() < 2000
        controls, trajectories = controls[kept], trajectories[kept]
        descriptors = farthest_from_segment(trajectories, scene.start, scene.target(0))
        theirs.add(controls, -bending_energy(controls), ours.frame.world_to_frame(descriptors))
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
    once, often = CurveGrid(scene, 0, 2, 6), CurveGrid(scene, 0, 2, 6)
    once.add(controls)
    new = [often.add(part) for part in np.array_split(controls[::-1], 7)]
    assert sum(new) == len(often.filled)
    np.testing.assert_array_equal(once.energies, often.energies)
    np.testing.assert_array_equal(once.controls, often.controls)
    np.testing.assert_array_equal(once.reached, often.reached)
    assert once.add(controls) == 0


def test_grid_counts_cells_that_only_invalid_curves_reach():
    """A curve beyond a wall whose most deviating point is not."""
    scene = lg.Scene([0, 0.5], [[0.8, 0.6], [1, 0.5]], [[-0.1, 0.42], [1.1, 1.1]])
    controls = straight_controls(scene.start, scene.target(0))[None].copy()
    controls[0, 1:3] = [[0.3, 1.8], [0.6, -0.2]]
    grid = CurveGrid(scene, 0, 5, 12)
    assert not free(scene, 0, controls)[0]
    assert grid.add(controls) == 0
    assert not len(grid.filled)
    assert grid.reached.sum() == 1


@given(st.integers(0, 2**32 - 1), st.sampled_from([2, 3]))
def test_cell_of_a_point_contains_it(seed, dim):
    scene = random_scene(seed, dim)
    grid = CurveGrid(scene, 0, 2, 12)
    points = np.random.default_rng(seed).uniform(grid.low, grid.high, (50, dim))
    flat = grid.cell_of(grid.frame.frame_to_world(points))
    index = np.stack(np.unravel_index(flat, grid.cells), axis=-1)
    side = (grid.high - grid.low) / grid.cells
    low = grid.low + index * side
    assert ((points >= low - 1e-9) & (points <= low + side + 1e-9)).all()


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("cells", range(4, 12))
def test_no_border_between_cells_is_on_the_straight_line(dim, cells):
    """Rounding would choose the side."""
    grid = CurveGrid(random_scene(0, dim), 0, 1.5, cells)
    line = np.zeros((50, dim))
    line[:, 0] = np.linspace(0.01, 0.99, 50)
    beside = line + 1e-9 * np.append(0, np.ones(dim - 1))
    found = [grid.cell_of(grid.frame.frame_to_world(x)) for x in (line, beside, 2 * line - beside)]
    np.testing.assert_array_equal(found[0], found[1])
    np.testing.assert_array_equal(found[0], found[2])


def test_rim_belongs_to_the_outermost_cells():
    grid = CurveGrid(PAPER, 0, 2, 12)
    points = [grid.low, grid.high, grid.low - 1, grid.high + 1]
    last = int(np.prod(grid.cells)) - 1
    found = grid.cell_of(grid.frame.frame_to_world(np.array(points)))
    assert found[1:].tolist() == [last, 0, last]


@given(st.integers(0, 2**32 - 1), st.sampled_from([2, 3]))
def test_region_holds_all_curves_that_are_not_longer(seed, dim):
    scene = random_scene(seed, dim)
    trajectories = bezier_trajectories(
        random_controls(np.random.default_rng(seed), scene, 200), SCORE_POINTS
    )
    longest = 1.6 * np.linalg.norm(scene.goals[0] - scene.start)
    grid = CurveGrid(scene, 0, longest, 5)
    local = grid.frame.world_to_frame(trajectories[arc_length(trajectories) <= longest])
    assert ((local >= grid.low) & (local <= grid.high)).all()


@pytest.mark.parametrize(("seed", "dim"), [(0, 2), (1, 2), (0, 3)])
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
    assert 0.9 < found.coverage == len(found) / found.cells_reached <= 1


class TestElites:
    def test_shapes(self, archive):
        num, dim = len(archive), archive.scene.dim
        assert archive.controls.shape == (num, 4, dim)
        assert archive.trajectories.shape == (num, SCORE_POINTS, dim)
        assert archive.descriptors.shape == (num, dim)
        assert archive.energies.shape == archive.scores.shape == archive.labels.shape == (num,)
        assert archive.field is archive.observer.field(archive.scene)
        assert (archive.observer.alpha, archive.target) == (DEFAULT_ALPHA, 1)

    def test_they_run_from_start_to_goal_inside_the_workspace(self, archive):
        scene = archive.scene
        np.testing.assert_array_equal(archive.trajectories[:, 0] - scene.start, 0)
        np.testing.assert_array_equal(archive.trajectories[:, -1] - scene.goals[1], 0)
        assert scene.contains(archive.trajectories).all()

    def test_they_are_within_the_detour_and_do_not_cross_themselves(self, archive):
        lengths = arc_length(bezier_trajectories(archive.controls, 400))
        assert lengths.max() <= archive.observer.detour * archive.shortest_length * 1.002
        assert lengths.max() > 1.5 * archive.shortest_length
        assert not crosses_itself(archive.controls).any()

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
        assert (np.diff(grid_of(archive).cell_of(archive.descriptors)) > 0).all()

    def test_energies_are_bending_energies(self, archive):
        np.testing.assert_array_equal(archive.energies, bending_energy(archive.controls))

    def test_scores_are_legibility_scores(self, archive):
        np.testing.assert_allclose(
            archive.scores,
            lg.metrics.legibility_score(archive.trajectories, archive.field, 1, DEFAULT_ALPHA),
            rtol=1e-9,
        )

    def test_the_straight_line_is_one_of_them(self, archive):
        scene = archive.scene
        straight = np.linspace(scene.start, scene.goals[1], SCORE_POINTS)
        found = np.flatnonzero(archive.energies < 1e-20)
        assert len(found) == 1
        np.testing.assert_allclose(archive.trajectories[found[0]], straight, atol=1e-12)
        assert archive.scores[found[0]] == archive.anchor_score
        assert not archive.blocked
        np.testing.assert_array_equal(archive.anchor, archive.controls[found[0]])
        assert archive.shortest_length == pytest.approx(np.linalg.norm(straight[-1] - straight[0]))
        assert archive.anchor_score == pytest.approx(
            lg.metrics.legibility_score(straight, archive.field, 1), rel=1e-9
        )

    def test_it_is_never_less_smooth_than_what_a_fresh_draw_offers(self, archive):
        """Elites have been chosen: random curves of the same cells are rougher."""
        grid = grid_of(archive)
        grid.add(random_controls(np.random.default_rng(0), archive.scene, 2000, target=1))
        own = np.full(len(grid.energies), np.inf)
        own[grid.cell_of(archive.descriptors)] = archive.energies
        assert np.mean(own[grid.filled] <= grid.energies[grid.filled]) > 0.95


class TestLabels:
    def test_are_the_label_functions(self, archive):
        expected = (
            lg.labels.rank_label(archive.scores)
            if archive.observer.label == "rank"
            else lg.labels.anchored_label(archive.scores, archive.anchor_score)
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
    @pytest.mark.parametrize("seed", range(4))
    def test_anchored_labels_have_the_straight_line_alone_at_zero(self, seed, dim):
        found = build_archive(random_scene(seed, dim), seed=seed, cells=6)
        assert (found.labels == 0).sum() == 1
        assert found.energies[found.labels == 0] < 1e-20
        assert found.nearest(0) == np.argmin(found.energies)
        assert (found.labels.min(), found.labels.max()) == (-1, 1)
        assert found.label_of(found.anchor_score) == 0

    def test_nearest_takes_the_smoothest_of_equals(self):
        args = {"scene": PAPER, "target": 0, "observer": lg.Observer(label="rank")}
        size = {"anchor_score": 0.0, "num_candidates": 3, "cells_reached": 3}
        curves = {"controls": np.zeros((3, 1)), "anchor": np.zeros(1)}
        scores = {"scores": np.array([0.0, 0.0, 1.0]), "labels": np.array([-0.5, -0.5, 1.0])}
        found = Archive(**args, **size, **curves, **scores, energies=np.array([2.0, 1.0, 0.0]))
        assert found.nearest(-0.5) == 1
        assert found.nearest(-1) == 1
        assert found.nearest(0.25) == 2  # all are as far: the smoothest of all
        assert found.nearest(0.2) == 1

    @given(level=levels)
    def test_near_are_the_smoothest_first(self, archive, level):
        near = archive.near(level)
        gaps = np.abs(archive.labels - level)
        assert set(np.flatnonzero(gaps <= 0.05)) | {archive.nearest(level)} == set(near)
        assert (np.diff(archive.energies[near]) >= 0).all()
        turned = turning(bezier_trajectories(archive.controls[near], 400))
        np.testing.assert_allclose(archive.turning_near(level), turned, atol=0.2)

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
        assert np.abs(one.label_of(scores) - other.label_of(scores)).mean() < 0.03


class TestSettings:
    def test_3d_default_cells(self):
        assert len(build_archive(random_scene(3, 3))) > 1000

    def test_target_and_observer_are_used(self):
        observer = lg.Observer("gaussian", "uniform", sigma=0.3, alpha=1.0, detour=1.5)
        found = build_archive(PAPER, 1, observer=observer, cells=8)
        np.testing.assert_array_equal(found.trajectories[:, -1] - PAPER.goals[1], 0)
        field = lg.InformationPotentialField(PAPER.goals, 0.3)
        np.testing.assert_allclose(
            found.scores, lg.metrics.legibility_score(found.trajectories, field, 1, 1.0), rtol=1e-9
        )
        assert arc_length(found.trajectories).max() <= 1.5 * found.shortest_length * (1 + 1e-9)

    def test_a_detour_of_one_leaves_the_straight_line(self):
        found = build_archive(PAPER, observer=lg.Observer(detour=1))
        assert len(found) == 1
        assert (found.labels[0], found.range, found.degenerate) == (0, (0, 0), True)
        assert found.label_of([-10, 0]).tolist() == [0, 0]

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
        longest = np.linalg.norm(scene.goals[0] - scene.start)
        grid = CurveGrid(scene, 0, longest, 6)
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
            {"observer": lg.Observer(prior=[1, 2, 3])},
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
        with pytest.raises(InvalidInputError, match=rf"{next(iter(wrong))}|prior"):
            build_archive(PAPER, **{"cells": 4, **wrong})

    @pytest.mark.parametrize("scene", [None, PAPER.to_dict(), "scene.yaml"])
    def test_something_that_is_no_scene(self, scene):
        with pytest.raises(InvalidInputError, match="scene"):
            build_archive(scene)


@pytest.fixture(scope="module", params=[BLOCKED, CLUTTERED, SOLID], ids=["ball", "three", "3d"])
def blocked(request):
    return build_archive(request.param, seed=1)


class TestObstacles:
    def test_every_curve_keeps_clear_of_everything(self, blocked):
        scene = blocked.scene
        curves = bezier_trajectories(np.append(blocked.controls, blocked.anchor[None], 0), 400)
        assert scene.feasible(curves, 0).all()
        assert scene.margin_at(curves).min() >= -1e-6 * scene.diagonal
        for goal in scene.distractors(0):
            assert np.linalg.norm(curves - goal, axis=-1).min() >= scene.goal_radius - 1e-6
        lengths = arc_length(curves)
        assert lengths.max() <= blocked.observer.detour * blocked.shortest_length * 1.002
        assert not crosses_itself(blocked.controls).any()

    def test_the_shortest_curve_is_at_zero(self, blocked):
        straight = np.linalg.norm(blocked.scene.goals[0] - blocked.scene.start)
        lengths = arc_length(bezier_trajectories(blocked.controls, 400))
        assert blocked.blocked
        assert passable(blocked.scene, 0)
        assert straight < blocked.shortest_length <= lengths.min() * 1.001
        assert blocked.label_of(blocked.anchor_score) == 0
        curve = bezier_trajectories(blocked.anchor[None], SCORE_POINTS)
        assert blocked.anchor_score == pytest.approx(
            blocked.observer.score(curve, blocked.scene, 0)[0], rel=1e-12
        )
        assert (blocked.labels.min(), blocked.labels.max()) == (-1, 1)

    def test_it_is_that_of_geometry(self):
        """Tangents to the ball and an arc between them."""
        scene = BLOCKED
        (ball,), length = scene.obstacles, np.linalg.norm
        start, goal = scene.start - ball.center, scene.goals[0] - ball.center
        between = np.arccos(start @ goal / length(start) / length(goal))
        arc = between - np.arccos(0.1 / length(start)) - np.arccos(0.1 / length(goal))
        exact = np.sqrt(start @ start - 0.01) + np.sqrt(goal @ goal - 0.01) + 0.1 * arc
        found = build_archive(scene, cells=4).shortest_length
        assert exact <= found < 1.01 * exact

    def test_on_either_side_of_an_obstacle(self, blocked):
        """Ways round it on both sides are found."""
        middle = blocked.trajectories[:, SCORE_POINTS // 2] - blocked.scene.obstacles[0].center
        way = blocked.scene.goals[0] - blocked.scene.start
        side = middle[:, 1] * way[0] - middle[:, 0] * way[1]
        assert 0.05 < np.mean(side > 0) < 0.95

    def test_it_does_not_hang_on_the_seed(self, blocked):
        other = build_archive(blocked.scene, seed=2, cells=4)
        np.testing.assert_array_equal(other.anchor, blocked.anchor)

    def test_an_s_bend_is_found(self):
        walls = [lg.Box([0.35, 0.3], [0.02, 1]), lg.Box([0.65, 0.7], [0.02, 1])]
        scene = lg.Scene([0, 0.5], [[1, 0.5], [1, 0.9]], None, walls)
        found = build_archive(scene)
        assert len(found) > 50
        assert scene.feasible(bezier_trajectories(found.controls, 400), 0).all()

    def test_start_and_target_may_touch_obstacles(self):
        obstacles = [lg.Ball([-0.05, 0.5], 0.05), lg.Ball([0.8, 0.7], 0.1)]
        scene = lg.Scene(PAPER.start, PAPER.goals, None, obstacles)
        found = build_archive(scene)
        assert not found.blocked
        assert scene.feasible(bezier_trajectories(found.controls, 400), 0).all()

    def test_an_obstacle_beyond_reach_changes_nothing(self):
        room = [[-5, -5], [5, 5]]
        one = build_archive(lg.Scene(PAPER.start, PAPER.goals, room), cells=8)
        far = lg.Scene(PAPER.start, PAPER.goals, room, [lg.Ball([4, 4], 0.5)])
        np.testing.assert_array_equal(build_archive(far, cells=8).labels, one.labels)

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            ({"obstacles": [lg.Box([0.4, 0.5], [0.1, 3])]}, "was found from the start"),
            ({"obstacles": [lg.Ball([0.8, 0.65], 0.1)]}, "lies over the target"),
            ({"goal_radius": 0.5}, "within goal_radius"),
        ],
        ids=str,
    )
    def test_scenes_without_a_way_are_refused(self, change, message):
        with pytest.raises(InvalidSceneError, match=message) as caught:
            build_archive(lg.Scene(PAPER.start, PAPER.goals, **change))
        assert not passable(lg.Scene(PAPER.start, PAPER.goals, **change), 0)
        assert "\n" not in str(caught.value)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=8)
def test_free_is_what_many_points_say(seed):
    controls = random_controls(np.random.default_rng(seed), CLUTTERED, 100)
    margin = CLUTTERED.margin_at(bezier_points(controls, 1001), 0).min(-1)
    sure = np.abs(margin) > 1e-4 * CLUTTERED.diagonal
    assert sure.sum() > 50
    np.testing.assert_array_equal(free(CLUTTERED, 0, controls)[sure], (margin > 0)[sure])


def changed(scene, scale, offset, turned=False):
    """The scene of balls scaled, turned by 90° if wanted, and moved."""

    def move(points):
        points = np.array(points)
        if turned:
            points = np.stack([-points[..., 1], points[..., 0]], axis=-1)
        return scale * points + offset

    corners = move(scene.workspace)
    return lg.Scene(
        move(scene.start),
        move(scene.goals),
        [corners.min(0), corners.max(0)],
        [lg.Ball(move(ball.center), scale * ball.radius) for ball in scene.obstacles],
        scale * scene.goal_radius,
        scale * scene.clearance,
    )


class TestRooms:
    @pytest.mark.parametrize("scene", [PAPER, BLOCKED], ids=["free", "ball"])
    @pytest.mark.parametrize(
        ("scale", "offset"), [(100, 0), (1e-3, 0), (1, 4e3), (1, -1e6), (1024, 0)]
    )
    def test_any_unit_and_place(self, scene, scale, offset):
        """Metres, centimetres, kilometres away: the same curves, scores and labels."""
        one = build_archive(scene, cells=8)
        other = build_archive(changed(scene, scale, offset), cells=8)
        scores = one.score_of(np.linspace(-1, 1, 41))
        error = np.abs(other.label_of(scores) - one.label_of(scores))
        assert error.max() < (1e-6 if offset == 0 else 0.05)
        assert other.anchor_score == pytest.approx(one.anchor_score, rel=1e-6)
        assert other.shortest_length == pytest.approx(scale * one.shortest_length, rel=1e-6)
        if scale == 1024:  # free of rounding
            np.testing.assert_array_equal(other.trajectories, one.trajectories * 1024)
            np.testing.assert_allclose(other.labels, one.labels, atol=1e-12)

    @pytest.mark.parametrize("scene", [PAPER, BLOCKED], ids=["free", "ball"])
    def test_any_direction(self, scene):
        """Other curves are drawn, the dial is the same."""
        room = lg.Scene(scene.start, scene.goals, [[-2, -2], [3, 3]], scene.obstacles)
        one, other = build_archive(room), build_archive(changed(room, 1, 0, turned=True))
        scores = one.score_of(np.linspace(-1, 1, 41))
        assert np.abs(one.label_of(scores) - other.label_of(scores)).mean() < 0.02

    @pytest.mark.parametrize("dim", [2, 3])
    def test_a_room_larger_than_the_reach_of_curves_changes_no_label(self, dim):
        scene = random_scene(1, dim)
        middle, far = scene.start, 3 * np.linalg.norm(scene.goals[0] - scene.start)
        far = max(far, 2 * scene.diagonal)
        small, large = (
            build_archive(lg.Scene(scene.start, scene.goals, [middle - r, middle + r]), cells=6)
            for r in (far, 100 * far)
        )
        np.testing.assert_array_equal(small.labels, large.labels)
        np.testing.assert_array_equal(small.trajectories, large.trajectories)

    def test_a_tighter_room_changes_labels(self):
        tight = lg.Scene(PAPER.start, PAPER.goals, [[-0.1, 0.2], [1.1, 0.7]])
        assert build_archive(tight, cells=8).range[0] < build_archive(PAPER, cells=8).range[0]

    @pytest.mark.parametrize("start", [[-0.1, 0.5], [-0.1, -0.1], [1.1, 1.1]])
    def test_start_on_a_wall(self, start):
        found = build_archive(lg.Scene(start, PAPER.goals), cells=8)
        assert not found.blocked
        assert len(found) > 20
        assert found.scene.feasible(bezier_trajectories(found.controls, 400), 0).all()


class TestObservers:
    @pytest.mark.parametrize("scene", [PAPER, BLOCKED], ids=["free", "ball"])
    def test_seen_by_is_building_with_that_observer(self, scene):
        one = build_archive(scene, cells=8)
        for observer in (
            lg.Observer.paper(2),
            lg.Observer(label="rank", alpha=1),
            lg.Observer("gaussian", viewpoint=[0.5, -3]),
        ):
            seen = one.seen_by(observer)
            built = build_archive(scene, cells=8, observer=observer)
            assert seen.observer == built.observer == observer
            for name in ("trajectories", "scores", "labels", "anchor", "anchor_score"):
                np.testing.assert_array_equal(getattr(seen, name), getattr(built, name))
        assert one.seen_by(one.observer).anchor_score == one.anchor_score

    def test_another_detour_has_other_curves(self):
        with pytest.raises(InvalidInputError, match=r"curves of detour 2.5, the observer's is 2"):
            build_archive(PAPER, cells=4).seen_by(lg.Observer(detour=2))
        with pytest.raises(InvalidInputError, match="observer must be a"):
            build_archive(PAPER, cells=4).seen_by("paper")

    def test_of_a_scene_is_kept_and_shares_its_curves(self):
        one, other = (
            scene_archive(PAPER, 0, lg.Observer()),
            scene_archive(lg.Scene(PAPER.start, PAPER.goals), 0, lg.Observer.paper(2)),
        )
        assert one is scene_archive(PAPER, 0, lg.Observer())
        assert one.controls is other.controls
        np.testing.assert_array_equal(one.labels, build_archive(PAPER).labels)

    def test_range_says_how_much_a_side_spans(self):
        found = build_archive(PAPER, cells=8)
        low, high = found.range
        assert low == found.anchor_score - found.scores.min()
        assert high == found.scores.max() - found.anchor_score
        assert not found.degenerate
        # To the paper's observer this target is clear from the start.
        clear = build_archive(
            lg.Scene([0, 0], [[0.2, 0], [-0.9, 0.9]], [[-1, -1], [1, 1]]), cells=8,
            observer=lg.Observer.paper(2),
        )  # fmt: skip
        assert min(clear.range) < SMALLEST_RANGE
        assert clear.degenerate


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

    Some thousands of them take as long as a fixed piece of NumPy, on any machine and one core.
    """
    threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    path = {"PYTHONPATH": str(next(iter(lg.__path__)).removesuffix("/legibility"))}
    run = subprocess.run(
        [sys.executable, "-c", THROUGHPUT], env={**threads, **path}, capture_output=True, text=True
    )
    assert run.returncode == 0, run.stderr
    rate, yardstick = map(float, run.stdout.split())
    assert rate * yardstick > 1000, f"{rate:,.0f} candidates/s, yardstick {yardstick * 1e3:.0f} ms"
