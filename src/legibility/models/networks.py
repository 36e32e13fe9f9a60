"""The networks of stage 1: a CNN over the field's image and a FiLM-conditioned 1-D U-Net."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional as F

__all__ = ["DistractorEncoder", "FiLMUNet", "FieldEncoder", "Residual", "fourier"]

_GROUPS = 8


def fourier(value: Tensor, num: int) -> Tensor:
    """`(B,)` in [−1, 1] to `(B, 2·num + 1)`: the value, its sines and cosines."""
    angles = value[:, None] * (torch.pi / 2) * torch.arange(1, num + 1, device=value.device)
    return torch.cat([value[:, None], angles.sin(), angles.cos()], dim=-1)


class FieldEncoder(nn.Module):
    """A small CNN: an image `(B, C, H, W)` to features `(B, size)`, H and W multiples of 8."""

    def __init__(self, channels: int, resolution: int, width: int, size: int) -> None:
        super().__init__()
        layers: list[nn.Module] = []
        for i in range(3):
            out = width * 2**i
            layers += [
                nn.Conv2d(channels, out, 3, stride=2, padding=1),
                nn.GroupNorm(_GROUPS, out),
                nn.SiLU(),
            ]
            channels = out
        self.convolutions = nn.Sequential(*layers)
        self.head = nn.Linear(channels * (resolution // 8) ** 2, size)

    def forward(self, image: Tensor) -> Tensor:
        """`(B, size)`."""
        return self.head(self.convolutions(image).flatten(1))


class DistractorEncoder(nn.Module):
    """Features of any number of distractors, whatever their order (Zaheer et al. 2017)."""

    def __init__(self, inputs: int, size: int) -> None:
        super().__init__()
        self.each = nn.Sequential(
            nn.Linear(inputs, size), nn.SiLU(), nn.Linear(size, size), nn.SiLU()
        )
        self.head = nn.Linear(2 * size, size)

    def forward(self, distractors: Tensor, there: Tensor) -> Tensor:
        """`distractors (B, M, inputs)`, `there (B, M)` to `(B, size)`."""
        each, missing = self.each(distractors), ~there[..., None]
        total = each.masked_fill(missing, 0.0).sum(dim=1) / 2
        most = each.masked_fill(missing, -torch.inf).amax(dim=1)
        return self.head(torch.cat([total, most], dim=-1))


class Residual(nn.Module):
    """`x + f(x)` of a two-layer perceptron with layer normalisation."""

    def __init__(self, size: int) -> None:
        super().__init__()
        self.body = nn.Sequential(
            nn.LayerNorm(size), nn.Linear(size, 2 * size), nn.SiLU(), nn.Linear(2 * size, size)
        )

    def forward(self, x: Tensor) -> Tensor:
        """`(..., size)`."""
        return x + self.body(x)


class _Convolution(nn.Conv1d):
    """A convolution of width 3 over the waypoints, as one matrix product.

    A library's convolution needs longer to set itself up than to convolve eight points; for the
    large batches of training, and backwards, it is the quicker one.
    """

    def __init__(self, channels: int, out: int, stride: int = 1) -> None:
        super().__init__(channels, out, 3, stride=stride, padding=1)
        # (C′, C, 3) as ever, but so laid out that `_matrix` need not copy it.
        last = self.weight.detach().transpose(1, 2).contiguous()
        self.weight = nn.Parameter(last.transpose(1, 2))

    def forward(self, input: Tensor) -> Tensor:
        """`(B, K, C)` to `(B, K / stride, C′)`."""
        if torch.is_grad_enabled():
            return super().forward(input.transpose(1, 2)).transpose(1, 2)
        windows = F.pad(input, (0, 0, 1, 1)).unfold(1, 3, self.stride[0])
        windows = windows.transpose(2, 3).flatten(2).contiguous()
        return F.linear(windows, self.weight.transpose(1, 2).flatten(1), self.bias)


class _Pointwise(nn.Conv1d):
    """A convolution of width 1: a linear layer whose weight is stored as a convolution's."""

    def __init__(self, channels: int, out: int) -> None:
        super().__init__(channels, out, 1)

    def forward(self, input: Tensor) -> Tensor:
        """`(B, K, C)` to `(B, K, C′)`."""
        if torch.is_grad_enabled():
            return super().forward(input.transpose(1, 2)).transpose(1, 2)
        return F.linear(input, self.weight[..., 0], self.bias)


class _Growth(nn.ConvTranspose1d):
    """A transposed convolution of width 4 and stride 2, as one matrix product."""

    def __init__(self, channels: int, out: int) -> None:
        super().__init__(channels, out, 4, stride=2, padding=1)

    def forward(self, input: Tensor, output_size: list[int] | None = None) -> Tensor:
        """`(B, K, C)` to `(B, 2K, C′)`."""
        if torch.is_grad_enabled():
            return super().forward(input.transpose(1, 2)).transpose(1, 2)
        taps = (input @ self.weight.flatten(1)).unflatten(2, (-1, 4))
        after, even, odd, before = taps.unbind(-1)
        even = even + F.pad(before[:, :-1], (0, 0, 1, 0))
        odd = odd + F.pad(after[:, 1:], (0, 0, 0, 1))
        grown = torch.stack([even, odd], dim=2).flatten(1, 2)
        return grown if self.bias is None else grown + self.bias


class _GroupNorm(nn.GroupNorm):
    """Group normalisation of channels that come last."""

    def forward(self, input: Tensor) -> Tensor:
        """`(B, K, C)`."""
        x = input.transpose(1, 2)
        if not torch.is_grad_enabled():
            return super().forward(x[..., None])[..., 0].transpose(1, 2)
        groups = x.unflatten(1, (self.num_groups, -1)).flatten(2)
        groups = F.layer_norm(groups, groups.shape[2:], eps=self.eps)
        return torch.addcmul(self.bias, groups.view(x.shape).transpose(1, 2), self.weight)


Modulation = tuple[Tensor, Tensor]
"""Scale and shift `(..., B, 1, C)` of one block."""


class _Block(nn.Module):
    """Two convolutions over the waypoints, the first modulated by FiLM (Perez et al. 2018)."""

    def __init__(self, channels: int, out: int, condition: int) -> None:
        super().__init__()
        self.first = _Convolution(channels, out)
        self.second = _Convolution(out, out)
        self.norms = nn.ModuleList([_GroupNorm(_GROUPS, out) for _ in range(2)])
        self.film = nn.Linear(condition, 2 * out)
        self.skip = _Pointwise(channels, out) if channels != out else nn.Identity()

    def modulation(self, condition: Tensor) -> Modulation:
        """Of a condition `(..., B, E)`."""
        scale, shift = self.film(condition)[..., None, :].chunk(2, dim=-1)
        return 1 + scale, shift

    def forward(self, x: Tensor, modulation: Modulation) -> Tensor:
        """`x (B, K, C)` to `(B, K, C′)`."""
        scale, shift = modulation
        h = F.silu(torch.addcmul(shift, self.norms[0](self.first(x)), scale))
        h = F.silu(self.norms[1](self.second(h)))
        return self.skip(x) + h


class FiLMUNet(nn.Module):
    """Denoiser over `(B, K, D)` waypoints: halves K once for each further entry of `channels`.

    Args:
        inputs: channels of what it reads at each waypoint.
        dim: D.
        channels: of each level, from the finest.
        condition: size E of the condition that every block is modulated by.
    """

    def __init__(self, inputs: int, dim: int, channels: tuple[int, ...], condition: int) -> None:
        super().__init__()
        self.inlet = _Convolution(inputs, channels[0])
        self.down, self.up = nn.ModuleList(), nn.ModuleList()
        for low, high in pairwise(channels):
            self.down.append(
                nn.ModuleList([_Block(low, low, condition), _Convolution(low, high, stride=2)])
            )
            self.up.insert(0, nn.ModuleList([_Growth(high, low), _Block(2 * low, low, condition)]))
        top = channels[-1]
        self.middle = nn.ModuleList([_Block(top, top, condition) for _ in range(2)])
        self.outlet = _Pointwise(channels[0], dim)
        nn.init.zeros_(self.outlet.weight)

    def blocks(self) -> list[Any]:
        """Its blocks in the order in which they are passed."""
        down: Any = self.down
        up: Any = self.up
        return [*(pair[0] for pair in down), *self.middle, *(pair[1] for pair in up)]

    def modulations(self, condition: Tensor) -> list[Modulation]:
        """Of every block by a condition `(..., B, E)`: of one step, or of all steps at once."""
        return [block.modulation(condition) for block in self.blocks()]

    def forward(self, x: Tensor, condition: Tensor) -> Tensor:
        """`x (B, K, inputs)`, `condition (B, E)` to `(B, K, D)`."""
        return self.modulated(x, self.modulations(condition))

    def modulated(self, x: Tensor, modulations: Sequence[Modulation]) -> Tensor:
        """`forward` by what `modulations` gave of the condition."""
        each = iter(modulations)
        h = self.inlet(x)
        skips = []
        for block, shrink in self.down:  # pyright: ignore[reportGeneralTypeIssues]
            h = block(h, next(each))
            skips.append(h)
            h = shrink(h)
        for block in self.middle:
            h = block(h, next(each))
        for grow, block in self.up:  # pyright: ignore[reportGeneralTypeIssues]
            h = block(torch.cat([grow(h), skips.pop()], dim=2), next(each))
        return self.outlet(h)
