"""Planned motions by other people's definitions: how legible under a ceiling on cost or clearance.

Dragan's legibility at several β, confidence, detachment and L_d are read off the motions with
ℓ = 1. Who bounds the cost of a motion (Dragan & Srinivasa, RSS 2013), or wants it to keep clear,
asks for the most legible one within that bound: of each method the best of its levels.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from ..baselines.planners import archive_path, search_archive
from ..checks import Array
from ..curves import arc_length, resample, spaced
from ..errors import InvalidInputError
from ..intent.metrics import (
    SCORE_POINTS,
    detachment,
    distance_score,
    dragan_posterior,
    posterior_legibility,
    time_to_confidence,
)
from ..modulator import Modulator
from ..motion.archive import Archive, build_archive, scene_archive
from ..motion.bezier import bezier_trajectories
from ..parallel import threads
from ..scene import Scene
from ..seeds import plan_seeds
from .common import Progress, each_of, rounded, silent
from .comparison import BETAS
from .configuration import ExternalConfig
from .statistics import summary

METHODS = {
    "shortest": "the shortest motion",
    "search": "search among 1,024 curves",
    "archive": "an archive's nearest trajectory",
    "network": "the modulator’s network alone",
    "modulator": "Legibility Modulator",
    "exact": "Legibility Modulator, exact",
}
"""The planners."""

YOURS = "yours"
"""The method of trajectories that were given."""

METRICS = {
    **{f"dragan_{beta}": f"Dragan’s, β = {beta}" for beta in BETAS},
    "confidence": "time to confidence",
    "detachment": "detachment",
    "distance_score": "L_d over size",
    "length": "length over the shortest",
    "clearance": "clearance",
    "feasible": "touch nothing",
}
"""The metrics of a motion. The legibility that Dragan's observer sees (HRI 2013), β over the
scene's size; the share of the motion after which that observer (β = 20) is confident; detachment
and L_d, over the scene's size, of points 2 % of it apart; the least clearance from obstacles, other
goals and walls over the scene's size, but for the first and the last tenth of the motion, where
start and goal decide; and whether it is feasible, ends included."""

LENGTHS = (1.02, 1.1, 1.25, 1.5, 2.0)
"""Ceilings on the length over the shortest."""

CLEARANCES = (0.0, 0.01, 0.02, 0.05)
"""Least clearances over the scene's size."""

_BETA = 20
_CURVES = 1024
_SPACING = 0.02
_PARTS = 25


def evaluate_external(
    modulator: Modulator,
    config: ExternalConfig,
    *,
    given: tuple[Scene, int, dict[str, Array]] | None = None,
    workers: int = 1,
    cluster: str | None = None,
    progress: Progress = silent,
) -> dict[str, Any]:
    """Rate motions of all planners by other people's definitions.

    Arguments as of `evaluate_dial`, and `given`: a scene, a target and trajectories `(T, D)` [m] to
    it by name, in place of random scenes; they are a method of their own.

    Returns:
        `methods`: of each of `METHODS`, and `yours`, each of `METRICS` of the motions with ℓ = 1
        (of yours, of all) as a summary over scenes, and the highest `legibility` (β = 20) of its
        feasible motions under `ceiling` that are no longer than each of `LENGTHS`, or under `clear`
        that keep each of `CLEARANCES`. The `share` is that of scenes in which there is such a
        motion; in the others the shortest motion counts, and where that does not keep clear
        either, the scene is left out for all. `scene` and `target`, if given.
    """
    if given is None:
        items: list[Any] = list(range(config.scenes))
    elif given[0].dim != modulator.config.dim:
        raise InvalidInputError(
            f"the model {modulator.name} plans in {modulator.config.dim}D, the scene is "
            f"{given[0].dim}D"
        )
    else:
        items = [given]
    measure = partial(_measure, modulator, config)
    found = each_of(items, measure, workers, cluster, progress)
    methods, shortest = {}, [scene["shortest"]["all"][0] for scene in found]
    for name in found[0]:
        rows = [scene[name] for scene in found]
        methods[name] = {
            **{m: summary(np.array([row["legible"][m] for row in rows])) for m in METRICS},
            "ceiling": [_best(rows, shortest, lambda m, c=c: m["length"] <= c) for c in LENGTHS],
            "clear": [
                _best(rows, shortest, lambda m, c=c: m["clearance"] >= c) for c in CLEARANCES
            ],
        }
    place = {} if given is None else {"scene": given[0].to_dict(), "target": given[1]}
    return rounded({"methods": methods, **place})


def _best(
    rows: list[dict[str, Any]],
    shortest: list[dict[str, float]],
    fits: Callable[[dict[str, float]], bool],
) -> dict[str, Any]:
    """The highest legibility of each scene's feasible motions that fit, over scenes."""
    legibility, own = f"dragan_{_BETA}", []
    best = []
    for row, line in zip(rows, shortest, strict=True):
        fitting = [m[legibility] for m in row["all"] if m["feasible"] and fits(m)]
        own.append(bool(fitting))
        if fits(line):
            best.append(max([*fitting, line[legibility]]))
    return {"share": float(np.mean(own)), "legibility": summary(np.array(best)) if best else None}


@threads(1)
def _measure(
    modulator: Modulator, config: ExternalConfig, item: int | tuple[Scene, int, dict[str, Array]]
) -> dict[str, dict[str, Any]]:
    """Of each method the metrics of its motions with ℓ = 1, and of all."""
    own: dict[str, Array] = {}
    if isinstance(item, int):
        source = config.stream(modulator.config.dim)
        judge, seed = source.archive(item, modulator.config.observer), item
    else:
        scene, target, own = item
        judge, seed = scene_archive(scene, target, modulator.config.observer), 0
    (seed,) = plan_seeds(config.seed, seed, 1)
    levels = np.linspace(0, 1, config.levels)
    curves = {name: _curves(modulator, name, judge, levels, seed) for name in METHODS}
    found = {}
    for name, motions in (curves | ({YOURS: list(own.values())} if own else {})).items():
        rated = [rate(curve, judge) for curve in motions]
        legible = rated if name == YOURS else rated[-1:]
        means = {metric: float(np.mean([row[metric] for row in legible])) for metric in METRICS}
        found[name] = {"legible": means, "all": rated}
    return found


def _curves(
    modulator: Modulator, name: str, judge: Archive, levels: Array, seed: int
) -> list[Array]:
    """The motions of a method at each level."""
    scene, target, observer = judge.scene, judge.target, judge.observer
    if name in ("network", "modulator", "exact"):
        paths = modulator.plan(
            scene, target, levels, seed=seed, observer=observer,
            refine=name != "network", exact=name == "exact",
        )  # fmt: skip
        return list(paths.trajectory())
    if name == "shortest":
        return [bezier_trajectories(judge.anchor[None], 10 * _PARTS + 1)[0]]
    archive = (
        search_archive(scene, target, observer, _CURVES, seed) if name == "search"
        else build_archive(scene, target, observer=observer, seed=seed)
    )  # fmt: skip
    return [archive_path(archive, level).trajectory() for level in levels.tolist()]


def rate(curve: Array, judge: Archive) -> dict[str, float]:
    """`METRICS` of one motion `(T, D)` [m] in the scene of `judge`."""
    scene, target = judge.scene, judge.target
    steady = resample(curve, SCORE_POINTS)
    points = spaced(curve, _SPACING * scene.size)
    beliefs = {beta: dragan_posterior(steady, scene.goals, beta / scene.size) for beta in BETAS}
    confident = float(time_to_confidence(beliefs[_BETA], target))
    dense = resample(curve, 10 * _PARTS + 1)[_PARTS:-_PARTS]
    clearance = scene.clearance_at(dense, target).min()
    return {
        **{f"dragan_{b}": float(posterior_legibility(p, target)) for b, p in beliefs.items()},
        "confidence": min(confident, 1.0),
        "detachment": float(detachment(points, scene.goals, target)),
        "distance_score": float(distance_score(points, scene.goals, target)) / scene.size,
        "length": float(arc_length(curve)) / judge.shortest_length,
        "clearance": float(clearance) / scene.size,
        "feasible": float(scene.feasible(resample(curve, 10 * _PARTS + 1), target)),
    }
