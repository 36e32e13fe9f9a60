"""`legibility train path`."""

from __future__ import annotations

import json as json_format
from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated, Any

import torch
from tyro.conf import arg

from ..dataset import Dataset, generate
from ..errors import InvalidInputError
from ..models.path_diffuser import PathDiffuserConfig
from ..modulator import Modulator
from ..training import LOG, TrainingConfig, choose_device, train_path
from .options import Folder, OutputFile, flags, made
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

_Training = flags(TrainingConfig)
_Model = flags(PathDiffuserConfig, "dim", "sigma", "alpha", "label")  # the data fixes these
_VALIDATION_SCENES = 128


def path(
    training: Annotated[Any, arg(constructor=_Training)],
    model: Annotated[Any, arg(constructor=_Model)],
    data: Annotated[Path, arg(metavar="DIR")],
    out: Annotated[Path, arg(metavar="DIR")],
    validation: Folder = None,
    workers: int = 1,
    weights: Folder = None,
    device: Annotated[str | None, arg(metavar="STR", help_behavior_hint="")] = None,
    json: OutputFile = None,
) -> None:
    """Train stage 1, the path diffuser, and save its weights to OUT/weights.

    Loss and validation of the dial go to OUT/log.jsonl, and with the extra named train to
    OUT/tensorboard too. Interrupted, the same command resumes from the last checkpoint.

    Args:
        training: how it is trained.
        model: the network.
        data: folder of the dataset, made by `legibility data`.
        out: folder of the log, the checkpoint and the weights.
        validation: another dataset; if not given, one of 128 scenes is made in OUT/validation.
        workers: processes that make the validation data.
        weights: where the weights are saved; OUT/weights if not given.
        device: cpu or cuda; if not given, a GPU where there is one.
        json: the settings and the last validation as JSON.
    """
    settings = made(TrainingConfig, training)
    check_file(json, "JSON file")
    dataset = Dataset.load(data)
    weights = weights or out / "weights"
    check_folder(out, "checkpoint")
    check_folder(weights, "weights")
    checks = _validation(dataset, validation, out, workers)
    with progress_bar("steps") as progress:

        def report(step: int, steps: int, figures: dict[str, float]) -> None:
            progress(step, steps, _line(step, figures))

        trained = train_path(
            dataset, checks, out, settings, device=device, progress=report, **vars(model)
        )
    last: dict[str, float] = {}
    for row in (out / LOG).read_text(encoding="utf-8").splitlines():
        last |= json_format.loads(row)
    parameters = sum(p.numel() for p in trained.parameters())
    made_by = {
        "data": dataset.config.to_dict(),
        "digest": dataset.digest,
        "training": asdict(settings),
        "parameters": parameters,
        "seconds": last["seconds"],
        "device": str(choose_device(device)),
        "threads": torch.get_num_threads(),
        "torch": torch.__version__,
    }
    Modulator(trained, training=made_by).save_pretrained(weights)
    write_report(
        json,
        seed=settings.seed,
        config={"training": asdict(settings), "path": trained.config.to_dict()},
        model=model_record(str(weights)),
        result={
            "data": dataset.digest,
            "validation": checks.digest,
            "parameters": parameters,
            "last": last,
        },
    )
    rows = table(
        f"{parameters} parameters after {settings.steps} steps", "figure", "last", text_columns=1
    )
    for name, value in last.items():
        rows.add_row(name, number(value, 0 if name in ("step", "seconds") else 4))
    show(rows, f"weights: {weights}")


def _validation(data: Dataset, folder: Path | None, out: Path, workers: int) -> Dataset:
    """The dataset that the dial is measured on while training, made like the data if not given."""
    if folder is not None:
        return Dataset.load(folder)
    if data.config.stream == "validation":
        raise InvalidInputError("the data are of the validation stream: give --validation DIR")
    config = replace(data.config, stream="validation", scenes=_VALIDATION_SCENES)
    with progress_bar("shards for validation") as progress:
        return generate(config, out / "validation", workers=workers, progress=progress)


def _line(step: int, figures: dict[str, float]) -> str:
    """A line of the validation of the dial, empty between them."""
    dial = {k.removeprefix("validation_"): v for k, v in figures.items() if k.startswith("valid")}
    if not dial:
        return ""
    if "loss" in figures:
        dial = {"loss": figures["loss"], **dial}
    return "  ".join([f"step {step}", *(f"{k} {number(v, 4)}" for k, v in dial.items())])
