"""Timed motions side by side: speed, use of the limits, and belief over time."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path as FilePath
from typing import Any

import numpy as np

from ..checks import Array
from ..envs.colors import INK, MUTED
from ..errors import InvalidInputError
from ..intent.metrics import CONFIDENCE, time_to_confidence
from ..motion.timed import Motion
from .belief import readers
from .scene_axes import goal_colors
from .style import DASHED, PAGE, figure_file

MOST = 5
"""Most motions that are shown side by side."""

_WIDTH, _HEIGHT = 1.75, 1.1  # of a panel, at most and of each row [in]


def check_number(number: int, what: str = "timed motions") -> None:
    """Raise unless `number` motions can be shown side by side."""
    if not 1 <= number <= MOST:
        raise InvalidInputError(f"a figure shows 1 to {MOST} {what}, got {number}")


def motion_figure(motions: Sequence[Motion], file: str | FilePath) -> None:
    """Draw timed motions side by side over one axis of time.

    Args:
        motions: 1 to `MOST`, in one scene, toward one target; another number raises.
        file: see `figure_file`.

    Raises:
        InvalidInputError: another number, or a motion without limits.
    """
    check_number(len(motions))
    if any(motion.limits is None for motion in motions):
        raise InvalidInputError("the record of an executed motion has no limits to be shown beside")
    path = motions[0].path
    watching = readers(path.scene, path.observer)
    rows, columns = 2 + len(watching), len(motions)
    width = min(PAGE, 0.6 + _WIDTH * max(2, columns))
    with figure_file(file, width, 0.75 + _HEIGHT * rows) as figure:
        panels: Any = figure.subplots(rows, columns, sharex=True, sharey="row", squeeze=False)
        for column, motion in zip(panels.T, motions, strict=True):
            _speed(column[0], motion)
            _shares(column[1], motion)
            for panel, reader in zip(column[2:], watching, strict=True):
                places = motion.in_frame("world").positions
                posterior = reader.observer.field(path.scene).posterior(places)
                belief_panel(panel, motion.times, posterior, path.target)
            column[-1].set_xlabel("time [s]")
            level = f"{float(motion.path.legibility):g}".replace("-", "−")
            column[0].set_title(rf"$\ell$ = {level}" + f", {motion.duration:.2f} s")
        moves = "point" if motions[0].arm is None else "grasp point"
        panels[0, 0].set_ylabel(f"{moves}\n[m/s]", fontsize=7)
        panels[1, 0].set_ylabel("of the limits", fontsize=7)
        panels[1, 0].legend(loc="upper center", fontsize=6, ncols=2, borderaxespad=0)
        panels[1, 0].set(ylim=(0, 1.25))
        for row, reader in zip(panels[2:], watching, strict=True):
            belief_axis(row[0], reader.short)


def _speed(panel: Any, motion: Motion) -> None:
    panel.plot(motion.times, np.linalg.norm(motion.velocities, axis=-1), color=INK, lw=1)
    panel.set_ylim(bottom=0)


def _shares(panel: Any, motion: Motion) -> None:
    """The greatest share of a limit that any joint, or the point, uses."""
    limits = motion.limits
    assert limits is not None
    values = (
        (motion.joint_positions, motion.joint_velocities, motion.joint_accelerations)
        if limits.joints
        else (motion.positions, motion.velocities, motion.accelerations)
    )
    bounds = limits.velocity_at(values[0]), limits.acceleration
    for name, value, bound, look in zip(
        ("velocity", "acceleration"), values[1:], bounds, ("-", DASHED), strict=True
    ):
        size = np.abs(value) if limits.joints else np.linalg.norm(value, axis=-1, keepdims=True)
        panel.plot(motion.times, (size / bound).max(-1), color=INK, ls=look, lw=1, label=name)
    panel.axhline(1, color=MUTED, lw=0.6)


def belief_panel(panel: Any, times: Array, posterior: Array, target: int) -> None:
    """P(g) of each goal over time, and a diamond from where the target is believed for good."""
    for goal, color in enumerate(goal_colors(posterior.shape[-1], target)):
        panel.plot(times, posterior[:, goal], color=color, lw=1.4 if goal == target else 0.8)
    panel.axhline(CONFIDENCE, color=MUTED, lw=0.6, ls=DASHED)
    when = times[0] + float(time_to_confidence(posterior, target)) * (times[-1] - times[0])
    if np.isfinite(when):
        panel.plot([when], [CONFIDENCE], marker="D", ms=4, color=INK, zorder=5)


def belief_axis(panel: Any, name: str) -> None:
    """The vertical axis of a belief, with the observer's name."""
    panel.set_ylabel(f"belief of\n{name}", fontsize=7)
    panel.set(ylim=(-0.04, 1.06))
    panel.set_yticks((0, 0.5, 1), ("0", "½", "1"))
