"""Gymnasium environments; importing this package registers them."""

from __future__ import annotations

import gymnasium

__all__ = ["MAX_EPISODE_STEPS"]

MAX_EPISODE_STEPS = 400

gymnasium.register(
    id="legibility/BlockReach2D-v0",
    entry_point="legibility.envs.block_reach_2d:BlockReach2D",
    vector_entry_point="legibility.envs.block_reach_2d:BlockReach2DVector",
    max_episode_steps=MAX_EPISODE_STEPS,
)
