"""What policies share that denoise a chunk of actions (Chi et al. 2024): settings and network."""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields
from typing import Any, Self

import torch
from torch import Tensor, nn

from ..checks import count, positive
from ..errors import CheckpointError, InvalidInputError
from .networks import FiLMUNet, Residual, fourier

__all__ = ["ActionConfig", "ActionDenoiser"]

_TIME_FREQUENCIES = 8


@dataclass(frozen=True)
class ActionConfig:
    """The shape of a policy.

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
    def from_dict(cls, content: dict[str, Any]) -> Self:
        """The inverse of `to_dict`; every key must be there and none else."""
        names = {f.name for f in fields(cls)}
        if set(content) != names:
            raise CheckpointError(
                f"a {cls.__name__} has the settings {sorted(names)}; "
                f"missing or unknown: {sorted(names ^ set(content))}"
            )
        return cls(**{**content, "channels": tuple(content["channels"])})


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
        """`(B, E)` of `features (B, F)`; `nothing (E,)` stands for what is not `guided (B,)`."""
        return self.fuse(self.observe(features) + torch.where(guided[:, None], 0.0, nothing))

    def forward(self, noisy: Tensor, timestep: Tensor, context: Tensor) -> Tensor:
        """The velocity v (Salimans & Ho 2022), `(B, chunk, D)`.

        Args:
            noisy: `(B, chunk, D)`, noisy actions over `scale`.
            timestep: `(B,)` int, of the noise schedule, or `(1,)` for all.
            context: `(B, E)` of what is observed.
        """
        time = timestep.float() / self.steps * 2 - 1
        condition = nn.functional.silu(context + self.time(fourier(time, _TIME_FREQUENCIES)))
        return self.unet(noisy, condition)
