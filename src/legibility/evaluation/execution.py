"""Closed-loop execution of plans on held-out scenes."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..checks import Array
from ..data.scenes import SceneStream
from ..drivers import Driver, Feedback, Policy, Replay
from ..envs import vector_type
from ..envs.block_reach import BlockReachVector
from ..errors import InvalidInputError
from ..intent.observer import Observer
from ..modulator import Modulator
from ..motion.archive import Archive
from ..motion.path import Path
from ..motion.tracking import NOMINAL_GAIN
from ..parallel import pool, threads
from ..rollout import Rollout
from ..scene import Scene
from ..seeds import plan_seeds, stream_seed
from .configuration import ExecutionConfig
from .statistics import bootstrap_interval, rank_correlation, share_interval, summary

__all__ = ["ROWS", "evaluate_execution"]


class Row(NamedTuple):
    """A controller and its conditions.

    Attributes:
        text: name in tables.
        driver: the controller.
        disturbance: `push` or `shift`, an option of the environment.
        replan: whether the robot may replan; one without feedback from the path is off it by
            design.
    """

    text: str
    driver: str
    disturbance: str | None = None
    replan: bool = True


ROWS = {
    "policy": Row("stage 2", "policy"),
    "policy, pushed": Row("stage 2, pushed once", "policy", "push"),
    "policy, goal moved": Row("stage 2, the target moved once", "policy", "shift"),
    "goal only": Row("stage 2 without the path", "goal only", replan=False),
    "open loop": Row("open-loop replay of the path's displacements", "open loop", replan=False),
    "open loop, mean gain": Row(
        "the same, divided by the mean of the hidden gains", "mean gain", replan=False
    ),
    "feedback": Row("the feedback controller that demonstrated", "feedback"),
    "feedback, pushed": Row("the same, pushed once", "feedback", "push"),
}
"""The rows of the table, by name."""

_DISTURBANCE = 2.0
_NEAR = 0.05


def evaluate_execution(
    modulator: Modulator,
    config: ExecutionConfig | None = None,
    *,
    workers: int = 1,
    cluster: str | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> dict[str, Any]:
    """Execute plans of `modulator` by stage 2 and by the controllers that it is compared with.

    Every row of `ROWS` has the same scenes, levels, plans, hidden gains, lags and disturbances. The
    metrics do not depend on the number of workers, each of which runs on one thread.

    Args:
        modulator: the model, with both stages.
        config: of the evaluation.
        workers: processes on this machine.
        cluster: a Dask cluster, see `pool`.
        progress: called with the scenes and rollouts done and all of them.

    Returns:
        `rows`: for each of `ROWS` success with interval, end reasons, achieved against asked ℓ (of
        all rollouts, however they ended; not where the target moved, because that label would
        belong to another scene), the deviation from the curve followed at the time over the length
        of the first curve, violations, and the environment's counts;
        `step_ms`: a control step of one robot on one core, policy included, amortised over a chunk;
        `rollouts_per_second`: of stage 2, planning included, the first `at_once` robots on
        `threads` threads; `env_steps_per_second`: of the environment alone, as many robots, on one
        core; these three before other work starts;
        `env`; `disturbance` [m].
    """
    config = config or ExecutionConfig()
    policy = modulator.path_policy
    if policy is None:
        raise InvalidInputError(f"the model {modulator.name} has no stage 2 to evaluate")
    source = SceneStream("evaluation", modulator.config.dim, config.goals, config.seed)
    kind = vector_type(config.env, modulator.config.dim)
    limit = policy.config.limit
    if kind.max_displacement != limit:
        raise InvalidInputError(
            f"the model {modulator.name} acts within {limit} m a step, {config.env} within "
            f"{kind.max_displacement} m"
        )
    disturbance = _DISTURBANCE * limit if config.disturbance is None else config.disturbance
    at_once = min(kind.at_once, config.rollouts)
    batches = range(0, config.rollouts, at_once)
    scene_of = np.repeat(np.arange(config.scenes), config.rollouts // config.scenes)
    draw = stream_seed("evaluation", config.seed, 0, "plan")
    levels = np.random.default_rng(draw).uniform(-1, 1, config.rollouts)
    total, done = config.scenes + len(ROWS) * config.rollouts, 0
    archives: dict[int, Archive] = {}
    parts: dict[str, dict[int, list[Rollout]]] = {name: {} for name in ROWS}
    rows: dict[str, dict[str, Any]] = {}

    def ended(task: _Task, rollouts: list[Rollout]) -> None:
        nonlocal done
        batch = parts[task.row]
        batch[task.first] = rollouts
        done += len(rollouts)
        progress(done, total)
        if len(batch) == len(batches):
            whole = [rollout for first in batches for rollout in batch.pop(first)]
            rows[task.row] = _metrics(whole, levels, scene_of, archives, limit)

    with pool(workers, cluster) as work:
        step_ms = step_milliseconds(modulator, source.scene(0), kind)
        env_speed = env_steps_per_second(kind, at_once)
        for index, archive in work(
            partial(_scores_of, source, modulator.config.observer), range(config.scenes)
        ):
            archives[index] = archive
            done += 1
            progress(done, total)
        scenes = [archives[i].scene for i in scene_of.tolist()]
        course = _Course(modulator, config, kind, disturbance, scenes, levels, at_once)
        # The plans of the first row are those of all.
        name, *others = ROWS
        tasks = [_Task(name, first) for first in batches]
        started = time.perf_counter()
        rollouts = course.rollouts(tasks[0])
        speed = len(rollouts) / (time.perf_counter() - started)
        plans = {0: [rollout.path for rollout in rollouts]}
        ended(tasks.pop(0), rollouts)
        for index, rollouts in work(course.rollouts, tasks):
            plans[tasks[index].first] = [rollout.path for rollout in rollouts]
            ended(tasks[index], rollouts)
        tasks = [_Task(name, first, plans[first]) for name in others for first in batches]
        for index, rollouts in work(course.rollouts, tasks):
            ended(tasks[index], rollouts)
    for name, row in ROWS.items():
        if row.disturbance == "shift":
            for metric in ("spearman", "error", "within_5_cm"):
                del rows[name][metric]
    return {
        "rows": {name: rows[name] for name in ROWS},
        "step_ms": step_ms,
        "rollouts_per_second": speed,
        "at_once": at_once,
        "env_steps_per_second": env_speed,
        "env": kind.__name__.removesuffix("Vector"),
        "disturbance": disturbance,
        "threads": 1,
    }


def _scores_of(source: SceneStream, observer: Observer, index: int) -> Archive:
    """A scene's archive without its curves, which are large; labels are read off the scores."""
    archive = source.archive(index, observer)
    nothing = np.empty(0)
    return replace(archive, controls=nothing, trajectories=nothing, descriptors=nothing)


class _Task(NamedTuple):
    """The rollouts of a row from `first` on, `at_once` of them, on `paths` or on new plans."""

    row: str
    first: int
    paths: list[Path] | None = None


@dataclass(frozen=True)
class _Course:
    """The scene and the level of each rollout, which all rows share, and the model."""

    modulator: Modulator
    config: ExecutionConfig
    kind: type[BlockReachVector]
    disturbance: float
    scenes: list[Scene]
    levels: Array
    at_once: int

    @threads(1)
    def rollouts(self, task: _Task) -> list[Rollout]:
        row, part = ROWS[task.row], slice(task.first, task.first + self.at_once)
        plan_seed, policy_seed, env_seed = plan_seeds(
            self.config.seed, task.first, 3, "demonstration"
        )
        scenes = self.scenes[part]
        env = self.kind(len(scenes), max_goals=max(6, self.config.goals[1]))
        options = {row.disturbance: self.disturbance} if row.disturbance else {}
        env.reset(seed=env_seed, options={"scene": scenes, **options})
        rollouts = self.modulator.execute_many(
            env, legibility=self.levels[part], seed=plan_seed, paths=task.paths,
            driver=self._driver(row.driver, policy_seed), replan=row.replan,
        )  # fmt: skip
        env.close()
        return rollouts

    def _driver(self, name: str, seed: int) -> Driver:
        policy = self.modulator.path_policy
        assert policy is not None
        drivers: dict[str, Callable[[], Driver]] = {
            "policy": lambda: Policy(policy, seed),
            "goal only": lambda: Policy(policy, seed, with_path=False),
            "open loop": lambda: Replay(policy.config.limit),
            "mean gain": lambda: Replay(policy.config.limit, NOMINAL_GAIN),
            "feedback": Feedback,
        }
        return drivers[name]()


def _metrics(
    rollouts: list[Rollout],
    levels: Array,
    scene_of: NDArray[np.intp],
    archives: dict[int, Archive],
    limit: float,
) -> dict[str, Any]:
    success = np.array([r.success for r in rollouts])
    achieved, planned = (
        np.array([archives[i].label_of(x) for i, x in zip(scene_of.tolist(), scores, strict=True)])
        for scores in ([r.score for r in rollouts], [float(r.path.score) for r in rollouts])
    )
    by_scene = [scene_of == i for i in range(len(archives))]
    # A rollout with a new plan deviates from the path that it followed at the time.
    deviation = np.array([r.deviation.mean() for r in rollouts])
    lengths = np.array([r.path.length for r in rollouts])
    shares = np.array([success[s].mean() for s in by_scene])
    actions = np.concatenate([r.actions for r in rollouts])
    states = np.concatenate([r.states for r in rollouts])
    low, high = rollouts[0].path.scene.workspace
    ends = np.stack([r.states[-1] for r in rollouts])
    goals = np.stack([r.path.waypoints[-1] for r in rollouts])
    return {
        "rollouts": len(rollouts),
        "success": {"mean": float(success.mean()), "interval": _interval(success, shares)},
        "within_5_cm": float((np.linalg.norm(ends - goals, axis=-1) <= _NEAR).mean()),
        "reasons": dict(Counter(r.reason for r in rollouts)),
        "spearman": summary(np.array([rank_correlation(levels[s], achieved[s]) for s in by_scene])),
        "error": summary(np.array([np.abs(achieved - levels)[s].mean() for s in by_scene])),
        "spearman_of_plan": summary(
            np.array([rank_correlation(levels[s], planned[s]) for s in by_scene])
        ),
        "error_of_plan": summary(np.array([np.abs(planned - levels)[s].mean() for s in by_scene])),
        "deviation": summary(np.array([(deviation / lengths)[s].mean() for s in by_scene])),
        "steps": float(np.mean([len(r.actions) for r in rollouts])),
        "replanned": float(np.mean([len(r.replans) > 0 for r in rollouts])),
        "wall_contacts": sum(r.wall_contacts for r in rollouts),
        "states_outside": int(((states < low - 1e-9) | (states > high + 1e-9)).any(-1).sum()),
        "farthest_outside": float(np.maximum(low - states, states - high).max()),
        "actions_not_finite": int((~np.isfinite(actions)).any(-1).sum()),
        "actions_over_limit": int((np.abs(actions) > limit).any(-1).sum()),
        "counts": {name: sum(r.counts[name] for r in rollouts) for name in rollouts[0].counts},
    }


def _interval(success: NDArray[Any], shares: Array) -> tuple[float, float]:
    """The wider of the exact interval and of the one over scenes, in which failures may gather."""
    exact, over_scenes = share_interval(success), bootstrap_interval(shares)
    return min(exact[0], over_scenes[0]), max(exact[1], over_scenes[1])


@threads(1)
def step_milliseconds(
    modulator: Modulator, scene: Scene, kind: type[BlockReachVector], repeats: int = 5
) -> float:
    """Median time [ms] of one control step of one robot on one core, everything but planning."""
    times = []
    for seed in range(repeats + 1):
        env = kind(1, max_goals=max(6, scene.num_goals))
        env.reset(seed=seed, options={"scene": scene})
        path = modulator.plan(scene, 0, 0.5, seed=seed)
        start = time.perf_counter()
        (rollout,) = modulator.execute_many(env, legibility=0.5, seed=seed, paths=[path])
        times.append((time.perf_counter() - start) / len(rollout.actions))
    return float(np.median(times[1:]) * 1e3)


def env_steps_per_second(kind: type[BlockReachVector], size: int, seconds: float = 2.0) -> float:
    """Control steps a second of the environment alone, `size` robots that move at random."""
    env = kind(size, max_episode_steps=2**31)
    env.reset(seed=0)
    rng = np.random.default_rng(0)
    reach = env.max_displacement / 2
    taken, started = 0, time.perf_counter()
    while (spent := time.perf_counter() - started) < seconds:
        if env.done.any():
            env.reset(options={"reset_mask": env.done})
        env.step(rng.uniform(-reach, reach, env.positions.shape))
        taken += size
    env.close()
    return taken / spent
