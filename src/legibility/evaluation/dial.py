"""How exact the dial is: asked against achieved label on scenes that training never drew."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from ..checks import Array
from ..curves import arc_length, turning
from ..data.scenes import SceneStream
from ..envs import vector_type
from ..modulator import Modulator
from ..motion.path import Path
from ..parallel import pool, threads
from ..scene import Scene
from ..seeds import plan_seeds
from .configuration import DialConfig
from .statistics import rank_correlation, summary

__all__ = ["FIGURES", "evaluate_dial", "worst"]


class Figure(NamedTuple):
    """What a figure means, and the value nearest to which is best (±inf: the higher or lower)."""

    text: str
    best: float | None


FIGURES = {
    "spearman": Figure("Spearman correlation of asked and achieved ℓ", np.inf),
    "error": Figure("mean absolute error of the achieved ℓ", -np.inf),
    "error_candidates": Figure("the same, with candidates", -np.inf),
    "at_1": Figure("achieved ℓ when asked 1", 1.0),
    "at_0": Figure("achieved ℓ when asked 0", 0.0),
    "at_-1": Figure("achieved ℓ when asked −1", -1.0),
    "length_ratio_at_0": Figure("length over the straight line's when asked 0", 1.0),
    "inside": Figure("share of curves inside the workspace", np.inf),
    "drawn_inside": Figure("the same, before curves are brought back to its walls", np.inf),
    "beyond_archive": Figure(
        "share of paths asked for ±1 that are beyond the archive's best", None
    ),
    "turning": Figure("angle that paths asked for ±1 turn through [rad]", None),
    "wrong_order": Figure("share of adjacent levels whose mean achieved ℓ does not rise", -np.inf),
    "spread": Figure("standard deviation of the achieved ℓ among samples of a level", None),
    "success": Figure("share of rollouts that reached the target", np.inf),
    "deviation": Figure("mean distance from the planned curve over its length", -np.inf),
}
"""What is measured of each scene; the last two of executed motions only, some of plans only."""


def worst(name: str, figures: dict[str, float]) -> float | None:
    """The worst scene's value of a figure, None if neither way is better."""
    best = FIGURES[name].best
    if best is None:
        return None
    if np.isinf(best):
        return figures["min" if best > 0 else "max"]
    return max((figures["min"], figures["max"]), key=lambda value: abs(value - best))


def evaluate_dial(
    modulator: Modulator,
    config: DialConfig | None = None,
    *,
    workers: int = 1,
    cluster: str | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> dict[str, Any]:
    """Measure the dial of `modulator` on fresh random scenes.

    The figures are the same for any number of workers; a scene is measured on one thread.

    Args:
        modulator: what is measured.
        config: how.
        workers: processes on this machine.
        cluster: a Dask cluster, see `pool`.
        progress: called with the scenes done and all of them.

    Returns:
        `overall`: each of `FIGURES` with mean over scenes, 95 % interval, worst and best;
        `scenes`: the same of each scene, its number of goals and what was achieved at each level;
        `levels`: the levels asked; `plan_ms`: the time of one plan on one core of this machine,
        before there is other work; `env`, of a closed loop: where.
    """
    config = config or DialConfig()
    kind = vector_type(config.env, modulator.config.dim) if config.closed_loop else None
    source = SceneStream("evaluation", modulator.config.dim, config.goals, config.seed)
    levels = np.round(np.linspace(-1, 1, config.levels), 12)
    measure = partial(_measure, modulator, source, levels, config)
    found: dict[int, dict[str, Any]] = {}
    with pool(workers, cluster) as each:
        plan_ms = plan_milliseconds(
            modulator, source.scene(0), guidance=config.guidance, steps=config.steps
        )
        progress(0, config.scenes)
        for index, row in each(measure, range(config.scenes)):
            found[index] = row
            progress(len(found), config.scenes)
    rows = [found[index] for index in range(config.scenes)]
    names = [name for name in FIGURES if name in rows[0]]
    world = {"env": kind.__name__.removesuffix("Vector")} if kind else {}
    return {
        **world,
        "overall": {name: summary(np.array([row[name] for row in rows])) for name in names},
        "levels": levels.tolist(),
        "plan_ms": plan_ms,
        "scenes": rows,
    }


@threads(1)
def _measure(
    modulator: Modulator, source: SceneStream, levels: Array, config: DialConfig, index: int
) -> dict[str, Any]:
    archive = source.archive(index, modulator.config.observer)
    scene = archive.scene
    options: dict[str, Any] = {"guidance": config.guidance, "steps": config.steps}
    (seed,) = plan_seeds(config.seed, index, 1)
    asked = np.repeat(levels, config.samples)
    path = modulator.plan(scene, 0, asked, seed=seed, **options)
    zero = np.abs(asked) == np.abs(levels).min()
    if config.closed_loop:
        score, curves, figures = _executed(modulator, path, seed, config.env)
    else:
        score, curves = path.score, path.trajectory(200)
        ends = np.abs(asked) == 1
        figures = {
            "drawn_inside": float(1 - np.mean(path.clipped)),
            "turning": float(turning(curves[ends]).mean()),
        }
        if config.candidates:
            # Chosen by an archive of the modulator's own, as a user's are; judged by this one.
            nearest = modulator.plan(
                scene, 0, levels, seed=seed, num_candidates=config.candidates, **options
            )
            found = archive.label_of(nearest.score)
            figures["error_candidates"] = float(np.abs(found - levels).mean())
    achieved = archive.label_of(score)
    table = achieved.reshape(len(levels), config.samples)
    means = table.mean(axis=1)
    length = arc_length(curves) / np.linalg.norm(scene.goals[0] - scene.start)
    scores = score.reshape(table.shape)
    beyond = np.concatenate([scores[0] < archive.scores.min(), scores[-1] > archive.scores.max()])
    figures |= {
        "spearman": rank_correlation(asked, achieved),
        "error": float(np.abs(achieved - asked).mean()),
        "at_-1": float(means[0]),
        "at_0": float(table.ravel()[zero].mean()),
        "at_1": float(means[-1]),
        "beyond_archive": float(beyond.mean()),
        "inside": float(scene.contains(curves).all(-1).mean()),
        "length_ratio_at_0": float(length[zero].mean()),
        "wrong_order": float((np.diff(means) < 1e-9).mean()),
        "spread": float(table.std(axis=1).mean()),
    }
    by_level = {
        "achieved": means,
        "error_by_level": np.abs(table - levels[:, None]).mean(axis=1),
        "drawn_inside_by_level": 1 - path.clipped.reshape(table.shape).mean(axis=1),
    }
    listed = {name: values.tolist() for name, values in by_level.items()}
    return {"scene": index, "goals": scene.num_goals, **figures, **listed}


def _executed(
    modulator: Modulator, path: Path, seed: int, name: str | None
) -> tuple[Array, Array, dict[str, float]]:
    """Scores `(B,)` and curves `(B, T, D)` [m] of the executed paths, and how well they went."""
    kind = vector_type(name, path.scene.dim)
    size, rollouts = len(path.waypoints), []
    for first in range(0, size, kind.at_once):
        part = [path[i] for i in range(first, min(first + kind.at_once, size))]
        env = kind(len(part), max_goals=max(6, path.scene.num_goals))
        env.reset(seed=seed + first, options={"scene": path.scene, "target": path.target})
        rollouts += modulator.execute_many(
            env, legibility=[p.legibility for p in part], seed=seed + first, paths=part
        )
        env.close()
    off = [r.deviation.mean() for r in rollouts] / path.length
    figures = {
        "success": float(np.mean([r.success for r in rollouts])),
        "deviation": float(np.mean(off)),
    }
    score = np.array([r.score for r in rollouts])
    return score, np.stack([r.trajectory(200) for r in rollouts]), figures


@threads(1)
def plan_milliseconds(
    modulator: Modulator, scene: Scene, repeats: int = 200, **options: Any
) -> float:
    """Median time [ms] of one plan on one core, after a warm-up."""
    times = []
    for seed in range(repeats + 5):
        start = time.perf_counter()
        modulator.plan(scene, 0, 0.5, seed=seed, **options)
        times.append(time.perf_counter() - start)
    return float(np.median(times[5:]) * 1e3)
