"""`legibility evaluate dial` and `legibility evaluate execution`."""

from __future__ import annotations

from dataclasses import asdict
from typing import Annotated, Any

from tyro.conf import arg

from ..evaluation.dial import FIGURES, DialConfig, evaluate_dial, worst
from ..evaluation.execution import ROWS, ExecutionConfig, evaluate_execution
from ..modulator import Modulator
from .options import MODEL, OutputFile, Workers, flags, made
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

_Flags = flags(DialConfig)
_Execution = flags(ExecutionConfig)


def dial(
    evaluation: Annotated[Any, arg(constructor=_Flags)],
    workers: Workers,
    model: str = MODEL,
    figure: OutputFile = None,
    json: OutputFile = None,
) -> None:
    """Measure achieved against asked legibility on random scenes that training never drew.

    Args:
        evaluation: what is measured.
        workers: who measures it.
        model: name of weights that came with the package, or a folder.
        figure: a picture of asked against achieved, .png, .pdf or .svg.
        json: everything as JSON.
    """
    settings = made(DialConfig, evaluation)
    check_figure(figure)
    check_file(json, "JSON file")
    modulator = Modulator.from_pretrained(model)
    used = model_record(model)
    with progress_bar("scenes") as progress:
        result = evaluate_dial(modulator, settings, **vars(workers), progress=progress)
    if figure is not None:
        from ..evaluation.figures import dial_figure

        dial_figure(result, figure)
    write_report(json, seed=settings.seed, config=asdict(settings), model=used, result=result)

    rows = table(
        f"{model} on {settings.scenes} scenes with {'..'.join(map(str, settings.goals))} goals",
        "figure", "mean", "95 % interval", "worst", "what it is", text_columns=1,
    )  # fmt: skip
    rows.columns[-1].justify = "left"
    for name, figures in result["overall"].items():
        low, high = figures["interval"]
        least = worst(name, figures)
        rows.add_row(
            name, number(figures["mean"], 4), f"{number(low, 4)} … {number(high, 4)}",
            "" if least is None else number(least, 4), FIGURES[name].text,
        )  # fmt: skip
    show(rows, f"one plan on one core: {number(result['plan_ms'], 1)} ms")


def execution(
    evaluation: Annotated[Any, arg(constructor=_Execution)],
    workers: Workers,
    model: str = MODEL,
    json: OutputFile = None,
) -> None:
    """Measure executed motions: success, dial, deviation and safety, and what stage 2 is good for.

    Stage 2, also pushed and with a target that moves, is held against itself without the path, the
    path's displacements in open loop, and the feedback controller that demonstrated; all in the
    same scenes, on the same plans, with the same hidden gains.

    Args:
        evaluation: what is measured.
        workers: who measures it.
        model: name of weights that came with the package, or a folder.
        json: everything as JSON.
    """
    settings = made(ExecutionConfig, evaluation)
    check_file(json, "JSON file")
    modulator = Modulator.from_pretrained(model)
    used = model_record(model)
    with progress_bar("rollouts") as progress:
        result = evaluate_execution(modulator, settings, **vars(workers), progress=progress)
    write_report(json, seed=settings.seed, config=asdict(settings), model=used, result=result)
    rows = table(
        f"{model}, {settings.rollouts} rollouts in {settings.scenes} scenes",
        "who", "success", "within 5 cm", "Spearman", "error of ℓ", "deviation", "planned anew",
        "counts", "what it is", text_columns=1,
    )  # fmt: skip
    rows.columns[-1].justify = "left"
    for name, figures in result["rows"].items():
        rows.add_row(
            name,
            number(figures["success"]["mean"], 4),
            number(figures["within_5_cm"], 4) if "within_5_cm" in figures else "",
            *(
                number(figures[key]["mean"], 4) if key in figures else ""
                for key in ("spearman", "error", "deviation")
            ),
            number(figures["replanned"], 4),
            " ".join(map(str, figures["counts"].values())),
            ROWS[name].text,
        )
    plan = result["rows"]["policy"]
    counted = ", ".join(name.replace("_", " ") for name in plan["counts"])
    show(
        rows,
        *([f"counts: {counted}"] if counted else []),
        f"plans alone: Spearman {number(plan['spearman_of_plan']['mean'], 4)}, error of ℓ "
        f"{number(plan['error_of_plan']['mean'], 4)}",
        f"{result['env']} alone: {number(result['env_steps_per_second'], 0)} control steps a "
        "second on one core",
        f"one control step on one core: {number(result['step_ms'], 2)} ms; "
        f"{number(result['rollouts_per_second'], 0)} rollouts a second, "
        f"{result['at_once']} at once on {result['threads']} threads",
    )
