"""The block reaching task, whatever moves: scenes, targets, success and disturbances, in metres.

A robot is a subclass: `block_reach_2d`'s point in the plane, or an arm in one of two simulators.
"""

from __future__ import annotations

import copy
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from ..checks import Array, bounded, count, finite_array, random_seed, target_index
from ..errors import InvalidInputError, InvalidSceneError
from ..scene import DEFAULT_WORKSPACE, Scene
from . import MAX_EPISODE_STEPS

__all__ = ["BlockReach", "BlockReachVector"]

_OPTIONS = ("scene", "target", "num_goals", "noise", "push", "shift")
_RADIUS = 0.02
_SLOW = 0.2


class BlockReachVector(VectorEnv[dict[str, Any], Array, NDArray[Any]]):
    """Many robots at once, each among blocks of its own, stepped together.

    Environment i of a reset with seed s is the single environment reset with seed s + i. An
    environment that has ended stands still, and stays ended, until it is reset
    (`AutoresetMode.DISABLED`); the option `reset_mask (B,)` bool of `reset` chooses which are
    reset. Seed and options may be given as one for all or as a list of one for each environment.

    A subclass says what moves: `_draw_robot`, `_place`, `_move` and `_picture`.

    Attributes:
        positions: `(B, D)` [m].
        velocities: `(B, D)` [m], the displacements of the last step, a push left out.
        scenes: the scenes as they are now; their start is where the episode started.
        targets: `(B,)`, index of the intended goal.
        done: `(B,)` bool, ended by success or by the limit on steps.
        success: `(B,)` bool, ended by success.
        steps: `(B,)`, control steps of the episode.
        commands: `(B, D)` [m], the actions of the last step as they were received.
        wall_contact: `(B,)` bool, whether a wall stopped the robot in the last step.
        counts: events over an episode by name, `(B,)` each.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 (Gymnasium's own form)
        "render_modes": ["rgb_array"],
        "render_fps": 20,
        "autoreset_mode": AutoresetMode.DISABLED,
    }
    dim: ClassVar[int]
    max_displacement: ClassVar[float]
    """Largest commanded displacement of a step along each axis [m]."""
    lag_range: ClassVar[tuple[float, float]]
    """How much of its last displacement a robot repeats that is told to stop, least and most."""
    at_once: ClassVar[int] = 256
    """As many as one process should hold."""
    robot_options: ClassVar[tuple[str, ...]] = ()
    """Options of `reset` beside those that all robots share."""
    counted: ClassVar[tuple[str, ...]] = ()
    """Names of `counts`."""
    overshoot: ClassVar[float] = 0.0
    """How far beyond the workspace a position may be [m]."""

    def __init__(
        self,
        num_envs: int = 1,
        *,
        max_goals: int = 6,
        max_episode_steps: int = MAX_EPISODE_STEPS,
        render_mode: str | None = None,
    ) -> None:
        self.num_envs = count("num_envs", num_envs)
        self.max_goals = count("max_goals", max_goals, low=2)
        self.max_episode_steps = count("max_episode_steps", max_episode_steps)
        check_render_mode(render_mode, self.metadata["render_modes"])
        self.render_mode = render_mode
        self.workspace = np.array(DEFAULT_WORKSPACE[self.dim])
        low, high = self.workspace
        self.single_observation_space = spaces.Dict({
            "position": spaces.Box(low - self.overshoot, high + self.overshoot, dtype=np.float64),
            "goals": spaces.Box(
                np.tile(np.minimum(low, 0), (max_goals, 1)),
                np.tile(np.maximum(high, 0), (max_goals, 1)),
                dtype=np.float64,
            ),
            "present": spaces.MultiBinary(max_goals),
            "target": spaces.Discrete(max_goals),
        })  # fmt: skip
        reach = self.max_displacement
        self.single_action_space = spaces.Box(-reach, reach, (self.dim,), dtype=np.float64)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)

        self._rngs = [np.random.default_rng() for _ in range(num_envs)]
        self.scenes: list[Scene] = []
        self.targets = np.zeros(num_envs, dtype=np.int64)
        self.positions, self.velocities, self.commands = np.zeros((3, num_envs, self.dim))
        self.done, self.success, self._due, self.wall_contact = np.zeros((4, num_envs), dtype=bool)
        self.steps = np.zeros(num_envs, dtype=np.int64)
        self.counts = {name: np.zeros(num_envs, dtype=np.int64) for name in self.counted}
        self._noise = np.zeros((num_envs, 1))
        self._push, self._shift, self._starts = np.zeros((3, num_envs, self.dim))
        self._travelled = np.zeros(num_envs)

    @property
    def joint_angles(self) -> Array:
        """`(B, J)` [rad], of an arm; J = 0 where there is none."""
        return np.empty((self.num_envs, 0))

    @abstractmethod
    def _draw_robot(self, rng: np.random.Generator, options: Mapping[str, Any]) -> dict[str, Any]:
        """What is hidden of a robot in an episode, drawn whatever the options fix."""

    @abstractmethod
    def _begin(self, index: int, robot: dict[str, Any]) -> None:
        """Robot `index` is, from now on, what `_draw_robot` said."""

    @abstractmethod
    def _place(self, index: int, position: Array) -> Array:
        """Robot `index` is at rest at `position (D,)` [m], or as near as it gets, where it is."""

    @abstractmethod
    def _move(
        self, command: Array, noise: Array, alive: NDArray[Any]
    ) -> tuple[Array, NDArray[Any]]:
        """One control step of the robots that are `alive (B,)`.

        Args:
            command: `(B, D)` [m], displacements within the limits.
            noise: `(B, D)` [m], an error of each displacement.
            alive: `(B,)` bool; the others stand still.

        Returns:
            Positions `(B, D)` [m] and `(B,)` bool, who would have left the workspace, noise aside.
        """

    @abstractmethod
    def _picture(self, index: int) -> NDArray[np.uint8]:
        """Environment `index` as a picture `(H, W, 3)`."""

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Start new episodes; see the class for the options.

        Raises:
            InvalidInputError: an option is unknown or out of its range.
            InvalidSceneError: a scene that does not fit this environment.
        """
        options = _mapping(options)
        mask = options.pop("reset_mask", None)
        mask = np.ones(self.num_envs, dtype=bool) if mask is None else np.asarray(mask)
        if mask.dtype != bool or mask.shape != (self.num_envs,):
            raise InvalidInputError(
                f"reset_mask must be {self.num_envs} booleans, "
                f"got {mask.dtype} of shape {mask.shape}"
            )
        if not self.scenes and not mask.all():
            raise InvalidInputError("reset_mask must choose all in the first reset")
        if isinstance(seed, int | np.integer):
            seed = [random_seed("seed", seed) + i for i in range(self.num_envs)]
        return self._reset(mask, self._each("seed", seed), options)

    def _reset(
        self, mask: NDArray[Any], seeds: Sequence[Any], options: Mapping[str, Any]
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        self._check_open()
        allowed = (*_OPTIONS, *self.robot_options)
        unknown = set(options) - set(allowed)
        if unknown:
            raise InvalidInputError(
                f"options of reset are {', '.join(allowed)}; unknown: {sorted(map(str, unknown))}"
            )
        # All episodes are drawn before any is changed, so that a bad option changes nothing.
        each = {name: self._each(name, value) for name, value in options.items()}
        drawn = {}
        for i in np.flatnonzero(mask).tolist():
            rng = (
                copy.deepcopy(self._rngs[i])
                if seeds[i] is None
                else np.random.default_rng(random_seed("seed", seeds[i]))
            )
            drawn[i] = rng, self._draw(rng, {name: values[i] for name, values in each.items()})
        scenes = dict(enumerate(self.scenes))
        for i, (rng, episode) in drawn.items():
            self._rngs[i] = rng
            scenes[i] = episode["scene"]
            for name in ("_noise", "_push", "_shift", "targets"):
                getattr(self, name)[i] = episode[name.lstrip("_")]
            self._begin(i, episode["robot"])
            self._starts[i] = episode["scene"].start
            self.positions[i] = self._place(i, self._starts[i])
        self.scenes = [scenes[i] for i in range(self.num_envs)]
        self.velocities[mask] = self.commands[mask] = 0
        self._travelled[mask] = self.steps[mask] = 0
        self.done[mask] = self.success[mask] = self.wall_contact[mask] = False
        for number in self.counts.values():
            number[mask] = 0
        self._due[mask] = (self._push[mask] != 0).any(-1) | (self._shift[mask] != 0).any(-1)
        self._goals = np.stack([self._padded(scene) for scene in self.scenes])
        self._present = np.arange(self.max_goals) < [[s.num_goals] for s in self.scenes]
        disturbed = np.zeros(self.num_envs, dtype=bool)
        return self._observation(), self._info(disturbed)

    @np.errstate(under="ignore")
    def step(
        self, actions: Array
    ) -> tuple[dict[str, Any], NDArray[Any], NDArray[Any], NDArray[Any], dict[str, Any]]:
        """Command the displacements `actions (B, D)` [m]; they are cut off at the limits.

        Raises:
            InvalidInputError: they are not finite or not of this shape.
        """
        self._check_ready()
        actions = finite_array("actions", actions)
        if actions.shape != (self.num_envs, self.dim):
            raise InvalidInputError(
                f"actions must have shape ({self.num_envs}, {self.dim}), got {actions.shape}"
            )
        alive = ~self.done
        command = np.clip(actions, -self.max_displacement, self.max_displacement)
        noise = np.zeros_like(command)
        for i in np.flatnonzero(self._noise[:, 0] * alive):
            noise[i] = self._noise[i] * self._rngs[i].standard_normal(self.dim)
        self.commands = actions.copy()
        reached, self.wall_contact = self._move(command, noise, alive)
        self.velocities = reached - self.positions
        self._travelled += np.linalg.norm(self.velocities, axis=-1)
        self.positions = reached
        disturbed = self._disturbed() & alive
        for i in np.flatnonzero(disturbed & (self._push != 0).any(-1)).tolist():
            self.positions[i] = self._place(i, np.clip(reached[i] + self._push[i], *self.workspace))
        for i in np.flatnonzero(disturbed & (self._shift != 0).any(-1)).tolist():
            self._move_target(i)
        self._due &= ~disturbed

        self.steps += alive
        slow = np.linalg.norm(self.velocities, axis=-1) <= _SLOW * self.max_displacement
        distance = self._distance()
        self.success |= alive & (distance <= _RADIUS) & slow & ~disturbed
        self.done |= self.success | (self.steps >= self.max_episode_steps)
        reward = np.where(alive, -distance, 0.0)
        success, truncated = self.success.copy(), self.done & ~self.success
        return self._observation(), reward, success, truncated, self._info(disturbed)

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:  # pyright: ignore
        """A picture `(H, W, 3)` of each environment."""
        if self.render_mode is None:
            return None
        self._check_ready()
        return tuple(self._picture(i) for i in range(self.num_envs))

    def set_target(self, index: int, target: int) -> None:
        """Mean another goal in environment `index` from now on."""
        self._check_ready()
        if count("index", index, low=0) >= self.num_envs:
            raise InvalidInputError(f"index must be at most {self.num_envs - 1}, got {index}")
        self.targets[index] = target_index(target, self.scenes[index].num_goals)

    def _each(self, name: str, value: Any) -> list[Any]:
        """A value for each environment, of one for all or a list of them."""
        if not (isinstance(value, list | tuple) or (isinstance(value, np.ndarray) and value.ndim)):
            return [value] * self.num_envs
        if len(value) != self.num_envs:
            raise InvalidInputError(
                f"{name} must be one for all or {self.num_envs}, got {len(value)}"
            )
        return list(value)

    def _draw(self, rng: np.random.Generator, options: Mapping[str, Any]) -> dict[str, Any]:
        """What an episode is made of; the robot and directions are drawn whatever it fixes."""
        robot = self._draw_robot(rng, options)
        directions = _directions(rng, self.dim)
        num_goals, scene = options.get("num_goals"), options.get("scene")
        target = options.get("target", 0)
        if num_goals is not None:
            num_goals = count("num_goals", num_goals, low=2)
            if num_goals > self.max_goals:
                raise InvalidInputError(
                    f"num_goals must be at most {self.max_goals}, got {num_goals}"
                )
        if scene is None:
            if num_goals is None:
                num_goals = int(rng.integers(2, min(6, self.max_goals) + 1))
            scene = Scene.random(rng, dim=self.dim, num_goals=num_goals, target=target)
        self._check_scene(scene)
        return {
            "scene": scene,
            "targets": target_index(target, scene.num_goals),
            "robot": robot,
            "noise": bounded("noise", options.get("noise", 0.0), 0, self.max_displacement),
            "push": bounded("push", options.get("push", 0.0), 0) * directions[0],
            "shift": bounded("shift", options.get("shift", 0.0), 0) * directions[1],
        }

    def _check_scene(self, scene: Any) -> None:
        if not isinstance(scene, Scene):
            raise InvalidSceneError(f"scene must be a legibility.Scene, got {type(scene).__name__}")
        if scene.dim != self.dim:
            raise InvalidSceneError(f"scene must be {self.dim}-D here, got {scene.dim}-D")
        if scene.num_goals > self.max_goals:
            raise InvalidSceneError(
                f"scene must have at most {self.max_goals} goals, got {scene.num_goals}"
            )
        if not np.array_equal(scene.workspace, self.workspace):
            raise InvalidSceneError(
                f"the scene's workspace must be {self.workspace.tolist()}, "
                f"got {scene.workspace.tolist()}"
            )

    def _disturbed(self) -> NDArray[Any]:
        """Where a push or a shift falls due: half the straight line's length is travelled."""
        if not self._due.any():
            return self._due.copy()
        straight = self._goals[np.arange(self.num_envs), self.targets] - self._starts
        return self._due & (self._travelled >= np.linalg.norm(straight, axis=-1) / 2)

    def _move_target(self, index: int) -> None:
        scene, target = self.scenes[index], self.targets[index]
        goals = scene.goals.copy()
        goals[target] = np.clip(goals[target] + self._shift[index], *self.workspace)
        try:
            self.scenes[index] = Scene(scene.start, goals, scene.workspace)
        except InvalidSceneError:  # another block is in just that corner: it stays
            return
        self._goals[index] = self._padded(self.scenes[index])

    def _padded(self, scene: Scene) -> Array:
        goals = np.zeros((self.max_goals, self.dim))
        goals[: scene.num_goals] = scene.goals
        return goals

    def _distance(self) -> Array:
        target = self._goals[np.arange(self.num_envs), self.targets]
        return np.linalg.norm(self.positions - target, axis=-1)

    def _observation(self) -> dict[str, Any]:
        return {
            "position": self.positions.copy(),
            "goals": self._goals.copy(),
            "present": self._present.astype(np.int8),
            "target": self.targets.copy(),
        }

    def _info(self, disturbed: NDArray[Any]) -> dict[str, Any]:
        return {
            "is_success": self.success.copy(),
            "distance": self._distance(),
            "speed": np.linalg.norm(self.velocities, axis=-1) * self.metadata["render_fps"],
            "wall_contact": self.wall_contact.copy(),
            "disturbed": disturbed,
            **{name: number.copy() for name, number in self.counts.items()},
        }

    def _check_open(self) -> None:
        if self.closed:
            raise InvalidInputError("the environment is closed; make a new one")

    def _check_ready(self) -> None:
        self._check_open()
        if not self.scenes:
            raise gymnasium.error.ResetNeeded("reset the environment before anything else")


class BlockReach(gymnasium.Env[dict[str, Any], Array]):
    """One robot: a batch of one behind Gymnasium's interface; `batch_type` says of what."""

    metadata: dict[str, Any] = {  # noqa: RUF012 (Gymnasium's own form)
        "render_modes": ["human", "rgb_array"],
        "render_fps": 20,
    }
    batch_type: ClassVar[type[BlockReachVector]]

    def __init_subclass__(cls, **settings: Any) -> None:
        super().__init_subclass__(**settings)
        rate = cls.batch_type.metadata["render_fps"]
        cls.metadata = {**BlockReach.metadata, "render_fps": rate}

    def __init__(self, *, max_goals: int = 6, render_mode: str | None = None) -> None:
        check_render_mode(render_mode, self.metadata["render_modes"])
        # The limit on steps is Gymnasium's wrapper's.
        self.batch = self.batch_type(1, max_goals=max_goals, max_episode_steps=2**31)
        self.observation_space = self.batch.single_observation_space
        self.action_space = self.batch.single_action_space
        self.render_mode = render_mode
        self._window: Any = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Start a new episode; see the class for the options."""
        seed = None if seed is None else random_seed("seed", seed)
        observation, info = self.batch._reset(np.ones(1, dtype=bool), [seed], _mapping(options))
        super().reset(seed=seed)
        if self.render_mode == "human":
            self.render()
        return _first(observation), _first(info)

    def step(self, action: Array) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """Command the displacement `action (D,)` [m]."""
        observation, reward, success, _, info = self.batch.step(
            finite_array("action", action, ndim=1, last=self.batch.dim)[None]
        )
        if self.render_mode == "human":
            self.render()
        return _first(observation), float(reward[0]), bool(success[0]), False, _first(info)

    def render(self) -> NDArray[np.uint8] | None:  # pyright: ignore
        """A picture `(H, W, 3)`, or a window that shows it."""
        if self.render_mode is None:
            return None
        self.batch._check_ready()
        image = self.batch._picture(0)
        if self.render_mode == "rgb_array":
            return image
        if self._window is None:
            from .render import Window

            self._window = Window(image, 1 / self.metadata["render_fps"])
        self._window.show(image)
        return None

    def close(self) -> None:
        """Close the window, if there is one; a closed environment refuses to go on."""
        if self._window is not None:
            self._window.close()
            self._window = None
        self.batch.close()


def check_render_mode(mode: Any, modes: Sequence[str]) -> None:
    """Raise if there is no such way to render."""
    if mode not in (None, *modes):
        raise InvalidInputError(f"render_mode must be one of {list(modes)}, got {mode!r}")


def _directions(rng: np.random.Generator, dim: int) -> Array:
    """Directions `(2, D)` of a push and of a shift."""
    if dim == 2:
        angles = rng.uniform(0, 2 * np.pi, 2)
        return np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    directions = rng.standard_normal((2, dim))
    return directions / np.linalg.norm(directions, axis=-1, keepdims=True)


def _mapping(options: Any) -> dict[str, Any]:
    if options is not None and not isinstance(options, Mapping):
        raise InvalidInputError(f"options must be a mapping, got {type(options).__name__}")
    return dict(options or {})


def _first(values: dict[str, Any]) -> dict[str, Any]:
    """The only row of a batch."""
    return {
        name: value[0] if isinstance(value[0], np.ndarray) else value[0].item()
        for name, value in values.items()
    }
