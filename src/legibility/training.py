"""How weights are made: one loop that logs, validates, checkpoints and resumes bit for bit.

Every random number of a step comes from the seed and the step's number, so on a CPU a run that was
killed and resumed with the same number of threads makes the same weights as one that was not.
"""

from __future__ import annotations

import copy
import json
import math
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional as F

from .checks import bounded, count, positive, random_seed
from .curves import NUM_WAYPOINTS, spline_matrix
from .dataset import LABEL_KNOTS, Dataset
from .errors import CheckpointError, InvalidInputError, TrainingError
from .files import read_text, write_bytes
from .intent.metrics import SCORE_POINTS
from .models.checkpoint import load_state, load_tensors, save_tensors
from .models.frame import Frame
from .models.path_diffuser import Conditions, PathDiffuser, PathDiffuserConfig, noise_schedule

__all__ = ["TrainingConfig", "train_path"]

_LEAST_COST = 1e-30
CHECKPOINT = "checkpoint.safetensors"
LOG = "log.jsonl"


@dataclass(frozen=True)
class TrainingConfig:
    """How a model is trained.

    Attributes:
        steps: optimiser steps.
        scenes: scenes in a batch.
        per_scene: trajectories of each scene in a batch.
        learning_rate: its highest value, after the warm-up; it ends at 0 (cosine).
        warmup: steps of linear warm-up.
        weight_decay: of AdamW.
        dropout: probability that field and ℓ are dropped together, for guidance.
        score_weight: weight of the loss on the achieved label against that on the velocity.
        ema: decay of the exponential moving average of the weights, which is what is kept.
        seed: of the weights and of every batch.
        validate_every: steps between validations of the dial.
        checkpoint_every: steps between checkpoints.
    """

    steps: int = 7000
    scenes: int = 128
    per_scene: int = 8
    learning_rate: float = 1e-3
    warmup: int = 500
    weight_decay: float = 1e-4
    dropout: float = 0.1
    score_weight: float = 5.0
    ema: float = 0.999
    seed: int = 0
    validate_every: int = 1000
    checkpoint_every: int = 500

    def __post_init__(self) -> None:
        for name in ("steps", "scenes", "per_scene", "validate_every", "checkpoint_every"):
            count(name, getattr(self, name))
        random_seed("seed", self.seed)
        count("warmup", self.warmup, low=0)
        positive("learning_rate", self.learning_rate)
        bounded("weight_decay", self.weight_decay, 0)
        bounded("score_weight", self.score_weight, 0)
        for name in ("dropout", "ema"):
            if bounded(name, getattr(self, name), 0, 1) == 1:
                raise InvalidInputError(f"{name} must lie in [0, 1), got {getattr(self, name)}")


M = TypeVar("M", bound=nn.Module)
Progress = Callable[[int, int, dict[str, float]], None]


def train(
    model: M,
    loss: Callable[[M, torch.Generator], tuple[Tensor, dict[str, Tensor]]],
    validate: Callable[[M], dict[str, float]],
    config: TrainingConfig,
    folder: str | Path,
    *,
    identity: dict[str, Any],
    progress: Progress = lambda step, steps, figures: None,
) -> M:
    """Train `model` in `folder`, or go on with it, and return its moving average.

    Args:
        model: already on the device it shall be trained on.
        loss: of the model and a generator for all of the step's random numbers: the loss and
            figures to log.
        validate: figures of a model, logged every `validate_every` steps.
        config: how to train.
        folder: of the checkpoint and the log.
        identity: what this run is (data, model); a checkpoint of another is refused.
        progress: called after each step with the steps done, all of them and what was logged, if
            anything was.

    Raises:
        CheckpointError: the folder's checkpoint is corrupted or of another run.
    """
    folder = Path(folder)
    average = copy.deepcopy(model).requires_grad_(False).eval()
    optimizer = torch.optim.AdamW(
        model.parameters(), lr=config.learning_rate, weight_decay=config.weight_decay
    )
    identity = {**identity, "training": asdict(config)}
    done, seconds = 0, 0.0
    if (folder / CHECKPOINT).exists():
        done, seconds = _restore(folder / CHECKPOINT, model, average, optimizer, identity)
    log = _Log(folder, done)
    generator = torch.Generator()
    started = time.perf_counter() - seconds
    model.train()
    try:
        for step in range(done, config.steps):
            generator.manual_seed(_mix(config.seed, step))
            for group in optimizer.param_groups:
                group["lr"] = config.learning_rate * _schedule(step, config)
            value, figures = loss(model, generator)
            optimizer.zero_grad(set_to_none=True)
            value.backward()
            nn.utils.clip_grad_norm_(model.parameters(), 1.0)
            optimizer.step()
            _average(average, model, min(config.ema, (1 + step) / (10 + step)))

            finished = step + 1
            last = finished == config.steps
            seconds = time.perf_counter() - started
            row: dict[str, float] = {}
            if last or finished % config.checkpoint_every == 0 or finished % 50 == 0:
                row = {k: float(v) for k, v in {"loss": value.detach(), **figures}.items()}
                if not math.isfinite(row["loss"]):
                    raise TrainingError(
                        f"the loss is {row['loss']} at step {finished}; try a lower learning_rate"
                    )
            if last or finished % config.validate_every == 0:
                row |= validate(average)
            if row:
                log.write({"step": finished, "seconds": round(seconds, 3), **row})
            progress(finished, config.steps, row)
            if last or finished % config.checkpoint_every == 0:
                _store(folder / CHECKPOINT, model, average, optimizer, identity, finished, seconds)
    finally:
        log.close()
    return average


@torch.no_grad()
def _average(average: nn.Module, model: nn.Module, decay: float) -> None:
    """Exponential moving average of the weights; it forgets faster in the first steps."""
    for old, new in zip(average.parameters(), model.parameters(), strict=True):
        old.lerp_(new, 1 - decay)


def _mix(seed: int, step: int) -> int:
    """One number from two, without patterns from step to step."""
    return int(np.random.SeedSequence([seed, step]).generate_state(1, np.uint64)[0] >> 1)


def _schedule(step: int, config: TrainingConfig) -> float:
    if step < config.warmup:
        return (step + 1) / config.warmup
    progress = (step - config.warmup) / max(1, config.steps - config.warmup)
    return 0.5 * (1 + math.cos(math.pi * progress))


def _store(
    path: Path,
    model: nn.Module,
    average: nn.Module,
    optimizer: torch.optim.Optimizer,
    identity: dict[str, Any],
    step: int,
    seconds: float,
) -> None:
    tensors = {f"model.{k}": v for k, v in model.state_dict().items()}
    tensors |= {f"average.{k}": v for k, v in average.state_dict().items()}
    for index, state in optimizer.state_dict()["state"].items():
        tensors |= {f"optimizer.{index}.{k}": v for k, v in state.items()}
    save_tensors(path, tensors, {**identity, "step": step, "seconds": seconds})


def _restore(
    path: Path,
    model: nn.Module,
    average: nn.Module,
    optimizer: torch.optim.Optimizer,
    identity: dict[str, Any],
) -> tuple[int, float]:
    tensors, header = load_tensors(path)
    try:
        step, seconds = header.pop("step"), header.pop("seconds")
    except (AttributeError, KeyError, TypeError) as cause:
        raise CheckpointError(f"{path} is not a training checkpoint") from cause
    if header != json.loads(json.dumps(identity)):
        changed = [k for k in identity if header.get(k) != json.loads(json.dumps(identity[k]))]
        raise CheckpointError(f"{path} is of another run ({', '.join(changed)} differ)")
    groups: dict[str, dict[str, Tensor]] = {"model": {}, "average": {}, "optimizer": {}}
    for name, tensor in tensors.items():
        head, rest = name.split(".", 1)
        groups[head][rest] = tensor
    load_state(model, groups["model"], path)
    load_state(average, groups["average"], path)
    state: dict[int, dict[str, Tensor]] = {}
    for index, parameter in enumerate(model.parameters()):
        shapes = {"step": (), "exp_avg": parameter.shape, "exp_avg_sq": parameter.shape}
        state[index] = {}
        for key, shape in shapes.items():
            tensor = groups["optimizer"].get(f"{index}.{key}")
            if tensor is None or tensor.shape != shape or not torch.isfinite(tensor).all():
                raise CheckpointError(f"{path}: optimizer.{index}.{key} is missing or broken")
            state[index][key] = tensor
    optimizer.load_state_dict({**optimizer.state_dict(), "state": state})
    return step, seconds


class _Log:
    """JSONL always, TensorBoard where it is installed; rows after the checkpoint are dropped."""

    def __init__(self, folder: Path, done: int) -> None:
        self._path = folder / LOG
        text = read_text(self._path, "log", CheckpointError) if self._path.exists() else ""
        whole = [row for row in text.splitlines() if row.endswith("}")]
        try:
            self._rows = [row for row in whole if json.loads(row)["step"] <= done]
        except (ValueError, LookupError, TypeError) as cause:
            raise CheckpointError(f"{self._path} is not a training log") from cause
        self._save()
        try:
            from torch.utils.tensorboard import SummaryWriter
        except ImportError:
            self._board = None
        else:
            self._board = SummaryWriter(str(folder / "tensorboard"), purge_step=done + 1)

    def write(self, row: dict[str, float]) -> None:
        self._rows.append(json.dumps(row))
        self._save()
        if self._board is not None:
            for name in row.keys() - {"step"}:
                self._board.add_scalar(name, row[name], int(row["step"]))

    def _save(self) -> None:
        write_bytes(self._path, "".join(row + "\n" for row in self._rows).encode())

    def close(self) -> None:
        if self._board is not None:
            self._board.close()


class PathBatches:
    """The dataset as tensors on a device, and the loss of stage 1 over random batches of it."""

    def __init__(
        self, data: Dataset, model: PathDiffuser, config: TrainingConfig, device: torch.device
    ) -> None:
        self.config = config
        self.device = device
        scenes = data.scenes
        self.conditions = model.conditions(scenes, [0] * len(scenes)).map(lambda x: x.to(device))
        frames = [Frame.of(scene, 0) for scene in scenes]
        waypoints = np.stack(
            [f.world_to_frame(w) for f, w in zip(frames, data.waypoints, strict=True)]
        )
        self.waypoints = torch.from_numpy(waypoints.astype(np.float32)).to(device)
        self.labels = torch.tensor(data.labels, device=device)
        self.scorer = FrameScorer(data, self.conditions)

    def loss(
        self, model: PathDiffuser, generator: torch.Generator
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """Squared error of the velocity, and smooth L1 of the denoised path's achieved label."""
        config, steps = self.config, model.config.diffusion_steps
        num, per = config.scenes, config.per_scene
        scenes = torch.randint(len(self.labels), (num,), generator=generator)
        chosen = torch.randint(self.labels.shape[1], (num, per), generator=generator)
        timestep = torch.randint(steps, (num * per,), generator=generator)
        noise = torch.randn(num * per, *self.waypoints.shape[2:], generator=generator)
        keep = torch.rand(num, generator=generator) >= config.dropout
        scenes, chosen, timestep, noise, keep = (
            x.to(self.device) for x in (scenes, chosen, timestep, noise, keep)
        )
        each = scenes.repeat_interleave(per)
        waypoints = self.waypoints[each, chosen.flatten()]
        label = self.labels[each, chosen.flatten()]

        clean = model.to_latent(waypoints)
        signal = model.signal[timestep, None, None]
        noisy = signal.sqrt() * clean + (1 - signal).sqrt() * noise
        velocity = signal.sqrt() * noise - (1 - signal).sqrt() * clean
        scene = model.encode_scene(self.conditions.map(lambda x: x[scenes]), keep)
        kept = keep.repeat_interleave(per)
        context = model.encode(scene.repeat_interleave(per, 0), label, kept)
        conditions = self.conditions.without_image().map(lambda x: x[each])
        predicted = model(noisy, timestep, context, conditions, kept)
        velocity_loss = F.mse_loss(predicted, velocity)
        if not config.score_weight:
            return velocity_loss, {"velocity": velocity_loss.detach()}

        # What the path would achieve if denoised at once. Under much noise that is a mean over many
        # paths, whose label says little: it counts by the signal squared, and not under the most.
        clear = torch.nonzero(kept & (signal[:, 0, 0] > 0.2))[:, 0]
        estimate = (signal.sqrt() * noisy - (1 - signal).sqrt() * predicted)[clear]
        achieved = self.scorer.label(
            conditions.map(lambda x: x[clear]), each[clear], model.from_latent(estimate)
        )
        weight = signal[clear, 0, 0] ** 2
        error = F.smooth_l1_loss(achieved, label[clear], beta=0.1, reduction="none")
        label_loss = (weight * error).sum() / weight.sum().clamp_min(1e-6)
        total = velocity_loss + config.score_weight * label_loss
        return total, {"velocity": velocity_loss.detach(), "label": label_loss.detach()}

    @torch.no_grad()
    def spread(self, model: PathDiffuser) -> Tensor:
        """`(K, D)`: standard deviation of the latent about the straight line, over the data."""
        return (model.to_latent(self.waypoints) * model.spread).square().mean((0, 1)).sqrt()


class FrameScorer:
    """`legibility_score` and its label in PyTorch, differentiable, in the start–target frame."""

    def __init__(self, data: Dataset, conditions: Conditions) -> None:
        def tensor(array: np.ndarray) -> Tensor:
            return torch.tensor(array, dtype=torch.float32, device=conditions.vector.device)

        # In the logarithm, since a scene may be so clear that its whole legible side lies within
        # a millionth of its scores.
        knots = -np.log(np.maximum(-data.score_at_label, _LEAST_COST))
        self.knots = tensor(np.maximum.accumulate(knots, axis=1))
        self.values = tensor(LABEL_KNOTS)
        self.alpha = data.config.alpha
        self.spline = tensor(spline_matrix(NUM_WAYPOINTS + 2, SCORE_POINTS))
        self.ends = tensor(np.eye(2, data.config.dim, k=-1))

    def score(self, conditions: Conditions, waypoints: Tensor) -> Tensor:
        """`(B,)` of waypoints `(B, K, D)` in the start–target frames of `B` scenes."""
        ends = self.ends.expand(len(waypoints), -1, -1)
        path = torch.cat([ends[:, :1], waypoints, ends[:, 1:]], dim=1)
        points = self.spline @ path
        potential, _ = conditions.potential(points)
        steps = (points.diff(dim=1).square().sum(-1) + 1e-12).sqrt()
        progress = F.pad(steps.cumsum(1), (1, 0)) / steps.sum(1, keepdim=True)
        decay = torch.exp(-self.alpha * progress)
        width = progress.diff(dim=1) / 2
        weighted = decay * potential
        total = ((weighted[:, 1:] + weighted[:, :-1]) * width).sum(1)
        return -total / ((decay[:, 1:] + decay[:, :-1]) * width).sum(1)

    def label(self, conditions: Conditions, scenes: Tensor, waypoints: Tensor) -> Tensor:
        """The achieved label `(B,)`, extrapolated beyond ±1 so that its gradient never ends.

        Args:
            conditions: of the `B` scenes.
            scenes: their indices `(B,)` in the data.
            waypoints: `(B, K, D)` in their start–target frames.
        """
        score = -torch.log((-self.score(conditions, waypoints)).clamp_min(_LEAST_COST))
        knots = self.knots[scenes]
        right = torch.searchsorted(knots, score.detach()[:, None]).clamp(1, len(self.values) - 1)
        low, high = knots.gather(1, right - 1)[:, 0], knots.gather(1, right)[:, 0]
        span = (high - low).clamp_min(1e-5 * (knots[:, -1] - knots[:, 0]))
        right = right[:, 0]
        step = self.values[1] - self.values[0]
        return self.values[right - 1] + (score - low) / span * step


def train_path(
    data: Dataset,
    validation: Dataset,
    folder: str | Path,
    config: TrainingConfig | None = None,
    *,
    device: str | None = None,
    progress: Progress = lambda step, steps, figures: None,
    **settings: Any,
) -> PathDiffuser:
    """Train stage 1 on `data`, validated on the scenes of `validation`.

    Args:
        data: labelled trajectories.
        validation: of another seed stream; its scenes measure the dial while training.
        folder: of the checkpoint and the log; an interrupted run goes on from there.
        config: how to train.
        device: where to; a GPU where there is one.
        progress: see `train`.
        **settings: of `PathDiffuserConfig`, but those that the data fixes.

    Returns:
        The trained model, on the CPU.
    """
    config = config or TrainingConfig()
    settings |= {name: getattr(data.config, name) for name in ("dim", "sigma", "alpha", "label")}
    if "evaluation" in (data.config.stream, validation.config.stream):
        raise InvalidInputError("scenes of the stream evaluation are for evaluations alone")
    for name, value in settings.items():
        found = getattr(validation.config, name, value)
        if found != value:
            raise InvalidInputError(f"the validation data have {name} {found}, the data {value}")
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(config.seed)
        model = PathDiffuser(PathDiffuserConfig(**settings))
    where = _device(device)
    batches = PathBatches(data, model, config, where)
    model = model.to(where)
    model.signal.copy_(noise_schedule(model.config.diffusion_steps))
    model.spread.copy_(batches.spread(model))
    checks = PathBatches(validation, model, config, where)
    identity = {"model": model.config.to_dict(), "data": data.digest}
    trained = train(
        model,
        batches.loss,
        lambda m: validate_dial(m, checks),
        config,
        folder,
        identity=identity,
        progress=progress,
    )
    return trained.to("cpu")


def _device(name: str | None) -> torch.device:
    """The device `name`, or a GPU where there is one."""
    try:
        device = torch.device(name or ("cuda" if torch.cuda.is_available() else "cpu"))
        torch.empty(1, device=device)
    except (RuntimeError, AssertionError) as cause:
        reason = str(cause).splitlines()[0]
        raise InvalidInputError(f"device {name!r} cannot be used here: {reason}") from cause
    return device


@torch.no_grad()
def validate_dial(
    model: PathDiffuser, checks: PathBatches, levels: int = 11, samples: int = 2
) -> dict[str, float]:
    """The dial on validation scenes: Spearman and error of the achieved label, mean over scenes."""
    from scipy.stats import spearmanr

    scenes = torch.arange(len(checks.labels), device=checks.device)
    asked = torch.linspace(-1, 1, levels, device=checks.device).repeat_interleave(samples)
    shape = (len(scenes), len(asked), *checks.waypoints.shape[2:])
    noise = torch.randn(shape, generator=torch.Generator().manual_seed(0)).to(checks.device)
    achieved = torch.empty(len(scenes), len(asked), device=checks.device)
    for column, level in enumerate(asked):
        waypoints = model.sample(checks.conditions, level.expand(len(scenes)), noise[:, column])
        label = checks.scorer.label(checks.conditions, scenes, waypoints)
        achieved[:, column] = label.clamp(-1, 1)
    found = achieved.cpu().numpy()
    wanted = asked.cpu().numpy()
    ranks = np.array([spearmanr(wanted, row)[0] if np.ptp(row) > 1e-4 else 0.0 for row in found])
    return {
        "validation_spearman": float(ranks.mean()),
        "validation_spearman_worst": float(ranks.min()),
        "validation_error": float(np.abs(found - wanted).mean()),
        "validation_at_1": float(found[:, -samples:].mean()),
        "validation_at_-1": float(found[:, :samples].mean()),
    }
