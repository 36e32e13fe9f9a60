"""Diffusion Policy and Legibility Diffuser in closed loop."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray

from ..checks import Array
from ..models.diffusion import standard_normal
from ..models.goal_policy import GoalPolicy, goal_features, guidance_weights
from ..motion.tracking import PathTracker
from ..scene import Scene

__all__ = ["GuidedPolicy"]


class GuidedPolicy:
    """A goal-conditioned policy that keeps away from what it would do for the other goals.

    It follows no path. The guidance is that of the model's configuration: none for Diffusion
    Policy; for Legibility Diffuser its weight falls by γ with every chunk that a robot executes.

    Args:
        model: the policy.
        scenes: of each of the `B` robots that it moves.
        targets: `(B,)`, index of the goal that is meant in each.
        seed: of the actions drawn.
        steps: of the sampler; the model's own if not given.
    """

    with_path = False

    def __init__(
        self,
        model: GoalPolicy,
        scenes: Sequence[Scene],
        targets: Sequence[int],
        seed: int,
        steps: int | None = None,
    ) -> None:
        self.model, self.steps = model, steps
        self.generator = torch.Generator("cpu").manual_seed(seed)
        self.workspaces = np.stack([scene.workspace for scene in scenes])
        most = max(scene.num_goals for scene in scenes) - 1
        self.others = np.zeros((len(scenes), most, scenes[0].dim))
        self.there = np.zeros((len(scenes), most), dtype=bool)
        for row, (scene, target) in enumerate(zip(scenes, targets, strict=True)):
            number = scene.num_goals - 1
            self.others[row, :number] = np.delete(scene.goals, target, axis=0)
            self.there[row, :number] = True
        self.chunks = np.zeros(len(scenes), dtype=np.intp)

    def __call__(
        self,
        rows: NDArray[np.intp],
        positions: Array,
        previous: Array,
        goals: Array,
        tracker: PathTracker,
    ) -> Array:
        """See `Driver`."""
        config = self.model.config
        guidance = config.guidance * config.guidance_decay ** self.chunks[rows].astype(np.float64)
        self.chunks[rows] += 1
        others = self.others[rows] if config.guidance else self.others[rows, :0]
        seen = [goals[rows], *others.swapaxes(0, 1), *[None] * bool(config.guidance)]
        features = [
            goal_features(positions[rows], previous[rows], g, config.limit, self.workspaces[rows])
            for g in seen
        ]
        weights = np.ones((len(rows), 1))
        if config.guidance:
            weights = guidance_weights(guidance, config.guidance_share, self.there[rows])
        noise = standard_normal(len(rows), config.chunk, config.dim, generator=self.generator)
        return self.model.act(
            np.stack(features, axis=1), np.array([g is not None for g in seen]), weights, noise,
            self.steps,
        )[:, : config.execute]  # fmt: skip
