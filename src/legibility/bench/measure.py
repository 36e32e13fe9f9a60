"""The measurements of the bench, robust to background load; rows are those of `run_bench`."""

import itertools
import json
import os
import platform
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import joblib
import numpy as np
import torch

from ..data.configuration import DatasetConfig, SceneStream
from ..data.dataset import Dataset, generate
from ..envs import vector_type
from ..errors import MissingExtraError, WorkerError
from ..modulator import BACKENDS, Modulator
from ..motion.archive import build_archive
from ..parallel import threads
from ..scene import Scene
from ..seeds import stream_seed
from ..training.configuration import PathTrainingConfig
from ..training.loop import Run
from ..training.path import train_path
from ..training.team import Team, choose_device
from .configuration import BenchConfig

Rows = list[dict[str, Any]]
Backends = dict[str, Modulator]
Work = Callable[[], list[float]]
"""Runs once and returns the durations of its repetitions [s]."""
Entry = tuple[str, dict[str, Any], Work, int | None]
"""A metric, its conditions, the work to time, and the number of items if the metric is a rate."""

_GOALS = 4
_SCENES = 100
_KNOWN = 4  # scenes in which plans were made before
_WARM_UP = 8  # training steps until memory is allocated

# Peak memory is that of /proc: `resource` counts the parent's memory at the fork too.
_CHILD = """
import json, re, sys, time
times = [time.perf_counter()]
import legibility
times.append(time.perf_counter())
modulator = legibility.Modulator.from_pretrained(sys.argv[1], backend=sys.argv[2])
times.append(time.perf_counter())
import numpy
scene = legibility.Scene.random(numpy.random.default_rng(0), dim=modulator.config.dim, num_goals=4)
modulator.plan(scene, 0, 0.5)
times.append(time.perf_counter())
names = ["import_ms", "load_ms", "first_plan_ms"]
metrics = {n: 1e3 * (b - a) for n, a, b in zip(names, times, times[1:])}
try:
    with open("/proc/self/status") as file:
        metrics["memory_mb"] = int(re.search(r"VmHWM:\\s+(\\d+) kB", file.read())[1]) / 1024
except OSError:
    pass
print(json.dumps(metrics))
"""


def machine(device: str) -> dict[str, Any]:
    """Processor, threads, device of training, version of PyTorch, and load average."""
    chosen = choose_device(device)
    try:
        lines = Path("/proc/cpuinfo").read_text()
    except OSError:
        lines = ""
    model = re.search(r"^model name\s*:\s*(.+)$", lines, re.MULTILINE)
    return {
        "cpu": model[1].strip() if model else platform.processor() or platform.machine(),
        "cores": joblib.cpu_count(),
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
    """Latency from scene to checked path by batch and number of goals, and on one core.

    Past obstacles a plan is quick, in scenes never seen before or in a few known ones, or exact, in
    known ones, whose archives are there.
    """
    sizes = dict.fromkeys([(b, _GOALS) for b in config.batches] + [(1, g) for g in config.goals])
    entries: list[Entry] = []
    for backend, model in backends.items():
        at = {"model": name, "backend": backend}
        for batch, goals in sizes:
            plan = timed(_planning(model, batch, goals))
            entries.append(("plan_ms", {**at, "batch": batch, "goals": goals}, plan, None))
        alone = threads(1)(timed(_planning(model, 1, _GOALS)))
        entries.append(("plan_one_core_ms", at, alone, None))
        for mode, scene in (("quick", "new"), ("quick", "known"), ("exact", "known")):
            plan = threads(1)(timed(_planning_past_obstacles(model, mode, scene == "known")))
            asked = {**at, "mode": mode, "scene": scene}
            entries.append(("plan_obstacles_ms", asked, plan, None))
    return _measured(entries, config)


def motions(name: str, backends: Backends, config: BenchConfig) -> Rows:
    """Control steps of one robot on one core, and executed rollouts of many."""
    dim = backends["torch"].config.dim
    kind, scene = vector_type(None, dim), _scenes(dim, _GOALS)[0]
    robots, seeds = config.robots if dim == 2 else config.arms, itertools.count()

    def step(model: Modulator) -> list[float]:
        seed, env = next(seeds), kind(1)
        env.reset(seed=seed, options={"scene": scene})
        path = model.plan(scene, 0, 0.5, seed=seed)
        start = time.perf_counter()
        (rollout,) = model.execute_many(env, legibility=0.5, seed=seed, paths=[path])
        return [(time.perf_counter() - start) / len(rollout.actions)]

    def roll_out(model: Modulator) -> None:
        seed, env = next(seeds), kind(robots)
        env.reset(seed=seed, options={"scene": scene})
        model.execute_many(env, legibility=_levels(robots), seed=seed)
        env.close()

    entries: list[Entry] = []
    for backend, model in backends.items():
        at = {"model": name, "backend": backend}
        entries.append(("control_step_ms", at, threads(1)(partial(step, model)), None))
        entries.append(("rollouts_per_second", at, timed(partial(roll_out, model)), robots))
    return _measured(entries, config)


def data(dim: int, config: BenchConfig) -> Rows:
    """One archive, and a dataset by one process."""
    scene = _scenes(dim, _GOALS)[0]
    archive, candidates = timed(lambda: build_archive(scene)), build_archive(scene).num_candidates
    entries: list[Entry] = [
        ("archive_ms", {"dim": dim}, archive, None),
        ("candidates_per_second", {"dim": dim}, archive, candidates),
        ("scenes_per_second", {"dim": dim}, timed(lambda: _dataset(dim, config)), config.dataset),
    ]
    return _measured(entries, config)


def training(dim: int, config: BenchConfig) -> Rows:
    """Steps of stage 1 by `train_path` of 128 scenes × 8 trajectories, in float32 and bf16."""
    scenes, device = _dataset(dim, config), choose_device(config.device)
    settings = PathTrainingConfig(steps=_WARM_UP + config.training_steps + 1, scenes=128)

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

    entries: list[Entry] = [
        ("training_steps_per_second", {"dim": dim, "precision": n}, partial(train, precision), 1)
        for n, precision in (("float32", "no"), ("bf16", "bf16"))
    ]
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


def _measured(entries: list[Entry], config: BenchConfig, *, warm_up: bool = True) -> Rows:
    """Rows in milliseconds, or in items a second where an entry has a number of them."""
    works = [work for _, _, work, _ in entries]
    times = interleaved(works, config.seconds, config.rounds, warm_up=warm_up)
    rows: Rows = []
    for (metric, at, _, number), durations in zip(entries, times, strict=True):
        values = [number / t if number else 1e3 * t for t in durations]
        rows.append({"metric": metric, **at, **summary(values)})
    return rows


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


@cache
def _scenes_with_obstacles(dim: int) -> list[Scene]:
    stream = SceneStream("evaluation", dim, "obstacles", (_GOALS, _GOALS))
    return [stream.scene(index) for index in range(_SCENES)]


def _planning_past_obstacles(modulator: Modulator, mode: str, known: bool) -> Callable[[], object]:
    """Plan one path past one to four obstacles, each time in the next scene."""
    scenes, seeds = _scenes_with_obstacles(modulator.config.dim), itertools.count()
    exact, drawn = mode == "exact", itertools.count()
    if known:
        scenes = scenes[:_KNOWN]
        for scene in scenes:
            modulator.plan(scene, exact=exact)

    def plan() -> object:
        turn = next(drawn)
        scene = scenes[turn % len(scenes)]
        if not known:  # moved by a hair in every turn it is another scene
            start = scene.start + 1e-6 * turn * (scene.goals[0] - scene.start)
            scene = replace(scene, start=start)
        return modulator.plan(scene, 0, 0.5, seed=next(seeds), exact=exact)

    return plan


def _dataset(dim: int, config: BenchConfig) -> Dataset:
    with tempfile.TemporaryDirectory() as folder:
        return generate(DatasetConfig(dim=dim, scenes=config.dataset), Path(folder) / "data")


def process_metrics(model: str, backend: str) -> dict[str, float]:
    """Metrics of one process, `memory_mb` on Linux only, on as many threads as PyTorch has here.

    Raises:
        WorkerError: the process failed.
    """
    run = subprocess.run(
        [sys.executable, "-P", "-W", "ignore", "-c", _CHILD, model, backend],
        env={**os.environ, "OMP_NUM_THREADS": str(torch.get_num_threads())},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    if run.returncode:
        reason = (run.stderr.strip().splitlines() or ["it wrote no error"])[-1]
        raise WorkerError(f"the process that loads {model} on {backend} failed: {reason}")
    return json.loads(run.stdout.splitlines()[-1])


def timed(call: Callable[[], object]) -> Work:
    """`call` as work of one repetition."""

    def work() -> list[float]:
        started = time.perf_counter()
        call()
        return [time.perf_counter() - started]

    return work


def interleaved(
    works: Sequence[Work], seconds: float, rounds: int, *, warm_up: bool = True
) -> list[list[float]]:
    """Durations [s] of each of `works`, which take turns: background load hits all alike.

    A turn lasts at least `seconds`, or one run. The run to warm up does not count.
    """
    if warm_up:
        for work in works:
            work()
    times: list[list[float]] = [[] for _ in works]
    for _ in range(rounds):
        for work, durations in zip(works, times, strict=True):
            started = time.perf_counter()
            durations += work()
            while time.perf_counter() - started < seconds:
                durations += work()
    return times


def summary(values: Sequence[float]) -> dict[str, Any]:
    """Median of `values`, its 95 % interval `low` to `high`, and their number, `calls`.

    The interval lies between two order statistics, which is exact for independent values of any
    distribution; for fewer than six values it is their range.
    """
    from scipy.stats import binom

    ordered = np.sort(np.asarray(values, dtype=np.float64))
    skipped = max(0, int(binom.ppf(0.025, len(ordered), 0.5)) - 1)
    return {
        "median": float(np.median(ordered)),
        "low": float(ordered[skipped]),
        "high": float(ordered[-1 - skipped]),
        "calls": len(ordered),
    }
