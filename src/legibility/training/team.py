"""The processes of a training: one alone, or several that a launcher started."""

from __future__ import annotations

import logging
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import torch
from torch import Tensor

from ..checks import one_of
from ..errors import InvalidInputError
from .configuration import PRECISIONS

_LOG = logging.getLogger(__name__)

_DTYPES: dict[str, torch.dtype] = dict(
    zip(PRECISIONS, (torch.float32, torch.bfloat16, torch.float16), strict=True)
)

_LAUNCHED = ("ACCELERATE_MIXED_PRECISION", "LOCAL_RANK")
"""Environment variables set by `accelerate launch` and by `torchrun`."""


@dataclass(frozen=True, eq=False)
class Team:
    """This process among those of a training, each of which computes its share of every batch.

    Attributes:
        device: of this process.
        rank: its number; 0 is the main process, which alone logs, validates and writes.
        size: number of processes.
        precision: of the network's products: no (float32), bf16 or fp16.
        accelerator: that of the package accelerate, if a launcher started the processes.
    """

    device: torch.device
    rank: int = 0
    size: int = 1
    precision: str = "no"
    accelerator: Any = None

    @classmethod
    def join(cls, device: str | None = None, precision: str | None = None) -> Team:
        """The team that `accelerate launch` or `torchrun` started, or this process alone.

        Args:
            device: cpu or cuda; if not given, accelerate's choice, or a GPU if there is one.
            precision: no, bf16 or fp16; if not given, the launcher's, or no.

        Raises:
            InvalidInputError: the device or the precision cannot be used here.
        """
        joined = _accelerator(device, precision)
        if joined is not None:
            precision = str(joined.mixed_precision)
        if precision is not None:
            one_of("precision", precision, PRECISIONS)
        where = joined.device if joined and device is None else choose_device(device)
        rank, size = (joined.process_index, joined.num_processes) if joined else (0, 1)
        precision = precision or "no"
        _LOG.info("process %d of %d, on %s, precision %s", rank + 1, size, where, precision)
        return cls(where, rank, size, precision, joined)

    @property
    def main(self) -> bool:
        """Whether this is the process that logs, validates and writes."""
        return self.rank == 0

    def share(self, batch: Tensor) -> Tensor:
        """This process's rows of a whole `batch`."""
        if len(batch) % self.size:
            raise InvalidInputError(
                f"a batch must be a multiple of the {self.size} processes, got {len(batch)} items"
            )
        return batch.chunk(self.size)[self.rank]

    def autocast(self) -> Any:
        """A context in which the network computes in the team's precision."""
        dtype = _DTYPES[self.precision]
        return torch.autocast(self.device.type, dtype, enabled=self.precision != "no")

    def scaler(self) -> torch.amp.GradScaler:
        """Keeps small gradients from vanishing in fp16; otherwise it does nothing."""
        return torch.amp.GradScaler(self.device.type, enabled=self.precision == "fp16")

    @contextmanager
    def main_first(self) -> Iterator[None]:
        """A context that the other processes enter after the main process has left it."""
        with self.accelerator.main_process_first() if self.accelerator else nullcontext():
            yield

    def mean(self, values: Sequence[Tensor]) -> list[Tensor]:
        """The means of `values` over all processes, in one message."""
        if self.size == 1:
            return list(values)
        flat = self.accelerator.reduce(torch.cat([v.flatten() for v in values]), "mean")
        parts = flat.split([v.numel() for v in values])
        return [part.view_as(v) for part, v in zip(parts, values, strict=True)]

    def leave(self) -> None:
        """End the group of processes when nothing more is sent.

        Otherwise a process may crash at its exit, as threads of gloo wait for Python's lock.
        """
        if self.accelerator is not None:
            self.accelerator.end_training()


def launched() -> bool:
    """Whether `accelerate launch` or `torchrun` started this process."""
    return any(name in os.environ for name in _LAUNCHED)


def _accelerator(device: str | None, precision: str | None) -> Any:
    """That of the package accelerate, or None if no launcher started this process."""
    if not launched():
        return None
    from accelerate import Accelerator

    # Imported later, this module would keep the group alive in defaults of its functions, and
    # `leave` could not end it.
    import_module("torch.distributed.nn.functional")
    try:
        return Accelerator(cpu=device == "cpu", mixed_precision=precision)
    except ValueError as cause:
        raise InvalidInputError(f"accelerate cannot be used here: {cause}") from cause


def choose_device(name: str | None) -> torch.device:
    """The device `name`, or a GPU where there is one."""
    try:
        device = torch.device(name or ("cuda" if torch.cuda.is_available() else "cpu"))
        torch.empty(1, device=device)
    except (RuntimeError, AssertionError) as cause:
        reason = str(cause).splitlines()[0]
        raise InvalidInputError(f"device {name!r} cannot be used here: {reason}") from cause
    return device
