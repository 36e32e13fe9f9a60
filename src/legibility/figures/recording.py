"""Recorded motions side by side: the belief of each observer over time."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ..evaluation.scoring import Score
from .motion import belief_axis, belief_panel, check_number
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
    width, height = min(PAGE, 0.6 + _WIDTH * max(2, columns)), 0.75 + _HEIGHT * len(rated)
    with figure_file(file, width, height) as figure:
        panels: Any = figure.subplots(len(rated), columns, sharex="col", sharey=True, squeeze=False)
        for row, (name, scores) in zip(panels, rated.items(), strict=True):
            belief_axis(row[0], name)
            for panel, score in zip(row, scores, strict=True):
                belief_panel(
                    panel, score.recording.motion_times, score.belief, score.archive.target
                )
        for top, bottom, score in zip(panels[0], panels[-1], first, strict=True):
            recording = score.recording
            level = f"{score.achieved:.2f}".replace("-", "−")
            top.set_title(rf"{recording.name}, $\ell$ = {level}")
            bottom.set_xlabel("point" if recording.times is None else "time [s]")
