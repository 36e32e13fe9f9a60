"""`legibility plan`."""

import numpy as np

from ..checks import count
from ..data.recordings import write_trajectories
from . import output
from .options import Motions, OptionalFloat, OptionalInt, OutputFile, Timed


def plan(
    motions: Motions,
    timed: Timed,
    guidance: OptionalFloat = None,
    steps: OptionalInt = None,
    points: int = 100,
    figure: OutputFile = None,
    json: OutputFile = None,
    csv: OutputFile = None,
) -> None:
    """Plan motions through a scene, one for each level of legibility.

    Args:
        motions: motions to plan.
        timed: motions for a robot.
        guidance: weight of classifier-free guidance at ±1; if not given, the model's.
        steps: of the sampler; if not given, the model's.
        points: of each trajectory written.
        figure: the paths drawn, .png, .pdf or .svg.
        json: everything as JSON.
        csv: the trajectories as CSV, the format that `legibility score` reads.

    Examples:
        legibility plan examples/paper.yaml --legibility -1:1:9 --figure out/plan.png
        legibility plan examples/panda.yaml --arm panda --rate 1000 --out out/motion.csv
    """
    count("points", points, low=2)
    output.check_figure(figure)
    output.check_file(json, "JSON file")
    output.check_file(csv, "CSV file")
    scene, observer, asked, model = motions.read()
    target = motions.target
    files = timed.files(asked, scene.dim, (figure, json, csv))

    from ..figures.belief import describe
    from ..modulator import Modulator

    options = {**motions.options(observer), "guidance": guidance, "steps": steps}
    modulator = Modulator.from_pretrained(model)
    with output.timed(f"planned {len(asked)} paths" + ", and timed them" * bool(files)):
        path = modulator.plan(scene, target, asked, seed=motions.seed, arm=timed.body(), **options)
        moves = timed.motions(path) if files else []
    archive = path.archive
    columns = {
        "legibility": asked,
        "achieved": path.achieved,
        "score": path.score,
        "detour": path.length / archive.shortest_length,
        "clearance": path.clearance,
        "feasible": path.feasible,
        "replaced": path.replaced,
        "waypoints": path.waypoints,
        "trajectory": path.trajectory(points),
    }
    if moves:
        columns["duration"] = [motion.duration for motion in moves]
        columns["score_over_time"] = [motion.score for motion in moves]
        columns["time_to_confidence"] = [motion.time_to_confidence for motion in moves]
    rows = [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]
    if csv is not None:
        write_trajectories(csv, [f"{level:g}" for level in asked], columns["trajectory"])
    output.write_report(
        json,
        seed=motions.seed,
        config={
            "target": target, "legibility": asked, **options, "observer": observer.to_dict(),
            "points": points,
            **(vars(timed) if moves else {}),
        },
        model=output.model_record(model, "path"),
        result={
            "scene": scene.to_dict(),
            "target": target,
            "observer": path.observer.to_dict(),
            **output.dial_record(archive),
            "paths": rows,
        },
    )  # fmt: skip
    for motion, file in zip(moves, files, strict=True):
        motion.save(file)
    if moves and timed.profile is not None:
        from ..figures.motion import motion_figure

        motion_figure(moves, timed.profile)
    if figure is not None:
        from ..figures.paper import plan_figure

        plan_figure(path, figure)

    solid = bool(scene.obstacles or scene.goal_radius)
    table = output.table(
        f"{motions.scene}, goal {target}, {model}, for {describe(scene, observer)}",
        *("asked ℓ", "achieved ℓ", "score", "detour", *["clearance [m]", "feasible"] * solid),
        *["duration [s]", "time to confidence [s]"] * bool(moves),
    )
    for row in rows:
        cells = [output.number(row[name]) for name in ("legibility", "achieved", "detour")]
        cells.insert(2, output.significant(row["score"]))
        cells += [output.number(row["clearance"]), "yes" if row["feasible"] else "no"] * solid
        if moves:
            seconds = row["time_to_confidence"]
            cells += [
                output.number(row["duration"], 2),
                output.number(seconds, 2) if np.isfinite(seconds) else "never",
            ]
        table.add_row(*cells)
    error = np.abs(path.achieved - asked).mean()
    output.show(
        table, f"mean |achieved − asked| {output.number(error)}", *output.dial_lines(archive)
    )
    if path.replaced.any():
        problem = "paths are curves of the archive, which came nearer than what the network drew"
        output.show(f"{path.replaced.sum()} of {len(asked)} {problem}")
    if not path.feasible.all():
        problem = "paths are not feasible: they come too near to something"
        output.show(f"{(~path.feasible).sum()} of {len(asked)} {problem}")
