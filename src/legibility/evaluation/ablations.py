"""Ablations of stage 1: the dial without a part of it, or with more or less of it."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, NamedTuple

from ..data.configuration import DatasetConfig
from ..data.dataset import Dataset, generate
from ..errors import InvalidInputError
from ..files import file_hash, write_json
from ..models.configuration import PathDiffuserConfig
from ..models.pretrained import pretrained_folder, save_stage
from ..modulator import Modulator
from ..training.configuration import FIXED_BY_DATA, PathTrainingConfig
from ..training.loop import Run
from ..training.path import check_data, train_path
from ..training.team import Team
from .configuration import AblationsConfig, DialConfig
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
    label: str = "anchored"
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
    rows["rank-label"] = Variant("small run on rank labels", scenes=size, label="rank")
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
    steps. Interrupted, the same call resumes: datasets, runs and rows in `folder` are kept.

    Args:
        model: name of weights that came with the package, or a folder.
        data: labelled trajectories with anchored labels; small runs learn their first scenes.
        folder: of rank-labelled and validation data, and of each row: checkpoint, log and weights
            of a small run, and the measured dial.
        config: the rows and their measurement.
        workers: processes that make data.
        device: of small runs; a GPU where there is one.
        progress: called with the number of scenes and optimiser steps done, that of all, and a line
            for each row.

    Returns:
        `rows`: of each variant its `text`, whether it is `small_run`, `sha256` of its weights,
        `overall` and `plan_ms` as of `evaluate_dial`; `data`: digest of the training data.

    Raises:
        InvalidInputError: the data are of another observer than the model, or too few.
        CheckpointError: the folder holds runs with other settings.
    """
    config, folder = config or AblationsConfig(), Path(folder)
    network = Modulator.from_pretrained(model).config
    rows = variants(config, network)
    _check(data, network)
    team = Team.join(device)
    parts = {number: data.first(number) for number in {v.scenes for v in rows.values()} if number}
    sources = {
        "validation": data.config.for_validation(),
        "rank-data": _on_rank_labels(parts[config.training_scenes].config),
        "rank-validation": _on_rank_labels(data.config.for_validation()),
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
    result = {}
    for name, variant in rows.items():
        weights = pretrained_folder(model)
        if variant.scenes:
            rank = variant.label == "rank"
            weights = _trained(
                sets["rank-data"] if rank else parts[variant.scenes],
                sets["rank-validation" if rank else "validation"],
                replace(network, field=variant.field),
                PathTrainingConfig(steps=config.training_steps),
                Run(folder / name, team, part(config.training_steps)),
            )
        settings = config.dial(variant.steps, variant.guidance)
        dial = _measured(weights, settings, folder / name / "dial.json", part(config.scenes))
        result[name] = {"text": variant.text, "small_run": bool(variant.scenes), **dial}
        metrics = [f"{key} {dial['overall'][key]['mean']:.4f}" for key in ("spearman", "error")]
        progress(done, total, f"{variant.text}: {', '.join(metrics)}")
    return {"rows": result, "data": data.digest}


def _check(data: Dataset, model: PathDiffuserConfig) -> None:
    stream, label = data.config.stream, data.config.observer.label
    if (stream, label) != ("train", "anchored"):
        raise InvalidInputError(
            f"the data must have stream train and label anchored, theirs are {stream} and {label}"
        )
    check_data(model, data, data)


def _on_rank_labels(config: DatasetConfig) -> DatasetConfig:
    return replace(config, observer=replace(config.observer, label="rank"))


def _trained(
    data: Dataset,
    validation: Dataset,
    network: PathDiffuserConfig,
    training: PathTrainingConfig,
    run: Run,
) -> Path:
    """Train a small run, or resume it; the folder of its weights."""
    settings = {k: v for k, v in vars(network).items() if k not in FIXED_BY_DATA}
    if network.distilled:  # a small run is sampled as a teacher is by default
        teacher = PathDiffuserConfig()
        settings |= {"distilled": False, "sampling_steps": teacher.sampling_steps,
                     "guidance": teacher.guidance}  # fmt: skip
    trained = train_path(data, validation, run, training, **settings)
    save_stage(run.folder / "weights", "path", trained.model, trained.record)
    return run.folder / "weights"


def _measured(
    weights: Path, config: DialConfig, file: Path, progress: Callable[[int, int], None]
) -> dict[str, Any]:
    """The dial of `weights`, kept in `file` and read from there if it is of these settings."""
    sha256 = file_hash(weights / "path.safetensors")
    of = {"sha256": sha256, "config": asdict(config)}
    try:
        kept = json.loads(file.read_text(encoding="utf-8"))
        if kept["of"] == json.loads(json.dumps(of)):
            return kept["result"]
    except (OSError, ValueError, LookupError, TypeError):
        pass  # not measured yet
    dial = evaluate_dial(Modulator.from_pretrained(weights), config, progress=progress)
    result = {"sha256": sha256, "overall": dial["overall"], "plan_ms": dial["plan_ms"]}
    write_json(file, {"of": of, "result": result})
    return result
