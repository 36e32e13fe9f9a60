"""Steps that the evaluations share: levels, results in order, executions in batches, timing."""

import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ..checks import Array
from ..envs.block_reach import BlockReachVector
from ..modulator import Modulator
from ..motion.path import Path
from ..parallel import Each, threads
from ..rollout import Rollout
from ..scene import Scene

Progress = Callable[[int, int], None]
"""Called with the number of finished items and of all items."""


def silent(done: int, total: int) -> None:
    """Show no progress."""


def counter(progress: Progress, total: int) -> Callable[[int], None]:
    """`advance(number)`, which adds to the finished items and reports them to `progress`."""
    done = 0

    def advance(number: int) -> None:
        nonlocal done
        done += number
        progress(done, total)

    return advance


def gather(
    each: Each,
    function: Callable[[Any], Any],
    items: Sequence[Any],
    finished: Callable[[Any], None],
) -> list[Any]:
    """The results of `function` in the order of `items`; `finished` is called with every result."""
    results: dict[int, Any] = {}
    for index, result in each(function, items):
        results[index] = result
        finished(result)
    return [results[index] for index in range(len(items))]


def level_steps(number: int) -> Array:
    """`number` levels of ℓ at equal steps from −1 to 1."""
    return np.round(np.linspace(-1, 1, number), 12)


def world(kind: type[BlockReachVector]) -> str:
    """The name of an environment in results."""
    return kind.__name__.removesuffix("Vector")


def execute(
    modulator: Modulator,
    kind: type[BlockReachVector],
    scenes: Sequence[Scene],
    env_seed: int | list[int],
    options: dict[str, Any],
    **execution: Any,
) -> list[Rollout]:
    """Execute one motion in each of `scenes`, together.

    `env_seed` and `options` are of the reset, `execution` is of `Modulator.execute_many`.
    """
    env = kind(len(scenes), max_goals=max(6, *(scene.num_goals for scene in scenes)))
    env.reset(seed=env_seed, options={"scene": list(scenes), **options})
    rollouts = modulator.execute_many(env, **execution)
    env.close()
    return rollouts


def execute_paths(
    modulator: Modulator,
    kind: type[BlockReachVector],
    plans: Path,
    plan_seed: int,
    env_seed: int,
    advance: Callable[[int], None] = lambda number: None,
) -> list[Rollout]:
    """Execute the paths of one scene, as many at once as fit, each by another robot."""
    rollouts: list[Rollout] = []
    for first in range(0, len(plans.waypoints), kind.at_once):
        paths = [plans[i] for i in range(first, min(first + kind.at_once, len(plans.waypoints)))]
        rollouts += execute(
            modulator, kind, [plans.scene] * len(paths), env_seed + first,
            {"target": plans.target}, legibility=[path.legibility for path in paths],
            seed=plan_seed + first, paths=paths, observer=plans.observer,
        )  # fmt: skip
        advance(len(paths))
    return rollouts


@threads(1)
def plan_milliseconds(
    modulator: Modulator, scene: Scene, repeats: int = 200, **options: Any
) -> float:
    """Median time [ms] of one plan on one core, after a warm-up."""
    times = []
    for seed in range(repeats + 5):
        start = time.perf_counter()
        modulator.plan(scene, 0, 0.5, seed=seed, **options)
        times.append(time.perf_counter() - start)
    return float(np.median(times[5:]) * 1e3)
