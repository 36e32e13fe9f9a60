"""The paired comparison of the modulator with its baselines: Table I and held-out scenes."""

import csv
import functools
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..baselines.planners import candidates_within
from ..checks import Array
from ..curves import arc_length, resample, spaced
from ..data.configuration import SceneStream
from ..envs import vector_type
from ..intent.metrics import (
    SCORE_POINTS,
    detachment,
    distance_score,
    dragan_posterior,
    posterior_legibility,
    potential_cost,
    time_to_confidence,
)
from ..intent.observer import Observer
from ..models.goal_policy import GoalPolicy
from ..modulator import Modulator
from ..motion.archive import Archive
from ..parallel import pool, threads
from ..rollout import Rollout
from ..scene import Scene
from ..seeds import plan_seeds
from .common import Progress, level_steps, plan_milliseconds, silent, world
from .configuration import SingleSceneConfig, Table1Config, UnseenConfig
from .contest import BASELINE, METHODS, OURS, Contest, Job
from .own_method import load_methods
from .statistics import (
    bootstrap_interval,
    holm,
    paired_test,
    rank_correlation,
    share_interval,
    summary,
)

METRICS = {
    "distance_score": "L_d",
    "potential_cost": "L_p",
    "regularised_cost": "L_p, regularised",
    "length_ratio": "length over the straight line's",
    "achieved": "achieved ℓ",
    "time_to_confidence": "time to confidence",
}
"""The metrics of a motion, and their names in tables."""

BETAS = (5, 10, 20, 40)
"""Rationality of Dragan's observer, over the scene's size."""

EXTERNAL = {
    **{f"dragan_{beta}": f"Dragan’s, β = {beta}" for beta in BETAS},
    "dragan_confidence": "Dragan’s time to confidence",
    "regularised": "less cost",
    "detachment": "detachment",
}
"""The same of metrics by other people's definitions: Dragan's legibility (HRI 2013), the time to
confidence of that observer (β = 20), that legibility (β = 20) less a tenth of the length over the
straight line's (RSS 2013), and detachment (Style-Conditioned Diffusion Policy, 2026)."""

TESTED = {"distance_score": 1, "potential_cost": -1}
"""The paper's two metrics, which are tested; 1 if higher is better, −1 if lower."""

TARGETS = {"R": 0, "G": 1}
"""The paper's red and green block, and their index."""


class TableScene(NamedTuple):
    """A scene of the table, with goals R and G, and the units of its metrics."""

    scene: Scene
    spacing: float  # between the points that the paper's two metrics sum over [m]
    unit: float  # length of one metre in the table's L_d


SCENES = {
    2: TableScene(Scene([0, 0.5], [[0.8, 0.6], [1, 0.3]]), spacing=0.04, unit=0.5),
    3: TableScene(
        Scene([-0.26, 0, 0.22], [[0.04, -0.09, 0.02], [0.04, 0.09, 0.02]]), spacing=0.02, unit=1.0
    ),
}
"""By dimension. That of the plane is read off the paper's figure; its simulator has half a metre to
a unit and points 2 cm apart, so that the straight line's L_d is 1.546 and 1.201 (the paper's
Diffusion Policy: 1.54 and 1.23). That of the arm is ours: the paper gives no coordinates."""

_REGULARISER, _GRID_POINTS = 1e-6, 30_000
_COST = 0.1

_LEAST = {"distance_score": 0.0, "potential_cost": 1e-9}
"""Lower bounds of the metrics: in the clearest scenes nothing is left to compare."""


def measured(
    states: Array, archive: Archive, spacing: float, unit: float = 1.0
) -> dict[str, float]:
    """`METRICS` and `EXTERNAL` of one motion `(T, D)` [m], its points a control step apart.

    The paper's two are sums over points, here at equal `spacing` [m] along the motion, and a metre
    is `unit` in L_d. A time to confidence that is never reached counts as 1, the end.
    """
    scene, field, target = archive.scene, archive.field, archive.target
    points = spaced(states, spacing)
    confident = float(time_to_confidence(field.posterior(states), target))
    straight = np.linalg.norm(scene.target(target) - scene.start)
    score = archive.observer.score(resample(states, SCORE_POINTS), scene, target)
    ratio = float(arc_length(states) / straight)
    posteriors = [dragan_posterior(states, scene.goals, beta / scene.size) for beta in BETAS]
    dragan = [float(posterior_legibility(posterior, target)) for posterior in posteriors]
    middle = BETAS.index(20)
    read = float(time_to_confidence(posteriors[middle], target))
    return {
        "distance_score": unit * float(distance_score(points, scene.goals, target)),
        "potential_cost": float(potential_cost(points, field, target)),
        "regularised_cost": regularised_cost(points, scene, target),
        "length_ratio": ratio,
        "achieved": float(archive.label_of(score)),
        "time_to_confidence": min(confident, 1.0),
        **{f"dragan_{beta}": value for beta, value in zip(BETAS, dragan, strict=True)},
        "dragan_confidence": min(read, 1.0),
        "regularised": dragan[middle] - _COST * ratio,
        "detachment": float(detachment(points, scene.goals, target)),
    }


def regularised_cost(points: Array, scene: Scene, target: int) -> float:
    """L_p of `points (T, D)` [m] in the field by which the paper's numbers seem to be made.

    Found by trying: the likelihoods lack their normalising constant, 10⁻⁶ is added to numerator and
    denominator of the posterior, and the potential is divided by its maximum over the workspace. To
    such an observer all is certain far from every goal.
    """
    potential = _regularised(points, scene, target) / _largest_potential(scene, target)
    return float((potential / (1 + np.arange(len(points)))).sum())


def _regularised(points: Array, scene: Scene, target: int) -> Array:
    """The potential `(...)` of that field at `points (..., D)` [m], not yet divided."""
    gaps = points[..., None, :] - scene.goals
    spread = 2 * np.float64(Observer.paper(scene.dim).sigma) ** 2
    likelihood = np.exp(-np.einsum("...gd,...gd->...g", gaps, gaps) / spread)
    share = (likelihood[..., target] + _REGULARISER) / (likelihood.sum(-1) + _REGULARISER)
    return -np.log(share)


@functools.lru_cache(maxsize=256)
def _largest_potential(scene: Scene, target: int) -> float:
    """Over a regular grid of the workspace."""
    number = round(_GRID_POINTS ** (1 / scene.dim))
    axes = [np.linspace(low, high, number) for low, high in zip(*scene.workspace, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    return float(_regularised(grid, scene, target).max())


def evaluate_table1(
    modulator: Modulator,
    policies: dict[str, GoalPolicy],
    config: Table1Config,
    *,
    workers: int = 1,
    cluster: str | None = None,
    progress: Progress = silent,
) -> dict[str, Any]:
    """Execute every method with ℓ = 1 in the table's scene, toward R and toward G.

    Rollouts are paired: the n-th of each method has the same robot and the same seeds. The metrics
    do not depend on the number of workers.

    Arguments as of `evaluate_dial`, and `policies`, the baselines by the name of their method.

    Returns:
        `methods`: for each its times and, toward either target, success with interval, end reasons,
        `METRICS` with mean and interval, and all values of the tested ones; `oracle`: the metrics
        of the archive's most legible trajectory itself, not executed; `tests`: see `compare`;
        `search`: number of curves that the two searches drew; `own`: of each method of the user its
        `kind`, planner or policy, and the `sha256` of its file.
    """
    contest, place = _contest(modulator, policies, config)
    times = contest.times(place.scene)
    archives = table_archives(modulator, place)
    jobs = table_jobs(place, config)
    work = [(name, letter) for letter in TARGETS for name in contest.names]
    tasks = [(n, jobs[letter], [archives[letter]] * config.rollouts) for n, letter in work]
    with pool(workers, cluster) as each:
        motions = contest.motions(tasks, each, progress)
    oracle = {
        letter: measured(a.trajectories[a.nearest(1.0)], a, place.spacing, place.unit)
        for letter, a in archives.items()
    }
    return {
        **table_of(place, archives, dict(zip(work, motions, strict=True)), times),
        "env": world(contest.kind),
        "oracle": oracle,
        "search": contest.sizes,
        "own": {name: method.record for name, method in contest.own.items()},
    }


def table_archives(modulator: Modulator, place: TableScene) -> dict[str, Archive]:
    """The archives that judge motions toward either target."""
    observer = Observer.paper(place.scene.dim)
    return {
        letter: modulator.archive(place.scene, target, observer)
        for letter, target in TARGETS.items()
    }


def table_jobs(place: TableScene, config: Table1Config | SingleSceneConfig) -> dict[str, list[Job]]:
    """The motions toward either target, on the same robots and seeds."""
    seeds = [plan_seeds(config.seed, i, 2) for i in range(config.rollouts)]
    return {
        letter: [Job(place.scene, target, 1.0, *pair) for pair in seeds]
        for letter, target in TARGETS.items()
    }


def table_of(
    place: TableScene,
    archives: dict[str, Archive],
    motions: dict[tuple[str, str], list[Rollout]],
    times: dict[str, dict[str, float]],
) -> dict[str, Any]:
    """The scene, methods and tests of a table, see `evaluate_table1`.

    Args:
        place: the scene and the units.
        archives: that judge, by target.
        motions: by method and target, paired.
        times: [ms] of methods, where measured.
    """
    methods: dict[str, Any] = {}
    cells: dict[str, dict[str, Array]] = {}
    for (name, letter), executed in motions.items():
        values = _values(executed, [archives[letter]] * len(executed), place.spacing, place.unit)
        method = methods.setdefault(name, {"milliseconds": times.get(name), "targets": {}})
        method["targets"][letter] = own = {
            "success": _share(executed),
            "reasons": dict(Counter(motion.reason for motion in executed)),
            **{
                m: {"mean": float(array.mean()), "interval": bootstrap_interval(array)}
                for m, array in values.items()
            },
        }
        for metric, sign in TESTED.items():
            own[metric]["values"] = _rounded(values[metric])
            cells.setdefault(f"{letter} {metric}", {})[name] = sign * values[metric]
    return {
        "scene": place.scene.to_dict(),
        "spacing": place.spacing,
        "unit": place.unit,
        "methods": methods,
        "tests": compare(cells),
    }


def evaluate_unseen(
    modulator: Modulator,
    policies: dict[str, GoalPolicy],
    config: UnseenConfig,
    *,
    workers: int = 1,
    cluster: str | None = None,
    progress: Progress = silent,
) -> dict[str, Any]:
    """Execute every method in the same held-out scenes, with ℓ = 1 and over the dial.

    Arguments as of `evaluate_table1`; the metrics do not depend on the number of workers.

    Returns:
        `methods`: for each its success with interval; `METRICS`, each as a summary of the scenes'
        means; `ratio`: of L_d and L_p the ratio to the scene's oracle (its archive's most legible
        trajectory, not executed), its median over scenes with interval, and all values; for methods
        with a dial, `spearman` and `error` of the executed ℓ; `goals`: number in each scene;
        `tests`: see `compare`, paired by scene; `search`: number of curves of the two searches;
        `own` as of `evaluate_table1`. Methods of the user count as such with a dial.
    """
    contest, place = _contest(modulator, policies, config)
    source = SceneStream("evaluation", contest.kind.dim, "paper", config.goals, config.seed)
    archives = [source.archive(index, contest.observer) for index in range(config.scenes)]
    oracle = [measured(a.trajectories[a.nearest(1.0)], a, place.spacing) for a in archives]
    levels = level_steps(config.levels)
    legible = _jobs(archives, [1.0] * config.rollouts, config.seed, "plan")
    dial = _jobs(archives, levels.tolist(), config.seed, "demonstration")
    names = contest.names
    with_dial = [name for name in names if name in contest.own or METHODS[name].dial]
    work = [(name, *legible) for name in names] + [(name, *dial) for name in with_dial]
    with pool(workers, cluster) as each:
        motions = contest.motions(work, each, progress)
    moved = dict(zip(names, motions[: len(names)], strict=True))
    turned = dict(zip(with_dial, motions[len(names) :], strict=True))
    methods: dict[str, Any] = {}
    cells: dict[str, dict[str, Array]] = {}
    for name in names:
        values = _values(moved[name], legible[1], place.spacing)
        means = {m: array.reshape(config.scenes, -1).mean(axis=1) for m, array in values.items()}
        methods[name] = {
            "success": _share(moved[name] + turned.get(name, [])),
            **{metric: summary(values) for metric, values in means.items()},
            "ratio": {},
        }
        for metric, sign in TESTED.items():
            least = _LEAST[metric]
            ratio = np.maximum(means[metric], least)
            ratio = ratio / np.maximum([o[metric] for o in oracle], least)
            methods[name]["ratio"][metric] = {
                "median": float(np.median(ratio)),
                "interval": bootstrap_interval(ratio, np.median),
                "values": _rounded(ratio),
            }
            cells.setdefault(metric, {})[name] = sign * np.log(ratio)
        if name in turned:
            achieved = _values(turned[name], dial[1], place.spacing)["achieved"]
            table = achieved.reshape(config.scenes, -1)
            orders = np.array([rank_correlation(levels, row) for row in table])
            methods[name]["spearman"] = summary(orders)
            methods[name]["error"] = summary(np.abs(table - levels).mean(axis=1))
    return {
        "env": world(contest.kind),
        "spacing": place.spacing,
        "methods": methods,
        "goals": [a.scene.num_goals for a in archives],
        "least": _LEAST,
        "tests": compare(cells),
        "search": contest.sizes,
        "own": {name: method.record for name, method in contest.own.items()},
    }


@threads(1)
def _contest(
    modulator: Modulator, policies: dict[str, GoalPolicy], config: Table1Config
) -> tuple[Contest, TableScene]:
    """The contest, and the table's scene in which its searches were timed."""
    kind, own = vector_type(config.env, modulator.config.dim), load_methods(config.method)
    place, size = SCENES[kind.dim], config.search_candidates
    sizes = (size, 10 * size)
    if not size:  # as many curves as fit in the time of a plan, and in ten times that
        observer = Observer.paper(kind.dim)
        plan = plan_milliseconds(modulator, place.scene, repeats=25, observer=observer)
        few, many = (candidates_within(f * plan, place.scene, 0, observer) for f in (1, 10))
        sizes = (few, many)
    return Contest(modulator, policies, kind, sizes, own), place


def _jobs(
    archives: list[Archive], levels: list[float], seed: int, use: str
) -> tuple[list[Job], list[Archive]]:
    """A motion in each scene for each level, and its archive."""
    jobs = []
    for index, archive in enumerate(archives):
        seeds = iter(plan_seeds(seed, index, 2 * len(levels), use))
        jobs += [Job(archive.scene, 0, level, next(seeds), next(seeds), index) for level in levels]
    return jobs, [archive for archive in archives for _ in levels]


def _values(
    motions: Sequence[Rollout], archives: Iterable[Archive], *units: float
) -> dict[str, Array]:
    """Each of `METRICS` and `EXTERNAL` of `N` motions, `(N,)`."""
    rows = [measured(m.states, a, *units) for m, a in zip(motions, archives, strict=True)]
    return {name: np.array([row[name] for row in rows]) for name in METRICS | EXTERNAL}


def _share(motions: Sequence[Rollout]) -> dict[str, Any]:
    success = np.array([motion.success for motion in motions])
    return {"mean": float(success.mean()), "interval": share_interval(success)}


def _rounded(values: Array) -> list[float]:
    return [float(f"{value:.6g}") for value in values]


def compare(cells: dict[str, dict[str, Array]]) -> list[dict[str, Any]]:
    """All paired tests of a table, with Holm's correction over all of them.

    Every method is tested against Diffusion Policy, and the modulator's rows against all others.

    Args:
        cells: by the name of a cell (such as a target and a metric) the paired values `(N,)` of
            each method; higher is better.

    Returns:
        For each test `cell`, `method`, `against`, the entries of `paired_test`, and `p_holm`.
    """
    tests = []
    for cell, methods in cells.items():
        pairs = [(name, BASELINE) for name in methods if name != BASELINE]
        others = [name for name in methods if name not in (BASELINE, *OURS)]
        pairs += [(name, other) for name in methods if name in OURS for other in others]
        tests += [
            {"cell": cell, "method": a, "against": b, **paired_test(methods[a], methods[b])}
            for a, b in pairs
        ]
    for test, p in zip(tests, holm(np.array([t["p"] for t in tests])), strict=True):
        test["p_holm"] = float(p)
    return tests


def paper_rows(dim: int) -> dict[str, dict[str, float | None]]:
    """The paper's own Table I: by the name of a method its numbers, `success_rate`, `L_d_R`, …."""
    table = Path(__file__).with_name("table1.csv").read_text(encoding="utf-8")
    return {
        name: {key: float(value) if value else None for key, value in row.items()}
        for row in csv.DictReader(table.splitlines())
        if row.pop("environment") == f"{dim}d" and (name := row.pop("method"))
    }
