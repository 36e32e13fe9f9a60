"""How the baselines' policy is trained and how Legibility Diffuser's guidance is chosen."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import product
from pathlib import Path as FilePath
from typing import Any

import numpy as np
import torch

from ..baselines.guided import GuidedPolicy
from ..baselines.planners import straight_path
from ..checks import Array
from ..data.dataset import LABEL_KNOTS, Dataset
from ..data.demonstrations import Demonstrations
from ..envs import vector_type
from ..envs.fleet import Fleet
from ..models.configuration import GoalPolicyConfig
from ..models.goal_policy import GoalPolicy, goal_features
from ..rollout import Rollout, follow
from .configuration import PolicyTrainingConfig
from .loop import Progress
from .policy import fit, moments
from .team import Team

__all__ = ["GUIDANCE", "train_goal", "tune_guidance", "validate_goal"]

GUIDANCE = {
    "guidance": (2.5, 5.0, 7.5, 10.0, 15.0),
    "guidance_decay": (0.4, 0.6, 0.9, 0.95, 1.0),
    "guidance_share": (0.5, 0.9, 1.0),
}
"""The settings that are tried: those of the Legibility Diffuser's authors and their neighbours."""

_SUCCESS = 0.99


def train_goal(
    data: Demonstrations,
    validation: Dataset,
    folder: str | FilePath,
    config: PolicyTrainingConfig | None = None,
    *,
    device: str | None = None,
    precision: str | None = None,
    progress: Progress = lambda step, steps, figures: None,
    **settings: Any,
) -> GoalPolicy:
    """Train a goal-conditioned policy on `data`, validated by rollouts in scenes of `validation`.

    What is known in a step of training, and what is not, is the same as in sampling: dropped with
    the configured probability, the goal is replaced by the null condition.

    Args:
        data: demonstrations.
        validation: a dataset of another seed stream.
        folder: of the checkpoint and the log; an interrupted run goes on from there.
        config: how to train.
        device: where to; a GPU where there is one.
        precision: no (float32), bf16 or fp16, see `Team.join`.
        progress: see `train`.
        **settings: of `GoalPolicyConfig`, but those that the data fixes.

    Returns:
        The trained model, on the CPU.
    """
    config = config or PolicyTrainingConfig()
    settings |= {"dim": data.paths.shape[-1], "limit": data.limit}
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(config.seed)
        model = GoalPolicy(GoalPolicyConfig(**settings))
    parts = toward_goals(data, model.config.chunk)
    team = Team.join(device, precision)
    return fit(model, parts, data, validation, folder, config, validate_goal, team, progress)


def toward_goals(data: Demonstrations, chunk: int) -> list[list[Array]]:
    """Features `(M, F)` and chunks of actions `(M, chunk, D)` of each of all M steps.

    Once with the goal, once without.
    """
    goals = data.paths[:, -1]
    found: list[list[Array]] = [[], [], []]
    for rows, now, before, actions in moments(data, chunk):
        for part, goal in zip(found, (goals[rows], None), strict=False):
            part.append(goal_features(now, before, goal, data.limit, data.workspace))
        found[2].append(actions)
    known, unknown, actions = (np.concatenate(part) for part in found)
    return [[known, actions], [unknown, actions]]


def rollouts_of(model: GoalPolicy, validation: Dataset) -> list[Rollout]:
    """One closed-loop motion in each scene of `validation`."""
    config, scenes = validation.config, validation.scenes
    env = vector_type(None, config.dim)(len(scenes))
    env.reset(seed=0, options={"scene": scenes})
    paths = [straight_path(scene, 0, 0.0, config.observer) for scene in scenes]
    found = follow(Fleet(env, 0), paths, GuidedPolicy(model, scenes, [0] * len(scenes), seed=0))
    env.close()
    return found


def validate_goal(model: GoalPolicy, validation: Dataset) -> dict[str, float]:
    """Rollouts in the scenes of `validation`: success, steps, and length over the straight line."""
    where = next(model.parameters()).device
    rollouts = rollouts_of(model.to("cpu"), validation)
    model.to(where)
    straight = [np.linalg.norm(np.diff(r.path.waypoints[[0, -1]], axis=0)) for r in rollouts]
    lengths = [np.linalg.norm(np.diff(r.states, axis=0), axis=-1).sum() for r in rollouts]
    return {
        "validation_success": float(np.mean([r.success for r in rollouts])),
        "validation_length_ratio": float(np.median(np.divide(lengths, straight))),
        "validation_steps": float(np.mean([len(r.actions) for r in rollouts])),
    }


def tune_guidance(
    model: GoalPolicy,
    validation: Dataset,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> tuple[dict[str, float], list[dict[str, float]]]:
    """The best of all combinations of `GUIDANCE` on the scenes of `validation`.

    The most legible one, by the mean achieved ℓ, of those that reach the goal in 99 % of the
    scenes, or as often as any does.

    Returns:
        The chosen settings, and of every combination its `success` and mean `achieved` ℓ.
    """
    rows = []
    combinations = [dict(zip(GUIDANCE, v, strict=True)) for v in product(*GUIDANCE.values())]
    plain = model.config
    for done, settings in enumerate(combinations):
        model.config = replace(plain, **settings)
        rollouts = rollouts_of(model, validation)
        achieved = [
            np.interp(rollout.score, knots, LABEL_KNOTS)
            for rollout, knots in zip(rollouts, validation.score_at_label, strict=True)
        ]
        success = float(np.mean([r.success for r in rollouts]))
        rows.append({**settings, "success": success, "achieved": float(np.mean(achieved))})
        progress(done + 1, len(combinations))
    model.config = plain
    enough = min(_SUCCESS, max(row["success"] for row in rows))
    best = max((row for row in rows if row["success"] >= enough), key=lambda r: r["achieved"])
    return {name: best[name] for name in GUIDANCE}, rows
