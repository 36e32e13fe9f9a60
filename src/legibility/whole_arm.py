"""Paths on which a whole arm keeps off the obstacles, not only the point that is planned.

A hand is much wider than its grasp point, and a wrist and a forearm follow it. Paths are checked on
the arm's geometry; where those that are drawn touch, the scene's archive is searched for the curve
of the nearest label that does not. A robot without an arm (None) is a point.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from .checks import Array
from .curves import NUM_WAYPOINTS, arc_length
from .errors import InvalidInputError, InvalidSceneError
from .intent.observer import Observer
from .motion.archive import scene_archive
from .motion.bezier import bezier_trajectories
from .motion.path import Path
from .parts import Parts, finished
from .scene import Scene

if TYPE_CHECKING:
    from .robots.arm import Arm

MARGIN = 0.01
"""Gap that an arm keeps from obstacles on a path [m], for the motion that deviates from it."""

_DRAWS, _POINTS = 4, 64  # paths drawn, points of a curve that is checked
_LEFT_OUT = 64  # curves tried of those that touch by all appearances
_AT_ONCE = 8  # poses in a part

Plan = Callable[[list[int], int], list[Path]]
"""Paths for some robots, given their indices and a seed."""


def checked_arm(arm: Arm | str | None, dim: int) -> Arm | None:
    """The arm given, or that of a name, which moves in 3-D."""
    if arm is None:
        return None
    from .robots.arm import Arm

    if isinstance(arm, str):
        arm = Arm.named(arm)
    if not isinstance(arm, Arm):
        raise InvalidInputError(f"arm must be a legibility.Arm or a name, got {arm!r}")
    if dim != 3:
        raise InvalidInputError(f"an arm moves in 3-D, the scene is {dim}-D")
    return arm


def paths_off_obstacles(
    arms: Sequence[Arm | None], plan: Plan, seed: int, max_detour: float | None = None
) -> list[Path]:
    """A path for each robot on which no link of its arm touches an obstacle.

    Where all that are drawn touch, the archive's curve of the nearest label stands in, none longer
    than `max_detour` times the shortest, and the path is marked as `replaced`.

    Raises:
        InvalidSceneError: there is none.
    """
    left = list(range(len(arms)))
    paths = plan(left, seed)
    for draw in range(1, _DRAWS + 1):
        left = [row for row in left if not finished(keeps_off(arms[row], paths[row]))]
        if draw == _DRAWS or not left:
            break
        for row, path in zip(left, plan(left, seed ^ (draw << 32)), strict=True):
            paths[row] = path
    for row in left:
        paths[row] = _from_archive(arms[row], paths[row], max_detour)
    return paths


def arm_can_pass(arm: Arm | None, scene: Scene, observer: Observer) -> bool:
    """Whether a curve of the scene's archive to goal 0 is found that keeps the robot off obstacles.

    Curves that touch by all appearances are not tried, see `_free_curves`.
    """
    if arm is None or not scene.obstacles:
        return True
    if any(arm.touches(scene.obstacles, point) for point in (scene.start, scene.goals[0])):
        return False
    nothing = np.empty((NUM_WAYPOINTS + 2, scene.dim))
    path = Path.through(nothing, scene, 0, np.array(0.0), observer)
    return next(_free_curves(arm, path, thorough=False), None) is not None


def keeps_off(arm: Arm | None, path: Path) -> Parts[bool]:
    """Whether no link of an arm touches an obstacle on a path."""
    if arm is None or not path.scene.obstacles:
        return True
    _, gaps = yield from _gaps(arm, path)
    return _clear(gaps)


def freed(arm: Arm | None, path: Path) -> Path:
    """The path, or where an arm touches something on it, the archive's nearest curve that is free.

    The path as it is if none is found.
    """
    if arm is None or finished(keeps_off(arm, path)):
        return path
    return next(_free_curves(arm, path, thorough=True), path)


def _gaps(arm: Arm, path: Path) -> Parts[tuple[Array, Array]]:
    """Points `(P, 3)` [m] of a path, 1 cm apart, and the arm's least gap there, `(P,)` [m]."""
    from .robots.arm import checked_points

    points, poses = checked_points(path.trajectory(_POINTS)), list[Array]()
    for few in np.array_split(points, -(-len(points) // _AT_ONCE)):
        poses.append(arm.postures(few, near=poses[-1][-1] if poses else None))
        yield
    gaps = list[Array]()
    for few in poses:
        gaps.append(arm.obstacle_gaps(path.scene.obstacles, few))
        yield
    return points, np.concatenate(gaps)


def _needed(gaps: Array) -> float:
    """The gap [m] to keep on a path with `gaps (P,)` [m]: less where its ends have less."""
    return min(MARGIN, gaps[0] / 2, gaps[-1] / 2)


def _clear(gaps: Array) -> bool:
    return bool(gaps.min() > 0 and gaps.min() >= _needed(gaps))


def _from_archive(arm: Arm | None, path: Path, max_detour: float | None) -> Path:
    """The archive's curve of the nearest label on which the arm touches nothing."""
    assert arm is not None, "a point touches nothing"
    for name, point in (("start", path.waypoints[0]), ("target", path.waypoints[-1])):
        if touched := arm.touches(path.scene.obstacles, point):
            link, obstacle = touched[0]
            raise InvalidSceneError(
                f"the arm cannot take part in this scene: with its grasp point at the {name} "
                f"{point.tolist()} its {link} touches obstacles[{obstacle}], "
                f"{path.scene.obstacles[obstacle]!r}"
            )
    for free in _free_curves(arm, path, max_detour, thorough=True):
        return free
    within = "" if max_detour is None else f" within max_detour {max_detour:g}"
    raise InvalidSceneError(
        f"the arm cannot pass the obstacles to the target goals[{path.target}]{within}: of the "
        f"{len(path.archive)} curves of the archive none was found on which all its links keep off "
        "them"
    )


def _free_curves(
    arm: Arm, path: Path, max_detour: float | None = None, *, thorough: bool
) -> Iterator[Path]:
    """The archive's curves on which the arm touches nothing, that of the nearest label first.

    The hand does not turn, so a curve that comes nearer to a point in contact than the contact is
    deep touches as well, and needs no inverse kinematics. The links behind the hand do turn:
    curves left out so come last, a few of them, if the search is to be thorough.
    """
    archive = scene_archive(path.scene, path.target, path.observer)
    order = np.argsort(np.abs(archive.labels - float(path.legibility)), kind="stable")
    curves = archive.trajectories[order]
    longest = np.inf if max_detour is None else max_detour * archive.shortest_length
    left = arc_length(curves) <= longest
    skipped = np.zeros(len(order), dtype=bool)

    def free(index: int) -> Path | None:
        waypoints = bezier_trajectories(archive.controls[order[index], None], NUM_WAYPOINTS + 2)[0]
        found = replace(path, waypoints=waypoints, replaced=np.True_)
        if not found.feasible:
            return None
        points, gaps = finished(_gaps(arm, found))
        if _clear(gaps):
            return found
        deepest, depth = points[gaps.argmin()], _needed(gaps) - gaps.min()
        near = (((curves - deepest) ** 2).sum(-1) < depth**2).any(-1)
        skipped[near & left] = True
        return None

    for index in range(len(order)):
        if left[index] and not skipped[index]:
            left[index] = False
            if (found := free(index)) is not None:
                yield found
    for index in np.flatnonzero(left)[: _LEFT_OUT if thorough else 0]:
        if (found := free(int(index))) is not None:
            yield found
