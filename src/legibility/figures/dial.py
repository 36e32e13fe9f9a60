"""The pictures: planned paths, one scene's archive, and how exact the dial is.

Each function writes one file, PNG, PDF or SVG by its suffix, in one style: sized for a paper in two
columns, colours that the colour-blind can tell apart, and the same bytes from the same input.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path as FilePath
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib import patheffects, style
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import LinearSegmentedColormap, Normalize, to_rgba
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import PercentFormatter
from mpl_toolkits.mplot3d import proj3d
from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection
from numpy.typing import ArrayLike

from ..checks import Array
from ..envs.colors import GOALS, INK, MUTED
from ..errors import InvalidInputError, OutputError
from ..files import atomic_path
from ..intent.field import InformationPotentialField
from ..scene import Scene

if TYPE_CHECKING:
    from ..motion.path import Path

__all__ = [
    "HALO",
    "LABELS",
    "PAGE",
    "REDS",
    "STYLE",
    "add_lines",
    "archive_figure",
    "dial_figure",
    "figure_file",
    "flat",
    "goal_colors",
    "name_ends",
    "plan_figure",
    "scene_axes",
]

_COLUMN, PAGE = 3.5, 7.16  # widths [in] of one column and of both, IEEE

STYLE = {
    "font.family": "DejaVu Sans",  # comes with matplotlib, so that it is the same everywhere
    "font.size": 8,
    "mathtext.fontset": "dejavusans",
    "axes.titlesize": 8,
    "axes.labelsize": 8,
    "axes.labelpad": 2,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
    "legend.handlelength": 1,
    "legend.handletextpad": 0.4,
    "legend.labelspacing": 0.25,
    "pdf.fonttype": 42,  # IEEE refuses Type 3 fonts
    "savefig.dpi": 300,
    "svg.hashsalt": "legibility",
    "xtick.major.size": 2.5,
    "xtick.major.width": 0.6,
    "ytick.major.size": 2.5,
    "ytick.major.width": 0.6,
}
_METADATA = {".png": {}, ".pdf": {"CreationDate": None}, ".svg": {"Date": None}}  # without the time

_INK, _MUTED = INK, MUTED
_TARGET, *_OTHERS = GOALS
REDS = LinearSegmentedColormap.from_list(
    "legibility", ["#f59b80", "#ee664b", "#cf2330", "#8d0f22", "#3f0714"]
)
_DIVERGING = LinearSegmentedColormap.from_list(
    "ambiguous_straight_legible", ["#114b8c", "#5b93c7", "#b8b8b8", "#de6a55", "#96101f"]
)
LABELS = Normalize(-1, 1)
_BINS = 20
_POTENTIALS = (0.1, 0.7, 2.3, 7, 21, np.inf)
"""φ [nat] at which the background's shade changes: P(g*|x) is 0.9, 0.5, 0.1, ..."""
_SHADES = ("#f7f7f8", "#efeff1", "#e7e7ea", "#dfdfe3", "#d7d7dc")
_DASHED, _DOTTED = (0, (3.2, 1.2)), (0, (1, 2))
HALO = [patheffects.withStroke(linewidth=2.5, foreground="white")]

_BLOCK = {2: 0.035, 3: 0.05}
"""Side of a goal's block as a share of the workspace's diagonal, by dimension."""
_SQUARE = ((-1, -1), (1, -1), (1, 1), (-1, 1))
_CUBE = np.array([np.insert(_SQUARE, axis, side, 1) for axis in range(3) for side in (-1, 1)])
"""The faces of the cube [−1, 1]³, `(6, 4, 3)`."""


def plan_figure(path: Path, file: str | FilePath) -> None:
    """Draw planned paths, how early their intent is clear, and what they achieved.

    The scene to scale over the target's potential, paths light to dark red with ℓ (dashed where
    ℓ = 0); `P(g*|x_t)` over progress t; with more than one ℓ, asked against achieved.

    Args:
        path: one path or a batch.
        file: where to; .png, .pdf or .svg.

    Raises:
        OutputError: another suffix, or the file cannot be written.
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
        "linestyles": [_DASHED if abs(level) < 1e-6 else "solid" for level in levels],
        "path_effects": HALO if few else None,
    }

    with figure_file(file, PAGE if several else 0.62 * PAGE, 2.5) as figure:
        panels = _panels(
            figure, scene, 3 if several else 2, room=1.95, margin=1.5 if several else 0.8
        )
        axes = scene_axes(figure, panels[0], scene, target, curves, path.field)
        add_lines(axes, curves, **lines)
        if num <= 11:
            for points, color in zip(waypoints[:, 1:-1], colors, strict=True):
                axes.plot(*points.T, "o", ms=2.2, mfc="white", mec=color, mew=0.7, zorder=5)
        if several:
            bar = figure.colorbar(ScalarMappable(LABELS, REDS), ax=axes, aspect=24, pad=0.03)
            bar.set_ticks([-1, 0, 1], labels=["−1", "0", "1"])
            bar.set_label(r"legibility $\ell$", labelpad=0)
            bar.outline.set_visible(False)
        else:
            axes.set_title(rf"$\ell$ = {levels[0]:g}, achieved {achieved.mean():.2f}")

        panel = figure.add_subplot(panels[1], xlim=(0, 1), ylim=(0, 1.02), xlabel="progress $t$")
        panel.set_title("observer’s belief $P(g^*|x_t)$")
        chance = path.field.prior[target]
        panel.set_xticks((0, 0.5, 1), ("0", "0.5", "1"))
        panel.set_yticks((0, chance, 1), ("0", "chance", "1"))
        panel.axhline(chance, color=_MUTED, lw=0.7, ls=_DOTTED, zorder=0)
        panel.spines[:].set_zorder(5)
        progress = np.linspace(0, 1, curves.shape[1])
        beliefs = path.field.posterior(curves)[..., target]
        add_lines(panel, [np.stack([progress, row], axis=-1) for row in beliefs], **lines)

        if several:
            panel = figure.add_subplot(panels[2], title="asked and achieved")
            _asked_and_achieved(panel)
            panel.scatter(
                levels, achieved, s=18 if few else 8, c=colors, ec="white", linewidths=0.4,
                zorder=3, clip_on=False,
            )  # fmt: skip
            error = np.abs(achieved - levels).mean()
            panel.text(0.97, 0.04, f"mean error {error:.3f}", ha="right", transform=panel.transAxes)
        name_ends(figure, axes, scene, target, curves)


def archive_figure(
    scene: Scene,
    target: int,
    trajectories: Array,
    labels: Array,
    all_labels: ArrayLike,
    file: str | FilePath,
) -> None:
    """Draw one scene's trajectories coloured by label, and the labels of all scenes along ℓ.

    Args:
        scene: the scene.
        target: index of the intended goal.
        trajectories: `(N, T, D)` [m].
        labels: `(N,)`.
        all_labels: labels of the whole dataset, any shape.
        file: where to; .png, .pdf or .svg.

    Raises:
        OutputError: another suffix, or the file cannot be written.
    """
    num = len(labels)
    order = np.random.default_rng(0).permutation(num)  # so that no level hides the others
    everything = np.clip(np.asarray(all_labels, dtype=np.float64).ravel(), -1, 1)
    counts, edges = np.histogram(everything, bins=_BINS, range=(-1, 1))
    centres = (edges[1:] + edges[:-1]) / 2

    with figure_file(file, _COLUMN, 1.85) as figure:
        panels = _panels(figure, scene, 2, room=1.35, margin=0.6)
        axes = scene_axes(figure, panels[0], scene, target, trajectories)
        add_lines(
            axes, trajectories[order], colors=_DIVERGING(LABELS(labels[order])),
            linewidths=float(np.clip(9 / num**0.5, 0.35, 1.2)), rasterized=num > 300,
        )  # fmt: skip
        panel = figure.add_subplot(panels[1], xlim=(-1, 1), xlabel=r"legibility $\ell$")
        panel.bar(centres, counts / len(everything), 1.7 / _BINS, color=_DIVERGING(LABELS(centres)))
        panel.axhline(1 / _BINS, color=_INK, lw=0.7, ls=_DASHED)
        panel.yaxis.set_major_formatter(PercentFormatter(1, decimals=0))
        panel.set_xticks((-1, 0, 1), ("−1", "0", "1"))
        panel.set_title(
            f"{len(everything):,} trajectories".replace(",", "\N{NARROW NO-BREAK SPACE}")
        )
        name_ends(figure, axes, scene, target, trajectories)


def dial_figure(result: dict[str, Any], file: str | FilePath) -> None:
    """Draw asked against achieved ℓ over all scenes, and the error by level.

    Thin lines are scenes, the shade holds 95 % of them.

    Args:
        result: what `evaluate_dial` returned, or its JSON.
        file: where to; .png, .pdf or .svg.

    Raises:
        InvalidInputError: `result` is something else.
        OutputError: another suffix, or the file cannot be written.
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

    with figure_file(file, _COLUMN, 2.05) as figure:
        left, right = figure.subplots(1, 2)
        _asked_and_achieved(left)
        left.set_title(order)
        right.set(xlim=(-1, 1), xticks=(-1, 0, 1), xlabel=r"asked $\ell$")
        right.set_title(error)
        right.set_ylabel(r"$|$achieved − asked$|$")
        add_lines(
            left, [np.stack([levels, row], axis=-1) for row in achieved], linewidths=0.4, zorder=1,
            colors=to_rgba(_INK, float(np.clip(12 / len(achieved), 0.06, 0.5))),
            rasterized=len(achieved) > 300,
        )  # fmt: skip
        for panel, table in ((left, achieved), (right, errors)):
            band = np.percentile(table, (2.5, 97.5), axis=0)
            panel.fill_between(
                levels, *band, color=_TARGET, alpha=0.25, lw=0, label="95 % of scenes"
            )
            panel.plot(levels, table.mean(axis=0), color=_TARGET, lw=1.3, label="mean")
        right.set_ylim(0, None)
        right.locator_params(axis="y", nbins=4)
        left.legend(loc="upper left", bbox_to_anchor=(-0.02, 1.04), borderpad=0)


@contextlib.contextmanager
def figure_file(file: str | FilePath, width: float, height: float) -> Iterator[Figure]:
    """A figure of `width` × `height` [in] in the shared style, written to `file` on success."""
    suffix = FilePath(file).suffix.lower()
    if suffix not in _METADATA:
        raise OutputError(f"cannot write {file}: a figure must end in {', '.join(_METADATA)}")
    with style.context(["default", STYLE]):
        figure = Figure(figsize=(width, height), layout="constrained")
        yield figure
        with atomic_path(file) as temporary:
            figure.savefig(temporary, format=suffix[1:], metadata=_METADATA[suffix])


def _panels(figure: Figure, scene: Scene, num: int, *, room: float, margin: float) -> Any:
    """Cells for a scene `room` [in] high and, in what is left beside `margin`, equal panels."""
    extent = scene.workspace[1] - scene.workspace[0]
    width = room * (np.clip(extent[0] / extent[1], 0.5, 1.5) if scene.dim == 2 else 1.1)
    rest = (figure.get_figwidth() - margin - width) / (num - 1)
    return figure.add_gridspec(1, num, width_ratios=[width, *[rest] * (num - 1)])


def scene_axes(
    figure: Figure,
    cell: Any,
    scene: Scene,
    target: int,
    curves: Array,
    field: InformationPotentialField | None = None,
    blocks: float = 1.0,
) -> Any:
    """Axes with start and goals to scale, over the target's potential if a field is given.

    The goals' blocks are drawn `blocks` times as large as usual.
    """
    side = blocks * _BLOCK[scene.dim] * scene.diagonal
    colors = goal_colors(scene.num_goals, target)
    (x0, y0), (x1, y1) = scene.workspace[:, :2]
    ground = {}
    if scene.dim == 2:
        axes = figure.add_subplot(cell, xlim=(x0, x1), ylim=(y0, y1), xticks=[], yticks=[])
        axes.set_aspect("equal")
        axes.spines[:].set(visible=True, color=_MUTED)
        for goal, color in zip(scene.goals, colors, strict=True):
            block = Rectangle(goal - side / 2, side, side, color=color, lw=0, zorder=6)
            axes.add_patch(block).set_clip_on(False)
    else:
        table = scene.workspace[0, 2] - side / 2
        top = max(curves[..., 2].max(), scene.goals[:, 2].max()) + side / 2
        axes = _table_axes(figure, cell, np.array([[x0, y0, table], [x1, y1, top]]))
        for goal, color in zip(scene.goals, colors, strict=True):
            cube = goal + side / 2 * _CUBE
            axes.add_collection3d(Poly3DCollection(cube, facecolors=color, shade=True, zorder=6))
        drop = np.stack([scene.start, [*scene.start[:2], table]])
        axes.plot(*drop.T, color=_MUTED, lw=0.7, ls=_DOTTED, zorder=2)
        ground = {"zdir": "z", "offset": table}
    axes.plot(*scene.start[:, None], "o", ms=5, color=_INK, mec="white", mew=0.6, zorder=7)
    if field is not None:  # in 3D the slice at the target's height, laid on the table
        x, y = np.meshgrid(np.linspace(x0, x1, 201), np.linspace(y0, y1, 201))
        height = np.broadcast_to(scene.goals[target, 2:], (*x.shape, scene.dim - 2))
        phi = field.potential(np.concatenate([np.stack([x, y], -1), height], -1), target)
        axes.contourf(x, y, phi, _POTENTIALS, colors=_SHADES, zorder=0, **ground)
        key = r"shade: potential $\phi(x|g^*)$"
        axes.annotate(key, (0.5, -0.03), xycoords="axes fraction", ha="center", va="top")
    return axes


def goal_colors(num_goals: int, target: int) -> list[str]:
    """Of each goal, the target's always the same."""
    colors = [_OTHERS[i % len(_OTHERS)] for i in range(num_goals - 1)]
    colors.insert(target, _TARGET)
    return colors


def _table_axes(figure: Figure, cell: Any, corners: Array) -> Any:
    """3-D axes over the box between `corners (2, 3)` [m], as large as fits, and its floor."""
    axes: Any = figure.add_subplot(cell, projection="3d", proj_type="ortho", computed_zorder=False)
    axes.set(xlim=corners[:, 0], ylim=corners[:, 1], zlim=corners[:, 2])
    axes.set_axis_off()
    axes.view_init(elev=28, azim=-35)
    sides = corners[1] - corners[0]
    axes.set_box_aspect(tuple(sides))
    box = corners.mean(axis=0) + _CUBE * sides / 2
    shares = axes.transLimits.transform(flat(axes, box.reshape(-1, 3)))  # of the axes' room
    axes.set_box_aspect(tuple(sides), zoom=0.5 / np.abs(shares - 0.5).max())
    axes.add_collection3d(Poly3DCollection(box[4:5], fc="none", ec=_MUTED, lw=0.7, zorder=1))
    return axes


def flat(axes: Any, points: Array) -> Array:
    """Where `points (N, D)` [m] lie in the plane of the axes, `(N, 2)`."""
    if points.shape[-1] == 2:
        return points
    x, y, z = points.T
    return np.stack(proj3d.proj_transform(x, y, z, axes.get_proj())[:2], axis=-1)


def name_ends(figure: Figure, axes: Any, scene: Scene, target: int, curves: Array) -> None:
    """Write "start" and "target" beside their marks, where they hide least of the rest."""
    figure.draw_without_rendering()  # the layout settles, so that the room is known
    point, dim = figure.dpi / 72, scene.dim  # pixels of a point
    ends = np.stack([scene.start, scene.target(target)])
    blocks = scene.goals[:, None] + _BLOCK[dim] * scene.diagonal / 2 * _CUBE.reshape(-1, 3)[:, :dim]
    points = np.concatenate(
        [curves.reshape(-1, dim), ends[:1], np.tile(blocks.reshape(-1, dim), (25, 1))]
    )
    taken = axes.transData.transform(flat(axes, points))
    angle = np.deg2rad(np.arange(0, 360, 15))
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    other = np.full(2, np.inf)
    for text, end, color in zip(
        ("start", "target"), flat(axes, ends), (_INK, _TARGET), strict=True
    ):
        note = axes.annotate(
            text, end, (0, 0), textcoords="offset points", ha="center", va="center", color=color,
            zorder=8, path_effects=HALO, in_layout=False,
        )  # fmt: skip
        half = np.array(note.get_window_extent().size) / 2 + point
        offsets = np.concatenate([ring * (reach * point + half) for reach in (4, 8, 12)])
        centres = axes.transData.transform(end) + offsets
        hidden = np.array([(np.abs(taken - c) < half).all(-1).sum() for c in centres])
        spills = (centres + half > axes.bbox.max) | (centres - half < axes.bbox.min)
        clashes = (np.abs(centres - other) < 2 * half).all(-1)
        cost = hidden + 1e6 * (spills.any(-1) | clashes)
        best = np.argmin(cost + (1 + 0.03 * hidden.max()) * np.arange(len(cost)) / len(ring))
        note.set_position(tuple(offsets[best] / point))
        other = centres[best]


def add_lines(axes: Any, curves: ArrayLike, **options: Any) -> None:
    """`curves (N, T, D)` as one collection."""
    curves = np.asarray(curves)
    kind = LineCollection if curves.shape[-1] == 2 else Line3DCollection
    axes.add_collection(kind(list(curves), **{"zorder": 4, **options}))


def _asked_and_achieved(axes: Any) -> None:
    """Axes for asked against achieved ℓ, and the line on which they agree."""
    axes.plot([-1, 1], [-1, 1], color=_INK, lw=0.7, ls=_DASHED, zorder=2)
    axes.set(xlim=(-1, 1), ylim=(-1, 1), xlabel=r"asked $\ell$", ylabel=r"achieved $\ell$")
    axes.set_xticks((-1, 0, 1), ("−1", "0", "1"))
    axes.set_yticks((-1, 0, 1), ("−1", "0", "1"))
