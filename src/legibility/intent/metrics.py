"""Metrics of a trajectory and of an observer's belief, each with its source.

Every function is vectorised over leading axes and takes these arguments:

* `trajectory`: `(..., T, D)` [m];
* `field`: the observer's `Field`;
* `goals`: `(G, D)` [m], G ≥ 2;
* `target`: index of the intended goal;
* `posterior`: P(g) over time, `(..., T, G)`, at T equally spaced times, from
  `Field.posterior` or `dragan_posterior`. Progress t runs from 0 to 1.
"""

import functools
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from ..checks import (
    Array,
    bounded,
    finite_array,
    goals_array,
    one_of,
    positive,
    posterior_array,
    prior_array,
    target_index,
    trajectory_array,
)
from ..curves import arc_length, resample
from ..errors import InvalidInputError
from .field import Field

__all__ = [
    "BETA_SHARE",
    "CONFIDENCE",
    "COSTS",
    "DEFAULT_ALPHA",
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

Cost = Literal["length", "squared_velocity"]

COSTS: tuple[Cost, ...] = ("length", "squared_velocity")
"""Costs that Dragan's observer assumes the robot minimises."""

CONFIDENCE = 0.8
"""Least belief in the target of a confident observer."""

BETA_SHARE = 20.0
"""Rationality β times the cost of a straight motion as long as the scene's size; a detour of a
twentieth of the size makes a goal e times less likely."""


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
    trajectory: ArrayLike, field: Field, target: int, alpha: float = DEFAULT_ALPHA
) -> Array:
    """`L_p(ξ) = −Σ_t f(t) φ(x_t|g*)`, `f(t) = exp(−α t)` (paper, eq. 4), `(...)`; higher = better.

    The trajectory is resampled to `SCORE_POINTS` points at equal arc length, t is progress in
    [0, 1] and f sums to 1, so that the score depends on the curve alone; α = 0 weighs all points
    alike.
    """
    points = resample(trajectory_array(trajectory, field.dim), SCORE_POINTS)
    weights = score_weights(SCORE_POINTS, bounded("alpha", alpha, 0))
    return -field.potential(points, target) @ weights


@np.errstate(under="ignore")
def potential_cost(trajectory: ArrayLike, field: Field, target: int) -> Array:
    """`L_p = Σ_t φ(x_t|g*) / t`, t = 1 … T over the points as given, `(...)`; lower = better.

    The cost of the paper's Table I: eq. 4 with `f(t) = 1/t` and without its sign. t is 1 at the
    start, so the value depends on the spacing of the points; compare equal spacings only.
    """
    return _over_time(field.potential(trajectory_array(trajectory, field.dim), target))


@np.errstate(under="ignore")
def distance_score(
    trajectory: ArrayLike, goals: ArrayLike, target: int, squared: bool = False
) -> Array:
    """`L_d = Σ_t ‖g⁻ − x_t‖ / t`, t = 1 … T over the points as given, `(...)`; higher = better.

    The score of the paper's Table I (eq. 5), whose numbers come from the plain norm; the equation
    squares it [m²], as `squared` does. With several distractors g⁻ is the nearest at each t. t is 1
    at the start, so the value depends on the spacing of the points; compare equal spacings only.
    """
    points, _, distractors = _checked(trajectory, goals, target)
    nearest = _distances(points, distractors).min(-1)
    return _over_time(nearest**2 if squared else nearest)


@np.errstate(under="ignore")
def detachment(trajectory: ArrayLike, goals: ArrayLike, target: int) -> Array:
    """`Σ_t (‖x_t − g⁻‖ / ‖g* − g⁻‖) / t`, t = 1 … T, `(...)`; higher = better.

    `distance_score` without a unit (Style-Conditioned Diffusion Policy, 2026). With several
    distractors the one with the smallest ratio counts at each t.
    """
    points, goal, distractors = _checked(trajectory, goals, target)
    apart = np.linalg.norm(distractors - goal, axis=-1)
    if (apart == 0).any():
        raise InvalidInputError(f"goals must not coincide, got {goal.tolist()} twice")
    return _over_time((_distances(points, distractors) / apart).min(-1))


@np.errstate(under="ignore")
def predictability(trajectory: ArrayLike) -> Array:
    """Straight length / length between the two ends, `(...)` in [0, 1]; higher = better.

    1 for a straight line and for a trajectory at rest, 0 for one that ends where it began. Also
    called efficiency (Style-Conditioned Diffusion Policy, 2026).
    """
    points = trajectory_array(trajectory)
    straight = np.linalg.norm(points[..., -1, :] - points[..., 0, :], axis=-1)
    length = arc_length(points)
    ratio = np.divide(straight, length, out=np.ones_like(length), where=length > 0)
    return np.minimum(ratio, 1)  # rounding


@np.errstate(under="ignore")
def regularised_legibility(legibility: ArrayLike, cost: ArrayLike, weight: float) -> Array:
    """`L(ξ) − λ C(ξ)` (Dragan and Srinivasa, RSS 2013), `(...)`; higher = better.

    `legibility (...)` is any metric of which higher is better, `cost (...)` see `trajectory_cost`,
    `weight` λ ≥ 0 is in units of 1 / cost.
    """
    legibility, cost = _same_shape(legibility, cost)
    return legibility - bounded("weight", weight, 0) * cost


def budgeted_legibility(legibility: ArrayLike, cost: ArrayLike, budget: float) -> Array:
    """`L(ξ)` where `C(ξ) ≤ budget`, −inf elsewhere, `(...)`; higher = better.

    The trust region of Dragan and Srinivasa (RSS 2013); arguments as in `regularised_legibility`.
    """
    legibility, cost = _same_shape(legibility, cost)
    return np.where(cost <= bounded("budget", budget, 0), legibility, -np.inf)


@np.errstate(under="ignore")
def trajectory_cost(trajectory: ArrayLike, cost: Cost = "length", time_step: float = 1.0) -> Array:
    """`C(ξ)` of each trajectory `(..., T, D)` [m], `(...)`; lower = better.

    Args:
        cost: `length`, `Σ ‖x_{t+1} − x_t‖` [m], or `squared_velocity`, `½ ∫ ‖ẋ‖² dt` =
            `Σ ‖x_{t+1} − x_t‖² / 2Δt` [m²/s] (Dragan and Srinivasa, RSS 2013).
        time_step: Δt [s] between the points, for `squared_velocity`.
    """
    points = trajectory_array(trajectory)
    time_step = positive("time_step", time_step)
    if _cost(cost) == "length":
        return arc_length(points)
    return (np.diff(points, axis=-2) ** 2).sum((-2, -1)) / (2 * time_step)


@np.errstate(under="ignore")
def dragan_posterior(
    trajectory: ArrayLike,
    goals: ArrayLike,
    beta: float | None = None,
    prior: ArrayLike | None = None,
    cost: Cost = "length",
    time_step: float = 1.0,
) -> Array:
    """`P(g|ξ_{S→Q}) ∝ exp(−β (C(ξ_{S→Q}) + C*(Q→g) − C*(S→g))) P(g)`, `(..., T, G)`.

    The observer of Dragan, Lee and Srinivasa (HRI 2013), at each point Q of the trajectory, whose
    first point is S. `C(ξ_{S→Q})` is the same for all goals and cancels. `C*` is the cost of the
    best motion, the straight one:

    * `length`: `C*(Q→g) = ‖g − Q‖` [m].
    * `squared_velocity`: a constant velocity over the time left, `C*(Q→g) = ‖g − Q‖² / 2τ` [m²/s].
      The observer knows the duration, (T − 1) Δt from S, so τ = (T − 1 − i) Δt at point i, and Δt
      at the last point.

    Args:
        trajectory: points at equal time steps.
        goals: the observer's hypotheses.
        beta: rationality β, in units of 1 / cost; if not given, `BETA_SHARE` over the cost of a
            straight motion as long as the largest distance among S and the goals.
        prior: `(G,)` P(g) before any motion, and so the posterior at S; uniform if not given.
        cost: see `trajectory_cost`.
        time_step: Δt [s], for `squared_velocity`.
    """
    goals = goals_array(goals)
    points = trajectory_array(trajectory, goals.shape[-1])
    time_step = positive("time_step", time_step)
    prior = prior_array(prior, len(goals))
    to_go = _distances(points, goals)
    size = np.maximum(to_go[..., 0, :].max(-1), _distances(goals, goals).max())
    if _cost(cost) == "squared_velocity":
        steps = points.shape[-2] - 1
        left = np.maximum(steps - np.arange(steps + 1), 1) * time_step
        to_go, size = to_go**2 / (2 * left[:, None]), size**2 / (2 * left[0])
    rationality = BETA_SHARE / size if beta is None else np.asarray(positive("beta", beta))
    logits = np.log(prior) - rationality[..., None, None] * (to_go - to_go[..., :1, :])
    logits -= logits.max(axis=-1, keepdims=True)  # log 2 is lost beside a large number
    return np.exp(logits - np.logaddexp.reduce(logits, axis=-1, keepdims=True))


def dragan_legibility(
    trajectory: ArrayLike,
    goals: ArrayLike,
    target: int,
    beta: float | None = None,
    prior: ArrayLike | None = None,
    cost: Cost = "length",
    time_step: float = 1.0,
) -> Array:
    """`posterior_legibility` of `dragan_posterior`, `(...)` in [0, 1]; higher = better."""
    posterior = dragan_posterior(trajectory, goals, beta, prior, cost, time_step)
    return posterior_legibility(posterior, target)


@np.errstate(under="ignore")
def posterior_legibility(posterior: ArrayLike, target: int) -> Array:
    """`∫ P(g*|ξ_{0→t}) f(t) dt / ∫ f(t) dt`, `f(t) = T − t`, `(...)` in [0, 1]; higher = better.

    Paper, eq. 1, and HRI 2013; both integrals by the trapezoidal rule over the T times.
    """
    belief = _belief(posterior, target)
    weights = np.arange(belief.shape[-1])[::-1].astype(np.float64)
    weights[0] /= 2
    return belief @ (weights / weights.sum())


def time_to_confidence(posterior: ArrayLike, target: int, threshold: float = CONFIDENCE) -> Array:
    """First progress t from which `P(g*) ≥ threshold` to the end, `(...)`; lower = better.

    In [0, 1], one of the T times; `inf` if the last belief is below the threshold.
    """
    held = _belief(posterior, target) >= bounded("threshold", threshold, 0, 1)
    return _first(np.logical_and.accumulate(held[..., ::-1], axis=-1)[..., ::-1])


def earliest_correct_guess(posterior: ArrayLike, target: int, margin: float = 0.0) -> Array:
    """First progress t at which `P(g*) > P(g) + margin` for every other g, `(...)`; lower = better.

    In [0, 1], one of the T times; `inf` if there is none. The guess may be lost again later.
    """
    belief = _belief(posterior, target)
    others = np.delete(posterior_array(posterior), target, axis=-1).max(-1)
    return _first(belief - others > bounded("margin", margin, 0, 1))


@np.errstate(under="ignore")
def early_intent(posterior: ArrayLike, target: int, fraction: float = 0.3) -> Array:
    """Mean `P(g*)` over the times with progress t ≤ fraction, `(...)`; higher = better."""
    belief = _belief(posterior, target)
    last = int(bounded("fraction", fraction, 0, 1) * (belief.shape[-1] - 1) + 1e-9)
    return belief[..., : last + 1].mean(-1)


@np.errstate(under="ignore")
def posterior_entropy(posterior: ArrayLike) -> Array:
    """Entropy `−Σ_g P(g) log P(g)` at each time [nat], `(..., T)`; lower = more certain."""
    posterior = posterior_array(posterior)
    logs = np.log(np.where(posterior > 0, posterior, 1))
    return -(posterior * logs).sum(-1) + 0.0  # never −0


@np.errstate(under="ignore")
def evaluate_trajectory(
    trajectory: ArrayLike,
    field: Field,
    target: int,
    alpha: float = DEFAULT_ALPHA,
    beta: float | None = None,
) -> dict[str, Array]:
    """Every metric of one or many trajectories by its name, each `(...)`.

    Metrics of a posterior come twice: `field_…` for the field, and `dragan_…` for the default
    `Observer`, `dragan_posterior` with path length as the cost and rationality `beta` [1/m], who
    has not decided at the trajectory's start. All but `legibility_score` take the points to be at
    equal time steps. A time never reached is `inf`.
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
        "dragan": dragan_posterior(points, field.goals, beta),
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


def _over_time(values: Array) -> Array:
    """`Σ_t values_t / t`, t = 1 … T, over the last axis."""
    return values @ (1 / np.arange(1, values.shape[-1] + 1))


def _checked(trajectory: ArrayLike, goals: ArrayLike, target: int) -> tuple[Array, Array, Array]:
    """Points `(..., T, D)`, the intended goal `(D,)` and the distractors `(G − 1, D)`."""
    goals = goals_array(goals)
    points = trajectory_array(trajectory, goals.shape[-1])
    index = target_index(target, len(goals))
    return points, goals[index], np.delete(goals, index, axis=0)


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


def _belief(posterior: ArrayLike, target: int) -> Array:
    posterior = posterior_array(posterior)
    return posterior[..., target_index(target, posterior.shape[-1])]


def _first(reached: np.ndarray) -> Array:
    """Progress of the first True of `reached (..., T)`, `inf` where there is none."""
    progress = np.argmax(reached, axis=-1) / (reached.shape[-1] - 1)
    return np.where(reached.any(-1), progress, np.inf)


def _cost(cost: Cost) -> Cost:
    return one_of("cost", cost, COSTS)
