"""`legibility score`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
from tyro.conf import Positional, arg

from ..intent.metrics import DEFAULT_ALPHA, DEFAULT_BETA
from .options import OptionalFloat, OutputFile, SceneFile
from .output import check_file, note, number, show, significant, table, write_report

_BETTER = {
    "legibility_score": "higher",
    "potential_cost": "lower",
    "distance_score": "higher",
    "detachment": "higher",
    "predictability": "higher",
    "length": "lower",
    "legibility": "higher",
    "time_to_confidence": "lower",
    "earliest_correct_guess": "lower",
    "early_intent": "higher",
    "mean_entropy": "lower",
}
_MOST_COLUMNS = 6


def score(
    trajectories: Annotated[Positional[Path], arg(metavar="TRAJECTORIES", help_behavior_hint="")],
    scene: SceneFile,
    target: int = 0,
    sigma: OptionalFloat = None,
    alpha: float = DEFAULT_ALPHA,
    beta: float = DEFAULT_BETA,
    label: str = "anchored",
    json: OutputFile = None,
) -> None:
    """Rate trajectories by every metric; no model is needed.

    The CSV file has a header and a row a point: columns x, y and in 3-D z [m]. A column named
    trajectory, a name or number, tells several apart; with a column t or time, which must rise
    within a trajectory, it is read at equal time steps, else the points are taken to be so. Other
    columns are left out. No point may lie outside the scene's workspace. The achieved label is read
    off the scene's archive.

    Args:
        trajectories: a CSV file.
        scene: a scene file, .yaml or .json.
        target: index of the intended goal, from 0.
        sigma: the observer's σ [m]; 0.15 in 2D and 0.08 in 3D if not given.
        alpha: decay of the score's weight over progress.
        beta: rationality [1/m] of Dragan's observer.
        label: how the archive is labelled, anchored or rank.
        json: everything as JSON.
    """
    from ..checks import target_index
    from ..intent.metrics import evaluate_trajectory
    from ..intent.observer import Observer
    from ..motion.archive import build_archive
    from ..scene import Scene
    from .trajectories import read_trajectories

    check_file(json, "JSON file")
    place = Scene.load(scene)
    goal = place.goals[target_index(target, place.num_goals)]
    observer = Observer(sigma, alpha, label).resolved(place.dim)
    field = observer.field(place)
    curves = read_trajectories(trajectories, place)
    rated = {
        name: {k: float(v) for k, v in evaluate_trajectory(c, field, target, alpha, beta).items()}
        for name, c in curves.items()
    }
    archive = build_archive(place, target, observer=observer)
    for name, figures in rated.items():
        achieved = float(archive.label_of(figures["legibility_score"]))
        gaps = np.linalg.norm(curves[name][[0, -1]] - [place.start, goal], axis=-1)
        rated[name] = {"achieved_label": achieved, **figures,
                       "start_gap": float(gaps[0]), "target_gap": float(gaps[1])}  # fmt: skip

    config = {"target": target, "observer": observer.to_dict(), "beta": beta}
    result = {
        "scene": place.to_dict(),
        "trajectories": [
            {"name": name, "points": len(curves[name]), **figures}
            for name, figures in rated.items()
        ],
    }
    write_report(json, seed=0, config=config, result=result)

    names = [n for n in next(iter(rated.values())) if not n.endswith("_gap")]
    values = {n: np.array([figures[n] for figures in rated.values()]) for n in names}
    summary = len(rated) > _MOST_COLUMNS
    heads = ("mean", "lowest", "highest") if summary else tuple(rated)
    rows = table(
        f"{trajectories} in {scene}, goal {target}", "metric", "better", *heads, text_columns=2
    )
    for name in names:
        row = values[name]
        shown = (row.mean(), row.min(), row.max()) if summary else row
        rows.add_row(name, _better(name), *map(significant, shown))
    show(rows)
    for name, figures in rated.items():
        for end in ("start", "target"):
            if figures[f"{end}_gap"] > 0.01 * place.diagonal:
                side = "starts" if end == "start" else "ends"
                gap = number(figures[f"{end}_gap"])
                note(f"trajectory {name} {side} {gap} m from the {end}, so its label means little")


def _better(metric: str) -> str:
    """Which way a metric is better; those of either observer share a name after the first `_`."""
    return _BETTER.get(metric) or _BETTER.get(metric.partition("_")[2], "")
