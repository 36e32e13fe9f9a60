"""`legibility score`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
from tyro.conf import Positional, arg

from ..intent.metrics import DEFAULT_ALPHA, DEFAULT_BETA
from .options import OptionalFloat, OutputFile, SceneFile
from .output import check_file, note, number, show, significant, table, write_report

_LOWER_IS_BETTER = (
    "potential_cost", "length", "time_to_confidence", "earliest_correct_guess", "mean_entropy"
)  # fmt: skip
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
    target_index(target, place.num_goals)
    observer = Observer(sigma, alpha, label).resolved(place.dim)
    field = observer.field(place)
    curves = read_trajectories(trajectories, place)
    archive = build_archive(place, target, observer=observer)
    rated: dict[str, dict[str, float]] = {}
    for name, curve in curves.items():
        metrics = evaluate_trajectory(curve, field, target, alpha, beta)
        achieved = archive.label_of(metrics["legibility_score"])
        rated[name] = {k: float(v) for k, v in {"achieved_label": achieved, **metrics}.items()}

    ends = np.stack([place.start, place.goals[target]])
    gaps = {
        name: np.linalg.norm(curve[[0, -1]] - ends, axis=-1).tolist()
        for name, curve in curves.items()
    }
    rows = [
        {"name": name, "points": len(curves[name]), **metrics,
         "start_gap": gaps[name][0], "target_gap": gaps[name][1]}
        for name, metrics in rated.items()
    ]  # fmt: skip
    config = {"target": target, "observer": observer.to_dict(), "beta": beta}
    result = {"scene": place.to_dict(), "trajectories": rows}
    write_report(json, seed=0, config=config, result=result)

    summary = len(rated) > _MOST_COLUMNS
    heads = ("mean", "lowest", "highest") if summary else tuple(rated)
    title = f"{trajectories} in {scene}, goal {target}"
    shown = table(title, "metric", "better", *heads, text_columns=2)
    for metric in next(iter(rated.values())):
        values = np.array([metrics[metric] for metrics in rated.values()])
        cells = (values.mean(), values.min(), values.max()) if summary else values
        better = "lower" if metric.endswith(_LOWER_IS_BETTER) else "higher"
        better = "" if metric == "achieved_label" else better
        shown.add_row(metric, better, *map(significant, cells))
    show(shown)
    for name, (start_gap, target_gap) in gaps.items():
        for gap, verb, end in (start_gap, "starts", "start"), (target_gap, "ends", "target"):
            if gap > 0.01 * place.diagonal:
                problem = f"{verb} {number(gap)} m from the {end}, so its label means little"
                note(f"trajectory {name} {problem}")
