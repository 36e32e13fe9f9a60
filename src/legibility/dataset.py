"""Labelled trajectories on disk: random scenes and a choice from their archives, flat along ℓ.

A dataset is a folder with `manifest.json` and Parquet shards, a row a scene. Every scene comes from
a seed of its own, so the bytes are the same for any number of workers, and a shard is either whole
or not there, so an interrupted run goes on where it stopped.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from .checks import Array, bounded, count, positive, random_seed
from .curves import NUM_WAYPOINTS, arc_length, path_curve
from .errors import DatasetError, InvalidInputError
from .files import at_home
from .intent.labels import LABELS
from .intent.metrics import DEFAULT_ALPHA, SCORE_POINTS, legibility_score
from .motion.archive import DEFAULT_CELLS, Archive, build_archive
from .motion.bezier import bezier_trajectories
from .scene import DEFAULT_SIGMA, STREAMS, Scene, stream_seed
from .shards import SHARD, ShardProgress, flat, make_shards, read_shards, shard_bytes

__all__ = ["Dataset", "DatasetConfig", "generate", "select"]

LABEL_KNOTS = np.linspace(-1, 1, 65)
"""Labels at which a scene's scores are stored, so that a score can be read as a label later."""

VALIDATION_SCENES = 128

_MANIFEST = "manifest.json"


@dataclass(frozen=True)
class DatasetConfig:
    """What a dataset is made of; together with the code it fixes every byte.

    Attributes:
        dim: 2 or 3.
        scenes: how many random scenes.
        seed: of the scenes and their archives.
        stream: which seed stream the scenes are drawn from.
        goals: least and most goals of a scene.
        per_scene: trajectories chosen from each archive, at equal steps of ℓ.
        label: the label along which they are chosen, `anchored` or `rank`.
        efficiency: among trajectories of nearly the same ℓ, one whose length exceeds the shortest's
            by |ℓ| times this share of the straight line is chosen e times less often; ℓ = 0 is then
            the straight line, and no level takes a detour that it does not need.
        sigma: the observer's σ [m]; 0 means the default of the dimension.
        alpha: decay of the score's weight.
        cells: the archive's cells along each axis; 0 means the default of the dimension.
    """

    dim: int = 2
    scenes: int = 1000
    seed: int = 0
    stream: str = "train"
    goals: tuple[int, int] = (2, 6)
    per_scene: int = 129
    label: str = "anchored"
    efficiency: float = 0.1
    sigma: float = 0.0
    alpha: float = DEFAULT_ALPHA
    cells: int = 0

    def __post_init__(self) -> None:
        if self.dim not in tuple(DEFAULT_SIGMA):
            raise InvalidInputError(f"dim must be 2 or 3, got {self.dim!r}")
        count("scenes", self.scenes)
        random_seed("seed", self.seed)
        count("per_scene", self.per_scene, low=3)
        if self.stream not in STREAMS:
            raise InvalidInputError(
                f"stream must be one of {', '.join(STREAMS)}, got {self.stream!r}"
            )
        if self.label not in LABELS:
            raise InvalidInputError(f"label must be one of {', '.join(LABELS)}, got {self.label!r}")
        try:
            low, high = (count("goals", number, low=2) for number in self.goals)
        except (TypeError, ValueError):
            low, high = 1, 0
        if not low <= high <= 12:
            raise InvalidInputError(
                f"goals must be two integers from 2 to 12, rising, got {self.goals}"
            )
        object.__setattr__(self, "goals", (low, high))
        if bounded("sigma", self.sigma, 0) == 0:
            object.__setattr__(self, "sigma", DEFAULT_SIGMA[self.dim])
        if count("cells", self.cells, low=0) == 0:
            object.__setattr__(self, "cells", DEFAULT_CELLS[self.dim])
        positive("efficiency", self.efficiency)
        bounded("alpha", self.alpha, 0)
        count("cells", self.cells, low=2)

    def to_dict(self) -> dict[str, Any]:
        """Plain values for the manifest."""
        return {**asdict(self), "goals": list(self.goals)}

    @classmethod
    def from_dict(cls, content: dict[str, Any]) -> DatasetConfig:
        """The inverse of `to_dict`; unknown keys are refused."""
        unknown = set(content) - {f.name for f in fields(cls)}
        if unknown:
            raise DatasetError(f"unknown dataset settings {sorted(unknown)}")
        return cls(**{**content, "goals": tuple(content["goals"])})

    def for_validation(self) -> DatasetConfig:
        """The same of 128 scenes of the validation stream."""
        return replace(self, stream="validation", scenes=VALIDATION_SCENES)

    def scene(self, index: int) -> tuple[Scene, Archive]:
        """Scene `index` of this dataset and its archive; the target is goal 0."""
        rng = np.random.default_rng(stream_seed(self.stream, self.seed, index, "scene"))
        num_goals = int(rng.integers(self.goals[0], self.goals[1] + 1))
        scene = Scene.random(rng, dim=self.dim, num_goals=num_goals)
        archive = build_archive(
            scene,
            seed=stream_seed(self.stream, self.seed, index, "archive"),
            sigma=self.sigma,
            alpha=self.alpha,
            label=self.label,
            cells=self.cells,
        )
        return scene, archive

    @property
    def shard_names(self) -> list[str]:
        """File names of all shards."""
        return [f"{self.stream}-{i:05d}.parquet" for i in range(-(-self.scenes // SHARD))]


def paths_of(archive: Archive) -> Array:
    """The archive's trajectories as paths: start, 8 waypoints at equal arc length, goal.

    Returns:
        `(N, K + 2, D)` [m].
    """
    return bezier_trajectories(archive.controls, NUM_WAYPOINTS + 2)


@np.errstate(under="ignore")
def select(
    archive: Archive, num: int, efficiency: float, rng: np.random.Generator
) -> dict[str, Array]:
    """Choose `num` trajectories at equal steps of ℓ from −1 to 1, short ones rather than long.

    A path stands for its trajectory from here on, so what is labelled is the curve through its
    waypoints; paths whose curve leaves the workspace are not chosen.

    Returns:
        `controls (num, 4, D)`, `waypoints (num, K, D)`, `scores (num,)`, `labels (num,)`.
    """
    paths = paths_of(archive)
    curves = path_curve(paths, SCORE_POINTS)
    keep = archive.scene.contains(curves).all(-1)
    paths, curves, controls = paths[keep], curves[keep], archive.controls[keep]
    scores = legibility_score(curves, archive.field, archive.target, archive.alpha)
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
    scene, archive = config.scene(index)
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
    """Make the dataset in `folder`, or go on with it; the same bytes for any number of workers.

    Args:
        config: what to make.
        folder: where to; made if it is missing.
        workers: processes on this machine.
        cluster: address of a Dask scheduler, whose workers work instead; `local` starts a cluster
            of `workers` processes on this machine.
        progress: called with the shards done and all of them.

    Raises:
        DatasetError: the folder holds a dataset of another configuration.
        OutputError: the folder cannot be written.
        WorkerError: there are no workers, or they die again and again.
    """
    folder = at_home(folder)

    def scenes(number: int) -> range:
        return range(number * SHARD, min((number + 1) * SHARD, config.scenes))

    counts = {"scenes": config.scenes, "trajectories": config.scenes * config.per_scene}
    make_shards(
        folder, _MANIFEST, config.to_dict(), config.shard_names, partial(_shard, config), counts,
        source=scenes, workers=workers, cluster=cluster, progress=progress,
    )  # fmt: skip
    return Dataset.load(folder)


@dataclass(frozen=True, eq=False)
class Dataset:
    """A dataset in memory; `S` scenes, `N` trajectories a scene.

    Attributes:
        config: what it was made with.
        digest: hash over all shards, which names the data in a model card; `[:n]` behind it means
            their first n scenes.
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
        content, digest, table = read_shards(at_home(folder), _MANIFEST, "legibility data")
        try:
            config = DatasetConfig.from_dict(content)
            if table.num_rows != config.scenes:
                raise ValueError(f"{table.num_rows} rows for {config.scenes} scenes")
            return cls.of_table(config, digest, table)
        except (LookupError, TypeError, ValueError, pa.ArrowException) as cause:
            raise DatasetError(f"{folder} has a manifest that is not its own") from cause

    def first(self, num: int) -> Dataset:
        """The first `num` scenes, which are those of a dataset of `num` scenes.

        Raises:
            InvalidInputError: there are fewer.
        """
        if count("scenes", num) > len(self.scenes):
            raise InvalidInputError(f"the data have {len(self.scenes)} scenes, {num} are asked")
        if num == len(self.scenes):
            return self
        return Dataset(
            config=replace(self.config, scenes=num),
            digest=f"{self.digest}[:{num}]",
            scenes=self.scenes[:num],
            controls=self.controls[:num],
            waypoints=self.waypoints[:num],
            scores=self.scores[:num],
            labels=self.labels[:num],
            score_at_label=self.score_at_label[:num],
            summary={name: values[:num] for name, values in self.summary.items()},
        )

    @classmethod
    def of_table(cls, config: DatasetConfig, digest: str, table: pa.Table) -> Dataset:
        """The scenes of `table`, rows of this configuration's shards."""
        dim, size, num = config.dim, table.num_rows, config.per_scene

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
