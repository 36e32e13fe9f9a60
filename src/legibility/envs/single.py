"""One robot of the block reaching task, behind Gymnasium's interface."""

from typing import Any, ClassVar

import gymnasium
import numpy as np
from numpy.typing import NDArray

from ..checks import Array, finite_array, random_seed
from ..scene import Scene
from . import check_render_mode
from .block_reach import BlockReachVector


class BlockReach(gymnasium.Env[dict[str, Any], Array]):
    """One robot: a vector of one, of type `batch_type`, behind Gymnasium's interface.

    It is an `Environment` as `Modulator.execute` needs it.

    Attributes:
        batch: the vector, which holds the state; see there for its attributes.
        max_displacement: largest displacement of an action along each axis [m].
        dt: duration of a step [s].
        lag: largest lag of the actuators.
        arm: that moves, if it is one.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 (Gymnasium's own form)
        "render_modes": ["human", "rgb_array"],
        "render_fps": 20,
    }
    batch_type: ClassVar[type[BlockReachVector]]

    def __init_subclass__(cls, **settings: Any) -> None:
        super().__init_subclass__(**settings)
        rate = cls.batch_type.metadata["render_fps"]
        cls.metadata = {**BlockReach.metadata, "render_fps": rate}

    def __init__(
        self, *, max_goals: int = 6, render_mode: str | None = None, **settings: Any
    ) -> None:
        check_render_mode(render_mode, self.metadata["render_modes"])
        # Gymnasium's wrapper limits the steps.
        self.batch = self.batch_type(
            1, max_goals=max_goals, max_episode_steps=2**31, render_mode="rgb_array", **settings
        )
        self.observation_space = self.batch.single_observation_space
        self.action_space = self.batch.single_action_space
        self.render_mode = render_mode
        self._window: Any = None
        self.max_displacement, self.dt = (
            self.batch.max_displacement,
            1 / self.metadata["render_fps"],
        )
        self.lag, self.arm = self.batch.lag_range[1], self.batch.arm

    @property
    def scene(self) -> Scene | None:
        """The present scene, with the start of the episode; None before the first reset."""
        return self.batch.scenes[0] if self.batch.scenes else None

    @property
    def target(self) -> int:
        """Index of the intended goal."""
        return int(self.batch.targets[0])

    @property
    def position(self) -> Array:
        """`(D,)` [m]."""
        return self.batch.positions[0].copy()

    @property
    def success(self) -> bool:
        """Whether the episode ended by success."""
        return bool(self.batch.success[0])

    @property
    def joint_angles(self) -> Array:
        """`(J,)` [rad], of an arm; J = 0 where there is none."""
        return self.batch.joint_angles[0]

    def set_target(self, target: int) -> None:
        """Set the intended goal; an invalid index raises."""
        self.batch.set_target(0, target)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Start a new episode; see the class for the options."""
        seed = None if seed is None else random_seed("seed", seed)
        observation, info = self.batch.reset(seed=seed, options=options)
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
        """A picture `(H, W, 3)`; in the mode `human` a window shows it instead."""
        if self.render_mode is None:
            return None
        pictures = self.batch.render()
        assert pictures
        (image,) = pictures
        if self.render_mode == "rgb_array":
            return image
        if self._window is None:
            from .render import Window

            self._window = Window(image, 1 / self.metadata["render_fps"])
        self._window.show(image)
        return None

    def close(self) -> None:
        """Close the window, if there is one; a closed environment cannot be used again."""
        if self._window is not None:
            self._window.close()
            self._window = None
        self.batch.close()


def _first(values: dict[str, Any]) -> dict[str, Any]:
    """The only row of a batch."""
    return {
        name: value[0] if isinstance(value[0], np.ndarray) else value[0].item()
        for name, value in values.items()
    }
