"""The dial at a glance: the score that each ℓ asks for, by a few hundred curves and a network."""

import dataclasses

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from legibility import Ball, Box, Observer, Scene, build_archive
from legibility.errors import InvalidInputError
from legibility.models.conditions import Conditions
from legibility.models.configuration import PathDiffuserConfig
from legibility.models.dial import KNOTS, Dial, standard_curves
from legibility.motion.bezier import bezier_trajectories

SCENE = Scene([0, 0.5], [[0.8, 0.6], [1, 0.3]], [[-3, -3], [4, 4]])
BARRED = Scene(SCENE.start, SCENE.goals, SCENE.workspace, [Ball([0.4, 0.55], 0.08)])
LEVELS = np.linspace(-1, 1, KNOTS)
OBSERVER = Observer()


def dial(dim=2, number=512, observer=OBSERVER):
    torch.manual_seed(0)
    config = PathDiffuserConfig(dim=dim, condition=16, curves=number, observer=observer)
    found = Dial(config).eval()
    found.set_curves(observer)
    return found


def conditions(scenes, observer=OBSERVER):
    return Conditions.of(scenes, [0] * len(scenes), [observer] * len(scenes), 16)


def coarse(found, scene, observer=OBSERVER):
    """The scores at the knots by the curves alone, `(KNOTS,)`."""
    readings = found.readings(conditions([scene], observer))[0].double()
    vector = len(readings) - KNOTS - 2 * len(found.points) - 1
    return -np.exp((readings[:KNOTS] + readings[-vector - 1]).numpy())


class TestStandardCurves:
    @pytest.mark.parametrize("dim", [2, 3])
    def test_lead_from_start_to_goal_within_the_detour_and_lie_apart(self, dim):
        controls = standard_curves(dim, Observer(detour=1.8), 64)
        assert controls.shape == (64, 4, dim)
        np.testing.assert_array_equal(controls[:, 0], 0)
        np.testing.assert_array_equal(controls[:, -1], np.eye(dim)[[0] * 64])
        curves = bezier_trajectories(controls, 200)
        lengths = np.linalg.norm(np.diff(curves, axis=1), axis=-1).sum(-1)
        assert (lengths <= 1.8 * 1.01).all()  # the archive measures them at fewer points
        assert len(np.unique(controls.round(6), axis=0)) == 64


class TestRanks:
    @pytest.mark.parametrize("observer", [Observer(), Observer.paper(2)], ids=["dragan", "paper"])
    def test_near_to_the_archives(self, observer):
        """In an empty room; an archive of another seed is 0.01 apart."""
        archive = build_archive(SCENE, observer=observer)
        error = np.abs(archive.label_of(coarse(dial(), SCENE, observer)) - LEVELS)
        assert error.mean() < 0.06

    def test_rank_labels(self):
        observer = Observer(label="rank")
        archive = build_archive(SCENE, observer=observer)
        found = coarse(dial(observer=observer), SCENE, observer)
        assert np.abs(archive.label_of(found) - LEVELS).mean() < 0.06

    @pytest.mark.parametrize("scene", [SCENE, BARRED], ids=["free", "blocked"])
    def test_rise_with_the_level(self, scene):
        assert (np.diff(coarse(dial(), scene)) >= 0).all()

    def test_the_straight_line_is_at_0(self):
        line = np.linspace(SCENE.start, SCENE.goals[0], 200)
        expected = float(Observer().score(line, SCENE, 0))
        assert coarse(dial(), SCENE)[KNOTS // 2] == pytest.approx(expected, rel=1e-3)

    def test_curves_in_contact_do_not_count(self):
        """A wall beside the straight line bars the ambiguous way, and leaves the legible one."""
        goals, room = [[1, 0], [0.9, -0.9]], [[-3, -3], [3, 3]]
        wall = Box([0.5, -0.35], [4, 0.5])
        scenes = [Scene([0, 0], goals, room, barrier) for barrier in ((), (wall,))]
        open_, walled = (coarse(dial(), scene) for scene in scenes)
        middle = KNOTS // 2
        assert (walled[:middle] > open_[:middle]).all()
        np.testing.assert_allclose(walled[middle:], open_[middle:], rtol=0.1)
        for found, scene in zip((open_, walled), scenes, strict=True):
            archive = build_archive(scene, cells=14, max_candidates=8192)
            assert found[0] == pytest.approx(archive.scores.min(), rel=0.15)

    def test_a_scene_without_a_clear_curve_has_a_finite_dial(self):
        tight = Scene([0, 0], [[1, 0], [1, 0.5]], [[-0.01, -0.01], [1.01, 0.51]])
        shut = dataclasses.replace(tight, obstacles=(Ball([0.5, 0.2], 0.25),))
        found = dial()
        assert torch.isfinite(found(found.readings(conditions([shut])))).all()


@given(level=st.floats(-1, 1), seed=st.integers(0, 9))
@settings(deadline=None)
def test_at_is_linear_between_knots(level, seed):
    knots = torch.randn(3, KNOTS, generator=torch.Generator().manual_seed(seed))
    found = Dial.at(knots, torch.full((3,), level))
    expected = [np.interp(level, LEVELS, row) for row in knots.numpy()]
    np.testing.assert_allclose(found, expected, atol=1e-5)


def test_of_several_scenes_is_that_of_each():
    found = dial(number=32)
    together = found.readings(conditions([SCENE, BARRED]))
    for row, scene in zip(together, (SCENE, BARRED), strict=True):
        torch.testing.assert_close(row, found.readings(conditions([scene]))[0])


@pytest.mark.parametrize("dim", [2, 3])
def test_a_small_detour_has_curves_enough_or_is_refused(dim):
    controls = standard_curves(dim, Observer(detour=1.02), 80)
    assert len(np.unique(controls.round(9), axis=0)) == 80
    with pytest.raises(
        InvalidInputError, match=r"curves must be at most \d+ for detour 1, got 500"
    ):
        standard_curves(dim, Observer(detour=1.0), 500)
