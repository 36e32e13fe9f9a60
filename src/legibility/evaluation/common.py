"""Steps that the evaluations share: levels, results in order, executions in batches, timing."""

import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ..checks import Array
from ..curves import resample
from ..drivers import Driver
from ..envs.block_reach import BlockReachVector
from ..intent.metrics import dragan_legibility
from ..modulator import Modulator
from ..motion.path import Path
from ..parallel import Each, pool, threads
from ..robots.arm import Arm
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


class Parts:
    """The progress of a long evaluation, one part after another, each of a number of items.

    Args:
        progress: called with the items done, that of all, and a line where something is finished.
        total: items of all parts.
    """

    def __init__(self, progress: Callable[[int, int, str], None], total: int) -> None:
        self.progress, self.total, self.done = progress, total, 0

    def next(self, size: int) -> Callable[..., None]:
        """The progress of the next part, of `size` items."""
        start, self.done = self.done, self.done + size
        return lambda now, of, *_: self.progress(start + size * now // max(of, 1), self.total, "")

    def tell(self, line: str) -> None:
        """Report a line at the end of the parts so far."""
        self.progress(self.done, self.total, line)


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


def each_of(
    items: Sequence[Any],
    measure: Callable[[Any], Any],
    workers: int,
    cluster: str | None,
    progress: Progress,
) -> list[Any]:
    """The results of `measure` in the order of `items`, by a `pool`."""
    advance = counter(progress, len(items))
    with pool(workers, cluster) as work:
        advance(0)
        return gather(work, measure, items, lambda _: advance(1))


def level_steps(number: int) -> Array:
    """`number` levels of ℓ at equal steps from −1 to 1."""
    return np.round(np.linspace(-1, 1, number), 12)


DRAGAN_LEVELS = level_steps(6)
"""Levels of ℓ over which Dragan's legibility must rise."""

_DRAGAN_BETA = 10.0
"""Rationality of that observer, over the scene's size: half of the default observer's."""

_DRAGAN_POINTS = 100


def dragan_rises(curves: Array, scene: Scene, levels: Array, over: Array) -> float:
    """1 if Dragan's legibility (HRI 2013), by code of its own, rises over ℓ, 0 otherwise.

    Args:
        curves: `(M S, T, D)` [m], S to goal 0 at each level; their mean counts.
        scene: the scene.
        levels: ℓ `(M,)`, rising.
        over: those of them over which it must rise.
    """
    steady = resample(curves, _DRAGAN_POINTS)
    legibility = dragan_legibility(steady, scene.goals, 0, _DRAGAN_BETA / scene.size)
    means = legibility.reshape(len(levels), -1).mean(axis=1)[np.isin(levels, over)]
    return float((np.diff(means) > 0).all())


def rounded(value: Any) -> Any:
    """`value` with six digits of each number, so that a file of many scenes stays small."""
    if isinstance(value, dict):
        return {name: rounded(v) for name, v in value.items()}
    if isinstance(value, list):
        return [rounded(v) for v in value]
    return float(f"{value:.6g}") if isinstance(value, float) else value


def world(kind: type[BlockReachVector]) -> str:
    """The name of an environment in results."""
    return kind.__name__.removesuffix("Vector")


def execute(
    modulator: Modulator,
    kind: type[BlockReachVector],
    scenes: Sequence[Scene],
    env_seed: int | list[int],
    options: dict[str, Any],
    arm: Arm | None = None,
    **execution: Any,
) -> list[Rollout]:
    """Execute one motion in each of `scenes`, together.

    `env_seed` and `options` are of the reset, `arm` is of the environment, if it is not its own,
    `execution` is of `Modulator.execute_many`.
    """
    settings: dict[str, Any] = {"max_goals": max(6, *(scene.num_goals for scene in scenes))}
    if arm is not None:
        settings["arm"] = arm
    env = kind(len(scenes), **settings)
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
    driver: Callable[[slice], Driver | None] | None = None,
) -> list[Rollout]:
    """Execute the paths of one scene, as many at once as fit, each by another robot.

    With a `driver`, which gives what moves a part of them, None for stage 2, none is replanned.
    """
    rollouts: list[Rollout] = []
    for first in range(0, len(plans.waypoints), kind.at_once):
        paths = [plans[i] for i in range(first, min(first + kind.at_once, len(plans.waypoints)))]
        part = slice(first, first + len(paths))
        how = {} if driver is None else {"driver": driver(part), "replan": False}
        rollouts += execute(
            modulator, kind, [plans.scene] * len(paths), env_seed + first,
            {"target": plans.target}, legibility=[path.legibility for path in paths],
            seed=plan_seed + first, paths=paths, observer=plans.observer,
            **how,
        )  # fmt: skip
        advance(len(paths))
    return rollouts


@threads(1)
def plan_milliseconds(
    modulator: Modulator, scene: Scene, repeats: int = 200, **options: Any
) -> float:
    """Median time [ms] of one plan on one core in a scene that was planned in before."""
    times = []
    for seed in range(repeats + 5):
        start = time.perf_counter()
        modulator.plan(scene, 0, 0.5, seed=seed, **options)
        times.append(time.perf_counter() - start)
    return float(np.median(times[5:]) * 1e3)
