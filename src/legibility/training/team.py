"""One process that trains alone, or one of several that a launcher started."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from typing import Any

import torch
from torch import Tensor

from ..errors import InvalidInputError

__all__ = ["Team", "choose_device"]

_DTYPES = {"no": torch.float32, "bf16": torch.bfloat16, "fp16": torch.float16}

_LAUNCHED = ("ACCELERATE_MIXED_PRECISION", "LOCAL_RANK")
"""Variables of which `accelerate launch` sets the first always, `torchrun` the second."""


@dataclass(frozen=True, eq=False)
class Team:
    """This process among those of a run, each of which trains on its share of every batch.

    Attributes:
        device: of this process.
        rank: its number; 0 is the main one, which alone logs, validates and writes.
        size: how many there are.
        precision: of the network's products: no (float32), bf16 or fp16.
        accelerator: accelerate's, if a launcher started the run.
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
            device: where to train; if not given, what accelerate chose, or a GPU if there is one.
            precision: no, bf16 or fp16; if not given, what the launcher was told, or no.

        Raises:
            InvalidInputError: the device or the precision cannot be used here.
        """
        if precision is not None and precision not in _DTYPES:
            raise InvalidInputError(
                f"precision must be one of {', '.join(_DTYPES)}, got {precision!r}"
            )
        if not any(name in os.environ for name in _LAUNCHED):
            return cls(choose_device(device), precision=precision or "no")
        from accelerate import Accelerator

        # Imported while there is a group, it would bind that group in defaults of its functions,
        # and `leave` could not end it.
        import_module("torch.distributed.nn.functional")

        try:
            joined = Accelerator(cpu=device == "cpu", mixed_precision=precision)
        except ValueError as cause:
            raise InvalidInputError(f"accelerate cannot be used here: {cause}") from cause
        where = joined.device if device is None else choose_device(device)
        precision = str(joined.mixed_precision)
        if precision not in _DTYPES:
            raise InvalidInputError(f"nothing here trains in {precision}")
        return cls(where, joined.process_index, joined.num_processes, precision, joined)

    @property
    def main(self) -> bool:
        """Whether this is the process that logs, validates and writes."""
        return self.rank == 0

    def shared(self, name: str, number: int) -> int:
        """What is left for each process of `number` things named `name` of a batch."""
        if number % self.size:
            raise InvalidInputError(
                f"{name} must be a multiple of the {self.size} processes, got {number}"
            )
        return number // self.size

    def share(self, batch: Tensor) -> Tensor:
        """This process's rows of a whole `batch`."""
        return batch.chunk(self.size)[self.rank]

    def autocast(self) -> Any:
        """A context in which the network computes in the team's precision."""
        if self.precision == "no":
            return nullcontext()
        return torch.autocast(self.device.type, dtype=_DTYPES[self.precision])

    @contextmanager
    def products(self) -> Iterator[None]:
        """A context in which products of float32 on a CPU are made by oneDNN.

        PyTorch leaves them to MKL, which on some processors is the slower one. What makes it ask
        oneDNN permits bfloat16 besides, and where that would be used MKL is kept. Which is quicker
        here is not asked, so that a run rounds as it did before it was interrupted.
        """
        before = torch.get_float32_matmul_precision()
        if self.device.type == "cpu" and _exact("medium"):
            torch.set_float32_matmul_precision("medium")
        try:
            yield
        finally:
            torch.set_float32_matmul_precision(before)

    @contextmanager
    def main_first(self) -> Iterator[None]:
        """A context that the others enter when the main process has left it."""
        with self.accelerator.main_process_first() if self.accelerator else nullcontext():
            yield

    def mean(self, values: Sequence[Tensor]) -> list[Tensor]:
        """The means of `values` over all processes, by one message."""
        if self.size == 1:
            return list(values)
        flat = self.accelerator.reduce(torch.cat([v.flatten() for v in values]), "mean")
        parts = flat.split([v.numel() for v in values])
        return [part.view_as(v) for part, v in zip(parts, values, strict=True)]

    def leave(self) -> None:
        """End the group of processes, once nothing more is sent; without, one may crash at its end.

        gloo's threads wait for Python's lock to give back what they sent.
        """
        if self.accelerator is not None:
            self.accelerator.end_training()

    def scaler(self) -> torch.amp.GradScaler:
        """What keeps small gradients from vanishing in fp16; in others it does nothing."""
        return torch.amp.GradScaler(self.device.type, enabled=self.precision == "fp16")


@cache
def _exact(precision: str) -> bool:
    """Whether this CPU's products stay float32 if a float32 matmul precision is permitted."""
    before = torch.get_float32_matmul_precision()
    torch.set_float32_matmul_precision(precision)
    try:
        fine = torch.full((256, 256), 1 + 2.0**-20)
        return torch.equal(fine @ torch.eye(256), fine)
    finally:
        torch.set_float32_matmul_precision(before)


def choose_device(name: str | None) -> torch.device:
    """The device `name`, or a GPU where there is one."""
    try:
        device = torch.device(name or ("cuda" if torch.cuda.is_available() else "cpu"))
        torch.empty(1, device=device)
    except (RuntimeError, AssertionError) as cause:
        reason = str(cause).splitlines()[0]
        raise InvalidInputError(f"device {name!r} cannot be used here: {reason}") from cause
    return device
