"""`legibility score`."""

from pathlib import Path
from typing import Annotated, Any

import numpy as np
from tyro.conf import Positional, arg

from .options import OutputFile, Place
from .output import (
    check_file,
    dial_lines,
    dial_record,
    note,
    number,
    show,
    significant,
    table,
    timed,
    write_report,
)

_LOWER_IS_BETTER = (
    "potential_cost", "length", "time_to_confidence", "earliest_correct_guess", "mean_entropy"
)  # fmt: skip
_MOST_COLUMNS = 6


def score(
    trajectories: Annotated[Positional[Path], arg(metavar="TRAJECTORIES", help_behavior_hint="")],
    place: Place,
    json: OutputFile = None,
) -> None:
    """Rate trajectories by every metric; no model is needed.

    The CSV file has a header and a row for each point: columns x, y and in 3-D z [m]. A column
    named trajectory, a name or number, tells several apart. A column t or time, which must rise
    within a trajectory, gives the times; without it the points are taken at equal time steps. Other
    columns are left out. No point may lie outside the scene's workspace. The achieved label is read
    off the scene's archive. Metrics of a belief come twice, field_… for --observer and dragan_…
    for Dragan's observer.

    Args:
        trajectories: a CSV file.
        place: scene, target and observer of the score and the labels.
        json: everything as JSON.

    Examples:
        legibility score examples/trajectories.csv examples/paper.yaml
        legibility score examples/trajectories.csv examples/paper.yaml --observer paper
    """
    from ..curves import resample
    from ..figures.belief import DRAGAN, describe
    from ..intent.metrics import SCORE_POINTS, evaluate_trajectory
    from ..motion.archive import build_archive
    from .trajectories import read_trajectories

    check_file(json, "JSON file")
    scene, observer = place.situation()
    target, field = place.target, observer.field(scene)
    curves = read_trajectories(trajectories, scene)
    with timed("built the archive"):
        archive = build_archive(scene, target, observer=observer)
    ends = np.stack([scene.start, scene.goals[target]])
    rated: dict[str, dict[str, Any]] = {}
    for name, curve in curves.items():
        metrics = evaluate_trajectory(curve, field, target, observer.alpha)
        start_gap, target_gap = np.linalg.norm(curve[[0, -1]] - ends, axis=-1)
        rated[name] = {
            "achieved_label": archive.label_of(metrics["legibility_score"]),
            **metrics,
            "clearance": scene.clearance_at(resample(curve, 4 * SCORE_POINTS), target).min(),
            "start_gap": start_gap,
            "target_gap": target_gap,
        }
    rows = [{"name": n, "points": len(curves[n]), **metrics} for n, metrics in rated.items()]
    write_report(
        json,
        seed=0,
        config={"target": target, "observer": observer.to_dict()},
        result={"scene": scene.to_dict(), **dial_record(archive), "trajectories": rows},
    )

    summary = len(rated) > _MOST_COLUMNS
    heads = ("mean", "lowest", "highest") if summary else tuple(rated)
    title = f"{trajectories} in {place.scene}, goal {target}"
    shown = table(title, "metric", "better", *heads, text_columns=2)
    for metric in next(iter(rated.values())):
        values = np.array([metrics[metric] for metrics in rated.values()])
        cells = (values.mean(), values.min(), values.max()) if summary else values
        better = "lower" if metric.endswith(_LOWER_IS_BETTER) else "higher"
        if not metric.endswith("_gap"):
            better = "" if metric == "achieved_label" else better
            shown.add_row(metric, better, *map(significant, cells))
    title = describe(scene, observer)
    show(shown, f"score, label and field_…: {title}; dragan_…: {DRAGAN}", *dial_lines(archive))
    for name, metrics in rated.items():
        for verb, end in (("starts", "start"), ("ends", "target")):
            if (gap := metrics[f"{end}_gap"]) > 0.01 * scene.diagonal:
                problem = f"{verb} {number(gap)} m from the {end}, so its label means little"
                note(f"trajectory {name} {problem}")
