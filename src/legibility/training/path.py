"""Training of stage 1, a teacher or its student, and the dial on validation scenes.

A student draws in one step what its teacher draws in many, guided. Guidance and steps are distilled
together (Luhman & Luhman 2021; Meng et al. 2023): the student learns to map the same noise to the
same path. One step yields the final path, so its achieved label is a second loss, which makes the
dial more exact. On its own that loss would reach ℓ = ±1 by waves, so jerk beyond the teacher's
costs too.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional as F

from ..data.dataset import LABEL_KNOTS, Dataset
from ..errors import InvalidInputError
from ..frame import Frame
from ..models.configuration import PathDiffuserConfig
from ..models.diffusion import noised, sampling_timesteps
from ..models.path_diffuser import DIAL_LEVELS, PathDiffuser, dial_of
from ..models.provenance import Source, TeacherRecord
from .configuration import DistillationConfig, PathTrainingConfig
from .loop import Run, Trained, new_model, train
from .scorer import FrameScorer
from .team import Team

_AT_ONCE = 64  # scenes for which a teacher draws at a time


class PathBatches:
    """A dataset as tensors on a device, and the loss of stage 1 over random batches of it."""

    def __init__(
        self, data: Dataset, model: PathDiffuser, config: PathTrainingConfig, team: Team
    ) -> None:
        self.config, self.team = config, team
        conditions = model.conditions(data.scenes, [0] * len(data.scenes), data.observers)
        self.conditions = conditions.map(lambda x: x.to(team.device))
        motions = zip(data.scenes, data.waypoints, strict=True)
        waypoints = np.stack([Frame.of(s, 0).world_to_frame(w) for s, w in motions])
        self.waypoints = torch.from_numpy(waypoints.astype(np.float32)).to(team.device)
        self.labels = torch.tensor(data.labels, device=team.device)
        self.scorer = FrameScorer(data, self.conditions)
        levels = np.searchsorted(LABEL_KNOTS, DIAL_LEVELS)
        self.dials = torch.from_numpy(dial_of(data.score_at_label[:, levels])).to(team.device)

    def loss(
        self, model: PathDiffuser, generator: torch.Generator
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """Squared error of the velocity, plus losses on the denoised path's label and contacts."""
        config, steps = self.config, model.config.diffusion_steps
        num, per = config.scenes, config.per_scene
        scenes = torch.randint(len(self.labels), (num,), generator=generator)
        chosen = torch.randint(self.labels.shape[1], (num, per), generator=generator)
        timestep = torch.randint(steps, (num * per,), generator=generator)
        noise = torch.randn(num * per, *self.waypoints.shape[2:], generator=generator)
        keep = torch.rand(num, generator=generator) >= config.dropout
        scenes, chosen, timestep, noise, keep = (
            x.to(self.team.device) for x in (scenes, chosen, timestep, noise, keep)
        )
        # The label loss is that of the path denoised in one step. Under much noise this path is a
        # mean over many, whose label says little: weigh it by the squared signal, or not at all.
        signal = model.signal[timestep]
        weight = signal**2 * (keep.repeat_interleave(per) & (signal > 0.2))
        weight = weight / weight.sum().clamp_min(1e-6) * self.team.size
        scenes, chosen, timestep, noise, keep, signal, weight = map(
            self.team.share, (scenes, chosen, timestep, noise, keep, signal, weight)
        )
        index, chosen = scenes.repeat_interleave(per), chosen.flatten()
        waypoints, label = self.waypoints[index, chosen], self.labels[index, chosen]

        clean = model.to_latent(waypoints)
        signal = signal[:, None, None]
        noisy, velocity = noised(clean, noise, signal)
        kept = keep.repeat_interleave(per)
        conditions = self.conditions.without_image().map(lambda x: x[index])
        with self.team.autocast():
            seen = self.conditions.map(lambda x: x[scenes])
            scene = model.encode_scene(seen, self.dials[scenes], keep)
            context = model.encode(scene.repeat_interleave(per, 0), label, kept)
            predicted = model(noisy, timestep, context, conditions, kept)
        predicted = predicted.float()
        velocity_loss = F.mse_loss(predicted, velocity)
        clear = torch.nonzero(weight)[:, 0]
        weight = weight[clear]
        estimate = (signal.sqrt() * noisy - (1 - signal).sqrt() * predicted)[clear]
        conditions = conditions.map(lambda x: x[clear])
        found, index, label = model.from_latent(estimate), index[clear], label[clear]
        points = self.scorer.curve(found)
        error = self.scorer.error(conditions, index, points, label)
        parts = {
            "velocity": velocity_loss,
            "label": (weight * error).sum(),
            "contact": (weight * self.scorer.contact(conditions, points)).sum(),
            "jerk": (weight * self.scorer.jerk(found, waypoints[clear])).sum(),
        }
        return self.weighed(parts)

    def weighed(self, parts: dict[str, Tensor]) -> tuple[Tensor, dict[str, Tensor]]:
        """The sum of the losses by their weights, and each for the log."""
        config = self.config
        weights = {
            "label": config.score_weight,
            "contact": config.contact_weight,
            "jerk": config.jerk_weight,
        }
        total = torch.stack([weights.get(name, 1.0) * part for name, part in parts.items()]).sum()
        return total, {name: part.detach() for name, part in parts.items()}

    @torch.no_grad()
    def spread(self, model: PathDiffuser) -> Tensor:
        """`(K, D)`: standard deviation of the latent about the straight line, over the data."""
        return (model.to_latent(self.waypoints) * model.spread).square().mean((0, 1)).sqrt()


class DistillationBatches(PathBatches):
    """The teacher's paths in every scene of the dataset, and the loss of the student."""

    config: DistillationConfig

    def __init__(
        self,
        data: Dataset,
        teacher: PathDiffuser,
        config: DistillationConfig,
        team: Team,
        drawn: Callable[[int, int], None] = lambda done, total: None,
    ) -> None:
        super().__init__(data, teacher, config, team)
        self.teacher = teacher
        self.drawn = drawn
        self.noise = torch.empty(0)

    def draw(self) -> None:
        """Let the teacher draw the paths that the student learns, from noise and for labels."""
        num, pairs, device = len(self.labels), self.config.pairs, self.team.device
        generator = torch.Generator().manual_seed(self.config.seed)
        report = self.drawn if self.team.main else lambda done, total: None
        shape = (num, pairs, *self.waypoints.shape[2:])
        spread = (torch.arange(pairs) + torch.rand(num, pairs, generator=generator)) / pairs
        levels = ((2 * spread - 1) / (1 - self.config.ends)).clamp(-1, 1)
        self.labels = levels.to(device)
        noise = torch.randn(shape, generator=generator).to(device)
        self.waypoints = torch.empty(shape, device=device)
        before = self.teacher.spread.device
        self.teacher.to(device)
        for scenes in torch.arange(num, device=device).split(_AT_ONCE):
            report(int(scenes[0]), num)
            rows = scenes.repeat_interleave(pairs)
            conditions = self.conditions.map(lambda x, rows=rows: x[rows])
            levels, drawn = self.labels[scenes].flatten(), noise[scenes].flatten(0, 1)
            paths = self.teacher.sample(conditions, levels, drawn, dial=self.dials[rows])
            self.waypoints[scenes] = paths.unflatten(0, (-1, pairs))
        self.teacher.to(before)
        report(num, num)
        self.noise = noise

    def loss(
        self, model: PathDiffuser, generator: torch.Generator
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """Squared distance from the teacher's paths, plus losses on label, contacts and jerk."""
        if not len(self.noise):
            self.draw()
        config, per = self.config, self.config.per_scene
        scenes = torch.randint(len(self.labels), (config.scenes,), generator=generator)
        chosen = torch.randint(self.labels.shape[1], (config.scenes, per), generator=generator)
        scenes, chosen = (self.team.share(x).to(self.team.device) for x in (scenes, chosen))
        each, chosen = scenes.repeat_interleave(per), chosen.flatten()
        level, noise = self.labels[each, chosen], self.noise[each, chosen]
        conditions = self.conditions.without_image().map(lambda x: x[each])
        times = sampling_timesteps(len(model.signal), config.sampling_steps)
        with self.team.autocast():
            seen = self.conditions.map(lambda x: x[scenes])
            scene = model.encode_scene(seen, self.dials[scenes])
            context = model.encode(scene.repeat_interleave(per, 0), level)
            found = model.denoise(conditions, context, noise, times)
        found = found.float()
        taught = self.waypoints[each, chosen]
        path_loss = F.mse_loss(model.to_latent(found), model.to_latent(taught))
        points = self.scorer.curve(found)
        return self.weighed({
            "path": path_loss,
            "label": self.scorer.error(conditions, each, points, level).mean(),
            "contact": self.scorer.contact(conditions, points).mean(),
            "jerk": self.scorer.jerk(found, taught).mean(),
        })  # fmt: skip


def train_path(
    data: Dataset,
    validation: Dataset,
    run: Run,
    config: PathTrainingConfig | None = None,
    **settings: Any,
) -> Trained[PathDiffuser]:
    """Train stage 1 on `data` and validate it on the scenes of `validation`.

    Args:
        data: labelled trajectories.
        validation: of another seed stream; its scenes measure the dial during training.
        run: where to train.
        config: how to train.
        **settings: of `PathDiffuserConfig`, without those that the data fix.

    Raises:
        InvalidInputError: the validation data have labels of another observer.
        CheckpointError: see `train`.
    """
    config = config or PathTrainingConfig()
    settings |= {name: getattr(data.config, name) for name in ("dim", "observer")}
    settings["recorded"] = bool(data.config.recordings)
    model = new_model(PathDiffuser, PathDiffuserConfig(**settings), config.seed)
    check_data(model.config, data, validation)
    model.to(run.team.device)
    batches = PathBatches(data, model, config, run.team)
    model.spread.copy_(batches.spread(model))
    checks = PathBatches(validation, model, config, run.team)
    source = Source(data.config.to_dict(), data.digest)
    return train(model, batches.loss, lambda m: validate_dial(m, checks), config, run, source)


def distill_path(
    teacher: PathDiffuser,
    data: Dataset,
    validation: Dataset,
    run: Run,
    config: DistillationConfig,
    record: TeacherRecord,
    *,
    drawn: Callable[[int, int], None] = lambda done, total: None,
) -> Trained[PathDiffuser]:
    """Train a student of `teacher`, a stage 1 of fewer sampling steps and without guidance.

    Args:
        teacher: a trained stage 1.
        data: of the teacher's labels; the student learns in its scenes.
        validation: of another seed stream; its scenes measure the dial during training.
        run: where to train; a resumed run lets the teacher draw again.
        config: how to train.
        record: of the teacher.
        drawn: called with the number of scenes for which the teacher has drawn, and that of all.

    Raises:
        InvalidInputError: the data are of another observer than the teacher.
    """
    if config.sampling_steps > teacher.config.diffusion_steps:
        raise InvalidInputError(
            f"sampling_steps must be at most {teacher.config.diffusion_steps}, "
            f"got {config.sampling_steps}"
        )
    check_data(teacher.config, data, validation)
    settings = replace(
        teacher.config, sampling_steps=config.sampling_steps, guidance=0.0, distilled=True
    )
    student = PathDiffuser(settings).to(run.team.device)
    student.load_state_dict(teacher.state_dict())
    student.no_level.requires_grad_(False)  # a student always has its conditions
    student.no_field.requires_grad_(not settings.field)
    batches = DistillationBatches(data, teacher, config, run.team, drawn)
    checks = PathBatches(validation, student, config, run.team)
    source = Source(data.config.to_dict(), data.digest, teacher=record)
    return train(student, batches.loss, lambda m: validate_dial(m, checks), config, run, source)


def check_data(config: PathDiffuserConfig, data: Dataset, validation: Dataset) -> None:
    """Raise unless both datasets have the dimension and the meaning of ℓ of a model of `config`."""
    for name, dataset in (("data", data), ("validation data", validation)):
        theirs, ours = (
            {"dim": c.dim, **{k: getattr(c.observer, k) for k in ("alpha", "detour", "label")}}
            for c in (dataset.config, config)
        )
        for key, value in ours.items():
            if theirs[key] != value:
                raise InvalidInputError(f"the {name} have {key} {theirs[key]}, the model {value}")


@torch.no_grad()
def validate_dial(
    model: PathDiffuser, checks: PathBatches, levels: int = 11, samples: int = 2
) -> dict[str, float]:
    """The dial on validation scenes: rank and error of the achieved label, feasible curves."""
    from scipy.stats import spearmanr

    device, size = checks.team.device, len(checks.labels)
    scenes = torch.arange(size, device=device)
    asked = torch.linspace(-1, 1, levels, device=device).repeat_interleave(samples)
    shape = (size, len(asked), *checks.waypoints.shape[2:])
    noise = torch.randn(shape, generator=torch.Generator().manual_seed(0)).to(device)
    achieved = torch.empty(shape[:2], device=device)
    feasible = torch.zeros((), device=device)
    for column, level in enumerate(asked):
        levels_asked = level.expand(size)
        drawn = model.sample(checks.conditions, levels_asked, noise[:, column], dial=checks.dials)
        points = checks.scorer.curve(drawn)
        achieved[:, column] = checks.scorer.label(checks.conditions, scenes, points).clamp(-1, 1)
        feasible += (checks.conditions.margin(points) >= -1e-3).all(dim=1).float().mean()
    labels, wanted = achieved.cpu().numpy(), asked.cpu().numpy()
    ranks = np.array([spearmanr(wanted, row)[0] if np.ptp(row) > 1e-4 else 0.0 for row in labels])
    return {
        "validation_spearman": float(ranks.mean()),
        "validation_spearman_worst": float(ranks.min()),
        "validation_error": float(np.abs(labels - wanted).mean()),
        "validation_feasible": float(feasible / len(asked)),
        "validation_at_1": float(labels[:, -samples:].mean()),
        "validation_at_-1": float(labels[:, :samples].mean()),
    }
