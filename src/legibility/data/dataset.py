"""Labelled trajectories on disk: random scenes and a choice from their archives, flat along ℓ.

A dataset is a folder with `manifest.json` and Parquet shards, a row a scene. Every scene has its
seed, so the bytes are the same for any number of workers. Shards are written atomically, so an
interrupted run resumes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from ..checks import Array, count
from ..curves import NUM_WAYPOINTS, arc_length, path_curve
from ..errors import InvalidInputError
from ..files import at_home
from ..intent.metrics import SCORE_POINTS
from ..motion.archive import Archive
from ..motion.bezier import bezier_trajectories
from ..scene import Scene
from ..seeds import stream_seed
from .configuration import DatasetConfig
from .shards import SHARD, ShardProgress, flat, make_shards, read_shards, shard_bytes

LABEL_KNOTS = np.linspace(-1, 1, 65)
"""Labels at which a scene's scores are stored, from which a label is read off a score."""

_MANIFEST = "manifest.json"


def paths_of(archive: Archive) -> Array:
    """The trajectories as paths `(N, K + 2, D)` [m]: start, waypoints at equal arc length, goal."""
    return bezier_trajectories(archive.controls, NUM_WAYPOINTS + 2)


@np.errstate(under="ignore")
def select(
    archive: Archive, num: int, efficiency: float, rng: np.random.Generator
) -> dict[str, Array]:
    """Choose `num` trajectories at equal steps of ℓ from −1 to 1, short ones rather than long.

    Scores and labels are those of the curve through a path's waypoints, which stands for the
    trajectory; paths whose curve leaves the workspace are not chosen.

    Returns:
        `controls (num, 4, D)`, `waypoints (num, K, D)`, `scores (num,)`, `labels (num,)`.
    """
    paths = paths_of(archive)
    curves = path_curve(paths, SCORE_POINTS)
    keep = archive.scene.contains(curves).all(-1)
    paths, curves, controls = paths[keep], curves[keep], archive.controls[keep]
    scores = archive.observer.score(curves, archive.scene, archive.target)
    labels = archive.label_of(scores)
    detour = arc_length(curves) / np.linalg.norm(paths[0, -1] - paths[0, 0]) - 1

    order = np.argsort(labels, kind="stable")
    ranked = labels[order]
    wanted = np.linspace(-1, 1, num)
    # Candidates for a level: all within half a step, and four on either side at least.
    centre = np.searchsorted(ranked, wanted)
    low = np.minimum(np.searchsorted(ranked, wanted - 1 / num), np.maximum(centre - 4, 0))
    high = np.maximum(np.searchsorted(ranked, wanted + 1 / num), np.minimum(centre + 4, len(order)))
    chosen = np.empty(num, dtype=np.intp)
    for i, (a, b) in enumerate(zip(low, high, strict=True)):
        candidates = order[a:b]
        excess = detour[candidates] - detour[candidates].min()
        weights = np.exp(-excess / (efficiency * max(abs(wanted[i]), 1e-3)))
        chosen[i] = rng.choice(candidates, p=weights / weights.sum())
    return {
        "controls": controls[chosen],
        "waypoints": paths[chosen, 1:-1],
        "scores": scores[chosen],
        "labels": labels[chosen],
    }


def _row(config: DatasetConfig, index: int) -> dict[str, Any]:
    archive = config.archive(index, config.observer, config.cells)
    scene = archive.scene
    rng = np.random.default_rng(stream_seed(config.stream, config.seed, index, "choice"))
    chosen = select(archive, config.per_scene, config.efficiency, rng)
    return {
        "scene": index,
        "start": scene.start,
        "goals": scene.goals.ravel(),
        "workspace": scene.workspace.ravel(),
        "elites": len(archive),
        "candidates": archive.num_candidates,
        "coverage": archive.coverage,
        "straight_score": archive.straight_score,
        "score_at_label": archive.score_of(LABEL_KNOTS),
        **{name: values.astype(np.float32).ravel() for name, values in chosen.items()},
    }


def shard_names(config: DatasetConfig) -> list[str]:
    """File names of all shards of a dataset."""
    return [f"{config.stream}-{i:05d}.parquet" for i in range(-(-config.scenes // SHARD))]


@np.errstate(under="ignore")
def _shard(config: DatasetConfig, scenes: range) -> bytes:
    return shard_bytes([_row(config, i) for i in scenes], config.to_dict())


def generate(
    config: DatasetConfig,
    folder: str | Path,
    *,
    workers: int = 1,
    cluster: str | None = None,
    progress: ShardProgress = lambda done, total: None,
) -> Dataset:
    """Make the dataset in `folder`, or resume; the same bytes for any number of workers.

    Args:
        config: the settings.
        folder: of the dataset; made if it is missing.
        workers: processes on this machine, see `pool`.
        cluster: address of a Dask scheduler, see `pool`.
        progress: called with the number of shards done and that of all.

    Raises:
        DatasetError: the folder holds a dataset of another configuration.
        OutputError: the folder cannot be written.
        WorkerError: there are no workers, or they die again and again.
    """
    folder = at_home(folder)

    counts = {"scenes": config.scenes, "trajectories": config.scenes * config.per_scene}
    make_shards(
        folder, _MANIFEST, config.to_dict(), shard_names(config), partial(_shard, config), counts,
        source=lambda i: range(i * SHARD, min((i + 1) * SHARD, config.scenes)),
        workers=workers, cluster=cluster, progress=progress,
    )  # fmt: skip
    return Dataset.load(folder)


@dataclass(frozen=True, eq=False)
class Dataset:
    """A dataset in memory; `S` scenes, `N` trajectories a scene.

    Attributes:
        config: its settings.
        digest: hash over all shards, which names the data in a model card; `[:n]` behind it means
            the first n scenes.
        scenes: the S scenes; the target is goal 0 in each.
        controls: `(S, N, 4, D)` float32 [m], cubic Béziers.
        waypoints: `(S, N, K, D)` float32 [m], between start and goal at equal arc length.
        scores: `(S, N)` float32, of the curve through start, waypoints and goal.
        labels: `(S, N)` float32.
        score_at_label: `(S, 65)` the scene's score at each of `LABEL_KNOTS`.
        summary: `(S,)` arrays by name: elites, candidates, coverage, straight_score.
    """

    config: DatasetConfig
    digest: str
    scenes: list[Scene]
    controls: np.ndarray
    waypoints: np.ndarray
    scores: np.ndarray
    labels: np.ndarray
    score_at_label: Array
    summary: dict[str, np.ndarray]

    @classmethod
    def load(cls, folder: str | Path) -> Dataset:
        """Read a complete dataset, checking every shard's hash.

        Raises:
            DatasetError: it is missing, incomplete or changed since it was written.
        """
        return read_shards(at_home(folder), _MANIFEST, "legibility data", cls._of_table)

    def first(self, num: int) -> Dataset:
        """The first `num` scenes, the same as a dataset of `num` scenes.

        Raises:
            InvalidInputError: the dataset has fewer.
        """
        if count("scenes", num) > len(self.scenes):
            raise InvalidInputError(f"the data have {len(self.scenes)} scenes, {num} are asked")
        if num == len(self.scenes):
            return self
        arrays = ("scenes", "controls", "waypoints", "scores", "labels", "score_at_label")
        return Dataset(
            config=replace(self.config, scenes=num),
            digest=f"{self.digest}[:{num}]",
            summary={name: values[:num] for name, values in self.summary.items()},
            **{name: getattr(self, name)[:num] for name in arrays},
        )

    @classmethod
    def _of_table(cls, content: dict[str, Any], digest: str, table: pa.Table) -> Dataset:
        """The dataset of a manifest's configuration, and the rows of its shards."""
        config = DatasetConfig.from_dict(content)
        dim, size, num = config.dim, config.scenes, config.per_scene

        def dense(name: str, *shape: int) -> np.ndarray:
            return flat(table[name]).reshape(size, *shape)

        goals = [np.asarray(g).reshape(-1, dim) for g in table["goals"].to_pylist()]
        starts, corners = dense("start", dim), dense("workspace", 2, dim)
        return cls(
            config=config,
            digest=digest,
            scenes=[Scene(*args) for args in zip(starts, goals, corners, strict=True)],
            controls=dense("controls", num, 4, dim),
            waypoints=dense("waypoints", num, NUM_WAYPOINTS, dim),
            scores=dense("scores", num),
            labels=dense("labels", num),
            score_at_label=dense("score_at_label", len(LABEL_KNOTS)),
            summary={
                name: table[name].to_numpy()
                for name in ("elites", "candidates", "coverage", "straight_score")
            },
        )
