"""A scene is valid, immutable, and the same after a round trip."""

import copy
import json
import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from legibility import Scene
from legibility.errors import InvalidInputError, InvalidSceneError, OutputError
from legibility.scene import DEFAULT_WORKSPACE

START, GOALS = [0.0, 0.5], [[0.8, 0.6], [1.0, 0.3]]
seeds = st.integers(0, 2**32 - 1)
dims = st.sampled_from([2, 3])


@pytest.fixture
def scene():
    return Scene(START, GOALS)


def test_what_a_scene_says(scene):
    assert (scene.dim, scene.num_goals) == (2, 2)
    assert scene.diagonal == pytest.approx(1.2 * 2**0.5)
    assert scene.workspace.tolist() == [list(corner) for corner in DEFAULT_WORKSPACE[2]]
    assert scene.target(1).tolist() == GOALS[1]
    assert scene.distractors(1).tolist() == [GOALS[0]]
    assert scene.contains([[0, 0], [-0.1, 1.1], [-0.2, 0]]).tolist() == [True, True, False]


@pytest.mark.parametrize("target", [-1, 2, 0.0, "0", None])
def test_targets_that_are_not_there(scene, target):
    for method in (scene.target, scene.distractors):
        with pytest.raises(InvalidInputError, match="target must be"):
            method(target)


BAD = {
    "start NaN": ({"start": [np.nan, 0]}, "start must be finite, got nan"),
    "goal inf": ({"goals": [[0.8, np.inf], [1, 0.3]]}, "goals must be finite, got inf"),
    "workspace inf": ({"workspace": [[-np.inf, 0], [1, 1]]}, "workspace must be finite, got -inf"),
    "one goal": ({"goals": [[0.8, 0.6]]}, "goals must be at least 2, got 1"),
    "no goals": ({"goals": []}, "goals must have 2 axes"),
    "flat goals": ({"goals": [0.8, 0.6]}, "goals must have 2 axes"),
    "equal goals": ({"goals": [[0.8, 0.6]] * 2}, r"goals\[0\] and goals\[1\] coincide at \[0.8"),
    "nearly equal goals": ({"goals": [[0.8, 0.6], [0.8, 0.6 + 1e-9]]}, "coincide"),
    "start on a goal": ({"start": GOALS[1]}, r"start and goals\[1\] coincide at \[1.0, 0.3\]"),
    "start outside": ({"start": [-1, 0.5]}, r"start \[-1.0, 0.5\] lies outside the workspace"),
    "goal outside": ({"goals": [[0.8, 0.6], [0, 9]]}, r"goals\[1\] \[0.0, 9.0\] lies outside"),
    "4 axes": ({"start": [0, 0, 0, 0]}, "start must have 2 or 3 numbers a point"),
    "1 axis": ({"start": [0]}, "start must have 2 or 3 numbers a point"),
    "start in 3D": ({"start": [0, 0.5, 0]}, "goals must have 3 numbers a point"),
    "goals in 3D": ({"goals": [[0.8, 0.6, 0], [1, 0.3, 0]]}, "goals must have 2 numbers"),
    "ragged goals": ({"goals": [[0.8, 0.6], [1]]}, "goals must be an array of numbers"),
    "number as start": ({"start": 3}, "start must have 1 axes"),
    "a truth value among numbers": ({"start": [True, 0.5]}, "start must be an array of numbers"),
    "text as start": ({"start": "here"}, "start must be an array of numbers, got 'here'"),
    "digits as text": ({"start": ["0", "0.5"]}, "start must be an array of numbers"),
    "booleans": ({"start": [True, False]}, "start must be an array of numbers"),
    "nothing as goals": ({"goals": None}, "goals must"),
    "mapping as goals": ({"goals": {"R": [0, 1]}}, "goals must be an array of numbers"),
    "swapped corners": ({"workspace": [[1, 1], [0, 0]]}, "a low and a high corner, got"),
    "flat workspace": ({"workspace": [[0, 0], [1, 0]]}, "a low and a high corner, got"),
    "three corners": ({"workspace": [[0, 0], [1, 1], [2, 2]]}, "a low and a high corner, got"),
    "workspace in 3D": ({"workspace": [[0, 0, 0], [1, 1, 1]]}, "workspace must have 2 numbers"),
}


@pytest.mark.parametrize(("change", "message"), BAD.values(), ids=BAD)
def test_bad_scenes_are_named(change, message):
    content = {"start": START, "goals": GOALS} | change
    with pytest.raises(InvalidSceneError, match=message):
        Scene(**content)
    with pytest.raises(InvalidSceneError, match=r"goals|start|workspace"):
        Scene.from_dict(content)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "got nothing"),
        ([START, GOALS], "got list"),
        ("scene", "got str"),
        ({}, r"missing \['goals', 'start'\]"),
        ({"start": START}, r"missing \['goals'\]"),
        ({"start": START, "goals": GOALS, "goal": 1}, r"unknown \['goal'\]"),
        ({"start": START, "goals": GOALS, 7: 1}, r"unknown \['7'\]"),
    ],
)
def test_contents_that_are_not_a_scene(content, message):
    with pytest.raises(InvalidSceneError, match=message):
        Scene.from_dict(content)


@pytest.mark.parametrize("suffix", ["yaml", "yml", "json", "YAML", "JSON"])
@given(seeds, dims)
def test_round_trip_is_exact(tmp_path_factory, suffix, seed, dim):
    scene = Scene.random(np.random.default_rng(seed), dim=dim)
    path = tmp_path_factory.mktemp("scene") / f"scene.{suffix}"
    scene.save(path)
    loaded = Scene.load(path)
    assert loaded == scene
    assert hash(loaded) == hash(scene)
    assert loaded.workspace.tolist() == scene.workspace.tolist()


@pytest.mark.parametrize(
    "scene",
    [
        Scene([1e-8, 1 / 3], [[0.1 + 0.2, -1e-300], [1, 123.45678901234567]], [[-1, -5], [2, 1e3]]),
        Scene(
            [1e-7, 5e-324], [[1e21, 0.1], [-12345678901234567890, 1e16]], [[-1e22] * 2, [1e22] * 2]
        ),
    ],
)
def test_round_trip_of_awkward_numbers(tmp_path, scene):
    for name in ("scene.yaml", "scene.json"):
        scene.save(tmp_path / name)
        assert Scene.load(tmp_path / name) == scene


def test_workspace_may_be_left_out_of_a_file(tmp_path, scene):
    (tmp_path / "scene.yaml").write_text("start: [0, .5]\ngoals:\n- [.8, .6]\n- [1, .3]\n")
    assert Scene.load(tmp_path / "scene.yaml") == scene


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("empty.yaml", ""),
        ("empty.json", ""),
        ("malformed.yaml", "start: [0, .5\ngoals: ]"),
        ("tagged.yaml", 'start: !!timestamp "x"\ngoals: [[0, 0], [1, 1]]'),
        ("nothing.yaml", 'start: !!float ""\ngoals: [[0, 0], [1, 1]]'),
        ("malformed.json", '{"start": [0, 0.5], "goals": '),
        ("date.yaml", "start: 2024-99-99"),
        ("object.yaml", "!!python/object/apply:os.getcwd []"),
        ("list.yaml", "- [0, .5]\n- [1, .3]"),
        ("list.json", "[[0, 0.5], [1, 0.3]]"),
        ("text.yaml", "hello"),
        ("unknown.yaml", "start: [0, .5]\ngoals: [[.8, .6], [1, .3]]\ncolour: red"),
        ("missing.json", '{"start": [0, 0.5]}'),
        ("nan.json", '{"start": [NaN, 0.5], "goals": [[0.8, 0.6], [1, 0.3]]}'),
        ("nan.yaml", "start: [.nan, .5]\ngoals: [[.8, .6], [1, .3]]"),
        ("deep.json", "[" * 100_000),
        ("deep.yaml", "[" * 10_000),
        ("boolean.json", '{"start": [true, 0.5], "goals": [[0.8, 0.6], [1, 0.3]]}'),
        ("boolean.yaml", "start: [yes, 0.5]\ngoals: [[.8, .6], [1, .3]]"),
        ("huge.json", '{"start": [1e999, 0.5], "goals": [[0.8, 0.6], [1, 0.3]]}'),
    ],
)
def test_bad_files_are_named(tmp_path, name, text):
    (tmp_path / name).write_text(text)
    with pytest.raises(InvalidSceneError, match=name):
        Scene.load(tmp_path / name)


@pytest.mark.parametrize("name", ["scene.yaml", "scene.json"])
def test_home_folder(tmp_path, monkeypatch, scene, name):
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("USERPROFILE", str(tmp_path))
    scene.save(f"~/{name}")
    assert (tmp_path / name).exists()
    assert Scene.load(f"~/{name}") == scene


def test_files_that_cannot_be_read(tmp_path):
    with pytest.raises(InvalidSceneError, match=r"cannot read the scene file .*absent\.yaml"):
        Scene.load(tmp_path / "absent.yaml")
    (tmp_path / "folder.yaml").mkdir()
    with pytest.raises(InvalidSceneError, match="cannot read"):
        Scene.load(tmp_path / "folder.yaml")
    (tmp_path / "binary.yaml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InvalidSceneError, match="not a text file"):
        Scene.load(tmp_path / "binary.yaml")


@pytest.mark.parametrize("name", ["scene", "scene.txt", "scene.pkl"])
def test_suffixes_that_are_not_known(tmp_path, scene, name):
    for act in (scene.save, Scene.load):
        with pytest.raises(InvalidSceneError, match=r"ends in \.yaml, \.yml or \.json, got"):
            act(tmp_path / name)


def test_file_that_cannot_be_written(tmp_path, scene):
    (tmp_path / "file").write_text("in the way")
    for name in ("scene.yaml", "scene.json"):
        with pytest.raises(OutputError, match="cannot write"):
            scene.save(tmp_path / "file" / name)


@pytest.mark.parametrize(
    ("start", "goals", "kept"),
    [
        (np.float32([1.1, 0.5]), GOALS, [1.1, 0.5]),
        ([0.06 - 0.04 - 0.12, 0.5], GOALS, [-0.1, 0.5]),
        ([0.1 + 0.02, 0.3, 0.02 - 0.02], [[0, 0, 0.02], [0, 0.2, 0.02]], [0.1, 0.3, 0.02]),
        (START, np.float32([[0.8, 1.1], [1.1, 0.3]]), START),
    ],
)
def test_points_a_little_beyond_a_wall_are_moved_onto_it(start, goals, kept):
    scene = Scene(start, goals)
    np.testing.assert_allclose(scene.start, kept, atol=1e-15)
    np.testing.assert_allclose(scene.goals, goals, atol=1e-6)
    assert scene.contains([scene.start, *scene.goals], tolerance=0).all()


def test_only_a_robot_may_be_found_clearly_beyond_a_wall():
    with pytest.raises(InvalidSceneError, match=r"start \[1.1001, 0.5\] lies outside"):
        Scene([1.1001, 0.5], GOALS)
    with pytest.raises(InvalidSceneError, match=r"start \[0.13, 0.0, 0.1\] lies outside"):
        Scene([0.13, 0, 0.1], [[0, 0, 0.02], [0, 0.2, 0.02]])
    with pytest.raises(InvalidSceneError, match=r"goals\[1\] \[1.1001, 0.3\] lies outside"):
        Scene(START, [[0.8, 0.6], [1.1001, 0.3]])
    with pytest.raises(InvalidSceneError, match=r"start and goals\[0\] coincide at \[0.1, 0.3"):
        Scene([0.105, 0.3, 0.2], [[0.1, 0.3, 0.2], [0, 0, 0.2]])


def test_arrays_of_other_libraries_are_read():
    torch = pytest.importorskip("torch")
    pandas = pytest.importorskip("pandas")
    expected = Scene(START, GOALS)
    start = torch.tensor(START, dtype=torch.float64, requires_grad=True)
    goals = [torch.tensor(goal, dtype=torch.float64, requires_grad=True) for goal in GOALS]
    assert Scene(start, goals) == expected
    assert Scene(pandas.Series(START), pandas.DataFrame(GOALS)) == expected
    assert (
        Scene([np.float64(x) for x in START], [[np.float64(x) for x in g] for g in GOALS])
        == expected
    )


@given(seeds, dims, st.integers(2, 6), st.data())
def test_random_scenes_keep_their_distances(seed, dim, num_goals, data):
    target = data.draw(st.integers(0, num_goals - 1))
    rng = np.random.default_rng(seed)
    scene = Scene.random(rng, dim=dim, num_goals=num_goals, target=target)
    assert scene.goals.shape == (num_goals, dim)
    points = np.concatenate([scene.start[None], scene.goals])
    gaps = np.linalg.norm(points[:, None] - points, axis=-1)[np.triu_indices(num_goals + 1, 1)]
    assert gaps.min() >= 0.12 * scene.diagonal
    assert np.linalg.norm(scene.start - scene.target(target)) >= 0.24 * scene.diagonal
    assert scene.contains(points).all()
    assert scene.workspace.tolist() == np.array(DEFAULT_WORKSPACE[dim]).tolist()
    if dim == 3:
        layers = (scene.goals[:, 2] - 0.02) / 0.04
        np.testing.assert_allclose(layers, np.round(layers), atol=1e-9)
        assert scene.goals[:, 2].max() <= 0.16


@given(seeds, dims)
def test_random_scenes_come_back_from_their_seed(seed, dim):
    first, again = (Scene.random(np.random.default_rng(seed), dim=dim) for _ in range(2))
    assert first == again
    assert first != Scene.random(np.random.default_rng(seed + 1), dim=dim)


@pytest.mark.parametrize("dim", [2, 3])
def test_random_scenes_have_two_to_six_goals(dim):
    rng = np.random.default_rng(0)
    scenes = [Scene.random(rng, dim=dim) for _ in range(200)]
    assert {scene.num_goals for scene in scenes} == {2, 3, 4, 5, 6}
    starts = np.array([scene.start for scene in scenes])
    low, high = np.array(DEFAULT_WORKSPACE[dim])
    spread = (starts - low) / (high - low)
    assert (spread.min(0) < 0.1).all()
    assert (spread.max(0) > 0.9).all()


@pytest.mark.parametrize(
    "arguments",
    [{"dim": 4}, {"dim": "2"}, {"dim": None}, {"num_goals": 1}, {"num_goals": 13},
     {"num_goals": 2.5}, {"num_goals": True}, {"num_goals": 3, "target": 3}, {"target": -1}],
    ids=repr,
)  # fmt: skip
def test_random_scenes_reject(arguments):
    with pytest.raises(InvalidInputError, match=r"^(dim|num_goals|target) must be"):
        Scene.random(np.random.default_rng(0), **arguments)


def test_a_scene_cannot_be_changed(scene):
    with pytest.raises(AttributeError):
        scene.start = [0, 0]
    for name in ("start", "goals", "workspace"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(scene, name)[...] = 0


def test_a_scene_does_not_follow_the_arrays_it_was_made_from():
    start, goals, workspace = np.array(START), np.array(GOALS), np.array([[-1.0, -1], [2, 2]])
    scene = Scene(start, goals, workspace)
    for array in (start, goals, workspace):
        array += 1
    assert scene == Scene(START, GOALS, [[-1, -1], [2, 2]])


@pytest.mark.parametrize(
    "make", [copy.copy, copy.deepcopy, lambda s: pickle.loads(pickle.dumps(s))]
)
def test_copies_are_equal_and_cannot_be_changed(scene, make):
    again = make(scene)
    assert again == scene
    with pytest.raises(ValueError, match="read-only"):
        again.goals[0] = 0


def test_equality_and_hash(scene):
    assert scene == Scene(tuple(START), np.array(GOALS))
    assert scene != Scene(START, GOALS[::-1])
    assert scene != Scene(START, GOALS, [[-1, -1], [2, 2]])
    assert scene != "scene"
    negative_zero = Scene([-0.0, 0.5], GOALS)
    assert negative_zero == scene
    assert {scene: 1}[negative_zero] == 1


def test_to_dict_is_plain_json(scene):
    assert Scene.from_dict(json.loads(json.dumps(scene.to_dict()))) == scene
