"""The machine itself: what it is, and the least time that it needs for a network's work."""

from __future__ import annotations

import os
import platform
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ..curves import NUM_WAYPOINTS
from ..models.path_diffuser import PathDiffuser
from ..training.team import Team
from .timing import Work, timed
from .workloads import bench_scene, levels, settle

__all__ = [
    "COPY_BYTES",
    "PRODUCT_FLOPS",
    "forward_cost",
    "limits",
    "load_average",
    "machine_facts",
    "operations",
]

_SIDE = 1024
_COPIED = 2**25  # numbers, more than any cache holds

PRODUCT_FLOPS = 2 * _SIDE**3
"""Operations of the product of `limits`."""

COPY_BYTES = 2 * 4 * _COPIED
"""Bytes that the copy of `limits` reads and writes."""


def machine_facts(device: torch.device) -> dict[str, Any]:
    """What the machine is, and how busy at the start."""
    affinity = getattr(os, "sched_getaffinity", None)
    return {
        "cpu": _cpu(),
        "cores": len(affinity(0)) if affinity else os.cpu_count(),
        "device": torch.cuda.get_device_name(device) if device.type == "cuda" else "cpu",
        "python": platform.python_version(),
        "torch": str(torch.__version__),
        "threads": torch.get_num_threads(),
        "load_before": load_average(),
    }


def _cpu() -> str:
    """The processor's own name where the system tells it."""
    try:
        text = Path("/proc/cpuinfo").read_text()
    except OSError:
        text = ""
    found = re.search(r"^model name\s*:\s*(.+)$", text, re.MULTILINE)
    return found[1].strip() if found else platform.processor() or platform.machine()


def load_average() -> float | None:
    """Processes that wanted to run in the last minute."""
    return os.getloadavg()[0] if hasattr(os, "getloadavg") else None


def limits(device: torch.device) -> dict[Any, Work]:
    """A product of matrices, by either library that PyTorch may ask, and a copy on `device`."""
    team = Team(device)
    one, two = torch.rand(2, _SIDE, _SIDE, device=device)
    product = torch.empty_like(one)
    source = torch.rand(_COPIED, device=device)
    target = torch.empty_like(source)

    def multiply() -> None:
        torch.mm(one, two, out=product)
        settle(device)

    def multiply_otherwise() -> None:
        with team.products():
            multiply()

    def copy() -> None:
        target.copy_(source)
        settle(device)

    return {
        "product": timed(multiply), "product otherwise": timed(multiply_otherwise),
        "copy": timed(copy),
    }  # fmt: skip


def forward_cost(model: PathDiffuser, batch: int) -> dict[str, int]:
    """What drawing `batch` paths in one scene needs: `flops` and `bytes`.

    The bytes are of parameters, inputs and outputs, each moved once.
    """
    device, dim = model.spread.device, model.config.dim
    conditions = model.conditions([bench_scene(dim)], [0]).map(lambda x: x.to(device))
    level = torch.from_numpy(levels(batch).astype(np.float32)).to(device)
    noise = torch.zeros(batch, NUM_WAYPOINTS, dim, device=device)
    drawn, flops = operations(lambda: PathDiffuser.sample(model, conditions, level, noise))
    inputs = [conditions.image, conditions.vector, conditions.slopes, conditions.intercepts]
    tensors = [*model.parameters(), *inputs, level, noise, drawn]
    return {
        "flops": flops,
        "bytes": sum(t.numel() * t.element_size() for t in tensors),
    }


def operations(call: Callable[[], Tensor]) -> tuple[Tensor, int]:
    """What `call` returns, and how many operations its products and convolutions are.

    A multiplication and the addition after it are two.
    """
    from torch.utils.flop_counter import FlopCounterMode

    with FlopCounterMode(display=False) as counter:
        found = call()
    return found, counter.get_total_flops()
