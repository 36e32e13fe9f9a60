"""Labelled trajectories on disk: random scenes and a choice from their archives, flat along ℓ.

A dataset is a folder with `manifest.json` and Parquet shards, a row for each observer of a scene.
Every scene has its seed, so the bytes are the same for any number of workers. Shards are written
atomically, so an interrupted run resumes.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa

from ..checks import Array, count
from ..curves import NUM_WAYPOINTS, arc_length, path_curve
from ..errors import InvalidInputError
from ..files import at_home
from ..intent.metrics import SCORE_POINTS
from ..intent.observer import Observer
from ..motion.archive import Archive
from ..motion.bezier import bezier_trajectories
from ..scene import Scene
from ..seeds import stream_seed
from .configuration import DatasetConfig
from .shards import SHARD, ShardProgress, flat, make_shards, read_shards, shard_bytes

if TYPE_CHECKING:
    from .trajectories import TorchTrajectories

LABEL_KNOTS = np.linspace(-1, 1, 65)
"""Labels at which a scene's scores are stored, from which a label is read off a score."""

_MANIFEST = "manifest.json"

NEAR = 0.1
"""Distance of ℓ within which trajectories leave no gap on the dial."""


def paths_of(archive: Archive) -> Array:
    """The trajectories as paths `(N, K + 2, D)` [m]: start, waypoints at equal arc length, goal."""
    return bezier_trajectories(archive.controls, NUM_WAYPOINTS + 2)


@dataclass(frozen=True, eq=False)
class Choice:
    """The trajectories of an archive as paths, to choose from for any observer.

    Scores and labels are those of the curve through a path's waypoints, which stands for the
    trajectory; paths whose curve touches anything are chosen only if all do.
    """

    archive: Archive
    controls: Array
    paths: Array
    curves: Array
    lengths: Array

    @classmethod
    def of(cls, archive: Archive) -> Choice:
        """The choice from `archive`."""
        paths = paths_of(archive)
        curves = path_curve(paths, SCORE_POINTS)
        keep = archive.scene.feasible(curves, archive.target)
        keep |= not keep.any()
        return cls(
            archive, archive.controls[keep], paths[keep], curves[keep], arc_length(curves[keep])
        )

    @np.errstate(under="ignore")
    def select(
        self, seen: Archive, wanted: Array, efficiency: float, rng: np.random.Generator
    ) -> dict[str, Array]:
        """Choose a path for each level of ℓ, short ones rather than long.

        Args:
            seen: the archive for an observer.
            wanted: levels `(num,)`, rising.
            efficiency: see `DatasetConfig`.
            rng: source of randomness.

        Returns:
            `controls (num, 4, D)`, `waypoints (num, K, D)`, `scores (num,)`, `labels (num,)`.
        """
        scores = seen.observer.score(self.curves, seen.scene, seen.target)
        labels = seen.label_of(scores)
        detour = self.lengths / np.linalg.norm(self.paths[0, -1] - self.paths[0, 0]) - 1

        order = np.argsort(labels, kind="stable")
        ranked, num = labels[order], len(wanted)
        # Candidates for a level: all within half a step, and four on either side at least.
        centre, size = np.searchsorted(ranked, wanted), len(order)
        low = np.minimum(np.searchsorted(ranked, wanted - 1 / num), np.maximum(centre - 4, 0))
        high = np.maximum(np.searchsorted(ranked, wanted + 1 / num), np.minimum(centre + 4, size))
        chosen = np.empty(num, dtype=np.intp)
        for i, (a, b) in enumerate(zip(low, high, strict=True)):
            candidates = order[a:b]
            excess = detour[candidates] - detour[candidates].min()
            weights = np.exp(-excess / (efficiency * max(abs(wanted[i]), 1e-3)))
            chosen[i] = rng.choice(candidates, p=weights / weights.sum())
        return {
            "controls": self.controls[chosen],
            "waypoints": self.paths[chosen, 1:-1],
            "scores": scores[chosen],
            "labels": labels[chosen],
        }


def _rows(config: DatasetConfig, index: int, recorded: Array | None) -> Iterator[dict[str, Any]]:
    """The rows of scene `index`, one for each observer.

    `recorded (M, K + 2, D)` [m] are the paths of recorded motions, if the choice is from these.
    """
    archive = config.archive(
        index, config.observer, cells=config.cells, max_candidates=config.candidates
    )
    scene, choice = archive.scene, Choice.of(archive)
    rng = np.random.default_rng(stream_seed(config.stream, config.seed, index, "choice"))
    for view in range(config.views):
        observer = config.observer_of(index, scene, config.observer, view)
        seen = archive.seen_by(observer) if view else archive
        if recorded is None:
            wanted = np.linspace(-1, 1, config.per_scene)
            chosen = choice.select(seen, wanted, config.efficiency, rng)
        else:
            chosen = _mixed(config, choice, seen, recorded, rng)
        yield {
            "scene": json.dumps(scene.to_dict()),
            "observer": json.dumps(observer.to_dict()),
            "elites": len(seen),
            "candidates": seen.num_candidates,
            "coverage": seen.coverage,
            "anchor_score": seen.anchor_score,
            "score_at_label": seen.score_of(LABEL_KNOTS),
            **{
                name: values.astype(np.int32 if name == "recorded" else np.float32).ravel()
                for name, values in chosen.items()
            },
        }


def _mixed(
    config: DatasetConfig, choice: Choice, seen: Archive, recorded: Array, rng: np.random.Generator
) -> dict[str, Array]:
    """Recorded paths `(M, K + 2, D)` [m], and up to a share `mix` from the archive.

    Each recorded one once, then those again that are next to equal steps of ℓ over their range; of
    too many, only the latter. The archive's are at levels of ℓ where the recorded leave gaps.
    """
    scores = seen.observer.score(path_curve(recorded, SCORE_POINTS), seen.scene, seen.target)
    labels = seen.label_of(scores)
    gaps = _gaps(labels, round(config.mix * config.per_scene))
    num = config.per_scene - len(gaps)
    chosen = np.arange(len(labels) if len(labels) <= num else 0)
    wanted = np.linspace(labels.min(), labels.max(), num - len(chosen))
    chosen = np.concatenate([chosen, np.abs(labels - wanted[:, None]).argmin(-1)])
    parts = [{
        "waypoints": recorded[chosen, 1:-1],
        "scores": scores[chosen],
        "labels": labels[chosen],
        "recorded": chosen,
    }]  # fmt: skip
    if len(gaps):
        filling = choice.select(seen, gaps, config.efficiency, rng)
        parts.append({**filling, "recorded": np.full(len(gaps), -1)})
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def _gaps(labels: Array, most: int) -> Array:
    """Levels from −1 to 1, rising, over `NEAR` from `labels` and each other: the farthest first.

    At most as many as asked for.
    """
    levels, found = np.linspace(-1, 1, 201), []
    apart = np.abs(levels - labels[:, None]).min(0)
    while len(found) < most and apart.max() > NEAR:
        found.append(levels[np.argmax(apart)])
        apart = np.minimum(apart, np.abs(levels - found[-1]))
    return np.sort(found)


def shard_names(config: DatasetConfig) -> list[str]:
    """File names of all shards of a dataset."""
    return [f"{config.stream}-{i:05d}.parquet" for i in range(-(-config.scenes // SHARD))]


@np.errstate(under="ignore")
def _shard(config: DatasetConfig, part: tuple[int, Sequence[Array | None]]) -> bytes:
    """The rows of some scenes: the index of the first, and the recorded paths in each, if any."""
    first, recorded = part
    rows = [row for i, paths in enumerate(recorded, first) for row in _rows(config, i, paths)]
    return shard_bytes(rows, config.to_dict())


def generate(
    config: DatasetConfig,
    folder: str | Path,
    *,
    recorded: Sequence[Array] | None = None,
    workers: int = 1,
    cluster: str | None = None,
    progress: ShardProgress = lambda done, total: None,
) -> Dataset:
    """Make the dataset in `folder`, or resume; the same bytes for any number of workers.

    Args:
        config: the settings.
        folder: of the dataset; made if it is missing.
        recorded: paths `(M, K + 2, D)` [m] of recorded motions in each scene, if `config` names the
            `recordings` that they are from.
        workers: processes on this machine, see `pool`.
        cluster: address of a Dask scheduler, see `pool`.
        progress: called with the number of shards done and that of all.

    Raises:
        DatasetError: the folder holds a dataset of another configuration.
        OutputError: the folder cannot be written.
        WorkerError: there are no workers, or they die again and again.
    """
    folder = at_home(folder)
    paths: Sequence[Array | None] = [None] * config.scenes if recorded is None else recorded
    if len(paths) != config.scenes or bool(config.recordings) != (recorded is not None):
        raise InvalidInputError(
            f"recorded paths must be given for each of the {config.scenes} scenes, and only if "
            f"recordings are named, got {len(paths)}"
        )
    rows = config.scenes * config.views
    counts = {"scenes": config.scenes, "trajectories": rows * config.per_scene}
    make_shards(
        folder, _MANIFEST, config.to_dict(), shard_names(config), partial(_shard, config), counts,
        source=lambda i: (i * SHARD, paths[i * SHARD : (i + 1) * SHARD]),
        workers=workers, cluster=cluster, progress=progress,
    )  # fmt: skip
    return Dataset.load(folder)


@dataclass(frozen=True, eq=False)
class Dataset:
    """A dataset in memory; `S` pairs of scene and observer, `N` trajectories each.

    Attributes:
        config: its settings.
        digest: hash over all shards, which names the data in a model card; `[:n]` behind it means
            the first n scenes.
        scenes: S, those of one archive side by side; the target is goal 0 in each.
        observers: S.
        controls: `(S, N, 4, D)` float32 [m], cubic Béziers; None with recorded motions.
        recorded: `(S, N)` int32, index of the recorded motion among those of its scene, −1 of one
            from the archive; None without recorded motions.
        waypoints: `(S, N, K, D)` float32 [m], between start and goal at equal arc length.
        scores: `(S, N)` float32, of the curve through start, waypoints and goal.
        labels: `(S, N)` float32.
        score_at_label: `(S, 65)` the scene's score at each of `LABEL_KNOTS`.
        summary: `(S,)` arrays by name: elites, candidates, coverage, anchor_score.
    """

    config: DatasetConfig
    digest: str
    scenes: list[Scene]
    observers: list[Observer]
    controls: np.ndarray | None
    recorded: np.ndarray | None
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
        if count("scenes", num) > self.config.scenes:
            raise InvalidInputError(f"the data have {self.config.scenes} scenes, {num} are asked")
        if num == self.config.scenes:
            return self
        rows = num * self.config.views
        arrays = ("scenes", "observers", "waypoints", "scores", "labels", "score_at_label")
        return Dataset(
            controls=None if self.controls is None else self.controls[:rows],
            recorded=None if self.recorded is None else self.recorded[:rows],
            config=replace(self.config, scenes=num, given=self.config.given[:num]),
            digest=f"{self.digest}[:{num}]",
            summary={name: values[:rows] for name, values in self.summary.items()},
            **{name: getattr(self, name)[:rows] for name in arrays},
        )

    def to_torch(self) -> TorchTrajectories:
        """The trajectories as a Dataset of PyTorch, whose samples are dicts of tensors."""
        from .trajectories import TorchTrajectories

        return TorchTrajectories(self)

    @classmethod
    def _of_table(cls, content: dict[str, Any], digest: str, table: pa.Table) -> Dataset:
        """The dataset of a manifest's configuration, and the rows of its shards."""
        config = DatasetConfig.from_dict(content)
        dim, size, num = config.dim, config.scenes * config.views, config.per_scene

        def dense(name: str, *shape: int) -> np.ndarray:
            return flat(table[name]).reshape(size, *shape)

        scenes: dict[str, Scene] = {}
        for text in (texts := table["scene"].to_pylist()):
            scenes[text] = scenes.get(text) or Scene.from_dict(json.loads(text))
        return cls(
            config=config,
            digest=digest,
            scenes=[scenes[text] for text in texts],
            observers=[
                Observer.from_dict(json.loads(text)) for text in table["observer"].to_pylist()
            ],
            controls=None if config.recordings else dense("controls", num, 4, dim),
            recorded=dense("recorded", num) if config.recordings else None,
            waypoints=dense("waypoints", num, NUM_WAYPOINTS, dim),
            scores=dense("scores", num),
            labels=dense("labels", num),
            score_at_label=dense("score_at_label", len(LABEL_KNOTS)),
            summary={
                name: table[name].to_numpy()
                for name in ("elites", "candidates", "coverage", "anchor_score")
            },
        )
