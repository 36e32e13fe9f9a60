"""A dataset in the files of other programs: CSV, tensors, or a folder of LeRobot."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv as pc
from safetensors.numpy import save

from ..checks import one_of
from ..envs import vector_type
from ..errors import DatasetError
from ..files import at_home, atomic_folder, write_bytes
from ..scene import Scene
from .configuration import FORMATS
from .dataset import LABEL_KNOTS, Dataset
from .demonstrations import DEMONSTRATIONS, Demonstrations
from .lerobot import write_lerobot
from .recordings import AXES


def export(source: str | Path, form: str, folder: str | Path) -> list[Path]:
    """Write a dataset and its demonstrations in another format; return the files.

    Args:
        source: folder of the dataset.
        form: one of `FORMATS` of `data.configuration`; `lerobot` needs demonstrations.
        folder: to be made, or empty.

    Raises:
        DatasetError: there is no complete dataset, or no demonstrations for `lerobot`.
        InvalidInputError: there is no such format.
        OutputError: the folder is there and not empty, or cannot be written.
    """
    one_of("export", form, FORMATS)
    source, folder = at_home(source), at_home(folder)
    dataset, shown = Dataset.load(source), None
    if (source / DEMONSTRATIONS).exists():
        shown = Demonstrations.load(source)
    with atomic_folder(folder) as made:
        if form == "csv":
            _write_csv(dataset, shown, made)
        elif form == "torch":
            _write_tensors(dataset, shown, made)
        elif shown is None:
            raise DatasetError(
                f"{source} has no demonstrations, which are what LeRobot learns from: make some by "
                "`legibility data --demonstrations N`"
            )
        else:
            write_lerobot(dataset, shown, made)
        names = sorted(file.relative_to(made) for file in made.rglob("*") if file.is_file())
    return [folder / name for name in names]


def scene_arrays(scenes: Sequence[Scene]) -> dict[str, np.ndarray]:
    """Starts and goals of scenes; `G` is the most goals of one.

    Returns:
        `starts (S, D)` and `goals (S, G, D)` [m] float32, the target first, 0 where a scene has no
        more; `goal_mask (S, G)`, whether there is a goal.
    """
    sizes = np.array([scene.num_goals for scene in scenes])
    mask = np.arange(sizes.max()) < sizes[:, None]
    goals = np.zeros((*mask.shape, scenes[0].dim), np.float32)
    goals[mask] = np.concatenate([scene.goals for scene in scenes])
    starts = np.stack([scene.start for scene in scenes]).astype(np.float32)
    return {"starts": starts, "goals": goals, "goal_mask": mask}


def _write_tensors(dataset: Dataset, shown: Demonstrations | None, folder: Path) -> None:
    """`dataset.safetensors` and `demonstrations.safetensors`, with their texts as metadata."""
    arrays = {
        **scene_arrays(dataset.scenes),
        **{
            name: getattr(dataset, name)
            for name in ("controls", "waypoints", "scores", "labels", "score_at_label")
            if getattr(dataset, name) is not None
        },
        "label_knots": LABEL_KNOTS,
    }
    texts = {
        "config": dataset.config.to_dict(),
        "scenes": [scene.to_dict() for scene in dataset.scenes],
        "observers": [observer.to_dict() for observer in dataset.observers],
    }
    _write_arrays(folder / "dataset.safetensors", arrays, texts)
    if shown is not None:
        moved = {
            "states": np.concatenate(shown.states).astype(np.float32),
            "actions": np.concatenate(shown.actions).astype(np.float32),
            "steps": np.array([len(actions) for actions in shown.actions]),
            "scenes": shown.scenes,
            "paths": shown.paths.astype(np.float32),
            "labels": shown.labels.astype(np.float32),
            "pushed": shown.pushed,
        }
        _write_arrays(folder / "demonstrations.safetensors", moved, {"limit": shown.limit})


def _write_arrays(file: Path, arrays: dict[str, np.ndarray], texts: dict[str, Any]) -> None:
    metadata = {name: json.dumps(value) for name, value in texts.items()}
    plain = {name: np.ascontiguousarray(array) for name, array in arrays.items()}
    write_bytes(file, save(plain, metadata=metadata))


def _write_csv(dataset: Dataset, shown: Demonstrations | None, folder: Path) -> None:
    """`scenes.csv`, `trajectories.csv`, a row a point, and `demonstrations.csv`, a row a state."""
    views, axes = dataset.config.views, AXES[: dataset.config.dim]
    size, number = dataset.labels.shape
    rows = np.arange(size)
    _write_table(folder / "scenes.csv", {
        "row": rows,
        "scene": rows // views,
        "view": rows % views,
        "scene_json": [json.dumps(scene.to_dict()) for scene in dataset.scenes],
        "observer_json": [json.dumps(observer.to_dict()) for observer in dataset.observers],
        **dataset.summary,
    })  # fmt: skip
    inner = dataset.waypoints
    starts, goals = (
        np.broadcast_to(np.stack(ends)[:, None, None], (size, number, 1, len(axes)))
        for ends in ([s.start for s in dataset.scenes], [s.goals[0] for s in dataset.scenes])
    )
    points = np.concatenate([starts.astype(np.float32), inner, goals.astype(np.float32)], axis=2)
    trajectory, per = np.arange(size * number), points.shape[2]
    _write_table(folder / "trajectories.csv", {
        "row": np.repeat(rows, number * per),
        "trajectory": np.repeat(trajectory, per),
        "label": np.repeat(dataset.labels.ravel(), per),
        "score": np.repeat(dataset.scores.ravel(), per),
        "point": np.tile(np.arange(per), size * number),
        **dict(zip(axes, points.reshape(-1, len(axes)).T, strict=True)),
    })  # fmt: skip
    if shown is None:
        return
    lengths = np.array([len(states) for states in shown.states])
    each = np.repeat(np.arange(len(lengths)), lengths)
    step = np.arange(len(each)) - (np.cumsum(lengths) - lengths)[each]
    rate = vector_type(None, dataset.config.dim).metadata["render_fps"]
    none = np.full((1, len(axes)), np.nan)  # is sent in the last state
    sent = np.concatenate([part for actions in shown.actions for part in (actions, none)])
    states, sent = np.concatenate(shown.states).astype(np.float32), sent.astype(np.float32)
    _write_table(folder / "demonstrations.csv", {
        "trajectory": each,
        "scene": shown.scenes[each],
        "label": shown.labels[each].astype(np.float32),
        "pushed": shown.pushed[each],
        "t": step / rate,
        **dict(zip(axes, states.T, strict=True)),
        **{
            f"action_{axis}": pa.array(component, from_pandas=True)
            for axis, component in zip(axes, sent.T, strict=True)
        },
    })  # fmt: skip


def _write_table(file: Path, columns: dict[str, Any]) -> None:
    with pa.BufferOutputStream() as buffer:
        pc.write_csv(pa.table(columns), buffer)
        write_bytes(file, buffer.getvalue().to_pybytes())
