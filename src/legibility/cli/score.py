"""`legibility score`."""

from pathlib import Path
from typing import Annotated, Any

import numpy as np
from tyro.conf import Positional, arg

from ..intent.observer import Observer
from .options import OutputFile, SceneFile, flags, made
from .output import check_file, note, number, show, significant, table, write_report

_LOWER_IS_BETTER = (
    "potential_cost", "length", "time_to_confidence", "earliest_correct_guess", "mean_entropy"
)  # fmt: skip
_MOST_COLUMNS = 6


def score(
    trajectories: Annotated[Positional[Path], arg(metavar="TRAJECTORIES", help_behavior_hint="")],
    scene: SceneFile,
    observer: Annotated[Any, arg(constructor=flags(Observer))],
    target: int = 0,
    beta: float | None = None,
    json: OutputFile = None,
) -> None:
    """Rate trajectories by every metric; no model is needed.

    The CSV file has a header and a row for each point: columns x, y and in 3-D z [m]. A column
    named trajectory, a name or number, tells several apart. A column t or time, which must rise
    within a trajectory, gives the times; without it the points are taken at equal time steps. Other
    columns are left out. No point may lie outside the scene's workspace. The achieved label is read
    off the scene's archive.

    Args:
        trajectories: a CSV file.
        scene: a scene file, .yaml or .json.
        observer: the observer of the score and the labels.
        target: index of the intended goal, from 0.
        beta: rationality [1/m] of Dragan's observer; 20 over the scene's size if not given.
        json: everything as JSON.
    """
    from ..checks import target_index
    from ..intent.metrics import evaluate_trajectory
    from ..motion.archive import build_archive
    from ..scene import Scene
    from .trajectories import read_trajectories

    check_file(json, "JSON file")
    place = Scene.load(scene)
    target_index(target, place.num_goals)
    reader = made(Observer, observer).resolved(place.dim)
    field = reader.field(place)
    curves = read_trajectories(trajectories, place)
    archive = build_archive(place, target, observer=reader)
    ends = np.stack([place.start, place.goals[target]])
    rated: dict[str, dict[str, Any]] = {}
    for name, curve in curves.items():
        metrics = evaluate_trajectory(curve, field, target, reader.alpha, beta)
        start_gap, target_gap = np.linalg.norm(curve[[0, -1]] - ends, axis=-1)
        rated[name] = {
            "achieved_label": archive.label_of(metrics["legibility_score"]),
            **metrics,
            "start_gap": start_gap,
            "target_gap": target_gap,
        }
    config = {"target": target, "observer": reader.to_dict(), "beta": beta}
    rows = [{"name": n, "points": len(curves[n]), **metrics} for n, metrics in rated.items()]
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
        if not metric.endswith("_gap"):
            better = "" if metric == "achieved_label" else better
            shown.add_row(metric, better, *map(significant, cells))
    show(shown)
    for name, metrics in rated.items():
        for verb, end in (("starts", "start"), ("ends", "target")):
            if (gap := metrics[f"{end}_gap"]) > 0.01 * place.diagonal:
                problem = f"{verb} {number(gap)} m from the {end}, so its label means little"
                note(f"trajectory {name} {problem}")
