"""Training of stage 2 and of the baselines' policy, and the tuning of the baselines' guidance."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from itertools import product
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional as F

from ..baselines.guided import GuidedPolicy
from ..baselines.planners import straight_path
from ..checks import Array
from ..curves import arc_length
from ..data.dataset import LABEL_KNOTS, Dataset
from ..data.demonstrations import Demonstrations
from ..drivers import Driver, Policy
from ..envs import vector_type
from ..envs.fleet import Fleet
from ..errors import InvalidInputError
from ..intent.observer import Observer
from ..models.configuration import GoalPolicyConfig, PathPolicyConfig
from ..models.diffusion import noised
from ..models.goal_policy import GoalPolicy, goal_features
from ..models.path_policy import Observation, PathPolicy
from ..models.provenance import Source
from ..motion.path import Path
from ..motion.tracking import PathTracker
from ..rollout import Rollout, follow
from ..scene import Scene
from .configuration import PolicyTrainingConfig
from .loop import Run, Trained, new_model, train
from .team import Team

GUIDANCE = {
    "guidance": (2.5, 5.0, 7.5, 10.0, 15.0),
    "guidance_decay": (0.4, 0.6, 0.9, 0.95, 1.0),
    "guidance_share": (0.5, 0.9, 1.0),
}
"""The settings to try: those of Legibility Diffuser's authors and their neighbours."""

_SUCCESS = 0.99

Samples = tuple[Array, Array]
"""Features `(M, F)` and chunks of actions `(M, chunk, D)` of M steps of demonstrations."""


class PolicyBatches:
    """Every step of the demonstrations as tensors, and the loss of a policy over random batches.

    Args:
        guided: all steps with the path or goal that guides the policy.
        unguided: the same steps without it.
        config: how to train.
        team: of this process.
    """

    def __init__(
        self, guided: Samples, unguided: Samples, config: PolicyTrainingConfig, team: Team
    ) -> None:
        self.config, self.team = config, team
        self.guided, self.unguided = (
            [torch.from_numpy(x.astype(np.float32)).to(team.device) for x in parts]
            for parts in (guided, unguided)
        )

    def loss(
        self, model: PathPolicy | GoalPolicy, generator: torch.Generator
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """Squared error of the velocity."""
        size, shape = self.config.batch, self.guided[1].shape[1:]
        chosen = torch.randint(len(self.guided[0]), (size,), generator=generator)
        timestep = torch.randint(model.config.diffusion_steps, (size,), generator=generator)
        noise = torch.randn(size, *shape, generator=generator)
        keep = torch.rand(size, generator=generator) >= self.config.dropout
        chosen, timestep, noise, keep = (
            self.team.share(x).to(self.team.device) for x in (chosen, timestep, noise, keep)
        )
        features, actions = (
            torch.where(keep.view(-1, *[1] * (known.ndim - 1)), known[chosen], without[chosen])
            for known, without in zip(self.guided, self.unguided, strict=True)
        )
        noisy, velocity = noised(actions / model.scale, noise, model.signal[timestep, None, None])
        with self.team.autocast():
            predicted = model(noisy, timestep, model.encode(features, keep))
        loss = F.mse_loss(predicted.float(), velocity)
        return loss, {"velocity": loss.detach()}


def along_paths(data: Demonstrations, chunk: int) -> tuple[Samples, Samples]:
    """Every step of the demonstrations as the policy sees it with the path, and without it."""
    tracker = PathTracker(data.paths, data.limit, data.workspace)

    def seen(rows: Any, now: Array, before: Array, actions: Array) -> Iterator[Samples]:
        for path in (tracker.of(rows), None):
            view = Observation.of(now, before, data.paths[rows, -1], data.limit, path)
            yield view.features, actions @ view.rotation.swapaxes(1, 2)

    return _samples(data, chunk, seen, tracker)


def toward_goals(data: Demonstrations, chunk: int) -> tuple[Samples, Samples]:
    """Every step of the demonstrations as the policy sees it with the goal, and without it."""

    def seen(rows: Any, now: Array, before: Array, actions: Array) -> Iterator[Samples]:
        for goal in (data.paths[rows, -1], None):
            yield goal_features(now, before, goal, data.limit, data.workspace), actions

    return _samples(data, chunk, seen)


def _samples(
    data: Demonstrations,
    chunk: int,
    seen: Callable[..., Iterator[Samples]],
    tracker: PathTracker | None = None,
) -> tuple[Samples, Samples]:
    """The samples with and without guidance that `seen` yields at all times of `data`.

    Its arguments are the indices `(N,)` of the demonstrations that have not ended; their positions
    now and one step before, `(N, D)` [m]; their next actions `(N, chunk, D)` in limits, 0 after the
    last one. The `tracker` of all paths moves along.
    """
    lengths = np.array([len(a) for a in data.actions])
    longest = lengths.max()
    states = np.stack([np.pad(s, ((0, longest + 1 - len(s)), (0, 0)), "edge") for s in data.states])
    actions = np.stack([np.pad(a, ((0, longest + chunk - len(a)), (0, 0))) for a in data.actions])
    steps = []
    for t in range(longest):
        now, before = states[:, t], states[:, max(t - 1, 0)]
        if t and tracker is not None:
            tracker.update(now, before)
        rows = np.flatnonzero(t < lengths)
        following = actions[rows, t : t + chunk] / data.limit
        steps.append(list(seen(rows, now[rows], before[rows], following)))
    guided, unguided = (
        (np.concatenate([x for x, _ in samples]), np.concatenate([a for _, a in samples]))
        for samples in zip(*steps, strict=True)
    )
    return guided, unguided


def train_policy(
    data: Demonstrations,
    validation: Dataset,
    run: Run,
    config: PolicyTrainingConfig | None = None,
    *,
    stage: str = "policy",
    **settings: Any,
) -> Trained[Any]:
    """Train stage 2 or the baselines' policy on `data` and validate it by rollouts.

    Args:
        data: demonstrations.
        validation: a dataset of another seed stream, whose paths or goals guide the rollouts.
        run: where to train.
        config: how to train.
        stage: `policy`, stage 2, or `goal`, the baselines' goal-conditioned policy, whose goal is
            replaced by the null condition with the probability `dropout`.
        **settings: of `PathPolicyConfig` or `GoalPolicyConfig`, without `dim` and `limit`, which
            the data fix.

    Raises:
        InvalidInputError: the validation data are of another dimension.
        CheckpointError: see `train`.
    """
    shape, network, samples, validate = _STAGES[stage]
    config = config or PolicyTrainingConfig()
    dim = data.paths.shape[-1]
    if validation.config.dim != dim:
        raise InvalidInputError(
            f"the validation data are {validation.config.dim}-D, the data {dim}-D"
        )
    model = new_model(network, shape(**settings, dim=dim, limit=data.limit), config.seed)
    model.to(run.team.device)
    guided, unguided = samples(data, model.config.chunk)
    batches = PolicyBatches(guided, unguided, config, run.team)
    model.scale.copy_(batches.guided[1].square().mean().sqrt())
    shown = {**asdict(data.config), "number": len(data)}
    source = Source(data.dataset.to_dict(), data.digest, shown)
    return train(model, batches.loss, lambda m: validate(m, validation), config, run, source)


def _rollouts(
    model: Any, policy: Callable[[Any], Driver], paths: list[Path], scenes: list[Scene]
) -> list[Rollout]:
    """One closed-loop motion in each of `scenes`, with a driver of the model on the CPU."""
    device = next(model.parameters()).device
    env = vector_type(None, scenes[0].dim)(len(scenes))
    try:
        env.reset(seed=0, options={"scene": scenes})
        return follow(Fleet(env, 0), paths, policy(model.to("cpu")))
    finally:
        env.close()
        model.to(device)


def validate_policy(model: PathPolicy, validation: Dataset, paths: int = 2) -> dict[str, float]:
    """Rollouts along archive paths: success, and mean distance from the path over its length."""
    config = validation.config
    chosen = np.linspace(0, config.per_scene - 1, paths * len(validation.scenes)).round()
    chosen = np.random.default_rng(0).permutation(chosen.astype(np.intp))
    scenes = [scene for scene in validation.scenes for _ in range(paths)]
    plans = []
    for number, (scene, index) in enumerate(zip(scenes, chosen, strict=True)):
        inner = validation.waypoints[number // paths, index].astype(np.float64)
        plans.append(Path.through(
            np.concatenate([scene.start[None], inner, scene.goals[:1]]),
            scene, 0, validation.labels[number // paths, index], config.observer,
        ))  # fmt: skip
    rollouts = _rollouts(model, Policy, plans, scenes)
    lengths = [arc_length(plan.trajectory()) for plan in plans]
    off = [r.deviation.mean() / n for r, n in zip(rollouts, lengths, strict=True)]
    return {
        "validation_success": float(np.mean([r.success for r in rollouts])),
        "validation_deviation": float(np.mean(off)),
        "validation_steps": float(np.mean([len(r.actions) for r in rollouts])),
    }


def _guided_rollouts(model: GoalPolicy, scenes: list[Scene], observer: Observer) -> list[Rollout]:
    """One closed-loop motion to goal 0 of each of `scenes`."""
    paths = [straight_path(scene, 0, 0.0, observer) for scene in scenes]
    return _rollouts(
        model, lambda m: GuidedPolicy(m, scenes, [0] * len(paths), seed=0), paths, scenes
    )


def validate_goal(model: GoalPolicy, validation: Dataset) -> dict[str, float]:
    """Rollouts in the scenes of `validation`: success, steps, and length over the straight line."""
    rollouts = _guided_rollouts(model, validation.scenes, validation.config.observer)
    straight = [np.linalg.norm(np.diff(r.path.waypoints[[0, -1]], axis=0)) for r in rollouts]
    lengths = [np.linalg.norm(np.diff(r.states, axis=0), axis=-1).sum() for r in rollouts]
    return {
        "validation_success": float(np.mean([r.success for r in rollouts])),
        "validation_length_ratio": float(np.median(np.divide(lengths, straight))),
        "validation_steps": float(np.mean([len(r.actions) for r in rollouts])),
    }


_STAGES: dict[str, Any] = {
    "policy": (PathPolicyConfig, PathPolicy, along_paths, validate_policy),
    "goal": (GoalPolicyConfig, GoalPolicy, toward_goals, validate_goal),
}
"""The settings of each stage, its network, its samples and its validation."""


def tune_guidance(
    model: GoalPolicy,
    validation: Dataset,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> tuple[dict[str, float], list[dict[str, float]]]:
    """The best of all combinations of `GUIDANCE` by the achieved ℓ on the scenes of `validation`.

    Returns:
        The chosen settings, and the `success` and mean `achieved` ℓ of every combination.
    """

    def worth(rollouts: list[Rollout]) -> dict[str, float]:
        knots = validation.score_at_label
        pairs = zip(rollouts, knots, strict=True)
        achieved = [np.interp(rollout.score, row, LABEL_KNOTS) for rollout, row in pairs]
        return {"achieved": float(np.mean(achieved))}

    scenes, observer = validation.scenes, validation.config.observer
    rows = try_guidance(model, scenes, observer, GUIDANCE, worth, progress)
    return best_guidance(rows, GUIDANCE, lambda row: row["achieved"]), rows


def try_guidance(
    model: GoalPolicy,
    scenes: list[Scene],
    observer: Observer,
    grid: Mapping[str, Sequence[float]],
    worth: Callable[[list[Rollout]], dict[str, float]],
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> list[dict[str, float]]:
    """Every combination of the values of `grid`, with its `success` and its `worth`.

    `worth` is of a motion to goal 0 in each of `scenes`.
    """
    rows = []
    combinations = [dict(zip(grid, v, strict=True)) for v in product(*grid.values())]
    plain = model.config
    for done, settings in enumerate(combinations):
        model.config = replace(plain, **settings)
        rollouts = _guided_rollouts(model, scenes, observer)
        success = float(np.mean([r.success for r in rollouts]))
        rows.append({**settings, "success": success, **worth(rollouts)})
        progress(done + 1, len(combinations))
    model.config = plain
    return rows


def best_guidance(
    rows: list[dict[str, float]], names: Iterable[str], worth: Callable[[dict[str, float]], float]
) -> dict[str, float]:
    """The settings `names` of the row of highest `worth` of those that arrive in 99 % of scenes.

    Of those that arrive most often, if none does.
    """
    enough = min(_SUCCESS, max(row["success"] for row in rows))
    best = max((row for row in rows if row["success"] >= enough), key=worth)
    return {name: best[name] for name in names}
