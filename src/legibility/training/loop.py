"""One training loop for every model: it logs, validates, checkpoints and resumes bit for bit.

All random numbers of a step follow from the seed and the number of the step. So a run on a CPU that
was killed and resumed with the same number of threads ends with the weights of one that was not,
and several processes, each of which draws the numbers of the whole batch and uses its share, take
the steps of one.
"""

import copy
import json
import math
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np
import torch
from torch import Tensor, nn

from ..errors import CheckpointError, TrainingError
from ..files import write_bytes
from ..models.checkpoint import copy_tensors, load_tensors, save_tensors
from ..models.diffusion import noise_schedule
from ..models.provenance import Source, TrainingRecord
from .configuration import TrainingConfig
from .team import Team

CHECKPOINT = "checkpoint.safetensors"
LOG = "log.jsonl"

_FORMAT = 1
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
        source: the data that the model learns from.

    Raises:
        CheckpointError: the folder's checkpoint is corrupted or of another run.
        TrainingError: the loss is not finite.
    """
    team, checkpoint, log = run.team, run.folder / CHECKPOINT, run.folder / LOG
    settings = _settings(model, config, team, source)
    state = _State(model, config, team)
    if team.main:
        for leftover in run.folder.glob(".*.safetensors"):  # of a run that was killed
            leftover.unlink()
    if checkpoint.exists():
        state.restore(checkpoint, settings)
    mean = float(team.mean([torch.tensor(float(state.step), device=team.device)])[0])
    if mean != state.step:
        raise CheckpointError(
            f"not all processes see the same {checkpoint}: "
            f"it is at step {state.step} here, at {mean:g} in the mean"
        )
    board = None
    if team.main:
        state.write_log(log)
        board = _tensorboard(run.folder, state.step)
    started = time.perf_counter() - state.seconds
    model.train()
    try:
        while state.step < config.steps:
            parts = state.advance(loss)
            state.seconds = time.perf_counter() - started
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
                state.rows.append(times | metrics)
            if not team.main:
                continue
            if metrics:
                state.write_log(log)
            if board:
                for name, value in metrics.items():
                    board.add_scalar(name, value, state.step)
            run.progress(state.step, config.steps, metrics)
            if saves:
                state.save(checkpoint, settings)
    finally:
        if board:
            board.close()
    metrics = {name: value for row in state.rows for name, value in row.items()}
    return Trained(state.average.to("cpu"), _record(state, source), metrics)


class _State(Generic[M]):
    """Everything from which a training goes on bit for bit.

    The rows of the log are part of it, so `log.jsonl` never disagrees with the checkpoint.
    """

    def __init__(self, model: M, config: TrainingConfig, team: Team) -> None:
        self.model, self.config, self.team = model, config, team
        self.average = copy.deepcopy(model).requires_grad_(False).eval()
        self.parameters = [p for p in model.parameters() if p.requires_grad]
        self.optimizer = torch.optim.AdamW(
            self.parameters, lr=config.learning_rate, weight_decay=config.weight_decay, fused=True
        )
        for p in self.parameters:  # the moments, there from the start so that they can be restored
            moments = {"exp_avg": torch.zeros_like(p), "exp_avg_sq": torch.zeros_like(p)}
            self.optimizer.state[p] = {"step": torch.zeros((), device=p.device), **moments}
        self.generator, self.scaler = torch.Generator(), team.scaler()
        self.step, self.seconds = 0, 0.0
        self.rows: list[dict[str, float]] = []

    def advance(self, loss: Loss[M]) -> dict[str, Tensor]:
        """Take one step of the optimiser and of the average; the loss and its parts."""
        mixed = np.random.SeedSequence([self.config.seed, self.step]).generate_state(1, np.uint64)
        self.generator.manual_seed(int(mixed[0] >> 1))
        (group,) = self.optimizer.param_groups
        group["lr"] = self.config.learning_rate * _schedule(self.step, self.config)
        value, parts = loss(self.model, self.generator)
        self.optimizer.zero_grad(set_to_none=True)
        self.scaler.scale(value).backward()
        if self.team.size > 1:
            gradients = [p.grad for p in self.parameters if p.grad is not None]
            for gradient, mean in zip(gradients, self.team.mean(gradients), strict=True):
                gradient.copy_(mean)
        self.scaler.unscale_(self.optimizer)
        nn.utils.clip_grad_norm_(self.parameters, 1.0)
        self.scaler.step(self.optimizer)
        self.scaler.update()
        decay = min(self.config.ema, (1 + self.step) / (10 + self.step))  # faster at first
        with torch.no_grad():
            for old, new in zip(self.average.parameters(), self.model.parameters(), strict=True):
                old.lerp_(new, 1 - decay)
        self.step += 1
        return {"loss": value.detach(), **parts}

    def tensors(self) -> dict[str, Tensor]:
        """The tensors of the networks and the optimiser, by the names of the checkpoint."""
        tensors = {f"model.{k}": v for k, v in self.model.state_dict().items()}
        tensors |= {f"average.{k}": v for k, v in self.average.state_dict().items()}
        for index, parameter in enumerate(self.parameters):
            moments = self.optimizer.state[parameter]
            tensors |= {f"optimizer.{index}.{k}": v for k, v in moments.items()}
        return tensors

    def write_log(self, path: Path) -> None:
        """Write the log as JSON lines."""
        write_bytes(path, "".join(json.dumps(row) + "\n" for row in self.rows).encode())

    def save(self, path: Path, settings: dict[str, Any]) -> None:
        """Write a checkpoint of a training of `settings`, plain values that fix its weights."""
        header = {"settings": settings, "step": self.step, "seconds": self.seconds}
        save_tensors(path, self.tensors(), {**header, "log": self.rows})

    def restore(self, path: Path, settings: dict[str, Any]) -> None:
        """Go on from the checkpoint at `path`, which must be of the same settings."""
        tensors, header = load_tensors(path)
        try:
            self.step, self.seconds = int(header["step"]), float(header["seconds"])
            self.rows = [dict(row) for row in header["log"]]
            changes = list(_differences(header["settings"], json.loads(json.dumps(settings))))
        except (AttributeError, LookupError, TypeError, ValueError) as cause:
            raise CheckpointError(f"{path} is not a training checkpoint") from cause
        if changes:
            raise CheckpointError(f"{path} is of another run: {'; '.join(changes[:3])}")
        copy_tensors(self.tensors(), tensors, path)


def _differences(kept: dict[str, Any], now: dict[str, Any], prefix: str = "") -> Iterator[str]:
    """The settings of a checkpoint that are not those of `now`, with both values."""
    for name in {**now, **kept}:
        old, new = kept.get(name), now.get(name)
        if isinstance(old, dict) and isinstance(new, dict):
            yield from _differences(old, new, f"{prefix}{name}.")
        elif old != new:
            yield f"{prefix}{name} is {old!r} in the checkpoint and {new!r} now"


def _settings(
    model: nn.Module, config: TrainingConfig, team: Team, source: Source
) -> dict[str, Any]:
    """The settings that fix the weights, which a resumed run must repeat."""
    network: Any = model.config
    teacher = source.teacher and {**vars(source.teacher), "training": None}
    return {
        "format": _FORMAT,
        "model": network.to_dict(),
        "data": {"sha256": source.digest},
        "teacher": teacher,
        "training": {k: v for k, v in asdict(config).items() if k not in _INTERVALS},
        "precision": team.precision,
    }


def _record(state: _State[Any], source: Source) -> TrainingRecord:
    times = np.array([[row["step"], row["seconds"]] for row in state.rows])
    steps, seconds = np.diff(times, axis=0, prepend=np.zeros((1, 2))).T
    team = state.team
    return TrainingRecord(
        **vars(source),
        training=asdict(state.config),
        parameters=sum(p.numel() for p in state.model.parameters()),
        seconds=round(state.seconds, 3),
        step_seconds=float(np.quantile(seconds / steps, 0.1)),
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


def _schedule(step: int, config: TrainingConfig) -> float:
    """Share of the learning rate: linear warm-up, then a cosine down to 0."""
    if step < config.warmup:
        return (step + 1) / config.warmup
    progress = (step - config.warmup) / max(1, config.steps - config.warmup)
    return 0.5 * (1 + math.cos(math.pi * progress))
