"""The networks of stage 1: a CNN over the field's image and a FiLM-conditioned 1-D U-Net."""

from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn import functional as F

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


class SetEncoder(nn.Module):
    """Features of any number of things, whatever their order (Zaheer et al. 2017)."""

    def __init__(self, inputs: int, size: int) -> None:
        super().__init__()
        self.each = nn.Sequential(
            nn.Linear(inputs, size), nn.SiLU(), nn.Linear(size, size), nn.SiLU()
        )
        self.head = nn.Linear(2 * size, size)

    def forward(self, things: Tensor, there: Tensor) -> Tensor:
        """`things (B, M, inputs)`, `there (B, M)` to `(B, size)`."""
        each = self.each(things).masked_fill(~there[..., None], 0.0)
        total = each.sum(dim=1) / 2
        most = each.amax(dim=1).clamp_min(0)  # the same with and without places that are empty
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


class _Block(nn.Module):
    """Two convolutions over the waypoints; FiLM (Perez et al. 2018) modulates the first."""

    def __init__(self, channels: int, out: int, condition: int) -> None:
        super().__init__()
        self.first = nn.Conv1d(channels, out, 3, padding=1)
        self.second = nn.Conv1d(out, out, 3, padding=1)
        self.norms = nn.ModuleList([nn.GroupNorm(_GROUPS, out) for _ in range(2)])
        self.film = nn.Linear(condition, 2 * out)
        self.skip = nn.Conv1d(channels, out, 1) if channels != out else nn.Identity()

    def forward(self, x: Tensor, condition: Tensor) -> Tensor:
        """`x (B, C, K)`, `condition (B, E)` to `(B, C′, K)`."""
        scale, shift = self.film(condition)[..., None].chunk(2, dim=1)
        h = F.silu(self.norms[0](self.first(x)) * (1 + scale) + shift)
        return self.skip(x) + F.silu(self.norms[1](self.second(h)))


class FiLMUNet(nn.Module):
    """Denoiser over `(B, K, D)` waypoints; each level below the first halves K.

    Args:
        inputs: channels read at each waypoint.
        dim: D.
        channels: of each level, from the finest.
        condition: size E of the condition that modulates every block.
    """

    def __init__(self, inputs: int, dim: int, channels: tuple[int, ...], condition: int) -> None:
        super().__init__()
        self.inlet = nn.Conv1d(inputs, channels[0], 3, padding=1)
        self.down, self.up = nn.ModuleList(), nn.ModuleList()
        for low, high in pairwise(channels):
            shrink = nn.Conv1d(low, high, 3, stride=2, padding=1)
            grow = nn.ConvTranspose1d(high, low, 4, stride=2, padding=1)
            self.down.append(nn.ModuleList([_Block(low, low, condition), shrink]))
            self.up.insert(0, nn.ModuleList([grow, _Block(2 * low, low, condition)]))
        top = channels[-1]
        self.middle = nn.ModuleList([_Block(top, top, condition) for _ in range(2)])
        self.outlet = nn.Conv1d(channels[0], dim, 1)
        nn.init.zeros_(self.outlet.weight)
        for layer in self.modules():
            if isinstance(layer, nn.Conv1d):  # faster by half with the channels last in memory
                weight = layer.weight.detach().transpose(1, 2).contiguous()
                layer.weight = nn.Parameter(weight.transpose(1, 2))

    def forward(self, x: Tensor, condition: Tensor) -> Tensor:
        """`x (B, K, inputs)`, `condition (B, E)` to `(B, K, D)`."""
        h = self.inlet(x.transpose(1, 2))
        skips = []
        for block, shrink in self.down:  # pyright: ignore[reportGeneralTypeIssues]
            h = block(h, condition)
            skips.append(h)
            h = shrink(h)
        for block in self.middle:
            h = block(h, condition)
        for grow, block in self.up:  # pyright: ignore[reportGeneralTypeIssues]
            h = block(torch.cat([grow(h), skips.pop()], dim=1), condition)
        return self.outlet(h).transpose(1, 2)
