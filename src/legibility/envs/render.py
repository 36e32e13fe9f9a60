"""The picture of a 2-D scene with the end effector in it, and a window for any picture."""

from __future__ import annotations

import functools
import math

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

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
_SMOOTH = 4
"""The picture is drawn this many times larger and reduced, for smooth edges."""


def draw_scene(scene: Scene, target: int, position: Array, size: int = 480) -> NDArray[np.uint8]:
    """Draw a 2-D scene from above, `(H, W, 3)`, y up.

    A block has the colour of its index, the ring marks the target, the white disc is the end
    effector. The lines of the grid are 0.1 m apart.

    Args:
        scene: the current scene.
        target: index of the intended goal.
        position: `(2,)` [m], of the end effector.
        size: pixels of the longer side.
    """
    size = count("size", size, low=64)
    low, high = scene.workspace
    scale = size * (1 - 2 * _MARGIN) / (high - low).max()
    image = _ground(size, scale, *low.tolist(), *high.tolist()).copy()
    draw = ImageDraw.Draw(image)

    def box(point: Array, radius: float) -> tuple[float, float, float, float]:
        x = _SMOOTH * (_MARGIN * size + scale * (point[0] - low[0]))
        y = _SMOOTH * (_MARGIN * size + scale * (high[1] - point[1]))
        reach = _SMOOTH * size * radius
        return x - reach, y - reach, x + reach - 1, y + reach - 1

    for index, goal in enumerate(scene.goals):
        corner = _SMOOTH * size * _BLOCK / 4
        draw.rounded_rectangle(box(goal, _BLOCK), corner, GOALS[index % len(GOALS)])
    line = round(_SMOOTH * size * _LINE)
    draw.ellipse(box(scene.goals[target], _RING), outline=INK, width=line)
    draw.ellipse(box(position, _EFFECTOR), _PAPER, INK, line)
    return np.array(image.reduce(_SMOOTH))


@functools.lru_cache(maxsize=8)
def _ground(size: int, scale: float, x0: float, y0: float, x1: float, y1: float) -> Image.Image:
    """The workspace with its grid and frame, to be reduced; lines are one pixel wide then."""
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
    return image.resize((_SMOOTH * image.width, _SMOOTH * image.height), Image.Resampling.NEAREST)


class Window:
    """A matplotlib window that shows one picture after another.

    Args:
        image: `(H, W, 3)` uint8, the first picture.
        interval: how long `show` waits [s].

    Raises:
        OutputError: matplotlib has no backend here that opens windows.
    """

    def __init__(self, image: NDArray[np.uint8], interval: float) -> None:
        self._interval = interval
        try:
            from matplotlib import pyplot
            from matplotlib.backends.registry import BackendFilter, backend_registry

            if pyplot.get_backend() in backend_registry.list_builtin(BackendFilter.NON_INTERACTIVE):
                raise RuntimeError(f"matplotlib's backend is {pyplot.get_backend()}")
            self._figure = pyplot.figure(
                figsize=(image.shape[1] / 100, image.shape[0] / 100), dpi=100
            )
        except (ImportError, RuntimeError, ValueError) as cause:
            raise OutputError(
                "render_mode='human' needs a display and a GUI toolkit such as tkinter "
                f"({cause}); render_mode='rgb_array' needs neither"
            ) from cause
        self._pyplot = pyplot
        axes = self._figure.add_axes((0, 0, 1, 1))
        axes.set_axis_off()
        self._image = axes.imshow(image)
        self._figure.show()

    def show(self, image: NDArray[np.uint8]) -> None:
        """Show the next picture, unless somebody has closed the window."""
        if self._pyplot.fignum_exists(self._figure.number):
            self._image.set_data(image)
            self._figure.canvas.draw_idle()
            self._figure.canvas.start_event_loop(self._interval)

    def close(self) -> None:
        """Close the window."""
        self._pyplot.close(self._figure)
