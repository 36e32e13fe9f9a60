"""Paths on which a whole arm keeps off the obstacles, not only the point that is planned.

A hand is much wider than its grasp point, and a wrist and a forearm follow it. Paths are checked on
the arm's geometry; where those that are drawn touch, the scene's archive is searched for the curve
of the nearest label that does not.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from .checks import Array
from .curves import NUM_WAYPOINTS
from .envs.block_reach import BlockReachVector
from .envs.fleet import Fleet
from .errors import InvalidSceneError
from .intent.observer import Observer
from .motion.archive import scene_archive
from .motion.bezier import bezier_trajectories
from .motion.path import Path
from .scene import Scene

MARGIN = 0.01
"""Gap that an arm keeps from obstacles on a path [m], for the motion that deviates from it."""

_DRAWS, _POINTS = 4, 64  # paths drawn, points of a curve that is checked
_LEFT_OUT = 64  # curves tried of those that touch by all appearances

Plan = Callable[[list[int], Array, int], list[Path]]
"""Paths for some robots, given their indices, positions `(N, D)` [m] and a seed."""


def paths_off_obstacles(fleet: Fleet, plan: Plan, seed: int) -> list[Path]:
    """A path for each robot on which no link of its arm touches an obstacle.

    Where all that are drawn touch, the archive's curve of the nearest label stands in, and the
    path is marked as `replaced`.

    Raises:
        InvalidSceneError: there is none.
    """
    paths = drawn_off_obstacles(fleet, plan, list(range(fleet.size)), fleet.positions, seed)
    for row, path in enumerate(paths):
        if not _keeps_off(fleet, row, path):
            paths[row] = _from_archive(fleet, row, path)
    return paths


def drawn_off_obstacles(
    fleet: Fleet, plan: Plan, rows: list[int], positions: Array, seed: int
) -> list[Path]:
    """Paths of robots `rows` from `positions (N, D)` [m], drawn again where the arm would touch.

    A path on which it touches in all draws is returned nevertheless.
    """
    paths = plan(rows, positions, seed)
    left = np.arange(len(rows))
    for draw in range(1, _DRAWS + 1):
        left = np.array([i for i in left if not _keeps_off(fleet, rows[i], paths[i])], dtype=int)
        if draw == _DRAWS or not len(left):
            break
        again = plan([rows[i] for i in left], positions[left], seed ^ (draw << 32))
        for i, path in zip(left, again, strict=True):
            paths[i] = path
    return paths


def arm_can_pass(kind: type[BlockReachVector], scene: Scene, observer: Observer) -> bool:
    """Whether a curve of the scene's archive to goal 0 is found that keeps the robot off obstacles.

    Curves that touch by all appearances are not tried, see `_free_curves`.
    """
    env = kind(1, max_goals=max(6, scene.num_goals))
    env.reset(seed=0, options={"scene": scene, "target": 0})
    fleet = Fleet(env, 0)
    try:
        if not _has_arm_among_obstacles(fleet, 0):
            return True
        if any(env.arm_touches(point) for point in (scene.start, scene.goals[0])):
            return False
        nothing = np.empty((NUM_WAYPOINTS + 2, scene.dim))
        path = Path.through(nothing, scene, 0, np.array(0.0), observer)
        return next(_free_curves(fleet, 0, path, thorough=False), None) is not None
    finally:
        env.close()


def _has_arm_among_obstacles(fleet: Fleet, row: int) -> bool:
    return fleet.joint_angles.shape[1] > 0 and len(fleet.scenes[row].obstacles) > 0


def _keeps_off(fleet: Fleet, row: int, path: Path) -> bool:
    if not _has_arm_among_obstacles(fleet, row):
        return True
    return _clear(fleet.arm_gaps(path.trajectory(_POINTS), row)[1])


def _needed(gaps: Array) -> float:
    """The gap [m] to keep on a path with `gaps (P,)` [m]: less where its ends have less."""
    return min(MARGIN, gaps[0] / 2, gaps[-1] / 2)


def _clear(gaps: Array) -> bool:
    return bool(gaps.min() > 0 and gaps.min() >= _needed(gaps))


def _from_archive(fleet: Fleet, row: int, path: Path) -> Path:
    """The archive's curve of the nearest label on which the arm touches nothing."""
    for name, point in (("start", path.waypoints[0]), ("target", path.waypoints[-1])):
        if touched := fleet.arm_touches(point, row):
            link, obstacle = touched[0]
            raise InvalidSceneError(
                f"the arm cannot take part in this scene: with its grasp point at the {name} "
                f"{point.tolist()} its {link} touches obstacles[{obstacle}], "
                f"{fleet.scenes[row].obstacles[obstacle]!r}"
            )
    for free in _free_curves(fleet, row, path, thorough=True):
        return free
    raise InvalidSceneError(
        f"the arm cannot pass the obstacles to the target goals[{path.target}]: of the "
        f"{len(path.archive)} curves of the archive none was found on which all its links keep off "
        "them"
    )


def _free_curves(fleet: Fleet, row: int, path: Path, *, thorough: bool) -> Iterator[Path]:
    """The archive's curves on which the arm touches nothing, that of the nearest label first.

    The hand does not turn, so a curve that comes nearer to a point in contact than the contact is
    deep touches as well, and needs no inverse kinematics. The links behind the hand do turn:
    curves left out so come last, a few of them, if the search is to be thorough.
    """
    archive = scene_archive(path.scene, path.target, path.observer)
    order = np.argsort(np.abs(archive.labels - float(path.legibility)), kind="stable")
    curves = archive.trajectories[order]
    left = np.ones(len(order), dtype=bool)
    skipped = np.zeros(len(order), dtype=bool)

    def free(index: int) -> Path | None:
        waypoints = bezier_trajectories(archive.controls[order[index], None], NUM_WAYPOINTS + 2)[0]
        found = replace(path, waypoints=waypoints, replaced=np.True_)
        if not found.feasible:
            return None
        points, gaps = fleet.arm_gaps(found.trajectory(_POINTS), row)
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
