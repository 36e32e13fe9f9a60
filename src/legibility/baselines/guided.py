"""Diffusion Policy and Legibility Diffuser in closed loop."""

from collections.abc import Sequence

import numpy as np
import torch

from ..checks import Array
from ..drivers import RobotStates
from ..models.diffusion import standard_normal
from ..models.goal_policy import GoalPolicy, goal_features, guidance_weights
from ..scene import Scene


class GuidedPolicy:
    """A goal-conditioned policy, guided away from its own actions for the other goals.

    It follows no path. The guidance is that of the model's configuration: none for Diffusion
    Policy; for Legibility Diffuser its weight decays by γ with every chunk that a robot executes.

    Args:
        model: the policy.
        scenes: the scene of each of `B` robots.
        targets: `(B,)`, index of the intended goal of each.
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

    def __call__(self, robots: RobotStates) -> Array:
        """See `Driver`."""
        config, rows = self.model.config, robots.rows
        guidance = config.guidance * config.guidance_decay ** self.chunks[rows].astype(np.float64)
        self.chunks[rows] += 1
        others = self.others[rows] if config.guidance else self.others[rows, :0]
        known = [robots.goals, *others.swapaxes(0, 1), *[None] * bool(config.guidance)]
        features = [
            goal_features(
                robots.positions, robots.previous, goal, config.limit, self.workspaces[rows]
            )
            for goal in known
        ]
        weights = np.ones((len(rows), 1))
        if config.guidance:
            weights = guidance_weights(guidance, config.guidance_share, self.there[rows])
        noise = standard_normal(len(rows), config.chunk, config.dim, generator=self.generator)
        return self.model.act(
            np.stack(features, axis=1), np.array([goal is not None for goal in known]), weights,
            noise, self.steps,
        )[:, : config.execute]  # fmt: skip
