"""The last check before an action is sent: finite, within its limits, inside the workspace."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ..checks import Array

__all__ = ["safe_actions"]


def safe_actions(
    actions: ArrayLike,
    positions: Array,
    velocities: Array,
    workspace: Array,
    limit: float,
    lag: float,
) -> Array:
    """Displacements that are safe to send, `(..., D)` [m].

    A stopped actuator of lag λ moves on by λ/(1 − λ) of its last displacement. Both from there and
    from the present position (the lag may be 0) the action must stay inside the workspace. A robot
    that starts at rest, receives only such actions and realises any share of them from 0 to 1 never
    leaves it.

    Args:
        actions: `(..., D)` [m], wanted displacements; NaN becomes 0.
        positions: `(..., D)` [m], present positions of the robots.
        velocities: `(..., D)` [m], their displacements in the last step.
        workspace: `(2, D)` [m], low and high corner.
        limit: largest displacement along each axis [m].
        lag: λ in [0, ½], the largest lag that the actuator may have.
    """
    wanted = np.nan_to_num(np.asarray(actions, dtype=np.float64))  # ±inf becomes ±1.8e308
    # Scaled, not clipped: a long step keeps its direction.
    wanted = wanted * (limit / np.maximum(np.abs(wanted).max(axis=-1, keepdims=True), limit))
    low, high = workspace
    rest = positions + lag / (1 - lag) * velocities
    wanted = np.clip(wanted, low - np.minimum(rest, positions), high - np.maximum(rest, positions))
    return np.clip(wanted, -limit, limit)
