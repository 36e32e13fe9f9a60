"""`legibility execute`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from ..data.recordings import write_trajectories
from ..envs import ENVIRONMENTS, vector_type
from ..errors import InvalidInputError
from . import output
from .options import Motions, OutputFile, choices, motion_files

if TYPE_CHECKING:
    from ..rollout import Rollout


def execute(
    motions: Motions,
    env: Annotated[str | None, choices(ENVIRONMENTS)] = None,
    noise: float = 0.0,
    push: float = 0.0,
    shift: float = 0.0,
    replan: bool = True,
    figure: OutputFile = None,
    spectrum: OutputFile = None,
    video: OutputFile = None,
    json: OutputFile = None,
    csv: OutputFile = None,
    out: OutputFile = None,
) -> None:
    """Plan motions and execute them, closed loop, in an environment.

    Args:
        motions: motions to plan and execute.
        env: if not given, 2d or panda (MuJoCo) by the scene. MuJoCo draws either arm.
        noise: standard deviation of each step's displacement [m].
        push: length of a push on the way [m].
        shift: distance that the target moves on the way [m].
        replan: replan after a push or a shift has taken the robot off its path.
        figure: motions side by side and the belief of Dragan's observer and of --observer under
            each, .png, .pdf or .svg.
        spectrum: all motions in one figure and their cost against ℓ, .png, .pdf or .svg.
        video: the motions side by side as a film, .gif or, with ffmpeg, .mp4.
        json: everything as JSON.
        csv: the executed trajectories, at equal arc length, as CSV that `legibility score` reads.
        out: the executed motion at its control steps: .csv, .json or .mcap, a bag of ROS 2 (extra
            ros). Of several levels there is a file each, with the level in its name.

    Examples:
        legibility execute examples/paper.yaml --legibility -1 0 1 --video out/motions.gif
        legibility execute examples/obstacle.yaml --exact --push 0.1 --json out/pushed.json
    """
    scene, observer, asked, model = motions.read()
    target, seed = motions.target, motions.seed
    if spectrum is not None and len(np.unique(asked)) < len(asked):
        raise InvalidInputError("a spectrum shows each level once, legibility names one twice")
    output.check_figure(figure)
    output.check_figure(spectrum)
    for file, name in ((json, "JSON file"), (csv, "CSV file"), (video, "film")):
        output.check_file(file, name)
    files = []
    if out is not None:
        files = motion_files(out, asked, (figure, spectrum, video, json, csv))
    if figure is not None or video is not None:
        from ..figures.film import check_film, check_number

        check_number(len(asked))
        if video is not None:
            check_film(video)
    robot_type = vector_type(env, scene.dim)
    if scene.dim == 3 and any((figure, spectrum, video)):
        from ..robots.simulator import import_mujoco

        import_mujoco()  # it draws the arm of either simulator

    from ..modulator import Modulator

    robots = robot_type(len(asked), max_goals=max(6, scene.num_goals))
    options = {"noise": noise, "push": push, "shift": shift}
    # The same hidden properties and disturbance for each, so that ℓ alone makes the difference.
    robots.reset(seed=[seed] * len(asked), options={"scene": scene, "target": target, **options})
    modulator = Modulator.from_pretrained(model)
    with output.timed(f"planned and executed {len(asked)} motions"):
        rollouts = modulator.execute_many(
            robots, legibility=asked, seed=seed, replan=replan, **motions.options(observer)
        )
    robots.close()
    archive = rollouts[0].path.archive
    output.write_report(
        json,
        seed=seed,
        config={
            "env": robot_type.__name__.removesuffix("Vector"),
            "target": target,
            "legibility": asked,
            "replan": replan,
            **motions.options(observer),
            "observer": observer.to_dict(),
            **options,
        },
        model=output.model_record(model),
        result={
            "scene": scene.to_dict(),
            "target": target,
            "observer": rollouts[0].path.observer.to_dict(),
            **output.dial_record(archive),
            "rollouts": list(map(_record, rollouts)),
        },
    )
    if csv is not None:
        names = [f"{level:g}" for level in asked]
        write_trajectories(csv, names, np.stack([r.trajectory() for r in rollouts]))
    arm = getattr(robots, "arm", None)
    for rollout, file in zip(rollouts, files, strict=False):
        rollout.motion(arm).save(file)
    _draw(rollouts, figure, spectrum, video)
    _print(f"{motions.scene}, goal {target}, {model}", rollouts)


def _draw(
    rollouts: list[Rollout], figure: Path | None, spectrum: Path | None, video: Path | None
) -> None:
    if figure is not None:
        from ..figures.film import execution_figure

        execution_figure(rollouts, figure)
    if spectrum is not None:
        from ..evaluation.spectrum import Spectrum
        from ..figures.paper import spectrum_figure

        spectrum_figure([Spectrum.of(rollouts)], spectrum)
    if video is not None:
        from ..figures.film import execution_film

        with output.progress_bar("frames") as progress:
            execution_film(rollouts, video, progress=progress)


def _clearance(rollout: Rollout) -> float:
    """Least clearance [m] on the way."""
    scene, target = rollout.path.scene, rollout.path.target
    return float(scene.clearance_at(rollout.states, target).min())


def _record(rollout: Rollout) -> dict[str, Any]:
    """A rollout for the report, with the belief of Dragan's observer beside the dial's."""
    from ..figures.belief import readers

    dragan = readers(rollout.path.scene, rollout.path.observer)[0]
    posterior, seconds = dragan.belief(rollout)
    return {
        **rollout.to_dict(),
        "feasible": rollout.path.feasible,
        "clearance": _clearance(rollout),
        "dragan_time_to_confidence": seconds,
        "dragan_posterior": posterior,
    }


def _print(title: str, rollouts: list[Rollout]) -> None:
    from ..figures.belief import describe, readers

    path, number = rollouts[0].path, output.number
    shown = readers(path.scene, path.observer)
    solid = bool(path.scene.obstacles or path.scene.goal_radius)
    rows = output.table(
        f"{title}, for {describe(path.scene, path.observer)}", "asked ℓ", "planned ℓ", "executed ℓ",
        *(f"time to confidence [s],\n{reader.short}" for reader in shown), "steps",
        "deviation [mm]", *["clearance [mm]", "steps in\ncontact"] * solid, "ended",
    )  # fmt: skip
    for rollout in rollouts:
        times = [reader.belief(rollout)[1] for reader in shown]
        rows.add_row(
            number(rollout.legibility), number(float(rollout.path.achieved)),
            number(rollout.achieved),
            *(number(seconds, 2) if np.isfinite(seconds) else "never" for seconds in times),
            str(len(rollout.actions)), number(1e3 * float(rollout.deviation.mean()), 1),
            *[number(1e3 * _clearance(rollout), 1), str(rollout.contacts)] * solid, rollout.reason,
        )  # fmt: skip
    error = float(np.mean([abs(rollout.achieved - rollout.legibility) for rollout in rollouts]))
    output.show(rows, f"mean |executed − asked| {number(error)}", *output.dial_lines(path.archive))
