"""Obstacles in a drawing of a scene, with the clearance that motions keep as a dashed outline."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Polygon
from mpl_toolkits.mplot3d import proj3d
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from .. import obstacles as solid
from ..checks import Array
from ..scene import Scene
from .style import DASHED

_EDGE = "#6c6c74"
SOLID: dict[str, Any] = {"fc": "#cdcdd3", "ec": _EDGE, "lw": 0.6, "hatch": "//////"}
OUTLINE: dict[str, Any] = {"color": _EDGE, "lw": 0.6, "ls": DASHED}
_SQUARE = ((-1, -1), (1, -1), (1, 1), (-1, 1))
CUBE = np.array([np.insert(_SQUARE, axis, side, 1) for axis in range(3) for side in (-1, 1)])
"""The faces of the cube [−1, 1]³, `(6, 4, 3)`."""
_TURN = np.linspace(0, 2 * np.pi, 181)
_CIRCLE = np.stack([np.cos(_TURN), np.sin(_TURN)], axis=-1)


def draw_obstacles(
    axes: Any, scene: Scene, target: int, colors: Sequence[str], table: float
) -> None:
    """Draw all that a motion to goal `target` keeps from.

    Args:
        axes: of the scene, complete but for what it holds.
        colors: of the goals, for the distance that is kept from their centres.
        table: height [m] of the table, on which obstacles cast a shadow in 3-D.
    """
    screen = _screen(axes, scene.dim)

    def outline(shape: tuple[Array, float], **style: Any) -> None:
        axes.add_artist(Line2D(*flat(axes, _outline(*shape, screen)).T, zorder=3, **style))

    for obstacle in scene.obstacles:
        corners, radius = shape = _shape(obstacle)
        if scene.dim == 2:
            axes.add_patch(Polygon(_outline(*shape, screen), zorder=1.5, **SOLID))
        else:
            shadow = _outline(*shape, np.eye(3)[:2])
            shadow[:, 2] = table
            axes.add_collection3d(Poly3DCollection([shadow], fc="#e4e4e8", lw=0, zorder=1.2))
            facing = np.cross(*screen)
            faces = [f for f in _faces(obstacle) if np.cross(f[2] - f[0], f[3] - f[1]) @ facing > 0]
            surface = Poly3DCollection(
                faces, facecolors="#eeeef2", shade=True, antialiased=False, lw=0, zorder=2.5
            )
            axes.add_collection3d(surface)
            outline(shape, color=_EDGE, lw=0.6)
        if scene.clearance:
            outline((corners, radius + scene.clearance), **OUTLINE)
    if scene.goal_radius:
        for goal, color in enumerate(colors):
            if goal != target:
                outline((scene.goals[goal, None], scene.goal_radius), color=color, lw=0.6)


def key(scene: Scene) -> dict[str, Any]:
    """Entries of a legend: their names and handles."""
    entries: dict[str, Any] = {}
    if scene.obstacles:
        entries["obstacle"] = Patch(**SOLID)
        if scene.dim == 3:
            entries["obstacle"].set_hatch("")
        if scene.clearance:
            entries["clearance to keep"] = Line2D([], [], **OUTLINE)
    return entries


def covered(axes: Any, scene: Scene) -> Array:
    """Points `(N, D)` [m] all over the obstacles."""
    screen = _screen(axes, scene.dim)
    points = [np.empty((0, scene.dim))]
    for obstacle in scene.obstacles:
        rim = _outline(*_shape(obstacle), screen)
        points += [rim.mean(axis=0) + share * (rim - rim.mean(axis=0)) for share in (0.4, 0.7, 1)]
    return np.concatenate(points)


def highest(scene: Scene) -> float:
    """Height [m] of the highest point of the obstacles of a 3-D scene within its workspace."""
    tops = [corners[:, 2].max() + radius for corners, radius in map(_shape, scene.obstacles)]
    return min(max(tops, default=-np.inf), scene.workspace[1, 2])


def flat(axes: Any, points: Array) -> Array:
    """Coordinates `(N, 2)` of `points (N, D)` [m] in the plane of the axes."""
    if points.shape[-1] == 2:
        return points
    x, y, z = points.T
    return np.stack(proj3d.proj_transform(x, y, z, axes.get_proj())[:2], axis=-1)


def _shape(obstacle: Any) -> tuple[Array, float]:
    """Corners `(V, D)` [m] whose hull is the obstacle, and how far it reaches beyond them [m]."""
    if isinstance(obstacle, solid.Ball):
        return obstacle.center[None], obstacle.radius
    if isinstance(obstacle, solid.Polygon):
        return obstacle.vertices, 0.0
    unit = np.unique(CUBE.reshape(-1, 3)[:, : obstacle.dim], axis=0)
    return obstacle.center + unit * obstacle.size / 2 @ obstacle.rotation.T, 0.0


def _faces(obstacle: Any) -> Iterator[Array]:
    """Faces `(4, 3)` [m] of a ball or box, their corners counter-clockwise seen from outside."""
    if isinstance(obstacle, solid.Ball):
        height = np.linspace(-np.pi / 2, np.pi / 2, 25)[:, None]
        around = np.linspace(0, 2 * np.pi, 49)
        ring = np.stack([np.cos(around), np.sin(around), 0 * around], axis=-1)
        grid = np.cos(height)[..., None] * ring + np.sin(height)[..., None] * [0, 0, 1.0]
        quads = np.stack([grid[:-1, :-1], grid[:-1, 1:], grid[1:, 1:], grid[1:, :-1]], axis=-2)
        yield from obstacle.center + obstacle.radius * quads.reshape(-1, 4, 3)
        return
    for face in CUBE:
        outward = np.cross(face[1] - face[0], face[2] - face[1]) @ face.mean(axis=0) > 0
        yield (
            obstacle.center
            + (face if outward else face[::-1]) * obstacle.size / 2 @ obstacle.rotation.T
        )


def _outline(corners: Array, radius: float, plane: Array) -> Array:
    """Closed outline `(N, D)` [m] of a rounded hull as seen along the normal of a plane.

    In each direction the farthest corner, and `radius` beyond it.

    Args:
        plane: `(2, D)`, two orthogonal unit vectors.
    """
    farthest = np.argmax(_CIRCLE @ plane @ corners.T, axis=-1)
    farthest[-1] = farthest[0]  # which rounding may keep apart where two are as far
    return corners[farthest] + radius * _CIRCLE @ plane


def _screen(axes: Any, dim: int) -> Array:
    """Unit vectors `(2, D)` in the scene that point right and up on the page."""
    if dim == 2:
        return np.eye(2)
    a, e = np.deg2rad([axes.azim, axes.elev])
    return np.array([
        [-np.sin(a), np.cos(a), 0],
        [-np.sin(e) * np.cos(a), -np.sin(e) * np.sin(a), np.cos(e)],
    ])  # fmt: skip
