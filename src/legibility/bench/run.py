"""The bench: its configuration and the order of its measurements."""

from collections.abc import Callable, Sequence
from typing import Any

from ..errors import InvalidInputError, MissingExtraError
from ..parallel import threads
from .configuration import BenchConfig


def run_bench(
    models: Sequence[str],
    config: BenchConfig | None = None,
    *,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> dict[str, Any]:
    """Measure `models`, and the data and training behind them.

    Args:
        models: names of weights or folders.
        config: sizes and durations.
        progress: called with the number of finished parts and of all parts.

    Returns:
        `machine`; `skipped`: reasons why something was not measured; `measurements`: flat rows,
        each a `metric` with its `median`, 95 % interval `low` to `high`, number of `calls`, and
        conditions: `plan_ms` by `model`, `backend`, `batch` and `goals`; `plan_one_core_ms`,
        `plan_obstacles_ms` (one core, also by `mode`, quick or exact, and `scene`, new or known),
        `control_step_ms` (one core), `rollouts_per_second`, `load_ms`, `first_plan_ms` and
        `memory_mb` (peak) by `model` and `backend`; `archive_ms`, `candidates_per_second`,
        `scenes_per_second` (one process) and `training_steps_per_second` (also by `precision`) by
        `dim`; `import_ms`.
    """
    import torch

    from . import measure

    config = config or BenchConfig()
    if not models:
        raise InvalidInputError("models must be at least one, got none")
    with threads(config.threads or torch.get_num_threads()):
        machine = measure.machine(config.device)
        skipped: list[str] = []
        loaded = {name: measure.load(name, skipped) for name in models}
        dims = dict.fromkeys(backends["torch"].config.dim for backends in loaded.values())
        parts: list[tuple[Any, ...]] = []
        for name, backends in loaded.items():
            parts.append((measure.plans, name, backends))
            if backends["torch"].path_policy is None:
                skipped.append(f"motions of {name}: it has no stage 2")
            else:
                parts.append((measure.motions, name, backends))
        for dim in dims:
            parts += [(measure.data, dim), (measure.training, dim)]
        parts.append((measure.processes, loaded))
        measurements = []
        for done, (part, *arguments) in enumerate(parts):
            progress(done, len(parts))
            try:
                measurements += part(*arguments, config)
            except MissingExtraError as error:  # no simulator
                skipped.append(str(error))
        progress(len(parts), len(parts))
    return {"machine": machine, "skipped": [*dict.fromkeys(skipped)], "measurements": measurements}
