"""Whose eyes: how the dial that is turned for one observer looks to every other."""

from functools import partial
from typing import Any

import numpy as np

from ..checks import Array
from ..curves import resample
from ..data.configuration import SceneStream
from ..intent.metrics import SCORE_POINTS, posterior_legibility
from ..intent.observer import Observer
from ..modulator import Modulator
from ..parallel import threads
from ..scene import Scene
from ..seeds import plan_seeds
from .common import (
    DRAGAN_LEVELS,
    Progress,
    dragan_rises,
    each_of,
    level_steps,
    rounded,
    silent,
)  # fmt: skip
from .configuration import EyesConfig
from .statistics import rank_correlation, summary

EYES = {
    "dragan": "Dragan’s: boltzmann, neutral prior",
    "gaussian": "gaussian, neutral prior",
    "paper": "the paper’s: gaussian, uniform prior",
    "viewpoint": "gaussian, neutral prior, seen from behind the target",
    "uniform": "boltzmann, uniform prior",
}
"""The observers, by name."""

_AWAY = 2.0  # of the eyes, in sizes of the scene


def observers(scene: Scene, like: Observer) -> dict[str, Observer]:
    """Each of `EYES` in a scene whose target is goal 0, with the α, detour and label of `like`.

    The viewpoint is far behind the goals on the way that the robot goes, so that progress is what
    these eyes read worst.
    """
    scale: Any = dict(zip(("alpha", "detour", "label"), like.scale, strict=True))
    paper = Observer.paper(scene.dim)
    way = scene.goals[0] - scene.start
    eyes = scene.goals.mean(axis=0) + _AWAY * scene.size * way / np.linalg.norm(way)
    return {
        "dragan": Observer(**scale),
        "gaussian": Observer(kind="gaussian", **scale),
        "paper": Observer(kind="gaussian", prior="uniform", sigma=paper.sigma, **scale),
        "viewpoint": Observer(kind="gaussian", viewpoint=tuple(eyes.tolist()), **scale),
        "uniform": Observer(prior="uniform", **scale),
    }


def evaluate_eyes(
    modulator: Modulator,
    config: EyesConfig,
    *,
    workers: int = 1,
    cluster: str | None = None,
    progress: Progress = silent,
) -> dict[str, Any]:
    """Turn the dial for each of `EYES` and measure what every other observer sees.

    Arguments as of `evaluate_dial`; the metrics do not depend on the number of workers.

    Returns:
        `rows`: by the observer that the dial is turned for, `seen_by`: by observer, the rank
        correlation of ℓ with their `score` and with their `posterior` legibility (HRI 2013), mean
        over scenes with interval; `dragan_rises` as of `evaluate_dial`; `scenes`: the same of each.
    """
    source = config.stream(modulator.config.dim)
    measure = partial(_measure, modulator, source, config)
    scenes = each_of(range(config.scenes), measure, workers, cluster, progress)

    def over(*keys: str) -> dict[str, Any]:
        values = scenes
        for key in keys:
            values = [value[key] for value in values]
        return summary(np.array(values))

    rows = {
        name: {
            "seen_by": {
                other: {part: over(name, "seen_by", other, part) for part in ("score", "posterior")}
                for other in EYES
            },
            "dragan_rises": over(name, "dragan_rises"),
        }
        for name in EYES
    }
    return {"rows": rows, "scenes": scenes}


@threads(1)
def _measure(
    modulator: Modulator, source: SceneStream, config: EyesConfig, index: int
) -> dict[str, Any]:
    scene = source.scene(index)
    known = observers(scene, modulator.config.observer)
    (seed,) = plan_seeds(config.seed, index, 1)
    levels = level_steps(config.levels)
    planned = np.unique(np.concatenate([levels, DRAGAN_LEVELS]))
    asked = np.repeat(planned, config.samples)
    counted = np.isin(asked, levels)
    rows = {}
    for name, observer in known.items():
        path = modulator.plan(scene, 0, asked, seed=seed, observer=observer, exact=config.exact)
        curves = resample(path.trajectory(4 * SCORE_POINTS), SCORE_POINTS)
        seen_by = {
            other: {
                part: rank_correlation(asked[counted], values[counted])
                for part, values in _legibility(eyes, curves, scene).items()
            }
            for other, eyes in known.items()
        }
        rises = dragan_rises(curves, scene, planned, DRAGAN_LEVELS)
        rows[name] = {"seen_by": seen_by, "dragan_rises": rises}
    return {"scene": index, **rounded(rows)}


def _legibility(observer: Observer, curves: Array, scene: Scene) -> dict[str, Array]:
    """What an observer sees of curves `(B, T, D)` [m] at equal arc length, `(B,)` each."""
    posterior = observer.field(scene).posterior(curves)
    return {
        "score": observer.score(curves, scene, 0),
        "posterior": posterior_legibility(posterior, 0),
    }
