"""Times of what is done many times on a machine that others use too."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from typing import Any, TypeVar

import numpy as np
import torch

from ..checks import Array

__all__ = ["Work", "figure", "interleaved", "on_threads", "power_law", "rate", "timed"]

Work = Callable[[], list[float]]
"""Does something and returns how long each piece of it took [s]."""

K = TypeVar("K", bound=Hashable)


def timed(call: Callable[[], object], pieces: int = 1) -> Work:
    """The work of one `call` that does `pieces` at once, each as long as the others."""

    def work() -> list[float]:
        started = time.perf_counter()
        call()
        return [(time.perf_counter() - started) / pieces]

    return work


def interleaved(
    works: Mapping[K, Work], seconds: float, rounds: int, *, warm_up: bool = True
) -> dict[K, list[list[float]]]:
    """Times [s] of each of `works` in each round, in turns, so that what disturbs hits all alike.

    Args:
        works: by name.
        seconds: spent on a work in a round, one call at least.
        rounds: of all works.
        warm_up: whether each is done once first, which does not count.
    """
    if warm_up:
        for work in works.values():
            work()
    found: dict[K, list[list[float]]] = {name: [] for name in works}
    for _ in range(rounds):
        for name, work in works.items():
            times: list[float] = []
            started = time.perf_counter()
            while not times or time.perf_counter() - started < seconds:
                times += work()
            found[name].append(times)
    return found


def figure(times: Sequence[Sequence[float]], scale: float = 1.0) -> dict[str, Any]:
    """Median of the times of all rounds, times `scale`, with a 95 % interval and their number.

    The interval is of two order statistics (exact for independent times, whatever they follow); of
    fewer than six times it is the shortest and the longest.
    """
    from scipy.stats import binom

    pooled = np.sort(np.concatenate([np.asarray(t, dtype=np.float64) for t in times])) * scale
    skipped = max(0, int(binom.ppf(0.025, len(pooled), 0.5)) - 1)
    return {
        "median": float(np.median(pooled)),
        "interval": [float(pooled[skipped]), float(pooled[-1 - skipped])],
        "calls": len(pooled),
    }


def rate(times: Sequence[Sequence[float]], scale: float = 1.0) -> dict[str, Any]:
    """`figure` of how many a second, times `scale`."""
    return figure([[scale / t for t in part] for part in times])


def power_law(sizes: Sequence[float] | Array, values: Sequence[float] | Array) -> float:
    """The exponent b of `values ≈ a · sizesᵇ`, by least squares of the logarithms."""
    return float(np.polyfit(np.log(sizes), np.log(values), 1)[0])


@contextlib.contextmanager
def on_threads(number: int) -> Iterator[None]:
    """PyTorch on `number` threads; backends take theirs from it."""
    before = torch.get_num_threads()
    torch.set_num_threads(number)
    try:
        yield
    finally:
        torch.set_num_threads(before)
