"""Executed motions side by side, with the belief under each: a figure or a film.

The belief is that of Dragan's observer, and below it that of the one the dial is turned for if that
is another. A trail has the colour of the first at that moment, and a diamond marks the time to
confidence: from there on the observer believes in the target for good.
"""

from __future__ import annotations

import contextlib
import shutil
import subprocess
import textwrap
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path as FilePath
from typing import Any

import numpy as np
from matplotlib import rcParams
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.legend_handler import HandlerTuple
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from numpy.typing import NDArray
from PIL import Image

from ..envs.colors import INK, MUTED
from ..errors import InvalidInputError, OutputError
from ..files import atomic_path
from ..intent.metrics import CONFIDENCE
from ..rollout import Rollout
from .belief import Reader, readers
from .obstacles import key
from .scene_axes import ArmView, DrawnView, add_artist, diamond, goal_colors
from .style import DOTTED, figure_file, shared_style

Picture = NDArray[np.uint8]

FILMS = (".gif", ".mp4")
"""Formats of a film."""

MOST = 25
"""Most motions that are shown side by side."""

_COLUMNS = 5
_DPI = {".gif": 110, ".mp4": 200}
_EXACT = 48
_LINE, _SMALL, _LETTER = 0.14, 0.125, 0.056
"""Height of a line of the key, height of a line of the caption and width of its letters [in]."""
_HOLD = 1.5
"""Duration of the still at the end of a film [s]."""


def check_film(file: str | FilePath) -> None:
    """Raise if a film of this name cannot be written here.

    Raises:
        OutputError: another suffix, or .mp4 without ffmpeg.
    """
    suffix = FilePath(file).suffix.lower()
    if suffix not in FILMS:
        raise OutputError(f"cannot write the film {file}: its name must end in {', '.join(FILMS)}")
    if suffix == ".mp4" and shutil.which("ffmpeg") is None:
        raise OutputError(f"cannot write the film {file}: .mp4 needs ffmpeg; .gif does not")


def check_number(number: int) -> None:
    """Raise unless `number` motions can be shown side by side."""
    if not 1 <= number <= MOST:
        raise InvalidInputError(f"a figure or film shows 1 to {MOST} motions, got {number}")


def execution_figure(rollouts: Sequence[Rollout], file: str | FilePath) -> None:
    """Draw executed motions side by side and the belief over time under each.

    Args:
        rollouts: 1 to `MOST`, in one scene, toward one target; another number raises.
        file: see `figure_file`.
    """
    check_number(len(rollouts))
    layout = _Layout(rollouts)
    with figure_file(file, *layout.size) as figure:
        stage = _Stage(figure, layout, rollouts, rcParams["savefig.dpi"])
        stage.show(stage.last)


def execution_film(
    rollouts: Sequence[Rollout],
    file: str | FilePath,
    *,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> None:
    """Film executed motions side by side, in real time, a frame a control step.

    Args:
        rollouts: see `execution_figure`.
        file: .gif, or .mp4 where ffmpeg is installed; see `check_film`.
        progress: called with the frames done and the frames in all.
    """
    check_film(file)
    check_number(len(rollouts))
    suffix = FilePath(file).suffix.lower()
    layout = _Layout(rollouts)
    write = _write_gif if suffix == ".gif" else _write_mp4
    with shared_style(), atomic_path(file) as temporary:
        figure = Figure(layout.size, dpi=_DPI[suffix])
        stage = _Stage(figure, layout, rollouts, figure.dpi)
        write(temporary, *stage.frames(progress), rollouts[0].step_seconds)


class _Layout:
    """Sizes of all cells [in], so that scenes and panels of all motions align exactly."""

    def __init__(self, rollouts: Sequence[Rollout]) -> None:
        path = rollouts[0].path
        scene = path.scene
        self.readers = readers(scene, path.observer)
        self.rows = -(-len(rollouts) // _COLUMNS)
        self.columns = -(-len(rollouts) // self.rows)
        extent = scene.workspace[1] - scene.workspace[0]
        width = 2.2 if self.columns < 3 else 1.62
        height = width * (np.clip(extent[1] / extent[0], 0.5, 1.5) if scene.dim == 2 else 0.9)
        self.widths = [0.55, *[width, 0.12] * self.columns]
        self.key_columns = (1, 2, 2, 3, 5)[self.columns - 1]
        self.key = _key(goal_colors(scene.num_goals, path.target), path.target)
        if not rollouts[0].joint_angles.size:  # an arm is rendered
            self.key |= key(scene)
        self.caption = textwrap.wrap(_caption(self.readers), int(sum(self.widths) / _LETTER))
        lines = -(-len(self.key) // self.key_columns)
        self.foot = 0.12 + _SMALL * len(self.caption)
        self.heights = [*[0.38, height, *[0.22, 0.8] * len(self.readers), 0.36] * self.rows]
        self.heights.append(self.foot + 0.08 + _LINE * lines)
        self.size = sum(self.widths), sum(self.heights)


def _key(colors: list[str], target: int) -> dict[str, Any]:
    """The entries of the legend: their names and handles."""
    others = [color for goal, color in enumerate(colors) if goal != target]
    squares = [
        Line2D([], [], ls="", marker="s", ms=4.5, color=color)
        for color in (colors[target], *others[:2])
    ]
    trails = [Line2D([], [], color=color, lw=2) for color in (colors[target], others[0])]
    confident = rf"time to confidence: $P(\mathrm{{target}})$ ≥ {CONFIDENCE:g} for good"
    return {
        "target": squares[0],
        "other goal" + "s" * (len(others) > 1): tuple(squares[1:]),
        "planned": Line2D([], [], color=INK, lw=0.7, ls=DOTTED),
        "executed, coloured by belief": tuple(trails),
        confident: diamond([], []),
    }


def _caption(shown: Sequence[Reader]) -> str:
    """Whose belief is where."""
    first, *others = (reader.title for reader in shown)
    text = f"Belief, colours and confidence are those of {first}"
    return "; ".join([text, *(f"in the lower panels, of {title}" for title in others)]) + "."


class _Stage:
    """The axes of all motions at any control step."""

    def __init__(
        self, figure: Figure, layout: _Layout, rollouts: Sequence[Rollout], dpi: float
    ) -> None:
        self.figure = figure
        self.last = max(len(rollout.actions) for rollout in rollouts)
        path = rollouts[0].path
        colors = goal_colors(path.scene.num_goals, path.target)
        figure.set_layout_engine("none")
        cells = figure.add_gridspec(
            len(layout.heights), len(layout.widths), left=0, right=1, bottom=0, top=1, wspace=0,
            hspace=0, width_ratios=layout.widths, height_ratios=layout.heights,
        )  # fmt: skip
        self.motions = []
        for number, rollout in enumerate(rollouts):
            row, column = divmod(number, layout.columns)
            top = row * (len(layout.heights) // layout.rows)
            beliefs = []
            for place, reader in enumerate(layout.readers):
                panel = figure.add_subplot(
                    cells[top + 3 + 2 * place, 2 * column + 1],
                    xlim=(0, self.last * rollouts[0].step_seconds),
                    ylim=(-0.04, 1.06),
                )
                panel.set_yticks((0, 0.5, 1), ("0", "½", "1"))
                panel.locator_params(axis="x", nbins=4)
                panel.xaxis.set_major_formatter("{x:g}")
                lowest = reader is layout.readers[-1]
                panel.tick_params(labelleft=column == 0, labelbottom=lowest)
                if lowest and number + layout.columns >= len(rollouts):
                    panel.set_xlabel("time [s]")
                if column == 0:
                    panel.set_ylabel(f"belief of\n{reader.short}", fontsize=7)
                beliefs.append(_Belief(panel, rollout, reader, colors))
            cell = cells[top + 1, 2 * column + 1]
            if rollout.joint_angles.size:
                view = ArmView(figure, cell, rollout, dpi)
            else:
                view = DrawnView(figure, cell, rollout)
            self.motions.append(_Motion(view, beliefs, rollout))
        height = layout.size[1]
        caption = "\n".join(layout.caption)
        figure.text(0.5, 0.06 / height, caption, ha="center", va="bottom", fontsize=7)
        figure.legend(
            [*layout.key.values()], [*layout.key], loc="lower center", borderpad=0,
            borderaxespad=0, columnspacing=1.5, ncols=layout.key_columns,
            bbox_to_anchor=(0, layout.foot / height, 1, 1),
            handler_map={tuple: HandlerTuple(ndivide=None, pad=0.2)},
        )  # fmt: skip

    def show(self, step: int) -> None:
        """Draw the state after `step` control steps."""
        for motion in self.motions:
            motion.show(step)

    def frames(self, progress: Callable[[int, int], None]) -> tuple[Picture, Iterator[Picture]]:
        """The last picture `(H, W, 3)`, and all: that of each control step, and the last held."""
        canvas = FigureCanvasAgg(self.figure)
        moving = [artist for motion in self.motions for artist in motion.moving]
        for artist in moving:
            artist.set_animated(True)
        canvas.draw()
        ground = canvas.copy_from_bbox(self.figure.bbox)

        def picture(step: int) -> Picture:
            canvas.restore_region(ground)
            self.show(step)
            for artist in moving:
                artist.axes.draw_artist(artist)
            return np.asarray(canvas.buffer_rgba())[..., :3].copy()

        def pictures() -> Iterator[Picture]:
            for step in range(self.last + 1):
                progress(step, self.last + 1)
                yield picture(step)
            yield from [final] * round(_HOLD / self.motions[0].seconds)

        final = picture(self.last)
        return final, pictures()


class _Motion:
    """One motion with the beliefs under it."""

    def __init__(self, view: ArmView | DrawnView, beliefs: list[_Belief], rollout: Rollout) -> None:
        self.view, self.beliefs = view, beliefs
        self.last, self.seconds = len(rollout.actions), rollout.step_seconds
        achieved = f"{round(rollout.achieved, 2) + 0:.2f}"  # + 0: never −0.00
        ended = "" if rollout.success else f", {rollout.reason}"
        title = rf"$\ell$ = {rollout.legibility:g}" + f"\nachieved {achieved}{ended}"
        view.axes.set_title(title.replace("-", "−"))
        moving = [*view.moving, *(artist for belief in beliefs for artist in belief.moving)]
        self.moving = sorted(moving, key=lambda artist: artist.get_zorder())

    def show(self, step: int) -> None:
        """Draw the state after `step` control steps."""
        step = min(step, self.last)
        first = self.beliefs[0]
        confident = first.confident_at(step)
        moment = round(first.confident / self.seconds) if confident else None
        self.view.show(step, first.tints[:step], moment)
        for belief in self.beliefs:
            belief.show(step)


class _Belief:
    """The panel of one observer's belief over time; `moving` are what every frame draws."""

    def __init__(self, panel: Any, rollout: Rollout, reader: Reader, colors: list[str]) -> None:
        target = rollout.path.target
        self.values, confident = reader.belief(rollout)
        self.last, seconds = len(rollout.actions), rollout.step_seconds
        self.times = np.arange(self.last + 1) * seconds
        self.confident = min(confident, (self.last + 1) * seconds)
        blended = self.values @ np.array([to_rgb(color) for color in colors])
        self.tints = (blended[1:] + blended[:-1]) / 2
        self.label = panel.set_title("", fontsize=7, pad=2)
        panel.axhline(CONFIDENCE, color=MUTED, lw=0.6, ls=DOTTED, zorder=0)
        self.lines = [
            add_artist(Line2D([], [], color=color, lw=1.8 if goal == target else 1.1,
                        zorder=5 if goal == target else 4), panel)
            for goal, color in enumerate(colors)
        ]  # fmt: skip
        at = np.isclose(self.times, self.confident)
        self.moment = add_artist(diamond(self.times[at], self.values[at, target]), panel)
        self.shade = add_artist(
            Rectangle((self.confident, -0.04), 0, 1.1, color=colors[target], alpha=0.15, lw=0,
                      zorder=1), panel,
        )  # fmt: skip
        self.moving = [self.shade, *self.lines, self.moment, self.label]

    def confident_at(self, step: int) -> bool:
        """Whether the time to confidence has come."""
        return bool(self.times[step] - self.confident > -1e-9)

    def show(self, step: int) -> None:
        """Draw the belief up to `step`."""
        confident = self.confident_at(step)
        for goal, line in enumerate(self.lines):
            line.set_data(self.times[: step + 1], self.values[: step + 1, goal])
        for artist in (self.moment, self.shade):
            artist.set_visible(confident)
        if confident:
            self.shade.set_width(self.times[step] - self.confident)
            when = f"after {self.confident:.2f} s" if self.confident else "from the start"
            self.label.set_text(f"confident {when}")
        else:
            self.label.set_text("never confident" if step == self.last else "")


def _write_gif(file: FilePath, final: Picture, pictures: Iterator[Picture], seconds: float) -> None:
    palette = _palette(final)  # one for all frames, so that the file holds it once

    def image(picture: Picture) -> Image.Image:
        return Image.fromarray(picture).quantize(palette=palette, dither=Image.Dither.NONE)

    frames = map(image, pictures)
    next(frames).save(  # equal frames are stored as one
        file, format="GIF", save_all=True, append_images=frames,
        duration=round(1000 * seconds), loop=0, disposal=1, optimize=False,
    )  # fmt: skip


def _palette(picture: Picture) -> Image.Image:
    """A palette of 255 colours of a picture: the most frequent exactly, and some for the rest."""
    image = Image.fromarray(picture)
    counts: Any = image.getcolors(picture.size)
    exact = [color for _, color in sorted(counts, reverse=True)[:_EXACT]]
    rest: Any = image.quantize(255 - len(exact), Image.Quantize.MAXCOVERAGE).getpalette()
    colors = {}  # one of each bin, as Pillow finds the nearest of a bin only
    for color in [*exact, *np.reshape(rest, (-1, 3)).tolist()]:
        colors.setdefault(tuple(part // 8 for part in color), color)
    palette = Image.new("P", (1, 1))
    palette.putpalette([part for color in colors.values() for part in color])
    return palette


def _write_mp4(file: FilePath, final: Picture, pictures: Iterator[Picture], seconds: float) -> None:
    height, width, _ = final.shape
    command = [
        "ffmpeg", "-loglevel", "error", "-y", "-f", "rawvideo", "-pix_fmt", "rgb24",
        "-s", f"{width}x{height}", "-r", str(round(1 / seconds)), "-i", "-",
        "-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2:color=white", "-pix_fmt", "yuv420p",
        "-movflags", "+faststart", str(file),
    ]  # fmt: skip
    pipe = subprocess.PIPE
    with subprocess.Popen(command, bufsize=0, stdin=pipe, stderr=pipe) as encoder:
        assert encoder.stdin
        with contextlib.suppress(BrokenPipeError):  # it has ended and printed why
            for picture in pictures:
                encoder.stdin.write(picture.tobytes())
        error = encoder.communicate()[1].decode(errors="replace").strip()
    if encoder.returncode:
        raise OSError(f"ffmpeg: {error or f'exit status {encoder.returncode}'}")
