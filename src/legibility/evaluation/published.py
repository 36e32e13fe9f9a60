"""The paper's published configuration of stage 1 with random weights, for its time alone.

Its U-Net (Chi et al. 2024), its image encoder (He et al. 2016, with group normalisation) and its
sampler are of the published sizes and in PyTorch's own layers, as the published code is.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import torch
from torch import Tensor, nn

from ..curves import NUM_WAYPOINTS

__all__ = ["DIFFERENCES", "PublishedDiffuser", "PublishedUNet"]

CHANNELS = (256, 512, 1024)
STEPS = 100
_KERNEL, _GROUPS, _STEP_SIZE, _FEATURES, _IMAGE = 5, 8, 256, 512, 96
_STAGES = (64, 128, 256, 512)

DIFFERENCES = (
    f"it denoises the {NUM_WAYPOINTS} points between start and goal, not all ten, which cannot be "
    "halved twice",
    "its weights are random, as the published ones are not to be had; time does not depend on them",
    "what is timed is its encoder and its sampler: drawing the field's image and checking the path "
    "are left out, while ours is timed from scene to path",
)
"""Where what is timed is not the published code; all of it is in favour of the published one."""


class PublishedUNet(nn.Module):
    """The U-Net of 256/512/1024 channels: kernel 5, 8 groups, FiLM with scale and bias.

    Args:
        dim: D.
        condition: size of the global condition, to which the step's embedding is added.
        channels: of each level, from the finest.
    """

    def __init__(self, dim: int, condition: int, channels: tuple[int, ...] = CHANNELS) -> None:
        super().__init__()
        size, top = condition + _STEP_SIZE, channels[-1]
        self.step = nn.Sequential(
            nn.Linear(_STEP_SIZE, 4 * _STEP_SIZE), nn.Mish(), nn.Linear(4 * _STEP_SIZE, _STEP_SIZE)
        )
        self.down, self.up = nn.ModuleList(), nn.ModuleList()
        for low, high in pairwise((dim, *channels)):
            last = high == top
            shrink = nn.Identity() if last else nn.Conv1d(high, high, 3, stride=2, padding=1)
            self.down.append(
                nn.ModuleList([_Block(low, high, size), _Block(high, high, size), shrink])
            )
        self.middle = nn.ModuleList([_Block(top, top, size) for _ in range(2)])
        for low, high in pairwise(channels):
            grow = nn.ConvTranspose1d(low, low, 4, stride=2, padding=1)
            self.up.insert(
                0, nn.ModuleList([_Block(2 * high, low, size), _Block(low, low, size), grow])
            )
        self.outlet = nn.Sequential(
            _convolution(channels[0], channels[0]), nn.Conv1d(channels[0], dim, 1)
        )

    def forward(self, x: Tensor, timestep: Tensor, condition: Tensor) -> Tensor:
        """The noise in `x (B, D, K)` at `timestep (B,)`, under `condition (B, C)`."""
        half = _STEP_SIZE // 2
        rates = torch.exp(torch.arange(half, device=x.device) * (-9.21034 / (half - 1)))
        angles = timestep[:, None] * rates
        embedded = self.step(torch.cat([angles.sin(), angles.cos()], dim=-1))
        condition = torch.cat([embedded, condition], dim=-1)
        down: Any = self.down
        up: Any = self.up
        skips = []
        for first, second, shrink in down:
            x = second(first(x, condition), condition)
            skips.append(x)
            x = shrink(x)
        for block in self.middle:
            x = block(x, condition)
        for first, second, grow in up:
            x = torch.cat([x, skips.pop()], dim=1)
            x = grow(second(first(x, condition), condition))
        return self.outlet(x)


class PublishedDiffuser(nn.Module):
    """Encoder, U-Net and DDPM sampler (Ho et al. 2020) of the published stage 1.

    Args:
        dim: D.
        channels: of the U-Net's levels.
    """

    def __init__(self, dim: int = 2, channels: tuple[int, ...] = CHANNELS) -> None:
        super().__init__()
        self.dim = dim
        self.unet = PublishedUNet(dim, 2 * dim + _FEATURES + 1, channels)
        stages = [
            layer
            for low, high in pairwise((_STAGES[0], *_STAGES))
            for layer in (_ImageBlock(low, high), _ImageBlock(high, high))
        ]
        self.encoder = nn.Sequential(
            nn.Conv2d(3, _STAGES[0], 7, stride=2, padding=3, bias=False),
            _norm(_STAGES[0]), nn.ReLU(), nn.MaxPool2d(3, stride=2, padding=1),
            *stages, nn.AdaptiveAvgPool2d(1), nn.Flatten(),
        )  # fmt: skip

    @torch.inference_mode()
    def sample(self, size: int, steps: int = STEPS) -> Tensor:
        """Draw waypoints `(size, K, D)` in one scene, by the first `steps` of its 100."""
        from diffusers.schedulers.scheduling_ddpm import DDPMScheduler

        device = next(self.parameters()).device
        scheduler: Any = DDPMScheduler(num_train_timesteps=STEPS, beta_schedule="squaredcos_cap_v2")
        features = self.encoder(torch.zeros(1, 3, _IMAGE, _IMAGE, device=device))
        known = torch.zeros(1, 2 * self.dim + 1, device=device)  # start, goal and score
        condition = torch.cat([known, features], dim=-1).expand(size, -1)
        noisy = torch.randn(size, self.dim, NUM_WAYPOINTS, device=device)
        for time in scheduler.timesteps[:steps]:
            noise = self.unet(noisy, time.to(device).expand(size), condition)
            noisy = scheduler.step(noise, time, noisy).prev_sample
        return noisy.transpose(1, 2)


def _convolution(channels: int, out: int) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv1d(channels, out, _KERNEL, padding=_KERNEL // 2),
        nn.GroupNorm(_GROUPS, out),
        nn.Mish(),
    )


class _Block(nn.Module):
    """Two convolutions, the first modulated by FiLM with scale and bias."""

    def __init__(self, channels: int, out: int, condition: int) -> None:
        super().__init__()
        self.first, self.second = _convolution(channels, out), _convolution(out, out)
        self.film = nn.Sequential(nn.Mish(), nn.Linear(condition, 2 * out))
        self.skip = nn.Conv1d(channels, out, 1) if channels != out else nn.Identity()

    def forward(self, x: Tensor, condition: Tensor) -> Tensor:
        """`x (B, C, K)` to `(B, C′, K)`."""
        scale, bias = self.film(condition)[..., None].chunk(2, dim=1)
        return self.second(scale * self.first(x) + bias) + self.skip(x)


class _ImageBlock(nn.Module):
    """The basic block of a ResNet; halves height and width where it has more channels out."""

    def __init__(self, channels: int, out: int) -> None:
        super().__init__()
        stride = 1 if channels == out else 2
        self.body = nn.Sequential(
            nn.Conv2d(channels, out, 3, stride=stride, padding=1, bias=False), _norm(out),
            nn.ReLU(), nn.Conv2d(out, out, 3, padding=1, bias=False), _norm(out),
        )  # fmt: skip
        self.skip = nn.Identity()
        if channels != out:
            self.skip = nn.Sequential(
                nn.Conv2d(channels, out, 1, stride=stride, bias=False), _norm(out)
            )

    def forward(self, x: Tensor) -> Tensor:
        """`(B, C, H, W)`."""
        return torch.relu(self.body(x) + self.skip(x))


def _norm(channels: int) -> nn.GroupNorm:
    """Groups of 16 channels, as in Diffusion Policy."""
    return nn.GroupNorm(channels // 16, channels)
