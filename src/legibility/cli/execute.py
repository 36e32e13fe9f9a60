"""`legibility execute`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
from tyro.conf import arg

from ..errors import InvalidInputError
from . import output
from .options import OptionalText, OutputFile, SceneFile, levels, model_of

if TYPE_CHECKING:
    from ..rollout import Rollout

Pictures = tuple[Path | None, Path | None, Path | None]
"""Files of the figure, the spectrum and the film."""


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
            either arm.
        seed: of the paths and actions drawn and of the environment's hidden properties.
        candidates: paths drawn for each level; the one nearest to the level is kept.
        noise: standard deviation of each step's displacement [m].
        push: length of a push on the way [m].
        shift: distance that the target moves on the way [m].
        replan: replan after a push or a shift has taken the robot off its path.
        figure: motions side by side and the belief under each, .png, .pdf or .svg.
        spectrum: all motions in one figure and their cost against ℓ, .png, .pdf or .svg.
        video: the motions side by side as a film, .gif or, with ffmpeg, .mp4.
        json: everything as JSON.
        csv: the executed trajectories, at equal arc length, as CSV that `legibility score` reads.
    """
    from ..checks import random_seed, target_index
    from ..envs import vector_type
    from ..scene import Scene

    asked = levels(legibility)
    random_seed("seed", seed)
    if spectrum is not None and len(np.unique(asked)) < len(asked):
        raise InvalidInputError("a spectrum shows each level once, legibility names one twice")
    pictures = figure, spectrum, video
    _check_outputs(len(asked), json, csv, pictures)
    place = Scene.load(scene)
    target_index(target, place.num_goals)
    model = model_of(model, place)
    robot_type = vector_type(env, place.dim)
    if place.dim == 3 and any(pictures):
        from ..envs.panda_model import import_mujoco

        import_mujoco()  # it draws the arm of either simulator

    from ..modulator import Modulator

    robots = robot_type(len(asked), max_goals=max(6, place.num_goals))
    options = {"noise": noise, "push": push, "shift": shift}
    # The same hidden properties and disturbance for each, so that ℓ alone makes the difference.
    robots.reset(seed=[seed] * len(asked), options={"scene": place, "target": target, **options})
    rollouts = Modulator.from_pretrained(model).execute_many(
        robots, legibility=asked, seed=seed, replan=replan, num_candidates=candidates
    )
    robots.close()
    settings = {"env": robot_type.__name__.removesuffix("Vector"), "target": target,
                "legibility": asked, "replan": replan, "candidates": candidates}  # fmt: skip
    result = {"scene": place.to_dict(), "target": target,
              "observer": rollouts[0].path.observer.to_dict(),
              "rollouts": [rollout.to_dict() for rollout in rollouts]}  # fmt: skip
    record = output.model_record(model)
    output.write_report(json, seed=seed, config=settings | options, model=record, result=result)
    if csv is not None:
        from .trajectories import write_trajectories

        names = [f"{level:g}" for level in asked]
        write_trajectories(csv, names, np.stack([r.trajectory() for r in rollouts]))
    if any(pictures):
        _draw(rollouts, pictures)
    _print(f"{scene}, goal {target}, {model}", rollouts)


def _check_outputs(number: int, json: Path | None, csv: Path | None, pictures: Pictures) -> None:
    """Raise before any work is done if a file cannot be written or `number` motions be shown."""
    figure, spectrum, video = pictures
    for file in (figure, spectrum):
        output.check_figure(file)
    for file, name in ((json, "JSON file"), (csv, "CSV file"), (video, "film")):
        output.check_file(file, name)
    if figure is not None or video is not None:
        from ..figures.film import check_film, check_number

        check_number(number)
        if video is not None:
            check_film(video)


def _draw(rollouts: list[Rollout], pictures: Pictures) -> None:
    from ..evaluation.spectrum import Spectrum
    from ..figures.film import execution_figure, execution_film
    from ..figures.spectrum import spectrum_figure

    figure, spectrum, video = pictures
    if figure is not None:
        execution_figure(rollouts, figure)
    if spectrum is not None:
        spectrum_figure([Spectrum.of(rollouts)], spectrum)
    if video is not None:
        with output.progress_bar("frames") as progress:
            execution_film(rollouts, video, progress=progress)


def _print(title: str, rollouts: list[Rollout]) -> None:
    columns = ("asked ℓ", "planned ℓ", "executed ℓ", "time to\nconfidence [s]", "steps",
               "deviation [mm]", "ended")  # fmt: skip
    rows, number = output.table(title, *columns), output.number
    for rollout in rollouts:
        seconds, deviation = rollout.time_to_confidence, float(rollout.deviation.mean())
        rows.add_row(
            number(rollout.legibility), number(float(rollout.path.achieved)),
            number(rollout.achieved),
            number(seconds, 2) if np.isfinite(seconds) else "never",
            str(len(rollout.actions)), number(1e3 * deviation, 1), rollout.reason,
        )  # fmt: skip
    error = float(np.mean([abs(rollout.achieved - rollout.legibility) for rollout in rollouts]))
    output.show(rows, f"mean |executed − asked| {number(error)}")
