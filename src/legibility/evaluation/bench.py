"""How fast it is here, beside the published configuration and the machine's own limit."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import torch

from ..checks import count, positive
from ..envs import vector_type
from ..errors import InvalidInputError, MissingExtraError
from ..modulator import BACKENDS, Modulator
from ..training.configuration import PathTrainingConfig
from ..training.team import Team, choose_device
from . import workloads
from .execution import step_milliseconds
from .footprint import footprint, import_seconds
from .machine import COPY_BYTES, PRODUCT_FLOPS, forward_cost, limits, load_average, machine_facts
from .published import DIFFERENCES, PublishedDiffuser
from .timing import Work, figure, interleaved, on_threads, power_law, rate, timed

__all__ = ["BenchConfig", "run_bench"]

Backends = dict[str, Modulator]


@dataclass(frozen=True)
class BenchConfig:
    """What is measured, and for how long.

    Attributes:
        seconds: spent on a measurement in a round, one call at least.
        rounds: of all measurements that are compared, in turns.
        device: where stage 1 draws and is trained, `cpu` or `cuda`; all else is on the CPU.
        threads: of PyTorch; those that it takes if not given.
        batches: paths planned at once in one scene.
        goals: of a scene in which one path is planned.
        candidates: drawn for one path.
        scenes: in each of which a path is planned at once.
        robots: moved at once in the plane.
        arms: moved at once.
        curves: tried for an archive.
        dataset: scenes of a dataset.
        training_steps: timed in a round.
        published: paths drawn at once by the published configuration.
        published_steps: of its sampler; fewer than its 100 only to try the bench out.
    """

    seconds: float = 0.2
    rounds: int = 3
    device: str = "cpu"
    threads: int | None = None
    batches: tuple[int, ...] = (1, 16, 64, 256, 1024)
    goals: tuple[int, ...] = (2, 4, 6, 12)
    candidates: tuple[int, ...] = (4, 16, 64)
    scenes: tuple[int, ...] = (1, 16, 64)
    robots: int = 256
    arms: int = 16
    curves: tuple[int, ...] = (4096, 8192, 16384)
    dataset: tuple[int, ...] = (1, 2, 4)
    training_steps: int = 16
    published: tuple[int, ...] = (1, 16, 64)
    published_steps: int = 100

    def __post_init__(self) -> None:
        positive("seconds", self.seconds)
        for name in ("rounds", "robots", "arms", "training_steps", "published_steps"):
            count(name, getattr(self, name))
        if self.threads is not None:
            count("threads", self.threads)
        if self.published_steps > 100:
            raise InvalidInputError(
                f"published_steps must be at most 100, got {self.published_steps}"
            )
        for name in ("batches", "goals", "candidates", "scenes", "curves", "dataset", "published"):
            sizes = getattr(self, name)
            if list(sizes) != sorted({count(name, size) for size in sizes}) or not sizes:
                raise InvalidInputError(f"{name} must be numbers that rise, got {sizes}")
        if self.goals[0] < 2 or self.goals[-1] > 12:
            raise InvalidInputError(f"goals must be from 2 to 12, got {self.goals}")


def run_bench(
    models: Sequence[str],
    config: BenchConfig | None = None,
    *,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> dict[str, Any]:
    """Measure `models` and all that makes them.

    Args:
        models: names of weights or folders; the published configuration is held against the first
            and those of its dimension.
        config: what is measured.
        progress: called with the parts done and all of them.

    Returns:
        `machine`: what it is and how busy;
        `skipped`: by what, why;
        `models`: of each its parameters, the `limit` of the machine at the time (operations and
        bytes a second), `floor` by batch (the operations and bytes that drawing needs, and the time
        that they cost at least), and by backend `growth` (times by batch, goals, candidates and
        scenes, with the exponent of a power law), `plan_one_core_ms`, `paths_per_second`, `draw_ms`
        (stage 1 alone), `over_floor` (that over the least), `step_ms` (a control step on one core,
        amortised over its chunk), `rollouts_per_second`, and `process` (start-up and memory);
        `published`: parameters, differences, times, and by model, backend and batch the `ratio` of
        its time to ours;
        `archive`, `dataset`, `training`: by dimension, how many a second, growth and memory;
        `import_ms`: of `import legibility` in a fresh process.
        A time is a median with a 95 % interval and the number of calls.
    """
    config = config or BenchConfig()
    if not models:
        raise InvalidInputError("models must be at least one, got none")
    device = choose_device(config.device)
    skipped: dict[str, str] = {}
    loaded = {name: _backends(name, device, skipped) for name in models}
    with on_threads(config.threads or torch.get_num_threads()):
        result: dict[str, Any] = {"machine": machine_facts(device), "skipped": skipped}
        parts: list[Callable[[], dict[str, Any]]] = []
        for name, backends in loaded.items():
            for measure in (_plans, _growth, _motions, _processes):
                parts.append(partial(measure, name, backends, config))
        firsts: dict[int, str] = {}
        for name, backends in loaded.items():
            firsts.setdefault(backends["torch"].config.dim, name)
        dim = next(iter(firsts))
        alike = {n: b for n, b in loaded.items() if b["torch"].config.dim == dim}
        parts.append(partial(_published, dim, alike, config, device))
        for dim, name in firsts.items():
            parts += [
                partial(_archive, dim, config),
                partial(_dataset, dim, config),
                partial(_training, name, loaded[name]["torch"], config, device),
            ]
        parts.append(partial(_imports, config))
        for done, part in enumerate(parts):
            progress(done, len(parts))
            _merge(result, part())
        progress(len(parts), len(parts))
        result["machine"]["load_after"] = load_average()
    return result


def _merge(result: dict[str, Any], part: dict[str, Any]) -> None:
    """Put a part into its place among those that are there."""
    for key, value in part.items():
        if isinstance(value, dict) and isinstance(result.get(key), dict):
            _merge(result[key], value)
        else:
            result[key] = value


def _backends(name: str, device: torch.device, skipped: dict[str, str]) -> Backends:
    """The model by each backend that can run here; why not goes to `skipped`."""
    found: Backends = {}
    for backend in BACKENDS:
        if backend == "onnx" and device.type != "cpu":
            skipped[backend] = "onnxruntime runs on the CPU here"
            continue
        try:
            model = Modulator.from_pretrained(name, backend=backend)
        except MissingExtraError as error:
            skipped[backend] = str(error)
            continue
        found[backend] = model if device.type == "cpu" else workloads.on_device(model, device)
    return found


def _parameters(modulator: Modulator) -> dict[str, int]:
    stages = {"path": modulator.path_diffuser, "policy": modulator.path_policy}
    return {
        name: sum(p.numel() for p in stage.parameters())
        for name, stage in stages.items()
        if stage is not None
    }


def _plans(name: str, backends: Backends, config: BenchConfig) -> dict[str, Any]:
    """One plan and batches by each backend, and in turns with them the machine's own limit."""
    works: dict[Any, Work] = {
        (backend, batch): timed(workloads.planning(model, batch))
        for backend, model in backends.items()
        for batch in config.batches
    }
    for backend, model in backends.items():
        works[backend, "one core"] = _alone(workloads.planning(model))
        for batch in config.batches:
            works[backend, "draw", batch] = timed(workloads.drawing(model, batch))
    stage = backends["torch"].path_diffuser
    works |= limits(stage.spread.device)
    times = interleaved(works, config.seconds, config.rounds)
    flops = max(
        (rate(times[name], PRODUCT_FLOPS) for name in ("product", "product otherwise")),
        key=lambda found: found["median"],
    )
    moved = rate(times["copy"], COPY_BYTES)
    floor: dict[str, dict[str, float]] = {}
    for batch in config.batches:
        cost = forward_cost(stage, batch)
        least = max(cost["flops"] / flops["median"], cost["bytes"] / moved["median"])
        floor[str(batch)] = {**cost, "ms": 1e3 * least}
    rows: dict[str, Any] = {}
    for backend in backends:
        plans = _curve({b: times[backend, b] for b in config.batches})
        draws = {str(b): figure(times[backend, "draw", b], 1e3) for b in config.batches}
        rows[backend] = {
            "plan_one_core_ms": figure(times[backend, "one core"], 1e3),
            "paths_per_second": {b: 1e3 * int(b) / p["median"] for b, p in plans["ms"].items()},
            "draw_ms": draws,
            "over_floor": {b: draw["median"] / floor[b]["ms"] for b, draw in draws.items()},
            "growth": {"batch": plans},
        }
    own = {
        "dim": backends["torch"].config.dim,
        "parameters": _parameters(backends["torch"]),
        "limit": {"flops_per_second": flops, "bytes_per_second": moved},
        "floor": floor,
        "backends": rows,
    }
    return {"models": {name: own}}


def _alone(call: Callable[[], object]) -> Work:
    """The work of `call` on one thread."""
    work = timed(call)

    def on_one() -> list[float]:
        with on_threads(1):
            return work()

    return on_one


def _growth(name: str, backends: Backends, config: BenchConfig) -> dict[str, Any]:
    """How the time of planning grows with what is asked."""
    axes: dict[str, tuple[tuple[int, ...], Callable[[Modulator, int], Callable[[], object]]]] = {
        "goals": (config.goals, lambda m, n: workloads.planning(m, goals=n)),
        "candidates": (config.candidates, lambda m, n: workloads.planning(m, candidates=n)),
        "scenes": (config.scenes, workloads.many_scenes),
    }
    works: dict[Any, Work] = {
        (backend, axis, size): timed(make(model, size))
        for axis, (sizes, make) in axes.items()
        for size in sizes
        for backend, model in backends.items()
    }
    times = interleaved(works, config.seconds / 2, config.rounds)
    rows = {
        backend: {
            "growth": {
                axis: _curve({size: times[backend, axis, size] for size in sizes})
                for axis, (sizes, _) in axes.items()
            }
        }
        for backend in backends
    }
    return {"models": {name: {"backends": rows}}}


def _curve(times: dict[int, list[list[float]]]) -> dict[str, Any]:
    """Times [ms] by size and the exponent of the power law through them, if there are two."""
    points = {str(size): figure(own, 1e3) for size, own in times.items()}
    medians: list[Any] = [p["median"] for p in points.values()]
    return {
        "ms": points,
        "exponent": power_law(list(times), medians) if len(points) > 1 else None,
    }


def _motions(name: str, backends: Backends, config: BenchConfig) -> dict[str, Any]:
    """Control steps and executed rollouts by each backend, where they can be executed."""
    dim = backends["torch"].config.dim
    if backends["torch"].path_policy is None:
        return {"skipped": {f"rollouts of {name}": "it has no stage 2"}}
    try:
        kind = vector_type(None, dim)
        kind(1).close()
    except MissingExtraError as error:
        return {"skipped": {f"rollouts of {name}": str(error)}}
    robots, scene = config.robots if dim == 2 else config.arms, workloads.bench_scene(dim)
    works: dict[Any, Work] = {}
    for backend, model in backends.items():
        works[backend, "step"] = lambda m=model: [step_milliseconds(m, scene, kind, repeats=1)]
        works[backend, "rollouts"] = timed(workloads.rollouts(model, robots), robots)
    times = interleaved(works, config.seconds, config.rounds)
    rows = {
        backend: {
            "robots": robots,
            "step_ms": figure(times[backend, "step"]),
            "rollouts_per_second": rate(times[backend, "rollouts"]),
            "rollouts_process": footprint(
                "torch", "rollouts", torch.get_num_threads(),
                model=name, backend=backend, robots=robots,
            ),
        }
        for backend in backends
    }  # fmt: skip
    return {"models": {name: {"backends": rows}}}


def _processes(name: str, backends: Backends, config: BenchConfig) -> dict[str, Any]:
    """Start-up and memory of a process that loads a model and plans with it."""
    batches = [config.batches[0], config.batches[-1]]
    rows: dict[str, Any] = {}
    for backend in backends:
        runs = [
            footprint(
                "torch", "plan", torch.get_num_threads(),
                model=name, backend=backend, batches=batches,
            )
            for _ in range(config.rounds)
        ]  # fmt: skip
        rows[backend] = {
            "process": {
                "ms": _over_runs([run["seconds"] for run in runs], 1e3),
                "megabytes": _over_runs([run["megabytes"] for run in runs], 1.0),
            }
        }
    return {"models": {name: {"backends": rows}}}


def _over_runs(runs: list[dict[str, float]], scale: float) -> dict[str, Any]:
    return {name: figure([[run[name] for run in runs]], scale) for name in runs[0]}


def _published(
    dim: int, loaded: dict[str, Backends], config: BenchConfig, device: torch.device
) -> dict[str, Any]:
    """The published configuration in turns with ours of the same dimension."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        model = PublishedDiffuser(dim).eval().to(device)
    sizes = config.published
    works: dict[Any, Work] = {}
    for batch in sizes:
        workloads.published(model, batch, 1, device)()  # warms it up
        call = workloads.published(model, batch, config.published_steps, device)
        works["published", batch] = timed(call)
        for name, backends in loaded.items():
            for backend, own in backends.items():
                plan = workloads.planning(own, batch)
                plan()
                works[name, backend, batch] = timed(plan)
    times = interleaved(works, config.seconds, config.rounds, warm_up=False)

    def of_each(shown: Callable[[str, str, int], dict[str, Any]]) -> dict[str, Any]:
        return {
            name: {b: {str(n): shown(name, b, n) for n in sizes} for b in backends}
            for name, backends in loaded.items()
        }

    found = {
        "parameters": {
            part: sum(p.numel() for p in getattr(model, part).parameters())
            for part in ("unet", "encoder")
        },
        "steps": config.published_steps,
        "differences": list(DIFFERENCES),
        "plan_ms": {str(n): figure(times["published", n], 1e3) for n in sizes},
        "ours_ms": of_each(lambda name, b, n: figure(times[name, b, n], 1e3)),
        "ratio": of_each(
            lambda name, b, n: figure([_ratios(times["published", n], times[name, b, n])])
        ),
        "process": footprint(
            "torch", "published", torch.get_num_threads(), steps=min(2, config.published_steps)
        ),
    }
    return {"published": found}


def _ratios(theirs: list[list[float]], ours: list[list[float]]) -> list[float]:
    """Of each round, the median of `theirs` over that of `ours`."""
    return [float(np.median(a) / np.median(b)) for a, b in zip(theirs, ours, strict=True)]


def _archive(dim: int, config: BenchConfig) -> dict[str, Any]:
    """Archives as they are built, and how their time grows with the curves that are tried."""
    usual = workloads.archive(dim)
    tried = usual()
    calls = {size: workloads.archive(dim, size) for size in config.curves}
    sizes = {size: call() for size, call in calls.items()}
    works: dict[Any, Work] = {size: timed(call) for size, call in calls.items()}
    works["usual"] = timed(usual)
    times = interleaved(works, config.seconds, config.rounds)
    found = {
        "candidates": tried,
        "archive_ms": figure(times["usual"], 1e3),
        "candidates_per_second": rate(times["usual"], tried),
        "growth": _curve({sizes[size]: times[size] for size in calls}),
        "process": footprint("sys", "archive", 1, dim=dim),
    }
    return {"archive": {str(dim): found}}


def _dataset(dim: int, config: BenchConfig) -> dict[str, Any]:
    """Datasets of few scenes by one process."""
    works = {size: timed(workloads.dataset(dim, size)) for size in config.dataset}
    times = interleaved(works, config.seconds, config.rounds)
    most = config.dataset[-1]
    found = {
        "scenes_per_second": rate(times[most], most),
        "growth": _curve(times),
        "process": footprint("torch", "dataset", 1, dim=dim, scenes=most),
    }
    return {"dataset": {str(dim): found}}


def _training(
    name: str, modulator: Modulator, config: BenchConfig, device: torch.device
) -> dict[str, Any]:
    """Steps of stage 1 at the batch that it is trained with, in float32 and in bf16."""
    settings, steps = PathTrainingConfig(), config.training_steps
    halved = device.type == "cpu" or torch.cuda.is_bf16_supported()
    works = {
        precision: workloads.training(modulator.config, Team(device, precision=precision), steps)
        for precision in ("no", "bf16")[: 1 + halved]
    }
    times = interleaved(works, config.seconds, config.rounds, warm_up=False)
    found = {
        "batch": settings.scenes * settings.per_scene,
        "step_ms": figure(times["no"], 1e3),
        "steps_per_second": rate(times["no"]),
        "steps_per_second_bf16": rate(times["bf16"]) if halved else None,
        "process": footprint("torch", "training", torch.get_num_threads(), model=name),
    }
    return {"training": {str(modulator.config.dim): found}}


def _imports(config: BenchConfig) -> dict[str, Any]:
    return {"import_ms": figure([[import_seconds() for _ in range(config.rounds)]], 1e3)}
