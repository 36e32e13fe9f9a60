"""The figures of a paper: planned paths, a scene's archive, the dial and the spectrum."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from pathlib import Path as FilePath
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LinearSegmentedColormap, to_rgba
from matplotlib.ticker import PercentFormatter
from numpy.typing import ArrayLike

from ..checks import Array
from ..envs.colors import GOALS, INK, MUTED
from ..envs.panda_render import Trail, arm_image
from ..errors import InvalidInputError
from ..evaluation.planning import PLACES
from ..evaluation.statistics import bootstrap_interval
from ..scene import Scene
from .belief import Reader, readers
from .scene_axes import name_ends, scene_axes, scene_cells
from .style import (
    COLUMN,
    DASHED,
    DOTTED,
    HALO,
    LABELS,
    PAGE,
    REDS,
    add_lines,
    compare_labels,
    figure_file,
    label_ticks,
)

if TYPE_CHECKING:
    from ..evaluation.spectrum import Spectrum
    from ..motion.path import Path

_COLORS = LinearSegmentedColormap.from_list(
    "ambiguous_straight_legible", ["#114b8c", "#5b93c7", "#b8b8b8", "#de6a55", "#96101f"]
)
_BINS = 20
_HEIGHT, _SHARE = 2.6, 0.58
_DPI = 300
_TUBE = 0.0045
_DECADE = 20
_SHOWN = 11


def plan_figure(path: Path, file: str | FilePath) -> None:
    """Draw planned paths, the belief in the target along them, and the labels achieved.

    The scene to scale over the target's potential for the observer that the dial is turned for,
    paths light to dark red with ℓ (dashed where ℓ = 0); `P(g*|x_t)` over progress t as Dragan's
    observer and, if that is another, the dial's reads it; with more than one ℓ, asked against
    achieved.

    Args:
        path: one path or a batch.
        file: see `figure_file`.
    """
    scene, target = path.scene, path.target
    levels, achieved = np.atleast_1d(path.legibility), np.atleast_1d(path.achieved)
    num = len(levels)
    order = np.argsort(levels, kind="stable")
    levels, achieved = levels[order], achieved[order]
    waypoints = path.waypoints.reshape(num, -1, scene.dim)[order]
    curves = path.trajectory(129).reshape(num, -1, scene.dim)[order]
    colors = REDS(LABELS(levels))
    several = levels[0] < levels[-1]
    few = num <= 25
    lines: dict[str, Any] = {
        "colors": colors,
        "linewidths": 1.5 if few else 0.7,
        "linestyles": [DASHED if abs(level) < 1e-6 else "solid" for level in levels],
        "path_effects": HALO if few else None,
    }

    shown = readers(scene, path.observer)
    height = 2.5 if len(shown) == 1 else 2.9

    with figure_file(file, PAGE if several else 0.62 * PAGE, height) as figure:
        margin = 1.5 if several else 0.8
        cells = scene_cells(figure, scene, 3 if several else 2, height=1.95, margin=margin)
        axes = scene_axes(
            figure, cells[0], scene, target, curves, path.field, reader=shown[-1].short
        )
        add_lines(axes, curves, **lines)
        if num <= 11:
            for points, color in zip(waypoints[:, 1:-1], colors, strict=True):
                axes.plot(*points.T, "o", ms=2.2, mfc="white", mec=color, mew=0.7, zorder=5)
        if several:
            bar = figure.colorbar(ScalarMappable(LABELS, REDS), ax=axes, aspect=24, pad=0.03)
            label_ticks(bar)
            bar.set_label(r"legibility $\ell$", labelpad=0)
            bar.outline.set_visible(False)
        else:
            axes.set_title(rf"$\ell$ = {levels[0]:g}, achieved {achieved.mean():.2f}")

        _draw_beliefs(figure, cells[1], shown, scene, target, curves, lines)
        if several:
            panel = figure.add_subplot(cells[2], title="asked and achieved")
            compare_labels(panel)
            panel.scatter(
                levels, achieved, s=18 if few else 8, c=colors, ec="white", linewidths=0.4,
                zorder=3, clip_on=False,
            )  # fmt: skip
            error = np.abs(achieved - levels).mean()
            panel.text(0.97, 0.04, f"mean error {error:.3f}", ha="right", transform=panel.transAxes)
        name_ends(figure, axes, scene, target, curves)


def _draw_beliefs(
    figure: Any, cell: Any, shown: list[Reader], scene: Scene, target: int, curves: Array,
    lines: dict[str, Any],
) -> None:  # fmt: skip
    """`P(g*|x_t)` of each reader over progress, one panel above the other."""
    progress = np.linspace(0, 1, curves.shape[1])
    panel: Any = None
    for row, reader in zip(cell.subgridspec(len(shown), 1), shown, strict=True):
        panel = figure.add_subplot(row, xlim=(0, 1), ylim=(0, 1.02), sharex=panel)
        if len(shown) == 1:
            panel.set_title(f"belief $P(g^*|x_t)$\nof {reader.title}")
        else:
            name, bracket, rest = f"belief of {reader.title}".partition(" (")
            width = 24 if bracket else 99
            words = [*textwrap.wrap(name, width), *textwrap.wrap(bracket[1:] + rest, 34)]
            panel.set_title("\n".join(words), fontsize=7, pad=3)
        panel.set_yticks((0, 1 / scene.num_goals, 1), ("0", "chance", "1"))
        panel.axhline(1 / scene.num_goals, color=MUTED, lw=0.7, ls=DOTTED, zorder=0)
        panel.spines[:].set_zorder(5)
        beliefs = reader.observer.field(scene).posterior(curves)[..., target]
        add_lines(panel, [np.stack([progress, row], axis=-1) for row in beliefs], **lines)
        panel.set_xticks((0, 0.5, 1), ("0", "0.5", "1"))
        panel.tick_params(labelbottom=reader is shown[-1])
    panel.set_xlabel("progress $t$")


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
        file: see `figure_file`.
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


def dial_figure(result: dict[str, Any], file: str | FilePath) -> None:
    """Draw asked against achieved ℓ of quick plans over all scenes, and the error by level.

    Thin lines are scenes, the shade holds 95 % of them.

    Args:
        result: what `evaluate_dial` returned, or its JSON.
        file: see `figure_file`.

    Raises:
        InvalidInputError: `result` is something else.
    """
    try:
        levels = np.array(result["levels"], dtype=np.float64)
        overall, scenes = result["overall"], result["scenes"]
        mode = next(m for m in ("quick", "exact", "bare") if m in overall)
        achieved = np.array([s[mode]["achieved"] for s in scenes], dtype=np.float64)
        errors = np.array([s[mode]["error_by_level"] for s in scenes], dtype=np.float64)
        order = "Spearman {mean:.3f}\nworst scene {min:.3f}".format(**overall[mode]["spearman"])
        error = "mean error {mean:.3f}".format(**overall[mode]["error"])
        if mode == "quick" and "exact" in overall:
            error += "\nexact {mean:.3f}".format(**overall["exact"]["error"])
        if not achieved.shape == errors.shape == (len(errors), len(levels)):
            raise ValueError(f"{achieved.shape} numbers for {len(levels)} levels")
    except (KeyError, TypeError, ValueError, StopIteration) as cause:
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


def planning_figure(result: dict[str, Any], file: str | FilePath) -> None:
    """Draw the error of ℓ against the time to plan, in free space and past obstacles.

    In a scene never seen before; open marks are of one that was planned in. Searches are one line.

    Args:
        result: what `evaluate_planning` returned, or its JSON.
        file: see `figure_file`.
    """
    styles = {"quick": (GOALS[0], "o"), "exact": (GOALS[1], "s"), "archive": (INK, "D")}
    with figure_file(file, COLUMN, 2.6) as figure:
        panels = figure.subplots(1, len(result), sharey=True)
        for panel, (regime, found) in zip(panels, result.items(), strict=True):
            planners = found["planners"]

            def at(name: str, span: str, planners: Any = planners) -> tuple[float, float]:
                return planners[name][span]["median"], planners[name]["error"]["mean"]

            searches = np.array([at(n, "new") for n in planners if n.startswith("search")])
            if len(searches):
                panel.plot(*searches.T, color=MUTED, lw=1, marker=".", label="search")
            for name, (color, marker) in styles.items():
                new, known = at(name, "new"), at(name, "known")
                panel.plot(*zip(known, new, strict=True), color=color, lw=0.6, ls=DOTTED)
                panel.plot(*new, marker, color=color, ms=4.5, label=name)
                panel.plot(*known, marker, color=color, ms=4.5, mfc="white")
            noise = found["noise"]["mean"]
            panel.axhline(noise, color=INK, lw=0.7, ls=DASHED, zorder=0, label="another archive")
            panel.set(xscale="log", yscale="log", xlabel="time to plan [ms]")
            panel.set_title(PLACES[regime])
        panels[0].set_ylabel("mean error of $\\ell$")
        panels[0].plot([], [], "o", color=INK, ms=4.5, mfc="white", label="known scene")
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=3, columnspacing=1.2)


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
