"""What policies share that denoise a chunk of actions (Chi et al. 2024): settings and network."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from .configuration import ActionConfig
from .networks import FiLMUNet, Residual, fourier

__all__ = ["ActionDenoiser"]

_TIME_FREQUENCIES = 8


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
