"""The spectrum: motions of rising legibility and their cost (paper, fig. 3)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..checks import Array
from ..curves import spaced
from ..envs import vector_type
from ..errors import InvalidInputError
from ..intent.field import Field
from ..intent.metrics import potential_cost
from ..intent.observer import Observer
from ..modulator import Modulator
from ..rollout import Rollout
from ..scene import Scene
from ..seeds import plan_seeds
from .common import Progress, counter, execute_paths, level_steps, silent, world
from .comparison import SCENES, TARGETS
from .configuration import SpectrumConfig
from .statistics import bootstrap_interval


def evaluate_spectrum(
    modulator: Modulator, config: SpectrumConfig, *, progress: Progress = silent
) -> dict[str, Any]:
    """Execute motions of all levels in the scene of Table I, toward R and toward G.

    The dial is turned for the paper's observer.

    Returns:
        `targets`: of each, at every level, the `costs (L, N)`, L_p of the table, with `mean` and
        `interval`, the `achieved` ℓ, and the `states` of the first motion; `success`, a share;
        `rising`, the number of levels whose mean cost is above that of the level before;
        `angles`, of the joints at the start.
    """
    kind = vector_type(config.env, modulator.config.dim)
    place, observer = SCENES[kind.dim], Observer.paper(kind.dim)
    levels = level_steps(config.levels)
    asked = np.repeat(levels, config.rollouts)
    advance = counter(progress, len(TARGETS) * len(asked))
    targets = {}
    for letter, target in TARGETS.items():
        plan_seed, env_seed = plan_seeds(config.seed, target, 2)
        plans = modulator.plan(place.scene, target, asked, seed=plan_seed, observer=observer)
        rollouts = execute_paths(modulator, kind, plans, plan_seed, env_seed, advance)
        spectrum = Spectrum.of(rollouts)
        means = spectrum.costs.mean(axis=1)
        achieved = np.reshape([r.achieved for r in rollouts], spectrum.costs.shape)
        targets[letter] = {
            "costs": spectrum.costs,
            "mean": means,
            "interval": [bootstrap_interval(row) for row in spectrum.costs],
            "achieved": achieved.mean(axis=1),
            "states": spectrum.motions,
            "success": float(np.mean([r.success for r in rollouts])),
            "rising": int((np.diff(means) > 0).sum()),
            "angles": spectrum.angles,
        }
    return {
        "env": world(kind),
        "scene": place.scene.to_dict(),
        "observer": observer.to_dict(),
        "spacing": place.spacing,
        "levels": levels,
        "targets": targets,
    }


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Executed motions in one scene toward one target, by rising ℓ.

    Attributes:
        scene: the scene.
        target: index of the intended goal.
        field: of the observer.
        levels: ℓ `(L,)`, rising.
        motions: one of each level, `(T, D)` [m].
        costs: `(L, N)`, L_p of the paper's Table I, of N motions of each level.
        angles: `(J,)` [rad] of an arm's joints at the start; J = 0 where there is none.
    """

    scene: Scene
    target: int
    field: Field
    levels: Array
    motions: list[Array]
    costs: Array
    angles: Array

    @classmethod
    def of(cls, rollouts: Sequence[Rollout]) -> Spectrum:
        """Of motions in one scene; L_p is of points as far apart as in Table I.

        Raises:
            InvalidInputError: there are none, or not as many of each level.
        """
        rollouts = sorted(rollouts, key=lambda rollout: rollout.legibility)
        levels, counts = np.unique([r.legibility for r in rollouts], return_counts=True)
        if len(set(counts)) != 1:
            raise InvalidInputError(
                "a spectrum needs at least one motion, as many of each level, "
                f"got {counts.tolist()}"
            )
        path = rollouts[0].path
        spacing = SCENES[path.scene.dim].spacing
        states = [spaced(rollout.states, spacing) for rollout in rollouts]
        costs = [potential_cost(points, path.field, path.target) for points in states]
        return cls(
            path.scene, path.target, path.field, levels,
            [r.states for r in rollouts[:: len(rollouts) // len(levels)]],
            np.reshape(costs, (len(levels), -1)), rollouts[0].joint_angles[0],
        )  # fmt: skip

    @classmethod
    def of_result(cls, result: dict[str, Any], letter: str) -> Spectrum:
        """The spectrum toward target R or G in the result of `evaluate_spectrum` or its JSON."""
        scene, values = Scene.from_dict(result["scene"]), result["targets"][letter]
        return cls(
            scene, TARGETS[letter], Observer.from_dict(result["observer"]).field(scene),
            np.array(result["levels"]), [np.array(s) for s in values["states"]],
            np.array(values["costs"]), np.array(values["angles"]),
        )  # fmt: skip
