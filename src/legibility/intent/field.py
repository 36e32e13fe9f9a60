"""The information potential field: how clearly each point reveals the target."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..checks import (
    Array,
    bounded,
    count,
    finite_array,
    goals_array,
    positive,
    prior_array,
    target_index,
)
from ..errors import InvalidInputError

_FARTHEST = 1e100  # of a coordinate; points beyond it are drawn in along their direction
_ROUNDING = 1e-9


@dataclass(frozen=True, eq=False, init=False, repr=False)
class Field:
    """The posterior over goals of an observer who reads a position.

    Each goal has an energy `E_g(x) = ½ (x − g)ᵀ P (x − g) + β ‖x − g‖`, and
    `P(g|x) = softmax_g(log P(g) − E_g(x))`, `φ(x|g*) = −log P(g*|x)` (paper, eq. 2 and 3). With
    β = 0 the likelihood of a position is Gaussian; with P = 0 the observer is that of Dragan et al.
    (HRI 2013), for whom the cost of a motion is its length.

    Args:
        goals: `(G, D)` [m], G ≥ 2.
        precision: P `(D, D)` [1/m²], the inverse covariance of each goal's likelihood, positive
            semi-definite; 0 if not given.
        beta: rationality β [1/m], at least 0.
        log_prior: `(G,)`, log P(g) up to a constant; uniform if not given.

    Raises:
        InvalidInputError: fewer than two goals, or an observer who cannot tell the goals apart.
    """

    goals: Array
    precision: Array
    beta: float
    log_prior: Array
    _origin: Array
    _slope: Array
    _intercept: Array

    def __init__(
        self,
        goals: ArrayLike,
        precision: ArrayLike | None = None,
        beta: float = 0.0,
        log_prior: ArrayLike | None = None,
    ) -> None:
        goals = goals_array(goals).copy()
        num, dim = goals.shape
        beta = bounded("beta", beta, 0)
        precision = np.zeros((dim, dim)) if precision is None else precision
        precision = finite_array("precision", precision, ndim=2, last=dim).copy()
        if precision.shape != (dim, dim) or not _is_semidefinite(precision):
            raise InvalidInputError(
                f"precision must be positive semi-definite and {dim} by {dim}, "
                f"got {precision.tolist()}"
            )
        log_prior = np.zeros(num) if log_prior is None else log_prior
        log_prior = finite_array("log_prior", log_prior, ndim=1).copy()
        if len(log_prior) != num:
            raise InvalidInputError(f"log_prior must be {num} numbers, got {len(log_prior)}")
        # Of the quadratic term what the goals do not share, about their mean: exact far away.
        origin = goals.mean(axis=0)
        offsets = goals - origin
        with np.errstate(all="ignore"):
            slope = precision @ offsets.T
            intercept = log_prior - (offsets * slope.T).sum(-1) / 2
            largest = beta * np.abs(offsets).max()
        if not (np.abs(slope).max() < _FARTHEST and np.isfinite(intercept).all()):
            raise InvalidInputError("sigma must not vanish beside the goals' distances")
        if not largest < _FARTHEST:
            raise InvalidInputError(
                f"beta must not be infinite beside the goals' distances, got {beta:g}"
            )
        if not slope.any() and not beta:
            raise InvalidInputError("sigma or beta must tell the goals apart")
        for array in (goals, precision, log_prior):
            array.setflags(write=False)
        vars(self).update(goals=goals, precision=precision, beta=beta, log_prior=log_prior)
        vars(self).update(_origin=origin, _slope=slope, _intercept=intercept)

    def __repr__(self) -> str:
        return (
            f"Field(goals={self.goals.tolist()}, precision={self.precision.tolist()}, "
            f"beta={self.beta:g}, log_prior={self.log_prior.tolist()})"
        )

    def seen_from(self, origin: Array, scale: float) -> Field:
        """The same field in lengths of `scale` [m] from `origin (D,)` [m], where φ is the same.

        Checked already, so that it takes a tenth of the time of a new one.
        """
        field = object.__new__(Field)
        vars(field).update(
            goals=(self.goals - origin) / scale,
            precision=self.precision * scale**2,
            beta=self.beta * scale,
            log_prior=self.log_prior,
            _origin=(self._origin - origin) / scale,
            _slope=self._slope * scale,
            _intercept=self._intercept,
        )
        return field

    @property
    def prior(self) -> Array:
        """P(g), `(G,)`."""
        weights = np.exp(self.log_prior - self.log_prior.max())
        return weights / weights.sum()

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
        logits = np.moveaxis(self._logits(x), 0, -1)
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
        logits = self._logits(x, target_index(target, self.num_goals))
        return potential_of_odds(np.delete(logits, target, axis=0))

    @np.errstate(under="ignore")
    def potential_and_gradient(self, x: Array, target: int) -> tuple[Array, Array]:
        """φ `(...)` and its gradient `(..., D)` [1/m] at points `(..., D)` [m] in or near a room.

        For optimisers: a few times faster than `potential`, unchecked, less exact far away.
        """
        logits = (x - self._origin) @ self._slope + self._intercept
        pull = self._slope.T
        if self.beta:
            offset = x[..., None, :] - self.goals
            apart = np.sqrt(np.einsum("...d,...d->...", offset, offset))
            logits = logits - self.beta * apart
            pull = pull - offset * (self.beta / np.maximum(apart, 1e-300))[..., None]
        odds = logits - logits[..., target, None]
        most = odds.max(-1)
        likely = np.exp(odds - most[..., None])
        total = likely.sum(-1)
        # Where the target is likely the logarithm of the total is too coarse.
        likely[..., target] = 0
        against = likely.sum(-1)
        potential = np.where(most > 0, most + np.log(total), np.log1p(against))
        posterior = likely / total[..., None]
        posterior[..., target] = -against / total
        return potential, (posterior[..., None, :] @ pull)[..., 0, :]

    def _logits(self, x: ArrayLike, target: int | None = None) -> Array:
        """`log P(g) − E_g(x)` of each goal, `(G, ...)`, less that of `target` or a common term."""
        points = finite_array("x", x, min_ndim=1, last=self.dim)
        if np.abs(points).max(initial=0) > _FARTHEST:
            points = points / np.maximum(1, np.abs(points).max(-1, keepdims=True) / _FARTHEST)
        offset = points - self._origin
        slope, intercept, zero = self._slope, self._intercept, np.zeros(self.dim)
        if target is not None:
            slope = slope - slope[:, target, None]
            intercept = intercept - intercept[target]
            zero = self.goals[target] - self._origin
        # Points come last: sums over a short last axis are slow in NumPy.
        columns = np.ascontiguousarray(offset.reshape(-1, self.dim).T)[:, None]  # (D, 1, N)
        logits = slope.T @ columns[:, 0] + intercept[:, None]
        if self.beta:
            goals, zero = (self.goals - self._origin).T[..., None], zero[:, None, None]
            apart = _length(columns - goals) + _length(columns - zero)
            # ‖x − g‖ − ‖x − zero‖ without a difference of large numbers.
            closer = ((2 * columns - goals - zero) * (goals - zero)).sum(0)
            logits += self.beta * np.divide(
                closer, apart, out=np.zeros(apart.shape), where=apart > 0
            )
        return logits.reshape(self.num_goals, *points.shape[:-1])

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


@dataclass(frozen=True, eq=False, init=False, repr=False)
class InformationPotentialField(Field):
    """The paper's field (section V.A): the likelihood `P(x|g) = N(x; g, σ²I)` around each goal.

    Args:
        goals: `(G, D)` [m], G ≥ 2.
        sigma: spread σ of the likelihood [m].
        prior: `(G,)`, P(g) before any motion, normalised; uniform if not given.

    Raises:
        InvalidInputError: fewer than two goals, σ ≤ 0, a prior that is not positive.
    """

    sigma: float

    def __init__(self, goals: ArrayLike, sigma: float, prior: ArrayLike | None = None) -> None:
        goals, sigma = goals_array(goals), positive("sigma", sigma)
        with np.errstate(all="ignore"):
            precision = np.eye(goals.shape[-1]) / np.float64(sigma) ** 2
        if not np.isfinite(precision).all():
            raise InvalidInputError(
                f"sigma must not vanish beside the goals' distances, got {sigma}"
            )
        super().__init__(goals, precision, log_prior=np.log(prior_array(prior, len(goals))))
        vars(self).update(sigma=sigma)

    def __repr__(self) -> str:
        return (
            f"InformationPotentialField(goals={self.goals.tolist()}, sigma={self.sigma:g}, "
            f"prior={self.prior.tolist()})"
        )


def _is_semidefinite(matrix: Array) -> bool:
    if not matrix.any():
        return True
    values = np.linalg.eigvalsh(matrix)
    is_symmetric = np.allclose(matrix, matrix.T, rtol=_ROUNDING, atol=_ROUNDING * values[-1])
    return is_symmetric and bool(values[0] >= -_ROUNDING * values[-1])


def _length(columns: Array) -> Array:
    """Length `(...)` of vectors `(D, ...)`."""
    return np.sqrt((columns * columns).sum(0))


def potential_of_odds(odds: np.ndarray) -> np.ndarray:
    """`φ = log(1 + Σ_g exp(odds_g))` (eq. 3) of log odds `log P(g|x) − log P(g*|x)`, `(...)`.

    Stable for odds of any size, and of their dtype.

    Args:
        odds: of the distractors, `(G − 1, ...)`.
    """
    against = odds[0]
    if len(odds) > 1:
        top = odds.max(0)
        against = top + np.log(np.exp(odds - top).sum(0))
    return np.maximum(against, 0) + np.log1p(np.exp(-np.abs(against)))
