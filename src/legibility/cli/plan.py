"""`legibility plan`."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from tyro.conf import arg

from . import output
from .options import (
    OptionalFloat,
    OptionalInt,
    OptionalText,
    OutputFile,
    SceneFile,
    levels,
    model_of,
)


def plan(
    scene: SceneFile,
    target: int = 0,
    legibility: Annotated[tuple[str, ...], arg(metavar="LEVEL ...")] = ("-1", "0", "1"),
    model: OptionalText = None,
    seed: int = 0,
    candidates: int = 1,
    guidance: OptionalFloat = None,
    steps: OptionalInt = None,
    points: int = 100,
    figure: OutputFile = None,
    json: OutputFile = None,
    csv: OutputFile = None,
) -> None:
    """Plan motions through a scene, one for each level of legibility.

    Args:
        scene: a file, .yaml or .json, with the keys start, goals and if wanted workspace.
        target: index of the intended goal, from 0.
        legibility: from -1 (most ambiguous) to 1 (most legible); -1:1:9 means nine equal steps.
        model: name of weights that came with the package, or a folder; those of the scene's
            dimension if not given.
        seed: of the paths drawn.
        candidates: paths drawn for each level; the one nearest to the level is kept.
        guidance: weight of classifier-free guidance at ±1; the model's own if not given.
        steps: of the sampler; the model's own if not given.
        points: of each trajectory written.
        figure: the paths drawn, .png, .pdf or .svg.
        json: everything as JSON.
        csv: the trajectories as CSV, the format that `legibility score` reads.
    """
    from ..checks import count, random_seed, target_index
    from ..scene import Scene

    asked = levels(legibility)
    random_seed("seed", seed)
    count("points", points, low=2)
    output.check_figure(figure)
    output.check_file(json, "JSON file")
    output.check_file(csv, "CSV file")
    place = Scene.load(scene)
    target_index(target, place.num_goals)
    model = model_of(model, place)

    from ..modulator import Modulator

    options = {"num_candidates": candidates, "guidance": guidance, "steps": steps}
    path = Modulator.from_pretrained(model).plan(place, target, asked, seed=seed, **options)
    columns = {
        "legibility": asked,
        "achieved": path.achieved,
        "score": path.score,
        "length_ratio": path.length / np.linalg.norm(place.goals[target] - place.start),
        "clipped": path.clipped,
        "waypoints": path.waypoints,
        "trajectory": path.trajectory(points),
    }
    rows = [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]
    if csv is not None:
        from .trajectories import write_trajectories

        write_trajectories(csv, [f"{level:g}" for level in asked], columns["trajectory"])
    output.write_report(
        json,
        seed=seed,
        config={"target": target, "legibility": asked, **options, "points": points},
        model=output.model_record(model),
        result={
            "scene": place.to_dict(),
            "target": target,
            "observer": path.observer.to_dict(),
            "paths": rows,
        },
    )
    if figure is not None:
        from ..figures.plan import plan_figure

        plan_figure(path, figure)

    table = output.table(
        f"{scene}, goal {target}, {model}", "asked ℓ", "achieved ℓ", "score", "length ratio"
    )
    for row in rows:
        table.add_row(
            output.number(row["legibility"]), output.number(row["achieved"]),
            output.significant(row["score"]), output.number(row["length_ratio"]),
        )  # fmt: skip
    error = np.abs(path.achieved - asked).mean()
    output.show(table, f"mean |achieved − asked| {output.number(error)}")
    if path.clipped.any():
        note = "paths left the workspace and were clipped to it"
        output.show(f"{path.clipped.sum()} of {len(asked)} {note}")
