"""The comparison on held-out scenes: the most legible motions, and the dial."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ..checks import Array
from ..data.scenes import SceneStream
from ..envs import vector_type
from ..models.goal_policy import GoalPolicy
from ..modulator import Modulator
from ..motion.archive import Archive
from ..parallel import pool
from ..seeds import plan_seeds
from .comparison import METHODS, METRICS, TESTED, Contest, Job, compare, measured
from .configuration import UnseenConfig
from .statistics import bootstrap_interval, rank_correlation, share_interval, summary
from .table1 import SCENES

__all__ = ["evaluate_unseen"]

_LEAST = {"distance_score": 0.0, "potential_cost": 1e-9}
"""Lower bounds of the metrics: in the clearest scenes nothing is left to compare."""


def evaluate_unseen(
    modulator: Modulator,
    policies: dict[str, GoalPolicy],
    config: UnseenConfig | None = None,
    *,
    workers: int = 1,
    cluster: str | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> dict[str, Any]:
    """Execute every method in the same random scenes.

    The metrics do not depend on the number of workers.

    Args:
        modulator: both stages.
        policies: the baselines by the name of their method.
        config: of the evaluation.
        workers: processes on this machine.
        cluster: a Dask cluster, see `pool`.
        progress: called with the number of finished motions and of all motions.

    Returns:
        `methods`: for each its success with interval; `METRICS`, each as a summary of the scenes'
        means; `ratio`: of L_d and L_p the ratio to the scene's oracle (its archive's most legible
        trajectory, not executed), its median over scenes with interval, and all values; for methods
        with a dial, `spearman` and `error` of the executed ℓ; `goals`: number in each scene;
        `tests`: see `compare`, paired by scene; `search`: number of curves of the two searches.
    """
    config = config or UnseenConfig()
    kind = vector_type(config.env, modulator.config.dim)
    source = SceneStream("evaluation", kind.dim, config.goals, config.seed)
    size = config.search_candidates
    contest = Contest(modulator, policies, kind, (size, 10 * size) if size else None)
    contest.calibrate(SCENES[kind.dim].scene, 0)
    observer = modulator.config.observer
    archives = [source.archive(index, observer) for index in range(config.scenes)]
    spacing = SCENES[kind.dim].spacing
    oracle = [
        measured(a.trajectories[a.nearest(1.0)], a.scene, a, spacing) for a in archives
    ]  # fmt: skip
    levels = np.round(np.linspace(-1, 1, config.levels), 12)
    asked = {"legible": np.ones(config.rollouts), "dial": levels}
    work, kinds = [], []
    for name, method in METHODS.items():
        for part, each_level in asked.items():
            if part == "legible" or method.dial:
                work.append((name, *_jobs(archives, each_level, config.seed, part)))
                kinds.append((name, part))
    with pool(workers, cluster) as each:
        executed = dict(zip(kinds, contest.motions(work, each, progress), strict=True))
    methods: dict[str, Any] = {}
    cells: dict[str, dict[str, Array]] = {}
    for name, method in METHODS.items():
        rows: dict[str, Array] = {}
        success = np.empty(0)
        for part, levels_asked in asked.items():
            motions = executed.get((name, part), [])
            if not motions:
                continue
            scene_of = np.repeat(np.arange(config.scenes), len(levels_asked))
            metrics = [
                measured(m.states, archives[i].scene, archives[i], spacing)
                for m, i in zip(motions, scene_of, strict=True)
            ]
            shape = config.scenes, len(levels_asked)
            for metric in METRICS:
                rows[f"{part} {metric}"] = np.reshape([m[metric] for m in metrics], shape)
            success = np.append(success, [m.success for m in motions])
        methods[name] = {
            "success": {"mean": float(success.mean()), "interval": share_interval(success)},
            **{m: summary(rows[f"legible {m}"].mean(axis=1)) for m in METRICS},
            "ratio": {},
        }
        for metric in TESTED:
            least = _LEAST[metric]
            values = np.maximum(rows[f"legible {metric}"].mean(axis=1), least)
            ratio = values / np.maximum([o[metric] for o in oracle], least)
            methods[name]["ratio"][metric] = {
                "median": float(np.median(ratio)),
                "interval": bootstrap_interval(ratio, np.median),
                "values": [float(f"{x:.6g}") for x in ratio],
            }
            sign = 1 if METRICS[metric].higher else -1
            cells.setdefault(metric, {})[name] = sign * np.log(ratio)
        if method.dial:
            table = rows["dial achieved"]
            methods[name]["spearman"] = summary(
                np.array([rank_correlation(levels, row) for row in table])
            )
            methods[name]["error"] = summary(np.abs(table - levels).mean(axis=1))
    return {
        "env": kind.__name__.removesuffix("Vector"),
        "spacing": spacing,
        "methods": methods,
        "goals": [a.scene.num_goals for a in archives],
        "least": _LEAST,
        "tests": compare(cells),
        "search": contest.sizes,
    }


def _jobs(
    archives: list[Archive], levels: Array, seed: int, part: str
) -> tuple[list[Job], list[Archive]]:
    """A motion in each scene for each level, and its archive."""
    jobs, archive_of = [], []
    kind = "plan" if part == "legible" else "demonstration"
    for index, archive in enumerate(archives):
        seeds = iter(plan_seeds(seed, index, 2 * len(levels), kind))
        for level in levels.tolist():
            jobs.append(Job(archive.scene, 0, level, next(seeds), next(seeds)))
            archive_of.append(archive)
    return jobs, archive_of
