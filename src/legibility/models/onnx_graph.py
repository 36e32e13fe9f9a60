"""Graphs of ONNX and what our networks are made of, as nodes of one."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from ..errors import MissingExtraError
from .networks import FiLMUNet

__all__ = [
    "Graph",
    "ddim_step",
    "fourier",
    "linear",
    "modulations",
    "sequence",
    "session",
    "silu",
    "unet",
]

_OPSET, _IR = 18, 9


def session(model: bytes) -> Any:
    """An onnxruntime session of a serialised model, on one thread.

    Raises:
        MissingExtraError: onnxruntime is not installed.
    """
    runtime = _installed()[1]
    options = runtime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    return runtime.InferenceSession(model, options, providers=["CPUExecutionProvider"])


def _installed() -> tuple[Any, Any]:
    try:
        import onnx
        import onnxruntime
    except ImportError as cause:
        raise MissingExtraError(
            "onnx and onnxruntime are not installed: pip install 'legibility[onnx]'"
        ) from cause
    return onnx, onnxruntime


class Graph:
    """A graph that grows by a node for each call; values are known by their names.

    Raises:
        MissingExtraError: onnx is not installed.
    """

    def __init__(self) -> None:
        self._onnx = _installed()[0]
        self._nodes: list[Any] = []
        self._constants: dict[tuple[str, tuple[int, ...], bytes], str] = {}

    def constant(self, value: Any) -> str:
        """Name of a constant: numbers, which are float32, or integers for shapes and indices."""
        array = value.numpy() if isinstance(value, Tensor) else np.asarray(value)
        array = array.astype(np.int64 if array.dtype.kind == "i" else np.float32)
        key = (array.dtype.str, array.shape, array.tobytes())  # the steps share their weights
        return self._constants.setdefault(key, f"constant_{len(self._constants)}")

    def __getattr__(self, kind: str) -> Any:
        """`graph.Add(x, 2.0)` is the name of a new node's output; what is no name is a constant.

        With `outputs` it is a list of names. All else are attributes of the node.
        """

        def node(*inputs: Any, outputs: int | None = None, **attributes: Any) -> Any:
            names = [f"{kind}_{len(self._nodes)}_{i}" for i in range(outputs or 1)]
            values = [x if isinstance(x, str) else self.constant(x) for x in inputs]
            self._nodes.append(self._onnx.helper.make_node(kind, values, names, **attributes))
            return names if outputs else names[0]

        return node

    def finished(self, inputs: dict[str, list[int | str]], output: str) -> bytes:
        """The serialised model of inputs by their shapes, in which a name is any number."""
        helper, kind = self._onnx.helper, self._onnx.TensorProto.FLOAT
        constants = [
            self._onnx.numpy_helper.from_array(np.frombuffer(data, dtype).reshape(shape), name)
            for (dtype, shape, data), name in self._constants.items()
        ]
        graph = helper.make_graph(
            self._nodes,
            "legibility",
            [helper.make_tensor_value_info(n, kind, shape) for n, shape in inputs.items()],
            [helper.make_tensor_value_info(output, kind, None)],
            constants,
        )
        opset = [helper.make_opsetid("", _OPSET)]
        return helper.make_model(graph, opset_imports=opset, ir_version=_IR).SerializeToString()


def silu(g: Graph, x: str) -> str:
    """x σ(x)."""
    return g.Mul(x, g.Sigmoid(x))


def linear(g: Graph, x: str, layer: nn.Linear) -> str:
    """Of rows `(N, C)`."""
    return _product(g, x, layer.weight, layer.bias)


def _product(g: Graph, x: str, weight: Tensor, bias: Tensor) -> str:
    return g.Gemm(x, weight, bias, transB=1)


def sequence(g: Graph, x: str, layers: nn.Sequential) -> str:
    """Linear layers and what is between them, of rows `(N, C)`."""
    for layer in layers:
        if isinstance(layer, nn.Linear):
            x = linear(g, x, layer)
        elif isinstance(layer, nn.SiLU):
            x = silu(g, x)
        elif isinstance(layer, nn.LayerNorm):
            x = g.LayerNormalization(x, layer.weight, layer.bias, epsilon=layer.eps)
        else:
            x = g.Add(x, sequence(g, x, layer.body))  # pyright: ignore
    return x


def fourier(g: Graph, value: str, num: int) -> str:
    column = g.Unsqueeze(value, [1])
    angles = g.Mul(column, np.arange(1, num + 1)[None] * np.pi / 2)
    return g.Concat(column, g.Sin(angles), g.Cos(angles), axis=1)


def ddim_step(
    g: Graph, latent: str, v: str, signal: Tensor, now: int, after: int | None
) -> tuple[str, str]:
    """What is denoised and the next latent, see `ddim`; after the last step they are the same."""
    kept, lost = signal[now].sqrt(), (1 - signal[now]).sqrt()
    clean = g.Sub(g.Mul(latent, kept), g.Mul(v, lost))
    if after is None:
        return clean, clean
    residue = g.Add(g.Mul(latent, lost), g.Mul(v, kept))
    kept, lost = signal[after].sqrt(), (1 - signal[after]).sqrt()
    return clean, g.Add(g.Mul(clean, kept), g.Mul(residue, lost))


def modulations(g: Graph, net: FiLMUNet, context: str, times: Tensor) -> list[list[str]]:
    """Scale and shift `(B, 1, C)` of each block, one after the other, at each of S steps.

    One matrix product for all blocks and steps; the affine part of the group normalisation before
    FiLM is in it.

    Args:
        g: the graph.
        net: the U-Net.
        context: `(B, E)`.
        times: `(S, E)`, what the steps add to it.
    """
    weights, biases, sizes = [], [], []
    for block in net.blocks():
        (scale, shift), (one, zero) = block.film.weight.chunk(2), block.film.bias.chunk(2)
        gain, offset = block.norms[0].weight, block.norms[0].bias
        weights += [gain[:, None] * scale, offset[:, None] * scale + shift]
        biases += [gain * (1 + one), offset * (1 + one) + zero]
        sizes += [len(gain)] * 2
    steps, size = times.shape
    condition = silu(g, g.Add(g.Unsqueeze(context, [0]), times[:, None]))
    found = _product(g, g.Reshape(condition, [-1, size]), torch.cat(weights), torch.cat(biases))
    found = g.Reshape(found, [steps, -1, 1, sum(sizes)])
    each = [g.Squeeze(g.Slice(found, [i], [i + 1], [0]), [0]) for i in range(steps)]
    return [g.Split(e, sizes, outputs=len(sizes), axis=-1) for e in each]


def unet(g: Graph, net: Any, x: str, size: int, modulations: Sequence[str]) -> str:
    """`FiLMUNet.modulated` of `x (B, K, inputs)`, K = `size`, by scales and shifts in turn."""
    each = iter(modulations)
    h = _convolution(g, net.inlet, x, size)
    skips = []
    for block, shrink in net.down:
        h = _block(g, block, h, size, each)
        skips.append(h)
        h = _convolution(g, shrink, h, size)
        size //= 2
    for block in net.middle:
        h = _block(g, block, h, size, each)
    for grow, block in net.up:
        h = g.Concat(_growth(g, grow, h, size), skips.pop(), axis=2)
        size *= 2
        h = _block(g, block, h, size, each)
    return g.Add(g.MatMul(h, net.outlet.weight[..., 0].T), net.outlet.bias)


def _block(g: Graph, block: Any, x: str, size: int, modulations: Any) -> str:
    scale, shift = next(modulations), next(modulations)
    first, second = block.norms
    h = _normalised(g, first, _convolution(g, block.first, x, size), size)
    h = silu(g, g.Add(g.Mul(h, scale), shift))
    h = _normalised(g, second, _convolution(g, block.second, h, size), size)
    h = silu(g, g.Add(g.Mul(h, second.weight), second.bias))
    if not isinstance(block.skip, nn.Identity):
        x = g.Add(g.MatMul(x, block.skip.weight[..., 0].T), block.skip.bias)
    return g.Add(x, h)


def _convolution(g: Graph, layer: Any, x: str, size: int) -> str:
    """`(B, K, C)` to `(B, K / stride, C′)`, one matrix product over windows."""
    stride = layer.stride[0]
    weight = layer.weight.transpose(1, 2).flatten(1)
    found = _product(g, _windows(g, x, size, stride, layer.in_channels), weight, layer.bias)
    return g.Reshape(found, [-1, size // stride, layer.out_channels])


def _growth(g: Graph, layer: Any, x: str, size: int) -> str:
    """`(B, K, C)` to `(B, 2K, C′)`, see `_Growth`: two outputs from each pair of neighbours."""
    after, even, odd, before = layer.weight.unbind(2)  # each (C, C′)
    nothing = torch.zeros_like(even)
    weight = torch.cat([
        torch.cat([before, even, nothing]), torch.cat([nothing, odd, after])
    ], dim=1)  # fmt: skip
    rows = _windows(g, x, size, 1, layer.in_channels)
    grown = _product(g, rows, weight.T, torch.cat([layer.bias, layer.bias]))
    return g.Reshape(grown, [-1, 2 * size, layer.out_channels])


def _windows(g: Graph, x: str, size: int, stride: int, channels: int) -> str:
    """`(B·K / stride, 3C)`, each point of `x (B, K, C)` between its neighbours."""
    places = np.arange(0, size, stride)[:, None] + np.arange(3)
    padded = g.Pad(x, [0, 1, 0, 0, 1, 0])
    return g.Reshape(g.Gather(padded, places.ravel(), axis=1), [-1, 3 * channels])


def _normalised(g: Graph, layer: nn.GroupNorm, x: str, size: int) -> str:
    """Of `(B, K, C)`, without the affine part."""
    groups, each = layer.num_groups, layer.num_channels // layer.num_groups
    x = g.Transpose(g.Reshape(x, [-1, size, groups, each]), perm=[0, 2, 1, 3])
    x = g.LayerNormalization(
        g.Reshape(x, [-1, groups, size * each]), np.ones(size * each), epsilon=layer.eps
    )
    x = g.Transpose(g.Reshape(x, [-1, groups, size, each]), perm=[0, 2, 1, 3])
    return g.Reshape(x, [-1, size, groups * each])
