"""Metrics of a trajectory: scores, costs and times, each with its source.

Trajectories are `(..., T, D)` [m]; every function is vectorised over the leading axes.
"""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import ArrayLike

from ..checks import (
    Array,
    bounded,
    finite_array,
    goals_array,
    target_index,
    trajectory_array,
)
from ..curves import arc_length, resample
from ..errors import InvalidInputError
from .belief import (
    COSTS,
    DEFAULT_BETA,
    Cost,
    dragan_legibility,
    dragan_posterior,
    earliest_correct_guess,
    early_intent,
    posterior_entropy,
    posterior_legibility,
    time_to_confidence,
    trajectory_cost,
)
from .field import InformationPotentialField

__all__ = [
    "COSTS",
    "DEFAULT_ALPHA",
    "DEFAULT_BETA",
    "SCORE_POINTS",
    "Cost",
    "budgeted_legibility",
    "detachment",
    "distance_score",
    "dragan_legibility",
    "dragan_posterior",
    "earliest_correct_guess",
    "early_intent",
    "evaluate_trajectory",
    "legibility_score",
    "posterior_entropy",
    "posterior_legibility",
    "potential_cost",
    "predictability",
    "regularised_legibility",
    "score_weights",
    "time_to_confidence",
    "trajectory_cost",
]

DEFAULT_ALPHA = 3.0
"""Decay α of the score's weight over progress t ∈ [0, 1]."""

SCORE_POINTS = 48
"""Points at equal arc length on which a score is summed."""


@functools.lru_cache(maxsize=32)
@np.errstate(under="ignore")
def score_weights(num_points: int, alpha: float) -> Array:
    """`f(t) = exp(−α t)` at `num_points` equal steps of t ∈ [0, 1], `(num_points,)`, summing to 1.

    The two ends count half (trapezoidal rule), so that the sum does not depend on `num_points`.
    """
    weights = np.exp(-alpha * np.linspace(0, 1, num_points))
    weights[[0, -1]] /= 2
    weights /= weights.sum()
    weights.setflags(write=False)
    return weights


@np.errstate(under="ignore")
def legibility_score(
    trajectory: ArrayLike,
    field: InformationPotentialField,
    target: int,
    alpha: float = DEFAULT_ALPHA,
) -> Array:
    """`L_p(ξ) = −Σ_t f(t) φ(x_t|g*)`, `f(t) = exp(−α t)` (paper, eq. 4), `(...)`; higher = better.

    The trajectory is resampled to `SCORE_POINTS` points at equal arc length, t is progress in
    [0, 1] and f sums to 1, so that the score depends on the curve alone.

    Args:
        trajectory: `(..., T, D)` [m].
        field: the observer.
        target: index of the intended goal.
        alpha: decay α; 0 weighs all points alike.
    """
    points = resample(trajectory_array(trajectory, field.dim), SCORE_POINTS)
    return -field.potential(points, target) @ score_weights(
        SCORE_POINTS, bounded("alpha", alpha, 0)
    )


@np.errstate(under="ignore")
def potential_cost(trajectory: ArrayLike, field: InformationPotentialField, target: int) -> Array:
    """`L_p = Σ_t φ(x_t|g*) / t`, t = 1 … T over the points as given, `(...)`; lower = better.

    The cost of the paper's Table I: eq. 4 with `f(t) = 1/t` and without its sign. t is 1 at the
    start, so the value depends on the spacing of the points; compare equal spacings only.

    Args:
        trajectory: `(..., T, D)` [m].
        field: the observer.
        target: index of the intended goal.
    """
    potential = field.potential(trajectory_array(trajectory, field.dim), target)
    return potential @ _harmonic_weights(potential.shape[-1])


@np.errstate(under="ignore")
def distance_score(
    trajectory: ArrayLike, goals: ArrayLike, target: int, squared: bool = False
) -> Array:
    """`L_d = Σ_t ‖g⁻ − x_t‖ / t`, t = 1 … T over the points as given, `(...)`; higher = better.

    The score of the paper's Table I, whose figures come from the plain norm (its equation squares
    it). With several distractors g⁻ is the nearest at each t. t is 1 at the start, so the value
    depends on the spacing of the points; compare equal spacings only.

    Args:
        trajectory: `(..., T, D)` [m].
        goals: `(G, D)` [m].
        target: index of the intended goal.
        squared: sum `‖g⁻ − x_t‖²` [m²], as the equation has it.
    """
    points, goals, target = _checked(trajectory, goals, target)
    nearest = _distances(points, np.delete(goals, target, axis=0)).min(-1)
    return (nearest**2 if squared else nearest) @ _harmonic_weights(nearest.shape[-1])


@np.errstate(under="ignore")
def detachment(trajectory: ArrayLike, goals: ArrayLike, target: int) -> Array:
    """`Σ_t (‖x_t − g⁻‖ / ‖g* − g⁻‖) / t`, t = 1 … T, `(...)`; higher = better.

    `distance_score` without a unit (Style-Conditioned Diffusion Policy, 2026). With several
    distractors the one with the smallest ratio counts at each t.

    Args:
        trajectory: `(..., T, D)` [m].
        goals: `(G, D)` [m], none at the target.
        target: index of the intended goal.
    """
    points, goals, target = _checked(trajectory, goals, target)
    distractors = np.delete(goals, target, axis=0)
    apart = np.linalg.norm(distractors - goals[target], axis=-1)
    if (apart == 0).any():
        raise InvalidInputError(f"goals must not coincide, got {goals[target].tolist()} twice")
    smallest = (_distances(points, distractors) / apart).min(-1)
    return smallest @ _harmonic_weights(smallest.shape[-1])


@np.errstate(under="ignore")
def predictability(trajectory: ArrayLike) -> Array:
    """Straight length / length between the two ends, `(...)` in [0, 1]; higher = better.

    1 for a straight line and for a trajectory at rest, 0 for one that ends where it began. Also
    called efficiency (Style-Conditioned Diffusion Policy, 2026).

    Args:
        trajectory: `(..., T, D)` [m].
    """
    points = trajectory_array(trajectory)
    straight = np.linalg.norm(points[..., -1, :] - points[..., 0, :], axis=-1)
    length = arc_length(points)
    ratio = np.divide(straight, length, out=np.ones_like(length), where=length > 0)
    return np.minimum(ratio, 1)  # rounding


@np.errstate(under="ignore")
def regularised_legibility(legibility: ArrayLike, cost: ArrayLike, weight: float) -> Array:
    """`L(ξ) − λ C(ξ)` (Dragan and Srinivasa, RSS 2013), `(...)`; higher = better.

    Args:
        legibility: `(...)` of any kind, higher = better.
        cost: `(...)`, see `trajectory_cost`.
        weight: λ ≥ 0, in units of 1 / cost.
    """
    legibility, cost = _same_shape(legibility, cost)
    return legibility - bounded("weight", weight, 0) * cost


def budgeted_legibility(legibility: ArrayLike, cost: ArrayLike, budget: float) -> Array:
    """`L(ξ)` where `C(ξ) ≤ budget`, −inf elsewhere, `(...)`; higher = better.

    The trust region of Dragan and Srinivasa (RSS 2013).

    Args:
        legibility: `(...)` of any kind, higher = better.
        cost: `(...)`, see `trajectory_cost`.
        budget: largest cost that is allowed, in the cost's unit.
    """
    legibility, cost = _same_shape(legibility, cost)
    return np.where(cost <= bounded("budget", budget, 0), legibility, -np.inf)


@np.errstate(under="ignore")
def evaluate_trajectory(
    trajectory: ArrayLike,
    field: InformationPotentialField,
    target: int,
    alpha: float = DEFAULT_ALPHA,
    beta: float = DEFAULT_BETA,
) -> dict[str, Array]:
    """Every metric of one or many trajectories by its name, each `(...)`.

    Metrics of a posterior come twice, `field_…` for the information potential field and `dragan_…`
    for Dragan's observer with path length as the cost and the same prior. All but
    `legibility_score` take the points to be at equal time steps. A time that is never reached is
    `inf`.

    Args:
        trajectory: `(..., T, D)` [m].
        field: the observer; its goals and prior are also those of Dragan's.
        target: index of the intended goal.
        alpha: decay α of `legibility_score`.
        beta: rationality β [1/m] of Dragan's observer.
    """
    points = trajectory_array(trajectory, field.dim)
    result = {
        "legibility_score": legibility_score(points, field, target, alpha),
        "potential_cost": potential_cost(points, field, target),
        "distance_score": distance_score(points, field.goals, target),
        "detachment": detachment(points, field.goals, target),
        "predictability": predictability(points),
        "length": arc_length(points),
    }
    observers = {
        "field": field.posterior(points),
        "dragan": dragan_posterior(points, field.goals, beta, field.prior),
    }
    for name, posterior in observers.items():
        result |= {
            f"{name}_legibility": posterior_legibility(posterior, target),
            f"{name}_time_to_confidence": time_to_confidence(posterior, target),
            f"{name}_earliest_correct_guess": earliest_correct_guess(posterior, target),
            f"{name}_early_intent": early_intent(posterior, target),
            f"{name}_mean_entropy": posterior_entropy(posterior).mean(-1),
        }
    return {name: np.asarray(value) for name, value in result.items()}


def _harmonic_weights(num_points: int) -> Array:
    return 1 / np.arange(1, num_points + 1)


def _checked(trajectory: ArrayLike, goals: ArrayLike, target: int) -> tuple[Array, Array, int]:
    goals = goals_array(goals)
    return trajectory_array(trajectory, goals.shape[-1]), goals, target_index(target, len(goals))


def _distances(points: Array, goals: Array) -> Array:
    """Distance [m] of `points (..., D)` from each of `goals (G, D)`, `(..., G)`."""
    return np.linalg.norm(points[..., None, :] - goals, axis=-1)


def _same_shape(legibility: ArrayLike, cost: ArrayLike) -> tuple[Array, Array]:
    legibility, cost = finite_array("legibility", legibility), finite_array("cost", cost)
    if legibility.shape != cost.shape:
        raise InvalidInputError(
            f"legibility and cost must have one shape, got {legibility.shape} and {cost.shape}"
        )
    return legibility, cost
