"""The spectrum in one picture: motions of rising legibility and what they cost (paper, fig. 3)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path as FilePath

import numpy as np

from ..colors import INK, MUTED
from ..errors import InvalidInputError
from ..execution import Rollout
from ..intent.metrics import potential_cost
from .figures import LABELS, PAGE, REDS, add_lines, figure_file, name_ends, scene_axes

__all__ = ["spectrum_figure"]

_HEIGHT, _SHARE = 2.6, 0.58
_DPI = 300
_TUBE = 0.0045
_DECADE = 20


def spectrum_figure(rollouts: Sequence[Rollout], file: str | FilePath) -> None:
    """Draw executed motions, light to dark red with ℓ, and beside them their cost L_p against ℓ.

    An arm is rendered at its table, the motions of the gripper as tubes. The cost is
    `potential_cost` of the positions at the control steps (paper, Table I).

    Args:
        rollouts: in one scene, toward one target.
        file: where to; .png, .pdf or .svg.

    Raises:
        InvalidInputError: there are none.
        OutputError: another suffix, or the file cannot be written.
    """
    if not rollouts:
        raise InvalidInputError("a spectrum needs at least one motion, got none")
    rollouts = sorted(rollouts, key=lambda rollout: rollout.legibility)
    path = rollouts[0].path
    levels = np.array([rollout.legibility for rollout in rollouts])
    colors = REDS(LABELS(levels))
    costs = np.array([potential_cost(r.states, path.field, path.target) for r in rollouts])
    with figure_file(file, PAGE, _HEIGHT) as figure:
        cells = figure.add_gridspec(1, 2, width_ratios=[_SHARE, 1 - _SHARE])
        if rollouts[0].joint_angles.size:
            from ..envs.panda_render import arm_image

            axes = figure.add_subplot(cells[0])
            axes.set_axis_off()
            trails = [(r.states, tuple(c), _TUBE) for r, c in zip(rollouts, colors, strict=True)]
            size = round(PAGE * _SHARE * _DPI), round(_HEIGHT * _DPI)
            axes.imshow(arm_image(path.scene, path.target, rollouts[0].joint_angles[0],
                                  trails=trails, size=size))  # fmt: skip
        else:
            axes = scene_axes(
                figure, cells[0], path.scene, path.target, rollouts[0].states, path.field
            )
            for rollout, color in zip(rollouts, colors, strict=True):
                add_lines(axes, rollout.states[None], colors=color, linewidths=1.5)
            name_ends(
                figure, axes, path.scene, path.target, np.concatenate([r.states for r in rollouts])
            )
        panel = figure.add_subplot(cells[1], xlim=(-1.05, 1.05), xlabel=r"legibility $\ell$")
        panel.set_ylabel(r"cost $L_p$ (lower: clearer)")
        panel.set_xticks((-1, 0, 1), ("−1", "0", "1"))
        panel.plot(levels, costs, color=MUTED, lw=1, zorder=1)
        panel.scatter(levels, costs, s=26, c=colors, ec=INK, linewidths=0.5, zorder=2)
        if costs.max() > _DECADE * costs.min():
            panel.set_yscale("log")
