"""Distillation of stage 1: a student draws in one step what its teacher draws in many, guided.

Guidance and steps of the teacher are distilled together (Luhman & Luhman 2021; Meng et al. 2023):
the student learns to map the same noise to the same path. One step yields the final path, so its
achieved label is a second loss, which makes the dial more exact. On its own that loss would reach
ℓ = ±1 by waves, so jerk beyond the teacher's costs too.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import torch
from torch import Tensor
from torch.nn import functional as F

from ..data.dataset import Dataset
from ..errors import InvalidInputError
from ..models.diffusion import sampling_timesteps
from ..models.path_diffuser import PathDiffuser
from ..models.provenance import Source, TeacherRecord
from .configuration import DistillationConfig
from .loop import Run, Trained, train
from .path import PathBatches, check_data, validate_dial
from .team import Team

_AT_ONCE = 16  # scenes for which the teacher draws at a time
_SMOOTH = 0.01  # added to a jerk, so that differences far below it do not count


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
            paths = self.teacher.sample(conditions, levels, drawn)
            self.waypoints[scenes] = paths.unflatten(0, (-1, pairs))
        self.teacher.to(before)
        report(num, num)
        self.noise = noise

    def loss(
        self, model: PathDiffuser, generator: torch.Generator
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """Squared distance from the teacher's paths, plus losses on label, walls and jerk."""
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
            scene = model.encode_scene(self.conditions.map(lambda x: x[scenes]))
            context = model.encode(scene.repeat_interleave(per, 0), level)
            found = model.denoise(conditions, context, noise, times)
        found = found.float()
        taught = self.waypoints[each, chosen]
        path_loss = F.mse_loss(model.to_latent(found), model.to_latent(taught))
        points = self.scorer.curve(found)
        achieved = self.scorer.label(conditions, each, points)
        # Labels end at ±1, scores go beyond: at the ends only a path that falls short is wrong.
        beyond = (level.abs() == 1) & (achieved * level > 1)
        label_loss = F.smooth_l1_loss(torch.where(beyond, level, achieved), level, beta=0.1)
        wall_loss = F.relu(-conditions.wall_distance(points)).mean()
        jerk_loss = F.relu((self._jerk(found) / self._jerk(taught)).log()).mean()
        total = path_loss + config.score_weight * label_loss + config.wall_weight * wall_loss
        total = total + config.jerk_weight * jerk_loss
        parts = {"path": path_loss, "label": label_loss, "wall": wall_loss, "jerk": jerk_loss}
        return total, {name: part.detach() for name, part in parts.items()}

    def _jerk(self, waypoints: Tensor) -> Tensor:
        """`(B,)`: squared third differences along paths of waypoints `(B, K, D)`, plus `_SMOOTH`.

        In squared lengths of the straight line.
        """
        return self.scorer.path(waypoints).diff(n=3, dim=1).square().sum((1, 2)) + _SMOOTH


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
    """Train a student that draws the paths of `teacher` in fewer steps and without guidance.

    Args:
        teacher: a trained stage 1.
        data: of the teacher's labels; the student learns in its scenes.
        validation: of another seed stream; its scenes measure the dial during training.
        run: where to train; a resumed run lets the teacher draw again.
        config: how to train.
        record: of the teacher.
        drawn: called with the number of scenes for which the teacher has drawn, and that of all.

    Returns:
        The student, a stage 1 like any other, with its own `sampling_steps`.

    Raises:
        InvalidInputError: the data are of another observer than the teacher, or the student has
            more sampling steps than diffusion has.
        CheckpointError: see `train`.
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
