"""The figure of a scene's archive."""

from __future__ import annotations

from pathlib import Path as FilePath

import numpy as np
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.ticker import PercentFormatter
from numpy.typing import ArrayLike

from ..checks import Array
from ..envs.colors import INK
from ..scene import Scene
from .scene_axes import name_ends, scene_axes, scene_cells
from .style import COLUMN, DASHED, LABELS, add_lines, figure_file, label_ticks

__all__ = ["archive_figure"]

_COLORS = LinearSegmentedColormap.from_list(
    "ambiguous_straight_legible", ["#114b8c", "#5b93c7", "#b8b8b8", "#de6a55", "#96101f"]
)
_BINS = 20


def archive_figure(
    scene: Scene,
    target: int,
    trajectories: Array,
    labels: Array,
    all_labels: ArrayLike,
    file: str | FilePath,
) -> None:
    """Draw one scene's trajectories coloured by label, and a histogram of the labels of all scenes.

    Args:
        scene: the scene.
        target: index of the intended goal.
        trajectories: `(N, T, D)` [m].
        labels: `(N,)`.
        all_labels: labels of the whole dataset, any shape.
        file: .png, .pdf or .svg.

    Raises:
        OutputError: another suffix, or the file cannot be written.
    """
    num = len(labels)
    order = np.random.default_rng(0).permutation(num)  # so that no level hides the others
    pooled = np.clip(np.asarray(all_labels, dtype=np.float64).ravel(), -1, 1)
    counts, edges = np.histogram(pooled, bins=_BINS, range=(-1, 1))
    centres = (edges[1:] + edges[:-1]) / 2

    with figure_file(file, COLUMN, 1.85) as figure:
        cells = scene_cells(figure, scene, 2, height=1.35, margin=0.6)
        axes = scene_axes(figure, cells[0], scene, target, trajectories)
        add_lines(
            axes, trajectories[order], colors=_COLORS(LABELS(labels[order])),
            linewidths=float(np.clip(9 / num**0.5, 0.35, 1.2)), rasterized=num > 300,
        )  # fmt: skip
        panel = figure.add_subplot(cells[1], xlim=(-1, 1), xlabel=r"legibility $\ell$")
        panel.bar(centres, counts / len(pooled), 1.7 / _BINS, color=_COLORS(LABELS(centres)))
        panel.axhline(1 / _BINS, color=INK, lw=0.7, ls=DASHED)
        panel.yaxis.set_major_formatter(PercentFormatter(1, decimals=0))
        label_ticks(panel.xaxis)
        panel.set_title(f"{len(pooled):,} trajectories".replace(",", "\N{NARROW NO-BREAK SPACE}"))
        name_ends(figure, axes, scene, target, trajectories)
