"""A scene is valid, immutable, and the same after a round trip."""

import copy
import json
import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from legibility import Ball, Box, Polygon, Scene
from legibility.errors import InvalidInputError, InvalidSceneError, OutputError
from legibility.scene import DEFAULT_WORKSPACE

START, GOALS = [0.0, 0.5], [[0.8, 0.6], [1.0, 0.3]]
OBSTACLES = [
    Ball([0.4, 0.9], 0.1),
    Box([0.5, 0.2], [0.2, 0.1], 0.3),
    Polygon([[0.5, 0.8], [0.7, 0.8], [0.6, 1.0]]),
]
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
    assert scene.size == np.linalg.norm([1.0, 0.2])
    assert (scene.obstacles, scene.goal_radius, scene.clearance) == ((), 0, 0)


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
    "goal_radius < 0": ({"goal_radius": -1}, "goal_radius must be a number of at least 0, got -1"),
    "clearance NaN": ({"clearance": np.nan}, "clearance must be finite, got nan"),
    "clearance none": ({"clearance": None}, "clearance must"),
    "start at a goal": ({"goal_radius": 0.9}, "start lies 0.806 m from a goal, within goal_radius"),
}


@pytest.mark.parametrize(("change", "message"), BAD.values(), ids=BAD)
def test_bad_scenes_are_named(change, message):
    content = {"start": START, "goals": GOALS} | change
    with pytest.raises(InvalidSceneError, match=message):
        Scene(**content)
    if change != {"clearance": None}:  # which a file may leave empty
        with pytest.raises(InvalidSceneError, match=message):
            Scene.from_dict(content)


BAD_OBSTACLES = {
    "over the start": ([OBSTACLES[0], Ball(START, 0.1)], {}, r"obstacles\[1\] lies over the start"),
    "near the start": (
        [Ball([0, 0.7], 0.1)], {"clearance": 0.2},
        r"obstacles\[0\] lies 0.1 m from the start \[0.0, 0.5\], within the clearance 0.2",
    ),
    "in 3D": ([Ball([0, 0, 0], 0.1)], {}, r"obstacles\[0\] is 3D, the scene is 2D"),
    "mapping": ([OBSTACLES[0].to_dict()], {}, r"obstacles\[0\] must be a Ball, a Box or a Polygon"),
    "one": (OBSTACLES[0], {}, "obstacles must be a list, got Ball"),
    "text": ("ball", {}, "obstacles must be a list, got 'ball'"),
    "none": (None, {}, "obstacles must be a list, got None"),
}  # fmt: skip


@pytest.mark.parametrize(("obstacles", "others", "message"), BAD_OBSTACLES.values(),
                         ids=BAD_OBSTACLES)  # fmt: skip
def test_bad_obstacles_are_named(obstacles, others, message):
    with pytest.raises(InvalidSceneError, match=message):
        Scene(START, GOALS, obstacles=obstacles, **others)


BAD_TARGETS = {
    "over": ([Ball([0.8, 0.65], 0.1)], {}, r"obstacles\[0\] lies over the target goals\[0\]"),
    "near": (
        [Ball([0.8, 0.8], 0.1)], {"clearance": 0.15},
        r"obstacles\[0\] lies 0.1 m from the target goals\[0\] \[0.8, 0.6\], within the clearance",
    ),
    "beside": ([], {"goal_radius": 0.4}, r"goals\[0\] lies 0.361 m from another goal, within"),
}  # fmt: skip


@pytest.mark.parametrize(("obstacles", "others", "message"), BAD_TARGETS.values(), ids=BAD_TARGETS)
def test_targets_where_no_motion_can_end_are_named(obstacles, others, message):
    scene = Scene(START, GOALS, obstacles=obstacles, **others)
    with pytest.raises(InvalidSceneError, match=message):
        scene.check_target(0)
    if obstacles:
        assert scene.check_target(1) == 1


def test_obstacles_may_touch_start_and_target():
    scene = Scene(START, GOALS, obstacles=[Ball([0, 0.6], 0.1), Ball([0.8, 0.7], 0.1)])
    assert scene.check_target(0) == 0
    assert scene.feasible([START, GOALS[0]], 0)


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
        ({"start": START, "goals": GOALS, "obstacles": {"ball": 1}}, "obstacles must be a list"),
        ({"start": START, "goals": GOALS, "obstacles": [{"cone": 1}]}, "one key, ball, box or pol"),
        (
            {"start": START, "goals": GOALS, "obstacles": [{"ball": {"center": START}}]},
            "a ball has the keys center, radius",
        ),
    ],
)
def test_contents_that_are_not_a_scene(content, message):
    with pytest.raises(InvalidSceneError, match=message):
        Scene.from_dict(content)


def test_keys_that_are_left_empty():
    content = {"start": START, "goals": GOALS}
    empty = dict.fromkeys(("workspace", "obstacles", "goal_radius", "clearance"))
    assert Scene.from_dict({**content, **empty}) == Scene(START, GOALS)
    with pytest.raises(InvalidSceneError, match="start must be an array of numbers, got None"):
        Scene.from_dict({**content, "start": None})


@pytest.mark.parametrize("size", [1e-12, 1e7, 1e200])
def test_rooms_of_no_sense(size):
    corners = [[-size, -size], [size, size]]
    with pytest.raises(InvalidSceneError, match="workspace must have a diagonal from 1e-09 to"):
        Scene([0, 0], [[size / 2, 0], [0, size / 2]], corners)


@pytest.mark.parametrize("target", [-1, 2, 0.5])
def test_a_wrong_target_is_refused_whatever_is_solid(target):
    scene = Scene(START, GOALS)
    for ask in (lambda: scene.feasible([START, GOALS[0]], target),
                lambda: scene.clearance_at(START, target)):  # fmt: skip
        with pytest.raises(InvalidInputError, match="target must be"):
            ask()


def test_points_that_are_none():
    scene = Scene(START, GOALS)
    with pytest.raises(InvalidInputError, match="points must be numbers of shape"):
        scene.contains([0, 0, 0])
    with pytest.raises(InvalidInputError, match="curves must have at least 2 points"):
        scene.feasible(np.zeros((0, 2)), 0)


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


@pytest.mark.parametrize("name", ["scene.yaml", "scene.json"])
def test_round_trip_with_obstacles(tmp_path, name):
    scene = Scene(START, GOALS, None, OBSTACLES, goal_radius=0.05, clearance=0.1 / 3)
    scene.save(tmp_path / name)
    loaded = Scene.load(tmp_path / name)
    assert loaded == scene
    assert hash(loaded) == hash(scene)
    assert repr(loaded) == repr(scene)


def test_obstacles_of_a_file(tmp_path):
    text = """
start: [0, .5]
goals: [[.8, .6], [1, .3]]
obstacles:
- {ball: {center: [.4, .9], radius: .1}}
- {box: {center: [.5, .2], size: [.2, .1], yaw: .3}}
- {polygon: [[.5, .8], [.7, .8], [.6, 1]]}
goal_radius: .05
"""
    (tmp_path / "scene.yaml").write_text(text)
    assert Scene.load(tmp_path / "scene.yaml") == Scene(START, GOALS, None, OBSTACLES, 0.05)


def test_a_scene_without_obstacles_is_written_as_before(scene):
    assert list(scene.to_dict()) == ["start", "goals", "workspace"]


@pytest.mark.parametrize(
    "scene",
    [
        Scene([1e-8, 1 / 3], [[0.1 + 0.2, -1e-300], [1, 123.45678901234567]], [[-1, -5], [2, 1e3]]),
        Scene([1e-7, 5e-324], [[1e5, 0.1], [-123456.78901234567890, 1e4]], [[-2e5] * 2, [2e5] * 2]),
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
    assert isinstance(Scene(START, GOALS, obstacles=OBSTACLES).obstacles, tuple)


def test_a_scene_does_not_follow_the_arrays_it_was_made_from():
    start, goals, workspace = np.array(START), np.array(GOALS), np.array([[-1.0, -1], [2, 2]])
    scene = Scene(start, goals, workspace)
    for array in (start, goals, workspace):
        array += 1
    assert scene == Scene(START, GOALS, [[-1, -1], [2, 2]])


@pytest.mark.parametrize(
    "make", [copy.copy, copy.deepcopy, lambda s: pickle.loads(pickle.dumps(s))]
)
def test_copies_are_equal_and_cannot_be_changed(make):
    scene = Scene(START, GOALS, None, OBSTACLES, 0.01, 0.02)
    again = make(scene)
    assert again == scene
    assert hash(again) == hash(scene)
    for array in (again.goals, again.obstacles[0].center):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0


def test_equality_and_hash(scene):
    assert scene == Scene(tuple(START), np.array(GOALS))
    assert scene != Scene(START, GOALS[::-1])
    assert scene != Scene(START, GOALS, [[-1, -1], [2, 2]])
    assert scene != "scene"
    others = {"obstacles": OBSTACLES, "goal_radius": 0.1, "clearance": 0.1}
    for name, value in others.items():
        assert scene != Scene(START, GOALS, **{name: value})
    assert Scene(START, GOALS, **others) == Scene(START, GOALS, **others)
    assert Scene(START, GOALS, **others) != Scene(
        START, GOALS, **{**others, "obstacles": OBSTACLES[::-1]}
    )
    negative_zero = Scene([-0.0, 0.5], GOALS)
    assert negative_zero == scene
    assert {scene: 1}[negative_zero] == 1


def test_to_dict_is_plain_json(scene):
    assert Scene.from_dict(json.loads(json.dumps(scene.to_dict()))) == scene


def test_repr_is_short_and_python(scene):
    assert repr(scene) == "Scene(start=[0.0, 0.5], goals=[[0.8, 0.6], [1.0, 0.3]])"
    full = Scene(START, GOALS, [[-1, -1], [2, 2]], OBSTACLES, 0.01, 0.02)
    assert eval(repr(full)) == full


class TestClearance:
    SCENE = Scene(START, GOALS, None, OBSTACLES, goal_radius=0.05, clearance=0.02)

    @given(seeds)
    def test_is_the_least_of_walls_obstacles_and_goals(self, seed):
        scene = self.SCENE
        points = np.random.default_rng(seed).uniform(-0.3, 1.3, (20, 2))
        low, high = scene.workspace
        walls = np.minimum(points - low, high - points).min(-1)
        solid = np.min([o.signed_distance(points) for o in OBSTACLES], axis=0)
        goal = np.linalg.norm(points - GOALS[1], axis=-1) - 0.05
        nearest = np.minimum(walls, solid)
        np.testing.assert_allclose(scene.clearance_at(points), nearest, atol=1e-12)
        np.testing.assert_allclose(
            scene.clearance_at(points, 0), np.minimum(nearest, goal), atol=1e-12
        )
        np.testing.assert_allclose(
            scene.margin_at(points, 0), np.minimum(np.minimum(walls, solid - 0.02), goal),
            atol=1e-12,
        )  # fmt: skip

    def test_feasible_are_curves_without_a_negative_margin(self):
        straight = np.linspace(START, GOALS[0], 50)
        through = np.linspace(START, [0.5, 0.2], 50)
        beyond = np.linspace(START, [-0.1001, 0.5], 50)
        past_a_goal = np.linspace(START, [1.1, 0.27], 50)
        curves = np.stack([straight, through, beyond, past_a_goal])
        assert self.SCENE.feasible(curves, 0).tolist() == [True, False, False, False]
        assert self.SCENE.feasible(past_a_goal, 1)
        assert self.SCENE.feasible([[-0.1, 0.5], [-0.1, 0.6]], 0)  # along a wall

    @pytest.mark.parametrize("scene", [SCENE, Scene(START, GOALS)])
    def test_leading_axes(self, scene):
        points = np.random.default_rng(0).uniform(0, 1, (2, 3, 4, 2))
        distance = scene.clearance_at(points)
        assert distance.shape == (2, 3, 4)
        assert scene.clearance_at(points[1, 2, 3]) == distance[1, 2, 3]
        assert scene.feasible(points, 0).shape == (2, 3)

    def test_points_of_another_dimension_are_named(self):
        with pytest.raises(InvalidInputError, match="points must have 2 numbers"):
            self.SCENE.clearance_at([0, 0, 0])

    def test_solids_are_kept(self):
        same = Scene(START, GOALS, None, OBSTACLES, goal_radius=0.05, clearance=0.02)
        assert self.SCENE.solids(0) is same.solids(0)
        assert self.SCENE.solids(0) is not same.solids(1)


class TestStartingAt:
    """The scene of a robot that has moved."""

    def test_the_same_scene_from_the_same_place(self):
        assert TestClearance.SCENE.starting_at(np.array(START) + 5e-5) is TestClearance.SCENE

    @pytest.mark.parametrize(
        ("position", "start"), [([0.3, 0.4], [0.3, 0.4]), ([-0.5, 0.4], [-0.1, 0.4])]
    )
    def test_elsewhere(self, position, start):
        scene = TestClearance.SCENE.starting_at(np.array(position))
        assert scene.start.tolist() == start
        assert scene.obstacles == tuple(OBSTACLES)
        assert (scene.goal_radius, scene.clearance) == (0.05, 0.02)

    @given(seeds)
    def test_anywhere_it_is_a_scene(self, seed):
        rng = np.random.default_rng(seed)
        scene, around = TestClearance.SCENE, [*GOALS, [0.4, 0.9], [0.5, 0.2], [0.6, 0.9]]
        position = around[rng.integers(5)] + rng.normal(0, rng.choice([0, 1e-6, 0.05]), 2)
        moved = scene.starting_at(position)
        assert moved.margin_at(moved.start) >= -1e-8
        assert np.linalg.norm(moved.start - position) < 0.2
        assert len(moved.obstacles) == 3

    def test_on_a_goal_it_starts_just_beside_it(self):
        moved = Scene(START, GOALS).starting_at(np.array(GOALS[0]))
        assert 0 < np.linalg.norm(moved.start - GOALS[0]) < 1e-4

    def test_walled_in_it_leaves_the_obstacle_out(self):
        walls = [Box([0.5, 0.5], [3, 0.2]), Box([0.5, 0.7], [3, 0.4])]
        scene = Scene([0, 0], [[0.8, 0.1], [0.9, 0.3]], [[-0.1, -0.1], [1.1, 0.85]], walls)
        moved = scene.starting_at(np.array([0.5, 0.8]))
        assert moved.margin_at(moved.start) >= -1e-8


@given(seeds, dims, st.floats(0.01, 100), st.floats(-1e3, 1e3))
def test_clearance_moves_and_scales_with_the_scene(seed, dim, scale, offset):
    rng = np.random.default_rng(seed)
    scene = Scene.random(rng, dim=dim)
    ball = Ball(rng.uniform(*scene.workspace), 0.01)
    try:
        scene = Scene(scene.start, scene.goals, None, [ball], goal_radius=0.02)
    except InvalidSceneError:
        return
    large = Scene(
        scale * scene.start + offset,
        scale * scene.goals + offset,
        scale * scene.workspace + offset,
        [Ball(scale * ball.center + offset, scale * ball.radius)],
        goal_radius=scale * 0.02,
    )
    points = rng.uniform(*scene.workspace, (20, dim))
    np.testing.assert_allclose(
        large.clearance_at(scale * points + offset, 0), scale * scene.clearance_at(points, 0),
        atol=1e-9 * max(scale, 1e3),
    )  # fmt: skip
    assert large.size == pytest.approx(scale * scene.size)


def test_scenes_that_are_alike():
    def scene(x, *obstacles):
        return Scene(START, [[x, 0.6], GOALS[1]], obstacles=obstacles)

    one = scene(0.8, Box([0.5, 0.5], [0.1, 0.2], 0.3))
    near = scene(0.801, Box([0.5, 0.5], [0.1, 0.2001], 0.3))
    assert one.alike(one, 0)
    assert one.alike(Scene([0.1, 0.1], one.goals, obstacles=one.obstacles), 0)
    assert one.alike(near, 0.0011)
    assert not one.alike(near, 0.0009)
    assert not one.alike(scene(0.8), 1)
    assert not one.alike(scene(0.8, Ball([0.5, 0.5], 0.1)), 1)
