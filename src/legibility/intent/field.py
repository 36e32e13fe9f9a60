"""The information potential field: how well each point tells the target from the other goals."""

from __future__ import annotations

import functools
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from ..checks import (
    Array,
    count,
    finite_array,
    goals_array,
    positive,
    prior_array,
    target_index,
)
from ..errors import InvalidInputError

__all__ = ["InformationPotentialField", "potential_of_odds"]


class InformationPotentialField:
    """The posterior over goals of a Gaussian likelihood around each (paper, section V.A).

    `P(x|g) = N(x; g, σ²I)`, `P(g|x) = softmax_g(log P(g) − ‖x − g‖² / 2σ²)` (eq. 2) and
    `φ(x|g*) = −log P(g*|x)` (eq. 3).

    Args:
        goals: `(G, D)` [m], G ≥ 2.
        sigma: spread σ of the likelihood [m].
        prior: `(G,)`, the observer's P(g) before any motion; uniform if not given;
            normalised.

    Raises:
        InvalidInputError: fewer than two goals, σ ≤ 0, a prior that is not positive.
    """

    def __init__(self, goals: ArrayLike, sigma: float, prior: ArrayLike | None = None) -> None:
        self._goals = goals_array(goals).copy()
        self._sigma = positive("sigma", sigma)
        self._prior = prior_array(prior, len(self.goals))
        for array in (self._goals, self._prior):
            array.setflags(write=False)
        # ‖x − g‖² without the term that all goals share, about their mean: exact far away too.
        self._origin = self.goals.mean(axis=0)
        offsets = self.goals - self._origin
        with np.errstate(all="ignore"):
            variance = np.float64(self.sigma) ** 2
            self._slope = offsets.T / variance
            self._intercept = np.log(self.prior) - (offsets**2).sum(-1) / (2 * variance)
        if not (np.isfinite(self._slope).all() and np.isfinite(self._intercept).all()):
            raise InvalidInputError(
                f"sigma must not vanish beside the goals' distances, got {sigma}"
            )
        if not self._slope.any():
            raise InvalidInputError(f"sigma must tell the goals apart, got {sigma}")

    @property
    def goals(self) -> Array:
        """`(G, D)` [m]."""
        return self._goals

    @property
    def sigma(self) -> float:
        """σ [m]."""
        return self._sigma

    @property
    def prior(self) -> Array:
        """`(G,)`, P(g)."""
        return self._prior

    @property
    def num_goals(self) -> int:
        """G."""
        return len(self.goals)

    @property
    def dim(self) -> int:
        """D."""
        return self.goals.shape[-1]

    @np.errstate(under="ignore")
    def log_posterior(self, x: ArrayLike) -> Array:
        """`log P(g|x)` for every goal, `(..., G)`, of points `(..., D)` [m]."""
        logits = self._logits(finite_array("x", x, min_ndim=1, last=self.dim))
        logits -= logits.max(axis=-1, keepdims=True)  # log 2 is lost beside a large number
        return logits - np.logaddexp.reduce(logits, axis=-1, keepdims=True)

    @np.errstate(under="ignore")
    def posterior(self, x: ArrayLike) -> Array:
        """`P(g|x)` (eq. 2) for every goal, `(..., G)`, of points `(..., D)` [m]."""
        return np.exp(self.log_posterior(x))

    @np.errstate(under="ignore")
    def potential(self, x: ArrayLike, target: int) -> Array:
        """`φ(x|g*) = −log P(g*|x)` (eq. 3), `(...)` ≥ 0, of points `(..., D)` [m].

        Finite for every finite x, and exact to rounding where it is tiny.
        """
        target = target_index(target, self.num_goals)
        return self._potential(finite_array("x", x, min_ndim=1, last=self.dim), target)

    def _logits(self, x: Array) -> Array:
        return (x - self._origin) @ self._slope + self._intercept

    def _potential(self, x: Array, target: int) -> Array:
        """`potential` of checked points."""
        slope = np.delete(self._slope, target, axis=1) - self._slope[:, target, None]
        intercept = np.delete(self._intercept, target) - self._intercept[target]
        # One distractor at a time: sums over a short last axis are slow in NumPy.
        return potential_of_odds(
            [(x - self._origin) @ slope[:, g] + intercept[g] for g in range(len(intercept))]
        )

    def grid(self, workspace: ArrayLike, resolution: int, target: int) -> Array:
        """φ at the centres of a uniform grid over `workspace (2, D)` [m].

        Returns:
            `(H, W)` in 2D, with y along H and x along W; `(D, H, W)` in 3D, with z along the depth
            slices, which are the image's channels (paper, section V.A).
        """
        workspace = finite_array("workspace", workspace, ndim=2, last=self.dim)
        resolution = count("resolution", resolution)
        centres = (np.arange(resolution) + 0.5) / resolution
        axes = [low + centres * (high - low) for low, high in workspace.T]
        points = np.stack(np.meshgrid(*axes[::-1], indexing="ij")[::-1], axis=-1)
        return self.potential(points, target)


def potential_of_odds(odds: Sequence[np.ndarray] | np.ndarray) -> np.ndarray:
    """`φ = log(1 + Σ_g exp(odds_g))` (eq. 3) of log odds `log P(g|x) − log P(g*|x)`, `(...)`.

    Stable for odds of any size, and of their dtype.

    Args:
        odds: of each of the G − 1 distractors, `(...)`.
    """
    against = odds[0]
    if len(odds) > 1:
        top = functools.reduce(np.maximum, odds)
        against = top + np.log(sum(np.exp(o - top) for o in odds))
    return np.maximum(against, 0) + np.log1p(np.exp(-np.abs(against)))
