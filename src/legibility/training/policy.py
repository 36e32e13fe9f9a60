"""Training of policies: batches, loss, and stage 2 in closed loop on validation scenes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import asdict
from functools import partial
from typing import Any, TypeVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional as F

from ..checks import Array
from ..curves import arc_length
from ..data.dataset import Dataset
from ..data.demonstrations import Demonstrations
from ..drivers import Driver, Policy
from ..envs import vector_type
from ..envs.fleet import Fleet
from ..errors import InvalidInputError
from ..models.configuration import ActionConfig, PathPolicyConfig
from ..models.diffusion import noised
from ..models.goal_policy import GoalPolicy
from ..models.path_policy import Observation, PathPolicy
from ..models.provenance import Source
from ..motion.path import Path
from ..motion.tracking import PathTracker
from ..rollout import Rollout, follow
from ..scene import Scene
from .configuration import PolicyTrainingConfig
from .loop import Run, Trained, new_model, train
from .team import Team

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
        self,
        guided: Samples,
        unguided: Samples,
        config: PolicyTrainingConfig,
        team: Team,
    ) -> None:
        team.shared("batch", config.batch)
        self.config = config
        self.team = team
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

    def scale(self) -> Tensor:
        """Root mean square of the actions, in limits."""
        return self.guided[1].square().mean().sqrt()


def along_paths(data: Demonstrations, chunk: int) -> tuple[Samples, Samples]:
    """Every step of the demonstrations as the policy sees it with the path, and without it."""
    tracker = PathTracker(data.paths, data.limit, data.workspace)
    goals = data.paths[:, -1]
    samples: tuple[list[Samples], list[Samples]] = ([], [])
    for rows, now, before, actions in moments(data, chunk, tracker):
        path = tracker.of(rows)
        for steps, along in zip(samples, (path, None), strict=True):
            view = Observation.of(now, before, goals[rows], data.limit, along)
            steps.append((view.features, actions @ view.rotation.swapaxes(1, 2)))
    return joined(samples[0]), joined(samples[1])


def joined(steps: list[Samples]) -> Samples:
    """The samples of several times as one."""
    features, actions = zip(*steps, strict=True)
    return np.concatenate(features), np.concatenate(actions)


def moments(
    data: Demonstrations, size: int, tracker: PathTracker | None = None
) -> Iterator[tuple[NDArray[np.intp], Array, Array, Array]]:
    """Iterate over the times of all demonstrations at once.

    Args:
        data: the demonstrations.
        size: actions of a chunk.
        tracker: of all paths, which is moved along.

    Yields:
        At each time: indices `(N,)` of the demonstrations that have not ended; their positions now
        and one step before, `(N, D)` [m]; their next `size` actions `(N, size, D)` in limits, 0
        after the last one.
    """
    lengths = np.array([len(a) for a in data.actions])
    longest = lengths.max()
    states = np.stack([_extended(s, longest + 1) for s in data.states])
    actions = np.zeros((len(data), longest + size, data.paths.shape[-1]))
    for row, demonstration in zip(actions, data.actions, strict=True):
        row[: len(demonstration)] = demonstration
    for t in range(longest):
        now, before = states[:, t], states[:, max(t - 1, 0)]
        if t and tracker is not None:
            tracker.update(now, before)
        rows = np.flatnonzero(t < lengths)
        yield rows, now[rows], before[rows], actions[rows, t : t + size] / data.limit


def _extended(states: Array, size: int) -> Array:
    """`states (T, D)` with the last one repeated to `(size, D)`."""
    return np.concatenate([states, np.repeat(states[-1:], size - len(states), axis=0)])


def train_policy(
    data: Demonstrations,
    validation: Dataset,
    run: Run,
    config: PolicyTrainingConfig | None = None,
    **settings: Any,
) -> Trained[PathPolicy]:
    """Train stage 2 on `data` and validate it by rollouts along paths of `validation`.

    Args:
        data: demonstrations.
        validation: a dataset of another seed stream.
        run: where to train.
        config: how to train.
        **settings: of `PathPolicyConfig`, without `dim` and `limit`, which the data fix.

    Raises:
        InvalidInputError: the validation data are of another dimension.
        CheckpointError: see `train`.
    """
    return fit(
        PathPolicy, PathPolicyConfig, along_paths, validate_policy,
        data, validation, run, config, settings,
    )  # fmt: skip


P = TypeVar("P", PathPolicy, GoalPolicy)


def fit(
    network: Callable[[Any], P],
    shape: type[ActionConfig],
    samples: Callable[[Demonstrations, int], tuple[Samples, Samples]],
    validate: Callable[[P, Dataset], dict[str, float]],
    data: Demonstrations,
    validation: Dataset,
    run: Run,
    config: PolicyTrainingConfig | None,
    settings: dict[str, Any],
) -> Trained[P]:
    """Train a policy of any kind on `samples` of `data`; see `train_policy`."""
    config = config or PolicyTrainingConfig()
    dim = data.paths.shape[-1]
    if validation.config.dim != dim:
        raise InvalidInputError(
            f"the validation data are {validation.config.dim}-D, the data {dim}-D"
        )
    model = new_model(network, shape(**settings, dim=dim, limit=data.limit), config.seed)
    model.to(run.team.device)
    batches = PolicyBatches(*samples(data, model.config.chunk), config, run.team)
    model.scale.copy_(batches.scale())
    shown = {**asdict(data.config), "number": len(data)}
    source = Source(data.dataset.to_dict(), data.digest, shown)
    return train(model, batches.loss, lambda m: validate(m, validation), config, run, source)


def rollouts_of(
    model: P, policy: Callable[[P], Driver], paths: list[Path], scenes: list[Scene]
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
    rollouts = rollouts_of(model, partial(Policy, seed=0), plans, scenes)
    lengths = [arc_length(plan.trajectory()) for plan in plans]
    off = [r.deviation.mean() / n for r, n in zip(rollouts, lengths, strict=True)]
    return {
        "validation_success": float(np.mean([r.success for r in rollouts])),
        "validation_deviation": float(np.mean(off)),
        "validation_steps": float(np.mean([len(r.actions) for r in rollouts])),
    }
