"""Timed motions: do they keep their limits, how much time do they waste, and what do they show?

Limits are checked on positions alone, by finite differences at 1 kHz, as a controller sees them.
"""

import time
from functools import partial
from typing import Any

import numpy as np

from ..checks import Array
from ..errors import InvalidInputError
from ..modulator import Modulator
from ..motion.path import Path
from ..motion.timed import Motion, mover
from ..parallel import threads
from ..robots.arm import Arm
from ..robots.limits import Limits
from ..seeds import plan_seeds
from .common import Progress, each_of, level_steps, rounded, silent
from .configuration import TimingConfig
from .statistics import summary

METRICS = {
    "velocity": "greatest velocity over its limit",
    "acceleration": "greatest acceleration over its limit",
    "jerk": "greatest jerk over its limit",
    "ends": "velocity at either end over its limit",
    "deviation": "greatest distance from the planned curve [mm]",
    "duration": "duration [s]",
    "over_bound": "duration over that without a bound on jerk",
    "milliseconds": "time to make it [ms]",
}
"""The metrics of a motion. The greatest are those of any joint, or of the point."""

_RATE = 1000.0
_PLACES = 50  # of a motion at which an arm's joints are compared with the curve


def evaluate_timing(
    modulator: Modulator,
    config: TimingConfig,
    *,
    workers: int = 1,
    cluster: str | None = None,
    progress: Progress = silent,
) -> dict[str, Any]:
    """Time motions of all levels in held-out scenes.

    Arguments as of `evaluate_dial`.

    Returns:
        `metrics`: of each of `METRICS` the `median`, the 99th `percentile` and the `greatest` of
        all motions; `error` of ℓ of the timed motions, read off their joints, over scenes, beside
        that of the plans (`planned`); `motions`, their number; `refused`: how many were not timed,
        because the arm cannot reach a point or touches something, and `why`, one message of each
        kind; `moves`: a name of what moves.
    """
    limits, arm = mover(config.limits, config.arm)
    measure = partial(_measure, modulator, config, limits, arm)
    found = each_of(list(range(config.scenes)), measure, workers, cluster, progress)
    rows = [row for scene in found for row in scene["rows"]]
    messages = [message for scene in found for message in scene["refused"]]
    if not rows:
        raise InvalidInputError(f"no motion could be timed: {messages[0]}")
    values = {name: np.array([row[name] for row in rows]) for name in METRICS}
    timed = [scene["rows"] for scene in found if scene["rows"]]
    errors = {
        name: summary(np.array([float(np.mean([r[name] for r in scene])) for scene in timed]))
        for name in ("error", "planned")
    }
    return rounded({
        "metrics": {
            name: {
                "median": float(np.median(v)),
                "percentile": float(np.percentile(v, 99)),
                "greatest": float(v.max()),
            }
            for name, v in values.items()
        },
        **errors,
        "motions": len(rows),
        "refused": len(messages),
        "why": sorted({_kind(message): message for message in messages}.values()),
        "moves": "a point" if arm is None else arm.name,
    })  # fmt: skip


def _kind(message: str) -> str:
    """A message without its numbers."""
    return "".join(c for c in message if c.isalpha() or c == " ")


@threads(1)
def _measure(
    modulator: Modulator, config: TimingConfig, limits: Limits, arm: Arm | None, index: int
) -> dict[str, list[Any]]:
    """The metrics of each motion that is timed in a scene, and why others are not."""
    judge = config.stream(modulator.config.dim).archive(index, modulator.config.observer)
    (seed,) = plan_seeds(config.seed, index, 1)
    levels = level_steps(config.levels)
    paths = modulator.plan(judge.scene, 0, levels, seed=seed, observer=judge.observer)
    paths[0].timed("point")  # loads what it needs
    rows, refused = [], []
    for number, asked in enumerate(levels):
        path = paths[number]
        try:
            started = time.perf_counter()
            motion = path.timed(limits, _RATE, arm=arm)
            seconds = time.perf_counter() - started
        except InvalidInputError as problem:
            refused.append(str(problem))
            continue
        curve, deviation = _followed(path, motion)
        scores = judge.observer.score(
            np.stack([curve, path.trajectory(len(curve))]), judge.scene, 0
        )
        error, planned = np.abs(judge.label_of(scores) - asked).tolist()
        rows.append({
            **_shares(motion), "deviation": 1e3 * deviation, "duration": motion.duration,
            "over_bound": motion.duration / motion.bound, "milliseconds": 1e3 * seconds,
            "error": error, "planned": planned,
        })  # fmt: skip
    return {"rows": rows, "refused": refused}


def _shares(motion: Motion) -> dict[str, float]:
    """By finite differences, with rest before and after, over the limits."""
    limits = motion.limits
    assert limits is not None
    positions = motion.joint_positions if limits.joints else motion.positions
    rest = np.repeat(positions[[0, -1]], 4, axis=0)
    whole = np.concatenate([rest[:4], positions, rest[4:]])
    bounds = {
        "velocity": limits.velocity_at(whole[:-1]),
        "acceleration": limits.acceleration,
        "jerk": limits.jerk,
    }
    found = {}
    for order, (name, bound) in enumerate(bounds.items(), 1):
        change = np.diff(whole, n=order, axis=0) * _RATE**order
        size = np.abs(change) if limits.joints else np.linalg.norm(change, axis=-1)
        found[name] = float((size / bound).max())
        if name == "velocity":
            found["ends"] = float((size / bound)[[4, -5]].max())
    return found


def _followed(path: Path, motion: Motion) -> tuple[Array, float]:
    """The curve that the motion follows, `(P, D)` [m], and its distance from the plan [m]."""
    if motion.arm is None:
        return motion.positions, 0.0
    chosen = np.linspace(0, len(motion.times) - 1, _PLACES).round().astype(int)
    kinematics = motion.arm.kinematics()
    curve = np.array([kinematics.grasp_point(angles) for angles in motion.joint_positions])
    planned = path.trajectory(20 * len(curve))
    apart = [np.linalg.norm(planned - place, axis=-1).min() for place in curve[chosen]]
    return curve, float(np.max(apart))
