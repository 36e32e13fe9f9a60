"""The figure of the dial: asked against achieved ℓ on held-out scenes."""

from __future__ import annotations

from pathlib import Path as FilePath
from typing import Any

import numpy as np
from matplotlib.colors import to_rgba

from ..envs.colors import GOALS, INK
from ..errors import InvalidInputError
from .style import COLUMN, add_lines, compare_labels, figure_file


def dial_figure(result: dict[str, Any], file: str | FilePath) -> None:
    """Draw asked against achieved ℓ over all scenes, and the error by level.

    Thin lines are scenes, the shade holds 95 % of them.

    Args:
        result: what `evaluate_dial` returned, or its JSON.
        file: see `figure_file`.

    Raises:
        InvalidInputError: `result` is something else.
    """
    try:
        levels = np.array(result["levels"], dtype=np.float64)
        achieved = np.array([s["achieved"] for s in result["scenes"]], dtype=np.float64)
        errors = np.array([s["error_by_level"] for s in result["scenes"]], dtype=np.float64)
        overall = result["overall"]
        order = "Spearman {mean:.3f}\nworst scene {min:.3f}".format(**overall["spearman"])
        error = "mean error {mean:.3f}".format(**overall["error"])
        if "error_candidates" in overall:
            error += "\nwith candidates {mean:.3f}".format(**overall["error_candidates"])
        if not achieved.shape == errors.shape == (len(errors), len(levels)):
            raise ValueError(f"{achieved.shape} numbers for {len(levels)} levels")
    except (KeyError, TypeError, ValueError) as cause:
        raise InvalidInputError(f"not a result of `legibility evaluate dial`: {cause!r}") from cause

    with figure_file(file, COLUMN, 2.05) as figure:
        left, right = figure.subplots(1, 2)
        compare_labels(left)
        left.set_title(order)
        right.set(xlim=(-1, 1), xticks=(-1, 0, 1), xlabel=r"asked $\ell$")
        right.set_title(error)
        right.set_ylabel(r"$|$achieved − asked$|$")
        add_lines(
            left, [np.stack([levels, row], axis=-1) for row in achieved], linewidths=0.4, zorder=1,
            colors=to_rgba(INK, float(np.clip(12 / len(achieved), 0.06, 0.5))),
            rasterized=len(achieved) > 300,
        )  # fmt: skip
        for panel, values in ((left, achieved), (right, errors)):
            band = np.percentile(values, (2.5, 97.5), axis=0)
            panel.fill_between(
                levels, *band, color=GOALS[0], alpha=0.25, lw=0, label="95 % of scenes"
            )
            panel.plot(levels, values.mean(axis=0), color=GOALS[0], lw=1.3, label="mean")
        right.set_ylim(0, None)
        right.locator_params(axis="y", nbins=4)
        left.legend(loc="upper left", bbox_to_anchor=(-0.02, 1.04), borderpad=0)
