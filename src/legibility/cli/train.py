"""`legibility train …`: the two stages, and the policies that they are compared with."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import torch
from torch import nn
from tyro.conf import arg

from ..data.configuration import DatasetConfig
from ..data.dataset import Dataset, generate
from ..data.demonstrations import Demonstrations
from ..errors import CheckpointError, InvalidInputError
from ..files import file_hash
from ..models.configuration import GoalPolicyConfig, PathDiffuserConfig, PathPolicyConfig
from ..models.pretrained import load_stages, pretrained_folder, save_stage
from ..models.provenance import TeacherRecord, TrainingRecord
from ..training.configuration import (
    FIXED_BY_DATA,
    DistillationConfig,
    PathTrainingConfig,
    PolicyTrainingConfig,
    TrainingConfig,
)
from ..training.distillation import distill_path
from ..training.goal import train_goal, tune_guidance
from ..training.loop import LOG
from ..training.path import train_path
from ..training.policy import train_policy
from ..training.team import Team
from .options import Folder, OutputFile, Where, Workers, flags, made
from .output import (
    check_file,
    check_folder,
    model_record,
    number,
    progress_bar,
    show,
    table,
    write_report,
)


@dataclass(frozen=True)
class Files:
    """What a training reads and writes.

    Attributes:
        data: folder of the dataset, made by `legibility data`: for a policy with --demonstrations,
            for a student with its teacher's labels.
        out: folder of the log, the checkpoint and the weights.
        validation: another dataset; if not given, one of 128 scenes is made in OUT/validation.
        weights: where the weights are saved, beside those of another stage if they are there;
            OUT/weights if not given.
        json: the settings and the last validation as JSON.
    """

    data: Annotated[Path, arg(metavar="DIR")]
    out: Annotated[Path, arg(metavar="DIR")]
    validation: Folder = None
    weights: Folder = None
    json: OutputFile = None

    @property
    def saved(self) -> Path:
        """Where the weights are saved."""
        return self.weights or self.out / "weights"


_PathTraining = flags(PathTrainingConfig)
_PathModel = flags(PathDiffuserConfig, *FIXED_BY_DATA, "distilled")
_Distillation = flags(DistillationConfig, "dropout")
_PolicyTraining = flags(PolicyTrainingConfig)
_PolicyModel = flags(PathPolicyConfig, "dim", "limit")
_GoalModel = flags(GoalPolicyConfig, "dim", "limit", "guidance", "guidance_decay", "guidance_share")
_DiffusionPolicyTraining = flags(PolicyTrainingConfig, dropout=0.0)
_LegibilityDiffuserTraining = flags(PolicyTrainingConfig, dropout=0.2)


def path(
    files: Files,
    training: Annotated[Any, arg(constructor=_PathTraining)],
    model: Annotated[Any, arg(constructor=_PathModel)],
    workers: Workers,
    where: Where,
) -> None:
    """Train stage 1, the path diffuser, and save its weights to OUT/weights.

    Loss and validation of the dial go to OUT/log.jsonl, and with the extra named train to
    OUT/tensorboard too. Interrupted, the same command resumes from the last checkpoint.

    Args:
        files: what is read and written.
        training: how it is trained.
        model: the network.
        workers: who makes the validation data.
        where: where it is trained.
    """
    settings = made(PathTrainingConfig, training)
    check_file(files.json, "JSON file")
    dataset = Dataset.load(files.data)
    team, checks = _ready(dataset.config, files, workers, where)
    facts = {"data": dataset.config.to_dict(), "digest": dataset.digest}

    def run(progress: Callable[..., None]) -> nn.Module:
        return train_path(
            dataset, checks, files.out, settings,
            progress=progress, **vars(where), **vars(model),
        )  # fmt: skip

    _train("path", run, settings, facts, checks.digest, files, team)


def distill(
    files: Files,
    training: Annotated[Any, arg(constructor=_Distillation)],
    workers: Workers,
    where: Where,
    teacher: Annotated[str, arg(metavar="NAME")],
) -> None:
    """Train a student of stage 1 that draws in one step what its teacher draws in several, guided.

    Its weights are used as those of any stage 1; the teacher's stage 2, if there is one, is saved
    beside them. Loss and validation of the dial go to OUT/log.jsonl. Interrupted, the same command
    resumes from the last checkpoint.

    Args:
        files: what is read and written.
        training: how it is trained.
        workers: who makes the validation data.
        where: where it is trained.
        teacher: name or folder of the weights that are distilled.
    """
    settings = made(DistillationConfig, training)
    check_file(files.json, "JSON file")
    folder = pretrained_folder(teacher)
    stages, made_by = load_stages(folder)
    if "path" not in stages:
        raise CheckpointError(f"{folder} has no stage 1")
    dataset = Dataset.load(files.data)
    if files.saved.resolve() == folder.resolve():
        raise InvalidInputError(f"weights must not be the teacher's own folder, got {files.saved}")
    team, checks = _ready(dataset.config, files, workers, where)
    facts = {
        "data": dataset.config.to_dict(),
        "digest": dataset.digest,
        "teacher": TeacherRecord(
            sha256=file_hash(folder / "path.safetensors"),
            sampling_steps=stages["path"].config.sampling_steps,
            guidance=stages["path"].config.guidance,
            training=made_by["path"],
        ),
    }

    def run(progress: Callable[..., None]) -> nn.Module:
        with progress_bar("scenes of the teacher") as drawn:
            student = distill_path(
                stages["path"], dataset, checks, files.out, settings,
                progress=progress, drawn=drawn, **vars(where),
            )  # fmt: skip
        if "policy" in stages and team.main:
            save_stage(files.saved, "policy", stages["policy"], made_by["policy"])
        return student

    _train("path", run, settings, facts, checks.digest, files, team)


def policy(
    files: Files,
    training: Annotated[Any, arg(constructor=_PolicyTraining)],
    model: Annotated[Any, arg(constructor=_PolicyModel)],
    workers: Workers,
    where: Where,
) -> None:
    """Train stage 2, the path-guided policy, and save its weights to OUT/weights.

    Loss and closed-loop validation go to OUT/log.jsonl, and with the extra named train to
    OUT/tensorboard too. Interrupted, the same command resumes from the last checkpoint.

    Args:
        files: what is read and written.
        training: how it is trained.
        model: the network.
        workers: who makes the validation data.
        where: where it is trained.
    """
    settings = made(PolicyTrainingConfig, training)
    _train_on_demonstrations("policy", train_policy, vars(model), settings, files, workers, where)


def diffusion_policy(
    files: Files,
    training: Annotated[Any, arg(constructor=_DiffusionPolicyTraining)],
    model: Annotated[Any, arg(constructor=_GoalModel)],
    workers: Workers,
    where: Where,
) -> None:
    """Train the baseline Diffusion Policy, which knows a goal but neither path nor legibility.

    Loss and closed-loop validation go to OUT/log.jsonl. Interrupted, the same command resumes from
    the last checkpoint.

    Args:
        files: what is read and written.
        training: how it is trained.
        model: the network.
        workers: who makes the validation data.
        where: where it is trained.
    """
    settings = made(PolicyTrainingConfig, training)
    _train_on_demonstrations("goal", train_goal, vars(model), settings, files, workers, where)


def legibility_diffuser(
    files: Files,
    training: Annotated[Any, arg(constructor=_LegibilityDiffuserTraining)],
    model: Annotated[Any, arg(constructor=_GoalModel)],
    workers: Workers,
    where: Where,
) -> None:
    """Train the baseline Legibility Diffuser, then tune its guidance on the validation scenes.

    It is a goal-conditioned policy whose goal is sometimes dropped in training. The JSON records
    every combination of weight, decay and share of the guidance that was tried, with its
    measurements. Interrupted, the same command resumes from the last checkpoint.

    Args:
        files: what is read and written.
        training: how it is trained.
        model: the network.
        workers: who makes the validation data.
        where: where it is trained.
    """
    settings = made(PolicyTrainingConfig, training)
    _train_on_demonstrations(
        "goal", train_goal, vars(model), settings, files, workers, where, tune=True
    )


def _train_on_demonstrations(
    stage: str,
    train_it: Callable[..., Any],
    model: dict[str, Any],
    settings: PolicyTrainingConfig,
    files: Files,
    workers: Workers,
    where: Where,
    tune: bool = False,
) -> None:
    check_file(files.json, "JSON file")
    demonstrations = Demonstrations.load(files.data)
    team, checks = _ready(demonstrations.dataset, files, workers, where)
    facts = {
        "data": demonstrations.dataset.to_dict(),
        "demonstrations": {**asdict(demonstrations.config), "number": len(demonstrations)},
        "digest": demonstrations.digest,
    }

    tuning: list[dict[str, float]] = []

    def run(progress: Callable[..., None]) -> nn.Module:
        trained = train_it(
            demonstrations, checks, files.out, settings, progress=progress, **vars(where), **model
        )
        if tune and team.main:
            with progress_bar("combinations of guidance") as tuned:
                chosen, rows = tune_guidance(trained, checks, tuned)
            trained.config = replace(trained.config, **chosen)
            tuning.extend(rows)
        return trained

    _train(stage, run, settings, facts, checks.digest, files, team, tuning)


def _train(
    stage: str,
    run: Callable[[Callable[..., None]], nn.Module],
    settings: TrainingConfig,
    facts: dict[str, Any],
    validation: str,
    files: Files,
    team: Team,
    tuning: list[dict[str, float]] | None = None,
) -> None:
    """Train a stage under a progress bar, save its weights and tell what became of it."""
    with progress_bar("steps") as progress:

        def report(step: int, steps: int, figures: dict[str, float]) -> None:
            progress(step, steps, _line(step, figures))

        trained = run(report)
    team.leave()
    if not team.main:
        return
    text = (files.out / LOG).read_text(encoding="utf-8")
    log = [json.loads(row) for row in text.splitlines()]
    last: dict[str, float] = {}
    for row in log:
        last |= row
    measured = {
        "parameters": sum(p.numel() for p in trained.parameters()),
        "seconds": last["seconds"],
        "step_seconds": _step_seconds(log),
        "device": str(team.device),
        "processes": team.size,
        "precision": team.precision,
        "threads": torch.get_num_threads(),
        "torch": torch.__version__,
    }
    record = TrainingRecord(training=asdict(settings), **facts, **measured)
    save_stage(files.saved, stage, trained, record)
    network: Any = trained.config
    write_report(
        files.json,
        seed=settings.seed,
        config={"training": asdict(settings), stage: network.to_dict()},
        model=model_record(str(files.saved)),
        result={
            "data": facts["digest"],
            "validation": validation,
            **measured,
            "last": last,
            **({"tuning": tuning} if tuning else {}),
        },
    )
    title = f"{measured['parameters']} parameters after {settings.steps} steps"
    rows = table(title, "figure", "last", text_columns=1)
    for name, value in last.items():
        rows.add_row(name, number(value, 0 if name in ("step", "seconds") else 4))
    show(rows, f"weights: {files.saved}")


def _step_seconds(log: list[dict[str, float]]) -> float:
    """Time of a step [s] that the quickest tenth of the log keeps to, as if nothing else ran."""
    times = np.array([[row["step"], row["seconds"]] for row in log])
    steps, seconds = np.diff(times, axis=0, prepend=np.zeros((1, 2))).T
    return float(np.quantile(seconds / steps, 0.1))


def _ready(
    config: DatasetConfig, files: Files, workers: Workers, where: Where
) -> tuple[Team, Dataset]:
    """The team that trains, once its folders can be written, and its validation data.

    They are those that are given, or made like the data of `config`.
    """
    check_folder(files.out, "checkpoint")
    check_folder(files.saved, "weights")
    team = Team.join(**vars(where))
    if files.validation is not None:
        return team, Dataset.load(files.validation)
    if config.stream == "validation":
        raise InvalidInputError("the data are of the validation stream: give --validation DIR")
    config, folder = config.for_validation(), files.out / "validation"
    with team.main_first():
        if not team.main:
            return team, Dataset.load(folder)
        with progress_bar("shards for validation") as progress:
            return team, generate(config, folder, **vars(workers), progress=progress)


def _line(step: int, figures: dict[str, float]) -> str:
    """A line of a validation, empty between them."""
    found = {k.removeprefix("validation_"): v for k, v in figures.items() if k.startswith("valid")}
    if not found:
        return ""
    if "loss" in figures:
        found = {"loss": figures["loss"], **found}
    return "  ".join([f"step {step}", *(f"{k} {number(v, 4)}" for k, v in found.items())])
