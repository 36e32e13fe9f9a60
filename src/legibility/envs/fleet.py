"""One interface to one environment or a vector of them."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from ..checks import Array
from ..errors import InvalidInputError, LegibilityError
from ..scene import Scene
from .block_reach import BlockReachVector
from .guard import safe_actions

if TYPE_CHECKING:
    from ..robots.arm import Arm

_ADVICE = "make it with gymnasium.make_vec(…, vectorization_mode='vector_entry_point')"


def is_vector(env: Any) -> bool:
    """Whether `env` holds several robots."""
    return isinstance(env, gymnasium.vector.VectorEnv)


def fleet_of(env: Any, seed: int) -> "Fleet":
    """The robots of an environment of this package, in any wrappers, or the one of your own.

    Args:
        env: see `Fleet` and `OwnFleet`.
        seed: of the reset of an environment that was never reset.

    Raises:
        InvalidInputError: it is neither, or is not ready for a motion.
    """
    single = getattr(getattr(env, "unwrapped", None), "batch", None)
    if is_vector(env) or isinstance(single, BlockReachVector):
        return Fleet(env, seed)
    from .own import OwnFleet

    return OwnFleet(env, seed)


def _gathered(name: str, doc: str) -> Any:
    return property(lambda fleet: fleet._gather(name), doc=doc)


class Fleet:
    """The `B` robots of an environment, whichever wrappers it stands in.

    Actions go through the wrappers; everything else is read from the environments themselves, so
    wrappers of observations, rewards and infos change nothing. A wrapper that alters, delays or
    repeats an action is refused as soon as it does.

    Args:
        env: an environment of this package, a vector of ours, or a `SyncVectorEnv` of ours.
        seed: of the reset of an environment that was never reset.

    Attributes:
        size: B.
        limit: largest displacement of an action along each axis [m].
        lag: largest lag of the actuators.
        workspace: `(2, D)` [m].
        step_seconds: duration of a control step [s].

    Raises:
        InvalidInputError: another environment, different ones in one vector, a mode of autoreset
            that loses the last state, or an episode that has already ended.
    """

    def __init__(self, env: Any, seed: int) -> None:
        self._env = env
        self._parts = _batches(env)
        first = self._parts[0]
        if len({type(part) for part in self._parts}) > 1:
            raise InvalidInputError(f"env must be a vector of one environment, got {env}")
        self.limit, self.lag = first.max_displacement, first.lag_range[1]
        self.workspace = first.workspace
        self.step_seconds = 1 / first.metadata["render_fps"]
        if any(not part.scenes for part in self._parts):
            self._through_wrappers(env.reset, seed=seed)
        if self._gather("done").any() or (self._gather("steps") >= _time_limits(env)).any():
            raise InvalidInputError("an episode has ended: reset the environment before executing")
        self.size = len(self.scenes)

    @property
    def _places(self) -> list[tuple[BlockReachVector, int]]:
        """Where each robot is."""
        return [(part, i) for part in self._parts for i in range(part.num_envs)]

    def _gather(self, name: str) -> Any:
        return np.concatenate([getattr(part, name) for part in self._parts])

    @property
    def scenes(self) -> list[Scene]:
        """The current scene of each robot."""
        return [scene for part in self._parts for scene in part.scenes]

    @property
    def arms(self) -> "list[Arm | None]":
        """What each robot is; None for a point."""
        return [part.arm for part, _ in self._places]

    targets = _gathered("targets", "`(B,)`, index of the intended goal.")
    positions = _gathered("positions", "`(B, D)` [m].")
    joint_angles = _gathered("joint_angles", "`(B, J)` [rad]; J = 0 for a point in 2-D.")
    wall_contacts = _gathered("wall_contact", "`(B,)`, whether a wall stopped the last step.")
    contacts = _gathered("contact", "`(B,)`, whether the last step touched an obstacle or a block.")

    @property
    def goals(self) -> Array:
        """`(B, D)` [m], the intended goals."""
        return np.stack([s.goals[t] for s, t in zip(self.scenes, self.targets, strict=True)])

    @property
    def counts(self) -> dict[str, NDArray[np.int64]]:
        """Events of this episode by name, `(B,)` each."""
        names = self._parts[0].counts
        return {n: np.concatenate([part.counts[n] for part in self._parts]) for n in names}

    def set_targets(self, targets: Sequence[Any]) -> None:
        """Set the intended goals `(B,)`; an invalid index raises and changes nothing."""
        indices = [
            scene.check_target(target) for scene, target in zip(self.scenes, targets, strict=True)
        ]
        for (part, i), index in zip(self._places, indices, strict=True):
            part.set_target(i, index)

    def safe(self, actions: Array, positions: Array, velocities: Array) -> Array:
        """`safe_actions` for all robots, `(B, D)` [m]."""
        safe, first = np.empty_like(actions), 0
        for part in self._parts:
            rows = slice(first, first := first + part.num_envs)
            safe[rows] = safe_actions(
                actions[rows], positions[rows], velocities[rows], self.workspace, self.limit,
                self.lag, part.barriers, part.planes,
            )  # fmt: skip
        return safe

    def step(
        self, actions: Array, active: NDArray[np.bool_]
    ) -> tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]:
        """Send `actions (B, D)` [m] to the robots that are `active (B,)`.

        Return whether each has succeeded, and whether its episode was terminated and truncated,
        `(B,)` each.

        Raises:
            InvalidInputError: an active robot did not receive its action.
        """
        before, sent = self._gather("steps"), actions.copy()  # a wrapper may write into it
        step = self._through_wrappers(self._env.step, sent if is_vector(self._env) else sent[0])
        steps, received = self._gather("steps"), self._gather("commands")
        if not (
            (steps == before + 1)[active].all()
            and np.allclose(received[active], actions[active], rtol=0, atol=1e-9)
        ):
            raise InvalidInputError(
                "env did not execute the action that was sent; reset it, and remove wrappers that "
                f"change, delay or repeat actions: {_names(self._env)}"
            )
        terminated, truncated = (np.atleast_1d(np.asarray(ends)) for ends in step[2:4])
        return self._gather("success"), terminated, truncated

    def _through_wrappers(self, method: Callable[..., Any], *args: Any, **options: Any) -> Any:
        """The result of a method of the environment; an error of its wrappers names them."""
        try:
            return method(*args, **options)
        except LegibilityError:
            raise
        except Exception as cause:
            problem = (
                f"env fails in {method.__name__}: {cause!r}; its wrappers: {_names(self._env)}"
            )
            raise InvalidInputError(problem) from cause


def _batches(env: Any) -> list[BlockReachVector]:
    """The environments of ours behind `env`."""
    inner: Any = getattr(env, "unwrapped", None)
    if isinstance(inner, BlockReachVector):
        return [inner]
    if isinstance(getattr(inner, "batch", None), BlockReachVector):
        return [inner.batch]
    singles = [getattr(e.unwrapped, "batch", None) for e in getattr(inner, "envs", ())]
    if not singles or not all(isinstance(single, BlockReachVector) for single in singles):
        raise InvalidInputError(
            "env must be an environment of legibility, a vector of them or a SyncVectorEnv of "
            f"them, got {env}; {_ADVICE}; your own environments move one at a time"
        )
    mode = inner.metadata.get("autoreset_mode")
    if mode is not AutoresetMode.NEXT_STEP:
        raise InvalidInputError(
            f"a SyncVectorEnv must reset in AutoresetMode.NEXT_STEP, got {mode}: the last state of "
            f"a motion would be lost, or no robot could go on alone; {_ADVICE}"
        )
    return [single for single in singles if single is not None]


def _names(env: Any) -> str:
    """`env` with its wrappers, and the first environment of a vector with its own."""
    return ", ".join(map(str, [env, *getattr(getattr(env, "unwrapped", env), "envs", ())[:1]]))


def _time_limits(env: Any) -> Array:
    """Control steps of an episode, `(B,)` or one for all, by the wrappers of Gymnasium."""
    if isinstance(env.unwrapped, BlockReachVector):
        return np.array(np.inf)  # which ends its episodes itself
    specs = [single.spec for single in getattr(env.unwrapped, "envs", [env])]
    return np.array([(spec and spec.max_episode_steps) or np.inf for spec in specs])
