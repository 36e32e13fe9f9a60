"""Environments of your own: what a robot in one needs to be moved, and a check of it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple, Protocol

import gymnasium
import numpy as np
from gymnasium.wrappers import MaxAndSkipObservation, RepeatAction
from numpy.typing import NDArray

from ..checks import Array, bounded, finite_array, positive, short
from ..errors import InvalidInputError, LegibilityError
from ..scene import START_OVERSHOOT, Scene
from .fleet import Fleet
from .guard import Barriers, Planes, safe_actions

DEFAULT_LAG = 0.3
"""Largest lag of a robot whose environment names none."""

_NOISE = 0.1  # in largest displacements, by which a scene may differ before paths are replanned

_CONSTANTS = {
    "max_displacement": "the largest displacement of an action along each axis [m]",
    "dt": "the duration of a step [s]",
    "reset": "reset(seed=…) of Gymnasium",
    "step": "step(action) of Gymnasium, the action a displacement (D,) [m]",
}
_STATE = {
    "scene": "a legibility.Scene, as it is now; None before the first reset",
    "target": "the index of the intended goal",
    "position": "(D,) [m], where the robot is",
    "success": "whether the robot has reached its target, True or False",
}
_MEANINGS = {**_CONSTANTS, **_STATE, "joint_angles": "(J,) [rad], of the arm"}


class Environment(Protocol):
    """What `Modulator.execute` needs of an environment that is not of this package.

    These are `reset` and `step` of Gymnasium and the state of the one robot, which is read before
    and after each step. Observations, rewards and infos are your own: nothing is read from them. A
    wrapper around your environment is the place for what it lacks; `examples/environment.py` is
    one, and `legibility.envs.check` says what is missing. The environments of this package have all
    of it as well.

    An environment may also have

    * `lag`: the largest share of its last displacement by which a robot that is sent 0 still moves
      in a step, from 0 to 0.5; 0.3 if not given. The guard stops that much earlier.
    * `set_target(index)`: called where `execute` is asked for another target than the present one.
    * `arm` and `joint_angles (J,)` [rad]: the `legibility.Arm` that moves. Its links keep off
      obstacles as well.
    """

    @property
    def max_displacement(self) -> float:
        """Largest displacement of an action along each axis [m]."""
        ...

    @property
    def dt(self) -> float:
        """Duration of a step [s]."""
        ...

    @property
    def scene(self) -> Scene | None:
        """The scene as it is now; None before the first reset.

        Its start is not read: the position is. During an episode goals and obstacles may move, by
        more than a tenth of `max_displacement` before the motion is replanned; the guard sees all.
        The number of goals and the workspace stay.
        """
        ...

    @property
    def target(self) -> int:
        """Index of the intended goal, the same during an episode."""
        ...

    @property
    def position(self) -> Array:
        """Where the robot is, `(D,)` [m], in the scene's frame."""
        ...

    @property
    def success(self) -> bool:
        """Whether the robot has reached its target, as you judge; False after a reset."""
        ...

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start an episode."""
        ...

    def step(self, action: Array) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Command a displacement `action (D,)` [m]; the robot realises a share of it, at most 1."""
        ...


class _State(NamedTuple):
    """What an environment says of its robot."""

    scene: Scene
    target: int
    position: Array
    success: bool
    joint_angles: Array


class OwnFleet(Fleet):
    """The one robot of an `Environment` of your own.

    Raises InvalidInputError if the environment lacks something, by name, or its episode has ended.
    """

    def __init__(self, env: Any, seed: int) -> None:
        self._env, self.size = env, 1
        if missing := missing_of(env):
            raise InvalidInputError(
                "env must be an environment of legibility or have what legibility.envs.Environment "
                f"names, got {env}: {'; '.join(missing)}; legibility.envs.check(env) tells all"
            )
        constants, problems = constants_of(env)
        if problems:
            raise InvalidInputError(f"{env}: {'; '.join(problems)}")
        self.limit, self.step_seconds, self.lag, self._arm = constants
        if not _was_reset(env):
            self._through_wrappers(env.reset, seed=seed)
        self._steps, self._wall, self._contact = 0, False, False
        self._now = self._read()
        self._planned, self.workspace = self._now.scene, self._now.scene.workspace
        if self._now.success:
            raise InvalidInputError("an episode has ended: reset the environment before executing")
        if problem := outside(self._now, self.limit):
            raise InvalidInputError(f"{env}: {problem}")
        self._barriers = self._seen_barriers()

    @property
    def scenes(self) -> list[Scene]:
        """The scene for which to plan: as it is now but for noise."""
        return [self._planned]

    @property
    def arms(self) -> list[Any]:
        """See `Fleet`."""
        return [self._arm]

    @property
    def targets(self) -> NDArray[np.int64]:
        """`(1,)`, index of the intended goal."""
        return np.array([self._now.target])

    @property
    def positions(self) -> Array:
        """`(1, D)` [m]."""
        return self._now.position[None]

    @property
    def joint_angles(self) -> Array:
        """`(1, J)` [rad]; J = 0 without an arm."""
        return self._now.joint_angles[None]

    @property
    def wall_contacts(self) -> NDArray[np.bool_]:
        """`(1,)`, whether the last step ended beyond a wall."""
        return np.array([self._wall])

    @property
    def contacts(self) -> NDArray[np.bool_]:
        """`(1,)`, whether the last step touched an obstacle or another goal."""
        return np.array([self._contact])

    @property
    def counts(self) -> dict[str, NDArray[np.int64]]:
        """None: events of its own do not count."""
        return {}

    def set_targets(self, targets: Sequence[Any]) -> None:
        """Set the intended goal, if it is another one than now.

        Raises:
            InvalidInputError: it is none of the scene's, or the environment cannot change it.
        """
        index = self._now.scene.check_target(targets[0])
        if index == self._now.target:
            return
        change = _value(self._env, "set_target", None)
        if change is None:
            raise InvalidInputError(
                f"env has the target {self._now.target} and no set_target(index) for {index}"
            )
        self._through_wrappers(change, index)
        if (now := self._read()).target != index:
            raise InvalidInputError(f"set_target({index}) left env with the target {now.target}")
        self._now, self._planned = now, now.scene
        self._barriers = self._seen_barriers()

    def safe(self, actions: Array, positions: Array, velocities: Array) -> Array:
        """See `Fleet`; obstacles are those of the scene as it is now."""
        planes = None
        if self._arm is not None and (obstacles := self._now.scene.obstacles):
            planes = Planes.of([next(self._arm.nearby(obstacles, self.joint_angles))])
        return safe_actions(
            actions, positions, velocities, self.workspace, self.limit, self.lag, self._barriers,
            planes,
        )  # fmt: skip

    def step(
        self, actions: Array, active: NDArray[np.bool_]
    ) -> tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]:
        """See `Fleet`.

        Raises:
            InvalidInputError: the environment fails, or what it says is not what it must be.
        """
        result: Any = self._through_wrappers(self._env.step, actions[0].copy())
        if not isinstance(result, tuple) or len(result) != 5:
            raise InvalidInputError(
                f"{self._env}: step must return observation, reward, terminated, truncated and "
                f"info, got {short(result)}"
            )
        before, self._steps = self._now, self._steps + 1
        now = self._read()
        if problem := _changed(before, now):
            raise InvalidInputError(f"{self._env}: after {self._steps} steps: {problem}")
        moved = (now.position - before.position)[None]
        touched = self._barriers is not None and self._barriers.touched(self.positions, moved)
        self._contact = bool(np.any(touched))
        self._wall = not now.scene.contains(now.position)
        self._now = now
        if now.scene != before.scene:
            self._barriers = self._seen_barriers()
        if not now.scene.alike(self._planned, _NOISE * self.limit):
            self._planned = now.scene
        terminated, truncated = (np.atleast_1d(np.asarray(end, dtype=bool)) for end in result[2:4])
        return np.array([now.success]), terminated, truncated

    def _read(self) -> _State:
        """What the environment says now, checked."""
        state, problems = state_of(self._env, self._arm)
        if state is None:
            when = f"after {self._steps} steps: " if self._steps else ""
            raise InvalidInputError(f"{self._env}: {when}{'; '.join(problems)}")
        return state

    def _seen_barriers(self) -> Barriers | None:
        """What the robot must keep off now."""
        return Barriers.of([self._now.scene], [self._now.target])


_NEEDED = object()


def _value(env: Any, name: str, default: Any = _NEEDED) -> Any:
    """An attribute of an environment or of a wrapper around it."""
    try:
        through = getattr(env, "get_wrapper_attr", None)
        return getattr(env, name) if through is None else through(name)
    except AttributeError:
        if default is not _NEEDED:
            return default
        raise InvalidInputError(f"{name} is missing: {_MEANINGS[name]}") from None
    except LegibilityError as cause:
        raise InvalidInputError(f"{name}: {cause}") from cause
    except Exception as cause:
        raise InvalidInputError(f"{name} raises {cause!r}") from cause


def missing_of(env: Any) -> list[str]:
    """A line for each of `_CONSTANTS` that an environment lacks."""
    return _collected(_CONSTANTS, lambda name: _value(env, name))[1]


def _collected(names: Iterable[str], read: Callable[[str], Any]) -> tuple[list[Any], list[str]]:
    """What is read by each name, and a line for each that cannot be."""
    values, problems = [], []
    for name in names:
        try:
            values.append(read(name))
        except LegibilityError as cause:
            values.append(None)
            problems.append(str(cause))
    return values, problems


def _was_reset(env: Any) -> bool:
    """Whether an environment has a scene."""
    try:
        return _value(env, "scene") is not None
    except LegibilityError:
        return False


def constants_of(env: Any) -> tuple[tuple[float, float, float, Any], list[str]]:
    """Limit, duration of a step, lag and arm; and what is wrong with those that it has."""

    def read(name: str) -> Any:
        if name == "lag":
            return bounded(name, _value(env, name, DEFAULT_LAG), 0, 0.5)
        if name == "arm":
            return _arm(_value(env, name, None))
        value = _value(env, name, None)
        return None if value is None else positive(name, value)

    values, problems = _collected(("max_displacement", "dt", "lag", "arm"), read)
    layer: Any = env
    while isinstance(layer, gymnasium.Wrapper) and not hasattr(layer, "max_displacement"):
        if isinstance(layer, gymnasium.ActionWrapper | RepeatAction | MaxAndSkipObservation):
            problems.append(
                f"{type(layer).__name__} changes or repeats actions: it belongs below the wrapper "
                "that has max_displacement"
            )
        layer = layer.env
    limit, dt, lag, arm = values
    return (limit, dt, lag, arm), problems


def _arm(value: Any) -> Any:
    if value is None:
        return None
    from ..robots.arm import Arm

    if not isinstance(value, Arm):
        raise InvalidInputError(f"arm must be a legibility.Arm, got {short(value)}")
    return value


def state_of(env: Any, arm: Any) -> tuple[_State | None, list[str]]:
    """What an environment says of its robot, or what is wrong with that."""
    scene: Scene | None = None

    def read(name: str) -> Any:
        nonlocal scene
        value = _value(env, name)
        if name == "scene":
            if not isinstance(value, Scene):
                kind = type(value).__name__
                raise InvalidInputError(f"scene must be a legibility.Scene, got {kind}")
            scene = value
            return value
        if name == "target":
            return value if scene is None else scene.check_target(value)
        if name == "success":
            if not isinstance(value, bool | np.bool_):
                raise InvalidInputError(f"success must be True or False, got {short(value)}")
            return bool(value)
        last: Any = (2, 3) if scene is None else scene.dim
        last = arm.joints if name == "joint_angles" else last
        return finite_array(name, value, ndim=1, last=last).copy()  # the environment may write

    names = [*_STATE, *["joint_angles"] * (arm is not None)]
    values, problems = _collected(names, read)
    if problems:
        return None, problems
    found, target, position, success, *angles = values
    return _State(found, target, position, success, *(angles or [np.empty(0)])), []


def outside(state: _State, limit: float) -> str:
    """What is wrong with the position at the start of a motion."""
    low, high = state.scene.workspace
    spare = max(limit, START_OVERSHOOT[state.scene.dim] * state.scene.diagonal)
    if ((state.position >= low - spare) & (state.position <= high + spare)).all():
        return ""
    return (
        f"position must lie in the scene's workspace {state.scene.workspace.tolist()} m, "
        f"got {state.position.tolist()}"
    )


def _changed(before: _State, now: _State) -> str:
    """What changed in an episode and must not."""
    if now.target != before.target:
        return f"target must stay {before.target} during an episode, got {now.target}"
    if now.scene.goals.shape != before.scene.goals.shape:
        return (
            f"scene must keep its {before.scene.num_goals} goals during an episode, got "
            f"{now.scene.num_goals}"
        )
    if not np.array_equal(now.scene.workspace, before.scene.workspace):
        return (
            f"scene must keep its workspace {before.scene.workspace.tolist()} during an episode, "
            f"got {now.scene.workspace.tolist()}"
        )
    return ""
