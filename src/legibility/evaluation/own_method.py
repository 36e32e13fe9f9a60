"""Methods of your own: a planner or a policy, by the name of its function or class."""

from __future__ import annotations

import functools
import importlib
import importlib.util
import inspect
import os
import sys
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path as FilePath
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np

from ..checks import Array, finite_array, trajectory_array
from ..curves import NUM_WAYPOINTS, resample
from ..drivers import RobotStates
from ..errors import InvalidInputError
from ..files import file_hash
from ..intent.metrics import SCORE_POINTS
from ..intent.observer import Observer
from ..motion.path import Path
from ..scene import Scene

_ENDS = 0.01  # of the workspace's diagonal, by which a motion may miss its start and target
_WALL = 1e-6  # the same, by which it may leave the workspace


class Task(NamedTuple):
    """A motion that is asked of a method."""

    scene: Scene
    target: int
    legibility: float
    seed: int
    observer: Observer
    scene_index: int

    def __str__(self) -> str:
        return f"scene {self.scene_index}, target {self.target}, ℓ = {self.legibility:g}"


_GIVEN = Task._fields[:-1]
"""What a method may ask for, by the names of its parameters."""


class OwnMethod:
    """A planner or a policy of a user.

    A planner is a function that returns a motion from the scene's start to the target: points
    `(T, D)` [m], which straight lines join, or a `legibility.Path`. A policy is a class with a
    method `act(position, limit)`, which returns the next displacement `(D,)` [m]; each motion has
    an instance of its own. Function and class are called with those of `scene`, `target`,
    `legibility`, `seed` and `observer` that are the names of their parameters.

    Args:
        name: `MODULE:NAME`, of a module that can be imported from `folder` or is installed, or
            `FILE.py:NAME`.
        folder: where relative files and modules lie.

    Attributes:
        is_policy: whether it is a policy.

    Raises:
        InvalidInputError: there is no such function or class, or it asks for something else.
    """

    def __init__(self, name: str, folder: str) -> None:
        self.name, self.folder = name, folder
        source, _, attribute = name.rpartition(":")
        if not source or not attribute:
            raise InvalidInputError(f"method must be MODULE:NAME or FILE.py:NAME, got {name!r}")
        module = _module(source, folder)
        self.function: Any = getattr(module, attribute, None)
        if not callable(self.function):
            known = [n for n, value in vars(module).items() if callable(value) and n[0] != "_"]
            raise InvalidInputError(
                f"method {name}: {source} has no function or class {attribute}, only "
                f"{', '.join(known) or 'none'}"
            )
        self.is_policy = hasattr(self.function, "act")
        if inspect.isclass(self.function) != self.is_policy:
            raise InvalidInputError(
                f"method {name} must be a function, which plans, or a class with a method act"
            )
        self._names = _asked_for(name, self.function)
        file = getattr(module, "__file__", None)
        self.record = {
            "kind": "policy" if self.is_policy else "planner",
            "sha256": file_hash(FilePath(file)) if file else None,
        }

    def __reduce__(self) -> tuple[type[OwnMethod], tuple[str, str]]:
        return OwnMethod, (self.name, self.folder)  # a function of a file cannot be pickled

    def paths(self, tasks: Sequence[Task]) -> Path:
        """The motions of `B` tasks in one scene, to one target.

        The waypoints, which stage 2 follows, are taken from a planner's trajectory at equal arc
        length; `trajectory` and all that is read off it are as they were planned. A policy has the
        straight line, which it does not follow.

        Raises:
            InvalidInputError: it fails, or returns no motion from start to target in the workspace.
        """
        first = tasks[0]
        curves = tuple(map(self._curve, tasks))
        return _Curves(
            scene=first.scene,
            target=first.target,
            legibility=np.array([task.legibility for task in tasks]),
            waypoints=np.stack([resample(curve, NUM_WAYPOINTS + 2) for curve in curves]),
            observer=first.observer,
            replaced=np.zeros(len(tasks), dtype=bool),
            curves=curves,
        )

    def _curve(self, task: Task) -> Array:
        """The trajectory `(T, D)` [m] of a task, checked."""
        scene, where = task.scene, f"{self.name}, {task}"
        ends = scene.start, scene.target(task.target)
        if self.is_policy:
            return np.stack(ends)
        found = self._called(self.function, task)
        if isinstance(found, Path):
            found = found.trajectory()
        points = trajectory_array(found, scene.dim, f"{where}: trajectory").copy()
        if points.ndim != 2:
            raise InvalidInputError(
                f"{where}: trajectory must be one, (T, {scene.dim}), got shape {points.shape}"
            )
        beyond = np.flatnonzero(~scene.contains(points, _WALL))
        if len(beyond):
            raise InvalidInputError(
                f"{where}: point {beyond[0]} at {points[beyond[0]].tolist()} lies outside the "
                f"workspace {scene.workspace.tolist()} m"
            )
        for what, end, point in zip(("start", "end"), ends, points[[0, -1]], strict=True):
            if (gap := float(np.linalg.norm(point - end))) > _ENDS * scene.diagonal:
                raise InvalidInputError(
                    f"{where}: trajectory must {what} at {end.tolist()}, it does {gap:.3g} m from "
                    f"there, at {point.tolist()}"
                )
        points[0], points[-1] = ends
        return points

    def policy(self, task: Task) -> Callable[[Array, float, int], Array]:
        """The displacement `(D,)` [m] of a policy by position, limit and the number of the step.

        Raises:
            InvalidInputError: it fails; or, later, it returns no displacement.
        """
        policy, where = self._called(self.function, task), f"{self.name}, {task}"

        def act(position: Array, limit: float, step: int) -> Array:
            action = self._tried(policy.act, task, position.copy(), limit)
            name = f"{where}: step {step}: displacement"
            return finite_array(name, action, ndim=1, last=len(position))

        return act

    def _called(self, function: Callable[..., Any], task: Task) -> Any:
        return self._tried(function, task, **{name: getattr(task, name) for name in self._names})

    def _tried(self, function: Callable[..., Any], task: Task, *args: Any, **named: Any) -> Any:
        """What the user's code returns; its failure in one line, with its place."""
        try:
            return function(*args, **named)
        except Exception as cause:
            raise InvalidInputError(f"{self.name}, {task}: {_failure(cause)}") from cause


@dataclass(frozen=True, eq=False)
class _Curves(Path):
    """Paths of `B` levels whose `curves`, `(T, D)` [m] each, are given."""

    curves: tuple[Array, ...]

    def trajectory(self, num_points: int = SCORE_POINTS) -> Array:
        """The curves at equal arc length, `(B, num_points, D)` [m]."""
        return np.stack([resample(curve, num_points) for curve in self.curves])

    def __getitem__(self, index: int) -> Path:
        """The path of one level, through its waypoints alone."""
        paths = Path.through(
            self.waypoints, self.scene, self.target, self.legibility, self.observer
        )
        return paths[index]


class OwnPolicy:
    """Moves each robot by a policy of its own; see `Driver`.

    Args:
        method: the policy.
        tasks: of the `B` robots.
    """

    with_path = False

    def __init__(self, method: OwnMethod, tasks: Sequence[Task]) -> None:
        self.policies = [method.policy(task) for task in tasks]
        self.steps = [0] * len(tasks)

    def __call__(self, robots: RobotStates) -> list[Array]:
        """See `Driver`."""
        actions, limit = [], robots.tracker.limit
        for row, position in zip(robots.rows.tolist(), robots.positions, strict=True):
            actions.append(self.policies[row](position, limit, self.steps[row])[None])
            self.steps[row] += 1
        return actions


def load_methods(names: Sequence[str]) -> dict[str, OwnMethod]:
    """Methods of the user by name, found from the current folder.

    Raises:
        InvalidInputError: one is not there, or named twice.
    """
    methods = {name: OwnMethod(name, os.getcwd()) for name in names}
    if len(methods) < len(names):
        raise InvalidInputError(f"method names each once, got {' '.join(names)}")
    return methods


@functools.lru_cache(maxsize=32)
def _module(source: str, folder: str) -> ModuleType:
    """A module by its name or file."""
    try:
        if source.endswith(".py"):
            file = FilePath(folder, source)
            if not file.is_file():
                raise InvalidInputError(f"method: there is no file {source} in {folder}")
            _look_in(str(file.parent))  # for what lies beside it
            spec = importlib.util.spec_from_file_location(f"legibility_own_{file.stem}", file)
            assert spec is not None
            assert spec.loader is not None
            module = sys.modules[spec.name] = importlib.util.module_from_spec(spec)
            spec.loader.exec_module(module)
            return module
        _look_in(folder)
        return importlib.import_module(source)
    except InvalidInputError:
        raise
    except Exception as cause:
        if isinstance(cause, ModuleNotFoundError) and f"{source}.".startswith(f"{cause.name}."):
            problem = f"method: there is no module {cause.name} in {folder}, and none is installed"
            raise InvalidInputError(problem) from cause
        raise InvalidInputError(f"method: {source} cannot be loaded: {_failure(cause)}") from cause


def _look_in(folder: str) -> None:
    if folder not in sys.path:
        sys.path.insert(0, folder)


def _failure(cause: Exception) -> str:
    """An exception of the user's code, and where it was raised."""
    frames = traceback.extract_tb(cause.__traceback__)
    return f"{cause!r} at {frames[-1].filename}:{frames[-1].lineno}"


def _asked_for(name: str, function: Callable[..., Any]) -> list[str]:
    """The names of `_GIVEN` that a function takes."""
    try:
        parameters = inspect.signature(function).parameters.values()
    except ValueError as cause:
        raise InvalidInputError(f"method {name}: {cause}") from cause
    if any(p.kind is p.VAR_KEYWORD for p in parameters):
        return list(_GIVEN)
    named = [p for p in parameters if p.kind in (p.POSITIONAL_OR_KEYWORD, p.KEYWORD_ONLY)]
    for parameter in parameters:
        needed = parameter.default is parameter.empty and parameter.kind != parameter.VAR_POSITIONAL
        if needed and (parameter not in named or parameter.name not in _GIVEN):
            raise InvalidInputError(
                f"method {name} asks for {parameter.name}; it gets those of {', '.join(_GIVEN)} "
                "that its parameters name"
            )
    return [p.name for p in named if p.name in _GIVEN]
