"""Paths without learning: the straight line, the archive's trajectories, and random search."""

import time

import numpy as np

from ..checks import count
from ..curves import NUM_WAYPOINTS
from ..frame import Frame
from ..intent.metrics import SCORE_POINTS
from ..intent.observer import Observer
from ..motion.archive import Archive
from ..motion.bezier import bezier_trajectories, straight_controls
from ..motion.curve_grid import CurveGrid, free, random_controls
from ..motion.path import Path, straight_waypoints
from ..scene import Scene

_ENDS = (64, 65_536)
_REPEATS = 5


def straight_path(scene: Scene, target: int, level: float, observer: Observer) -> Path:
    """The most predictable path, for any ℓ."""
    points = straight_waypoints(scene.start, scene.target(target))
    return Path.through(points, scene, target, np.asarray(level), observer)


@np.errstate(under="ignore")
def archive_path(archive: Archive, level: float) -> Path:
    """The archive's trajectory whose label is nearest to ℓ: at 1 its most legible one."""
    controls = archive.controls[[archive.nearest(level)]]
    return Path.through(
        bezier_trajectories(controls, NUM_WAYPOINTS + 2)[0],
        archive.scene, archive.target, np.asarray(level), archive.observer,
    )  # fmt: skip


@np.errstate(under="ignore")
def search(
    scene: Scene, target: int, level: float, observer: Observer, num_candidates: int, seed: int
) -> Path:
    """The nearest to ℓ of random cubic Béziers in this scene.

    They are drawn as the archive draws them. Those that touch anything are dropped, and the rest
    are labelled by their rank among each other.

    Args:
        scene: any.
        target: index of the intended goal.
        level: ℓ in [−1, 1].
        observer: scores and labels them.
        num_candidates: curves drawn.
        seed: of the curves.
    """
    rng = np.random.default_rng(seed)
    straight = straight_controls(scene.start, scene.target(target))
    grid = CurveGrid(scene, target, observer.detour * Frame.of(scene, target).scale, 2)
    controls = np.tile(straight, (count("num_candidates", num_candidates) + 1, 1, 1))
    controls[1:, 1:3] = random_controls(rng, grid, num_candidates)
    controls = controls[np.append(True, free(scene, target, controls[1:]))]
    curves = bezier_trajectories(controls, SCORE_POINTS)
    scores = observer.score(curves, scene, target)
    best = np.argmin(np.abs(observer.labels(scores, float(scores[0])) - level))
    return Path.through(
        bezier_trajectories(controls[[best]], NUM_WAYPOINTS + 2)[0],
        scene, target, np.asarray(level), observer,
    )  # fmt: skip


def candidates_within(milliseconds: float, scene: Scene, target: int, observer: Observer) -> int:
    """The number of curves that `search` can draw in a time [ms].

    The largest power of √2 from 64 to 65,536 whose median time is not longer.
    """
    number, size = _ENDS[0], float(_ENDS[0])
    while size <= _ENDS[1]:
        times = []
        for seed in range(_REPEATS):
            start = time.perf_counter()
            search(scene, target, 1.0, observer, round(size), seed)
            times.append(1e3 * (time.perf_counter() - start))
        if np.median(times) > milliseconds:
            break
        number, size = round(size), size * np.sqrt(2)
    return number
