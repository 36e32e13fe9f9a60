"""The kinds of work that the bench times and weighs, each as one call."""

from __future__ import annotations

import itertools
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch

from ..checks import Array
from ..curves import NUM_WAYPOINTS
from ..data.configuration import DatasetConfig
from ..data.dataset import Dataset, generate
from ..envs import vector_type
from ..models.configuration import PathDiffuserConfig
from ..models.diffusion import noise_schedule
from ..models.path_diffuser import PathDiffuser
from ..modulator import Modulator
from ..motion.archive import build_archive
from ..scene import Scene
from ..seeds import stream_seed
from ..training.configuration import PathTrainingConfig
from ..training.loop import train
from ..training.path import PathBatches
from ..training.team import Team
from .published import PublishedDiffuser
from .timing import Work

__all__ = [
    "SCENES_TRAINED",
    "archive",
    "bench_scene",
    "dataset",
    "drawing",
    "levels",
    "many_scenes",
    "on_device",
    "planning",
    "published",
    "rollouts",
    "settle",
    "training",
]

SCENES_TRAINED = 4
"""Scenes that a step of training draws its batch from; its time does not depend on them."""

_WARM_UP = 8  # steps of training until they have their memory
_NEVER = 1e-12
_FRESH = 100
_NEXT = itertools.count(0, _FRESH)
"""Each work plans in scenes of its own, in turns, more of them than a cache of parts keeps."""


def bench_scene(dim: int, goals: int = 4, index: int = 0) -> Scene:
    """A random scene of the evaluation stream."""
    rng = np.random.default_rng(stream_seed("evaluation", 0, index, "scene"))
    return Scene.random(rng, dim=dim, num_goals=goals)


def levels(batch: int) -> Array:
    """ℓ `(batch,)` all over the dial; one alone is 0.5."""
    return 2 * (np.arange(batch) + 0.75) / batch - 1


def planning(
    modulator: Modulator, batch: int = 1, *, goals: int = 4, candidates: int = 1
) -> Callable[[], object]:
    """Plan `batch` paths in a scene, another one each time, of which nothing is known yet.

    With candidates it is the same scene, as its archive is kept.
    """
    indices = [0] if candidates > 1 else range(next(_NEXT), next(_NEXT))
    places = itertools.cycle([bench_scene(modulator.config.dim, goals, i) for i in indices])
    asked, seeds = levels(batch), itertools.count()
    return lambda: modulator.plan(
        next(places), 0, asked, seed=next(seeds), num_candidates=candidates
    )


def drawing(modulator: Modulator, batch: int) -> Callable[[], object]:
    """Draw `batch` paths by stage 1 alone, in a scene whose conditions are there."""
    dim = modulator.config.dim
    conditions = modulator.path_diffuser.conditions([bench_scene(dim)], [0])
    asked = torch.from_numpy(levels(batch).astype(np.float32))
    noise = torch.randn(batch, NUM_WAYPOINTS, dim, generator=torch.Generator().manual_seed(0))

    @torch.inference_mode()
    def call() -> object:
        return modulator.sampler(conditions, asked, noise)

    return call


def many_scenes(modulator: Modulator, scenes: int) -> Callable[[], object]:
    """Plan a path in each of `scenes`, other ones each time, of which nothing is known yet."""
    first, groups = next(_NEXT), -(-_FRESH // scenes) + 1
    places = itertools.cycle(
        [
            [bench_scene(modulator.config.dim, index=first + i * scenes + j) for j in range(scenes)]
            for i in range(groups)
        ]
    )
    targets, seeds = [0] * scenes, itertools.count()
    return lambda: modulator.plan_many(next(places), targets, levels(scenes), seed=next(seeds))


def rollouts(modulator: Modulator, robots: int) -> Callable[[], object]:
    """Plan for `robots` in one scene and move them to their goals."""
    scene = bench_scene(modulator.config.dim)
    kind, seeds = vector_type(None, modulator.config.dim), itertools.count()

    def call() -> None:
        seed = next(seeds)
        env = kind(robots)
        env.reset(seed=seed, options={"scene": scene})
        modulator.execute(env, legibility=levels(robots), seed=seed)
        env.close()

    return call


def archive(dim: int, candidates: int | None = None) -> Callable[[], int]:
    """Build an archive and return how many curves were tried.

    Args:
        dim: D.
        candidates: how many at most, as long as new cells fill; as ever if not given.
    """
    scene = bench_scene(dim)
    if candidates is None:
        return lambda: build_archive(scene).num_candidates
    first = min(candidates, 4096)
    return lambda: (
        build_archive(
            scene, random_candidates=first, max_candidates=candidates, patience=_NEVER
        ).num_candidates
    )


def dataset(dim: int, scenes: int) -> Callable[[], Dataset]:
    """Make a dataset of `scenes` on disk by one process, and read it."""
    config = DatasetConfig(dim=dim, scenes=scenes, stream="evaluation")

    def call() -> Dataset:
        with tempfile.TemporaryDirectory() as folder:
            return generate(config, Path(folder) / "data")

    return call


def training(config: PathDiffuserConfig, team: Team, steps: int) -> Work:
    """Train stage 1 from nothing; the pieces are `steps` after a warm-up, without the last one."""
    settings = PathTrainingConfig(steps=_WARM_UP + steps + 1)
    model = PathDiffuser(config)
    model.signal.copy_(noise_schedule(config.diffusion_steps))
    batches = PathBatches(dataset(config.dim, SCENES_TRAINED)(), model, settings, team)
    model = model.to(team.device)
    model.spread.copy_(batches.spread(model))

    def work() -> list[float]:
        ends: list[float] = []

        def progress(*_: object) -> None:
            settle(team.device)
            ends.append(time.perf_counter())

        with tempfile.TemporaryDirectory() as folder:
            train(
                model, batches.loss, lambda _: {}, settings, folder,
                identity={}, team=team, progress=progress,
            )  # fmt: skip
        return np.diff(ends)[-steps - 1 : -1].tolist()

    return work


def published(
    model: PublishedDiffuser, batch: int, steps: int, device: torch.device
) -> Callable[[], None]:
    """Draw `batch` paths by the published configuration."""

    def call() -> None:
        model.sample(batch, steps)
        settle(device)

    return call


def on_device(modulator: Modulator, device: torch.device) -> Modulator:
    """A modulator whose stage 1 draws on `device`; all else stays on the CPU."""
    model = modulator.path_diffuser.to(device)
    draw = model.sample

    def sample(conditions, level, noise, **options):
        there = conditions.map(lambda x: x.to(device))
        return draw(there, level.to(device), noise.to(device), **options).cpu()

    model.sample = sample  # pyright: ignore[reportAttributeAccessIssue]
    return Modulator(model, modulator.path_policy, modulator.name)


def settle(device: torch.device) -> None:
    """Wait for what was started on a GPU."""
    if device.type == "cuda":
        torch.cuda.synchronize(device)
