"""The bench's measurements; each function returns rows, see `run_bench`."""

from __future__ import annotations

import itertools
import os
import platform
import re
import tempfile
import time
from collections.abc import Callable, Mapping
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import torch

from ..data.configuration import DatasetConfig
from ..data.dataset import Dataset, generate
from ..envs import vector_type
from ..errors import MissingExtraError
from ..evaluation.execution import step_milliseconds
from ..modulator import BACKENDS, Modulator
from ..motion.archive import build_archive
from ..parallel import threads
from ..scene import Scene
from ..seeds import stream_seed
from ..training.configuration import PathTrainingConfig
from ..training.loop import Run
from ..training.path import train_path
from ..training.team import Team, choose_device
from .process import process_metrics
from .run import BenchConfig
from .timing import Work, interleaved, summary, timed

Rows = list[dict[str, Any]]
Backends = dict[str, Modulator]
Entry = tuple[dict[str, Any], Work, int | None]
"""The conditions of a row, the work to time, and its number of items if the metric is a rate."""

_GOALS = 4
_SCENES = 100  # more than the modulator caches
_WARM_UP = 8  # training steps until memory is allocated


def machine(device: str) -> dict[str, Any]:
    """Processor, threads, device of training, version of PyTorch, and load average."""
    chosen = choose_device(device)
    affinity = getattr(os, "sched_getaffinity", None)
    try:
        lines = Path("/proc/cpuinfo").read_text()
    except OSError:
        lines = ""
    model = re.search(r"^model name\s*:\s*(.+)$", lines, re.MULTILINE)
    return {
        "cpu": model[1].strip() if model else platform.processor() or platform.machine(),
        "cores": len(affinity(0)) if affinity else os.cpu_count(),
        "threads": torch.get_num_threads(),
        "device": torch.cuda.get_device_name(chosen) if chosen.type == "cuda" else "cpu",
        "torch": str(torch.__version__),
        "load": os.getloadavg()[0] if hasattr(os, "getloadavg") else None,
    }


def load(name: str, skipped: list[str]) -> Backends:
    """The model by each backend that is installed; reasons for the others go to `skipped`."""
    backends: Backends = {}
    for backend in BACKENDS:
        try:
            backends[backend] = Modulator.from_pretrained(name, backend=backend)
        except MissingExtraError as error:
            skipped.append(str(error))
    return backends


def plans(name: str, backends: Backends, config: BenchConfig) -> Rows:
    """Latency from scene to checked path by batch and number of goals, and on one core."""
    sizes = dict.fromkeys([(b, _GOALS) for b in config.batches] + [(1, g) for g in config.goals])
    entries: list[Entry] = []
    for backend, model in backends.items():
        at = {"model": name, "backend": backend}
        for batch, goals in sizes:
            plan = timed(_planning(model, batch, goals))
            entries.append(_entry("plan_ms", plan, {**at, "batch": batch, "goals": goals}))
        alone = threads(1)(timed(_planning(model, 1, _GOALS)))
        entries.append(_entry("plan_one_core_ms", alone, at))
    return _measured(entries, config)


def motions(name: str, backends: Backends, config: BenchConfig) -> Rows:
    """Control steps of one robot on one core, and executed rollouts of many."""
    dim = backends["torch"].config.dim
    kind, scene = vector_type(None, dim), _scenes(dim, _GOALS)[0]
    robots, seeds = config.robots if dim == 2 else config.arms, itertools.count()

    def step(model: Modulator) -> list[float]:
        return [step_milliseconds(model, scene, kind, repeats=1) / 1e3]

    def roll_out(model: Modulator) -> None:
        seed, env = next(seeds), kind(robots)
        env.reset(seed=seed, options={"scene": scene})
        model.execute_many(env, legibility=_levels(robots), seed=seed)
        env.close()

    entries: list[Entry] = []
    for backend, model in backends.items():
        at = {"model": name, "backend": backend}
        entries.append(_entry("control_step_ms", partial(step, model), at))
        rollouts = timed(partial(roll_out, model))
        entries.append(_entry("rollouts_per_second", rollouts, at, robots))
    return _measured(entries, config)


def data(dim: int, config: BenchConfig) -> Rows:
    """One archive, and a dataset by one process."""
    scene = _scenes(dim, _GOALS)[0]
    archive, candidates = timed(lambda: build_archive(scene)), build_archive(scene).num_candidates
    dataset = timed(lambda: _dataset(dim, config))
    entries = [
        _entry("archive_ms", archive, {"dim": dim}),
        _entry("candidates_per_second", archive, {"dim": dim}, candidates),
        _entry("scenes_per_second", dataset, {"dim": dim}, config.dataset),
    ]
    return _measured(entries, config)


def training(dim: int, config: BenchConfig) -> Rows:
    """Steps of stage 1 by `train_path` with its default batch, in float32 and bf16."""
    scenes, device = _dataset(dim, config), choose_device(config.device)
    settings = PathTrainingConfig(steps=_WARM_UP + config.training_steps + 1)

    def train(precision: str) -> list[float]:
        ends: list[float] = []

        def progress(*_: object) -> None:
            if device.type == "cuda":
                torch.cuda.synchronize(device)
            ends.append(time.perf_counter())

        with tempfile.TemporaryDirectory() as folder:
            team = Team.join(str(device), precision)
            train_path(scenes, scenes, Run(Path(folder), team, progress), settings)
        return np.diff(ends[_WARM_UP - 1 : -1]).tolist()  # the last step also validates

    entries: list[Entry] = []
    for name, precision in {"float32": "no", "bf16": "bf16"}.items():
        at, steps = {"dim": dim, "precision": name}, partial(train, precision)
        entries.append(_entry("training_steps_per_second", steps, at, 1))
    return _measured(entries, config, warm_up=False)


def processes(models: Mapping[str, Backends], config: BenchConfig) -> Rows:
    """Start-up and peak memory of a fresh process that loads a model and plans one path."""
    rows: Rows = []
    imports: list[float] = []
    for name, backend in [(n, b) for n, backends in models.items() for b in backends]:
        runs = [process_metrics(name, backend) for _ in range(config.rounds)]
        imports += [run.pop("import_ms") for run in runs]
        for metric in runs[0]:
            row = {"metric": metric, "model": name, "backend": backend}
            rows.append({**row, **summary([run[metric] for run in runs])})
    return [*rows, {"metric": "import_ms", **summary(imports)}]


def _entry(metric: str, work: Work, at: dict[str, Any], number: int | None = None) -> Entry:
    return {"metric": metric, **at}, work, number


def _measured(entries: list[Entry], config: BenchConfig, *, warm_up: bool = True) -> Rows:
    """Rows in milliseconds, or in items a second where an entry has a number of them."""
    works = [work for _, work, _ in entries]
    times = interleaved(works, config.seconds, config.rounds, warm_up=warm_up)
    return [
        {**row, **summary([number / t if number else 1e3 * t for t in durations])}
        for (row, _, number), durations in zip(entries, times, strict=True)
    ]


@cache
def _scenes(dim: int, goals: int) -> list[Scene]:
    seeds = [stream_seed("evaluation", 0, index, "scene") for index in range(_SCENES)]
    return [Scene.random(np.random.default_rng(s), dim=dim, num_goals=goals) for s in seeds]


def _levels(batch: int) -> np.ndarray:
    """ℓ `(batch,)` over the whole dial; a single one is 0.5."""
    return 2 * (np.arange(batch) + 0.75) / batch - 1


def _planning(modulator: Modulator, batch: int, goals: int) -> Callable[[], object]:
    """Plan `batch` paths, each time in the next scene."""
    scenes = itertools.cycle(_scenes(modulator.config.dim, goals))
    levels, seeds = _levels(batch), itertools.count()
    return lambda: modulator.plan(next(scenes), 0, levels, seed=next(seeds))


def _dataset(dim: int, config: BenchConfig) -> Dataset:
    with tempfile.TemporaryDirectory() as folder:
        return generate(DatasetConfig(dim=dim, scenes=config.dataset), Path(folder) / "data")
