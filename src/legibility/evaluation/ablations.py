"""Ablations of stage 1: the dial without a part of it, or with more or less of it."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from ..data.dataset import Dataset, generate
from ..errors import InvalidInputError
from ..files import file_hash
from ..models.configuration import PathDiffuserConfig
from ..models.pretrained import pretrained_folder, save_stage
from ..modulator import Modulator
from ..training.configuration import FIXED_BY_DATA, PathTrainingConfig
from ..training.loop import Run
from ..training.path import check_data, train_path
from ..training.team import Team
from .common import plan_milliseconds
from .configuration import AblationsConfig
from .dial import evaluate_dial

COLUMNS = {
    "spearman": "Spearman",
    "error": "error of ℓ",
    "at_1": "ℓ when asked 1",
    "at_-1": "ℓ when asked −1",
    "length_ratio_at_0": "length when asked 0",
}
"""Headings of the dial's metrics in the table of the rows."""


class Variant(NamedTuple):
    """A row: the given weights, sampled in some way, or a small run on `scenes` scenes."""

    text: str
    steps: int | None = None
    guidance: float | None = None
    scenes: int | None = None
    rank: bool = False
    field: bool = True


def variants(config: AblationsConfig, model: PathDiffuserConfig) -> dict[str, Variant]:
    """The rows by name, without those that repeat the given weights or the reference.

    Raises:
        InvalidInputError: the model cannot be sampled so.
    """
    sampling = f"sampling steps {model.sampling_steps}, guidance {model.guidance:g}"
    rows = {"as-shipped": Variant(f"the weights as they are: {sampling}")}
    if not model.distilled:
        for steps in config.sampling_steps:
            if replace(model, sampling_steps=steps) != model:
                rows[f"steps-{steps}"] = Variant(f"sampling steps {steps}", steps=steps)
        for weight in config.guidance:
            if replace(model, guidance=weight) != model:
                rows[f"guidance-{weight:g}"] = Variant(f"guidance {weight:g}", guidance=weight)
    size = config.training_scenes
    rows["reference"] = Variant(f"small run: {size:,} training scenes", scenes=size)
    rows["without-field"] = Variant("small run without the field", scenes=size, field=False)
    rows["rank-label"] = Variant("small run on rank labels", scenes=size, rank=True)
    for number in sorted(set(config.scene_numbers) - {size}):
        rows[f"scenes-{number}"] = Variant(f"small run: {number:,} training scenes", scenes=number)
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
    steps. Interrupted, the same call resumes: datasets and runs in `folder` are kept.

    Args:
        model: name of weights that came with the package, or a folder.
        data: labelled trajectories with anchored labels; small runs learn their first scenes.
        folder: of the other data, and of each small run's checkpoint, log and weights.
        progress: called with the scenes and steps done, that of all, and a line for each row.

    Returns:
        `rows`: of each variant its `text`, whether it is `small_run`, `sha256` of its weights,
        `overall` of quick plans as of `evaluate_dial`, `plan_ms` on one core; `data`: digest of the
        training data.

    Raises:
        InvalidInputError: the data are of another observer than the model, or too few.
        CheckpointError: the folder holds runs with other settings.
    """
    config, folder = config or AblationsConfig(), Path(folder)
    network = Modulator.from_pretrained(model).config
    rows = variants(config, network)
    stream, label = data.config.stream, data.config.observer.label
    if (stream, label) != ("train", "anchored"):
        raise InvalidInputError(
            f"the data must have stream train and label anchored, theirs are {stream} and {label}"
        )
    check_data(network, data, data)
    team = Team.join(device)
    parts = {number: data.first(number) for number in {v.scenes for v in rows.values()} if number}
    part_data, validation = parts[config.training_scenes].config, data.config.for_validation()
    observer = replace(data.config.observer, label="rank")
    sources = {
        "validation": validation,
        "rank-data": replace(part_data, observer=observer),
        "rank-validation": replace(validation, observer=observer),
    }
    steps = config.training_steps * sum(bool(variant.scenes) for variant in rows.values())
    total = steps + sum(s.scenes for s in sources.values()) + len(rows) * config.scenes
    done = 0

    def part(size: int) -> Callable[..., None]:
        """The progress of the next part, of `size` scenes or steps."""
        nonlocal done
        start, done = done, done + size
        return lambda now, of, *_: progress(start + size * now // of, total, "")

    sets = {
        name: generate(source, folder / name, workers=workers, progress=part(source.scenes))
        for name, source in sources.items()
    }
    network_settings = {k: v for k, v in vars(network).items() if k not in FIXED_BY_DATA}
    if network.distilled:  # a small run is sampled as a teacher is by default
        teacher = PathDiffuserConfig()
        network_settings |= {"distilled": False, "sampling_steps": teacher.sampling_steps,
                             "guidance": teacher.guidance}  # fmt: skip
    training = PathTrainingConfig(steps=config.training_steps)
    scene = config.stream(network.dim).scene(0)
    result = {}
    for name, variant in rows.items():
        weights = pretrained_folder(model)
        if variant.scenes:
            run, weights = Run(folder / name, team, part(training.steps)), folder / name / "weights"
            pair = parts[variant.scenes], sets["validation"]
            if variant.rank:
                pair = sets["rank-data"], sets["rank-validation"]
            network_settings["field"] = variant.field
            trained = train_path(*pair, run, training, **network_settings)
            save_stage(weights, "path", trained.model, trained.record)
        settings = config.dial(variant.steps, variant.guidance)
        shown = part(config.scenes)
        modulator = Modulator.from_pretrained(weights)
        dial = evaluate_dial(modulator, settings, progress=shown)
        overall = dial["overall"]["quick"]
        result[name] = {
            "text": variant.text,
            "small_run": bool(variant.scenes),
            "sha256": file_hash(weights / "path.safetensors"),
            "overall": overall,
            "plan_ms": plan_milliseconds(
                modulator, scene, guidance=variant.guidance, steps=variant.steps
            ),
        }
        metrics = [f"{key} {overall[key]['mean']:.4f}" for key in ("spearman", "error")]
        progress(done, total, f"{variant.text}: {', '.join(metrics)}")
    return {"rows": result, "data": data.digest}
