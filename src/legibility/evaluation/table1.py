"""The paper's Table I: the most legible motions of each method toward either goal of its scene."""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Callable
from importlib import resources
from typing import Any, NamedTuple

import numpy as np

from ..checks import Array
from ..envs import vector_type
from ..errors import InvalidInputError
from ..models.goal_policy import GoalPolicy
from ..modulator import Modulator
from ..parallel import pool
from ..scene import Scene
from ..seeds import plan_seeds
from .comparison import METHODS, METRICS, TESTED, Contest, Job, Motion, compare, measured
from .configuration import Table1Config
from .statistics import bootstrap_interval, share_interval

__all__ = ["SCENES", "TARGETS", "evaluate_table1", "paper_rows"]

TARGETS = {"R": 0, "G": 1}
"""The paper's red and green block, and their index."""


class TableScene(NamedTuple):
    """A scene of the table and the units of its metrics.

    Attributes:
        scene: two goals, R and G.
        spacing: between the points that the paper's two metrics sum over [m].
        unit: length of one metre in the table's L_d.
    """

    scene: Scene
    spacing: float
    unit: float


SCENES = {
    2: TableScene(Scene([0, 0.5], [[0.8, 0.6], [1, 0.3]]), spacing=0.04, unit=0.5),
    3: TableScene(
        Scene([-0.26, 0, 0.22], [[0.04, -0.09, 0.02], [0.04, 0.09, 0.02]]), spacing=0.02, unit=1.0
    ),
}
"""By dimension. The plane's is read off the paper's figure; its simulator has half a metre to a
unit and points 2 cm apart, so that the straight line's L_d is 1.546 and 1.201 (the paper's
Diffusion Policy: 1.54 and 1.23). The arm's is ours: the paper gives no coordinates."""


def evaluate_table1(
    modulator: Modulator,
    policies: dict[str, GoalPolicy],
    config: Table1Config | None = None,
    *,
    workers: int = 1,
    cluster: str | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> dict[str, Any]:
    """Execute every method with ℓ = 1 in the table's scene, toward R and toward G.

    Rollouts are paired: the n-th of each method has the same robot and the same seeds. The metrics
    do not depend on the number of workers.

    Args:
        modulator: both stages.
        policies: the baselines by the name of their method.
        config: of the evaluation.
        workers: processes on this machine.
        cluster: a Dask cluster, see `pool`.
        progress: called with the number of finished motions and of all motions.

    Returns:
        `methods`: for each its times and, toward either target, success with interval, end reasons,
        `METRICS` with mean and interval, and all values of the tested ones; `oracle`: the metrics
        of the archive's most legible trajectory itself, not executed; `tests`: see `compare`;
        `search`: number of curves that the two searches drew.
    """
    config = config or Table1Config()
    kind = vector_type(config.env, modulator.config.dim)
    place = SCENES[kind.dim]
    size = config.search_candidates
    contest = Contest(modulator, policies, kind, (size, 10 * size) if size else None)
    contest.calibrate(place.scene, TARGETS["R"])
    times = contest.times(place.scene, TARGETS["R"])
    archives = {t: modulator.archive(place.scene, target) for t, target in TARGETS.items()}
    seeds = [plan_seeds(config.seed, i, 2) for i in range(config.rollouts)]
    work = []
    for letter, target in TARGETS.items():
        jobs = [Job(place.scene, target, 1.0, *pair) for pair in seeds]
        work += [(name, jobs, [archives[letter]] * len(jobs)) for name in METHODS]
    with pool(workers, cluster) as each:
        motions = iter(contest.motions(work, each, progress))
    methods: dict[str, Any] = {
        name: {"milliseconds": times.get(name), "targets": {}} for name in METHODS
    }
    cells: dict[str, dict[str, Array]] = {}
    oracle = {}
    for letter, archive in archives.items():
        best = archive.trajectories[archive.nearest(1.0)]
        oracle[letter] = _scaled(measured(best, place.scene, archive, place.spacing), place.unit)
        for name in METHODS:
            executed = next(motions)
            rows = [
                _scaled(measured(m.states, place.scene, archive, place.spacing), place.unit)
                for m in executed
            ]
            values = {metric: np.array([row[metric] for row in rows]) for metric in METRICS}
            methods[name]["targets"][letter] = _metrics(executed, values)
            for metric in TESTED:
                sign = 1 if METRICS[metric].higher else -1
                cells.setdefault(f"{letter} {metric}", {})[name] = sign * values[metric]
    return {
        "env": kind.__name__.removesuffix("Vector"),
        "scene": place.scene.to_dict(),
        "spacing": place.spacing,
        "unit": place.unit,
        "methods": methods,
        "oracle": oracle,
        "tests": compare(cells),
        "search": contest.sizes,
    }


def _metrics(motions: list[Motion], values: dict[str, Array]) -> dict[str, Any]:
    success = np.array([motion.success for motion in motions])
    metrics: dict[str, Any] = {
        "success": {"mean": float(success.mean()), "interval": share_interval(success)},
        "reasons": dict(Counter(motion.reason for motion in motions)),
    }
    for name, array in values.items():
        metrics[name] = {"mean": float(array.mean()), "interval": bootstrap_interval(array)}
        if name in TESTED:
            metrics[name]["values"] = [float(f"{x:.6g}") for x in array]
    return metrics


def _scaled(metrics: dict[str, float], unit: float) -> dict[str, float]:
    return {**metrics, "distance_score": unit * metrics["distance_score"]}


def paper_rows(dim: int) -> dict[str, dict[str, float | None]]:
    """The paper's own Table I: by the name of a method its numbers, `success_rate`, `L_d_R`, ….

    Raises:
        InvalidInputError: the dimension is neither 2 nor 3.
    """
    if dim not in SCENES:
        raise InvalidInputError(f"dim must be 2 or 3, got {dim!r}")
    text = (
        resources.files("legibility.evaluation").joinpath("table1.csv").read_text(encoding="utf-8")
    )
    rows = {}
    for row in csv.DictReader(text.splitlines()):
        if row.pop("environment") == f"{dim}d":
            name = row.pop("method")
            rows[name] = {key: float(value) if value else None for key, value in row.items()}
    return rows
