"""Both stages as ONNX graphs for onnxruntime: the results of PyTorch to rounding, in less time.

A graph depends on a stage's settings, not on its weights: a session takes those from the model. So
a small file beside the weights is enough, and retraining needs no new export.
"""

import contextlib
import hashlib
import json
import logging
import re
import warnings
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from ..checks import Array
from ..curves import NUM_WAYPOINTS
from ..errors import CheckpointError, InvalidInputError, MissingExtraError, OutputError
from ..files import write_bytes
from ..scene import Scene
from .conditions import Conditions
from .path_diffuser import DIAL_LEVELS, PathDiffuser
from .path_policy import Observation, PathPolicy

_VERSION = 9
"""Version of the graphs; raising it makes stored graphs be exported again."""

_TRACED = (
    "dim", "field", "channels", "condition", "encoder_width", "resolution", "squash",
    "chunk",
    "diffusion_steps", "sampling_steps", "guidance",
)  # fmt: skip
"""Settings that a graph depends on."""


_NUMBERS = (
    dict.fromkeys(("slopes", "intercepts", "distractors"), "M")
    | dict.fromkeys(("centers", "axes", "halves", "radii"), "O")
    | {"vertices": "Q", "polygon_radii": "Q", "solid_features": "N"}
)
"""Inputs of any number of distractors, solids, polygons and features along their second axis."""


class _OnnxStage:
    """A stage in onnxruntime, with its own steps and guidance and its present weights.

    Args:
        model: the stage; later changes of its weights are not seen.
        graph: see `load_graph`.

    Raises:
        CheckpointError: the graph does not run.
        MissingExtraError: onnxruntime is not installed.
    """

    def __init__(self, model: Any, graph: bytes) -> None:
        self.model, self.graph, self.config = model, graph, model.config
        self._session, self._weights = _session(model, graph)
        self._read = {node.name for node in self._session.get_inputs()}  # none for polygons in 3D

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.model, self.graph)  # a session cannot go to another process

    def _run(self, options: dict[str, float | None], **inputs: np.ndarray) -> list[np.ndarray]:
        """The outputs for `inputs`; raises if the options differ from the model's."""
        for name, value in options.items():
            fixed = getattr(self.config, name)
            if value is not None and value != fixed:
                raise InvalidInputError(
                    f"{name.removeprefix('sampling_')} must be the model's own {fixed:g} with "
                    f"backend 'onnx', got {value:g}; backend 'torch' takes others"
                )
        return self._session.run(None, {k: v for k, v in inputs.items() if k in self._read})


class OnnxPathDiffuser(_OnnxStage):
    """Draws the paths of `PathDiffuser.sample`, to rounding; for its arguments see `_OnnxStage`."""

    def sample(
        self,
        conditions: Conditions,
        level: Tensor,
        noise: Tensor,
        *,
        guidance: float | None = None,
        steps: int | None = None,
        dial: Tensor | None = None,
    ) -> Tensor:
        """See `PathDiffuser.sample`.

        Raises:
            InvalidInputError: the guidance or the steps are not the model's own.
        """
        size, several = len(level), len(conditions.vector) > 1
        (waypoints,) = self._run(
            {"guidance": guidance, "sampling_steps": steps},
            **{name: tensor.numpy() for name, tensor in vars(conditions).items()},
            **({} if dial is None else {"dial": dial.numpy()}),
            scene=np.arange(size) if several else np.zeros(size, dtype=np.int64),
            level=level.numpy(),
            noise=noise.numpy(),
        )
        return torch.from_numpy(waypoints)


class OnnxPathPolicy(_OnnxStage):
    """Acts as `PathPolicy` does, to rounding; for its arguments see `_OnnxStage`."""

    def act(self, observation: Observation, steps: int | None = None) -> Array:
        """See `PathPolicy.act`.

        Raises:
            InvalidInputError: the steps are not the model's own.
        """
        (actions,) = self._run(
            {"sampling_steps": steps}, features=observation.features, has_path=observation.has_path
        )
        return actions.astype(np.float64) * self.config.limit @ observation.rotation


def load_graph(model: PathDiffuser | PathPolicy, folder: str | Path | None = None) -> bytes:
    """The graph of a stage: the one in `folder`, or exported now and kept there.

    To export takes up to a minute. A graph of other settings is replaced; a folder that cannot be
    written to keeps none.

    Raises:
        MissingExtraError: the graph must be exported and onnxscript is not installed.
    """
    _onnxruntime()
    if folder is None:
        return export_graph(model)
    file = Path(folder) / ("path.onnx" if isinstance(model, PathDiffuser) else "policy.onnx")
    if file.is_file() and _fingerprint(model).encode() in (graph := file.read_bytes()):
        return graph
    warnings.warn(f"exporting {file.name}, which takes up to a minute, once", stacklevel=4)
    graph = export_graph(model)
    with contextlib.suppress(OutputError):
        write_bytes(file, graph)
    return graph


def export_graph(model: PathDiffuser | PathPolicy) -> bytes:
    """The serialised ONNX model of a stage with its own steps and guidance, without its weights.

    Raises:
        MissingExtraError: onnxscript is not installed.
    """
    try:
        import onnx_ir as ir
        from onnxscript import optimizer
    except ImportError as cause:
        raise MissingExtraError(
            "no ONNX graph fits the model's settings yet, and onnxscript, which exports one, is "
            "not installed: pip install 'legibility[export]'"
        ) from cause
    with _quiet(), torch.no_grad(), torch.device("cpu"):
        example = _example(model)
        values, axes = zip(*example.values(), strict=True)
        program: Any = torch.onnx.export(
            _Traced(model).eval(), values, dynamo=True, dynamic_shapes=(axes,), optimize=False,
            input_names=list(example), verbose=False,
        )  # fmt: skip
    graph = program.model.graph
    tensors = _tensors(model)
    # As inputs the weights are unknown to the optimizer, which would fold them into constants.
    weights = {name: graph.initializers[name] for name in tensors if name in graph.initializers}
    for name, value in weights.items():
        del graph.initializers[name]
        value.const_value = None
        graph.inputs.append(value)
    optimizer.optimize(program.model)
    for value in weights.values():
        graph.inputs.remove(value)
    used = {name: value for name, value in weights.items() if value.uses()}
    for name, value in used.items():
        shape = ir.Shape(tensors[name].shape)
        value.const_value = ir.ExternalTensor(
            "weights", 0, None, ir.DataType.FLOAT, shape=shape, name=name
        )
        graph.register_initializer(value)
    program.model.metadata_props["weights"] = f"<weights>{' '.join(used)}</weights>"
    for node in graph:  # the exporter's notes are ten times as long as the graph
        node.metadata_props.clear()
    program.model.metadata_props["settings"] = _fingerprint(model)
    return ir.to_proto(program.model).SerializeToString()


class _Traced(nn.Module):
    """The part of a stage that a graph computes; its inputs are those of `_example`."""

    def __init__(self, model: PathDiffuser | PathPolicy) -> None:
        super().__init__()
        self.model = model

    def forward(self, *inputs: Tensor) -> Tensor:
        if isinstance(self.model, PathPolicy):
            features, has_path = inputs
            return self.model.denoise(features, has_path)
        *scenes, scene, level, noise = inputs
        dial = scenes.pop() if self.model.config.field else None
        conditions = Conditions(*scenes)
        rows = conditions.without_image().map(lambda x: x.index_select(0, scene))
        encoded = self.model.encode_scene(conditions, dial).index_select(0, scene)
        return self.model.draw(rows, encoded, level, noise)


def _example(model: PathDiffuser | PathPolicy) -> dict[str, tuple[Tensor, dict[int, Any]]]:
    """Inputs of `_Traced` by name: a value, and the axes that may have any size."""
    rows, scenes = (torch.export.Dim(name) for name in "BS")
    if isinstance(model, PathPolicy):
        return {
            "features": (torch.zeros(5, model.observe.in_features), {0: rows}),
            "has_path": (torch.ones(5, dtype=torch.bool), {0: rows}),
        }
    dim, rng = model.config.dim, np.random.default_rng(0)
    drawn = [Scene.random(rng, dim=dim, num_goals=4) for _ in range(3)]
    seen = model.conditions(drawn, [0, 0, 0], [model.config.observer] * 3)
    inputs = {}
    sizes = {name: torch.export.Dim(name) for name in _NUMBERS.values()}
    for field in fields(Conditions):
        value = getattr(seen, field.name)
        number = _NUMBERS.get(field.name)
        if number is None or not value.shape[1]:  # no polygons in 3D
            inputs[field.name] = (value, {0: scenes})
            continue
        value = torch.cat([value, value[:, :1]], dim=1) if value.shape[1] == 1 else value
        inputs[field.name] = (value, {0: scenes, 1: sizes[number]})
    if model.config.field:
        inputs["dial"] = (torch.zeros(3, len(DIAL_LEVELS)), {0: scenes})
    return inputs | {
        "scene": (torch.tensor([0, 1, 2, 1, 0]), {0: rows}),
        "level": (torch.zeros(5), {0: rows}),
        "noise": (torch.zeros(5, NUM_WAYPOINTS, dim), {0: rows}),
    }


def _fingerprint(model: PathDiffuser | PathPolicy) -> str:
    """Of everything that a graph depends on."""
    settings = model.config.to_dict()
    traced = {name: settings.get(name) for name in _TRACED}
    text = json.dumps([_VERSION, type(model).__name__, traced])
    return hashlib.sha256(text.encode()).hexdigest()


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Without the exporter's advice to its developers."""
    logger = logging.getLogger("torch.onnx")
    level = logger.level
    logger.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logger.setLevel(level)


def _onnxruntime() -> Any:
    try:
        import onnxruntime
    except ImportError as cause:
        raise MissingExtraError(
            "onnxruntime is not installed: pip install 'legibility[onnx]'"
        ) from cause
    return onnxruntime


def _tensors(model: nn.Module) -> dict[str, Tensor]:
    """Parameters and buffers by their names in a graph."""
    named = (*model.named_parameters(), *model.named_buffers())
    return {f"model.{name}": tensor for name, tensor in named}


def _session(model: nn.Module, graph: bytes) -> tuple[Any, list[Any]]:
    """An onnxruntime session on one thread, and the weights that it reads."""
    onnxruntime = _onnxruntime()
    tensors = _tensors(model)
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 4
    try:
        listed = re.search(rb"<weights>(.*?)</weights>", graph)
        names = listed[1].decode().split() if listed else []
        arrays = [np.array(tensors[n].detach().numpy(), np.float32, order="C") for n in names]
        weights = [onnxruntime.OrtValue.ortvalue_from_numpy(array) for array in arrays]
        options.add_external_initializers(names, weights)
        session = onnxruntime.InferenceSession(
            graph, options, providers=["CPUExecutionProvider"], enable_fallback=False
        )
    except Exception as cause:  # onnxruntime has one class an error, and no base class for them
        raise CheckpointError(f"onnxruntime cannot run the model's graph: {cause}") from cause
    return session, [arrays, weights]
