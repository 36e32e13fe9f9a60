"""The picture of a 2-D scene with the end effector in it, and a window for any picture."""

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from ..checks import Array
from ..errors import OutputError
from ..obstacles import Ball, Box, Obstacle
from ..scene import Scene
from .colors import GOALS, INK, MUTED, OBSTACLE

_SMOOTH = 4
"""The picture is drawn this many times larger and reduced, for smooth edges."""
_SIZE = 480 * _SMOOTH
"""Pixels of the longer side before that."""
_GRID = 0.1  # [m]
# In the default workspace a block is 0.06 m wide and the end effector's radius is 0.02 m.
_MARGIN, _BLOCK, _RING, _EFFECTOR = (round(share * _SIZE) for share in (0.06, 0.022, 0.04, 0.0147))
_TURN = np.linspace(0, 2 * np.pi, 97)[:-1]
_LINE = round(0.0045 * _SIZE)
_PAPER, _OUTSIDE, _LINES = "#ffffff", "#f4f4f6", "#ececef"


def draw_scene(scene: Scene, target: int, position: Array) -> NDArray[np.uint8]:
    """Draw a 2-D scene from above, `(H, W, 3)`, y up; the longer side has 480 pixels.

    A block has the colour of its index, the ring marks the target, the white disc is the end
    effector, obstacles are grey. The lines of the grid are 0.1 m apart.

    Args:
        scene: the current scene.
        target: index of the intended goal.
        position: `(2,)` [m], of the end effector.
    """
    low, high = scene.workspace
    scale = (_SIZE - 2 * _MARGIN) / (high - low).max()

    def pixel(point: Array) -> tuple[float, float]:
        return _MARGIN + scale * (point[0] - low[0]), _MARGIN + scale * (high[1] - point[1])

    def box(point: Array, radius: float) -> tuple[float, float, float, float]:
        x, y = pixel(point)
        return x - radius, y - radius, x + radius - 1, y + radius - 1

    right, bottom = (_MARGIN + scale * (high - low)).round().astype(int).tolist()
    image = Image.new("RGB", (right + _MARGIN, bottom + _MARGIN), _OUTSIDE)
    draw = ImageDraw.Draw(image)
    draw.rectangle((_MARGIN, _MARGIN, right, bottom), _PAPER)
    first, last = np.ceil(low / _GRID), np.floor(high / _GRID)
    for x in np.arange(first[0], last[0] + 1) * _GRID:
        left, _, end, _ = box(np.array([x, 0.0]), _SMOOTH / 2)
        draw.rectangle((left, _MARGIN, end, bottom), _LINES)
    for y in np.arange(first[1], last[1] + 1) * _GRID:
        _, top, _, end = box(np.array([0.0, y]), _SMOOTH / 2)
        draw.rectangle((_MARGIN, top, right, end), _LINES)
    for obstacle in scene.obstacles:
        draw.polygon([pixel(point) for point in _outline(obstacle)], OBSTACLE)
    draw.rectangle((_MARGIN, _MARGIN, right, bottom), outline=MUTED, width=_SMOOTH)
    for index, goal in enumerate(scene.goals):
        draw.rounded_rectangle(box(goal, _BLOCK), _BLOCK / 4, GOALS[index % len(GOALS)])
    draw.ellipse(box(scene.goals[target], _RING), outline=INK, width=_LINE)
    draw.ellipse(box(position, _EFFECTOR), _PAPER, INK, _LINE)
    return np.array(image.reduce(_SMOOTH))


def _outline(obstacle: Obstacle) -> Array:
    """The corners of a 2-D obstacle, or many points around a disc, `(N, 2)` [m]."""
    if isinstance(obstacle, Ball):
        return obstacle.center + obstacle.radius * np.stack([np.cos(_TURN), np.sin(_TURN)], -1)
    if isinstance(obstacle, Box):
        signs = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
        return obstacle.center + signs * obstacle.size / 2 @ obstacle.rotation.T
    return obstacle.vertices


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
