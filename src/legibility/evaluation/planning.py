"""The error of ℓ against the time to plan: the modulator, random search, and archives."""

import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from ..baselines.planners import archive_path, search_archive
from ..checks import Array
from ..intent.observer import Observer
from ..modulator import Modulator
from ..motion.archive import build_archive, forget_archives
from ..motion.path import Path
from ..motion.rough_archive import forget_rough_archives
from ..parallel import threads
from ..scene import Scene
from ..seeds import plan_seeds
from .common import Progress, each_of, level_steps, rounded, silent
from .configuration import PlanningConfig
from .statistics import summary

Planner = Callable[[float], Path]
"""Plans a path at a level of ℓ in the scene that it was made for."""

_MODES: dict[str, dict[str, Any]] = {
    "bare": {"refine": False}, "quick": {}, "exact": {"exact": True}
}  # fmt: skip
PLACES = {"dragan": "free space", "obstacles": "one to four obstacles"}
"""The regimes of scenes, and what they hold."""

TEXTS = {
    "bare": "Legibility Modulator, the bare network",
    "quick": "Legibility Modulator",
    "exact": "Legibility Modulator, exact",
    "archive": "an archive's nearest trajectory",
}
"""Names of the planners but for the searches."""


def planner_text(name: str) -> str:
    """The name of a planner in tables."""
    if name in TEXTS:
        return TEXTS[name]
    return f"search among {int(name.removeprefix('search ')):,} curves"


def evaluate_planning(
    modulator: Modulator,
    config: PlanningConfig,
    *,
    workers: int = 1,
    cluster: str | None = None,
    progress: Progress = silent,
) -> dict[str, Any]:
    """Plan in fresh random scenes by every planner, and measure time and error.

    The metrics but for the times do not depend on the number of workers. For these leave the
    machine alone.

    Arguments as of `evaluate_dial`.

    Returns:
        For each of `PLACES` its `planners`: for each the `error` of the achieved ℓ and the
        `feasible` share of its paths over all levels, and the times of a plan [ms], `new` of the
        first in a scene and `known`, the median of the later ones, each as a summary over scenes;
        and `noise`, the error of ℓ that another seed of the archive leaves.
    """
    levels = level_steps(config.levels)
    items = [(regime, index) for regime in PLACES for index in range(config.scenes)]
    measure = partial(_measure, modulator, levels, config)
    found = each_of(items, measure, workers, cluster, progress)
    result: dict[str, Any] = {}
    for i, regime in enumerate(PLACES):
        rows = found[i * config.scenes : (i + 1) * config.scenes]
        planners = {
            name: {
                metric: summary(np.array([row["planners"][name][metric] for row in rows]))
                for metric in values
            }
            for name, values in rows[0]["planners"].items()
        }
        result[regime] = {
            "planners": planners,
            "noise": summary(np.array([row["noise"] for row in rows])),
        }
    return rounded(result)


@threads(1)
def _measure(
    modulator: Modulator, levels: Array, config: PlanningConfig, item: tuple[str, int]
) -> dict[str, Any]:
    regime, index = item
    judge = config.stream(regime, modulator.config.dim).archive(index, modulator.config.observer)
    scene, observer = judge.scene, judge.observer
    (seed,) = plan_seeds(config.seed, index, 1)
    order = np.random.default_rng(seed).permutation(len(levels))
    found: dict[str, dict[str, float]] = {}
    for name in planner_names(config.search):
        forget_archives()
        forget_rough_archives()
        started = time.perf_counter()
        plan = _planner(modulator, name, scene, observer, seed)
        paths, times = list[Path](), list[float]()
        for level in levels[order].tolist():
            paths.append(plan(level))
            now = time.perf_counter()
            times.append(1e3 * (now - started))
            started = now
        achieved = np.array([float(judge.label_of(path.score)) for path in paths])
        found[name] = {
            "error": float(np.abs(achieved - levels[order]).mean()),
            "feasible": float(np.mean([bool(path.feasible) for path in paths])),
            "new": times[0],
            "known": float(np.median(times[1:])),
        }
    other = build_archive(scene, observer=observer, seed=seed)
    noise = float(np.abs(judge.label_of(other.score_of(levels)) - levels).mean())
    return {"planners": found, "noise": noise}


def planner_names(search: Sequence[int]) -> list[str]:
    """The planners, given the numbers of curves of the searches."""
    return [*_MODES, "archive", *(f"search {number}" for number in search)]


def _planner(
    modulator: Modulator, name: str, scene: Scene, observer: Observer, seed: int
) -> Planner:
    if name in _MODES:
        return lambda level: modulator.plan(
            scene, 0, level, seed=seed, observer=observer, **_MODES[name]
        )
    if name == "archive":
        archive = build_archive(scene, observer=observer, seed=seed)
    else:
        number = int(name.removeprefix("search "))
        archive = search_archive(scene, 0, observer, number, seed)
    return partial(archive_path, archive)
