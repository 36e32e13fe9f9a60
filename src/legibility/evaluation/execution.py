"""Closed-loop execution of plans on held-out scenes."""

from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import chain
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..checks import Array
from ..curves import turning
from ..data.configuration import SceneStream
from ..drivers import Driver, Feedback, Policy, Replay
from ..envs import vector_type
from ..envs.block_reach import BlockReachVector
from ..errors import InvalidSceneError
from ..intent.observer import Observer
from ..models.path_policy import PathPolicy
from ..modulator import Modulator
from ..motion.archive import Archive
from ..motion.path import Path
from ..motion.tracking import NOMINAL_GAIN
from ..parallel import pool, threads
from ..robots.arm import Arm
from ..rollout import Rollout
from ..scene import Scene
from ..seeds import plan_seeds, stream_seed
from ..whole_arm import arm_can_pass, checked_arm
from .common import Progress, counter, execute, gather, silent, world
from .configuration import ExecutionConfig
from .statistics import bootstrap_interval, rank_correlation, share_interval, summary


class Row(NamedTuple):
    """A controller and its conditions."""

    text: str  # name in tables
    driver: Callable[[PathPolicy], Driver]  # from stage 2
    disturbance: str | None = None  # push or shift, an option of the environment
    replan: bool = True  # without feedback from the path a robot is off it by design


ROWS = {
    "policy": Row("stage 2", Policy),
    "policy, pushed": Row("stage 2, pushed once", Policy, "push"),
    "policy, goal moved": Row("stage 2, the target moved once", Policy, "shift"),
    "goal only": Row("stage 2 without the path", partial(Policy, with_path=False), replan=False),
    "open loop": Row(
        "open-loop replay of the path's displacements",
        lambda policy: Replay(policy.config.limit),
        replan=False,
    ),
    "open loop, mean gain": Row(
        "the same, over the mean hidden gain",
        lambda policy: Replay(policy.config.limit, NOMINAL_GAIN),
        replan=False,
    ),
    "feedback": Row("the feedback controller that demonstrated", lambda policy: Feedback()),
    "feedback, pushed": Row("the same, pushed once", lambda policy: Feedback(), "push"),
}
"""The rows of the table, by name."""

_Task = tuple[str, list[Scene], Array, list[int], list[Path] | None]
"""Rollouts of a row to execute together: scenes, levels, seeds, and paths unless they are new."""

_DISTURBANCE = 2.0
_NEAR = 0.05
_MOST_SCENES = 16  # drawn for each that is asked


def evaluate_execution(
    modulator: Modulator,
    config: ExecutionConfig,
    *,
    workers: int = 1,
    cluster: str | None = None,
    progress: Progress = silent,
) -> dict[str, Any]:
    """Execute plans of `modulator` by stage 2 and by the controllers that it is compared with.

    Every row of `ROWS` has the same scenes, levels, plans, hidden gains, lags and disturbances. The
    metrics do not depend on the number of workers, each of which runs on one thread. A scene whose
    obstacles let no motion of the whole robot pass is counted, and the next one is taken.

    Arguments as of `evaluate_dial`; the model needs both stages.

    Returns:
        `rows`: for each of `ROWS` success with interval, end reasons, achieved against asked ℓ of
        all rollouts (not where the target moved: a label belongs to a scene), the deviation from
        the curve followed at the time over the length of the first curve, the rms `jerk` [m/s³],
        the angle [rad] that motions and their first plans turn through, violations, among them
        `contacts` (steps) in `touching` rollouts, and the environment's counts; `env`;
        `disturbance` [m]; `impassable`, the number of scenes drawn that the robot cannot pass.
    """
    policy = modulator.stage_2()
    source = config.stream(modulator.config.dim)
    kind = vector_type(config.env, modulator.config.dim)
    arm = checked_arm(config.arm, modulator.config.dim)
    limit = policy.config.limit
    disturbance = _DISTURBANCE * limit if config.disturbance is None else config.disturbance
    at_once = min(kind.at_once, config.rollouts)
    scene_of = np.repeat(np.arange(config.scenes), config.rollouts // config.scenes)
    draw = stream_seed("evaluation", config.seed, 0, "plan")
    levels = np.random.default_rng(draw).uniform(-1, 1, config.rollouts)
    advance = counter(progress, config.scenes + len(ROWS) * config.rollouts)
    rows: dict[str, dict[str, Any]] = {}
    with pool(workers, cluster) as work:
        scores_of = partial(_scores_of, source, modulator.config.observer, arm or kind.arm)
        archives, tried = list[Archive](), 0
        while len(archives) < config.scenes:
            more = range(tried, tried + config.scenes - len(archives))
            tried = more.stop
            found = gather(work, scores_of, more, lambda archive: advance(archive is not None))
            archives += [archive for archive in found if archive is not None]
            if len(archives) < config.scenes and tried >= _MOST_SCENES * config.scenes:
                raise InvalidSceneError(
                    f"{world(kind)} can pass {len(archives)} of {tried} random scenes only, "
                    f"{config.scenes} are asked"
                )
        scenes = [archives[i].scene for i in scene_of.tolist()]
        tasks: list[_Task] = []
        for first in range(0, config.rollouts, at_once):
            part = slice(first, first + at_once)
            seeds = plan_seeds(config.seed, first, 2, "demonstration")
            tasks.append((next(iter(ROWS)), scenes[part], levels[part], seeds, None))
        watching = archives[0].observer  # one for all scenes of these regimes
        run = partial(_rollouts, modulator, policy, kind, arm, watching, disturbance)
        parts: list[list[Rollout]] = []
        for name, row in ROWS.items():
            tasks = [(name, *task[1:]) for task in tasks]
            parts += gather(work, run, tasks[len(parts) :], lambda part: advance(len(part)))
            # The plans of the first row are those of all.
            pairs = zip(tasks, parts, strict=True)
            tasks = [(*task[:-1], [rollout.path for rollout in part]) for task, part in pairs]
            rows[name] = _metrics(list(chain(*parts)), levels, scene_of, archives, limit)
            parts = []
            if row.disturbance == "shift":
                for metric in ("spearman", "error", "within_5_cm"):
                    del rows[name][metric]
    impassable = tried - config.scenes
    name = world(kind) if arm is None else f"{world(kind)} with {arm.name}"
    return {"rows": rows, "env": name, "disturbance": disturbance, "impassable": impassable}


def _scores_of(
    source: SceneStream, observer: Observer, arm: Arm | None, index: int
) -> Archive | None:
    """A scene's archive without its curves, which are large; labels are read off the scores.

    None if the robot cannot pass the scene.
    """
    if not arm_can_pass(arm, source.scene(index), observer):
        return None
    archive = source.archive(index, observer)
    return replace(archive, controls=np.empty(0))


@threads(1)
def _rollouts(
    modulator: Modulator,
    policy: PathPolicy,
    kind: type[BlockReachVector],
    arm: Arm | None,
    observer: Observer,
    disturbance: float,
    task: _Task,
) -> list[Rollout]:
    name, scenes, levels, (plan_seed, env_seed), paths = task
    row = ROWS[name]
    options = {row.disturbance: disturbance} if row.disturbance else {}
    return execute(
        modulator, kind, scenes, env_seed, options, arm, legibility=levels, seed=plan_seed,
        paths=paths, driver=row.driver(policy), replan=row.replan, observer=observer,
    )  # fmt: skip


def _metrics(
    rollouts: list[Rollout],
    levels: Array,
    scene_of: NDArray[np.intp],
    archives: list[Archive],
    limit: float,
) -> dict[str, Any]:
    by_scene = [scene_of == i for i in range(len(archives))]

    def over_scenes(values: Array) -> dict[str, Any]:
        return summary(np.array([values[scene].mean() for scene in by_scene]))

    def dial(scores: list[float], suffix: str = "") -> dict[str, Any]:
        pairs = zip(scene_of.tolist(), scores, strict=True)
        labels = np.array([archives[i].label_of(score) for i, score in pairs])
        orders = [rank_correlation(levels[scene], labels[scene]) for scene in by_scene]
        return {
            f"spearman{suffix}": summary(np.array(orders)),
            f"error{suffix}": over_scenes(np.abs(labels - levels)),
        }

    success = np.array([r.success for r in rollouts])
    shares = np.array([success[scene].mean() for scene in by_scene])
    ends = np.stack([r.states[-1] for r in rollouts])
    goals = np.stack([r.path.waypoints[-1] for r in rollouts])
    # A rollout with a new plan deviates from the path that it followed at the time.
    deviation = np.array([r.deviation.mean() / r.path.length for r in rollouts])
    actions = np.concatenate([r.actions for r in rollouts])
    states = np.concatenate([r.states for r in rollouts])
    low, high = rollouts[0].path.scene.workspace
    return {
        "rollouts": len(rollouts),
        "success": {"mean": float(success.mean()), "interval": _interval(success, shares)},
        "within_5_cm": float((np.linalg.norm(ends - goals, axis=-1) <= _NEAR).mean()),
        "reasons": dict(Counter(r.reason for r in rollouts)),
        **dial([r.score for r in rollouts]),
        **dial([float(r.path.score) for r in rollouts], "_of_plan"),
        "deviation": over_scenes(deviation),
        "jerk": over_scenes(np.array([r.jerk for r in rollouts])),
        "turned": over_scenes(turning(np.stack([r.trajectory() for r in rollouts]))),
        "turned_of_plan": over_scenes(turning(np.stack([r.path.trajectory() for r in rollouts]))),
        "steps": float(np.mean([len(r.actions) for r in rollouts])),
        "replanned": float(np.mean([len(r.replans) > 0 for r in rollouts])),
        "contacts": sum(r.contacts for r in rollouts),
        "touching": sum(r.contacts > 0 for r in rollouts),
        "corrections": sum(r.corrections for r in rollouts),
        "replaced": sum(bool(r.path.replaced) for r in rollouts),
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
