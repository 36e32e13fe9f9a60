import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import legibility as lg
from legibility.curves import NUM_WAYPOINTS, path_curve
from legibility.data.configuration import DatasetConfig, with_target_first
from legibility.data.dataset import Dataset, generate
from legibility.data.recorded import RecordedPaths, read_scenes
from legibility.errors import InvalidInputError, InvalidSceneError
from legibility.intent.metrics import SCORE_POINTS

SCENES = {
    "lab": lg.Scene([0, 0.5], [[0.8, 0.6], [1, 0.3]]),
    "hall": lg.Scene([0, 0.1], [[0.9, 0.2], [0.3, 0.9]], obstacles=[lg.Ball([0.1, 0.5], 0.1)]),
}
SMALL = {"regime": "dragan", "views": 2, "cells": 6, "candidates": 4096}


def bent(place, goal, bends, name="1", **options):
    """A motion with as many waves as there are bends, which is no Bézier."""
    share = np.linspace(0, 1, 60)
    along = place.goals[goal] - place.start
    across = np.array([-along[1], along[0]])
    waves = sum(bend * np.sin((i + 1) * np.pi * share) for i, bend in enumerate(bends))
    points = place.start + share[:, None] * along + np.asarray(waves)[:, None] * across
    return lg.Recording(points, name=name, **options)


def recordings(rng, number=6):
    return [
        bent(SCENES[name], target, rng.normal(0, [0.1, 0.04, 0.02]), f"{name} {target} {i}",
             target=target, scene=name)
        for name in SCENES for target in (1, 0) for i in range(number)
    ]  # fmt: skip


@pytest.fixture(scope="module")
def found():
    return RecordedPaths(recordings(np.random.default_rng(0)), SCENES)


def test_by_scene_and_target(found):
    assert found.scenes == [
        with_target_first(SCENES[name], target) for name in SCENES for target in (1, 0)
    ]
    assert sum(map(len, found.paths)) + len(found.touching) == 24
    for scene, paths in zip(found.scenes, found.paths, strict=True):
        assert paths.shape[1:] == (NUM_WAYPOINTS + 2, 2)
        np.testing.assert_array_equal(paths[:, 0], np.tile(scene.start, (len(paths), 1)))
        np.testing.assert_array_equal(paths[:, -1], np.tile(scene.goals[0], (len(paths), 1)))
        assert scene.feasible(path_curve(paths, SCORE_POINTS), 0).all()


@given(
    first=st.tuples(st.floats(-0.05, 0.05), st.floats(-0.05, 0.05)),
    last=st.tuples(st.floats(-0.05, 0.05), st.floats(-0.05, 0.05)),
)
@settings(max_examples=20)
def test_ends_are_moved_onto_those_of_the_scene(first, last):
    """A motion that begins and ends a little off keeps its shape."""
    scene, share = SCENES["lab"], np.linspace(0, 1, 60)[:, None]
    exact = bent(scene, 0, (0.2, 0.1))
    moved = exact.positions + (1 - share) * first + share * last
    (wanted,), (got,) = (
        RecordedPaths([recording], {"": scene}).paths for recording in (exact, lg.Recording(moved))
    )
    np.testing.assert_allclose(got, wanted, atol=0.02)
    gap = max(np.linalg.norm(first), np.linalg.norm(last))
    found = RecordedPaths([lg.Recording(moved, name="a")], {"": scene})
    if abs(gap - 0.01 * scene.diagonal) > 0.002:
        assert found.off == (["a"] if gap > 0.01 * scene.diagonal else [])


def test_the_nearest_goal_is_meant():
    scene = SCENES["lab"]
    for target in (0, 1):
        found = RecordedPaths([bent(scene, target, (0.1,))], {"": scene})
        assert found.scenes == [with_target_first(scene, target)]


def test_what_touches_is_left_out():
    scene = SCENES["lab"]
    blocked = lg.Scene(scene.start, scene.goals, obstacles=[lg.Ball([0.4, 0.55], 0.05)])
    ways = [bent(blocked, 0, (bend,), str(bend)) for bend in (0.0, 0.3)]
    found = RecordedPaths(ways, {"": blocked})
    assert found.touching == ["0.0"]
    assert [len(paths) for paths in found.paths] == [1]
    with pytest.raises(InvalidInputError, match="no recording that keeps clear"):
        RecordedPaths(ways[:1], {"": blocked})


def test_dataset(found, tmp_path):
    """Every motion is there, with its label on the dial of its scene; whole again when loaded."""
    config = DatasetConfig(**SMALL, **found.config(), per_scene=9)
    data = generate(config, tmp_path / "d", recorded=found.paths)
    assert data.controls is None
    assert data.waypoints.shape == (8, 9, NUM_WAYPOINTS, 2)
    for row, (scene, observer) in enumerate(zip(data.scenes, data.observers, strict=True)):
        paths = found.paths[row // 2]
        assert scene == found.scenes[row // 2]
        kept = {tuple(w.ravel()) for w in data.waypoints[row]}
        assert kept == {tuple(p[1:-1].astype(np.float32).ravel()) for p in paths}
        archive = config.archive(row // 2, config.observer, cells=6, max_candidates=4096)
        archive = archive.seen_by(observer)
        scores = observer.score(path_curve(paths, SCORE_POINTS), scene, 0)
        wanted = np.sort(archive.label_of(scores))
        np.testing.assert_allclose(np.unique(data.labels[row]), np.unique(np.float32(wanted)))
    again = Dataset.load(tmp_path / "d")
    assert again.config == config
    assert again.digest == data.digest
    validation = config.for_validation()
    assert validation.given == config.given
    assert not validation.recordings
    assert data.first(2).scenes == data.scenes[:4]


def test_mixed_with_the_archive(found, tmp_path):
    config = DatasetConfig(**SMALL, **found.config(), per_scene=12, mix=0.5)
    data = generate(config, tmp_path / "d", recorded=found.paths)
    for row, paths in enumerate(np.repeat(np.array(found.paths, dtype=object), 2)):
        known = {tuple(p[1:-1].astype(np.float32).ravel()) for p in paths}
        ours = [tuple(w.ravel()) in known for w in data.waypoints[row]]
        assert 6 <= sum(ours) < 12
        reach = [np.abs(np.linspace(-1, 1, 21)[:, None] - labels).min(-1).max()
                 for labels in (data.labels[row], data.labels[row][ours])]  # fmt: skip
        assert reach[0] < 0.6 * reach[1]


def test_too_many_are_thinned_along_the_dial(found, tmp_path):
    config = DatasetConfig(**SMALL, **found.config(), per_scene=3)
    data = generate(config, tmp_path / "d", recorded=found.paths)
    wide = DatasetConfig(**SMALL, **found.config(), per_scene=9)
    every = generate(wide, tmp_path / "e", recorded=found.paths)
    np.testing.assert_array_equal(data.labels.min(-1), every.labels.min(-1))
    np.testing.assert_array_equal(data.labels.max(-1), every.labels.max(-1))


FILES = {
    "{start: [0, 0.5], goals: [[1, 1], [1, 0]]}": [""],
    "scenes: [{start: [0, 0.5], goals: [[1, 1], [1, 0]]}]": ["0"],
    "scenes: {a: {start: [0, 1], goals: [[1, 1], [1, 0]]}}": ["a"],
}


@pytest.mark.parametrize(("content", "names"), FILES.items(), ids=["one", "list", "names"])
def test_files_of_scenes(content, names, tmp_path):
    (tmp_path / "s.yaml").write_text(content)
    assert list(read_scenes(tmp_path / "s.yaml")) == names


BAD_FILES = {
    "scenes: 3": "scenes must be a list, or a mapping",
    "scenes: []": "scenes must be a list, or a mapping",
    "{scenes: [], start: [0, 0]}": "and the only key",
    "scenes: {a: {start: [0, 0]}}": "scene a: a scene has the keys .* missing",
    "scenes: [{start: [0, 0.5], goals: [[1, 1], [1, 0]]}, "
    "{start: [-0.2, -0.2, 0.3], goals: [[0, 0.1, 0.02], [0, -0.1, 0.02]]}]": "must be 2D",
    "goals: 1": "a scene has the keys",
}


@pytest.mark.parametrize(("content", "message"), BAD_FILES.items(), ids=range(len(BAD_FILES)))
def test_bad_files_of_scenes(content, message, tmp_path):
    (tmp_path / "s.yaml").write_text(content)
    with pytest.raises(InvalidSceneError, match=message):
        read_scenes(tmp_path / "s.yaml")


LAB = SCENES["lab"]
BAD = {
    "no scene": (bent(LAB, 0, (0.1,)), "'1' must name one of the scenes lab, hall, got none"),
    "another scene": (bent(LAB, 0, (0.1,), scene="x"), "one of the scenes lab, hall, got 'x'"),
    "another goal": (bent(LAB, 0, (0.1,), scene="lab", target=2), "target must be"),
    "the wrong goal": (bent(LAB, 0, (0.1,), scene="lab", target=1), r"the target goals\[1\]"),
    "another start": (
        lg.Recording([[0.5, 0.5], [0.8, 0.6]], scene="lab"),
        "off the start, at most",
    ),
    "3-D": (lg.Recording(np.eye(3), scene="lab"), "'1' is 3D, its scene is 2D"),
}


@pytest.mark.parametrize(("recording", "message"), BAD.values(), ids=BAD)
def test_bad_recordings(recording, message):
    with pytest.raises(InvalidInputError, match=message):
        RecordedPaths([recording], SCENES)


def test_settings_that_do_not_belong_together(found, tmp_path):
    with pytest.raises(InvalidInputError, match="recordings need the scenes"):
        DatasetConfig(recordings="abc")
    with pytest.raises(InvalidInputError, match="mix belongs to recordings"):
        DatasetConfig(mix=0.5)
    config = DatasetConfig(**SMALL, **found.config())
    for recorded in (None, found.paths[:-1]):
        with pytest.raises(InvalidInputError, match="recorded paths must be given"):
            generate(config, tmp_path / "d", recorded=recorded)
    assert not (tmp_path / "d").exists()


TEXTS = {"scene lab": "lab", "hall": "hall", "reach goal 0 in scene lab": "lab"}


@pytest.mark.parametrize(("text", "name"), TEXTS.items())
def test_texts_that_name_a_scene(text, name):
    found = RecordedPaths([bent(SCENES[name], 0, (0.3,), scene=text, target=0)], SCENES)
    assert found.scenes == [SCENES[name]]
