"""One interface to one environment, to a vector of ours, and to Gymnasium's `SyncVectorEnv`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from ..checks import Array, target_index
from ..errors import InvalidInputError
from ..scene import Scene
from .block_reach import BlockReachVector

__all__ = ["Fleet", "is_vector"]

_ADVICE = "make it with gymnasium.make_vec(…, vectorization_mode='vector_entry_point')"


def is_vector(env: Any) -> bool:
    """Whether `env` holds several robots."""
    return isinstance(env, gymnasium.vector.VectorEnv)


class Fleet:
    """The `B` robots of an environment, whichever wrappers it stands in.

    Actions go through the wrappers; everything else is read from the environments themselves, so
    wrappers of observations, rewards and infos change nothing. A wrapper that alters actions is
    refused as soon as it does.

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
        InvalidInputError: another environment, a mode of autoreset that loses the last state, or an
            episode that has already ended.
    """

    def __init__(self, env: Any, seed: int) -> None:
        self._env = env
        self._parts = _batches(env)
        first = self._parts[0]
        self.limit, self.lag = first.max_displacement, first.lag_range[1]
        self.workspace = first.workspace
        self.step_seconds = 1 / first.metadata["render_fps"]
        if any(not part.scenes for part in self._parts):
            env.reset(seed=seed)
        if self._gather("done").any():
            raise InvalidInputError("an episode has ended: reset the environment before executing")
        self.size = len(self.scenes)

    def _gather(self, name: str) -> Any:
        return np.concatenate([getattr(part, name) for part in self._parts])

    @property
    def scenes(self) -> list[Scene]:
        """The current scene of each robot."""
        return [scene for part in self._parts for scene in part.scenes]

    @property
    def targets(self) -> NDArray[np.int64]:
        """`(B,)`, index of the intended goal."""
        return self._gather("targets")

    @property
    def goals(self) -> Array:
        """`(B, D)` [m], the intended goals."""
        return np.stack([s.goals[t] for s, t in zip(self.scenes, self.targets, strict=True)])

    @property
    def positions(self) -> Array:
        """`(B, D)` [m]."""
        return self._gather("positions")

    @property
    def joint_angles(self) -> Array:
        """`(B, J)` [rad]; J = 0 for a point in the plane."""
        return self._gather("joint_angles")

    @property
    def wall_contacts(self) -> NDArray[np.bool_]:
        """`(B,)`, whether a wall stopped the robot in the last step."""
        return self._gather("wall_contact")

    @property
    def counts(self) -> dict[str, NDArray[np.int64]]:
        """Events of this episode by name, `(B,)` each."""
        names = self._parts[0].counts
        return {n: np.concatenate([part.counts[n] for part in self._parts]) for n in names}

    def set_targets(self, targets: Sequence[Any]) -> None:
        """Set the intended goals `(B,)`; an invalid index raises and changes nothing."""
        indices = [
            target_index(target, scene.num_goals)
            for scene, target in zip(self.scenes, targets, strict=True)
        ]
        places = [(part, i) for part in self._parts for i in range(part.num_envs)]
        for (part, i), index in zip(places, indices, strict=True):
            part.set_target(i, index)

    def step(
        self, actions: Array, active: NDArray[np.bool_]
    ) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Send `actions (B, D)` [m].

        Args:
            actions: displacements.
            active: `(B,)`, the robots whose episode goes on.

        Returns:
            Whether each has succeeded and whether its episode has ended, `(B,)` each.

        Raises:
            InvalidInputError: an active robot did not receive its action.
        """
        before = self._gather("steps")
        vector = is_vector(self._env)
        _, _, terminated, truncated, _ = self._env.step(actions if vector else actions[0])
        steps, received = self._gather("steps"), self._gather("commands")
        if not (
            (steps == before + 1)[active].all()
            and np.allclose(received[active], actions[active], rtol=0, atol=1e-9)
        ):
            raise InvalidInputError(
                "env did not execute the action that was sent; reset it, and remove wrappers that "
                f"change or repeat actions: {', '.join(_wrappers(self._env)) or 'none'}"
            )
        success = np.atleast_1d(np.asarray(terminated))
        return success, success | np.atleast_1d(np.asarray(truncated))


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
            f"them, got {env}; {_ADVICE}"
        )
    mode = inner.metadata.get("autoreset_mode")
    if mode is not AutoresetMode.NEXT_STEP:
        raise InvalidInputError(
            f"a SyncVectorEnv must reset in AutoresetMode.NEXT_STEP, got {mode}: the last state of "
            f"a motion would be lost, or no robot could go on alone; {_ADVICE}"
        )
    return [single for single in singles if single is not None]


def _wrappers(env: Any) -> list[str]:
    """Names of the wrappers around `env` and, in a vector, around its first environment."""
    names: list[str] = []
    while hasattr(env, "env"):
        names.append(type(env).__name__)
        env = env.env
    return names + (_wrappers(env.envs[0]) if getattr(env, "envs", None) else [])
