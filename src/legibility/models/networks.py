"""The networks of stage 1: a CNN over the field's image and a FiLM-conditioned 1-D U-Net."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import torch
from torch import Tensor, nn
from torch.autograd.function import once_differentiable
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


Joins = tuple[tuple[slice, slice], ...]
"""Of each tap of a kernel, the outputs and the inputs along the waypoints that it joins."""

_ALL, _FIRST, _LAST = slice(None), slice(0, -1), slice(1, None)
_EVEN, _ODD = slice(0, None, 2), slice(1, None, 2)
_KEEP: Joins = ((_LAST, _FIRST), (_ALL, _ALL), (_FIRST, _LAST))
_SHRINK: Joins = ((_LAST, slice(1, -1, 2)), (_ALL, _EVEN), (_ALL, _ODD))
_GROW: Joins = ((slice(1, -1, 2), _LAST), (_EVEN, _ALL), (_ODD, _ALL), (slice(2, None, 2), _FIRST))


class _Taps(torch.autograd.Function):
    """A convolution over the waypoints in training: a matrix product for each tap of its kernel.

    A library's convolution needs longer to arrange eight points than to convolve them. With the
    waypoints first in memory a step along them is another beginning of the same matrix, so that
    nothing is copied, and the products add up in place.
    """

    @staticmethod
    def forward(
        ctx: Any, x: Tensor, weight: Tensor, bias: Tensor, joins: Joins, num: int
    ) -> Tensor:
        """`x (K, B, C)`, `weight (taps, C, C′)` to `(num, B, C′)`."""
        ctx.save_for_backward(x, weight)
        ctx.joins = joins
        found = bias.repeat(num, x.shape[1], 1)  # a copy even of one row, since it is added to
        for tap, (outs, ins) in zip(weight, joins, strict=True):
            _add_product(found[outs], x[ins], tap)
        return found

    @staticmethod
    @once_differentiable
    def backward(  # pyright: ignore[reportIncompatibleMethodOverride]
        ctx: Any, *gradients: Tensor
    ) -> tuple[Tensor | None, ...]:
        """Of `x`, `weight` and `bias`."""
        (x, weight), gradient = ctx.saved_tensors, gradients[0].contiguous()
        of_x = torch.zeros_like(x) if ctx.needs_input_grad[0] else None
        of_weight = torch.empty_like(weight)
        for tap, of_tap, (outs, ins) in zip(weight, of_weight, ctx.joins, strict=True):
            if of_x is not None:
                _add_product(of_x[ins], gradient[outs], tap.T)
            torch.mm(x[ins].flatten(0, 1).T, gradient[outs].flatten(0, 1), out=of_tap)
        return of_x, of_weight, gradient.sum((0, 1)), None, None


def _add_product(total: Tensor, x: Tensor, weight: Tensor) -> None:
    """Add `x @ weight` of `x (K, B, C)` to `total (K, B, C′)`."""
    total.baddbmm_(x, weight.expand(len(x), -1, -1))


def _by_taps(layer: nn.Conv1d | nn.ConvTranspose1d, x: Tensor, joins: Joins, num: int) -> Tensor:
    """`(B, num, C′)` of `x (B, K, C)`, both with the waypoints first in memory."""
    assert layer.bias is not None
    kind = x.device.type
    precision = torch.get_autocast_dtype(kind) if torch.is_autocast_enabled(kind) else x.dtype
    weight = layer.weight.permute((2, 0, 1) if layer.transposed else (2, 1, 0))
    inputs = (x.transpose(0, 1), weight, layer.bias)
    return _Taps.apply(*(i.to(precision) for i in inputs), joins, num).transpose(0, 1)


class _Convolution(nn.Conv1d):
    """A convolution of width 3 over the waypoints, as matrix products."""

    def __init__(self, channels: int, out: int, stride: int = 1) -> None:
        super().__init__(channels, out, 3, stride=stride, padding=1)
        # (C′, C, 3) as ever, but so laid out that no product need copy it.
        last = self.weight.detach().transpose(1, 2).contiguous()
        self.weight = nn.Parameter(last.transpose(1, 2))

    def forward(self, input: Tensor) -> Tensor:
        """`(B, K, C)` to `(B, K / stride, C′)`."""
        stride = self.stride[0]
        if torch.is_grad_enabled():
            joins = _KEEP if stride == 1 else _SHRINK  # of an even number of points
            return _by_taps(self, input, joins, input.shape[1] // stride)
        windows = F.pad(input, (0, 0, 1, 1)).unfold(1, 3, stride)
        windows = windows.transpose(2, 3).flatten(2).contiguous()
        return F.linear(windows, self.weight.transpose(1, 2).flatten(1), self.bias)


class _Pointwise(nn.Conv1d):
    """A convolution of width 1: a linear layer whose weight is stored as a convolution's."""

    def __init__(self, channels: int, out: int) -> None:
        super().__init__(channels, out, 1)

    def forward(self, input: Tensor) -> Tensor:
        """`(B, K, C)` to `(B, K, C′)`."""
        if torch.is_grad_enabled():
            found = F.linear(input.transpose(0, 1), self.weight[..., 0], self.bias)
            return found.transpose(0, 1)
        return F.linear(input, self.weight[..., 0], self.bias)


class _Growth(nn.ConvTranspose1d):
    """A transposed convolution of width 4 and stride 2, as matrix products."""

    def __init__(self, channels: int, out: int) -> None:
        super().__init__(channels, out, 4, stride=2, padding=1)

    def forward(self, input: Tensor, output_size: list[int] | None = None) -> Tensor:
        """`(B, K, C)` to `(B, 2K, C′)`."""
        if torch.is_grad_enabled():
            return _by_taps(self, input, _GROW, 2 * input.shape[1])
        taps = (input @ self.weight.flatten(1)).unflatten(2, (-1, 4))
        after, even, odd, before = taps.unbind(-1)
        even = even + F.pad(before[:, :-1], (0, 0, 1, 0))
        odd = odd + F.pad(after[:, 1:], (0, 0, 0, 1))
        grown = torch.stack([even, odd], dim=2).flatten(1, 2)
        return grown if self.bias is None else grown + self.bias


Modulation = tuple[Tensor, Tensor]
"""Scale and shift `(..., B, 1, C)` of one block."""


class _Activation(torch.autograd.Function):
    """Group normalisation, an affine function and SiLU in training, with few passes over the data.

    In float32 whatever the precision of the data, in which passes are slower. The variance is the
    mean square less the squared mean: exact enough while a group's mean is not many times its
    standard deviation, and in networks like ours it is not.
    """

    @staticmethod
    def forward(
        ctx: Any, data: Tensor, scale: Tensor, shift: Tensor, groups: int, eps: float
    ) -> Tensor:
        """`data (K, B, C)`, `scale` and `shift` `(B or 1, C)` to `(K, B, C)`."""
        x = data.float()
        mean, square = _group_means(torch.stack([x.sum(0), x.square().sum(0)]), groups) / len(x)
        inverse = ((square - mean.square()).clamp_min(0) + eps).rsqrt()  # of the deviation
        mean, inverse = _spread(torch.stack([mean, inverse]), x.shape[2])
        slope = scale * inverse
        offset = torch.addcmul(shift, mean, slope, value=-1)
        ctx.save_for_backward(data, scale, mean, inverse, slope, offset)
        ctx.groups = groups
        return F.silu(torch.addcmul(offset, x, slope), inplace=True).to(data.dtype)

    @staticmethod
    @once_differentiable
    def backward(  # pyright: ignore[reportIncompatibleMethodOverride]
        ctx: Any, *gradients: Tensor
    ) -> tuple[Tensor | None, ...]:
        """Of `data`, `scale` and `shift`."""
        data, scale, mean, inverse, slope, offset = ctx.saved_tensors
        x = data.float()
        z = torch.addcmul(offset, x, slope)
        of_z = torch.ops.aten.silu_backward(gradients[0].float(), z)
        of_shift = of_z.sum(0)
        of_scale = torch.mul(of_z, x, out=z).sum(0).addcmul_(mean, of_shift, value=-1).mul_(inverse)
        # What every point of a group adds by its mean, and by its standard deviation.
        parts = _group_means(torch.stack([of_shift, of_scale]) * scale, ctx.groups) / -len(x)
        by_mean, by_deviation = _spread(parts, x.shape[2]) * inverse
        by_deviation *= inverse
        of_x = torch.addcmul(by_mean - by_deviation * mean, x, by_deviation, out=z)
        of_x.addcmul_(of_z, slope)
        affine = (part.sum_to_size(scale.shape) for part in (of_scale, of_shift))
        return of_x.to(data.dtype), *affine, None, None


def _group_means(x: Tensor, groups: int) -> Tensor:
    """`(..., C)` to the mean over each group of channels, `(..., groups)`."""
    return x.unflatten(-1, (groups, -1)).mean(-1)


def _spread(x: Tensor, channels: int) -> Tensor:
    """The inverse: what is of a group to all its channels, `(..., C)`."""
    return x[..., None].expand(*x.shape, channels // x.shape[-1]).flatten(-2)


class _GroupNorm(nn.GroupNorm):
    """Group normalisation of channels that come last."""

    def forward(self, input: Tensor) -> Tensor:
        """`(B, K, C)`."""
        return super().forward(input.transpose(1, 2)[..., None])[..., 0].transpose(1, 2)

    def activated(self, x: Tensor, modulation: Modulation | None = None) -> Tensor:
        """SiLU of what `forward` gives, modulated."""
        if not torch.is_grad_enabled():
            h = self(x)
            if modulation is not None:
                h = torch.addcmul(modulation[1], h, modulation[0])
            return F.silu(h)
        scale, shift = self.weight[None], self.bias[None]
        if modulation is not None:
            by, add = (m.squeeze(-2) for m in modulation)
            scale, shift = by * scale, by * shift + add
        found = _Activation.apply(x.transpose(0, 1), scale, shift, self.num_groups, self.eps)
        return found.transpose(0, 1)


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
        norms: Any = self.norms
        first, second = norms
        h = first.activated(self.first(x), modulation)
        return self.skip(x) + second.activated(self.second(h))


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
            both = [part.transpose(0, 1) for part in (grow(h), skips.pop())]
            h = block(torch.cat(both, dim=2).transpose(0, 1), next(each))
        return self.outlet(h)
