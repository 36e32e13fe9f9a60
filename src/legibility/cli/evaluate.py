"""`legibility evaluate …`."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import arg

from ..data.dataset import Dataset
from ..envs import environment_dim
from ..errors import CheckpointError, InvalidInputError
from ..evaluation.ablations import COLUMNS, evaluate_ablations
from ..evaluation.comparison import METHODS, METRICS, TESTED
from ..evaluation.configuration import (
    AblationsConfig,
    DialConfig,
    ExecutionConfig,
    SpectrumConfig,
    Table1Config,
    UnseenConfig,
)
from ..evaluation.dial import FIGURES, evaluate_dial, worst
from ..evaluation.execution import ROWS, evaluate_execution
from ..evaluation.spectrum import Spectrum, evaluate_spectrum
from ..evaluation.table1 import TARGETS, evaluate_table1
from ..evaluation.unseen import evaluate_unseen
from ..models.goal_policy import GoalPolicy
from ..models.pretrained import load_stages, pretrained_folder
from ..modulator import Modulator
from .options import MODEL, MODELS, OptionalText, OutputFile, Workers, flags, made
from .output import (
    check_figure,
    check_file,
    check_folder,
    model_record,
    number,
    progress_bar,
    show,
    significant,
    table,
    write_report,
)

_Flags = flags(DialConfig)
_Table1 = flags(Table1Config)
_Unseen = flags(UnseenConfig)
_Spectrum = flags(SpectrumConfig)
_Execution = flags(ExecutionConfig)
_Ablations = flags(AblationsConfig)


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
    write_report(json, seed=settings.seed, config=asdict(settings), model=used, result=result)
    if figure is not None:
        from ..figures.dial import dial_figure

        dial_figure(result, figure)

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


def table1(
    evaluation: Annotated[Any, arg(constructor=_Table1)],
    workers: Workers,
    model: OptionalText = None,
    diffusion_policy: OptionalText = None,
    legibility_diffuser: OptionalText = None,
    json: OutputFile = None,
) -> None:
    """The paper's Table I: the most legible motions of every method, executed, with statistics.

    Its scene has two goals, R and G. The modulator, with one path and as the best of 64, is held
    against Diffusion Policy, Legibility Diffuser, the straight line, random search in the same and
    in ten times the time, and the archive's most legible trajectory.

    Args:
        evaluation: what is evaluated.
        workers: who executes it.
        model: weights of the modulator, a name or a folder; those of the environment's dimension if
            not given.
        diffusion_policy: weights of that baseline, likewise.
        legibility_diffuser: weights of that baseline, likewise.
        json: everything as JSON.
    """
    settings = made(Table1Config, evaluation)
    check_file(json, "JSON file")
    modulator, policies, used, others = _contestants(
        settings.env, model, diffusion_policy, legibility_diffuser
    )
    with progress_bar("rollouts") as progress:
        result = evaluate_table1(modulator, policies, settings, **vars(workers), progress=progress)
    write_report(
        json, seed=settings.seed, config=asdict(settings), model=used, baselines=others,
        result=result,
    )  # fmt: skip
    for letter in TARGETS:
        rows = table(
            f"target {letter}, {settings.rollouts} rollouts in {result['env']}",
            "method", "success", "L_d ↑", "over oracle", "L_p ↓", "over oracle", "length",
            "achieved ℓ", "confident at", "Dragan", "plan [ms]", "motion [ms]", text_columns=1,
        )  # fmt: skip
        oracle = result["oracle"][letter]
        for name, method in result["methods"].items():
            own, times = method["targets"][letter], method["milliseconds"]
            means = {metric: own[metric]["mean"] for metric in METRICS}
            rows.add_row(
                METHODS[name].text,
                number(own["success"]["mean"], 2),
                *(
                    text
                    for metric in TESTED
                    for text in (
                        significant(means[metric]), number(means[metric] / oracle[metric])
                    )
                ),
                *(number(means[metric]) for metric in METRICS if metric not in TESTED),
                *(number(times[what], 1) if times else "" for what in ("plan", "motion")),
            )  # fmt: skip
        show(rows)


def unseen(
    evaluation: Annotated[Any, arg(constructor=_Unseen)],
    workers: Workers,
    model: OptionalText = None,
    diffusion_policy: OptionalText = None,
    legibility_diffuser: OptionalText = None,
    json: OutputFile = None,
) -> None:
    """The methods of table1 in random scenes that training never drew, over each scene's oracle.

    Args:
        evaluation: what is evaluated.
        workers: who executes it.
        model: weights of the modulator, a name or a folder; those of the environment's dimension if
            not given.
        diffusion_policy: weights of that baseline, likewise.
        legibility_diffuser: weights of that baseline, likewise.
        json: everything as JSON.
    """
    settings = made(UnseenConfig, evaluation)
    check_file(json, "JSON file")
    modulator, policies, used, others = _contestants(
        settings.env, model, diffusion_policy, legibility_diffuser
    )
    with progress_bar("rollouts") as progress:
        result = evaluate_unseen(modulator, policies, settings, **vars(workers), progress=progress)
    write_report(
        json, seed=settings.seed, config=asdict(settings), model=used, baselines=others,
        result=result,
    )  # fmt: skip
    rows = table(
        f"{settings.scenes} scenes in {result['env']}; L_d and L_p over the oracle's, medians",
        "method", "success", "L_d ↑", "L_p ↓", "length", "achieved ℓ when asked 1", "Spearman",
        "error of ℓ", text_columns=1,
    )  # fmt: skip
    for name, method in result["methods"].items():
        rows.add_row(
            METHODS[name].text,
            number(method["success"]["mean"], 4),
            *(number(method["ratio"][metric]["median"]) for metric in TESTED),
            *(number(method[metric]["mean"]) for metric in ("length_ratio", "achieved")),
            *(
                number(method[key]["mean"], 4) if key in method else ""
                for key in ("spearman", "error")
            ),
        )
    show(rows)


def spectrum(
    evaluation: Annotated[Any, arg(constructor=_Spectrum)],
    model: OptionalText = None,
    figure: OutputFile = None,
    json: OutputFile = None,
) -> None:
    """The paper's figure 3: executed motions over the whole dial in the scene of Table I.

    Args:
        evaluation: what is evaluated.
        model: weights of the modulator, a name or a folder; those of the environment's dimension if
            not given.
        figure: motions and their cost against ℓ, toward R and toward G, .png, .pdf or .svg.
        json: everything as JSON.
    """
    settings = made(SpectrumConfig, evaluation)
    check_figure(figure)
    check_file(json, "JSON file")
    name = model or MODELS[environment_dim(settings.env)]
    modulator = Modulator.from_pretrained(name)
    used = model_record(name)
    with progress_bar("rollouts") as progress:
        result = evaluate_spectrum(modulator, settings, progress=progress)
    write_report(json, seed=settings.seed, config=asdict(settings), model=used, result=result)
    if figure is not None:
        from ..figures.spectrum import spectrum_figure

        spectrum_figure([Spectrum.of_result(result, letter) for letter in TARGETS], figure)

    rows = table(
        f"{settings.rollouts} motions a level in {result['env']}",
        "asked ℓ", *(text for t in TARGETS for text in (f"L_p toward {t}", f"achieved ℓ ({t})")),
    )  # fmt: skip
    for index, level in enumerate(result["levels"]):
        own = [result["targets"][letter] for letter in TARGETS]
        rows.add_row(
            number(level, 2),
            *(
                text
                for part in own
                for text in (significant(part["mean"][index]), number(part["achieved"][index]))
            ),
        )
    rising = ", ".join(f"{t} {result['targets'][t]['rising']}" for t in TARGETS)
    show(rows, f"levels at which the mean cost rises: {rising}")


def _contestants(
    env: str, model: str | None, diffusion_policy: str | None, legibility_diffuser: str | None
) -> tuple[Modulator, dict[str, GoalPolicy], dict[str, str], list[dict[str, str]]]:
    """The models, and what is recorded of the modulator and of the baselines."""
    dim = environment_dim(env)
    robot = "2d" if dim == 2 else "panda"
    name = model or MODELS[dim]
    names = {
        "diffusion policy": diffusion_policy or f"diffusion-policy-{robot}",
        "legibility diffuser": legibility_diffuser or f"legibility-diffuser-{robot}",
    }
    policies = {}
    for method, weights in names.items():
        stages, _ = load_stages(pretrained_folder(weights))
        if "goal" not in stages:
            raise CheckpointError(f"{weights} has no goal-conditioned policy")
        policies[method] = stages["goal"].eval().requires_grad_(False)
        guided = policies[method].config.guidance > 0
        if guided != (method == "legibility diffuser"):
            raise InvalidInputError(
                f"{weights} is {'' if guided else 'not '}guided, so it is no {method}"
            )
    modulator = Modulator.from_pretrained(name)
    others = [model_record(weights) for weights in names.values()]
    return modulator, policies, model_record(name), others


def ablations(
    evaluation: Annotated[Any, arg(constructor=_Ablations)],
    data: Annotated[Path, arg(metavar="DIR")],
    out: Annotated[Path, arg(metavar="DIR")],
    model: str = MODEL,
    workers: int = 1,
    device: OptionalText = None,
    json: OutputFile = None,
) -> None:
    """Measure the dial of the weights sampled otherwise, and of small runs that lack a part.

    Small runs are trained in OUT: the reference, without the field, on rank labels, and on other
    numbers of scenes. Interrupted, the same command resumes.

    Args:
        evaluation: what is measured, and how small runs are trained.
        data: folder of the dataset whose first scenes small runs are trained on.
        out: folder of the small runs, their data and what was measured so far.
        model: name of weights that came with the package, or a folder.
        workers: processes that make data.
        device: cpu or cuda; if not given, a GPU where there is one.
        json: everything as JSON.
    """
    settings = made(AblationsConfig, evaluation)
    check_file(json, "JSON file")
    check_folder(out, "small runs")
    used = model_record(model)
    dataset = Dataset.load(data)
    with progress_bar("scenes and training steps") as progress:
        result = evaluate_ablations(
            model, dataset, out, settings, workers=workers, device=device, progress=progress
        )
    write_report(json, seed=settings.seed, config=asdict(settings), model=used, result=result)
    rows = table(
        f"{model}, {settings.scenes} scenes with {'..'.join(map(str, settings.goals))} goals",
        "what is changed", *COLUMNS.values(), "plan [ms]",
        text_columns=1,
    )  # fmt: skip
    for row in result["rows"].values():
        figures = (number(row["overall"][name]["mean"], 4) for name in COLUMNS)
        rows.add_row(row["text"], *figures, number(row["plan_ms"], 1))
    show(rows, f"small runs are trained for {settings.training_steps} steps")
