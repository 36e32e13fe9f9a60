"""Both stages as ONNX graphs that onnxruntime runs: the same results in less time."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from ..checks import Array
from ..curves import NUM_WAYPOINTS
from .diffusion import sampling_timesteps
from .onnx_graph import (
    Graph,
    ddim_step,
    fourier,
    linear,
    modulations,
    sequence,
    session,
    silu,
    unet,
)
from .path_diffuser import LEVEL_FREQUENCIES, NO_ODDS, Conditions, PathDiffuser
from .path_policy import Observation, PathPolicy

__all__ = ["OnnxPathDiffuser", "OnnxPathPolicy"]

_AT_ONCE = 64  # rows: what their layers hold fits into a core's cache
_SCENE = ("image", "vector", "slopes", "intercepts")


class OnnxPathDiffuser:
    """Draws what `PathDiffuser.sample` draws, to rounding.

    Args:
        model: stage 1, with the weights that it has when it first draws.

    Raises:
        MissingExtraError: onnxruntime is not installed.
    """

    def __init__(self, model: PathDiffuser) -> None:
        self.model = model
        self._session = lru_cache(lambda steps, guided: session(_path_graph(model, steps, guided)))
        self._session(model.config.sampling_steps, bool(model.config.guidance))

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.model,)  # a session cannot be sent to another process

    def sample(
        self,
        conditions: Conditions,
        level: Tensor,
        noise: Tensor,
        *,
        guidance: float | None = None,
        steps: int | None = None,
    ) -> Tensor:
        """See `PathDiffuser.sample`; other steps than the model's own need a graph of their own."""
        config = self.model.config
        guidance = config.guidance if guidance is None else guidance
        scenes = [getattr(conditions, name).numpy() for name in _SCENE]
        each = {"level": level.numpy(), "noise": noise.numpy()}
        if guidance:
            each["weight"] = guidance * each["level"][:, None, None] ** 4
        if len(scenes[0]) > 1:
            each |= dict(zip(_SCENE, scenes, strict=True))
            scenes = []
        found = _in_parts(
            self._session(steps or config.sampling_steps, bool(guidance)),
            each,
            dict(zip(_SCENE, scenes, strict=False)),
        )
        return torch.from_numpy(found)


class OnnxPathPolicy:
    """Acts as `PathPolicy` does, to rounding.

    Args:
        model: stage 2, with the weights that it has when it first acts.

    Raises:
        MissingExtraError: onnxruntime is not installed.
    """

    def __init__(self, model: PathPolicy) -> None:
        self.model, self.config = model, model.config
        self._session = lru_cache(lambda steps: session(_policy_graph(model, steps)))
        self._session(model.config.sampling_steps)

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.model,)

    def act(self, observation: Observation, noise: Tensor, steps: int | None = None) -> Array:
        """See `PathPolicy.act`; other steps than the model's own need a graph of their own."""
        each = {
            "features": observation.features,
            "without": 1 - observation.has_path[:, None].astype(np.float32),
            "noise": noise.numpy(),
        }
        actions = _in_parts(self._session(steps or self.config.sampling_steps), each, {})
        return actions.astype(np.float64) * self.config.limit @ observation.rotation


def _in_parts(graph: Any, each: dict[str, np.ndarray], shared: dict[str, np.ndarray]) -> np.ndarray:
    """The output for the rows of `each`, shared among as many threads as PyTorch has."""
    parts = range(0, len(each["noise"]), _AT_ONCE)

    def run(first: int) -> np.ndarray:
        rows = {name: value[first : first + _AT_ONCE] for name, value in each.items()}
        return graph.run(None, rows | shared)[0]

    threads = min(len(parts), torch.get_num_threads())
    if threads == 1:
        return np.concatenate([run(first) for first in parts])
    with ThreadPoolExecutor(threads) as pool:
        return np.concatenate(list(pool.map(run, parts)))


@torch.no_grad()
def _path_graph(model: PathDiffuser, steps: int, guided: bool) -> bytes:
    """`PathDiffuser.sample` with its steps unrolled, of `B` rows in one scene or as many."""
    g, config, dim = Graph(), model.config, model.config.dim
    times = sampling_timesteps(config.diffusion_steps, steps)
    moments = model.moments(torch.tensor(times))
    modulated = modulations(g, model.unet, _context(g, model, guided), moments)
    reading = _reader(g, dim, config.field)
    latent = clean = "noise"
    for now, after, by in zip(times, [*times[1:], None], modulated, strict=True):
        inputs = g.Concat(latent, *reading(_from_latent(g, model, latent)), axis=-1)
        if guided:
            inputs = g.Concat(inputs, g.Pad(latent, [0, 0, 0, 0, 0, dim + 2]), axis=0)
        v = unet(g, model.unet, inputs, NUM_WAYPOINTS, by)
        if guided:
            v, free = g.Split(v, outputs=2, axis=0, num_outputs=2)
            v = g.Add(v, g.Mul("weight", g.Sub(v, free)))
        clean, latent = ddim_step(g, latent, v, model.signal, now, after)
    shapes: dict[str, list[int | str]] = {
        "image": ["S", "C", config.resolution, config.resolution],
        "vector": ["S", model.place.in_features],
        "slopes": ["S", "M", dim],
        "intercepts": ["S", "M"],
        "level": ["B"],
        "noise": ["B", NUM_WAYPOINTS, dim],
    }
    if guided:
        shapes["weight"] = ["B", 1, 1]
    return g.finished(shapes, _from_latent(g, model, clean))


@torch.no_grad()
def _policy_graph(model: PathPolicy, steps: int) -> bytes:
    """The actions in limits that `PathPolicy.act` finds, with its steps unrolled, of `B` rows."""
    g, config = Graph(), model.config
    times = sampling_timesteps(config.diffusion_steps, steps)
    seen = g.Add(linear(g, "features", model.observe), g.Mul("without", model.no_path))
    modulated = modulations(
        g, model.unet, sequence(g, seen, model.fuse), model.moments(torch.tensor(times))
    )
    latent = clean = "noise"
    for now, after, by in zip(times, [*times[1:], None], modulated, strict=True):
        v = unet(g, model.unet, latent, config.chunk, by)
        clean, latent = ddim_step(g, latent, v, model.signal, now, after)
    shapes: dict[str, list[int | str]] = {
        "features": ["B", model.observe.in_features],
        "without": ["B", 1],
        "noise": ["B", config.chunk, config.dim],
    }
    return g.finished(shapes, g.Mul(clean, model.scale))


def _context(g: Graph, model: PathDiffuser, guided: bool) -> str:
    """`(B, E)` of scenes and levels; guided `(2B, E)`, of nothing besides."""
    place = linear(g, "vector", model.place)
    features = model.no_field
    if model.config.field:
        features = g.Add(_image(g, model), _distractors(g, model))
    scene = sequence(g, g.Add(features, place), model.scene)
    level = fourier(g, "level", LEVEL_FREQUENCIES)
    context = g.Add(scene, linear(g, level, model.level))
    if guided:
        free = g.Add(sequence(g, g.Add(place, model.no_field), model.scene), model.no_level)
        as_many = g.Mul(g.Unsqueeze("level", [1]), 0.0)
        context = g.Concat(context, g.Add(as_many, free), axis=0)
    return sequence(g, context, model.fuse)


def _image(g: Graph, model: PathDiffuser) -> str:
    x, size = "image", model.config.resolution
    for layer in model.encoder.convolutions:
        if isinstance(layer, nn.Conv2d):
            x = g.Conv(x, layer.weight, layer.bias, strides=[2, 2], pads=[1, 1, 1, 1])
            size //= 2
        elif isinstance(layer, nn.GroupNorm):
            groups, channels = layer.num_groups, layer.num_channels
            x = g.Reshape(x, [0, groups, -1])
            x = g.InstanceNormalization(x, np.ones(groups), np.zeros(groups), epsilon=layer.eps)
            x = g.Reshape(x, [-1, channels, size, size])
            x = g.Add(g.Mul(x, layer.weight[:, None, None]), layer.bias[:, None, None])
        else:
            x = silu(g, x)
    return linear(g, g.Flatten(x), model.encoder.head)


def _distractors(g: Graph, model: PathDiffuser) -> str:
    """See `Conditions.distractors` and `DistractorEncoder`."""
    dim, encoder = model.config.dim, model.distractors
    width = model.place.in_features
    variance = g.Unsqueeze(g.Exp(g.Mul(g.Slice("vector", [width - 1], [width], [1]), -2.0)), [2])
    x = g.Concat(
        g.Mul("slopes", variance),
        g.Mul(g.Asinh("slopes"), 0.25),
        g.Unsqueeze(g.Mul(g.Asinh("intercepts"), 0.25), [2]),
        axis=2,
    )
    there = g.Unsqueeze(g.Greater("intercepts", NO_ODDS), [2])
    rows = sequence(g, g.Reshape(x, [-1, 2 * dim + 1]), encoder.each)
    size = encoder.head.out_features
    shape = g.Concat(g.Shape("intercepts"), np.array([size]), axis=0)
    each = g.Reshape(rows, shape)
    total = g.Mul(g.ReduceSum(g.Where(there, each, 0.0), [1], keepdims=0), 0.5)
    most = g.ReduceMax(g.Where(there, each, -np.inf), [1], keepdims=0)
    return linear(g, g.Concat(total, most, axis=1), encoder.head)


def _reader(g: Graph, dim: int, field: bool) -> Callable[[str], tuple[str, str, str]]:
    """What reads the field and the walls at points `(B, K, D)`, see `PathDiffuser.forward`."""
    last = dim + dim * dim
    axes = g.Reshape(g.Slice("vector", [dim], [last], [1]), [-1, dim, dim])
    half = g.Sqrt(g.ReduceSum(g.Mul(axes, axes), [1], keepdims=1))
    axes, centre = g.Div(axes, half), g.Unsqueeze(g.Slice("vector", [0], [dim], [1]), [1])
    slopes, intercepts = g.Transpose("slopes", perm=[0, 2, 1]), g.Unsqueeze("intercepts", [1])

    def reading(points: str) -> tuple[str, str, str]:
        along = g.Abs(g.MatMul(g.Sub(points, centre), axes))
        wall = g.Tanh(g.Mul(g.ReduceMin(g.Sub(half, along), [2], keepdims=1), 2.0))
        if not field:
            nothing = g.Mul(points, 0.0)
            return g.Slice(nothing, [0], [1], [2]), nothing, wall
        odds = g.Add(g.MatMul(points, slopes), intercepts)
        top = g.ReduceMax(odds, [2], keepdims=1)
        against = g.Add(top, g.Log(g.ReduceSum(g.Exp(g.Sub(odds, top)), [2], keepdims=1)))
        shares = g.Mul(g.Exp(g.Sub(odds, against)), g.Sigmoid(against))
        return (
            g.Sub(g.Log(g.Add(g.Softplus(against), 1.0)), 1.0),
            g.Mul(g.Asinh(g.MatMul(shares, "slopes")), 0.5),
            wall,
        )

    return reading


def _from_latent(g: Graph, model: PathDiffuser, latent: str) -> str:
    deviation = g.Sinh(g.Clip(g.Mul(latent, model.spread), -6.0, 6.0))
    return g.Add(g.Mul(deviation, model.config.squash), model.straight)
