"""The picture of a scene with the end effector in it, and a window that shows it."""

from __future__ import annotations

import functools
import math

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageColor, ImageDraw

from ..checks import Array, count
from ..errors import OutputError
from ..scene import Scene
from .colors import GOALS, INK, MUTED

__all__ = ["Window", "draw_scene"]

_GRID = 0.1  # [m]
# Shares of the picture's size; in the default workspace a block is 0.06 m wide and the end
# effector's radius is 0.02 m.
_MARGIN, _BLOCK, _RING, _EFFECTOR, _LINE = 0.06, 0.022, 0.04, 0.0147, 0.0045
_PAPER, _OUTSIDE, _LINES = "#ffffff", "#f4f4f6", "#ececef"
_SMOOTH = 8


def draw_scene(scene: Scene, target: int, position: Array, size: int = 480) -> NDArray[np.uint8]:
    """Draw a 2-D scene from above, `(H, W, 3)`, y up.

    A block has the colour of its index, the ring marks the target, the white disc is the end
    effector. The lines of the grid are 0.1 m apart.

    Args:
        scene: the scene as it is now.
        target: index of the intended goal.
        position: `(2,)` [m], of the end effector.
        size: pixels of the longer side.
    """
    size = count("size", size, low=64)
    (low, high), margin = scene.workspace, _MARGIN * size
    scale = (size - 2 * margin) / (high - low).max()
    image = _ground(size, scale, *low.tolist(), *high.tolist()).copy()

    def place(point: Array) -> tuple[float, float]:
        return margin + scale * (point[0] - low[0]), margin + scale * (high[1] - point[1])

    for index, goal in enumerate(scene.goals):
        color = GOALS[index % len(GOALS)]
        _stamp(image, place(goal), _BLOCK * size, color, square=True)
    ring, effector = place(scene.goals[target]), place(position)
    _stamp(image, ring, _RING * size, INK, width=_LINE * size)
    _stamp(image, effector, _EFFECTOR * size, INK)
    _stamp(image, effector, (_EFFECTOR - _LINE) * size, _PAPER)
    return np.array(image)


def _stamp(
    image: Image.Image,
    centre: tuple[float, float],
    radius: float,
    color: str,
    *,
    square: bool = False,
    width: float | None = None,
) -> None:
    """Paint a disc, a ring of `width` or a square with round corners, smooth at the edges [px]."""
    left, top = (math.floor(place - radius) for place in centre)
    side = math.ceil(2 * radius) + 1
    low = _SMOOTH * (centre[0] - left - radius), _SMOOTH * (centre[1] - top - radius)
    box = (*low, *(corner + 2 * _SMOOTH * radius - 1 for corner in low))
    mask = Image.new("L", (_SMOOTH * side, _SMOOTH * side))
    draw = ImageDraw.Draw(mask)
    if square:
        draw.rounded_rectangle(box, radius=_SMOOTH * radius / 4, fill=255)
    elif width is None:
        draw.ellipse(box, fill=255)
    else:
        draw.ellipse(box, outline=255, width=round(_SMOOTH * width))
    image.paste(ImageColor.getrgb(color), (left, top), mask.reduce(_SMOOTH))


@functools.lru_cache(maxsize=8)
def _ground(size: int, scale: float, x0: float, y0: float, x1: float, y1: float) -> Image.Image:
    """The workspace with its grid and frame."""
    margin = _MARGIN * size
    right, bottom = margin + scale * (x1 - x0), margin + scale * (y1 - y0)
    image = Image.new("RGB", (round(right + margin), round(bottom + margin)), _OUTSIDE)
    draw = ImageDraw.Draw(image)
    frame = [round(side) for side in (margin, margin, right, bottom)]
    draw.rectangle(frame, fill=_PAPER)
    for x in range(math.ceil(x0 / _GRID), math.floor(x1 / _GRID) + 1):
        column = round(margin + scale * (x * _GRID - x0))
        draw.line((column, frame[1], column, frame[3]), fill=_LINES)
    for y in range(math.ceil(y0 / _GRID), math.floor(y1 / _GRID) + 1):
        row = round(bottom - scale * (y * _GRID - y0))
        draw.line((frame[0], row, frame[2], row), fill=_LINES)
    draw.rectangle(frame, outline=MUTED)
    return image


class Window:
    """A window of matplotlib's that shows one picture after another.

    Args:
        image: `(H, W, 3)` uint8, the first picture.
        interval: how long each is shown before `show` returns [s].

    Raises:
        OutputError: matplotlib has no backend here that opens windows.
    """

    def __init__(self, image: NDArray[np.uint8], interval: float) -> None:
        self._interval = interval
        size = image.shape[1] / 100, image.shape[0] / 100
        try:
            from matplotlib import pyplot
            from matplotlib.backends.registry import BackendFilter, backend_registry

            if pyplot.get_backend() in backend_registry.list_builtin(BackendFilter.NON_INTERACTIVE):
                raise RuntimeError(f"matplotlib's backend is {pyplot.get_backend()}")
            self._figure = pyplot.figure(figsize=size, dpi=100)
        except (ImportError, RuntimeError, ValueError) as cause:
            raise OutputError(
                "render_mode='human' needs a display and a GUI toolkit such as tkinter "
                f"({cause}); render_mode='rgb_array' needs neither"
            ) from cause
        axes = self._figure.add_axes((0, 0, 1, 1))
        axes.set_axis_off()
        self._image = axes.imshow(image)
        self._figure.show()

    def show(self, image: NDArray[np.uint8]) -> None:
        """Show the next picture; nothing happens if somebody has closed the window."""
        from matplotlib import pyplot

        if pyplot.fignum_exists(self._figure.number):
            self._image.set_data(image)
            self._figure.canvas.draw_idle()
            self._figure.canvas.start_event_loop(self._interval)

    def close(self) -> None:
        """Close the window."""
        from matplotlib import pyplot

        pyplot.close(self._figure)
