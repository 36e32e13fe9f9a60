"""The shared style of all figures: widths for a paper in two columns, fonts and colours."""

import contextlib
from collections.abc import Iterator
from pathlib import Path as FilePath
from typing import Any

import numpy as np
from matplotlib import patheffects, style
from matplotlib.collections import LineCollection
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Line3DCollection
from numpy.typing import ArrayLike

from ..envs.colors import INK
from ..errors import OutputError
from ..files import atomic_path

COLUMN, PAGE = 3.5, 7.16
"""Widths of one column and of both, as IEEE prints them [in]."""

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
    "hatch.linewidth": 0.35,
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

REDS = LinearSegmentedColormap.from_list(
    "legibility", ["#f59b80", "#ee664b", "#cf2330", "#8d0f22", "#3f0714"]
)
LABELS = Normalize(-1, 1)
DASHED, DOTTED = (0, (3.2, 1.2)), (0, (1, 2))
HALO = [patheffects.withStroke(linewidth=2.5, foreground="white")]


@contextlib.contextmanager
def shared_style() -> Iterator[None]:
    """Draw in the shared style, whatever the user's settings of matplotlib and NumPy."""
    with style.context(["default", STYLE]), np.errstate(all="warn", under="ignore"):
        yield


@contextlib.contextmanager
def figure_file(file: str | FilePath, width: float, height: float) -> Iterator[Figure]:
    """A figure of `width` × `height` [in] in the shared style, written to `file` on success.

    The same figure gives the same bytes.

    Raises:
        OutputError: another suffix than .png, .pdf and .svg, or the file cannot be written.
    """
    suffix = FilePath(file).suffix.lower()
    if suffix not in _METADATA:
        raise OutputError(f"cannot write {file}: a figure must end in {', '.join(_METADATA)}")
    with shared_style():
        figure = Figure(figsize=(width, height), layout="constrained")
        yield figure
        with atomic_path(file) as temporary:
            figure.savefig(temporary, format=suffix[1:], metadata=_METADATA[suffix])


def add_lines(axes: Any, curves: ArrayLike, **options: Any) -> None:
    """Add `curves (N, T, D)` as one collection."""
    curves = np.asarray(curves)
    collection = LineCollection if curves.shape[-1] == 2 else Line3DCollection
    axes.add_collection(collection(list(curves), **{"zorder": 4, **options}))


def label_ticks(*axes: Any) -> None:
    """Ticks −1, 0 and 1 on each axis of labels."""
    for axis in axes:
        axis.set_ticks((-1, 0, 1), labels=("−1", "0", "1"))


def compare_labels(panel: Any) -> None:
    """Set up axes of asked against achieved ℓ with the line on which they agree."""
    panel.plot([-1, 1], [-1, 1], color=INK, lw=0.7, ls=DASHED, zorder=2)
    panel.set(xlim=(-1, 1), ylim=(-1, 1), xlabel=r"asked $\ell$", ylabel=r"achieved $\ell$")
    label_ticks(panel.xaxis, panel.yaxis)
