"""The figure of the spectrum: motions, and their cost against ℓ (paper, fig. 3)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path as FilePath
from typing import Any

import numpy as np

from ..envs.colors import INK, MUTED
from ..evaluation.spectrum import Spectrum
from ..evaluation.statistics import bootstrap_interval
from .scene_axes import name_ends, scene_axes
from .style import LABELS, PAGE, REDS, add_lines, figure_file, label_ticks

_HEIGHT, _SHARE = 2.6, 0.58
_DPI = 300
_TUBE = 0.0045
_DECADE = 20
_SHOWN = 11


def spectrum_figure(spectra: Sequence[Spectrum], file: str | FilePath) -> None:
    """Draw motions, light to dark red with ℓ, and beside them their cost L_p against ℓ.

    An arm is rendered at its table, the motions of the gripper as tubes; of more than 11 levels
    some are drawn. Costs are means with their 95 % interval.

    Args:
        spectra: one for each row.
        file: see `figure_file`.
    """
    with figure_file(file, PAGE, _HEIGHT * len(spectra)) as figure:
        cells = figure.add_gridspec(len(spectra), 2, width_ratios=[_SHARE, 1 - _SHARE])
        for row, spectrum in enumerate(spectra):
            _draw_motions(figure, cells[row, 0], spectrum)
            _draw_costs(figure, cells[row, 1], spectrum)


def _draw_motions(figure: Any, cell: Any, spectrum: Spectrum) -> None:
    shown = np.unique(np.linspace(0, len(spectrum.levels) - 1, _SHOWN).round().astype(int))
    motions = [spectrum.motions[i] for i in shown]
    colors = REDS(LABELS(spectrum.levels[shown]))
    if spectrum.angles.size:
        from ..envs.panda_render import Trail, arm_image

        axes = figure.add_subplot(cell)
        axes.set_axis_off()
        trails = [Trail(m, tuple(c), _TUBE) for m, c in zip(motions, colors, strict=True)]
        size = round(PAGE * _SHARE * _DPI), round(_HEIGHT * _DPI)
        axes.imshow(
            arm_image(spectrum.scene, spectrum.target, spectrum.angles, trails=trails, size=size)
        )
        return
    axes = scene_axes(figure, cell, spectrum.scene, spectrum.target, motions[0], spectrum.field)
    for motion, color in zip(motions, colors, strict=True):
        add_lines(axes, motion[None], colors=color, linewidths=1.5)
    name_ends(figure, axes, spectrum.scene, spectrum.target, np.concatenate(motions))


def _draw_costs(figure: Any, cell: Any, spectrum: Spectrum) -> None:
    panel = figure.add_subplot(cell, xlim=(-1.05, 1.05), xlabel=r"legibility $\ell$")
    panel.set_ylabel(r"cost $L_p$ (lower: more legible)")
    label_ticks(panel.xaxis)
    levels, means = spectrum.levels, spectrum.costs.mean(axis=1)
    if spectrum.costs.shape[1] > 1:
        band = np.array([bootstrap_interval(row) for row in spectrum.costs])
        panel.fill_between(levels, *band.T, color=MUTED, alpha=0.35, lw=0, zorder=0)
    panel.plot(levels, means, color=MUTED, lw=1, zorder=1)
    panel.scatter(levels, means, s=26, c=REDS(LABELS(levels)), ec=INK, linewidths=0.5, zorder=2)
    if means.max() > _DECADE * means.min():
        panel.set_yscale("log")
