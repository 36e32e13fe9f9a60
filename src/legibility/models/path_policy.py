"""Stage 2, the path-guided diffusion policy: two states, goal and path to actions (paper, V.C)."""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from ..checks import Array, count, positive
from ..errors import CheckpointError, InvalidInputError
from ..motion.tracking import PathTracker
from .diffusion import ddim
from .frame import axes_along
from .networks import FiLMUNet, Residual, fourier

__all__ = ["Observation", "PathPolicy", "PathPolicyConfig"]

_AHEAD = (0.0, 0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 4.0)
"""Arc lengths ahead, in limits, at which the policy sees the path: as far as a chunk gets."""

_REACH = 4.0
"""Beyond this many limits distances are compressed."""

_TIME_FREQUENCIES = 8


@dataclass(frozen=True)
class PathPolicyConfig:
    """The shape of stage 2.

    Attributes:
        dim: D, 2 or 3.
        limit: largest displacement of an action along each axis [m]; all lengths are seen in it.
        chunk: actions predicted at once; even.
        execute: how many of them are executed before the next are predicted.
        channels: of the U-Net's levels.
        condition: size of the condition.
        diffusion_steps: of the noise schedule in training.
        sampling_steps: of the deterministic sampler.
    """

    dim: int = 2
    limit: float = 0.05
    chunk: int = 8
    execute: int = 4
    channels: tuple[int, ...] = (32, 64)
    condition: int = 128
    diffusion_steps: int = 100
    sampling_steps: int = 2

    def __post_init__(self) -> None:
        if self.dim not in (2, 3):
            raise InvalidInputError(f"dim must be 2 or 3, got {self.dim!r}")
        positive("limit", self.limit)
        if not self.channels or count("chunk", self.chunk) % 2 ** (len(self.channels) - 1):
            raise InvalidInputError(
                f"chunk must be a multiple of {2 ** max(0, len(self.channels) - 1)}, "
                f"got {self.chunk} with channels {self.channels}"
            )
        for width in self.channels:
            if count("channels", width) % 8:
                raise InvalidInputError(f"channels must be multiples of 8, got {width}")
        if count("execute", self.execute) > self.chunk:
            raise InvalidInputError(f"execute must be at most {self.chunk}, got {self.execute}")
        count("condition", self.condition)
        count("diffusion_steps", self.diffusion_steps)
        if count("sampling_steps", self.sampling_steps) > self.diffusion_steps:
            raise InvalidInputError(
                f"sampling_steps must be at most {self.diffusion_steps}, got {self.sampling_steps}"
            )

    def to_dict(self) -> dict[str, Any]:
        """Plain values for `config.json`."""
        return {**asdict(self), "channels": list(self.channels)}

    @classmethod
    def from_dict(cls, content: dict[str, Any]) -> PathPolicyConfig:
        """The inverse of `to_dict`; every key must be there and none else."""
        names = {f.name for f in fields(cls)}
        if set(content) != names:
            raise CheckpointError(
                f"a path policy's settings are {sorted(names)}; "
                f"missing or unknown: {sorted(names ^ set(content))}"
            )
        return cls(**{**content, "channels": tuple(content["channels"])})


@dataclass(frozen=True, eq=False)
class Observation:
    """What the policy sees of `B` robots, each in a frame of its own.

    The origin is the robot; the first axis is the path's direction there, or where there is no path
    the goal's. Lengths are in limits. The place on the path is tracked, so however often a path
    meets itself the robot sees the stretch that it is on, about as far ahead as a chunk can get.

    Attributes:
        features: `(B, F)` float32: last displacement (with the position, the two past states), the
            stretch of the path ahead, the goal, and the length of path that is left.
        rotation: `(B, D, D)`, rows are the frame's axes in the world.
        has_path: `(B,)` bool.
    """

    features: np.ndarray
    rotation: Array
    has_path: np.ndarray

    @classmethod
    def of(
        cls,
        positions: Array,
        previous: Array,
        goals: Array,
        limit: float,
        tracker: PathTracker | None = None,
    ) -> Observation:
        """Of robots at `positions (B, D)` [m] that were at `previous (B, D)` [m] one step before.

        Args:
            positions: `(B, D)` [m].
            previous: `(B, D)` [m].
            goals: `(B, D)` [m], the targets.
            limit: largest displacement of an action [m].
            tracker: where they are on their paths; without one they are to reach the goal anyhow.
        """
        size, dim = positions.shape
        to_goal = goals - positions
        if tracker is None:
            ahead = np.zeros((size, len(_AHEAD), dim))
            left = np.zeros((size, 1))
            heading = to_goal
        else:
            ahead = tracker.ahead(np.array(_AHEAD) * limit)
            left = np.tanh(tracker.remaining[:, None] / (_REACH * limit))
            heading = np.where(
                tracker.remaining[:, None] > 0.1 * limit, ahead[:, 4] - ahead[:, 0], to_goal
            )
            ahead = ahead - positions[:, None]
        rotation = axes_along(heading)

        def seen(vectors: Array) -> Array:
            return np.einsum("bij,b...j->b...i", rotation, vectors) / limit

        features = [
            seen(positions - previous),
            _compressed(seen(ahead)).reshape(size, -1),
            _compressed(seen(to_goal)),
            left,
        ]
        return cls(
            np.concatenate(features, axis=-1).astype(np.float32),
            rotation,
            np.full(size, tracker is not None),
        )


def _compressed(vectors: Array) -> Array:
    """Vectors `(..., D)` whose length grows like the logarithm beyond `_REACH`, over `_REACH`."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True) / _REACH
    return vectors / _REACH * np.arcsinh(length) / np.maximum(length, 1e-9)


class PathPolicy(nn.Module):
    """Denoises a chunk of actions in the robot's frame, in limits."""

    def __init__(self, config: PathPolicyConfig) -> None:
        super().__init__()
        self.config = config
        size = config.condition
        inputs = config.dim * (len(_AHEAD) + 2) + 1
        self.observe = nn.Linear(inputs, size)
        self.no_path = nn.Parameter(torch.zeros(size))
        self.fuse = nn.Sequential(Residual(size), Residual(size))
        self.time = nn.Sequential(
            nn.Linear(2 * _TIME_FREQUENCIES + 1, size), nn.SiLU(), nn.Linear(size, size)
        )
        self.unet = FiLMUNet(config.dim, config.dim, config.channels, size)
        self.scale: Tensor  # of the actions over the data, set by training
        self.register_buffer("scale", torch.ones(()))
        self.signal: Tensor  # ᾱ at each diffusion step, set by training
        self.register_buffer("signal", torch.ones(config.diffusion_steps))

    def encode(self, features: Tensor, has_path: Tensor) -> Tensor:
        """`(B, E)` of an observation's `features (B, F)` and `has_path (B,)`."""
        observed = self.observe(features)
        return self.fuse(observed + torch.where(has_path[:, None], 0.0, self.no_path))

    def forward(self, noisy: Tensor, timestep: Tensor, context: Tensor) -> Tensor:
        """The velocity v (Salimans & Ho 2022), `(B, chunk, D)`.

        Args:
            noisy: `(B, chunk, D)`, noisy actions over `scale`.
            timestep: `(B,)` int, of the noise schedule.
            context: `(B, E)` from `encode`.
        """
        time = timestep.to(noisy.dtype) / self.config.diffusion_steps * 2 - 1
        condition = context + self.time(fourier(time, _TIME_FREQUENCIES))
        return self.unet(noisy, nn.functional.silu(condition))

    @torch.inference_mode()
    def act(self, observation: Observation, noise: Tensor, steps: int | None = None) -> Array:
        """A chunk of displacements `(B, chunk, D)` [m] in the world, not yet made safe.

        Args:
            observation: of `B` robots.
            noise: `(B, chunk, D)` standard normal; the same noise gives the same actions.
            steps: of the sampler; the configuration's if not given.
        """
        context = self.encode(
            torch.from_numpy(observation.features), torch.from_numpy(observation.has_path)
        )
        actions = ddim(
            lambda noisy, timestep: self(noisy, timestep, context),
            noise, self.signal, steps or self.config.sampling_steps,
        )  # fmt: skip
        actions = (actions * self.scale).double().numpy() * self.config.limit
        return actions @ observation.rotation
