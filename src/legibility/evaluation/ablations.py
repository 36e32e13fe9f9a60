"""Ablations of stage 1: the dial without a part of it, or with more or less of it."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from ..data.dataset import Dataset, generate
from ..errors import InvalidInputError
from ..files import file_hash
from ..models.configuration import PathDiffuserConfig
from ..models.path_sampler import Sampling
from ..models.pretrained import load_stages, pretrained_folder, save_stage
from ..models.provenance import TeacherRecord
from ..modulator import Modulator
from ..training.configuration import FIXED_BY_DATA, DistillationConfig, PathTrainingConfig
from ..training.loop import Run
from ..training.path import check_data, distill_path, train_path
from ..training.team import Team
from .common import Parts, plan_milliseconds
from .configuration import AblationsConfig
from .dial import evaluate_dial

COLUMNS = {
    "spearman": "Spearman",
    "error": "error of ℓ",
    "at_1": "ℓ when asked 1",
    "at_-1": "ℓ when asked −1",
    "length_ratio_at_0": "length when asked 0",
    "feasible": "touch nothing",
    "waves": "waves",
}
"""Headings of the dial's metrics in the table of the rows."""

_LONG_WAYS = 1e3
"""An `efficiency` of data that makes nothing of length."""


class Variant(NamedTuple):
    """A row: the given weights, or a small run, sampled in some way.

    Attributes:
        text: for tables.
        run: name of the small run; none is that of the given weights.
        scenes: of its training.
        data: its data, `data`, `rank-data` or `long-data`.
        training: settings of the training that differ.
        field: whether it sees the field.
        student: whether it is the student of another small run, the reference.
        steps, guidance: of the sampler.
    """

    text: str
    run: str = ""
    scenes: int = 0
    data: str = "data"
    training: Mapping[str, Any] = {}
    field: bool = True
    student: bool = False
    steps: int | None = None
    guidance: float | None = None


def variants(config: AblationsConfig) -> dict[str, Variant]:
    """The rows by name."""
    size = config.training_scenes
    plain = Variant(f"small run: {size:,} training scenes", "reference", size)
    rows = {"as-shipped": Variant("the weights as they are"), "reference": plain}
    for weight in config.guidance:
        text = f"the same, guidance {weight:g}"
        rows[f"guidance-{weight:g}"] = plain._replace(text=text, guidance=weight)
    for steps in config.sampling_steps:
        text = f"the same, sampling steps {steps}"
        rows[f"steps-{steps}"] = plain._replace(text=text, steps=steps)

    def small(name: str, text: str, **changes: Any) -> None:
        rows[name] = plain._replace(text=f"small run{text}", run=name, **changes)

    small("another-seed", " of another seed", training={"seed": 1})
    small("twice-the-steps", " of twice the steps", training={"steps": 2 * config.training_steps})
    small("distilled", " distilled, in as many steps again, into one step", student=True)
    small("without-label-loss", " without the loss on labels", training={"score_weight": 0.0})
    small("without-contact-loss", " without the loss on contact", training={"contact_weight": 0.0})
    small("without-jerk-loss", " without the loss on jerk", training={"jerk_weight": 0.0})
    small("without-field", " without the field", field=False)
    small("rank-label", " on rank labels", data="rank-data")
    small("long-ways", " on data that do not prefer short ways", data="long-data")
    for number in sorted(set(config.scene_numbers) - {size}):
        small(f"scenes-{number}", f": {number:,} training scenes", scenes=number)
    return rows


def evaluate_ablations(
    model: str | Path,
    data: Dataset,
    folder: str | Path,
    config: AblationsConfig | None = None,
    *,
    workers: int = 1,
    device: str | None = None,
    progress: Callable[[int, int, str], None] = lambda done, total, line: None,
) -> dict[str, Any]:
    """Measure the dial of each of `variants`, training the small runs among them.

    A small run has the network of `model` and the settings of `PathTrainingConfig`, apart from its
    steps and batch, and is measured as its network draws: what a user gets is mended, and hides the
    differences. Interrupted, the same call resumes: datasets and runs in `folder` are kept.

    Args:
        model: name of weights that came with the package, or a folder.
        data: labelled trajectories with anchored labels; small runs learn their first scenes.
        folder: of the other data, and of each small run's checkpoint, log and weights.
        progress: called with the scenes and steps done, that of all, and a line for each row.

    Returns:
        `rows`: of each variant its `text`, whether it is `small_run`, `sha256` of its weights,
        `overall` of bare plans as of `evaluate_dial`, `quick_error` of those that a user gets,
        `plan_ms` on one core; `data`: digest of the training data.

    Raises:
        InvalidInputError: the data are of another observer than the model, or too few.
        CheckpointError: the folder holds runs with other settings.
    """
    config, folder = config or AblationsConfig(), Path(folder)
    network = Modulator.from_pretrained(model).config
    rows = variants(config)
    for row in rows.values():
        Sampling(row.guidance, row.steps).checked(replace(network, distilled=False))
    stream, label = data.config.stream, data.config.observer.label
    if (stream, label) != ("train", "anchored"):
        raise InvalidInputError(
            f"the data must have stream train and label anchored, theirs are {stream} and {label}"
        )
    check_data(network, data, data)
    team = Team.join(device)
    parts = {number: data.first(number) for number in {v.scenes for v in rows.values()} if number}
    source = parts[config.training_scenes].config
    rank = {"observer": replace(source.observer, label="rank")}
    sources = {
        "validation": source.for_validation(),
        "rank-data": replace(source, **rank),
        "rank-validation": replace(source.for_validation(), **rank),
        "long-data": replace(source, efficiency=_LONG_WAYS),
    }
    trained = {variant.run: variant for variant in rows.values() if variant.run}
    common: dict[str, Any] = {"steps": config.training_steps, "scenes": config.batch_scenes}
    lessons = {name: {**common, **variant.training} for name, variant in trained.items()}
    total = sum(lesson["steps"] for lesson in lessons.values())
    total += sum(s.scenes for s in sources.values()) + len(rows) * config.scenes
    stages = Parts(progress, total)
    sets = {
        name: generate(source, folder / name, workers=workers, progress=stages.next(source.scenes))
        for name, source in sources.items()
    }
    settings = {k: v for k, v in vars(network).items() if k not in FIXED_BY_DATA}
    if network.distilled:  # a small run is sampled as a teacher is by default
        teacher = PathDiffuserConfig()
        settings |= {"distilled": False, "sampling_steps": teacher.sampling_steps,
                     "guidance": teacher.guidance}  # fmt: skip
    weights = {"": pretrained_folder(model)}
    for name, variant in trained.items():
        run = Run(folder / name, team, stages.next(lessons[name]["steps"]))
        learned = sets.get(variant.data, parts[variant.scenes])
        checks = sets["rank-validation" if variant.data == "rank-data" else "validation"]
        weights[name] = folder / name / "weights"
        if variant.student:
            model_of, records = load_stages(weights["reference"])
            taught = model_of["path"]
            record = TeacherRecord(
                file_hash(weights["reference"] / "path.safetensors"),
                taught.config.sampling_steps, taught.config.guidance, records["path"],
            )  # fmt: skip
            how = DistillationConfig(**lessons[name])
            result = distill_path(taught, learned, checks, run, how, record)
        else:
            how = PathTrainingConfig(**lessons[name])
            own = {**settings, "field": variant.field}
            result = train_path(learned, checks, run, how, **own)
        save_stage(weights[name], "path", result.model, result.record)
    scene = config.stream(network.dim).scene(0)
    found = {}
    for name, variant in rows.items():
        modulator = Modulator.from_pretrained(weights[variant.run])
        how = config.dial(variant.steps, variant.guidance)
        dial = evaluate_dial(modulator, how, workers=workers, progress=stages.next(config.scenes))
        overall = dial["overall"]["bare"]
        found[name] = {
            "text": variant.text,
            "small_run": bool(variant.run),
            "sha256": file_hash(weights[variant.run] / "path.safetensors"),
            "overall": overall,
            "quick_error": dial["overall"]["quick"]["error"],
            "plan_ms": plan_milliseconds(
                modulator, scene, guidance=variant.guidance, steps=variant.steps
            ),
        }
        metrics = [f"{key} {overall[key]['mean']:.4f}" for key in ("spearman", "error")]
        stages.tell(f"{variant.text}: {', '.join(metrics)}")
    return {"rows": found, "data": data.digest}
