"""Training of the baselines' policy, and the choice of Legibility Diffuser's guidance."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np

from ..baselines.guided import GuidedPolicy
from ..baselines.planners import straight_path
from ..data.dataset import LABEL_KNOTS, Dataset
from ..data.demonstrations import Demonstrations
from ..models.configuration import GoalPolicyConfig
from ..models.goal_policy import GoalPolicy, goal_features
from ..rollout import Rollout
from .configuration import PolicyTrainingConfig
from .loop import Run, Trained
from .policy import Samples, fit, joined, moments, rollouts_of

GUIDANCE = {
    "guidance": (2.5, 5.0, 7.5, 10.0, 15.0),
    "guidance_decay": (0.4, 0.6, 0.9, 0.95, 1.0),
    "guidance_share": (0.5, 0.9, 1.0),
}
"""The settings to try: those of Legibility Diffuser's authors and their neighbours."""

_SUCCESS = 0.99


def train_goal(
    data: Demonstrations,
    validation: Dataset,
    run: Run,
    config: PolicyTrainingConfig | None = None,
    **settings: Any,
) -> Trained[GoalPolicy]:
    """Train a goal-conditioned policy, validated by rollouts in the scenes of `validation`.

    With the configured probability the null condition replaces the goal, as in guided sampling.
    Arguments are those of `train_policy`; `settings` are of `GoalPolicyConfig`.
    """
    return fit(
        GoalPolicy, GoalPolicyConfig, toward_goals, validate_goal,
        data, validation, run, config, settings,
    )  # fmt: skip


def toward_goals(data: Demonstrations, chunk: int) -> tuple[Samples, Samples]:
    """Every step of the demonstrations as the policy sees it with the goal, and without it."""
    goals = data.paths[:, -1]
    samples: tuple[list[Samples], list[Samples]] = ([], [])
    for rows, now, before, actions in moments(data, chunk):
        for steps, goal in zip(samples, (goals[rows], None), strict=True):
            steps.append((goal_features(now, before, goal, data.limit, data.workspace), actions))
    return joined(samples[0]), joined(samples[1])


def _rollouts(model: GoalPolicy, validation: Dataset) -> list[Rollout]:
    """One closed-loop motion in each scene of `validation`."""
    scenes, observer = validation.scenes, validation.config.observer
    paths = [straight_path(scene, 0, 0.0, observer) for scene in scenes]
    targets = [0] * len(scenes)
    return rollouts_of(model, lambda m: GuidedPolicy(m, scenes, targets, seed=0), paths, scenes)


def validate_goal(model: GoalPolicy, validation: Dataset) -> dict[str, float]:
    """Rollouts in the scenes of `validation`: success, steps, and length over the straight line."""
    rollouts = _rollouts(model, validation)
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

    The best has the highest mean achieved ℓ among those that reach the goal in 99 % of the scenes,
    or as often as any does.

    Returns:
        The chosen settings, and the `success` and mean `achieved` ℓ of every combination.
    """
    rows = []
    combinations = [dict(zip(GUIDANCE, v, strict=True)) for v in product(*GUIDANCE.values())]
    plain = model.config
    for done, settings in enumerate(combinations):
        model.config = replace(plain, **settings)
        rollouts = _rollouts(model, validation)
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
