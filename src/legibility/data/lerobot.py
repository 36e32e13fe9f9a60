"""The format LeRobotDataset v3: demonstrations are written in it, and motions read from it.

Its description is https://huggingface.co/docs/lerobot/lerobot-dataset-v3: `meta/info.json` names
the features, `data/` holds a row a frame in Parquet, `meta/episodes/` a row an episode.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from ..checks import Array
from ..curves import NUM_WAYPOINTS
from ..envs import vector_type
from ..errors import DatasetError
from ..files import at_home, atomic_path, read_text, write_json
from .dataset import Dataset
from .demonstrations import Demonstrations
from .recordings import AXES
from .shards import flat

VERSION = "v3.0"
"""Version of the format that is written; all of the same first number are read."""

_FILE = "chunk-000/file-000.parquet"
_QUANTILES = {"q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}
_LIMITS = {"chunks_size": 1000, "data_files_size_in_mb": 100, "video_files_size_in_mb": 200}
"""Number of files in a folder and sizes of files beyond which LeRobot begins another."""

_PANDAS = {
    "index_columns": ["task"],
    "column_indexes": [],
    "columns": [
        {"name": name, "field_name": name, "pandas_type": kind, "numpy_type": dtype,
         "metadata": None}
        for name, kind, dtype in (("task_index", "int64", "int64"), ("task", "unicode", "object"))
    ],
    "pandas_version": "2.0.0",
}  # fmt: skip
"""What tells pandas, with which LeRobot reads the tasks, that their texts are its index."""


class Episode(NamedTuple):
    """A recorded motion.

    Attributes:
        times: `(T,)` [s], rising.
        positions: `(T, D)` [m].
        task: the text of the task.
    """

    times: Array
    positions: Array
    task: str


def write_lerobot(dataset: Dataset, shown: Demonstrations, folder: Path) -> None:
    """Write the demonstrations of a dataset to `folder`, an episode each.

    Features of a frame, with G the most goals of a scene:

    * `observation.state` `(D,)`: the position [m];
    * `action` `(D,)`: the displacement [m] that the controller sends, 0 in the last frame;
    * `observation.environment_state` `(G D + 1,)`: the goals [m], the target first and the last one
      repeated up to G, and ℓ;
    * `path` `((K + 2) D,)`: start, waypoints and goal [m] of the path that is followed;
    * `legibility` `(1,)`: ℓ of that path.

    The task of an episode names its scene, whose number is its place in `meta/scenes.json`.
    """
    dim = dataset.config.dim
    scenes = dataset.scenes[:: dataset.config.views]
    rate = vector_type(None, dim).metadata["render_fps"]
    most = max(scene.num_goals for scene in scenes)
    goals = np.stack([
        np.pad(scene.goals, ((0, most - scene.num_goals), (0, 0)), mode="edge").ravel()
        for scene in scenes
    ])  # fmt: skip
    lengths = np.array([len(states) for states in shown.states])
    starts = np.cumsum(lengths) - lengths
    episode = np.repeat(np.arange(len(lengths)), lengths)
    frame = np.arange(len(episode)) - starts[episode]
    used, task = np.unique(shown.scenes, return_inverse=True)
    tasks = [f"reach goal 0 in scene {scene}" for scene in used]

    level = shown.labels[episode, None]
    sent = [part for actions in shown.actions for part in (actions, np.zeros((1, dim)))]
    axes = AXES[:dim]
    numbers = {
        "observation.state": np.concatenate(shown.states),
        "observation.environment_state": np.hstack([goals[shown.scenes][episode], level]),
        "action": np.concatenate(sent),
        "path": shown.paths.reshape(len(lengths), -1)[episode],
        "legibility": level,
        "timestamp": frame[:, None] / rate,
    }
    indices = {
        "frame_index": frame,
        "episode_index": episode,
        "index": np.arange(len(episode)),
        "task_index": task[episode],
    }
    names = {
        "observation.state": [*axes],
        "observation.environment_state": [*_names("goal", most, axes), "legibility"],
        "action": [*axes],
        "path": _names("point", NUM_WAYPOINTS + 2, axes),
    }
    frames = {name: value.astype(np.float32) for name, value in numbers.items()}
    frames |= {name: value[:, None].astype(np.int64) for name, value in indices.items()}

    info = {
        "codebase_version": VERSION,
        "robot_type": shown.config.arm or {2: "point", 3: "panda"}[dim],
        "total_episodes": len(lengths),
        "total_frames": len(episode),
        "total_tasks": len(tasks),
        **_LIMITS,
        "fps": rate,
        "splits": {"train": f"0:{len(lengths)}"},
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "video_path": None,
        "features": {
            name: {"dtype": str(value.dtype), "shape": [value.shape[1]], "names": names.get(name)}
            for name, value in frames.items()
        },
    }
    statistics = {
        name: {key: number.tolist() for key, number in _statistics(value).items()}
        for name, value in frames.items()
    }
    file = np.zeros(len(lengths), np.int64)
    episodes = {
        "episode_index": np.arange(len(lengths)),
        "tasks": pa.array([[tasks[number]] for number in task]),
        "length": lengths,
        "data/chunk_index": file,
        "data/file_index": file,
        "dataset_from_index": starts,
        "dataset_to_index": starts + lengths,
        **_statistics_of_episodes(frames, starts, lengths),
        "meta/episodes/chunk_index": file,
        "meta/episodes/file_index": file,
    }
    write_json(folder / "meta/info.json", info)
    write_json(folder / "meta/stats.json", statistics)
    write_json(folder / "meta/scenes.json", [scene.to_dict() for scene in scenes])
    table = pa.table({"task_index": np.arange(len(tasks)), "task": tasks})
    _write(folder / "meta/tasks.parquet", table, {"pandas": json.dumps(_PANDAS)})
    _write(folder / "meta/episodes" / _FILE, pa.table(episodes))
    _write(folder / "data" / _FILE, pa.table({n: _column(value) for n, value in frames.items()}))


def read_lerobot(
    folder: str | Path, feature: str = "observation.state", axes: Sequence[str] = ()
) -> list[Episode]:
    """The motions of a dataset in the format LeRobotDataset v3, in the order of its episodes.

    Args:
        folder: of the dataset, with `meta/info.json`.
        feature: whose components are positions [m].
        axes: names of the components that are x, y and in 3-D z; if not given, those with these
            names, or all components if there are two or three.

    Raises:
        DatasetError: the folder is no such dataset, is of another version or is damaged, or the
            feature holds no positions; the message names what there is.
    """
    folder = at_home(folder)
    text = read_text(folder / "meta/info.json", "information of a LeRobot dataset", DatasetError)
    try:
        info = json.loads(text)
        version, features = str(info["codebase_version"]), info["features"]
        if version.partition(".")[0] != VERSION.partition(".")[0]:
            raise DatasetError(
                f"{folder} is of version {version} of LeRobot's format, {VERSION} is read: convert "
                "it by LeRobot's own script"
            )
        chosen = _components(folder, features, feature, axes)
        frames = _read(
            folder / "data", "*/*.parquet", ["episode_index", "frame_index", "task_index", feature]
        )
        texts = _task_texts(_read(folder / "meta", "tasks.parquet"))
        positions = flat(frames[feature]).reshape(len(frames), -1)[:, chosen].astype(np.float64)
        episode, frame, task = (frames[name].to_numpy() for name in frames.column_names[:3])
        if len(frames) != info["total_frames"]:
            raise DatasetError(
                f"{folder} is damaged: it has {len(frames)} of {info['total_frames']} frames"
            )
        order = np.lexsort((frame, episode))
        numbers, first = np.unique(episode[order], return_index=True)
        motions = []
        for number, rows in zip(numbers, np.split(order, first[1:]), strict=True):
            if not np.isfinite(positions[rows]).all():
                raise DatasetError(f"{folder}, episode {number}: {feature} must be finite")
            if len(rows) < 2 or (np.diff(frame[rows]) <= 0).any():
                raise DatasetError(
                    f"{folder}, episode {number}: it needs at least 2 frames, rising"
                )
            times = frame[rows] / info["fps"]
            motions.append(Episode(times, positions[rows], texts[task[rows[0]]]))
        return motions
    except (
        LookupError, TypeError, ValueError, AttributeError, ArithmeticError, OSError,
        pa.ArrowException,
    ) as cause:  # fmt: skip
        raise DatasetError(f"{folder} is no whole LeRobot dataset: {cause!r}") from cause


def _components(
    folder: Path, features: dict[str, Any], feature: str, axes: Sequence[str]
) -> list[int]:
    """The components of a feature that are x, y and in 3-D z."""
    numeric = [
        name
        for name, entry in features.items()
        if entry["dtype"].startswith(("float", "int")) and entry["shape"][0] >= 2
    ]
    if feature not in numeric:
        kind = f" of type {features[feature]['dtype']}" if feature in features else ""
        raise DatasetError(
            f"{folder} has no positions in a feature {feature!r}{kind}: those of several numbers "
            f"are {', '.join(numeric) or 'none'}"
        )
    (size,), names = features[feature]["shape"], features[feature]["names"]
    if isinstance(names, dict):  # {"motors": [...]}, or the places of the names
        lists = [entry for entry in names.values() if isinstance(entry, list)]
        names = [name for entry in lists for name in entry] if lists else list(names)
    names = list(names or map(str, range(size)))
    axes = list(axes) or [axis for axis in AXES if axis in names]
    if len(axes) in (2, 3) and set(axes) <= set(names):
        return [names.index(axis) for axis in axes]
    if not axes and size in (2, 3):
        return list(range(size))
    raise DatasetError(
        f"{folder}: which components of {feature} are x, y and z must be named by axes, got "
        f"{', '.join(axes) or 'none'}; there are {', '.join(names)}"
    )


def _read(folder: Path, pattern: str, columns: list[str] | None = None) -> pa.Table:
    """The rows of all files; ParquetFile, as read_table takes the dot in a name for a path."""
    files = [pq.ParquetFile(file) for file in sorted(folder.glob(pattern))]
    if not files:
        raise DatasetError(f"there is no {folder / pattern}")
    tables = [file.read(columns) for file in files]
    return pa.concat_tables([table.select(columns) if columns else table for table in tables])


def _task_texts(tasks: pa.Table) -> dict[int, str]:
    """The text of each task; its column is the index of a pandas table, whose name may differ."""
    (name,) = set(tasks.column_names) - {"task_index"}
    return dict(zip(tasks["task_index"].to_pylist(), tasks[name].to_pylist(), strict=True))


def _names(what: str, number: int, axes: Sequence[str]) -> list[str]:
    return [f"{what}_{index}_{axis}" for index in range(number) for axis in axes]


def _column(values: np.ndarray) -> pa.Array:
    """`(T, n)` as a column of numbers, or of lists of n > 1 numbers."""
    flat, size = pa.array(values.ravel()), values.shape[1]
    return flat if size == 1 else pa.FixedSizeListArray.from_arrays(flat, size)


def _write(path: Path, table: pa.Table, metadata: Mapping[str, str] | None = None) -> None:
    with atomic_path(path) as temporary:
        pq.write_table(table.replace_schema_metadata(metadata), temporary, compression="snappy")


def _statistics(values: np.ndarray) -> dict[str, np.ndarray]:
    """What LeRobot normalizes by, over frames `(…, T, n)`: `(…, n)` each, but `count (…, 1)`."""
    quantiles = np.quantile(values, list(_QUANTILES.values()), axis=-2)
    return {
        "min": values.min(-2),
        "max": values.max(-2),
        "mean": values.mean(-2, dtype=np.float64),
        "std": values.std(-2, dtype=np.float64),
        "count": np.full((*values.shape[:-2], 1), values.shape[-2]),
        **dict(zip(_QUANTILES, quantiles, strict=True)),
    }


def _statistics_of_episodes(
    frames: Mapping[str, np.ndarray], starts: np.ndarray, lengths: np.ndarray
) -> dict[str, pa.Array]:
    """`_statistics` of each episode as columns of lists, those of equal length at a time."""
    found: dict[str, np.ndarray] = {}
    for length in np.unique(lengths):
        rows = np.flatnonzero(lengths == length)
        at = starts[rows, None] + np.arange(length)
        for name, values in frames.items():
            for key, numbers in _statistics(values[at]).items():
                column = f"stats/{name}/{key}"
                empty = np.empty((len(lengths), numbers.shape[-1]), numbers.dtype)
                found.setdefault(column, empty)[rows] = numbers
    return {
        name: pa.FixedSizeListArray.from_arrays(pa.array(numbers.ravel()), numbers.shape[1])
        for name, numbers in found.items()
    }
