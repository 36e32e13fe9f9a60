"""One training loop for every model: it logs, validates, checkpoints and resumes bit for bit.

All random numbers of a step follow from the seed and the number of the step. So a run on a CPU that
was killed and resumed with the same number of threads ends with the weights of one that was not,
and several processes, each of which draws the numbers of the whole batch and uses its share, take
the steps of one.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np
import torch
from torch import Tensor, nn

from ..errors import CheckpointError, TrainingError
from ..models.diffusion import noise_schedule
from ..models.provenance import Source, TrainingRecord
from .configuration import TrainingConfig
from .state import State
from .team import Team

CHECKPOINT = "checkpoint.safetensors"
LOG = "log.jsonl"

_LOG_EVERY = 50
_INTERVALS = ("validate_every", "checkpoint_every")
"""Settings that do not change the weights, so a resumed run may have others."""

M = TypeVar("M", bound=nn.Module)
Progress = Callable[[int, int, dict[str, float]], None]
Loss = Callable[[M, torch.Generator], tuple[Tensor, dict[str, Tensor]]]


@dataclass(frozen=True)
class Run:
    """Where a model is trained.

    Attributes:
        folder: of the checkpoint and the log, seen by all processes; an interrupted run resumes
            from there.
        team: the processes that train.
        progress: called by the main process after each step with the number of steps done, that of
            all steps, and the metrics if they were logged.
    """

    folder: Path
    team: Team = field(default_factory=Team.join)
    progress: Progress = lambda step, steps, metrics: None


@dataclass(frozen=True)
class Trained(Generic[M]):
    """The result of a training.

    Attributes:
        model: the moving average of the weights, on the CPU.
        record: how it was made.
        metrics: the last value of each metric in the log.
    """

    model: M
    record: TrainingRecord
    metrics: dict[str, float]


def new_model(network: Callable[[Any], M], config: Any, seed: int) -> M:
    """A network of `config` with the initial weights of a seed and its noise schedule."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        model = network(config)
    model.signal.copy_(noise_schedule(config.diffusion_steps))  # pyright: ignore
    return model


def train(
    model: M,
    loss: Loss[M],
    validate: Callable[[M], dict[str, float]],
    config: TrainingConfig,
    run: Run,
    source: Source,
) -> Trained[M]:
    """Train `model`, or resume its training, in the folder of a run.

    A run that is complete is not trained again: its model is that of the checkpoint.

    Args:
        model: on the device of the run's team.
        loss: of the model and a generator for all random numbers of the step: the loss and the
            metrics to log, whose means over the processes are those of the whole batch.
        validate: metrics of a model, logged every `validate_every` steps.
        config: how to train.
        run: where to train.
        source: what the model learns from.

    Raises:
        CheckpointError: the folder's checkpoint is corrupted or of another run.
        TrainingError: the loss is not finite.
    """
    team, checkpoint = run.team, run.folder / CHECKPOINT
    settings = _settings(model, config, team, source)
    state = State(model, config)
    if team.main:
        for leftover in run.folder.glob(".*.safetensors"):  # of a run that was killed
            leftover.unlink()
    if checkpoint.exists():
        state.restore(checkpoint, settings)
    _check_same_step(state.step, team, checkpoint)
    if team.main:
        state.log.write(run.folder / LOG)
    board = _tensorboard(run.folder, state.step) if team.main else None
    scaler, generator = team.scaler(), torch.Generator()
    started = time.perf_counter() - state.seconds
    model.train()
    try:
        for step in range(state.step, config.steps):
            generator.manual_seed(_mix(config.seed, step))
            parts = _take_step(state, loss, generator, config, team, scaler)
            state.step, state.seconds = step + 1, time.perf_counter() - started
            last = state.step == config.steps
            validates = last or state.step % config.validate_every == 0
            saves = last or state.step % config.checkpoint_every == 0
            metrics: dict[str, float] = {}
            if validates or saves or state.step % _LOG_EVERY == 0:
                means = team.mean(list(parts.values()))
                metrics = {name: float(mean) for name, mean in zip(parts, means, strict=True)}
                if not math.isfinite(metrics["loss"]):
                    raise TrainingError(
                        f"the loss is {metrics['loss']} at step {state.step}; "
                        "try a lower learning_rate"
                    )
            if validates and team.main:
                metrics |= validate(state.average)
            if metrics:
                times = {"step": state.step, "seconds": round(state.seconds, 3)}
                state.log.rows.append(times | metrics)
            if not team.main:
                continue
            if metrics:
                state.log.write(run.folder / LOG)
                if board:
                    for name, value in metrics.items():
                        board.add_scalar(name, value, state.step)
            run.progress(state.step, config.steps, metrics)
            if saves:
                state.save(checkpoint, settings)
    finally:
        if board:
            board.close()
    return Trained(state.average.to("cpu"), _record(state, config, team, source), state.log.last)


def _take_step(
    state: State[M],
    loss: Loss[M],
    generator: torch.Generator,
    config: TrainingConfig,
    team: Team,
    scaler: torch.amp.GradScaler,
) -> dict[str, Tensor]:
    """Take one step of the optimiser and of the average; the loss and its parts."""
    optimizer, parameters = state.optimizer, state.parameters
    for group in optimizer.param_groups:
        group["lr"] = config.learning_rate * _schedule(state.step, config)
    value, parts = loss(state.model, generator)
    optimizer.zero_grad(set_to_none=True)
    scaler.scale(value).backward()
    if team.size > 1:
        gradients = [p.grad for p in parameters if p.grad is not None]
        for gradient, mean in zip(gradients, team.mean(gradients), strict=True):
            gradient.copy_(mean)
    scaler.unscale_(optimizer)
    nn.utils.clip_grad_norm_(parameters, 1.0)
    scaler.step(optimizer)
    scaler.update()
    state.update_average(min(config.ema, (1 + state.step) / (10 + state.step)))  # faster at first
    return {"loss": value.detach(), **parts}


def _check_same_step(step: int, team: Team, checkpoint: Path) -> None:
    mean = float(team.mean([torch.tensor(float(step), device=team.device)])[0])
    if mean != step:
        raise CheckpointError(
            f"not all processes see the same {checkpoint}: "
            f"it is at step {step} here, at {mean:g} in the mean"
        )


def _settings(
    model: nn.Module, config: TrainingConfig, team: Team, source: Source
) -> dict[str, Any]:
    """The settings that fix the weights, which a resumed run must repeat."""
    network: Any = model.config
    settings: dict[str, Any] = {"model": network.to_dict(), "data": {"sha256": source.digest}}
    if source.teacher:
        settings["teacher"] = {k: v for k, v in vars(source.teacher).items() if k != "training"}
    settings["training"] = {k: v for k, v in asdict(config).items() if k not in _INTERVALS}
    return {**settings, "precision": team.precision}


def _record(
    state: State[Any], config: TrainingConfig, team: Team, source: Source
) -> TrainingRecord:
    return TrainingRecord(
        **vars(source),
        training=asdict(config),
        parameters=sum(p.numel() for p in state.model.parameters()),
        seconds=round(state.seconds, 3),
        step_seconds=state.log.step_seconds,
        device=str(team.device),
        processes=team.size,
        precision=team.precision,
        threads=torch.get_num_threads(),
        torch=torch.__version__,
    )


def _tensorboard(folder: Path, step: int) -> Any:
    """A writer of metrics after `step` for TensorBoard, or None where it is not installed."""
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ImportError:
        return None
    return SummaryWriter(str(folder / "tensorboard"), purge_step=step + 1)


def _mix(seed: int, step: int) -> int:
    """One number from two, without patterns from step to step."""
    return int(np.random.SeedSequence([seed, step]).generate_state(1, np.uint64)[0] >> 1)


def _schedule(step: int, config: TrainingConfig) -> float:
    """Share of the learning rate: linear warm-up, then a cosine down to 0."""
    if step < config.warmup:
        return (step + 1) / config.warmup
    progress = (step - config.warmup) / max(1, config.steps - config.warmup)
    return 0.5 * (1 + math.cos(math.pi * progress))
