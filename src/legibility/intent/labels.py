"""Labels ℓ in [−1, 1]: the rank of a score among those of one scene and target.

`scores` are `(N,)` of one scene and target, higher = more legible.
"""

import numpy as np
from numpy.typing import ArrayLike

from ..checks import Array, finite_array
from ..errors import InvalidInputError

LABELS = ("anchored", "rank")
"""The two ways to label; `anchored` is the default everywhere."""


def rank_label(scores: ArrayLike) -> Array:
    """`ℓ = 2·rank/(N − 1) − 1` (paper, section V.B), `(N,)`; equal scores share their mean rank.

    −1 is the most ambiguous and 1 the most legible of `scores (N,)`; a single score is 0.
    """
    scores = _scores(scores)
    if len(scores) == 1:
        return np.zeros(1)
    return 2 * _mean_rank(scores) / (len(scores) - 1) - 1


def anchored_label(scores: ArrayLike, straight_score: float) -> Array:
    """Rank on either side of the straight line's score, `(N,)`: ℓ = 0 *is* the straight line.

    Or the shortest curve, where something is in its way.

    The n scores above the straight line's are labelled 1/n, 2/n, …, 1 in rising order, those below
    −1/n, −2/n, …, −1 in falling order; equal scores share their mean rank.
    """
    scores = _scores(scores)
    straight = float(finite_array("straight_score", straight_score, ndim=0))
    labels = np.zeros(len(scores))
    above, below = scores > straight, scores < straight
    if above.any():
        labels[above] = (1 + _mean_rank(scores[above])) / above.sum()
    if below.any():
        labels[below] = -(1 + _mean_rank(-scores[below])) / below.sum()
    return labels


def label_knots(scores: ArrayLike, labels: ArrayLike) -> tuple[Array, Array]:
    """Rising scores and their labels, the knots of linear interpolation from one to the other."""
    scores = _scores(scores)
    labels = finite_array("labels", labels, ndim=1)
    if labels.shape != scores.shape:
        raise InvalidInputError(
            f"labels must be as many as scores, {len(scores)}, got {len(labels)}"
        )
    knots, first = np.unique(scores, return_index=True)
    return knots, labels[first]


def _mean_rank(values: Array) -> Array:
    """Ranks from 0; equal values share their mean rank."""
    _, inverse, counts = np.unique(values, return_inverse=True, return_counts=True)
    return (np.cumsum(counts) - 1 - (counts - 1) / 2)[inverse]


def _scores(scores: ArrayLike) -> Array:
    scores = finite_array("scores", scores, ndim=1)
    if not len(scores):
        raise InvalidInputError("scores must not be empty")
    return scores
