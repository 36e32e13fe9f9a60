"""The paired comparison of the modulator with its baselines on executed motions."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from ..baselines.guided import GuidedPolicy
from ..baselines.planners import archive_path, candidates_within, search, straight_path
from ..checks import Array
from ..curves import arc_length, resample, spaced
from ..drivers import Driver, Policy, RobotStates
from ..envs.block_reach import BlockReachVector
from ..errors import InvalidInputError
from ..intent.metrics import (
    SCORE_POINTS,
    distance_score,
    dragan_legibility,
    potential_cost,
    time_to_confidence,
)
from ..models.goal_policy import GoalPolicy
from ..modulator import Modulator
from ..motion.archive import Archive
from ..motion.path import Path
from ..parallel import Each, threads
from ..rollout import Rollout
from ..scene import Scene
from .statistics import holm, paired_test

__all__ = [
    "BASELINE",
    "CANDIDATES",
    "METHODS",
    "METRICS",
    "OURS",
    "TESTED",
    "Contest",
    "Job",
    "Metric",
    "Motion",
    "compare",
    "measured",
]

CANDIDATES = 64
"""Paths drawn by the modulator's second row, which takes the best."""

OURS = ("modulator", "modulator, candidates")
BASELINE = "diffusion policy"
"""The method without any notion of legibility; bold cells differ from it (paper, Table I)."""

_REPEATS = 25


class Method(NamedTuple):
    """A way to the goal: a path that stage 2 follows, or a policy.

    Attributes:
        text: name in tables.
        dial: whether it takes an ℓ.
        guided: whether it is a policy, without a path.
    """

    text: str
    dial: bool
    guided: bool = False


METHODS = {
    "straight line": Method("straight line", dial=False),
    BASELINE: Method("Diffusion Policy", dial=False, guided=True),
    "legibility diffuser": Method("Legibility Diffuser", dial=False, guided=True),
    "search": Method("search, in the time of a plan", dial=True),
    "search, tenfold": Method("search, in ten times that", dial=True),
    "modulator": Method("Legibility Modulator", dial=True),
    "modulator, candidates": Method(f"the same, best of {CANDIDATES}", dial=True),
    "oracle": Method("Dataset Oracle, executed", dial=True),
}
"""The compared methods, in the order of the tables."""


class Metric(NamedTuple):
    """A metric of a motion, and whether higher is better."""

    text: str
    higher: bool | None


METRICS = {
    "distance_score": Metric("L_d", True),
    "potential_cost": Metric("L_p", False),
    "length_ratio": Metric("length over the straight line's", None),
    "achieved": Metric("achieved ℓ", True),
    "time_to_confidence": Metric("time to confidence", False),
    "dragan_legibility": Metric("Dragan's legibility", True),
}
"""The metrics of a motion."""

TESTED = ("distance_score", "potential_cost")
"""The paper's two metrics, which are tested."""


class Job(NamedTuple):
    """A motion to execute, with the seeds that all methods share."""

    scene: Scene
    target: int
    level: float
    env_seed: int
    plan_seed: int


class Motion(NamedTuple):
    """An executed motion: states `(T, D)` [m], success and end reason."""

    states: Array
    success: bool
    reason: str


def measured(states: Array, scene: Scene, archive: Archive, spacing: float) -> dict[str, float]:
    """`METRICS` of one motion `(T, D)` [m], its points a control step apart.

    The paper's two are sums over points, here at equal `spacing` [m] along the motion. A time to
    confidence that is never reached counts as 1, the end.
    """
    field, target = archive.field, archive.target
    points = spaced(states, spacing)
    confident = float(time_to_confidence(field.posterior(states), target))
    straight = np.linalg.norm(scene.target(target) - scene.start)
    score = archive.observer.score(resample(states, SCORE_POINTS), scene, target)
    return {
        "distance_score": float(distance_score(points, scene.goals, target)),
        "potential_cost": float(potential_cost(points, field, target)),
        "length_ratio": float(arc_length(states) / straight),
        "achieved": float(archive.label_of(score)),
        "time_to_confidence": min(confident, 1.0),
        "dragan_legibility": float(dragan_legibility(states, scene.goals, target)),
    }


class Contest:
    """All methods on the same scenes, levels, robots and seeds.

    Args:
        modulator: both stages; stage 2 follows the paths of all methods that have one.
        policies: the goal-conditioned baselines by the name of their method.
        kind: vector environment.
        sizes: curves that the two searches draw; set by `calibrate` if not given.
    """

    def __init__(
        self,
        modulator: Modulator,
        policies: dict[str, GoalPolicy],
        kind: type[BlockReachVector],
        sizes: tuple[int, int] | None = None,
    ) -> None:
        policy = modulator.path_policy
        if policy is None:
            raise InvalidInputError(f"the model {modulator.name} has no stage 2 to compare")
        for name, config in {
            modulator.name: policy.config, **{n: p.config for n, p in policies.items()}
        }.items():  # fmt: skip
            if (config.dim, config.limit) != (kind.dim, kind.max_displacement):
                raise InvalidInputError(
                    f"{name} acts in {config.dim}D within {config.limit} m a step, "
                    f"{kind.__name__.removesuffix('Vector')} in {kind.dim}D within "
                    f"{kind.max_displacement} m"
                )
        self.modulator, self.policies, self.kind = modulator, policies, kind
        self.policy = policy
        self.sizes = sizes
        self.observer = modulator.config.observer

    def calibrate(self, scene: Scene, target: int) -> tuple[int, int]:
        """Set the numbers of curves of the searches, unless they are given, and return them.

        They are as many as fit in the time that the modulator plans with ℓ = 1 in `scene`, and in
        ten times that, on one core.
        """
        if self.sizes is None:
            with threads(1):
                job, times = [Job(scene, target, 1.0, 0, 0)], []
                for _ in range(_REPEATS):
                    started = time.perf_counter()
                    self.paths("modulator", job, [])
                    times.append(1e3 * (time.perf_counter() - started))
                plan = float(np.median(times))
                self.sizes = (
                    candidates_within(plan, scene, target, self.observer),
                    candidates_within(10 * plan, scene, target, self.observer),
                )
        return self.sizes

    def times(self, scene: Scene, target: int) -> dict[str, dict[str, float]]:
        """Median times [ms] on one core, by method: `plan`, before it can move, and `motion`, all.

        They are of one motion with ℓ = 1 in `scene`, without the simulation; the oracle, whose
        archive is given, has none.
        """
        medians = {}
        with threads(1):
            for name in METHODS:
                if name != "oracle":
                    times = [self._timed(name, scene, target, seed) for seed in range(6)][1:]
                    plan, motion = np.median(times, axis=0)
                    medians[name] = {"plan": float(plan), "motion": float(motion)}
        return medians

    def _timed(self, name: str, scene: Scene, target: int, seed: int) -> tuple[float, float]:
        job = Job(scene, target, 1.0, seed, seed)
        started = time.perf_counter()
        paths = self.paths(name, [job], [])
        planned = time.perf_counter() - started
        driver = _Stopwatch(self._driver(name, [job], seed))
        self._execute([job], paths, driver)
        if METHODS[name].guided:
            planned = driver.times[0]
        else:
            driver.times.insert(0, planned)
        return 1e3 * planned, 1e3 * sum(driver.times)

    def paths(self, name: str, jobs: Sequence[Job], archives: Sequence[Archive]) -> list[Path]:
        """A path for each of `jobs`; for a policy the straight line, which is not followed.

        Args:
            name: of the method.
            jobs: the motions.
            archives: of each job's scene, for the oracle.
        """
        if name == "oracle":
            return [archive_path(a, job.level) for job, a in zip(jobs, archives, strict=True)]
        if name.startswith("search"):
            assert self.sizes is not None
            size = self.sizes[name != "search"]
            return [
                search(job.scene, job.target, job.level, self.observer, size, job.plan_seed)
                for job in jobs
            ]
        if name in OURS:
            candidates = CANDIDATES if name == OURS[1] else 1
            return [
                self.modulator.plan(
                    job.scene, job.target, job.level, seed=job.plan_seed, num_candidates=candidates
                )
                for job in jobs
            ]
        return [straight_path(job.scene, job.target, job.level, self.observer) for job in jobs]

    def motions(
        self,
        work: Sequence[tuple[str, Sequence[Job], Sequence[Archive]]],
        each: Each,
        progress: Callable[[int, int], None] = lambda done, total: None,
    ) -> list[list[Motion]]:
        """Execute the jobs of every method in `work`, as many at once as fit.

        Args:
            work: methods, their jobs, and the archives of the jobs' scenes, for the oracle.
            each: of `pool`.
            progress: called with the number of finished motions and of all motions.
        """
        items: list[tuple[str, Sequence[Job], list[Path] | None]] = []
        places = []
        for number, (name, jobs, archives) in enumerate(work):
            # Archives are large: the oracle takes its paths before anything is sent.
            paths = self.paths(name, jobs, archives) if name == "oracle" else None
            for first in range(0, len(jobs), self.kind.at_once):
                part = slice(first, first + self.kind.at_once)
                items.append((name, jobs[part], paths and paths[part]))
                places.append(number)
        done, total = 0, sum(len(jobs) for _, jobs, _ in work)
        parts: dict[int, list[Motion]] = {}
        for index, executed in each(self._execute_item, items):
            parts[index] = executed
            done += len(executed)
            progress(done, total)
        motions: list[list[Motion]] = [[] for _ in work]
        for index, number in enumerate(places):
            motions[number] += parts[index]
        return motions

    @threads(1)
    def _execute_item(self, item: tuple[str, Sequence[Job], list[Path] | None]) -> list[Motion]:
        name, jobs, paths = item
        paths = paths or self.paths(name, jobs, [])
        rollouts = self._execute(jobs, paths, self._driver(name, jobs, jobs[0].plan_seed))
        return [Motion(r.states, r.success, r.reason) for r in rollouts]

    def _driver(self, name: str, jobs: Sequence[Job], seed: int) -> Driver:
        if not METHODS[name].guided:
            return Policy(self.policy, seed)
        scenes, targets = [job.scene for job in jobs], [job.target for job in jobs]
        return GuidedPolicy(self.policies[name], scenes, targets, seed)

    def _execute(self, jobs: Sequence[Job], paths: Sequence[Path], driver: Driver) -> list[Rollout]:
        env = self.kind(len(jobs), max_goals=max(job.scene.num_goals for job in jobs))
        env.reset(
            seed=[job.env_seed for job in jobs],
            options={"scene": [j.scene for j in jobs], "target": [j.target for j in jobs]},
        )
        levels = [job.level for job in jobs]
        rollouts = self.modulator.execute_many(
            env, legibility=levels, paths=paths, driver=driver, replan=False
        )
        env.close()
        return rollouts


class _Stopwatch:
    """A driver that records the time [s] of each chunk."""

    def __init__(self, driver: Driver) -> None:
        self.driver, self.with_path = driver, driver.with_path
        self.times: list[float] = []

    def __call__(self, robots: RobotStates) -> Array:
        """See `Driver`."""
        started = time.perf_counter()
        actions = self.driver(robots)
        self.times.append(time.perf_counter() - started)
        return actions


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
