"""`legibility plan`."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from tyro.conf import arg

from .options import (
    OptionalFloat,
    OptionalInt,
    OptionalText,
    OutputFile,
    SceneFile,
    levels,
    model_of,
)
from .output import (
    check_figure,
    check_file,
    model_record,
    number,
    show,
    significant,
    table,
    write_report,
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
    """Plan motions through a scene, one for each legibility asked.

    Args:
        scene: a file, .yaml or .json, with the keys start, goals and if wanted workspace.
        target: index of the intended goal, from 0.
        legibility: from -1 (most ambiguous) to 1 (most legible); -1:1:9 means nine equal steps.
        model: name of weights that came with the package, or a folder; those of the scene's
            dimension if not given.
        seed: of the paths drawn.
        candidates: paths drawn for each level; the one nearest to what was asked is kept.
        guidance: weight of classifier-free guidance at ±1; the model's own if not given.
        steps: of the sampler; the model's own if not given.
        points: of each trajectory written.
        figure: a picture of the paths, .png, .pdf or .svg.
        json: everything as JSON.
        csv: the trajectories as CSV, the format that `legibility score` reads.
    """
    from ..checks import count, random_seed, target_index
    from ..curves import arc_length
    from ..scene import Scene

    asked = levels(legibility)
    random_seed("seed", seed)
    count("points", points, low=2)
    check_figure(figure)
    check_file(json, "JSON file")
    check_file(csv, "CSV file")
    place = Scene.load(scene)
    target_index(target, place.num_goals)
    model = model_of(model, place)

    from ..modulator import Modulator

    modulator = Modulator.from_pretrained(model)
    options = {"num_candidates": candidates, "guidance": guidance, "steps": steps}
    path = modulator.plan(place, target, asked, seed=seed, **options)
    trajectories = path.trajectory(points)
    straight = np.linalg.norm(place.goals[target] - place.start)
    rows = {
        "legibility": asked,
        "achieved": path.achieved,
        "score": path.score,
        "length_ratio": arc_length(path.trajectory()) / straight,
        "clipped": path.clipped,
        "waypoints": path.waypoints,
        "trajectory": trajectories,
    }
    config = {"target": target, "legibility": asked, **options, "points": points}
    result = {
        "scene": place.to_dict(),
        "target": target,
        "observer": path.observer.to_dict(),
        "paths": [
            dict(zip(rows, values, strict=True)) for values in zip(*rows.values(), strict=True)
        ],
    }
    if csv is not None:
        from .trajectories import write_trajectories

        write_trajectories(csv, [f"{level:g}" for level in asked], trajectories)
    write_report(json, seed=seed, config=config, model=model_record(model), result=result)
    if figure is not None:
        from ..figures.dial import plan_figure

        plan_figure(path, figure)

    figures = table(
        f"{scene}, goal {target}, {model}", "asked ℓ", "achieved ℓ", "score", "length ratio"
    )
    for level, achieved, score, ratio in zip(
        asked, path.achieved, path.score, rows["length_ratio"], strict=True
    ):
        figures.add_row(number(level), number(achieved), significant(score), number(ratio))
    mean = np.abs(path.achieved - asked).mean()
    show(figures, f"mean |achieved − asked| {number(mean)}")
    if path.clipped.any():
        show(f"{path.clipped.sum()} of {len(asked)} paths left the workspace and were brought back")
