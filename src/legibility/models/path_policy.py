"""Stage 2, the path-guided diffusion policy: two states, goal and path to actions (paper, V.C).

`ActionDenoiser` is shared with the baselines' policy.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn

from ..checks import Array
from ..frame import axes_along
from ..motion.tracking import PathTracker
from .configuration import ActionConfig, PathPolicyConfig
from .diffusion import ddim, sampling_timesteps
from .networks import FiLMUNet, Residual, fourier

_AHEAD = (0.0, 0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 4.0)
"""Arc lengths ahead, in limits, at which the policy sees the path: as far as a chunk gets."""

_TIME_FREQUENCIES = 8

_REACH = 4.0
"""Beyond this many limits distances are compressed."""


@dataclass(frozen=True, eq=False)
class Observation:
    """The policy's inputs of `B` robots, each in a frame at the robot.

    The first axis is the path's direction there, or without a path the goal's. Lengths are in
    limits. The place on the path is tracked: however often a path meets itself, the robot sees the
    stretch that it is on, about as far ahead as a chunk can get.

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
        """The inputs of `B` robots.

        Args:
            positions: `(B, D)` [m].
            previous: `(B, D)` [m], one step before.
            goals: `(B, D)` [m], the targets.
            limit: largest displacement of an action [m].
            tracker: their places on their paths; without it they see only the goal.
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
            compressed(seen(ahead)).reshape(size, -1),
            compressed(seen(to_goal)),
            left,
        ]
        return cls(
            np.concatenate(features, axis=-1).astype(np.float32),
            rotation,
            np.full(size, tracker is not None),
        )


def compressed(vectors: Array) -> Array:
    """Vectors `(..., D)` whose length grows like the logarithm beyond `_REACH`, over `_REACH`."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True) / _REACH
    return vectors / _REACH * np.arcsinh(length) / np.maximum(length, 1e-9)


class ActionDenoiser(nn.Module):
    """A U-Net over a chunk of actions, in limits and over `scale`, that a context modulates.

    Args:
        config: its shape.
        inputs: F, features of an observation.
    """

    def __init__(self, config: ActionConfig, inputs: int) -> None:
        super().__init__()
        size = config.condition
        self.steps = config.diffusion_steps
        self.observe = nn.Linear(inputs, size)
        self.fuse = nn.Sequential(Residual(size), Residual(size))
        self.time = nn.Sequential(
            nn.Linear(2 * _TIME_FREQUENCIES + 1, size), nn.SiLU(), nn.Linear(size, size)
        )
        self.unet = FiLMUNet(config.dim, config.dim, config.channels, size)
        self.scale: Tensor  # of the actions over the data, set by training
        self.register_buffer("scale", torch.ones(()))
        self.signal: Tensor  # ᾱ at each diffusion step, set by training
        self.register_buffer("signal", torch.ones(config.diffusion_steps))

    def _encode(self, features: Tensor, guided: Tensor, nothing: Tensor) -> Tensor:
        """`(B, E)` of `features (B, F)`; where not `guided (B,)`, `nothing (E,)` stands in."""
        return self.fuse(self.observe(features) + torch.where(guided[:, None], 0.0, nothing))

    def forward(self, noisy: Tensor, timestep: Tensor, context: Tensor) -> Tensor:
        """The velocity v (Salimans & Ho 2022), `(B, chunk, D)`.

        Args:
            noisy: `(B, chunk, D)`, noisy actions over `scale`.
            timestep: `(B,)` int, of the noise schedule, or `(1,)` for all.
            context: `(B, E)` of the observation.
        """
        time = timestep.float() / self.steps * 2 - 1
        condition = nn.functional.silu(context + self.time(fourier(time, _TIME_FREQUENCIES)))
        return self.unet(noisy, condition)


class PathPolicy(ActionDenoiser):
    """Denoises a chunk of actions in the robot's frame."""

    def __init__(self, config: PathPolicyConfig) -> None:
        super().__init__(config, config.dim * (len(_AHEAD) + 2) + 1)
        self.config = config
        self.no_path = nn.Parameter(torch.zeros(config.condition))

    def encode(self, features: Tensor, has_path: Tensor) -> Tensor:
        """`(B, E)` of an observation's `features (B, F)` and `has_path (B,)`."""
        return self._encode(features, has_path, self.no_path)

    @torch.inference_mode()
    def act(self, observation: Observation, steps: int | None = None) -> Array:
        """A chunk of displacements `(B, chunk, D)` [m] in the world, not yet made safe.

        Args:
            observation: of `B` robots.
            steps: of the sampler; the configuration's if not given.
        """
        features, has_path = map(torch.from_numpy, (observation.features, observation.has_path))
        with torch.autocast("cpu", enabled=False):
            actions = self.denoise(features, has_path, steps)
        return actions.double().numpy() * self.config.limit @ observation.rotation

    def denoise(self, features: Tensor, has_path: Tensor, steps: int | None = None) -> Tensor:
        """`act` in limits and in each robot's frame, `(B, chunk, D)`.

        The sampler starts at the middle of its noise: a path leaves nothing to choose, and other
        noise would only shake the arm.
        """
        context = self.encode(features, has_path)
        times = sampling_timesteps(self.config.diffusion_steps, steps or self.config.sampling_steps)
        timesteps = torch.tensor(times, device=features.device)[:, None]
        noise = features.new_zeros(features.shape[0], self.config.chunk, self.config.dim)

        def velocity(noisy: Tensor, i: int) -> Tensor:
            return self(noisy, timesteps[i], context)

        return ddim(velocity, noise, self.signal, times) * self.scale
