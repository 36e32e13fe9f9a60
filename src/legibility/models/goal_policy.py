"""The baselines' policy: two states and a goal to actions, with guidance away from other goals.

Without guidance it is a goal-conditioned Diffusion Policy (Chi et al. 2024), with it Legibility
Diffuser (Bronars, Cheng & Xu 2024).
"""

import numpy as np
import torch
from torch import Tensor, nn

from ..checks import Array
from .configuration import GoalPolicyConfig
from .diffusion import ddim, sampling_timesteps
from .path_policy import ActionDenoiser, compressed


def goal_features(
    positions: Array, previous: Array, goals: Array | None, limit: float, workspace: Array
) -> np.ndarray:
    """The policy's inputs of `B` robots, `(B, F)` float32, in the world's axes.

    The last displacement (with the position, the two past states) and the way to the goal in
    limits, and the place in the workspace. The other features carry no information about the goal.

    Args:
        positions: `(B, D)` [m].
        previous: `(B, D)` [m], one step before.
        goals: `(B, D)` [m]; if not given, none is known.
        limit: largest displacement of an action [m].
        workspace: `(2, D)` or `(B, 2, D)` [m].
    """
    low, high = workspace[..., 0, :], workspace[..., 1, :]
    centre, half = (low + high) / 2, (high - low) / 2
    way = np.zeros_like(positions) if goals is None else (goals - positions) / limit
    parts = [(positions - previous) / limit, (positions - centre) / half, compressed(way), way / 16]
    return np.concatenate(parts, axis=-1).astype(np.float32)


def guidance_weights(guidance: Array, share: float, others: np.ndarray) -> Array:
    """Weights `(B, M + 2)` of the target, of M other goals and of no goal; they sum to 1.

    `ε̂ = (1 + w) ε(g*) − a w ε(g⁻) − (1 − a) w ε(∅)` (Bronars et al. 2024); with several other goals
    the mean of ε(g⁻) over them.

    Args:
        guidance: w of each robot, `(B,)`.
        share: a.
        others: `(B, M)` bool, which of the other goals there are; at least one in each.
    """
    w = guidance[:, None]
    shares = others / others.sum(axis=1, keepdims=True)
    return np.concatenate([1 + w, -share * w * shares, -(1 - share) * w], axis=1, dtype=np.float64)


class GoalPolicy(ActionDenoiser):
    """Denoises a chunk of actions in the world's axes."""

    def __init__(self, config: GoalPolicyConfig) -> None:
        super().__init__(config, 4 * config.dim)
        self.config = config
        self.no_goal = nn.Parameter(torch.zeros(config.condition))

    def encode(self, features: Tensor, has_goal: Tensor) -> Tensor:
        """`(B, E)` of `features (B, F)`, see `goal_features`, and `has_goal (B,)`."""
        return self._encode(features, has_goal, self.no_goal)

    @torch.inference_mode()
    def act(
        self,
        features: np.ndarray,
        has_goal: np.ndarray,
        weights: Array,
        noise: Tensor,
        steps: int | None = None,
    ) -> Array:
        """A chunk of displacements `(B, chunk, D)` [m] in the world, not yet made safe.

        The weights sum to 1, so weighing v, ε or the denoised actions is all the same. As in the
        reference implementations the clean estimate is clipped to the range of the data.

        Args:
            features: `(B, C, F)` of `B` robots under `C` conditions.
            has_goal: `(C,)`, which conditions are a goal.
            weights: `(B, C)` of the conditions.
            noise: `(B, chunk, D)` standard normal; the same noise gives the same actions.
            steps: of the sampler; the configuration's if not given.
        """
        size, num = weights.shape
        known = torch.from_numpy(np.tile(has_goal, size))
        weight = torch.from_numpy(weights.astype(np.float32))
        times = sampling_timesteps(
            self.config.diffusion_steps, steps or self.config.sampling_steps, to_end=True
        )
        timesteps = torch.tensor(times, device="cpu")[:, None]
        with torch.autocast("cpu", enabled=False):
            context = self.encode(torch.from_numpy(features).flatten(0, 1), known)

            def velocity(noisy: Tensor, i: int) -> Tensor:
                under_each = self(noisy.repeat_interleave(num, 0), timesteps[i], context)
                return torch.einsum("bc,bc...->b...", weight, under_each.unflatten(0, (size, num)))

            actions = ddim(velocity, noise, self.signal, times, bound=1 / float(self.scale))
        return (actions * self.scale).double().numpy() * self.config.limit
