"""`legibility train …`: the two stages, and the policies that they are compared with."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tyro.conf import arg

from ..data.configuration import DemonstrationsConfig
from ..errors import CheckpointError, InvalidInputError
from ..files import file_hash, read_document
from ..models.configuration import GoalPolicyConfig, PathDiffuserConfig, PathPolicyConfig
from ..models.provenance import TeacherRecord
from ..training.configuration import (
    FIXED_BY_DATA,
    DistillationConfig,
    PathTrainingConfig,
    PolicyTrainingConfig,
)
from .options import (
    MODELS,
    Folder,
    ModelName,
    OptionalInt,
    OutputFile,
    Where,
    Workers,
    choices,
    flags,
    made,
)
from .output import (
    check_file,
    check_folder,
    model_record,
    note,
    number,
    progress_bar,
    show,
    table,
    write_report,
)

if TYPE_CHECKING:
    from ..data.dataset import Dataset
    from ..training.loop import Run, Trained
    from ..training.team import Team


@dataclass(frozen=True, kw_only=True)
class Job:
    """Files that a training reads and writes.

    Attributes:
        data: folder of the dataset, made by `legibility data`: for a policy with --demonstrations,
            for a student with its teacher's labels.
        out: folder of the log (log.jsonl, and TensorBoard's with the extra named train), the
            checkpoint and the weights. Interrupted, the same command resumes from the checkpoint.
        validation: another dataset; if not given, one of up to 128 scenes is made in
            OUT/validation.
        weights: where the weights are saved, beside those of another stage if they are there;
            OUT/weights if not given.
        json: the settings and the last validation as JSON.
    """

    data: Annotated[Path, arg(metavar="DIR")]
    out: Annotated[Path, arg(metavar="DIR")]
    validation: Folder = None
    weights: Folder = None
    json: OutputFile = None
    workers: Workers
    where: Where

    @property
    def saved(self) -> Path:
        """Where the weights are saved."""
        return self.weights or self.out / "weights"


_Job = Annotated[Job, arg(name="")]
_Path = Annotated[Any, arg(constructor=flags(PathTrainingConfig))]
_PathModel = Annotated[Any, arg(constructor=flags(PathDiffuserConfig, *FIXED_BY_DATA, "distilled"))]
_Distillation = Annotated[Any, arg(constructor=flags(DistillationConfig, "dropout"))]
_Policy = Annotated[Any, arg(constructor=flags(PolicyTrainingConfig))]
_Unguided = Annotated[Any, arg(constructor=flags(PolicyTrainingConfig, dropout=0.0))]
_Guided = Annotated[Any, arg(constructor=flags(PolicyTrainingConfig, dropout=0.2))]
_PolicyModel = Annotated[Any, arg(constructor=flags(PathPolicyConfig, "dim", "limit"))]
_TUNED = ("guidance", "guidance_decay", "guidance_share")
_GoalModel = Annotated[Any, arg(constructor=flags(GoalPolicyConfig, "dim", "limit", *_TUNED))]


def all(
    out: Annotated[Path, arg(metavar="DIR")],
    workers: Workers,
    where: Where,
    dim: int = 2,
    seed: int = 0,
    scenes: OptionalInt = None,
    demonstrated: OptionalInt = None,
    steps: OptionalInt = None,
    policy_steps: OptionalInt = None,
    settings: Annotated[Path | None, arg(metavar="FILE")] = None,
    weights: Folder = None,
    json: OutputFile = None,
) -> None:
    """Make every stage of a model, from nothing to the weights in OUT/weights.

    In OUT it makes the data of stage 1 (data), demonstrations (shown), stage 1, the teacher (path),
    stage 2 (policy), and the student that takes the teacher's place (student). Interrupted, the
    same command resumes.

    Args:
        out: folder of the data and of the runs.
        dim: 2, or 3 for an arm, which needs the extra named panda.
        seed: of the data and of every training.
        scenes: of the data of stage 1; if not given, 4096.
        demonstrated: scenes with demonstrations; if not given, 3200.
        steps: of the training of stage 1; if not given, 3500.
        policy_steps: of the training of stage 2; if not given, 8000.
        settings: a file, .yaml or .json, of any settings of the stages, in the sections observer,
            data, demonstrations, path, policy and student; their names are those of the flags of
            `legibility data` and `legibility train …`.
        weights: where the weights are saved; OUT/weights if not given.
        json: the settings and the last validation of each stage as JSON.

    Examples:
        legibility train all --out runs/model --workers 2
        legibility train all --settings examples/small-model.yaml --out runs/small
    """
    from ..envs import vector_type
    from ..training.recipe import Recipe
    from ..training.team import launched
    from .data import make_dataset

    sections = {} if settings is None else read_document(settings, "settings file")
    flags = {
        "data": {"scenes": scenes},
        "demonstrations": {"scenes": demonstrated},
        "path": {"steps": steps},
        "policy": {"steps": policy_steps},
    }
    recipe = Recipe.of(sections, flags, dim=dim, seed=seed)
    if launched():
        raise InvalidInputError(
            "train all is one process: give the stages one by one to accelerate launch or torchrun"
        )
    check_file(json, "JSON file")
    check_folder(out, "data")
    saved = weights or out / "weights"
    check_folder(saved, "weights")
    vector_type(None, dim)  # its simulator may be missing, which stage 2 needs only after hours
    note("1 of 5: the data of stage 1")
    make_dataset(out / "data", recipe.data, DemonstrationsConfig(), workers)
    note("2 of 5: demonstrations")
    make_dataset(out / "shown", recipe.shown, recipe.demonstrations, workers)
    note("3 of 5: stage 1, the teacher")
    teacher, last = out / "teacher", {}
    job = partial(Job, workers=workers, where=where, weights=teacher)
    first = job(data=out / "data", out=out / "path")
    last["path"] = _train(first, "path", recipe.path, recipe.path_network)
    note("4 of 5: stage 2")
    second = job(data=out / "shown", out=out / "policy")
    last["policy"] = _train(second, "policy", recipe.policy, recipe.policy_network)
    note("5 of 5: the student, which draws in one step")
    third = replace(first, out=out / "student", weights=saved, validation=first.out / "validation")
    last["student"] = _distill(third, recipe.student, teacher)
    config, model = recipe.to_dict(), model_record(str(saved))
    write_report(json, seed=seed, config=config, model=model, result={"last": last})


def path(job: _Job, training: _Path, model: _PathModel, policy: ModelName = None) -> None:
    """Train stage 1, the path diffuser, and save its weights to OUT/weights.

    Args:
        policy: name or folder of weights whose stage 2, which follows any path, is saved beside it,
            so that motions can be executed at once.

    Examples:
        legibility train path --data runs/data --out runs/teacher
        legibility train path --data runs/data --out runs/quick --steps 1000 --device cpu
    """
    stage = None if policy is None else _stage_2(policy)
    _train(job, "path", made(PathTrainingConfig, training), vars(model), stage)


def _stage_2(name: str) -> tuple[Any, Any]:
    """Stage 2 of some weights, and its record."""
    from ..models.pretrained import load_stages, pretrained_folder

    folder = pretrained_folder(name)
    stages, records = load_stages(folder)
    if "policy" not in stages:
        raise CheckpointError(f"{folder} has no stage 2")
    return stages["policy"], records["policy"]


def distill(
    job: _Job, training: _Distillation, teacher: Annotated[str, choices(MODELS.values(), "DIR")]
) -> None:
    """Train a student of stage 1 that draws in one step what its teacher draws in several, guided.

    Its weights are used as those of any stage 1; the teacher's stage 2, if there is one, is saved
    beside them.

    Args:
        teacher: name or folder of the weights to distill.

    Examples:
        legibility train distill --teacher runs/teacher/weights --data runs/data --out runs/student
        legibility train distill --teacher block-reach-2d --data runs/data --out runs/s --steps 2000
    """
    from ..models.pretrained import pretrained_folder

    _distill(job, made(DistillationConfig, training), pretrained_folder(teacher))


def _distill(job: Job, settings: DistillationConfig, folder: Path) -> dict[str, float]:
    """Distill the teacher in `folder` and save the student; return the last metrics."""
    from ..models.pretrained import load_stages, save_stage
    from ..training.path import distill_path

    saved = job.saved
    stages, records = load_stages(folder)
    if "path" not in stages:
        raise CheckpointError(f"{folder} has no stage 1")
    if saved.resolve() == folder.resolve():
        raise InvalidInputError(f"weights must not be the teacher's own folder, got {saved}")
    data, validation, team = _ready(job, "path")
    model = stages["path"]
    sha256, config = file_hash(folder / "path.safetensors"), model.config
    record = TeacherRecord(sha256, config.sampling_steps, config.guidance, records["path"])
    with progress_bar("scenes of the teacher") as drawn, _run(job, team) as run:
        trained = distill_path(model, data, validation, run, settings, record, drawn=drawn)
    if "policy" in stages and team.main:
        save_stage(saved, "policy", stages["policy"], records["policy"])
    return _save(job, team, "path", trained, validation)


def policy(job: _Job, training: _Policy, model: _PolicyModel) -> None:
    """Train stage 2, the path-guided policy, and save its weights to OUT/weights.

    Examples:
        legibility train policy --data runs/shown --out runs/policy
        legibility train policy --data runs/shown --out runs/policy --weights runs/teacher/weights
    """
    _train(job, "policy", made(PolicyTrainingConfig, training), vars(model))


def diffusion_policy(job: _Job, training: _Unguided, model: _GoalModel) -> None:
    """Train the baseline Diffusion Policy, which knows a goal but neither path nor legibility.

    Examples:
        legibility train diffusion-policy --data runs/shown --out runs/baseline
        legibility train diffusion-policy --data runs/shown --out runs/baseline --precision bf16
    """
    _train(job, "goal", made(PolicyTrainingConfig, training), vars(model))


def legibility_diffuser(job: _Job, training: _Guided, model: _GoalModel) -> None:
    """Train the baseline Legibility Diffuser, then tune its guidance on the validation scenes.

    It is a goal-conditioned policy whose goal is sometimes dropped in training. The JSON records
    the measurements of every combination of weight, decay and share of the guidance.

    Examples:
        legibility train legibility-diffuser --data runs/shown --out runs/diffuser
        legibility train legibility-diffuser --data runs/shown --out runs/diffuser --steps 2000
    """
    _train(job, "goal", made(PolicyTrainingConfig, training), vars(model), tune=True)


def _train(
    job: Job,
    stage: str,
    settings: Any,
    network: dict[str, Any],
    policy: Any = None,
    tune: bool = False,
) -> dict[str, float]:
    """Train a stage from nothing and save it, beside stage 2 and its record, if given.

    Returns the last metrics.
    """
    from ..models.pretrained import save_stage
    from ..training.path import train_path
    from ..training.policy import train_policy, tune_guidance

    train: Any = train_path if stage == "path" else partial(train_policy, stage=stage)
    data, validation, team = _ready(job, stage)
    if policy is not None and policy[0].config.dim != validation.config.dim:
        raise InvalidInputError(
            f"policy must move in {validation.config.dim}D, got {policy[0].config.dim}D"
        )
    with _run(job, team) as run:
        trained = train(data, validation, run, settings, **network)
    tuning = {}
    if tune and team.main:
        with progress_bar("combinations of guidance") as progress:
            chosen, rows = tune_guidance(trained.model, validation, progress)
        trained.model.config = replace(trained.model.config, **chosen)
        tuning = {"tuning": rows}
    if policy is not None and team.main:
        save_stage(job.saved, "policy", *policy)
    return _save(job, team, stage, trained, validation, **tuning)


def _ready(job: Job, stage: str) -> tuple[Any, Dataset, Team]:
    """The data of a stage, the validation data, given or made alike, and the team that trains."""
    check_file(job.json, "JSON file")
    check_folder(job.out, "checkpoint")
    check_folder(job.saved, "weights")
    if job.saved.resolve() == job.out.resolve():
        raise InvalidInputError(f"weights must be another folder than out, got {job.saved}")
    from ..data.dataset import Dataset, generate
    from ..data.demonstrations import Demonstrations
    from ..training.team import Team

    data: Any = (Dataset if stage == "path" else Demonstrations).load(job.data)
    config = data.config if stage == "path" else data.dataset
    team = Team.join(**vars(job.where))
    if job.validation is not None:
        return data, Dataset.load(job.validation), team
    if config.stream == "validation":
        raise InvalidInputError("the data are of the validation stream: give --validation DIR")
    folder = job.out / "validation"
    with team.main_first():
        if team.main:
            with progress_bar("shards for validation") as progress:
                generate(config.for_validation(), folder, **vars(job.workers), progress=progress)
        return data, Dataset.load(folder), team


@contextmanager
def _run(job: Job, team: Team) -> Iterator[Run]:
    """A run in OUT under a progress bar; the team ends with it."""
    from ..training.loop import Run

    with progress_bar("steps") as progress:
        yield Run(job.out, team, lambda *at: progress(*at[:2], _line(at[0], at[2])))
    team.leave()


def _line(step: int, metrics: dict[str, float]) -> str:
    """A line for a validation, empty between validations."""
    names = [name for name in metrics if name.startswith("validation_")]
    shown = (f"{n.removeprefix('validation_')} {number(metrics[n], 4)}" for n in ["loss", *names])
    return "  ".join([f"step {step}", *shown]) if names else ""


def _save(
    job: Job, team: Team, stage: str, trained: Trained[Any], validation: Dataset, **tuning: Any
) -> dict[str, float]:
    """Save the weights of a stage, write the JSON, and print and return the last metrics."""
    if not team.main:
        return trained.metrics
    from ..models.pretrained import save_stage

    record, metrics = trained.record, trained.metrics
    save_stage(job.saved, stage, trained.model, record)
    source = {"data", "digest", "demonstrations", "teacher", "training"}
    measured = {name: value for name, value in vars(record).items() if name not in source}
    digests = {"data": record.digest, "validation": validation.digest}
    write_report(
        job.json,
        seed=record.training["seed"],
        config={"training": record.training, stage: trained.model.config.to_dict()},
        model=model_record(str(job.saved)),
        result={**digests, **measured, "last": metrics, **tuning},
    )
    title = f"{record.parameters} parameters after {record.training['steps']} steps"
    rows = table(title, "metric", "last", text_columns=1)
    for name, value in metrics.items():
        rows.add_row(name, number(value, 0 if name in ("step", "seconds") else 4))
    show(rows, f"weights: {job.saved}")
    return metrics
