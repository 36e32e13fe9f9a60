"""The information potential field: how clearly each point reveals the target."""

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..checks import Array, count, finite_array, goals_array, positive, prior_array, target_index
from ..errors import InvalidInputError


@dataclass(frozen=True, eq=False, init=False)
class InformationPotentialField:
    """The posterior over goals of a Gaussian likelihood around each (paper, section V.A).

    `P(x|g) = N(x; g, σ²I)`, `P(g|x) = softmax_g(log P(g) − ‖x − g‖² / 2σ²)` (eq. 2) and
    `φ(x|g*) = −log P(g*|x)` (eq. 3).

    Args:
        goals: `(G, D)` [m], G ≥ 2.
        sigma: spread σ of the likelihood [m].
        prior: `(G,)`, P(g) before any motion, normalised; uniform if not given.

    Raises:
        InvalidInputError: fewer than two goals, σ ≤ 0, a prior that is not positive.
    """

    goals: Array
    sigma: float
    prior: Array
    _origin: Array
    _slope: Array
    _intercept: Array

    def __init__(self, goals: ArrayLike, sigma: float, prior: ArrayLike | None = None) -> None:
        goals, sigma = goals_array(goals).copy(), positive("sigma", sigma)
        prior = prior_array(prior, len(goals))
        goals.setflags(write=False)
        prior.setflags(write=False)
        # ‖x − g‖² without the term that all goals share, about their mean: exact far away too.
        origin = goals.mean(axis=0)
        offsets = goals - origin
        with np.errstate(all="ignore"):
            variance = np.float64(sigma) ** 2
            slope = offsets.T / variance
            intercept = np.log(prior) - (offsets**2).sum(-1) / (2 * variance)
        if not (np.isfinite(slope).all() and np.isfinite(intercept).all()):
            raise InvalidInputError(
                f"sigma must not vanish beside the goals' distances, got {sigma}"
            )
        if not slope.any():
            raise InvalidInputError(f"sigma must tell the goals apart, got {sigma}")
        vars(self).update(goals=goals, sigma=sigma, prior=prior)
        vars(self).update(_origin=origin, _slope=slope, _intercept=intercept)

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
        x = finite_array("x", x, min_ndim=1, last=self.dim)
        logits = (x - self._origin) @ self._slope + self._intercept
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
        x = finite_array("x", x, min_ndim=1, last=self.dim)
        slope = self._slope - self._slope[:, target, None]
        intercept = self._intercept - self._intercept[target]
        offset = x - self._origin
        # One distractor at a time: sums over a short last axis are slow in NumPy.
        others = (g for g in range(self.num_goals) if g != target)
        return potential_of_odds([offset @ slope[:, g] + intercept[g] for g in others])

    def grid(self, workspace: ArrayLike, resolution: int, target: int) -> Array:
        """φ at the centres of a uniform grid over `workspace (2, D)` [m].

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
