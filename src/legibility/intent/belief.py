"""Belief over time: Dragan's observer, and metrics of any observer's posterior.

A posterior is P(g) over time, `(..., T, G)`, its T times equally spaced; it comes from
`InformationPotentialField.posterior` or from `dragan_posterior`. Progress t runs from 0 to 1.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from ..checks import (
    Array,
    bounded,
    goals_array,
    positive,
    posterior_array,
    prior_array,
    target_index,
    trajectory_array,
)
from ..curves import arc_length
from ..errors import InvalidInputError

__all__ = [
    "CONFIDENCE",
    "COSTS",
    "DEFAULT_BETA",
    "Cost",
    "dragan_legibility",
    "dragan_posterior",
    "earliest_correct_guess",
    "early_intent",
    "posterior_entropy",
    "posterior_legibility",
    "time_to_confidence",
    "trajectory_cost",
]

Cost = Literal["length", "squared_velocity"]

COSTS: tuple[Cost, ...] = ("length", "squared_velocity")
"""Costs that Dragan's observer assumes the robot minimises."""

CONFIDENCE = 0.8
"""Belief in the target from which on the observer is confident."""

DEFAULT_BETA = 10.0
"""Rationality β [1/m]: with `length`, 0.1 m of detour makes a goal e times less likely."""


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
    beta: float = DEFAULT_BETA,
    prior: ArrayLike | None = None,
    cost: Cost = "length",
    time_step: float = 1.0,
) -> Array:
    """`P(g|ξ_{S→Q}) ∝ exp(−β (C(ξ_{S→Q}) + C*(Q→g) − C*(S→g))) P(g)`, `(..., T, G)`.

    The observer of Dragan, Lee and Srinivasa (HRI 2013), at each point Q of the trajectory, whose
    first point is S. `C(ξ_{S→Q})` is the same for all goals and cancels. `C*` is the cost of the
    best motion, the straight one:

    * `length`: `C*(Q→g) = ‖g − Q‖` [m].
    * `squared_velocity`: a constant velocity over the time that is left, `C*(Q→g) = ‖g − Q‖² / 2τ`
      [m²/s]. The observer knows the duration, (T − 1) Δt from S, so τ = (T − 1 − i) Δt at point i,
      and one step at the last point.

    Args:
        trajectory: `(..., T, D)` [m], points at equal time steps.
        goals: `(G, D)` [m], G ≥ 2.
        beta: rationality β, in units of 1 / cost.
        prior: `(G,)` P(g) before any motion; uniform if not given. It is also the posterior at S.
        cost: `length` or `squared_velocity`.
        time_step: Δt [s], for `squared_velocity`.
    """
    goals = goals_array(goals)
    points = trajectory_array(trajectory, goals.shape[-1])
    beta, time_step = positive("beta", beta), positive("time_step", time_step)
    prior = prior_array(prior, len(goals))
    to_go = np.linalg.norm(points[..., None, :] - goals, axis=-1)
    if _cost(cost) == "squared_velocity":
        steps = points.shape[-2] - 1
        left = np.maximum(steps - np.arange(steps + 1), 1) * time_step
        to_go = to_go**2 / (2 * left[:, None])
    logits = np.log(prior) - beta * (to_go - to_go[..., :1, :])
    logits -= logits.max(axis=-1, keepdims=True)  # log 2 is lost beside a large number
    return np.exp(logits - np.logaddexp.reduce(logits, axis=-1, keepdims=True))


def dragan_legibility(
    trajectory: ArrayLike,
    goals: ArrayLike,
    target: int,
    beta: float = DEFAULT_BETA,
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
    """First progress t from which on `P(g*) ≥ threshold` for good, `(...)`; lower = better.

    In [0, 1], one of the T times; `inf` if the last belief is below the threshold.
    """
    held = _belief(posterior, target) >= bounded("threshold", threshold, 0, 1)
    return _first(np.logical_and.accumulate(held[..., ::-1], axis=-1)[..., ::-1])


@np.errstate(under="ignore")
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


def _belief(posterior: ArrayLike, target: int) -> Array:
    posterior = posterior_array(posterior)
    return posterior[..., target_index(target, posterior.shape[-1])]


def _first(reached: np.ndarray) -> Array:
    """Progress of the first True of `reached (..., T)`, `inf` where there is none."""
    progress = np.argmax(reached, axis=-1) / (reached.shape[-1] - 1)
    return np.where(reached.any(-1), progress, np.inf)


def _cost(cost: Cost) -> Cost:
    if cost not in COSTS:
        raise InvalidInputError(f"cost must be one of {', '.join(COSTS)}, got {cost!r}")
    return cost
