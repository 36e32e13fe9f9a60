"""Statistics of the evaluations: intervals over scenes and of shares."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..checks import Array
from ..intent.observers import time_to_confidence

__all__ = [
    "CONFIDENT",
    "bootstrap_interval",
    "clear_step",
    "rank_correlation",
    "share_interval",
    "summary",
]

CONFIDENT = 0.8
"""From this P(target) on, held for good, the intent is clear."""


def bootstrap_interval(
    values: Array, statistic: Callable[..., Array] = np.mean, level: float = 0.95
) -> tuple[float, float]:
    """Percentile bootstrap interval (Efron 1979) of `statistic` over `values (N,)`, seeded."""
    from scipy.stats import bootstrap

    values = np.asarray(values, dtype=np.float64)
    if len(values) < 2 or np.ptp(values) == 0:
        only = float(statistic(values))
        return only, only
    found = bootstrap(
        (values,),
        statistic,
        confidence_level=level,
        method="percentile",
        n_resamples=4000,
        rng=np.random.default_rng(0),
    ).confidence_interval
    return float(found.low), float(found.high)


def clear_step(posterior: Array, target: int) -> int | None:
    """From which state of `posterior (T, G)` on the intent is clear; None if it never is."""
    share = float(time_to_confidence(posterior, target, CONFIDENT))
    return round(share * (len(posterior) - 1)) if np.isfinite(share) else None


def rank_correlation(asked: Array, achieved: Array) -> float:
    """Spearman's correlation of two arrays `(N,)`; 0 where one of them is constant."""
    from scipy.stats import rankdata

    # Rounded, so that what differs by rounding alone is a tie.
    ranks = np.stack([rankdata(np.round(x, 9)) for x in (asked, achieved)])
    ranks -= ranks.mean(axis=1, keepdims=True)
    norms = np.linalg.norm(ranks, axis=1)
    return float(ranks[0] @ ranks[1] / norms.prod()) if norms.all() else 0.0


def share_interval(happened: np.ndarray, level: float = 0.95) -> tuple[float, float]:
    """Exact interval (Clopper & Pearson 1934) of the share of `happened (N,)` bool."""
    from scipy.stats import binomtest

    found = binomtest(int(happened.sum()), len(happened)).proportion_ci(level, method="exact")
    return float(found.low), float(found.high)


def summary(values: Array) -> dict[str, float | list[float]]:
    """Mean over scenes with its 95 % interval, and the worst and best scene."""
    values = np.asarray(values, dtype=np.float64)
    return {
        "mean": float(values.mean()),
        "interval": list(bootstrap_interval(values)),
        "min": float(values.min()),
        "max": float(values.max()),
    }
