"""Demonstrations on disk: a feedback controller follows a dataset's paths in the environment.

They lie in the folder of their dataset, under the same rules, a row a demonstration.
"""

from __future__ import annotations

import io
from dataclasses import asdict, dataclass, fields
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq

from ..checks import Array
from ..curves import NUM_WAYPOINTS
from ..envs import vector_type
from ..envs.fleet import safe_actions
from ..errors import DatasetError, InvalidInputError
from ..motion.tracking import PathTracker, feedback_action
from ..scene import DEFAULT_WORKSPACE
from ..seeds import stream_seed
from .configuration import DatasetConfig, DemonstrationsConfig
from .dataset import Dataset, shard_names
from .shards import SHARD, ShardProgress, flat, make_shards, read_shards, shard_bytes

DEMONSTRATIONS = "demonstrations.json"
"""File name of the manifest, beside that of the dataset."""


@dataclass(frozen=True, eq=False)
class Demonstrations:
    """Demonstrations in memory, `N` of them.

    Attributes:
        config: their settings.
        dataset: settings of the dataset whose paths they follow.
        digest: hash over all shards.
        workspace: `(2, D)` [m].
        limit: largest displacement of an action along each axis [m].
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
        content, digest, table = read_shards(
            Path(folder), DEMONSTRATIONS, "legibility data --demonstrations"
        )
        try:
            settings = {f.name: content[f.name] for f in fields(DemonstrationsConfig)}
            dataset = DatasetConfig.from_dict(content["dataset"])
            dim, limit = dataset.dim, content["limit"]
            workspace = np.array(content["workspace"])
            paths = flat(table["path"]).reshape(-1, NUM_WAYPOINTS + 2, dim).astype(np.float64)
            lengths = np.array([len(row) for row in table["actions"]]) // dim
            states = flat(table["states"]).reshape(-1, dim).astype(np.float64)
            actions = flat(table["actions"]).reshape(-1, dim).astype(np.float64)
        except (LookupError, TypeError, ValueError) as cause:
            raise DatasetError(f"{folder} has a manifest that does not fit its shards") from cause
        return cls(
            config=DemonstrationsConfig(**settings),
            dataset=dataset,
            digest=digest,
            workspace=workspace,
            limit=limit,
            paths=paths,
            labels=table["label"].to_numpy().astype(np.float64),
            states=np.split(states, np.cumsum(lengths + 1)[:-1]),
            actions=np.split(actions, np.cumsum(lengths)[:-1]),
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
        workers: processes on this machine.
        cluster: a Dask cluster, see `generate`.
        progress: called with the number of shards done and that of all.

    Raises:
        DatasetError: there is no complete dataset, or demonstrations of another configuration.
        OutputError: the folder cannot be written.
        WorkerError: there are no workers, or they die again and again.
    """
    folder = Path(folder)
    dataset, digest, _ = read_shards(folder, "manifest.json", "legibility data")
    source = DatasetConfig.from_dict(dataset)
    config = config.within(source)
    scenes = config.demonstrated or source.scenes
    env = vector_type(None, source.dim)
    content = {
        **asdict(config),
        "dataset": source.to_dict(),
        "digest": digest,
        "limit": env.max_displacement,
        "workspace": np.array(DEFAULT_WORKSPACE[source.dim]).tolist(),
    }
    names_of_data = shard_names(source)
    names = [f"demonstrations-{i:05d}.parquet" for i in range(-(-scenes // SHARD))]

    def first_scenes(number: int) -> tuple[int, int, bytes]:
        first = number * SHARD
        shard = (folder / names_of_data[number]).read_bytes()
        return first, min(SHARD, scenes - first), shard

    make_shards(
        folder, DEMONSTRATIONS, content, names, partial(_shard, source, config, content),
        {"scenes": scenes}, source=first_scenes,
        workers=workers, cluster=cluster, progress=progress,
    )  # fmt: skip
    return Demonstrations.load(folder)


@np.errstate(under="ignore")
def _shard(
    source: DatasetConfig,
    config: DemonstrationsConfig,
    content: dict[str, Any],
    first_scenes: tuple[int, int, bytes],
) -> bytes:
    """Demonstrations in the first scenes of a shard of the dataset.

    Args:
        source: settings of the dataset.
        config: settings of the demonstrations.
        content: of their manifest.
        first_scenes: index of the shard's first scene, number of its scenes to use, and its bytes.
    """
    first, size, shard = first_scenes
    part = Dataset.of_table(source, "", pq.read_table(io.BytesIO(shard)))
    rngs = [
        np.random.default_rng(stream_seed(source.stream, source.seed, first + i, "demonstration"))
        for i in range(size)
    ]
    # Flat along ℓ, like the dataset: one path from each of equal parts of its levels.
    edges = np.linspace(0, source.per_scene, config.demonstrations + 1)
    chosen = [np.floor(rng.uniform(edges[:-1], edges[1:])).astype(np.intp) for rng in rngs]
    repeated = [part.scenes[i] for i in range(size) for _ in range(config.demonstrations)]
    waypoints = np.concatenate([part.waypoints[i, chosen[i]] for i in range(size)])
    labels = np.concatenate([part.labels[i, chosen[i]] for i in range(size)])
    starts = np.stack([scene.start for scene in repeated])[:, None]
    goals = np.stack([scene.goals[0] for scene in repeated])[:, None]
    paths = np.concatenate([starts, waypoints, goals], axis=1)
    pushed = np.concatenate([rng.random(config.demonstrations) < config.pushed for rng in rngs])
    seeds = [int(s) for rng in rngs for s in rng.integers(2**62, size=config.demonstrations)]

    states, actions, success = _roll(config, repeated, paths, pushed, seeds)
    rows = [
        {
            "scene": first + i // config.demonstrations,
            "label": np.float32(labels[i]),
            "path": paths[i].astype(np.float32).ravel(),
            "pushed": bool(pushed[i]),
            "states": states[i].astype(np.float32).ravel(),
            "actions": actions[i].astype(np.float32).ravel(),
        }
        for i in range(len(paths))
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
    scenes: list[Any],
    paths: Array,
    pushed: np.ndarray,
    seeds: list[int],
) -> tuple[list[Array], list[Array], np.ndarray]:
    """States and actions of the controller on `paths`, and whether it reached each goal."""
    env = vector_type(None, scenes[0].dim)(len(paths))
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
            env.workspace, env.max_displacement, env.lag_range[1],
        )  # fmt: skip
        observation, _, success, _, _ = env.step(sent)
        previous, positions = positions, observation["position"]
        tracker.update(positions, previous)
        states.append(positions)
        actions.append(sent)
    motions = zip(np.stack(states, 1), np.stack(actions, 1), lengths, strict=True)
    cut = [(s[: n + 1], a[:n]) for s, a, n in motions]
    return [s for s, _ in cut], [a for _, a in cut], success
