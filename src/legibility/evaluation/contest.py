"""The compared methods, and their executed motions on the same scenes, robots and seeds."""

import time
from collections.abc import Iterable, Sequence
from functools import partial
from itertools import chain, islice
from typing import NamedTuple

import numpy as np

from ..baselines.guided import GuidedPolicy
from ..baselines.planners import archive_path, search, straight_path
from ..checks import Array
from ..drivers import Driver, Policy, RobotStates
from ..envs.block_reach import BlockReachVector
from ..errors import InvalidInputError
from ..intent.observer import Observer
from ..models.goal_policy import GoalPolicy
from ..modulator import Modulator
from ..motion.archive import Archive, build_archive
from ..motion.path import Path
from ..parallel import Each, threads
from ..rollout import Rollout
from ..scene import Scene
from .common import Progress, counter, execute, gather, silent, world
from .own_method import OwnMethod, OwnPolicy, Task

CANDIDATES = 64
"""Paths drawn by the modulator's last row, which takes the best."""

_TIMED = 5
"""Motions of each method that are timed, after one that is not."""

OURS = ("network", "modulator", "modulator, candidates")
BASELINE = "diffusion policy"
"""The method without any notion of legibility; bold cells differ from it (paper, Table I)."""


class Method(NamedTuple):
    """A way to the goal: a path that stage 2 follows, or a `guided` policy without a path."""

    text: str
    dial: bool
    guided: bool = False
    paper: str = ""  # name in the paper's Table I


METHODS = {
    "straight line": Method("straight line", dial=False),
    BASELINE: Method("Diffusion Policy", False, True, "Diffusion Policy"),
    "legibility diffuser": Method("Legibility Diffuser", False, True, "Legibility Diffuser"),
    "search": Method("search, in the time of a plan", dial=True),
    "search, tenfold": Method("search, in ten times that", dial=True),
    "archive": Method("an archive's nearest trajectory", dial=True),
    "network": Method("the modulator’s network alone", dial=True),
    "modulator": Method("Legibility Modulator", dial=True, paper="Legibility Modulator"),
    "modulator, candidates": Method(
        f"the same, best of {CANDIDATES}", dial=True, paper="Legibility Modulator"
    ),
    "oracle": Method("Dataset Oracle, executed", dial=True, paper="Dataset Oracle"),
}
"""The compared methods, in the order of the tables."""


class Job(NamedTuple):
    """A motion to execute, with the seeds that all methods share."""

    scene: Scene
    target: int
    level: float
    env_seed: int
    plan_seed: int
    scene_index: int = 0


class Contest:
    """All methods on the same scenes, levels, robots and seeds, for the paper's observer.

    Stage 2 of `modulator` follows the paths of all methods that have one; `policies` are the
    goal-conditioned baselines by the name of their method; `sizes` are the numbers of curves that
    the two searches draw; `own` are methods of the user by name. Raises CheckpointError without a
    stage 2, InvalidInputError if a policy moves robots other than those of `kind`.

    Attributes:
        names: of all methods, in the order of the tables.
    """

    def __init__(
        self,
        modulator: Modulator,
        policies: dict[str, GoalPolicy],
        kind: type[BlockReachVector],
        sizes: tuple[int, int],
        own: dict[str, OwnMethod] | None = None,
    ) -> None:
        self.own = own or {}
        self.names = [*METHODS, *self.own]
        policy = modulator.stage_2()
        for name, model in {modulator.name: policy, **policies}.items():
            dim, limit = model.config.dim, model.config.limit
            if (dim, limit) != (kind.dim, kind.max_displacement):
                raise InvalidInputError(
                    f"{name} acts in {dim}D within {limit} m a step, {world(kind)} in {kind.dim}D "
                    f"within {kind.max_displacement} m"
                )
        self.modulator, self.policies, self.kind = modulator, policies, kind
        self.policy, self.sizes = policy, sizes
        self.observer = Observer.paper(kind.dim)

    @threads(1)
    def times(self, scene: Scene) -> dict[str, dict[str, float]]:
        """Median times [ms] on one core, by method: `plan`, before it can move, and `motion`, all.

        They are of one motion with ℓ = 1 toward goal 0 of `scene`, without the simulation; the
        oracle, whose archive is given, has none.
        """
        medians = {}
        for name in self.names:
            if name != "oracle":
                times = []
                for seed in range(1 + _TIMED):
                    job, started = Job(scene, 0, 1.0, seed, seed), time.perf_counter()
                    paths = self.paths(name, [job], [])
                    planned = time.perf_counter() - started
                    driver = _Stopwatch(self._driver(name, [job]))
                    self._execute([job], paths, driver)
                    moved = sum(driver.times)
                    followed = driver.with_path
                    times.append(
                        (planned, planned + moved) if followed else (driver.times[0], moved)
                    )
                plan, motion = 1e3 * np.median(times[1:], axis=0)
                medians[name] = {"plan": float(plan), "motion": float(motion)}
        return medians

    def paths(self, name: str, jobs: Sequence[Job], archives: Sequence[Archive]) -> list[Path]:
        """A path of a method for each of `jobs`; for a policy the straight line, not followed.

        `archives` of each job's scene are for the oracle alone.
        """
        if name in self.own:
            return [self.own[name].paths([self._task(job)])[0] for job in jobs]
        if name == "oracle":
            return [archive_path(a, job.level) for job, a in zip(jobs, archives, strict=True)]
        if name.startswith("search"):
            size = self.sizes[name != "search"]
            return [search(*job[:3], self.observer, size, job.plan_seed) for job in jobs]
        if name == "archive":
            return [
                archive_path(
                    build_archive(
                        job.scene, job.target, observer=self.observer, seed=job.plan_seed
                    ),
                    job.level,
                )
                for job in jobs
            ]
        if name in OURS:
            plan = partial(
                self.modulator.plan,
                observer=self.observer,
                refine=name != OURS[0],
                num_candidates=CANDIDATES if name == OURS[-1] else 1,
            )
            return [plan(*job[:3], seed=job.plan_seed) for job in jobs]
        return [straight_path(*job[:3], self.observer) for job in jobs]

    def motions(
        self,
        work: Sequence[tuple[str, Sequence[Job], Sequence[Archive]]],
        each: Each,
        progress: Progress = silent,
    ) -> list[list[Rollout]]:
        """Execute methods' jobs, with the archives of the jobs' scenes, as many at once as fit."""
        items: list[tuple[str, Sequence[Job], list[Path] | None]] = []
        for name, jobs, archives in work:
            # Archives are large: the oracle takes its paths before anything is sent.
            paths = self.paths(name, jobs, archives) if name == "oracle" else None
            for first in range(0, len(jobs), self.kind.at_once):
                part = slice(first, first + self.kind.at_once)
                items.append((name, jobs[part], paths and paths[part]))
        advance = counter(progress, sum(len(jobs) for _, jobs, _ in work))
        parts = gather(each, self._execute_item, items, lambda motions: advance(len(motions)))
        motions = chain.from_iterable(parts)
        return [list(islice(motions, len(jobs))) for _, jobs, _ in work]

    @threads(1)
    def _execute_item(self, item: tuple[str, Sequence[Job], list[Path] | None]) -> list[Rollout]:
        name, jobs, paths = item
        paths = paths or self.paths(name, jobs, [])
        return self._execute(jobs, paths, self._driver(name, jobs))

    def _task(self, job: Job) -> Task:
        return Task(*job[:3], job.plan_seed, self.observer, job.scene_index)

    def _driver(self, name: str, jobs: Sequence[Job]) -> Driver:
        if name in self.own and self.own[name].is_policy:
            return OwnPolicy(self.own[name], list(map(self._task, jobs)))
        if name in self.own or not METHODS[name].guided:
            return Policy(self.policy)
        scenes, targets = [job.scene for job in jobs], [job.target for job in jobs]
        return GuidedPolicy(self.policies[name], scenes, targets, jobs[0].plan_seed)

    def _execute(self, jobs: Sequence[Job], paths: list[Path], driver: Driver) -> list[Rollout]:
        return execute(
            self.modulator, self.kind, [job.scene for job in jobs],
            [job.env_seed for job in jobs], {"target": [job.target for job in jobs]},
            legibility=[job.level for job in jobs], paths=paths, driver=driver, replan=False,
        )  # fmt: skip


class _Stopwatch:
    """A driver that records the time [s] of each chunk."""

    def __init__(self, driver: Driver) -> None:
        self.driver, self.with_path = driver, driver.with_path
        self.times: list[float] = []

    def __call__(self, robots: RobotStates) -> Iterable[Array]:
        """See `Driver`."""
        started = time.perf_counter()
        actions = self.driver(robots)
        self.times.append(time.perf_counter() - started)
        return actions
