"""`legibility execute`."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from tyro.conf import arg

from .options import OptionalText, OutputFile, SceneFile, levels, model_of
from .output import (
    check_figure,
    check_file,
    model_record,
    number,
    progress_bar,
    show,
    table,
    write_report,
)


def execute(
    scene: SceneFile,
    target: int = 0,
    legibility: Annotated[tuple[str, ...], arg(metavar="LEVEL ...")] = ("-1", "0", "1"),
    model: OptionalText = None,
    env: OptionalText = None,
    seed: int = 0,
    candidates: int = 1,
    noise: float = 0.0,
    push: float = 0.0,
    shift: float = 0.0,
    replan: bool = True,
    figure: OutputFile = None,
    spectrum: OutputFile = None,
    video: OutputFile = None,
    json: OutputFile = None,
    csv: OutputFile = None,
) -> None:
    """Plan motions and execute them, closed loop, in an environment.

    Args:
        scene: a file, .yaml or .json, with the keys start and goals.
        target: index of the intended goal, from 0.
        legibility: from -1 (most ambiguous) to 1 (most legible); -1:1:9 means nine equal steps.
        model: name of weights that came with the package, or a folder; those of the scene's
            dimension if not given.
        env: 2d, panda (MuJoCo) or pandagym; 2d or panda, by the scene, if not given. MuJoCo draws
            the pictures of either arm.
        seed: of the paths and actions drawn and of the environment's hidden properties.
        candidates: paths drawn for each level; the one nearest to what was asked is kept.
        noise: standard deviation of each step's displacement [m].
        push: the robot is pushed by so much [m] on its way.
        shift: the target is moved by so much [m] on the way.
        replan: plan again where a push or a shift has taken the robot off its path.
        figure: motions side by side and the belief under each, .png, .pdf or .svg.
        spectrum: all motions in one picture and their cost against ℓ, .png, .pdf or .svg.
        video: the motions side by side as a film, .gif or, with ffmpeg, .mp4.
        json: everything as JSON.
        csv: the executed trajectories, at equal arc length, as CSV that `legibility score` reads.
    """
    from ..checks import random_seed, target_index
    from ..envs import vector_type
    from ..errors import InvalidInputError
    from ..evaluation.statistics import clear_step
    from ..rollout import Rollout
    from ..scene import Scene

    asked = levels(legibility)
    random_seed("seed", seed)
    check_figure(figure)
    check_figure(spectrum)
    if spectrum is not None and len(np.unique(asked)) < len(asked):
        raise InvalidInputError("a spectrum shows each level once, legibility names one twice")
    check_file(json, "JSON file")
    check_file(csv, "CSV file")
    if figure is not None or video is not None:
        from ..figures.film import check_film, check_number

        check_number(len(asked))
        if video is not None:
            check_film(video)
            check_file(video, "film")
    place = Scene.load(scene)
    target_index(target, place.num_goals)
    model = model_of(model, place)
    kind = vector_type(env, place.dim)
    if place.dim == 3 and any((figure, spectrum, video)):
        from ..envs.panda_model import import_mujoco

        import_mujoco()  # it draws the arm of whichever simulator

    from ..modulator import Modulator

    modulator = Modulator.from_pretrained(model)
    robots = kind(len(asked), max_goals=max(6, place.num_goals))
    options = {"noise": noise, "push": push, "shift": shift}
    # The same hidden properties and disturbance in each, so that ℓ alone makes the difference.
    robots.reset(seed=[seed] * len(asked), options={"scene": place, "target": target, **options})
    rollouts = modulator.execute_many(
        robots, legibility=asked, seed=seed, replan=replan, num_candidates=candidates
    )
    robots.close()

    def clear_after(rollout: Rollout) -> float | None:
        step = clear_step(rollout.posterior, rollout.path.target)
        return None if step is None else round(rollout.step_seconds * step, 9)

    rows = [
        {
            "legibility": rollout.legibility,
            "achieved": rollout.achieved,
            "achieved_by_plan": float(rollout.path.achieved),
            "score": rollout.score,
            "success": rollout.success,
            "reason": rollout.reason,
            "replans": rollout.replans,
            "deviation": rollout.deviation.mean(),
            "wall_contacts": rollout.wall_contacts,
            "counts": rollout.counts,
            "clear_after": clear_after(rollout),
            "waypoints": rollout.path.waypoints,
            "states": rollout.states,
            "actions": rollout.actions,
            "posterior": rollout.posterior,
        }
        for rollout in rollouts
    ]
    if csv is not None:
        from .trajectories import write_trajectories

        names = [f"{level:g}" for level in asked]
        write_trajectories(csv, names, np.stack([r.trajectory() for r in rollouts]))
    config = {
        "env": kind.__name__.removesuffix("Vector"),
        "target": target,
        "legibility": asked,
        "replan": replan,
        "candidates": candidates,
        **options,
    }
    first = rollouts[0].path
    result = {
        "scene": place.to_dict(),
        "target": target,
        "observer": first.observer.to_dict(),
        "rollouts": rows,
    }
    write_report(json, seed=seed, config=config, model=model_record(model), result=result)
    if figure is not None:
        from ..figures.film import execution_figure

        execution_figure(rollouts, figure)
    if spectrum is not None:
        from ..evaluation.spectrum import Spectrum
        from ..evaluation.table1 import SCENES
        from ..figures.spectrum import spectrum_figure

        spectrum_figure([Spectrum.of(rollouts, SCENES[place.dim].spacing)], spectrum)
    if video is not None:
        from ..figures.film import execution_film

        with progress_bar("frames") as progress:
            execution_film(rollouts, video, progress=progress)

    figures = table(
        f"{scene}, goal {target}, {model}",
        "asked ℓ", "planned ℓ", "executed ℓ", "clear after [s]", "steps", "deviation [mm]", "ended",
    )  # fmt: skip
    for row in rows:
        figures.add_row(
            number(row["legibility"]), number(row["achieved_by_plan"]), number(row["achieved"]),
            "never" if row["clear_after"] is None else number(row["clear_after"], 2),
            str(len(row["actions"])), number(1e3 * row["deviation"], 1), row["reason"],
        )  # fmt: skip
    error = float(np.mean([abs(row["achieved"] - row["legibility"]) for row in rows]))
    show(figures, f"mean |executed − asked| {number(error)}")
