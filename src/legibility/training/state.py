"""The state of a training, as its checkpoint holds it: weights, optimiser, position and log."""

from __future__ import annotations

import copy
import json
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np
import torch
from torch import Tensor, nn

from ..errors import CheckpointError
from ..files import write_bytes
from ..models.checkpoint import load_state, load_tensors, save_tensors
from .configuration import TrainingConfig

_FORMAT = 1

M = TypeVar("M", bound=nn.Module)


@dataclass
class Log:
    """Metrics over the steps of a training.

    Attributes:
        rows: of each logged step `step`, `seconds` since the start [s] and its metrics by name.
    """

    rows: list[dict[str, float]] = field(default_factory=list)

    @property
    def last(self) -> dict[str, float]:
        """The latest value of each metric."""
        return {name: value for row in self.rows for name, value in row.items()}

    @property
    def step_seconds(self) -> float:
        """Duration of a step [s] in the fastest tenth of the log, as if nothing else ran."""
        times = np.array([[row["step"], row["seconds"]] for row in self.rows])
        steps, seconds = np.diff(times, axis=0, prepend=np.zeros((1, 2))).T
        return float(np.quantile(seconds / steps, 0.1))

    def write(self, path: Path) -> None:
        """Write the rows to `path` as JSON lines."""
        write_bytes(path, "".join(json.dumps(row) + "\n" for row in self.rows).encode())


class State(Generic[M]):
    """Everything from which a training goes on bit for bit.

    The log is part of it, so `log.jsonl` never disagrees with the checkpoint after a resume.

    Args:
        model: what is trained, on its device.
        config: how it is trained.

    Attributes:
        average: moving average of the model's weights, the result of the training.
        optimizer: AdamW over the trained parameters.
        step: steps that are done.
        seconds: duration so far [s].
        log: metrics so far.
    """

    def __init__(self, model: M, config: TrainingConfig) -> None:
        self.model = model
        self.average = copy.deepcopy(model).requires_grad_(False).eval()
        self.optimizer = torch.optim.AdamW(
            self.parameters, lr=config.learning_rate, weight_decay=config.weight_decay, fused=True
        )
        self.step, self.seconds, self.log = 0, 0.0, Log()

    @property
    def parameters(self) -> list[nn.Parameter]:
        """The trained parameters."""
        return [p for p in self.model.parameters() if p.requires_grad]

    @torch.no_grad()
    def update_average(self, decay: float) -> None:
        """Move the average towards the model's weights."""
        for old, new in zip(self.average.parameters(), self.model.parameters(), strict=True):
            old.lerp_(new, 1 - decay)

    def save(self, path: Path, settings: dict[str, Any]) -> None:
        """Write a checkpoint of a training of `settings`, plain values that fix its weights."""
        tensors = {f"model.{k}": v for k, v in self.model.state_dict().items()}
        tensors |= {f"average.{k}": v for k, v in self.average.state_dict().items()}
        for index, moments in self.optimizer.state_dict()["state"].items():
            tensors |= {f"optimizer.{index}.{k}": v for k, v in moments.items()}
        save_tensors(path, tensors, {
            "format": _FORMAT, "settings": settings, "step": self.step, "seconds": self.seconds,
            "log": self.log.rows,
        })  # fmt: skip

    def restore(self, path: Path, settings: dict[str, Any]) -> None:
        """Go on from the checkpoint at `path`.

        Raises:
            CheckpointError: it is corrupted, of another format or of other settings; the message
                names the first settings that differ.
        """
        tensors, header = load_tensors(path)
        if not isinstance(header, dict) or "format" not in header:
            raise CheckpointError(f"{path} is not a training checkpoint")
        if header["format"] != _FORMAT:
            raise CheckpointError(
                f"{path} has format {header['format']!r}; this version reads {_FORMAT}"
            )
        try:
            kept, step, seconds = header["settings"], int(header["step"]), float(header["seconds"])
            log = Log([dict(row) for row in header["log"]])
            changes = list(_differences(kept, json.loads(json.dumps(settings))))
        except (AttributeError, LookupError, TypeError, ValueError) as cause:
            raise CheckpointError(f"{path} is not a training checkpoint") from cause
        if changes:
            raise CheckpointError(f"{path} is of another run: {'; '.join(changes[:3])}")
        self._load(tensors, path)
        self.step, self.seconds, self.log = step, seconds, log

    def _load(self, tensors: dict[str, Tensor], path: Path) -> None:
        groups: dict[str, dict[str, Tensor]] = {"model": {}, "average": {}, "optimizer": {}}
        for name, tensor in tensors.items():
            group, _, rest = name.partition(".")
            groups.setdefault(group, {})[rest] = tensor
        load_state(self.model, groups["model"], path)
        load_state(self.average, groups["average"], path)
        moments: dict[int, dict[str, Tensor]] = {}
        for index, parameter in enumerate(self.parameters):
            shapes = {"step": (), "exp_avg": parameter.shape, "exp_avg_sq": parameter.shape}
            moments[index] = {}
            for key, shape in shapes.items():
                tensor = groups["optimizer"].get(f"{index}.{key}")
                if tensor is None or tensor.shape != shape or not torch.isfinite(tensor).all():
                    raise CheckpointError(f"{path}: optimizer.{index}.{key} is missing or broken")
                # Laid out as the weight, since the fused step rounds by the place in memory.
                moments[index][key] = torch.empty_like(parameter if shape else tensor).copy_(tensor)
        self.optimizer.load_state_dict({**self.optimizer.state_dict(), "state": moments})


def _differences(kept: dict[str, Any], now: dict[str, Any], prefix: str = "") -> Iterator[str]:
    """The settings of a checkpoint that are not those of `now`, each with both values."""
    for name in {**now, **kept}:
        old, new = kept.get(name), now.get(name)
        if isinstance(old, dict) and isinstance(new, dict):
            yield from _differences(old, new, f"{prefix}{name}.")
        elif old != new:
            yield f"{prefix}{name} is {old!r} in the checkpoint and {new!r} now"
