"""Ready-made curves, and the archive of a scene by them."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from legibility import Ball, Box, Observer, Scene
from legibility.curves import arc_length
from legibility.data.rooms import random_observer, random_room
from legibility.errors import InvalidSceneError
from legibility.motion import library
from legibility.motion import rough_archive as rough_archives
from legibility.motion.archive import passable, scene_archive
from legibility.motion.bezier import bezier_trajectories, crosses_itself
from legibility.motion.curve_grid import free
from legibility.motion.library import curve_library, make_library
from legibility.motion.rough_archive import rough_archive
from legibility.parts import cached_parts, finished

OBSERVER = Observer()
SCENE = Scene([0, 0.5], [[0.8, 0.6], [1, 0.3]], [[-3, -3], [4, 4]])
BARRED = dataclasses.replace(SCENE, obstacles=(Ball([0.4, 0.53], 0.08),))
LEVELS = np.linspace(-1, 1, 21)


def error(scene, observer=OBSERVER):
    """Mean error of ℓ by the library, as the scene's archive reads it."""
    archive = scene_archive(scene, 0, observer)
    found = archive.label_of(rough_archive(scene, 0, observer).score_of(LEVELS))
    return np.abs(found - LEVELS).mean()


class TestLibrary:
    @pytest.mark.parametrize("dim", [2, 3])
    @pytest.mark.parametrize("detour", [2.5, 1.3])
    def test_curves(self, dim, detour, monkeypatch):
        monkeypatch.setattr(library, "_BATCHES", 20)
        found = curve_library(dim, detour) if detour == 2.5 else make_library(dim, detour)
        assert found.controls.shape == (len(found), 4, dim)
        np.testing.assert_array_equal(found.controls[:, 0], 0)
        np.testing.assert_array_equal(found.controls[:, -1], np.eye(dim)[[0] * len(found)])
        lengths = arc_length(bezier_trajectories(found.controls, 200))
        assert (lengths <= detour * 1.03).all()  # measured at fewer points
        assert not crosses_itself(found.controls).any()
        assert (np.diff(lengths[found.by_length]) > -0.1).all()
        assert (np.diff(found.cells) >= 0).all()
        assert np.bincount(found.cells).max() <= 4
        assert len(np.unique(found.controls.round(6), axis=0)) == len(found)

    @pytest.mark.parametrize("dim", [2, 3])
    def test_the_files_are_what_the_command_makes(self, dim, tmp_path):
        """But for ties that another processor's rounding may decide otherwise."""
        shipped, made = curve_library(dim, OBSERVER.detour), make_library(dim, OBSERVER.detour)
        assert abs(len(made) - len(shipped)) <= 0.01 * len(shipped)
        ours, theirs = ({row.tobytes() for row in x.controls.round(3)} for x in (made, shipped))
        assert len(ours & theirs) > 0.97 * len(theirs)
        file = tmp_path / "curves.safetensors"
        made.save(file)
        assert file.stat().st_size > 1e5


class TestRoughArchive:
    @pytest.mark.parametrize(
        "observer", [OBSERVER, Observer.paper(2), Observer(label="rank")], ids=str
    )
    @pytest.mark.parametrize("scene", [SCENE, BARRED], ids=["free", "blocked"])
    def test_is_near_to_the_archive(self, observer, scene):
        """Measured: 0.01 to 0.025. A second archive is 0.01 apart."""
        assert error(scene, observer) < 0.05

    @given(seed=st.integers(0, 999), dim=st.sampled_from([2, 3]))
    @settings(deadline=None, max_examples=15)
    def test_laws(self, seed, dim):
        rng = np.random.default_rng(seed)
        scene = random_room(rng, dim=dim, goals=(2, 4), obstacles=(0, 3))
        if not passable(scene, 0):
            with pytest.raises(InvalidSceneError):
                rough_archive(scene, 0, OBSERVER)
            return
        observer = random_observer(rng, scene, OBSERVER)
        found, archive = rough_archive(scene, 0, observer), scene_archive(scene, 0, observer)
        assert free(scene, 0, found.controls).all()
        assert not crosses_itself(found.controls).any()
        lengths = arc_length(bezier_trajectories(found.controls, 200))
        assert (lengths <= observer.detour * archive.shortest_length * 1.03).all()
        np.testing.assert_array_equal(found.anchor, archive.anchor)
        assert found.anchor_score == pytest.approx(archive.anchor_score, rel=1e-12)
        assert found.score_of(0) == pytest.approx(archive.anchor_score)
        assert (np.diff(found.score_of(LEVELS)) >= 0).all()
        assert np.isfinite(found.trajectories).all()

    def test_moves_and_scales_with_the_scene(self):
        turn = np.array([[0, -2], [2, 0]])
        other = Scene(
            turn @ BARRED.start + 7,
            BARRED.goals @ turn.T + 7,
            [[-50, -50], [50, 50]],
            [Ball(turn @ [0.4, 0.53] + 7, 0.16)],
        )
        ours, theirs = (rough_archive(s, 0, OBSERVER).score_of(LEVELS) for s in (BARRED, other))
        np.testing.assert_allclose(ours, theirs, rtol=0.02)

    def test_curves_in_contact_do_not_count(self):
        """A wall beside the straight line bars the ambiguous way, and leaves the legible one."""
        goals, room = [[1, 0], [0.9, -0.9]], [[-3, -3], [3, 3]]
        wall = Box([0.5, -0.35], [4, 0.5])
        open_, walled = (Scene([0, 0], goals, room, barrier) for barrier in ((), (wall,)))
        archives = [rough_archive(scene, 0, OBSERVER) for scene in (open_, walled)]
        assert archives[0].score_of(-1) < archives[1].score_of(-1)
        np.testing.assert_allclose(*(a.score_of([0.5, 1.0]) for a in archives), rtol=0.1)

    def test_a_search_goes_on_where_few_curves_are_clear(self, monkeypatch):
        things = [Box([0.5, 0.75], [0.1, 0.7]), Ball([0.3, 0.3], 0.12), Ball([0.75, 0.3], 0.1)]
        tight = Scene([0, 0.5], [[0.8, 0.6], [1, 0.3]], obstacles=things)
        assert error(tight) < 0.2  # 0.29 without
        found = finished(rough_archive.__wrapped__(tight, 0, OBSERVER))
        monkeypatch.setattr(rough_archives, "_FEW", 0.0)
        unsearched = cached_parts(maxsize=1)(rough_archives._geometry.__wrapped__)
        monkeypatch.setattr(rough_archives, "_geometry", unsearched)
        ready_made = finished(rough_archive.__wrapped__(tight, 0, OBSERVER))
        assert len(found) > 1.5 * len(ready_made)

    def test_a_search_goes_on_from_the_shortest_curve_alone(self):
        """In a gap that no ready-made curve passes."""
        walls = [Box([0.5, y], [0.5, 0.96]) for y in (0.53, -0.51)]
        gap = Scene([0, 0.3], [[1, -0.3], [1, 0.6]], [[-0.05, -0.7], [1.05, 0.7]], walls)
        found = rough_archive(gap, 0, OBSERVER)
        assert found.blocked
        assert len(found) > 10
        assert np.isfinite(found.score_of(LEVELS)).all()


def test_a_search_for_the_shortest_curve_that_the_library_does_not_help(monkeypatch):
    from legibility.motion import archive

    empty = dataclasses.replace(
        curve_library(2, OBSERVER.detour),
        controls=np.tile([[[0, 0], [9, 9], [9, 9], [1, 0]]], (256, 1, 1)),
    )
    helped = finished(archive.shortest_curve.__wrapped__(BARRED, 0))
    monkeypatch.setattr(
        archive, "curve_library", lambda *_: dataclasses.replace(empty, cells=np.arange(256))
    )
    alone = finished(archive.shortest_curve.__wrapped__(BARRED, 0))
    assert alone[1] == pytest.approx(helped[1], rel=0.01)
