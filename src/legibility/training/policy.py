"""How policies are trained: batches, loss, and stage 2 in closed loop on validation scenes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path as FilePath
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
from ..drivers import Policy
from ..envs import vector_type
from ..envs.fleet import Fleet
from ..errors import InvalidInputError
from ..models.configuration import PathPolicyConfig
from ..models.diffusion import noise_schedule, noised
from ..models.goal_policy import GoalPolicy
from ..models.path_policy import Observation, PathPolicy
from ..motion.path import Path
from ..motion.tracking import PathTracker
from ..rollout import follow
from .configuration import PolicyTrainingConfig
from .loop import Progress, train
from .team import Team

__all__ = ["PolicyBatches", "train_policy", "validate_policy"]


class PolicyBatches:
    """Every step of the demonstrations as tensors, and the loss of a policy over random batches.

    Args:
        guided: features `(M, F)` and chunks of actions `(M, chunk, D)` of each of all M steps, with
            what guides the policy.
        unguided: the same without it.
        config: how to train.
        team: of this process.
    """

    def __init__(
        self,
        guided: Sequence[Array],
        unguided: Sequence[Array],
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


def along_paths(data: Demonstrations, config: PathPolicyConfig) -> list[list[Array]]:
    """Features `(M, F)` and chunks of actions `(M, chunk, D)` of each of all M steps.

    Once as the policy sees them with the path, once without it.
    """
    tracker = PathTracker(data.paths, data.limit, data.workspace)
    goals = data.paths[:, -1]
    found: list[list[list[Array]]] = [[[], []], [[], []]]
    for rows, now, before, chunk in moments(data, config.chunk, tracker):
        part = tracker.of(rows)
        for kind, along in zip(found, (part, None), strict=True):
            seen = Observation.of(now, before, goals[rows], data.limit, along)
            kind[0].append(seen.features)
            kind[1].append(chunk @ seen.rotation.swapaxes(1, 2))
    return [[np.concatenate(parts) for parts in kind] for kind in found]


def moments(
    data: Demonstrations, size: int, tracker: PathTracker | None = None
) -> Iterator[tuple[NDArray[np.intp], Array, Array, Array]]:
    """Of each time in turn which demonstrations go on, where they are, were, and do next.

    Indices `(N,)`, positions `(N, D)` now and one step before [m], chunks of the next `size`
    actions `(N, size, D)` in limits; after the last they are 0. A `tracker` of all is kept up.
    """
    lengths = np.array([len(a) for a in data.actions])
    longest = lengths.max()
    states = np.stack([_extended(s, longest + 1) for s in data.states])
    actions = np.zeros((len(data), longest + size, data.paths.shape[-1]))
    for row, own in zip(actions, data.actions, strict=True):
        row[: len(own)] = own
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
    folder: str | FilePath,
    config: PolicyTrainingConfig | None = None,
    *,
    device: str | None = None,
    precision: str | None = None,
    progress: Progress = lambda step, steps, figures: None,
    **settings: Any,
) -> PathPolicy:
    """Train stage 2 on `data`, validated by rollouts along paths of `validation`.

    Args:
        data: demonstrations.
        validation: a dataset of another seed stream.
        folder: of the checkpoint and the log; an interrupted run goes on from there.
        config: how to train.
        device: where to; a GPU where there is one.
        precision: no (float32), bf16 or fp16, see `Team.join`.
        progress: see `train`.
        **settings: of `PathPolicyConfig`, but those that the data fixes.

    Returns:
        The trained model, on the CPU.
    """
    config = config or PolicyTrainingConfig()
    settings |= {"dim": data.paths.shape[-1], "limit": data.limit}
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(config.seed)
        model = PathPolicy(PathPolicyConfig(**settings))
    parts = along_paths(data, model.config)
    team = Team.join(device, precision)
    return fit(model, parts, data, validation, folder, config, validate_policy, team, progress)


P = TypeVar("P", PathPolicy, GoalPolicy)


def fit(
    model: P,
    parts: list[list[Array]],
    data: Demonstrations,
    validation: Dataset,
    folder: str | FilePath,
    config: PolicyTrainingConfig,
    validate: Callable[[P, Dataset], dict[str, float]],
    team: Team,
    progress: Progress,
) -> P:
    """Train a policy on `parts`, guided and unguided, of `data`; see `train_policy`."""
    if validation.config.dim != model.config.dim:
        raise InvalidInputError(
            f"the validation data are {validation.config.dim}-D, the data {model.config.dim}-D"
        )
    batches = PolicyBatches(parts[0], parts[1], config, team)
    model = model.to(team.device)
    model.signal.copy_(noise_schedule(model.config.diffusion_steps))
    model.scale.copy_(batches.scale())
    identity = {"model": model.config.to_dict(), "data": data.digest}
    trained = train(
        model,
        batches.loss,
        lambda m: validate(m, validation),
        config,
        folder,
        identity=identity,
        team=team,
        progress=progress,
    )
    return trained.to("cpu")


def validate_policy(model: PathPolicy, validation: Dataset, paths: int = 2) -> dict[str, float]:
    """Rollouts along archive paths: success, and mean distance from the path over its length."""
    where = next(model.parameters()).device
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
    env = vector_type(None, config.dim)(len(scenes))
    env.reset(seed=0, options={"scene": scenes})
    rollouts = follow(Fleet(env, 0), plans, Policy(model.to("cpu"), seed=0))
    model.to(where)
    lengths = [arc_length(plan.trajectory()) for plan in plans]
    off = [r.deviation.mean() / n for r, n in zip(rollouts, lengths, strict=True)]
    return {
        "validation_success": float(np.mean([r.success for r in rollouts])),
        "validation_deviation": float(np.mean(off)),
        "validation_steps": float(np.mean([len(r.actions) for r in rollouts])),
    }
