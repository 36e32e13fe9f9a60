"""The last check before an action is sent: finite, within its limits, and not out of the workspace.

Whatever a policy says, what `safe_actions` returns can be sent.
"""

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
    """Displacements that can be sent, `(..., D)` [m].

    An actuator of lag λ that is told to stop moves on by λ/(1 − λ) of its last displacement in all.
    From where it would then stand, and from where it is (it may have no lag), the action must stay
    inside the workspace. A robot that starts at rest, sends only such actions and realises a share
    of them from 0 to 1, whichever, then never leaves it.

    Args:
        actions: `(..., D)` [m], wanted displacements; what is not a number becomes 0.
        positions: `(..., D)` [m], where the robot is.
        velocities: `(..., D)` [m], its displacement in the last step.
        workspace: `(2, D)` [m], low and high corner.
        limit: largest displacement along each axis [m].
        lag: λ in [0, ½], the largest that the actuator may have.
    """
    wanted = np.nan_to_num(np.asarray(actions, dtype=np.float64))  # ±inf becomes ±1.8e308
    # Scaled, not cut off: a long step keeps its direction.
    wanted = wanted * (limit / np.maximum(np.abs(wanted).max(axis=-1, keepdims=True), limit))
    low, high = workspace
    rest = positions + lag / (1 - lag) * velocities
    wanted = np.clip(wanted, low - np.minimum(rest, positions), high - np.maximum(rest, positions))
    return np.clip(wanted, -limit, limit)
