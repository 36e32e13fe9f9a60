"""How exact the dial is: asked against achieved label on scenes that training never drew."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from ..checks import Array, count
from ..curves import arc_length
from ..dataset import DatasetConfig
from ..modulator import Modulator, Path
from ..motion.archive import Archive
from ..scene import Scene, stream_seed
from .statistics import rank_correlation, summary

__all__ = ["FIGURES", "DialConfig", "evaluate_dial"]

FIGURES = {
    "spearman": "Spearman correlation of asked and achieved ℓ; higher = better",
    "error": "mean absolute error of the achieved ℓ; lower = better",
    "error_candidates": "the same, nearest of the candidates; lower = better",
    "at_-1": "mean achieved ℓ when asked −1; nearer to −1 = better",
    "at_0": "mean achieved ℓ when asked 0; nearer to 0 = better",
    "at_1": "mean achieved ℓ when asked 1; nearer to 1 = better",
    "beyond_archive": "share of the paths asked for ±1 whose score is beyond the archive's extreme",
    "inside": "share of curves that lay inside the workspace as drawn; higher = better",
    "length_ratio_at_0": "length over the straight line's when asked 0; nearer to 1 = better",
    "wrong_order": "share of adjacent levels whose mean achieved ℓ does not rise; lower = better",
    "spread": "standard deviation of the achieved ℓ among samples of one level, mean over levels",
}
"""What is measured of each scene."""


@dataclass(frozen=True)
class DialConfig:
    """What is evaluated.

    Attributes:
        scenes: random scenes of the evaluation stream.
        goals: least and most goals of a scene.
        seed: of the scenes and of the plans.
        levels: levels of ℓ at equal steps from −1 to 1.
        samples: paths drawn for a level.
        candidates: paths drawn for the nearest of them, measured besides; 0 leaves it out.
        guidance: weight of classifier-free guidance; the model's own if not given.
        steps: of the sampler; the model's own if not given.
    """

    scenes: int = 200
    goals: tuple[int, int] = (2, 6)
    seed: int = 0
    levels: int = 21
    samples: int = 8
    candidates: int = 16
    guidance: float | None = None
    steps: int | None = None

    def __post_init__(self) -> None:
        count("levels", self.levels, low=3)
        count("samples", self.samples)
        count("candidates", self.candidates, low=0)


def evaluate_dial(
    modulator: Modulator,
    config: DialConfig | None = None,
    *,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> dict[str, Any]:
    """Measure the dial of `modulator` on fresh random scenes.

    Returns:
        `overall`: each of `FIGURES` with mean over scenes, 95 % interval, worst and best;
        `scenes`: the same of each scene, its number of goals and what was achieved at each level;
        `levels`: the levels asked; `plan_ms`: the time of one plan on one core.
    """
    config = config or DialConfig()
    source = DatasetConfig(
        dim=modulator.config.dim,
        scenes=config.scenes,
        seed=config.seed,
        stream="evaluation",
        goals=config.goals,
        label=modulator.config.label,
        sigma=modulator.config.sigma,
        alpha=modulator.config.alpha,
    )
    levels = np.round(np.linspace(-1, 1, config.levels), 12)
    rows = []
    progress(0, config.scenes)
    for index in range(config.scenes):
        scene, archive = source.scene(index)
        rows.append({"scene": index, "goals": scene.num_goals,
                     **_measure(modulator, scene, archive, levels, index, config)})  # fmt: skip
        progress(index + 1, config.scenes)
    names = [name for name in FIGURES if name in rows[0]]
    return {
        "overall": {name: summary(np.array([row[name] for row in rows])) for name in names},
        "levels": levels.tolist(),
        "plan_ms": plan_milliseconds(modulator, source.scene(0)[0]),
        "scenes": rows,
    }


def _measure(
    modulator: Modulator,
    scene: Scene,
    archive: Archive,
    levels: Array,
    index: int,
    config: DialConfig,
) -> dict[str, Any]:
    options: dict[str, Any] = {"guidance": config.guidance, "steps": config.steps}
    draw = stream_seed("evaluation", config.seed, index).spawn(4)[3]
    seed = int(draw.generate_state(1, np.uint64)[0] >> 2)
    asked = np.repeat(levels, config.samples)
    path = modulator.plan(scene, 0, asked, seed=seed, **options)
    achieved = archive.label_of(path.score)
    table = achieved.reshape(len(levels), config.samples)
    means = table.mean(axis=1)
    zero = np.abs(levels) == np.abs(levels).min()
    length = arc_length(path.trajectory()) / np.linalg.norm(scene.goals[0] - scene.start)
    scores = path.score.reshape(len(levels), -1)
    beyond = np.concatenate([scores[0] < archive.scores.min(), scores[-1] > archive.scores.max()])
    figures = {
        "spearman": rank_correlation(asked, achieved),
        "error": float(np.abs(achieved - asked).mean()),
        "at_-1": float(means[0]),
        "at_0": float(means[zero].mean()),
        "at_1": float(means[-1]),
        "beyond_archive": float(beyond.mean()),
        "inside": float(1 - np.mean(path.clipped)),
        "length_ratio_at_0": float(length.reshape(len(levels), -1)[zero].mean()),
        "wrong_order": float((np.diff(means) < 1e-9).mean()),
        "spread": float(table.std(axis=1).mean()),
    }
    if config.candidates:
        drawn = modulator.plan(
            scene, 0, np.repeat(levels, config.candidates), seed=seed + 1, **options
        )
        figures["error_candidates"] = float(
            nearest_error(archive, drawn, levels, config.candidates).mean()
        )
    return {**figures, "achieved": means.tolist(), "error_by_level":
            np.abs(table - levels[:, None]).mean(axis=1).tolist()}  # fmt: skip


def nearest_error(archive: Archive, drawn: Path, levels: Array, candidates: int) -> Array:
    """Error of the candidate nearest to each level, `(L,)`."""
    achieved = archive.label_of(drawn.score).reshape(len(levels), candidates)
    return np.abs(achieved - levels[:, None]).min(axis=1)


def plan_milliseconds(modulator: Modulator, scene: Scene, repeats: int = 50) -> float:
    """Median time [ms] of one plan on one core, after a warm-up."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        times = []
        for seed in range(repeats + 5):
            start = time.perf_counter()
            modulator.plan(scene, 0, 0.5, seed=seed)
            times.append(time.perf_counter() - start)
    finally:
        torch.set_num_threads(threads)
    return float(np.median(times[5:]) * 1e3)
