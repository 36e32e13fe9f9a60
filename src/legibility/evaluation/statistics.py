"""Statistics of the evaluations: intervals over scenes and of shares, paired tests."""

from collections.abc import Callable
from typing import Any

import numpy as np

from ..checks import Array


def bootstrap_interval(
    values: Array, statistic: Callable[..., Array] = np.mean, level: float = 0.95
) -> tuple[float, float]:
    """Percentile bootstrap interval (Efron 1979) of `statistic` over `values (N,)`, seeded."""
    from scipy.stats import bootstrap

    values = np.asarray(values, dtype=np.float64)
    if len(values) < 2 or np.ptp(values) == 0:
        only = float(statistic(values))
        return only, only
    interval = bootstrap(
        (values,),
        statistic,
        confidence_level=level,
        method="percentile",
        n_resamples=4000,
        rng=np.random.default_rng(0),
    ).confidence_interval
    return float(interval.low), float(interval.high)


def paired_test(first: Array, second: Array) -> dict[str, float | list[float]]:
    """Wilcoxon's signed-rank test (1945) of `first` against `second (N,)`, paired, two-sided.

    Returns `p`; `effect`, the matched-pairs rank-biserial correlation (Kerby 2014), 1 where `first`
    is the greater in every pair; `difference`, the mean of first − second, and its `interval`.
    """
    from scipy.stats import wilcoxon

    difference = np.asarray(first, dtype=np.float64) - np.asarray(second, dtype=np.float64)
    # Differences of rounding count as equal.
    scale = np.maximum(np.abs(first), np.abs(second))
    apart = difference[np.abs(difference) > 1e-12 * scale]
    p, effect = 1.0, 0.0
    if number := len(apart):
        test: Any = wilcoxon(apart)
        positive: Any = wilcoxon(apart, alternative="greater")
        p, effect = float(test.pvalue), 4 * float(positive.statistic) / (number * (number + 1)) - 1
    return {
        "p": p,
        "effect": effect,
        "difference": float(difference.mean()),
        "interval": list(bootstrap_interval(difference)),
    }


def holm(p_values: Array) -> Array:
    """p-values `(N,)` adjusted for N tests by Holm's step-down method (1979), `(N,)`."""
    p_values = np.asarray(p_values, dtype=np.float64)
    order = np.argsort(p_values)
    adjusted = np.maximum.accumulate(p_values[order] * np.arange(len(order), 0, -1))
    result = np.empty_like(adjusted)
    result[order] = np.minimum(adjusted, 1)
    return result


def rank_correlation(asked: Array, achieved: Array) -> float:
    """Spearman's correlation of two arrays `(N,)`; 0 where one of them is constant."""
    from scipy.stats import spearmanr

    # Rounded, so that differences of rounding are ties.
    asked, achieved = np.round(asked, 9), np.round(achieved, 9)
    if np.ptp(asked) == 0 or np.ptp(achieved) == 0:
        return 0.0
    result: Any = spearmanr(asked, achieved)
    return float(result.statistic)


def spearman_ceiling(asked: Array, error: float, draws: int = 64) -> float:
    """Spearman's correlation with `asked (N,)` of labels that err by nothing but noise.

    The noise is normal, seeded, its mean absolute value is `error`, and labels are clipped to
    [−1, 1]. Where levels repeat, the ceiling is below 1 without any noise: samples of a level
    differ.
    """
    rng = np.random.default_rng(0)
    spread = max(error, 1e-6) * np.sqrt(np.pi / 2)
    noisy = np.clip(asked + spread * rng.normal(size=(draws, len(asked))), -1, 1)
    return float(np.mean([rank_correlation(asked, labels) for labels in noisy]))


def share_interval(happened: np.ndarray, level: float = 0.95) -> tuple[float, float]:
    """Exact interval (Clopper & Pearson 1934) of the share of `happened (N,)` bool."""
    from scipy.stats import binomtest

    interval = binomtest(int(happened.sum()), len(happened)).proportion_ci(level, method="exact")
    return float(interval.low), float(interval.high)


def summary(values: Array) -> dict[str, float | list[float]]:
    """Mean over scenes with its 95 % interval, the median, and the least and greatest value."""
    values = np.asarray(values, dtype=np.float64)
    return {
        "mean": float(values.mean()),
        "interval": list(bootstrap_interval(values)),
        "median": float(np.median(values)),
        "min": float(values.min()),
        "max": float(values.max()),
    }
