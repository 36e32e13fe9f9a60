"""Recorded motions side by side: the belief of each observer over time."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib.lines import Line2D

from ..envs.colors import INK
from ..evaluation.scoring import Score
from ..intent.metrics import CONFIDENCE
from .motion import belief_axis, belief_panel, check_number
from .scene_axes import goal_colors
from .style import PAGE, figure_file

_WIDTH, _HEIGHT = 1.75, 1.1  # of a panel, at most and of each row [in]


def belief_figure(rated: Mapping[str, Sequence[Score]], file: str | Path) -> None:
    """Draw the belief of each observer, a row, in each recording, a column.

    Args:
        rated: scores of the same 1 to 5 recordings by the observer's name; another number raises.
        file: see `figure_file`.
    """
    first = next(iter(rated.values()))
    check_number(columns := len(first), "recordings")
    width, height = min(PAGE, 0.6 + _WIDTH * max(2, columns)), 0.95 + _HEIGHT * len(rated)
    with figure_file(file, width, height) as figure:
        panels: Any = figure.subplots(len(rated), columns, sharex="col", sharey=True, squeeze=False)
        for index, (row, (name, scores)) in enumerate(zip(panels, rated.items(), strict=True)):
            belief_axis(row[0], name)
            for panel, score in zip(row, scores, strict=True):
                times, target = score.recording.motion_times, score.archive.target
                belief_panel(panel, times, score.belief, target)
                level = rf"$\ell$ = {score.achieved:.2f}".replace("-", "−")
                title = f"trajectory {score.recording.name}, {level}" if index == 0 else level
                panel.set_title(title)
        for bottom, score in zip(panels[-1], first, strict=True):
            bottom.set_xlabel("point" if score.recording.times is None else "time [s]")
        targets = {score.archive.target for score in first}
        if len(targets) == 1:
            (target,), number = targets, first[0].archive.scene.num_goals
            names = [f"goal {g}" + " (target)" * (g == target) for g in range(number)]
        else:
            target, number, names = 0, 2, ["target", "another goal"]
        lines = [Line2D([], [], color=color) for color in goal_colors(number, target)]
        lines.append(Line2D([], [], color=INK, marker="D", ms=4, ls="none"))
        names.append(f"target believed by {CONFIDENCE:g} for good")
        figure.legend(lines, names, loc="outside lower center", ncols=4)
