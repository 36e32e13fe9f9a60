"""What becomes of plans in the world: rollouts on scenes that training never drew."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from ..checks import Array, bounded, count
from ..dataset import DatasetConfig
from ..envs.block_reach_2d import BlockReach2DVector
from ..errors import InvalidInputError
from ..execution import Driver, Feedback, Policy, Replay, Rollout
from ..modulator import Modulator
from ..motion.archive import Archive
from ..scene import Scene, stream_seed
from .statistics import rank_correlation, share_interval, summary

__all__ = ["ROWS", "ExecutionConfig", "evaluate_execution"]

ROWS = {
    "policy": "stage 2",
    "policy, pushed": "stage 2, pushed once by 10 cm",
    "policy, goal moved": "stage 2, the target moved once by 10 cm",
    "goal only": "stage 2 without the path",
    "open loop": "open-loop replay of the path's displacements",
    "feedback": "the feedback controller that demonstrated",
    "feedback, pushed": "the same, pushed once by 10 cm",
}
"""What is compared, and what it is."""

_BATCH = 256


@dataclass(frozen=True)
class ExecutionConfig:
    """What is evaluated.

    Attributes:
        scenes: random scenes of the evaluation stream.
        goals: least and most goals of a scene.
        seed: of the scenes, the plans and the environments.
        rollouts: in all, the same number in each scene, ℓ uniform in [−1, 1].
        disturbance: of a push or a shift of the target [m].
    """

    scenes: int = 200
    goals: tuple[int, int] = (2, 6)
    seed: int = 0
    rollouts: int = 5000
    disturbance: float = 0.1

    def __post_init__(self) -> None:
        count("scenes", self.scenes)
        if count("rollouts", self.rollouts) % self.scenes or self.rollouts < 3 * self.scenes:
            raise InvalidInputError(
                f"rollouts must be a multiple of scenes, three or more in each, "
                f"got {self.rollouts} for {self.scenes}"
            )
        bounded("disturbance", self.disturbance, 0)


def evaluate_execution(
    modulator: Modulator,
    config: ExecutionConfig | None = None,
    *,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> dict[str, Any]:
    """Execute plans of `modulator` by stage 2 and by what it is compared with.

    Every row of `ROWS` has the same scenes, levels, plans, hidden gains and lags.

    Returns:
        `rows`: of each of `ROWS` its success with interval, the reasons of the ends, what was
        achieved against what was asked, the deviation from the planned curve, violations;
        `step_ms`: a control step of one robot on one core, policy included, amortised over a chunk;
        `rollouts_per_second`: 256 robots at once, planning included.
    """
    config = config or ExecutionConfig()
    policy = modulator.path_policy
    if policy is None:
        raise InvalidInputError(f"the model {modulator.name} has no stage 2 to evaluate")
    source = DatasetConfig(
        dim=modulator.config.dim, scenes=config.scenes, seed=config.seed, stream="evaluation",
        goals=config.goals, label=modulator.config.label, sigma=modulator.config.sigma,
        alpha=modulator.config.alpha,
    )  # fmt: skip
    step_ms = step_milliseconds(modulator, source.scene(0)[0])
    scenes: list[Scene] = []
    archives: list[Archive] = []
    total = config.scenes + len(ROWS) * config.rollouts
    for index in range(config.scenes):
        scene, archive = source.scene(index)
        scenes.append(scene)
        archives.append(archive)
        progress(index + 1, total)
    each = np.repeat(np.arange(config.scenes), config.rollouts // config.scenes)
    draw = stream_seed("evaluation", config.seed, 0, "plan")
    levels = np.random.default_rng(draw).uniform(-1, 1, config.rollouts)
    drivers: dict[str, Callable[[int], Driver]] = {
        "policy": lambda seed: Policy(policy, seed),
        "goal only": lambda seed: Policy(policy, seed, with_path=False),
        "open loop": lambda seed: Replay(policy.config.limit),
        "feedback": lambda seed: Feedback(),
    }
    disturbances = {"pushed": "push", "goal moved": "shift"}
    rows, speed = {}, 0.0
    done = config.scenes
    for name in ROWS:
        who, _, what = name.partition(", ")
        options = {disturbances[what]: config.disturbance} if what else {}
        rollouts: list[Rollout] = []
        started = time.perf_counter()
        for first in range(0, config.rollouts, _BATCH):
            part = slice(first, first + _BATCH)
            env = BlockReach2DVector(len(each[part]))
            env.reset(
                seed=_number(config.seed, first),
                options={"scene": [scenes[i] for i in each[part]], **options},
            )
            found = modulator.execute(
                env, legibility=levels[part], seed=first, driver=drivers[who](first),
                replan=who in ("policy", "feedback"),  # the others are off the path by design
            )  # fmt: skip
            assert isinstance(found, list)
            rollouts += found
            progress(done + len(rollouts), total)
        if name == "policy":
            speed = config.rollouts / (time.perf_counter() - started)
        done += config.rollouts
        rows[name] = _figures(rollouts, levels, each, archives, policy.config.limit)
    return {"rows": rows, "step_ms": step_ms, "rollouts_per_second": speed}


def _figures(
    rollouts: list[Rollout], levels: Array, each: Array, archives: list[Archive], limit: float
) -> dict[str, Any]:
    success = np.array([r.success for r in rollouts])
    achieved, planned = (
        np.array([archives[i].label_of(x) for i, x in zip(each, scores, strict=True)])
        for scores in ([r.score for r in rollouts], [float(r.path.score) for r in rollouts])
    )
    own = [each == i for i in range(len(archives))]
    # A rollout with a new plan deviates from the path that it followed at the time.
    deviation = np.array([r.deviation.mean() for r in rollouts])
    lengths = np.array([r.path.length for r in rollouts])
    actions = np.concatenate([r.actions for r in rollouts])
    states = np.concatenate([r.states for r in rollouts])
    low, high = rollouts[0].path.scene.workspace
    return {
        "rollouts": len(rollouts),
        "success": {"mean": success.mean(), "interval": share_interval(success)},
        "reasons": dict(Counter(r.reason for r in rollouts)),
        "spearman": summary(np.array([rank_correlation(levels[o], achieved[o]) for o in own])),
        "error": summary(np.array([np.abs(achieved - levels)[o].mean() for o in own])),
        "error_of_plan": summary(np.array([np.abs(planned - levels)[o].mean() for o in own])),
        "deviation": summary(np.array([(deviation / lengths)[o].mean() for o in own])),
        "steps": float(np.mean([len(r.actions) for r in rollouts])),
        "replans": float(np.mean([len(r.replans) for r in rollouts])),
        "wall_contacts": sum(r.wall_contacts for r in rollouts),
        "states_outside": int(((states < low - 1e-9) | (states > high + 1e-9)).any(-1).sum()),
        "actions_not_finite": int((~np.isfinite(actions)).any(-1).sum()),
        "actions_over_limit": int((np.abs(actions) > limit).any(-1).sum()),
    }


def _number(seed: int, index: int) -> int:
    """A seed for the environments from `index` on, which take consecutive ones."""
    draw = stream_seed("evaluation", seed, 0, "demonstration")
    return int(draw.generate_state(1, np.uint64)[0] >> 2) + index


def step_milliseconds(modulator: Modulator, scene: Scene, repeats: int = 5) -> float:
    """Median time [ms] of one control step of one robot on one core, everything but planning."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        times = []
        for seed in range(repeats + 1):
            env = BlockReach2DVector(1)
            env.reset(seed=seed, options={"scene": scene})
            path = modulator.plan(scene, 0, 0.5, seed=seed)
            start = time.perf_counter()
            found = modulator.execute(env, legibility=0.5, seed=seed, path=path)
            assert isinstance(found, list)
            times.append((time.perf_counter() - start) / len(found[0].actions))
    finally:
        torch.set_num_threads(threads)
    return float(np.median(times[1:]) * 1e3)
