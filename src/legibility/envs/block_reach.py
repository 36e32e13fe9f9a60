"""The block reaching task for any robot: scenes, targets, success and disturbances, in metres."""

import copy
import dataclasses
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, NamedTuple

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from ..checks import Array, bounded, count, finite_array, for_each, random_seed
from ..errors import InvalidInputError, InvalidSceneError
from ..scene import DEFAULT_WORKSPACE, Scene
from . import MAX_EPISODE_STEPS, check_render_mode
from .guard import Barriers, Planes

_OPTIONS = ("scene", "target", "num_goals", "noise", "push", "shift")
_RADIUS = 0.02
_SLOW = 0.2


class _Episode(NamedTuple):
    scene: Scene
    target: int
    hidden: dict[str, float]
    noise: float
    push: Array
    shift: Array


class BlockReachVector(VectorEnv[dict[str, Any], Array, NDArray[Any]]):
    """Many robots, each among its own blocks, stepped together.

    Environment i of a reset with seed s equals the single environment reset with seed s + i. An
    environment whose episode has ended stands still until it is reset (`AutoresetMode.DISABLED`);
    the option `reset_mask (B,)` bool of `reset` selects which are reset. Seed and options are one
    value for all, or a list with one for each.

    A subclass moves the robots: `_place`, `_move` and `_picture`.

    Attributes:
        num_envs: B.
        max_goals: most goals of a scene.
        max_episode_steps: control steps after which an episode is truncated.
        workspace: `(2, D)` [m], low and high corner.
        scenes: the current scenes; their start is where the episode started.
        targets: `(B,)`, index of the intended goal; set by `set_target`.
        positions: `(B, D)` [m].
        velocities: `(B, D)` [m], displacements of the last step without its push.
        joint_angles: `(B, J)` [rad], of an arm; J = 0 where there is none.
        commands: `(B, D)` [m], actions of the last step as received.
        steps: `(B,)`, control steps of the episode.
        done: `(B,)` bool, whether the episode ended by success or by the limit on steps.
        success: `(B,)` bool, whether it ended by success.
        wall_contact: `(B,)` bool, whether a wall stopped the robot in the last step.
        contact: `(B,)` bool, whether the last step led, unhindered, into an obstacle or within the
            scene's `goal_radius` of a block that is not the target.
        counts: events of the episode by name, `(B,)` each.
        hidden: properties of the robots that no observation shows, by name, `(B,)` each.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 (Gymnasium's own form)
        "render_modes": ["rgb_array"],
        "render_fps": 20,
        "autoreset_mode": AutoresetMode.DISABLED,
    }
    dim: ClassVar[int]
    max_displacement: ClassVar[float]
    """Largest commanded displacement of a step along each axis [m]."""
    block_radius: ClassVar[float]
    """`goal_radius` of the scenes that are drawn: from a block's centre to its corners [m]."""
    lag_range: ClassVar[tuple[float, float]] = (0.0, 0.3)
    """Least and largest share of its last displacement by which a stopped robot moves on."""
    at_once: ClassVar[int] = 256
    """Most environments that one process should hold."""
    drawn: ClassVar[dict[str, tuple[float, float]]] = {}
    """Ranges from which the hidden properties are drawn; each is also an option of `reset`."""
    allowed: ClassVar[dict[str, tuple[float, float]]] = {}
    """Ranges of these options where they are wider."""
    counted: ClassVar[tuple[str, ...]] = ()
    """Names of `counts`."""
    arm: Any = None
    """The arm that moves, if it is one."""
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

        self.scenes: list[Scene] = []
        self.positions, self.velocities, self.commands = np.zeros((3, num_envs, self.dim))
        self.targets, self.steps = np.zeros((2, num_envs), dtype=np.int64)
        self._barriers: tuple[list[Any], Barriers | None] = [], None
        self.done, self.success, self._due = np.zeros((3, num_envs), dtype=bool)
        self.wall_contact, self.contact = np.zeros((2, num_envs), dtype=bool)
        self.counts = {name: np.zeros(num_envs, dtype=np.int64) for name in self.counted}
        self.hidden = {name: np.ones(num_envs) for name in self.drawn}
        self._rngs = [np.random.default_rng() for _ in range(num_envs)]
        self._noise, self._travelled = np.zeros((2, num_envs))
        self._push, self._shift = np.zeros((2, num_envs, self.dim))

    @property
    def joint_angles(self) -> Array:
        """`(B, J)` [rad], of an arm; J = 0 where there is none."""
        return np.empty((self.num_envs, 0))

    @property
    def barriers(self) -> Barriers | None:
        """All that `contact` counts, for `safe_actions`; None if there is nothing."""
        key = [*self.scenes, *self.targets.tolist()]
        if key != self._barriers[0]:
            self._barriers = key, Barriers.of(self.scenes, self.targets.tolist())
        return self._barriers[1]

    @property
    def planes(self) -> Planes | None:
        """Planes between the arms and the obstacles near them; None if there are none."""
        return None

    @abstractmethod
    def _place(self, index: int, position: Array) -> Array:
        """Place robot `index` at rest at or near `position (D,)` [m]; return the position reached.

        Its state does not depend on what it did before.
        """

    @abstractmethod
    def _move(self, command: Array, noise: Array, alive: NDArray) -> tuple[Array, NDArray]:
        """Move the robots that are `alive (B,)` by `command` and its error `noise (B, D)` [m].

        Return positions `(B, D)` [m], and whether each robot would have left the workspace without
        noise, `(B,)` bool.
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
        """Start new episodes; the single environment's docstring lists the options.

        Raises:
            InvalidInputError: an option is unknown or out of its range.
            InvalidSceneError: a scene that does not fit this environment.
        """
        self._check_open()
        if options is not None and not isinstance(options, Mapping):
            raise InvalidInputError(f"options must be a mapping, got {type(options).__name__}")
        options = dict(options or {})
        mask = self._mask(options.pop("reset_mask", None))
        allowed = (*_OPTIONS, *self.drawn)
        if unknown := set(options) - set(allowed):
            raise InvalidInputError(
                f"options of reset are {', '.join(allowed)}; unknown: {sorted(map(str, unknown))}"
            )
        if isinstance(seed, int | np.integer):
            seed = [random_seed("seed", seed) + i for i in range(self.num_envs)]
        seeds = for_each("seed", seed, self.num_envs)
        values = {name: for_each(name, value, self.num_envs) for name, value in options.items()}
        # All episodes are drawn before any is changed, so that a bad option changes nothing.
        episodes: dict[int, tuple[np.random.Generator, _Episode]] = {}
        for i in np.flatnonzero(mask).tolist():
            rng = copy.deepcopy(self._rngs[i])
            if seeds[i] is not None:
                rng = np.random.default_rng(random_seed("seed", seeds[i]))
            episodes[i] = rng, self._draw(rng, {name: value[i] for name, value in values.items()})

        scenes: list[Any] = self.scenes or [None] * self.num_envs
        self.scenes = [episodes[i][1].scene if i in episodes else s for i, s in enumerate(scenes)]
        events = self.wall_contact, self.contact, self.done, self.success, *self.counts.values()
        for state in (self.velocities, self.commands, self.steps, self._travelled, *events):
            state[mask] = 0
        for i, (rng, episode) in episodes.items():
            self._rngs[i], self.targets[i] = rng, episode.target
            self._noise[i], self._push[i], self._shift[i] = episode[-3:]
            self._due[i] = episode.push.any() or episode.shift.any()
            for name, value in episode.hidden.items():
                self.hidden[name][i] = value
            self.positions[i] = self._place(i, episode.scene.start)
        self._goals = np.zeros((self.num_envs, self.max_goals, self.dim))
        for goals, scene in zip(self._goals, self.scenes, strict=True):
            goals[: scene.num_goals] = scene.goals
        self._present = np.arange(self.max_goals) < [[s.num_goals] for s in self.scenes]
        return self._observation(), self._info(np.zeros(self.num_envs, dtype=bool))

    def _mask(self, value: Any) -> NDArray[np.bool_]:
        num = self.num_envs
        mask = np.ones(num, dtype=bool) if value is None else np.asarray(value)
        if mask.dtype != bool or mask.shape != (num,):
            raise InvalidInputError(
                f"reset_mask must be {num} booleans, got {mask.dtype} of shape {mask.shape}"
            )
        if not self.scenes and not mask.all():
            raise InvalidInputError("reset_mask must select all in the first reset")
        return mask

    def _draw(self, rng: np.random.Generator, options: Mapping[str, Any]) -> _Episode:
        """Draw an episode; every option fixes one part and leaves the draws of the others alone."""
        # Two draws for every robot, so that a seed gives one scene in either simulator.
        hidden = {
            name: bounded(
                name, options.get(name, low + (high - low) * share),
                *self.allowed.get(name, (low, high)),
            )
            for (name, (low, high)), share in zip(self.drawn.items(), rng.random(2), strict=False)
        }  # fmt: skip
        push, shift = _directions(rng, self.dim)
        num_goals, scene = options.get("num_goals"), options.get("scene")
        target = options.get("target", 0)
        if num_goals is not None and count("num_goals", num_goals, low=2) > self.max_goals:
            raise InvalidInputError(f"num_goals must be at most {self.max_goals}, got {num_goals}")
        if scene is None:
            if num_goals is None:
                num_goals = int(rng.integers(2, min(6, self.max_goals) + 1))
            scene = Scene.random(rng, dim=self.dim, num_goals=num_goals, target=target)
            scene = dataclasses.replace(scene, goal_radius=self.block_radius)
        self._check_scene(scene)
        return _Episode(
            scene,
            scene.check_target(target),
            hidden,
            bounded("noise", options.get("noise", 0.0), 0, self.max_displacement),
            bounded("push", options.get("push", 0.0), 0) * push,
            bounded("shift", options.get("shift", 0.0), 0) * shift,
        )

    def _check_scene(self, scene: Any) -> None:
        if not isinstance(scene, Scene):
            raise InvalidSceneError(f"scene must be a legibility.Scene, got {type(scene).__name__}")
        if scene.dim != self.dim or scene.num_goals > self.max_goals:
            raise InvalidSceneError(
                f"scene must be {self.dim}-D with at most {self.max_goals} goals here, "
                f"got {scene.dim}-D with {scene.num_goals}"
            )
        if not np.array_equal(scene.workspace, self.workspace):
            raise InvalidSceneError(
                f"the scene's workspace must be {self.workspace.tolist()}, "
                f"got {scene.workspace.tolist()}"
            )

    @np.errstate(under="ignore")
    def step(
        self, actions: Array
    ) -> tuple[dict[str, Any], NDArray[Any], NDArray[Any], NDArray[Any], dict[str, Any]]:
        """Command the displacements `actions (B, D)` [m]; they are clipped to the limits.

        Raises:
            InvalidInputError: they are not finite or have another shape.
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
        for i in np.flatnonzero(self._noise * alive):
            noise[i] = self._noise[i] * self._rngs[i].standard_normal(self.dim)
        self.commands = actions.copy()
        reached, self.wall_contact = self._move(command, noise, alive)
        self.velocities = reached - self.positions
        if (barriers := self.barriers) is not None:
            self.contact = alive & barriers.touched(self.positions, self.velocities)
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
        return tuple(map(self._picture, range(self.num_envs)))

    def set_target(self, index: int, target: int) -> None:
        """Set the intended goal of environment `index`; an invalid goal raises."""
        self._check_ready()
        if count("index", index, low=0) >= self.num_envs:
            raise InvalidInputError(f"index must be at most {self.num_envs - 1}, got {index}")
        self.targets[index] = self.scenes[index].check_target(target)

    def _disturbed(self) -> NDArray[Any]:
        """Where a push or a shift is due: half the straight line's length is travelled."""
        if not self._due.any():
            return self._due.copy()
        starts = np.stack([scene.start for scene in self.scenes])
        straight = np.linalg.norm(self._intended() - starts, axis=-1)
        return self._due & (self._travelled >= straight / 2)

    def _move_target(self, index: int) -> None:
        scene, target = self.scenes[index], self.targets[index]
        goals = scene.goals.copy()
        goals[target] = np.clip(goals[target] + self._shift[index], *self.workspace)
        try:
            moved = dataclasses.replace(scene, goals=goals)
            moved.check_target(target)
        except InvalidSceneError:  # something is in the new place: the target stays
            return
        self.scenes[index] = moved
        self._goals[index, : len(goals)] = moved.goals

    def _intended(self) -> Array:
        return self._goals[np.arange(self.num_envs), self.targets]

    def _distance(self) -> Array:
        return np.linalg.norm(self.positions - self._intended(), axis=-1)

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
            **{name: getattr(self, name).copy() for name in ("wall_contact", "contact")},
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


def _directions(rng: np.random.Generator, dim: int) -> Array:
    """Directions `(2, D)` of a push and of a shift."""
    if dim == 2:
        angles = rng.uniform(0, 2 * np.pi, 2)
        return np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    directions = rng.standard_normal((2, dim))
    return directions / np.linalg.norm(directions, axis=-1, keepdims=True)
