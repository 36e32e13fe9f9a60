"""Demonstrations on disk: a feedback controller follows a dataset's paths in the environment.

They lie in the folder of their dataset, under the same rules, a row a demonstration.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from ..checks import Array
from ..curves import NUM_WAYPOINTS
from ..envs import vector_type
from ..envs.fleet import safe_actions
from ..errors import InvalidInputError
from ..motion.tracking import PathTracker, feedback_action
from ..robots.arm import Arm
from ..scene import DEFAULT_WORKSPACE, Scene
from ..seeds import stream_seed
from ..whole_arm import checked_arm
from .configuration import DatasetConfig, DemonstrationsConfig
from .dataset import Dataset
from .shards import SHARD, ShardProgress, flat, make_shards, read_shards, shard_bytes

DEMONSTRATIONS = "demonstrations.json"
"""File name of the manifest, beside that of the dataset."""

_Part = tuple[int, list[Scene], np.ndarray, np.ndarray]
"""Some scenes of a dataset: the index of the first, and their scenes, waypoints and labels."""


@dataclass(frozen=True, eq=False)
class Demonstrations:
    """Demonstrations in memory, `N` of them.

    Attributes:
        config: their settings.
        dataset: settings of the dataset whose paths they follow.
        digest: hash over all shards.
        workspace: `(2, D)` [m].
        limit: largest displacement of an action along each axis [m].
        scenes: `(N,)`, the index of each one's scene in the dataset.
        paths: `(N, K + 2, D)` [m], the paths that they follow.
        labels: `(N,)`, of the paths.
        states: N arrays `(T + 1, D)` [m].
        actions: N arrays `(T, D)` [m], as the controller sent them.
        pushed: `(N,)` bool.
    """

    config: DemonstrationsConfig
    dataset: DatasetConfig
    digest: str
    workspace: Array
    limit: float
    scenes: np.ndarray
    paths: Array
    labels: Array
    states: list[Array]
    actions: list[Array]
    pushed: np.ndarray

    def __len__(self) -> int:
        return len(self.states)

    @classmethod
    def load(cls, folder: str | Path) -> Demonstrations:
        """Read complete demonstrations from the folder of their dataset.

        Raises:
            DatasetError: they are missing, incomplete or changed since they were written.
        """
        command = "legibility data --demonstrations"
        return read_shards(Path(folder), DEMONSTRATIONS, command, cls._of_table)

    @classmethod
    def _of_table(cls, content: dict[str, Any], digest: str, table: pa.Table) -> Demonstrations:
        """The demonstrations of a manifest's configuration, and the rows of their shards."""
        dataset = DatasetConfig.from_dict(content["dataset"])

        def points(name: str, *shape: int) -> Array:
            return flat(table[name]).reshape(-1, *shape, dataset.dim).astype(np.float64)

        ends = np.cumsum([len(row) // dataset.dim for row in table["actions"]])[:-1]
        later = 1 + np.arange(len(ends))  # a motion has one state more than actions
        return cls(
            config=DemonstrationsConfig(
                **{f.name: content[f.name] for f in fields(DemonstrationsConfig)}
            ),
            dataset=dataset,
            digest=digest,
            workspace=np.array(content["workspace"]),
            limit=content["limit"],
            scenes=table["scene"].to_numpy(),
            paths=points("path", NUM_WAYPOINTS + 2),
            labels=table["label"].to_numpy().astype(np.float64),
            states=np.split(points("states"), ends + later),
            actions=np.split(points("actions"), ends),
            pushed=table["pushed"].to_numpy(),
        )


def demonstrate(
    folder: str | Path,
    config: DemonstrationsConfig,
    *,
    workers: int = 1,
    cluster: str | None = None,
    progress: ShardProgress = lambda done, total: None,
) -> Demonstrations:
    """Demonstrate paths of the dataset in `folder`, or resume; the same bytes for any workers.

    Args:
        folder: of the dataset.
        config: the settings.
        workers, cluster, progress: see `generate`.

    Raises:
        DatasetError: there is no complete dataset, or demonstrations of another configuration.
    """
    folder = Path(folder)
    data = Dataset.load(folder)
    source = data.config
    config, arm = config.within(source), checked_arm(config.arm, source.dim)
    scenes = config.demonstrated or source.scenes
    content = {
        **asdict(config),
        "arm": None if arm is None else arm.name,
        "dataset": source.to_dict(),
        "digest": data.digest,
        "limit": vector_type(None, source.dim).max_displacement,
        "workspace": np.array(DEFAULT_WORKSPACE[source.dim]).tolist(),
    }
    names = [f"demonstrations-{i:05d}.parquet" for i in range(-(-scenes // SHARD))]

    def part(number: int) -> _Part:
        first, views = number * SHARD, source.views
        rows = slice(first * views, min(first + SHARD, scenes) * views, views)
        return first, data.scenes[rows], data.waypoints[rows], data.labels[rows]

    make_shards(
        folder, DEMONSTRATIONS, content, names, partial(_shard, source, config, arm, content),
        {"scenes": scenes}, source=part, workers=workers, cluster=cluster, progress=progress,
    )  # fmt: skip
    return Demonstrations.load(folder)


@np.errstate(under="ignore")
def _shard(
    source: DatasetConfig,
    config: DemonstrationsConfig,
    arm: Arm | None,
    content: dict[str, Any],
    part: _Part,
) -> bytes:
    """Demonstrations in some scenes of the dataset `source`, `content` being their manifest's."""
    first, scenes, inner, labels = part
    size, number = len(scenes), config.demonstrations
    rngs = [
        np.random.default_rng(stream_seed(source.stream, source.seed, first + i, "demonstration"))
        for i in range(size)
    ]
    # Flat along ℓ, like the dataset: one path from each of equal parts of its levels.
    edges = np.linspace(0, source.per_scene, number + 1)
    chosen = [np.floor(rng.uniform(edges[:-1], edges[1:])).astype(np.intp) for rng in rngs]
    paths = np.concatenate([
        [np.concatenate([scenes[i].start[None], inner[i, j], scenes[i].goals[:1]]) for j in row]
        for i, row in enumerate(chosen)
    ])  # fmt: skip
    labels = np.take_along_axis(labels, np.stack(chosen), axis=1).ravel()
    pushed = np.concatenate([rng.random(number) < config.pushed for rng in rngs])
    seeds = [int(s) for rng in rngs for s in rng.integers(2**62, size=number)]
    repeated = [scene for scene in scenes for _ in range(number)]

    motions, success = _roll(config, arm, repeated, paths, pushed, seeds)
    rows = [
        {
            "scene": first + i // number,
            "label": np.float32(labels[i]),
            "path": paths[i].astype(np.float32).ravel(),
            "pushed": bool(pushed[i]),
            "states": states.astype(np.float32).ravel(),
            "actions": actions.astype(np.float32).ravel(),
        }
        for i, (states, actions) in enumerate(motions)
        if success[i]
    ]
    if not rows:
        raise InvalidInputError(
            f"no demonstration in scenes {first} to {first + size - 1} reached its goal; "
            "lower noise or push"
        )
    return shard_bytes(rows, content)


def _roll(
    config: DemonstrationsConfig,
    arm: Arm | None,
    scenes: list[Scene],
    paths: Array,
    pushed: np.ndarray,
    seeds: list[int],
) -> tuple[list[tuple[Array, Array]], np.ndarray]:
    """States and actions of the controller on `paths`, and whether it reached the goals."""
    kind: Any = vector_type(None, scenes[0].dim)
    env = kind(len(paths)) if arm is None else kind(len(paths), arm=arm)
    assert config.push is not None
    options = {"scene": scenes, "noise": config.noise, "push": (config.push * pushed).tolist()}
    observation, _ = env.reset(seed=seeds, options=options)
    tracker = PathTracker(paths, env.max_displacement, env.workspace)
    positions = previous = observation["position"]
    states, actions = [positions], []
    lengths = np.zeros(len(paths), dtype=np.intp)
    success = np.zeros(len(paths), dtype=bool)
    while not env.done.all():
        lengths += ~env.done
        sent = safe_actions(
            feedback_action(tracker, positions), positions, positions - previous,
            env.workspace, env.max_displacement, env.lag_range[1], env.barriers,
        )  # fmt: skip
        observation, _, success, _, _ = env.step(sent)
        previous, positions = positions, observation["position"]
        tracker.update(positions, previous)
        states.append(positions)
        actions.append(sent)
    motions = zip(np.stack(states, 1), np.stack(actions, 1), lengths, strict=True)
    return [(s[: n + 1], a[:n]) for s, a, n in motions], success
