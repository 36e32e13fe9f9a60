"""Executed motions side by side, with what the observer believes under each: a picture or a film.

A viewer sees when the intent becomes clear: a trail has the colour of what the observer believes at
that moment, and a diamond marks from where on the target is believed for good.
"""

from __future__ import annotations

import itertools
import shutil
import subprocess
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path as FilePath
from typing import Any

import numpy as np
from matplotlib import style
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.legend_handler import HandlerTuple
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from numpy.typing import NDArray
from PIL import Image

from ..checks import Array
from ..colors import INK, MUTED
from ..envs.block_reach_2d import BlockReach2DVector
from ..errors import InvalidInputError, OutputError
from ..execution import Rollout
from ..files import atomic_path
from ..intent.observers import time_to_confidence
from .figures import STYLE, figure_file, flat, goal_colors, scene_axes

__all__ = ["FILMS", "MOST", "check_film", "check_number", "execution_figure", "execution_film"]

FILMS = (".gif", ".mp4")
"""Formats of a film."""

MOST = 25
"""Motions that are shown side by side."""

_SECONDS = 1 / BlockReach2DVector.metadata["render_fps"]
_CONFIDENT = 0.8
_COLUMNS = 5
_DPI = {".gif": 110, ".mp4": 200}
_DOTTED = (0, (1, 2))
_HOLD = 1.5
"""How long a film stands still at its end [s]."""


def check_film(file: str | FilePath) -> None:
    """Raise if a film of this name cannot be written here.

    Raises:
        OutputError: another suffix, or what writes it is not installed.
    """
    suffix = FilePath(file).suffix.lower()
    if suffix not in FILMS:
        raise OutputError(f"cannot write the film {file}: its name must end in {', '.join(FILMS)}")
    if suffix == ".mp4" and shutil.which("ffmpeg") is None:
        raise OutputError(f"cannot write the film {file}: .mp4 needs ffmpeg; .gif does not")


def check_number(number: int) -> None:
    """Raise if so many motions cannot be shown side by side."""
    if not 1 <= number <= MOST:
        raise InvalidInputError(f"a picture or film shows 1 to {MOST} motions, got {number}")


def execution_figure(rollouts: Sequence[Rollout], file: str | FilePath) -> None:
    """Draw executed motions side by side and the observer's belief over time under each.

    Args:
        rollouts: in one scene, toward one target.
        file: where to; .png, .pdf or .svg.

    Raises:
        InvalidInputError: there are none, or too many.
        OutputError: another suffix, or the file cannot be written.
    """
    check_number(len(rollouts))
    layout = _Layout(len(rollouts))
    with figure_file(file, layout.width, layout.height) as figure:
        _Stage(figure, layout, rollouts).show(np.inf)


def execution_film(rollouts: Sequence[Rollout], file: str | FilePath) -> None:
    """Film executed motions side by side, in real time, a frame a control step.

    Args:
        rollouts: in one scene, toward one target.
        file: where to; .gif, or .mp4 where ffmpeg is installed.

    Raises:
        InvalidInputError: there are none, or too many.
        OutputError: another suffix, or the file cannot be written.
    """
    check_film(file)
    check_number(len(rollouts))
    suffix = FilePath(file).suffix.lower()
    layout = _Layout(len(rollouts))
    write: Callable[..., None] = _write_gif if suffix == ".gif" else _write_mp4
    with style.context(["default", STYLE]), atomic_path(file) as temporary:
        figure = Figure((layout.width, layout.height), dpi=_DPI[suffix], layout="constrained")
        stage = _Stage(figure, layout, rollouts)
        write(temporary, *stage.frames())


class _Layout:
    """How many columns and rows the motions take, and the size of the figure [in]."""

    def __init__(self, number: int) -> None:
        self.rows = -(-number // _COLUMNS)
        self.columns = -(-number // self.rows)
        self.key_columns = min(self.columns, 4) if self.columns > 1 else 1
        self.width = self.columns * (2.3 if self.columns < 3 else 1.75) + 0.35
        scene = 2.3 if self.columns < 3 else 1.75
        self.height = self.rows * (scene + 1.15) + 0.2 * -(-4 // self.key_columns)


class _Stage:
    """The axes of all motions, and how they look at a time."""

    def __init__(self, figure: Figure, layout: _Layout, rollouts: Sequence[Rollout]) -> None:
        self.figure = figure
        self.longest = max(len(r.actions) for r in rollouts) * _SECONDS
        path = rollouts[0].path
        self.colors = goal_colors(path.scene.num_goals, path.target)
        cells = figure.add_gridspec(
            2 * layout.rows, layout.columns, height_ratios=[1.75, 1] * layout.rows
        )
        self.motions = []
        for number, rollout in enumerate(rollouts):
            row, column = divmod(number, layout.columns)
            panel = figure.add_subplot(
                cells[2 * row + 1, column], xlim=(0, self.longest), ylim=(-0.04, 1.06)
            )
            panel.set_yticks((0, 0.5, 1), ("0", "½", "1"))
            panel.locator_params(axis="x", nbins=4)
            if number + layout.columns >= len(rollouts):
                panel.set_xlabel("time [s]")
            if column == 0:
                panel.set_ylabel("belief $P(g|x_t)$")
            else:
                panel.tick_params(labelleft=False)
            curves = rollout.states[None]
            axes = scene_axes(
                figure, cells[2 * row, column], path.scene, path.target, curves, blocks=1.5
            )
            self.motions.append(_Motion(axes, panel, rollout, self.colors))
        self._add_key(layout, path.target)

    def _add_key(self, layout: _Layout, target: int) -> None:
        others = [color for goal, color in enumerate(self.colors) if goal != target]

        def square(color: str) -> Line2D:
            return Line2D([], [], ls="", marker="s", ms=5, color=color)

        def line(color: str) -> Line2D:
            return Line2D([], [], color=color, lw=2)

        entries: list[tuple[Any, str]] = [
            (square(self.colors[target]), "target"),
            (tuple(map(square, others)), "other goal" + "s" * (len(others) > 1)),
            (
                tuple(map(line, (self.colors[target], *others[:2]))),
                "executed, in the colour of what is believed",
            ),
            (Line2D([], [], color=INK, lw=0.7, ls=_DOTTED), "planned"),
            (_diamond([], []), rf"clear: $P(\mathrm{{target}})$ ≥ {_CONFIDENT:g} for good"),
        ]
        handles, labels = zip(*entries, strict=True)
        self.figure.legend(
            handles, labels, loc="outside lower center", ncols=layout.key_columns,
            handler_map={tuple: HandlerTuple(ndivide=None, pad=0.2)}, columnspacing=1.5,
        )  # fmt: skip

    def show(self, now: float) -> None:
        """How it looks `now` [s]."""
        for motion in self.motions:
            motion.show(now)

    def frames(self) -> tuple[int, Iterator[NDArray[np.uint8]]]:
        """How many pictures `(H, W, 3)` there are, the last first as well, and the pictures."""
        canvas = FigureCanvasAgg(self.figure)
        self.show(np.inf)
        canvas.draw()  # the layout settles with everything in it
        self.figure.set_layout_engine("none")
        moving = [artist for motion in self.motions for artist in motion.moving]
        for artist in moving:
            artist.set_animated(True)
        canvas.draw()
        ground = canvas.copy_from_bbox(self.figure.bbox)

        def picture(now: float) -> NDArray[np.uint8]:
            canvas.restore_region(ground)
            self.show(now)
            for artist in moving:
                artist.axes.draw_artist(artist)
            return np.asarray(canvas.buffer_rgba())[..., :3].copy()

        number = round(self.longest / _SECONDS) + 1
        times = itertools.chain([np.inf], (step * _SECONDS for step in range(number)))
        return number, map(picture, times)


class _Motion:
    """One motion and the belief under it."""

    def __init__(self, axes: Any, panel: Any, rollout: Rollout, colors: list[str]) -> None:
        path = rollout.path
        self.states = flat(axes, rollout.states)
        self.beliefs = rollout.posterior
        self.target = path.target
        self.last = len(rollout.actions)
        share = float(time_to_confidence(self.beliefs, path.target, _CONFIDENT))
        self.clear = round(share * self.last) if np.isfinite(share) else self.last + 1
        blended = self.beliefs @ np.array([to_rgb(color) for color in colors])
        self.tints = (blended[1:] + blended[:-1]) / 2

        ended = "" if rollout.success else f", {rollout.reason}"
        title = rf"$\ell$ = {rollout.legibility:g}" + f"\nachieved {rollout.achieved:.2f}{ended}"
        axes.set_title(title.replace("-", "−"))
        panel.set_title(" ", fontsize=7, pad=2)
        planned = flat(axes, path.trajectory(129))

        def add(artist: Any, to: Any = axes) -> Any:
            to.add_artist(artist).set_clip_on(False)
            return artist

        front = [artist for artist in axes.get_children() if artist.get_zorder() > 5]
        self.halo = add(Line2D([], [], color="white", lw=3.2, zorder=4))
        self.trail = add(LineCollection([], linewidths=2, capstyle="round", zorder=4.1))
        self.plan = add(Line2D(*planned.T, color=INK, lw=0.7, ls=_DOTTED, zorder=4.2))
        self.spot = add(_diamond(*self.states[[min(self.clear, self.last)]].T))
        self.robot = add(Line2D([], [], marker="o", ms=5, color=INK, mec="white", zorder=10))
        times = np.arange(self.last + 1) * _SECONDS
        self.times = times
        self.lines = [
            add(Line2D([], [], color=color, lw=1.8 if goal == path.target else 1.1,
                       zorder=5 if goal == path.target else 4), panel)
            for goal, color in enumerate(colors)
        ]  # fmt: skip
        start = min(self.clear, self.last)
        self.shade = add(
            Rectangle((times[start], -0.04), 0, 1.1, color=colors[path.target], alpha=0.15, lw=0,
                      zorder=1), panel,
        )  # fmt: skip
        self.moment = add(_diamond(times[start : start + 1], self.beliefs[start, [path.target]]), panel)
        panel.axhline(_CONFIDENT, color=MUTED, lw=0.6, ls=_DOTTED, zorder=0)
        self.label = panel.title
        self.moving = sorted(
            [*front, self.halo, self.trail, self.plan, self.spot, self.robot, *self.lines, self.shade,
             self.moment, self.label],
            key=lambda artist: artist.get_zorder(),
        )  # fmt: skip

    def show(self, now: float) -> None:
        """How it looks `now` [s]."""
        step = min(self.last, int(min(now, 1e6) / _SECONDS + 1e-6))
        seen = self.states[: step + 1]
        self.halo.set_data(*seen.T)
        self.trail.set_segments(np.stack([seen[:-1], seen[1:]], axis=1))
        self.trail.set_color(self.tints[:step])
        self.robot.set_data(*seen[-1:].T)
        for goal, line in enumerate(self.lines):
            line.set_data(self.times[: step + 1], self.beliefs[: step + 1, goal])
        clear = step >= self.clear
        for artist in (self.spot, self.moment, self.shade):
            artist.set_visible(clear)
        self.shade.set_width(max(0, step - self.clear) * _SECONDS)
        text = " "
        if clear:
            text = f"clear after {self.clear * _SECONDS:.2f} s" if self.clear else "clear from the start"
        elif step == self.last:
            text = "never clear"
        self.label.set_text(text)


def _diamond(x: Any, y: Any) -> Line2D:
    """The mark of the moment from which on the intent is clear."""
    return Line2D(x, y, ls="", marker="D", ms=4.5, color="white", mec=INK, mew=1, zorder=9)


def _write_gif(file: FilePath, number: int, pictures: Iterator[NDArray[np.uint8]]) -> None:
    palette = Image.new("P", (1, 1))  # one for all, so that it is kept once
    palette.putpalette(_main_colors(next(pictures), 255).tobytes())
    frames = (
        Image.fromarray(picture).quantize(palette=palette, dither=Image.Dither.NONE)
        for picture in pictures
    )
    durations = [round(1000 * _SECONDS)] * (number - 1) + [round(1000 * (_HOLD + _SECONDS))]
    next(frames).save(
        file, format="GIF", save_all=True, append_images=frames, duration=durations, loop=0,
        disposal=1, optimize=False,
    )  # fmt: skip


def _main_colors(picture: NDArray[np.uint8], number: int) -> NDArray[np.uint8]:
    """The most frequent colours, `(number or fewer, 3)`; text and lines keep theirs exactly."""
    red, green, blue = np.moveaxis(picture.astype(np.uint32), -1, 0)
    found, counts = np.unique(red << 16 | green << 8 | blue, return_counts=True)
    packed = found[np.argsort(-counts, kind="stable")[:number]]
    return np.stack([packed >> 16, packed >> 8 & 255, packed & 255], axis=-1).astype(np.uint8)


def _write_mp4(file: FilePath, number: int, pictures: Iterator[NDArray[np.uint8]]) -> None:
    final = next(pictures)
    height, width, _ = final.shape
    rate = round(1 / _SECONDS)
    command = [
        "ffmpeg", "-loglevel", "error", "-y", "-f", "rawvideo", "-pix_fmt", "rgb24",
        "-s", f"{width}x{height}", "-r", str(rate), "-i", "-",
        "-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2:color=white", "-pix_fmt", "yuv420p",
        "-movflags", "+faststart", str(file),
    ]  # fmt: skip
    hold = itertools.repeat(final, round(_HOLD * rate))
    with subprocess.Popen(command, stdin=subprocess.PIPE, stderr=subprocess.PIPE) as encoder:
        assert encoder.stdin is not None
        assert encoder.stderr is not None
        try:
            for picture in itertools.chain(pictures, hold):
                encoder.stdin.write(picture.tobytes())
            encoder.stdin.close()
        except BrokenPipeError:  # it has ended and says why
            pass
        said = encoder.stderr.read().decode(errors="replace").strip()
    if encoder.returncode:
        raise OutputError(f"cannot write the film {file}: ffmpeg: {said or encoder.returncode}")
