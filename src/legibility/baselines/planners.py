"""Paths without learning: the straight line, the archive's trajectories, and random search."""

import time

import numpy as np

from ..checks import count
from ..curves import NUM_WAYPOINTS
from ..intent.observer import Observer
from ..motion.archive import Archive, build_archive
from ..motion.bezier import bezier_trajectories
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


def search_archive(
    scene: Scene, target: int, observer: Observer, num_candidates: int, seed: int
) -> Archive:
    """The archive of random curves alone, as many as asked."""
    count("num_candidates", num_candidates)
    return build_archive(
        scene, target, observer=observer, seed=seed,
        random_candidates=num_candidates, max_candidates=num_candidates,
    )  # fmt: skip


def search(
    scene: Scene, target: int, level: float, observer: Observer, num_candidates: int, seed: int
) -> Path:
    """The nearest to ℓ of random cubic Béziers in this scene.

    They are drawn, kept, and ranked as an archive's are, but none is varied.

    Args:
        scene: any.
        target: index of the intended goal.
        level: ℓ in [−1, 1].
        observer: scores and labels them.
        num_candidates: curves drawn.
        seed: of the curves.
    """
    return archive_path(search_archive(scene, target, observer, num_candidates, seed), level)


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
