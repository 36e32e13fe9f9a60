"""A user's own planner or policy: found by name, asked for what it names, and never trusted."""

import pickle
import sys

import numpy as np
import pytest

import legibility as lg
from legibility.drivers import RobotStates
from legibility.errors import InvalidInputError
from legibility.evaluation.own_method import OwnPolicy, Task, load_methods
from legibility.motion.path import straight_waypoints
from legibility.motion.tracking import PathTracker

SCENE = lg.Scene([0, 0.5], [[0.8, 0.6], [1, 0.3]])
TASK = Task(SCENE, 1, 0.5, 7, lg.Observer(), 3)
CODE = """
import numpy as np
import legibility as lg

def line(scene, target):
    return [scene.start, scene.goals[target]]

def told(*, legibility, seed, observer, **others):
    told.last = {"legibility": legibility, "seed": seed, "observer": observer, **others}
    return [others["scene"].start, others["scene"].goals[others["target"]]]

def path(scene, target, legibility, observer, unused=None):
    points = np.linspace(scene.start, scene.goals[target], 10)
    points[5, 1] += 0.1
    return lg.Path.through(points, scene, target, np.array(legibility), observer)

def both(scene, target, observer):
    points = np.linspace(scene.start, scene.goals[target], 10)
    return lg.Path.through(np.stack([points] * 2), scene, target, np.zeros(2), observer)

def flat(scene): return np.zeros(10)
def solid(scene): return np.zeros((10, 3))
def one(scene): return [scene.start]
def text(scene): return "straight on"
def nothing(scene): return None
def nan(scene, target): return [scene.start, [np.nan, 0], scene.goals[target]]
def batch(scene, target): return [[scene.start, scene.goals[target]]] * 2
def beyond(scene, target): return [scene.start, [0.5, 7], scene.goals[target]]
def late(scene, target): return [scene.start + 0.1, scene.goals[target]]
def short(scene, target): return [scene.start, 0.9 * scene.goals[target]]
def fails(scene): return 1 / 0
def asks(scene, speed): ...
def positional(scene, /): ...

class Toward:
    def __init__(self, scene, target): self.goal = scene.goals[target]
    def act(self, position, limit): return 0.1 * (self.goal - position)

class Wild:
    def act(self, position, limit): return [np.inf, 0]

class Deaf:
    def act(self, position): return position

class Plain: ...

number = 5
"""
WRONG = {
    "flat": "trajectory must have at least 2 axes, got shape (10,)",
    "solid": "trajectory must have 2 numbers a point, got shape (10, 3)",
    "one": "trajectory must have at least 2 points, got shape (1, 2)",
    "text": "trajectory must be an array of numbers, got 'straight on'",
    "nothing": "trajectory must be an array of numbers, got None",
    "nan": "trajectory must be finite, got nan",
    "batch": "trajectory must be one, (T, 2), got shape (2, 2, 2)",
    "both": "trajectory must be one, (T, 2), got shape (2, ",
    "beyond": "point 1 at [0.5, 7.0] lies outside the workspace",
    "late": "trajectory must start at [0.0, 0.5], it does 0.141 m from there",
    "short": "trajectory must end at [1.0, 0.3], it does 0.104 m from there",
    "fails": "ZeroDivisionError('division by zero') at ",
}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The current folder, with the module `own_code`."""
    (tmp_path / "own_code.py").write_text(CODE)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", sys.path.copy())
    yield tmp_path
    sys.modules.pop("own_code", None)


def method(name):
    (found,) = load_methods([f"own_code.py:{name}"]).values()
    return found


class TestFound:
    @pytest.mark.parametrize("source", ["own_code", "own_code.py", "./own_code.py"])
    def test_from_the_current_folder(self, folder, source):
        found = load_methods([f"{source}:line", f"{source}:Toward"])
        assert list(found) == [f"{source}:line", f"{source}:Toward"]
        assert [m.is_policy for m in found.values()] == [False, True]
        records = [m.record for m in found.values()]
        assert [r["kind"] for r in records] == ["planner", "policy"]
        assert len(records[0]["sha256"]) == 64

    def test_what_lies_beside_a_file_is_found(self, folder):
        (folder / "deep").mkdir()
        (folder / "deep" / "helps_own.py").write_text("GOAL = 1")
        (folder / "deep" / "uses.py").write_text("from helps_own import GOAL\ndef plan(): ...")
        assert load_methods(["deep/uses.py:plan"])
        sys.modules.pop("helps_own")

    def test_after_pickling(self, folder):
        found = pickle.loads(pickle.dumps(method("line")))
        np.testing.assert_array_equal(found.paths([TASK]).curves[0], [SCENE.start, SCENE.goals[1]])

    @pytest.mark.parametrize(
        ("name", "message"),
        [
            ("plan", "method must be MODULE:NAME or FILE.py:NAME, got 'plan'"),
            (":plan", "method must be MODULE:NAME"),
            ("own_code:", "method must be MODULE:NAME"),
            ("nowhere:plan", "there is no module nowhere in"),
            ("own_code.deep:plan", "there is no module own_code.deep in"),
            ("nowhere.py:plan", "there is no file nowhere.py in"),
            ("own_code:plan", "has no function or class plan, only line, told, "),
            ("own_code:number", "has no function or class number"),
            ("own_code:Plain", "must be a function, which plans, or a class with a method act"),
            ("own_code:asks", "asks for speed; it gets those of scene, target, legibility, seed"),
            ("own_code:positional", "asks for scene; it gets those of scene"),
            ("broken.py:plan", "broken.py cannot be loaded: SyntaxError"),
            ("needs.py:plan", "needs.py cannot be loaded: ModuleNotFoundError"),
        ],
    )
    def test_refused(self, folder, name, message):
        (folder / "broken.py").write_text("def plan(:")
        (folder / "needs.py").write_text("import no_such_thing")
        with pytest.raises(InvalidInputError) as caught:
            load_methods([name])
        assert message in str(caught.value)

    def test_named_once(self, folder):
        with pytest.raises(InvalidInputError, match="names each once"):
            load_methods(["own_code:line"] * 2)


class TestPlanner:
    def test_gets_what_it_names(self, folder):
        told = method("told")
        told.paths([TASK])
        assert told.function.last == dict(zip(Task._fields[:-1], TASK[:-1], strict=True))

    def test_a_trajectory_is_measured_as_it_is(self, folder):
        paths = method("line").paths([TASK, TASK._replace(legibility=-1.0)])
        assert len(paths) == 2
        np.testing.assert_allclose(
            paths.trajectory(9)[1], np.linspace(SCENE.start, SCENE.goals[1], 9), atol=1e-12
        )
        np.testing.assert_allclose(
            paths[0].waypoints, straight_waypoints(SCENE.start, SCENE.goals[1]), atol=1e-12
        )
        assert paths.score[0] == pytest.approx(float(paths[0].score), abs=1e-9)
        assert paths.legibility.tolist() == [0.5, -1.0]

    def test_a_path_is_too(self, folder):
        planned = method("path")
        paths, path = planned.paths([TASK]), planned.function(*TASK[:3], TASK.observer)
        assert paths.score[0] == pytest.approx(float(path.score), abs=1e-4)

    @pytest.mark.parametrize("name", WRONG)
    def test_nonsense_is_named(self, folder, name):
        with pytest.raises(InvalidInputError) as caught:
            method(name).paths([TASK])
        message = str(caught.value)
        assert message.startswith(f"own_code.py:{name}, scene 3, target 1, ℓ = 0.5: ")
        assert WRONG[name] in message
        assert "\n" not in message


def states(number):
    starts = np.tile(SCENE.start, (number, 1))
    lines = np.stack([straight_waypoints(SCENE.start, SCENE.goals[1])] * number)
    tracker = PathTracker(lines, 0.05, SCENE.workspace)
    rows, idle = np.arange(number), np.zeros(number, dtype=int)
    return RobotStates(rows, starts, starts, lines[:, -1], tracker, idle)


class TestPolicy:
    def test_each_robot_has_its_own(self, folder):
        driver = OwnPolicy(method("Toward"), [TASK, TASK._replace(target=0)])
        assert not driver.with_path
        actions = driver(states(2))
        np.testing.assert_allclose(np.stack(actions)[:, 0], 0.1 * (SCENE.goals[::-1] - SCENE.start))

    def test_its_path_is_the_straight_line(self, folder):
        curve = method("Toward").paths([TASK]).trajectory(3)
        np.testing.assert_allclose(curve[0, 1], (SCENE.start + SCENE.goals[1]) / 2)

    @pytest.mark.parametrize(
        ("name", "message"),
        [("Wild", "step 0: displacement must be finite"), ("Deaf", "TypeError")],
    )
    def test_nonsense_is_named(self, folder, name, message):
        driver = OwnPolicy(method(name), [TASK])
        with pytest.raises(InvalidInputError, match=message) as caught:
            driver(states(1))
        assert str(caught.value).startswith(f"own_code.py:{name}, scene 3, target 1, ℓ = 0.5: ")
