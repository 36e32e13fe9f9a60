"""Repeated timings, robust to background load."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

__all__ = ["Work", "interleaved", "summary", "timed"]

Work = Callable[[], list[float]]
"""Runs once and returns the durations of its repetitions [s]."""


def timed(call: Callable[[], object]) -> Work:
    """`call` as work of one repetition."""

    def work() -> list[float]:
        started = time.perf_counter()
        call()
        return [time.perf_counter() - started]

    return work


def interleaved(
    works: Sequence[Work], seconds: float, rounds: int, *, warm_up: bool = True
) -> list[list[float]]:
    """Durations [s] of each of `works`, which take turns: background load hits all alike.

    Args:
        works: to time.
        seconds: least time spent on each in a round; at least one run.
        rounds: number of turns of each.
        warm_up: run each once before, which does not count.
    """
    if warm_up:
        for work in works:
            work()
    times: list[list[float]] = [[] for _ in works]
    for _ in range(rounds):
        for work, durations in zip(works, times, strict=True):
            started = time.perf_counter()
            durations += work()
            while time.perf_counter() - started < seconds:
                durations += work()
    return times


def summary(values: Sequence[float]) -> dict[str, Any]:
    """Median of `values`, its 95 % interval `low` to `high`, and their number, `calls`.

    The interval lies between two order statistics, which is exact for independent values of any
    distribution; for fewer than six values it is their range.
    """
    from scipy.stats import binom

    ordered = np.sort(np.asarray(values, dtype=np.float64))
    skipped = max(0, int(binom.ppf(0.025, len(ordered), 0.5)) - 1)
    return {
        "median": float(np.median(ordered)),
        "low": float(ordered[skipped]),
        "high": float(ordered[-1 - skipped]),
        "calls": len(ordered),
    }
