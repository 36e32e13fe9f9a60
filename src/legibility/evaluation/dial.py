"""The exactness of the dial: asked against achieved label on held-out scenes."""

from functools import partial
from typing import Any

import numpy as np

from ..checks import Array
from ..curves import arc_length, turning
from ..data.configuration import SceneStream
from ..envs import vector_type
from ..modulator import Modulator
from ..parallel import pool, threads
from ..seeds import plan_seeds
from .common import Progress, counter, execute_paths, gather, level_steps, silent, world
from .configuration import DialConfig
from .statistics import rank_correlation, summary

METRICS = {
    "spearman": "Spearman correlation of asked and achieved ℓ",
    "error": "mean absolute error of the achieved ℓ",
    "error_candidates": "the same, with candidates",
    "at_1": "achieved ℓ when asked 1",
    "at_0": "achieved ℓ when asked 0",
    "at_-1": "achieved ℓ when asked −1",
    "length_ratio_at_0": "length over the straight line's when asked 0",
    "inside": "share of curves inside the workspace",
    "drawn_inside": "the same, before curves are brought back to its walls",
    "beyond_archive": "share of paths asked for ±1 beyond the archive's best",
    "turning": "angle that paths asked for ±1 turn through [rad]",
    "wrong_order": "share of adjacent levels whose mean achieved ℓ does not rise",
    "spread": "standard deviation of the achieved ℓ among samples of a level",
    "success": "share of rollouts that reached the target",
    "deviation": "mean distance from the planned curve over its length",
}
"""The metrics of a scene; the last two are of executed motions only, some of plans only."""


def evaluate_dial(
    modulator: Modulator,
    config: DialConfig,
    *,
    workers: int = 1,
    cluster: str | None = None,
    progress: Progress = silent,
) -> dict[str, Any]:
    """Measure the dial of `modulator` on fresh random scenes.

    The metrics do not depend on the number of workers; a scene is measured on one thread.

    Args:
        modulator: the model.
        config: of the evaluation.
        workers: see `pool`.
        cluster: see `pool`.
        progress: called with the number of finished items and of all items.

    Returns:
        `overall`: each of `METRICS` with mean over scenes, 95 % interval, worst and best;
        `scenes`: the same of each scene, its number of goals and the labels achieved at each level;
        `levels`: the asked levels; `env`: the environment of a closed loop.
    """
    kind = vector_type(config.env, modulator.config.dim) if config.closed_loop else None
    source = SceneStream("evaluation", modulator.config.dim, config.goals, config.seed)
    levels = level_steps(config.levels)
    measure = partial(_measure, modulator, source, levels, config)
    advance = counter(progress, config.scenes)
    with pool(workers, cluster) as work:
        advance(0)
        rows = gather(work, measure, range(config.scenes), lambda _: advance(1))
    names = [name for name in METRICS if name in rows[0]]
    return {
        **({"env": world(kind)} if kind else {}),
        "overall": {name: summary(np.array([row[name] for row in rows])) for name in names},
        "levels": levels.tolist(),
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
        kind = vector_type(config.env, scene.dim)
        rollouts = execute_paths(modulator, kind, path, seed, seed)
        score = np.array([r.score for r in rollouts])
        curves = np.stack([r.trajectory(200) for r in rollouts])
        off = [r.deviation.mean() for r in rollouts] / path.length
        metrics = {
            "success": float(np.mean([r.success for r in rollouts])),
            "deviation": float(off.mean()),
        }
    else:
        score, curves = path.score, path.trajectory(200)
        ends = np.abs(asked) == 1
        metrics = {
            "drawn_inside": float(1 - np.mean(path.clipped)),
            "turning": float(turning(curves[ends]).mean()),
        }
        if config.candidates:
            # The modulator chooses by its own archive, as for a user; this one is the judge.
            nearest = modulator.plan(
                scene, 0, levels, seed=seed, num_candidates=config.candidates, **options
            )
            labels = archive.label_of(nearest.score)
            metrics["error_candidates"] = float(np.abs(labels - levels).mean())
    achieved = archive.label_of(score)
    table = achieved.reshape(len(levels), config.samples)
    means = table.mean(axis=1)
    length = arc_length(curves) / np.linalg.norm(scene.goals[0] - scene.start)
    scores = score.reshape(table.shape)
    beyond = np.concatenate([scores[0] < archive.scores.min(), scores[-1] > archive.scores.max()])
    metrics |= {
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
    return {
        "scene": index,
        "goals": scene.num_goals,
        **metrics,
        "achieved": means.tolist(),
        "error_by_level": np.abs(table - levels[:, None]).mean(axis=1).tolist(),
        "drawn_inside_by_level": (1 - path.clipped.reshape(table.shape).mean(axis=1)).tolist(),
    }
