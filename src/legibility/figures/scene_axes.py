"""The drawing of a scene to scale, and a motion in it: a point is drawn, an arm is rendered."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from ..checks import Array
from ..envs.colors import GOALS, INK, MUTED
from ..envs.panda_render import Trail, arm_image
from ..intent.field import Field
from ..scene import Scene
from .obstacles import CUBE, covered, draw_obstacles, flat, highest
from .style import DOTTED, HALO

if TYPE_CHECKING:
    from ..rollout import Rollout

_TARGET, *_OTHERS = GOALS
_POTENTIALS = (0.1, 0.7, 2.3, 7, 21, np.inf)
"""φ [nat] at which the background's shade changes: P(g*|x) is 0.9, 0.5, 0.1, ..."""
_SHADES = ("#f7f7f8", "#efeff1", "#e7e7ea", "#dfdfe3", "#d7d7dc")
_BLOCK = {2: 0.035, 3: 0.05}
"""Side of a goal's block as a share of the workspace's diagonal, by dimension."""
_TUBE = 0.0035


def scene_cells(figure: Figure, scene: Scene, num: int, *, height: float, margin: float) -> Any:
    """A cell for a scene `height` [in] high and `num` − 1 equal panels beside it.

    Args:
        margin: room [in] that is left to ticks and labels.
    """
    extent = scene.workspace[1] - scene.workspace[0]
    width = height * (np.clip(extent[0] / extent[1], 0.5, 1.5) if scene.dim == 2 else 1.1)
    rest = (figure.get_figwidth() - margin - width) / (num - 1)
    return figure.add_gridspec(1, num, width_ratios=[width, *[rest] * (num - 1)])


def scene_axes(
    figure: Figure,
    cell: Any,
    scene: Scene,
    target: int,
    curves: Array,
    field: Field | None = None,
    reader: str = "",
    blocks: float = 1.0,
) -> Any:
    """Axes with start and goals to scale, over the target's potential if a field is given.

    Args:
        curves: `(..., 3)` [m], which the axes must hold, in 3-D.
        field: of the observer whose potential is shown.
        reader: the name of that observer.
        blocks: factor of the usual size of the goals' blocks.
    """
    side = blocks * _BLOCK[scene.dim] * scene.diagonal
    colors = goal_colors(scene.num_goals, target)
    (x0, y0), (x1, y1) = scene.workspace[:, :2]
    table, ground = 0.0, {}
    if scene.dim == 2:
        axes = figure.add_subplot(cell, xlim=(x0, x1), ylim=(y0, y1), xticks=[], yticks=[])
        axes.set_aspect("equal")
        axes.spines[:].set(visible=True, color=MUTED)
        for goal, color in zip(scene.goals, colors, strict=True):
            block = Rectangle(goal - side / 2, side, side, color=color, lw=0, zorder=6)
            axes.add_patch(block).set_clip_on(False)
    else:
        table = scene.workspace[0, 2] - side / 2
        top = max(curves[..., 2].max(), scene.goals[:, 2].max(), highest(scene)) + side / 2
        axes = _table_axes(figure, cell, np.array([[x0, y0, table], [x1, y1, top]]))
        for goal, color in zip(scene.goals, colors, strict=True):
            cube = goal + side / 2 * CUBE
            axes.add_collection3d(Poly3DCollection(cube, facecolors=color, shade=True, zorder=6))
        drop = np.stack([scene.start, [*scene.start[:2], table]])
        axes.plot(*drop.T, color=MUTED, lw=0.7, ls=DOTTED, zorder=2)
        ground = {"zdir": "z", "offset": table}
    axes.plot(*scene.start[:, None], "o", ms=5, color=INK, mec="white", mew=0.6, zorder=7)
    if field is not None:  # in 3-D the slice at the target's height, laid on the table
        x, y = np.meshgrid(np.linspace(x0, x1, 201), np.linspace(y0, y1, 201))
        height = np.broadcast_to(scene.goals[target, 2:], (*x.shape, scene.dim - 2))
        phi = field.potential(np.concatenate([np.stack([x, y], -1), height], -1), target)
        axes.contourf(x, y, phi, _POTENTIALS, colors=_SHADES, zorder=0, **ground)
        key = r"shade: potential $\phi(x|g^*)$" + f"\nof {reader}" * bool(reader)
        axes.annotate(key, (0.5, -0.03), xycoords="axes fraction", ha="center", va="top")
    draw_obstacles(axes, scene, target, colors, table)
    return axes


def goal_colors(num_goals: int, target: int) -> list[str]:
    """A colour for each goal; the target's is always the same."""
    colors = [_OTHERS[i % len(_OTHERS)] for i in range(num_goals - 1)]
    colors.insert(target, _TARGET)
    return colors


def _table_axes(figure: Figure, cell: Any, corners: Array) -> Any:
    """3-D axes over the box between `corners (2, 3)` [m], enlarged to the cell, and its floor."""
    axes: Any = figure.add_subplot(cell, projection="3d", proj_type="ortho", computed_zorder=False)
    axes.set(xlim=corners[:, 0], ylim=corners[:, 1], zlim=corners[:, 2])
    axes.set_axis_off()
    axes.view_init(elev=28, azim=-35)
    sides = corners[1] - corners[0]
    axes.set_box_aspect(tuple(sides))
    box = corners.mean(axis=0) + CUBE * sides / 2
    shares = axes.transLimits.transform(flat(axes, box.reshape(-1, 3)))  # of the axes' room
    axes.set_box_aspect(tuple(sides), zoom=0.5 / np.abs(shares - 0.5).max())
    axes.add_collection3d(Poly3DCollection(box[4:5], fc="none", ec=MUTED, lw=0.7, zorder=1))
    return axes


def name_ends(figure: Figure, axes: Any, scene: Scene, target: int, curves: Array) -> None:
    """Write "start" and "target" beside their marks, where they hide the least."""
    figure.draw_without_rendering()  # settles the layout
    point, dim = figure.dpi / 72, scene.dim  # pixels of a point
    corners = _BLOCK[dim] * scene.diagonal / 2 * CUBE.reshape(-1, 3)[:, :dim]
    blocks = (scene.goals[:, None] + corners).reshape(-1, dim)
    ends = np.stack([scene.start, scene.target(target)])
    drawn = np.concatenate([curves.reshape(-1, dim), ends[:1], np.tile(blocks, (25, 1))])
    drawn = np.concatenate([drawn, covered(axes, scene)])
    taken = axes.transData.transform(flat(axes, drawn))
    angle = np.deg2rad(np.arange(0, 360, 15))
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    other = np.full(2, np.inf)
    for text, end, color in zip(("start", "target"), flat(axes, ends), (INK, _TARGET), strict=True):
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
        # Farther and later in the ring only where it hides less.
        best = np.argmin(cost + (1 + 0.03 * hidden.max()) * np.arange(len(cost)) / len(ring))
        note.set_position(tuple(offsets[best] / point))
        other = centres[best]


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
