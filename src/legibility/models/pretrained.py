"""Weights of models in folders: `config.json` and a file of tensors for each stage."""

import json
from pathlib import Path
from typing import Any

import torch

from ..checks import did_you_mean
from ..errors import CheckpointError, InvalidInputError, TrainingError
from ..files import at_home, file_hash, read_text, write_json
from .checkpoint import load_state, load_tensors, save_tensors
from .configuration import GoalPolicyConfig, PathDiffuserConfig, PathPolicyConfig
from .goal_policy import GoalPolicy
from .hub import download, hub_name
from .path_diffuser import PathDiffuser
from .path_policy import PathPolicy
from .provenance import TrainingRecord

_FORMAT = 3

_STAGES: dict[str, Any] = {
    "path": (PathDiffuserConfig, PathDiffuser),
    "policy": (PathPolicyConfig, PathPolicy),
    "goal": (GoalPolicyConfig, GoalPolicy),
}
"""The settings and the network of each stage; `goal` is the baselines' one stage."""

_WEIGHTS = Path(__file__).parent.parent / "weights"


def pretrained_folder(name_or_folder: str | Path, revision: str | None = None) -> Path:
    """The folder of the weights, downloaded if they are on the Hugging Face Hub.

    Args:
        name_or_folder: a name that the package knows, a folder, or a repository on the Hub,
            `USER/REPOSITORY` or `USER/REPOSITORY@REVISION`. What is here comes first.
        revision: of a repository, a branch, a tag or a commit; its main branch if not given.

    Raises:
        CheckpointError: there is none of these; `HubError`, if the Hub says so.
        InvalidInputError: a revision is given of weights that are here.
    """
    names = sorted({name for stage in _STAGES for name in pretrained_names(stage)})
    name, folder = str(name_or_folder), at_home(name_or_folder)
    folder = _WEIGHTS / name if name in names else folder
    if folder.is_dir():
        if revision is not None:
            raise InvalidInputError(
                f"revision is for the Hugging Face Hub, but {name} is here, got {revision!r}"
            )
        return folder
    base, at, own = name.partition("@")
    if at and (base in names or at_home(base).is_dir()):
        return pretrained_folder(base, own)  # which says that it has no revisions
    repository = hub_name(name, revision) if isinstance(name_or_folder, str) else None
    if repository is not None:
        return download(*repository)
    raise CheckpointError(
        f"there are no weights {name!r}: give a folder, USER/REPOSITORY on the Hugging Face Hub "
        f"or one of {', '.join(names)}{did_you_mean(name_or_folder, names)}"
    )


def pretrained_names(stage: str = "path") -> list[str]:
    """Names of the weights that came with the package and have a `stage`, see `load_stages`."""
    return sorted(f.parent.name for f in _WEIGHTS.glob(f"*/{stage}.safetensors"))


def save_stage(
    folder: str | Path, stage: str, model: torch.nn.Module, training: TrainingRecord | None
) -> None:
    """Write the weights of one stage to `folder` and its entry to `config.json` there.

    Parameters are stored in float16, buffers as they are; networks compute in float32.

    Args:
        folder: of the model; its other stages stay.
        stage: `path`, `policy` or `goal`.
        model: the network.
        training: how it was made.

    Raises:
        TrainingError: a parameter is not finite in float16.
    """
    folder = at_home(folder)
    entries = _read_config(folder) if (folder / "config.json").exists() else {}
    weights = folder / f"{stage}.safetensors"
    halves = {name: parameter.detach().half() for name, parameter in model.named_parameters()}
    for name, tensor in halves.items():
        if not torch.isfinite(tensor).all():
            raise TrainingError(f"{name} of stage {stage} is not finite in float16")
    save_tensors(weights, {**model.state_dict(), **halves})
    entries[stage] = {
        "config": model.config.to_dict(),  # pyright: ignore
        "sha256": file_hash(weights),
        "training": training and training.to_dict(),
    }
    write_json(folder / "config.json", {"format": _FORMAT, **dict(sorted(entries.items()))})


def load_stages(folder: Path) -> tuple[dict[str, Any], dict[str, TrainingRecord | None]]:
    """The networks in `folder` by stage, and how each was trained.

    Raises:
        CheckpointError: there are none, or they are corrupted.
    """
    entries = _read_config(folder)
    stages = {name: _load_stage(folder, name, entry) for name, entry in entries.items()}
    return stages, training_records(folder)


def training_records(folder: Path) -> dict[str, TrainingRecord | None]:
    """How each stage in `folder` was trained; None where that is not known.

    Raises:
        CheckpointError: there is no configuration, or it is not one of ours.
    """
    try:
        return {
            name: None if record is None else TrainingRecord.from_dict(record)
            for name, entry in _read_config(folder).items()
            for record in [entry["training"]]
        }
    except (TypeError, KeyError, AttributeError) as cause:
        raise CheckpointError(
            f"{folder}/config.json has another training record: {cause}"
        ) from cause


def _read_config(folder: Path) -> dict[str, Any]:
    """The entries of the stages in `config.json`, checked for their form."""
    text = read_text(folder / "config.json", "model configuration", CheckpointError)
    try:
        content = json.loads(text)
        if content.pop("format") != _FORMAT:
            raise _of_another_version(folder, f"its format is not {_FORMAT}")
        for name, entry in content.items():
            if name not in _STAGES or set(entry) != {"config", "sha256", "training"}:
                raise CheckpointError(
                    f"{folder}/config.json has an entry {name!r} that is not ours"
                )
    except CheckpointError:
        raise
    except (ValueError, KeyError, TypeError, AttributeError) as cause:
        raise CheckpointError(f"{folder} has no model configuration: {cause!r}") from cause
    return content


def _of_another_version(folder: Path, reason: str) -> CheckpointError:
    """The error for weights that this version does not read."""
    return CheckpointError(
        f"the weights in {folder} are of another version of legibility ({reason}): use those that "
        "came with the package, or train new ones with `legibility data` and `legibility train`"
    )


def _load_stage(folder: Path, name: str, entry: dict[str, Any]) -> Any:
    config_type, network = _STAGES[name]
    try:
        config = config_type.from_dict(entry["config"])
        with torch.device("cpu"):  # in float32 on the CPU, whatever PyTorch's defaults
            model = network(config).float()
    except (CheckpointError, InvalidInputError) as cause:
        raise _of_another_version(folder, str(cause)) from cause
    except (KeyError, TypeError, ValueError, RuntimeError) as cause:
        raise CheckpointError(f"{folder} has no model configuration: {cause!r}") from cause
    weights = folder / f"{name}.safetensors"
    load_state(model, load_tensors(weights)[0], weights)
    if file_hash(weights) != entry["sha256"]:
        raise CheckpointError(f"{weights} is not the file that {folder / 'config.json'} names")
    return model
