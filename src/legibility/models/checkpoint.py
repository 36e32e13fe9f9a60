"""Tensors on disk: safetensors with a JSON header, written atomically, loaded strictly."""

import json
import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor, nn

from ..errors import CheckpointError
from ..files import write_bytes

_LOG = logging.getLogger(__name__)


def save_tensors(path: str | Path, tensors: Mapping[str, Tensor], header: Any = None) -> None:
    """Write `tensors` and a JSON `header` to `path`, atomically; the order of `tensors` is free."""
    plain = {k: tensors[k].detach().contiguous().cpu() for k in sorted(tensors)}
    metadata = {"header": json.dumps(header)}
    write_bytes(path, save(plain, metadata=metadata))


def load_tensors(path: str | Path) -> tuple[dict[str, Tensor], Any]:
    """The tensors and the header of `path`.

    Raises:
        CheckpointError: it is missing or corrupted.
    """
    if not Path(path).is_file():
        raise CheckpointError(f"there are no weights at {path}")
    try:
        with safe_open(path, framework="pt") as file:
            header = json.loads((file.metadata() or {}).get("header", "null"))
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except (SafetensorError, OSError, ValueError) as cause:
        raise CheckpointError(f"{path} is corrupted or not a safetensors file: {cause}") from cause
    _LOG.info("loaded %s", path)
    return tensors, header


def load_state(module: nn.Module, tensors: Mapping[str, Tensor], source: str | Path) -> None:
    """Copy `tensors` into the state of `module`; see `copy_tensors`."""
    copy_tensors(module.state_dict(), tensors, source)


@torch.no_grad()
def copy_tensors(
    state: Mapping[str, Tensor], tensors: Mapping[str, Tensor], source: str | Path
) -> None:
    """Copy `tensors` into those of `state`: the same names and shapes, all numbers finite.

    Raises:
        CheckpointError: they differ or are not finite; the message names the first difference.
    """
    missing, unknown = sorted(set(state) - set(tensors)), sorted(set(tensors) - set(state))
    if missing or unknown:
        raise CheckpointError(f"{source}: missing tensors {missing[:3]}, unknown {unknown[:3]}")
    for name, tensor in tensors.items():
        if tensor.shape != state[name].shape:
            raise CheckpointError(
                f"{source}: {name} has shape {tuple(tensor.shape)}, "
                f"the model's is {tuple(state[name].shape)}"
            )
        if tensor.is_floating_point() and not torch.isfinite(tensor).all():
            raise CheckpointError(f"{source}: {name} is not finite")
    for name, tensor in tensors.items():
        state[name].copy_(tensor)
