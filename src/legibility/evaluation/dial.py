"""The exactness of the dial: asked against achieved label on held-out scenes."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..checks import Array
from ..curves import arc_length, turning
from ..data.configuration import SceneStream
from ..drivers import Driver
from ..envs import vector_type
from ..errors import InvalidInputError
from ..modulator import Modulator
from ..motion.archive import Archive, scene_archive
from ..motion.path import Path
from ..parallel import threads
from ..seeds import plan_seeds
from .common import (
    DRAGAN_LEVELS,
    Progress,
    dragan_rises,
    each_of,
    execute_paths,
    level_steps,
    rounded,
    silent,
    world,
)  # fmt: skip
from .configuration import MODES, DialConfig
from .own_method import OwnMethod, OwnPolicy, Task, load_methods
from .statistics import rank_correlation, spearman_ceiling, summary

METRICS = {
    "spearman": "Spearman correlation of asked and achieved ℓ",
    "error": "mean absolute error of the achieved ℓ",
    "error_candidates": "the same, with candidates",
    "at_1": "achieved ℓ when asked 1",
    "at_0": "achieved ℓ when asked 0",
    "at_-1": "achieved ℓ when asked −1",
    "wrong_order": "share of adjacent levels whose mean achieved ℓ does not rise",
    "adjacent_order": "share of adjacent single draws in the right order",
    "spread": "standard deviation of the achieved ℓ among samples of a level",
    "feasible": "share of curves that touch nothing",
    "replaced": "share of paths for which an archive's curve stands in",
    "waves": "share of curves asked for ±1 that turn 0.5 rad more than the archive's there",
    "turning": "angle that curves asked for ±1 turn through [rad]",
    "length_ratio_at_1": "length over the shortest when asked 1",
    "length_ratio_at_0": "length over the shortest when asked 0",
    "length_ratio_at_-1": "length over the shortest when asked −1",
    "optimum": "gain when asked 1 over the archive's best gain in that length",
    "beyond_archive": "share of curves asked for ±1 beyond the archive's best",
    "dragan_rises": "share of scenes in which Dragan's legibility rises over six levels",
    "dragan_rises_at_3": "the same over −1, 0, 1",
    "success": "share of rollouts that reached the target",
    "deviation": "mean distance from the planned curve over its length",
}
"""The metrics of a scene; the last two are of executed motions only, some of plans only."""

LIMITS = {
    "noise": "error of the achieved ℓ by another seed of the archive",
    "spearman": "greatest Spearman correlation given that noise",
    "waves": "share of the archive's own curves near ±1 that count as waves",
    "below": "nats that the archive spans below ℓ = 0",
    "above": "nats that the archive spans above ℓ = 0",
}
"""What a scene and its archive allow."""

_OPTIONS: dict[str, dict[str, bool]] = dict(
    zip(MODES, ({"refine": False}, {}, {"exact": True}), strict=True)
)
_POINTS = 400  # at which curves are measured
_THREE = level_steps(3)
_WAVE = 0.5
_ROUNDING = 1e-12
_LEAST_GAIN = 0.01  # of the archive's range


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
        `overall`: number of `scenes`, each of `LIMITS` and, by mode, each of `METRICS` with mean
        over scenes, 95 % interval, median, worst and best; `sound` and `degenerate`: the same of
        scenes whose labels mean something and of the others, None without any; `scenes`: the same
        of each scene, its number of goals, and for each mode the labels achieved at each level;
        `levels`: the asked levels; `env`: the environment of a closed loop; `own`: of each method
        of the user, which counts as a mode, its `kind` and the `sha256` of its file.
    """
    kind = vector_type(config.env, modulator.config.dim) if config.closed_loop else None
    levels, own = level_steps(config.levels), load_methods(config.method)
    for name, method in own.items():
        if method.is_policy and kind is None:
            raise InvalidInputError(f"method {name} is a policy, which needs closed_loop")
    measure = partial(_measure, modulator, config.stream(modulator.config.dim), levels, config, own)
    rows = each_of(range(config.scenes), measure, workers, cluster, progress)
    overall = partial(_overall, modes=[*(mode for mode in MODES if mode in config.modes), *own])
    return {
        **({"env": world(kind)} if kind else {}),
        "overall": overall(rows),
        "sound": overall([row for row in rows if not row["degenerate"]]),
        "degenerate": overall([row for row in rows if row["degenerate"]]),
        "levels": levels.tolist(),
        "scenes": rows,
        "own": {name: method.record for name, method in own.items()},
    }


def _overall(rows: Sequence[dict[str, Any]], modes: Sequence[str]) -> dict[str, Any] | None:
    """The summaries of some scenes."""
    if not rows:
        return None

    def summaries(part: str, names: dict[str, str]) -> dict[str, Any]:
        values = {n: [r[part][n] for r in rows if r[part].get(n) is not None] for n in names}
        return {name: summary(np.array(found)) for name, found in values.items() if found}

    return {
        "scenes": len(rows),
        "limits": summaries("limits", LIMITS),
        **{mode: summaries(mode, METRICS) for mode in modes},
    }


@threads(1)
def _measure(
    modulator: Modulator,
    source: SceneStream,
    levels: Array,
    config: DialConfig,
    own: dict[str, OwnMethod],
    index: int,
) -> dict[str, Any]:
    archive = source.archive(index, modulator.config.observer)
    scene, observer = archive.scene, archive.observer
    judge = _Judge.of(archive, levels, config.samples)
    (seed,) = plan_seeds(config.seed, index, 1)
    plan: Any = partial(
        modulator.plan, scene, 0, seed=seed, observer=observer, guidance=config.guidance,
        steps=config.steps,
    )  # fmt: skip
    modes: dict[str, Any] = {}
    for mode in (*config.modes, *own):
        driver = None
        if mode in own:
            path, driver = _planned_by(own[mode], judge, config.seed, index)
        else:
            path = plan(legibility=judge.asked, **_OPTIONS[mode])
        metrics: dict[str, Any] = {"replaced": float(np.mean(path.replaced))}
        if config.closed_loop:
            kind = vector_type(config.env, scene.dim)
            rollouts = execute_paths(modulator, kind, path, seed, seed, driver=driver)
            metrics["success"] = float(np.mean([r.success for r in rollouts]))
            if mode not in own or not own[mode].is_policy:  # which follows no path
                off = [r.deviation.mean() for r in rollouts] / path.length
                metrics["deviation"] = float(off.mean())
            scores = np.array([r.score for r in rollouts])
            curves = np.stack([r.trajectory(_POINTS) for r in rollouts])
        else:
            scores, curves = path.score, path.trajectory(_POINTS)
            if config.candidates and mode == "quick":
                # The modulator chooses by its own archive, as for a user; this one is the judge.
                nearest = plan(legibility=levels, num_candidates=config.candidates)
                labels = archive.label_of(nearest.score)
                metrics["error_candidates"] = float(np.abs(labels - levels).mean())
        modes[mode] = rounded(judge.metrics(scores, curves) | metrics)
    below, above = archive.range
    noise = judge.noise()
    ceiling = spearman_ceiling(np.repeat(levels, config.samples), noise)
    limits = {
        "noise": noise, "spearman": ceiling, "waves": judge.waves, "below": below, "above": above
    }  # fmt: skip
    return {
        "scene": index,
        "goals": scene.num_goals,
        "obstacles": len(scene.obstacles),
        "observer": observer.kind,
        "degenerate": archive.degenerate,
        "blocked": archive.blocked,
        "limits": rounded(limits),
        **modes,
    }


def _planned_by(
    method: OwnMethod, judge: "_Judge", seed: int, index: int
) -> tuple[Path, Callable[[slice], Driver | None]]:
    """The paths of a user's method, and what moves a part of the robots: a policy, or stage 2."""
    archive, asked = judge.archive, judge.asked.tolist()
    tasks = [
        Task(archive.scene, 0, level, own_seed, archive.observer, index)
        for level, own_seed in zip(asked, plan_seeds(seed, index, len(asked)), strict=True)
    ]

    def driver(part: slice) -> Driver | None:
        return OwnPolicy(method, tasks[part]) if method.is_policy else None

    return method.paths(tasks), driver


class _Judge(NamedTuple):
    """What measures the curves of a scene.

    Attributes:
        archive: reads their labels.
        levels: of ℓ that are planned, `(M,)`, rising: the asked ones and those of Dragan's test.
        counted: which of them were asked, `(M,)` bool.
        samples: curves of a level.
        lengths: of the archive's curves [m], `(N,)`.
        turned: mean angle [rad] that the archive's curves near −1 and near 1 turn through.
        waves: share of these curves that turn `_WAVE` more.
    """

    archive: Archive
    levels: Array
    counted: NDArray[np.bool]
    samples: int
    lengths: Array
    turned: tuple[float, float]
    waves: float

    @classmethod
    def of(cls, archive: Archive, levels: Array, samples: int) -> "_Judge":
        """The judge by an archive of `samples` curves at each of `levels`."""
        planned = np.unique(np.concatenate([levels, DRAGAN_LEVELS, _THREE]))
        angles = archive.turning_near(-1), archive.turning_near(1)
        turned = float(angles[0].mean()), float(angles[1].mean())
        waves = np.mean([(a > mean + _WAVE).mean() for a, mean in zip(angles, turned, strict=True)])
        lengths = arc_length(archive.trajectories)
        return cls(
            archive, planned, np.isin(planned, levels), samples, lengths, turned, float(waves)
        )

    @property
    def asked(self) -> Array:
        """ℓ of each curve, `(M S,)`."""
        return np.repeat(self.levels, self.samples)

    def noise(self) -> float:
        """Mean error of labels that are read off an archive of another seed, the modulator's."""
        archive, levels = self.archive, self.levels[self.counted]
        other = scene_archive(archive.scene, archive.target, archive.observer)
        return float(np.abs(archive.label_of(other.score_of(levels)) - levels).mean())

    def metrics(self, scores: Array, curves: Array) -> dict[str, Any]:
        """Those of `METRICS` that scores `(M S,)` and curves `(M S, T, D)` [m] have."""
        archive, scene = self.archive, self.archive.scene
        shape = len(self.levels), self.samples
        score, levels = scores.reshape(shape), self.levels[self.counted]
        achieved = archive.label_of(scores).reshape(shape)
        turned, length = turning(curves).reshape(shape), arc_length(curves).reshape(shape)
        ratio = length.mean(1) / archive.shortest_length
        zero = int(np.flatnonzero(self.levels == 0)[0])
        excess = turned[[0, -1]] - np.array(self.turned)[:, None]
        beyond = [score[0] < archive.scores.min(), score[-1] > archive.scores.max()]
        feasible = scene.feasible(curves, archive.target).reshape(shape)
        optimum = self._optimum(score[-1], length[-1], feasible[-1])
        at_zero = float(achieved[zero].mean())
        score, achieved = score[self.counted], achieved[self.counted]
        means, errors = achieved.mean(1), np.abs(achieved - levels[:, None])
        return {
            "spearman": rank_correlation(np.repeat(levels, self.samples), achieved.ravel()),
            "error": float(errors.mean()),
            "at_1": float(means[-1]),
            "at_0": at_zero,
            "at_-1": float(means[0]),
            "wrong_order": float((np.diff(means) < 1e-9).mean()),
            # Scores, because labels end at ±1.
            "adjacent_order": float((np.diff(score, axis=0) > _ROUNDING).mean()),
            "spread": float(achieved.std(axis=1).mean()),
            "feasible": float(feasible[self.counted].mean()),
            "waves": float((excess > _WAVE).mean()),
            "turning": float(turned[[0, -1]].mean()),
            "length_ratio_at_1": float(ratio[-1]),
            "length_ratio_at_0": float(ratio[zero]),
            "length_ratio_at_-1": float(ratio[0]),
            "optimum": optimum,
            "beyond_archive": float(np.mean(beyond)),
            "dragan_rises": dragan_rises(curves, scene, self.levels, DRAGAN_LEVELS),
            "dragan_rises_at_3": dragan_rises(curves, scene, self.levels, _THREE),
            "achieved": means.tolist(),
            "error_by_level": errors.mean(1).tolist(),
        }

    def _optimum(self, scores: Array, lengths: Array, feasible: np.ndarray) -> float | None:
        """Gain of feasible curves over ℓ = 0, over that of the best elites that are no longer.

        None where no such elite gains anything worth the name.
        """
        if not feasible.any():
            return None
        shorter = self.lengths <= lengths[feasible].reshape(-1, 1) * (1 + 1e-3)
        anchor = self.archive.anchor_score
        best = np.where(shorter, self.archive.scores, anchor).max(1, initial=anchor)
        gain, most = (scores[feasible] - anchor).mean(), (best - anchor).mean()
        return float(gain / most) if most > _LEAST_GAIN * self.archive.range[1] else None
