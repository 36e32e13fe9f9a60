"""A motion in its scene, for figures and films: a point is drawn, an arm is rendered."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from ..checks import Array
from ..envs.colors import INK
from ..envs.panda_render import Trail, arm_image
from ..rollout import Rollout
from .scene_axes import flat, scene_axes
from .style import DOTTED

_TUBE = 0.0035


class DrawnView:
    """A point moves in a drawing of the scene; `moving` are the artists that every frame draws."""

    def __init__(self, figure: Figure, cell: Any, rollout: Rollout) -> None:
        path = rollout.path
        axes = scene_axes(figure, cell, path.scene, path.target, rollout.states[None], blocks=1.6)
        self.axes, self.states = axes, flat(axes, rollout.states)
        # Every frame draws these again, so that trails stay below them.
        front = [artist for artist in axes.get_children() if artist.get_zorder() > 5]
        planned = flat(axes, path.trajectory(129))
        self.halo = add_artist(Line2D([], [], color="white", lw=3.2, zorder=4), axes)
        self.trail = add_artist(_Trail([], linewidths=2, capstyle="round", zorder=4.1), axes)
        plan = add_artist(Line2D(*planned.T, color=INK, lw=0.7, ls=DOTTED, zorder=4.2), axes)
        self.robot = add_artist(
            Line2D([], [], marker="o", ms=4.5, color=INK, mec="white", mew=0.6, zorder=10), axes
        )
        self.spot = add_artist(diamond([], []), axes)
        self.moving = [*front, self.halo, self.trail, plan, self.spot, self.robot]

    def show(self, step: int, tints: Array, confident: int | None) -> None:
        """Draw the state after `step` control steps, with a trail in the colours `tints (step, 3)`.

        `confident` is the step from which the observer is confident, once it is reached.
        """
        seen = self.states[: step + 1]
        self.halo.set_data(*seen.T)
        self.trail.set_segments(np.stack([seen[:-1], seen[1:]], axis=1))
        self.trail.set_color(tints)
        self.robot.set_data(*seen[-1:].T)
        self.spot.set_visible(confident is not None)
        if confident is not None:
            self.spot.set_data(*self.states[confident : confident + 1].T)


class ArmView:
    """An arm moves in a picture of the table, rendered for `dpi` pixels an inch."""

    def __init__(self, figure: Figure, cell: Any, rollout: Rollout, dpi: float) -> None:
        self.rollout = rollout
        self.axes = figure.add_subplot(cell)
        self.axes.set_axis_off()
        box = self.axes.get_position()
        width, height = figure.get_size_inches() * (box.width, box.height) * dpi
        self.size = round(width), round(height)
        picture = np.zeros((self.size[1], self.size[0], 3), dtype=np.uint8)
        self.image = self.axes.imshow(picture, aspect="auto", zorder=1)
        self.moving = [self.image]
        planned = rollout.path.trajectory(65)
        self.planned = [
            Trail(planned[i : i + 2], (*to_rgb(INK), 1.0), _TUBE / 3)
            for i in range(0, len(planned) - 1, 2)
        ]

    def show(self, step: int, tints: Array, confident: int | None) -> None:
        """See `DrawnView`."""
        path, states = self.rollout.path, self.rollout.states
        pieces = zip(states[:step], states[1 : step + 1], tints, strict=True)
        trails = [Trail(np.stack([a, b]), (*tint, 1.0), _TUBE) for a, b, tint in pieces]
        trails += self.planned
        if confident is not None:
            dot = states[confident] + [[0, 0, 0], [0, 0, _TUBE / 50]]
            trails.append(Trail(dot, (1.0, 1.0, 1.0, 1.0), 2.2 * _TUBE))
        angles = self.rollout.joint_angles[step]
        self.image.set_data(
            arm_image(path.scene, path.target, angles, trails=trails, size=self.size)
        )


def add_artist(artist: Any, axes: Any) -> Any:
    axes.add_artist(artist).set_clip_on(False)
    return artist


class _Trail(LineCollection):
    """Segments in the plane of the axes, which 3-D axes accept too."""

    def do_3d_projection(self) -> float:
        """The segments are projected already."""
        return 0.0


def diamond(x: Any, y: Any) -> Line2D:
    """The mark of the time to confidence."""
    return Line2D(x, y, ls="", marker="D", ms=4.5, color="white", mec=INK, mew=1, zorder=9)
