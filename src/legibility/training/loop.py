"""How weights are made: one loop that logs, validates, checkpoints and resumes bit for bit.

Every random number of a step comes from the seed and the step's number, so on a CPU a run that was
killed and resumed with the same number of threads makes the same weights as one that was not, and
several processes, each of which draws the numbers of the whole batch and uses its share, take the
steps of one.
"""

from __future__ import annotations

import copy
import json
import math
import time
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import torch
from torch import Tensor, nn

from ..errors import CheckpointError, TrainingError
from ..files import read_text, write_bytes
from ..models.checkpoint import load_state, load_tensors, save_tensors
from .configuration import TrainingConfig
from .team import Team

__all__ = ["CHECKPOINT", "LOG", "Progress", "train"]

CHECKPOINT = "checkpoint.safetensors"
LOG = "log.jsonl"


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
    team: Team,
    progress: Progress = lambda step, steps, figures: None,
) -> M:
    """Train `model` in `folder`, or go on with it, and return its moving average.

    Args:
        model: already on the device it shall be trained on.
        loss: of the model and a generator for all of the step's random numbers: the loss and
            figures to log, whose means over the processes are those of the whole batch.
        validate: figures of a model, logged every `validate_every` steps.
        config: how to train.
        folder: of the checkpoint and the log.
        identity: what this run is (data, model); a checkpoint of another is refused.
        team: of this process; all must see `folder`.
        progress: called by the main process after each step with the steps done, all of them and
            what was logged, if anything was.

    Raises:
        CheckpointError: the folder's checkpoint is corrupted or of another run.
    """
    folder = Path(folder)
    average = copy.deepcopy(model).requires_grad_(False).eval()
    parameters = _trained(model)
    optimizer = torch.optim.AdamW(
        parameters, lr=config.learning_rate, weight_decay=config.weight_decay, fused=True
    )
    scaler = team.scaler()
    identity = {**identity, "training": asdict(config)}
    if team.precision != "no":
        identity["precision"] = team.precision
    if team.main:
        for leftover in folder.glob(".*.safetensors"):  # of a run that was killed
            leftover.unlink()
    done, seconds = 0, 0.0
    if (folder / CHECKPOINT).exists():
        done, seconds = _restore(folder / CHECKPOINT, model, average, optimizer, identity)
    if (found := float(team.mean([torch.tensor(float(done), device=team.device)])[0])) != done:
        raise CheckpointError(
            f"not all processes see the same {folder / CHECKPOINT}: "
            f"it is at step {done} here, at {found:g} in the mean"
        )
    log = _Log(folder, done) if team.main else None
    _keep_memory()
    generator = torch.Generator()
    started = time.perf_counter() - seconds
    model.train()
    try:
        for step in range(done, config.steps):
            generator.manual_seed(_mix(config.seed, step))
            for group in optimizer.param_groups:
                group["lr"] = config.learning_rate * _schedule(step, config)
            with team.products():
                value, figures = loss(model, generator)
                optimizer.zero_grad(set_to_none=True)
                scaler.scale(value).backward()
            if team.size > 1:
                gradients = [p.grad for p in parameters if p.grad is not None]
                for own, mean in zip(gradients, team.mean(gradients), strict=True):
                    own.copy_(mean)
            scaler.unscale_(optimizer)
            nn.utils.clip_grad_norm_(parameters, 1.0)
            scaler.step(optimizer)
            scaler.update()
            _average(average, model, min(config.ema, (1 + step) / (10 + step)))

            finished = step + 1
            last = finished == config.steps
            seconds = time.perf_counter() - started
            row: dict[str, float] = {}
            if last or finished % config.checkpoint_every == 0 or finished % 50 == 0:
                figures = {"loss": value.detach(), **figures}
                means = team.mean(list(figures.values()))
                row = {k: float(v) for k, v in zip(figures, means, strict=True)}
                if not math.isfinite(row["loss"]):
                    raise TrainingError(
                        f"the loss is {row['loss']} at step {finished}; try a lower learning_rate"
                    )
            if log is None:
                continue
            if last or finished % config.validate_every == 0:
                row |= validate(average)
            if row:
                log.write({"step": finished, "seconds": round(seconds, 3), **row})
            progress(finished, config.steps, row)
            if last or finished % config.checkpoint_every == 0:
                _store(folder / CHECKPOINT, model, average, optimizer, identity, finished, seconds)
    finally:
        if log is not None:
            log.close()
    return average


def _keep_memory() -> None:
    """Let the C library keep what a step frees for the next one, which else waits for new pages.

    glibc returns memory to the system block by block until it has seen a large block freed, of up
    to 32 MB; elsewhere this does nothing.
    """
    torch.empty(31 << 20, dtype=torch.uint8)


def _trained(model: nn.Module) -> list[nn.Parameter]:
    return [p for p in model.parameters() if p.requires_grad]


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
        wanted = json.loads(json.dumps(identity))
        changed = [k for k in {**wanted, **header} if header.get(k) != wanted.get(k)]
        raise CheckpointError(f"{path} is of another run ({', '.join(changed)} differ)")
    groups: dict[str, dict[str, Tensor]] = {"model": {}, "average": {}, "optimizer": {}}
    for name, tensor in tensors.items():
        head, rest = name.split(".", 1)
        groups[head][rest] = tensor
    load_state(model, groups["model"], path)
    load_state(average, groups["average"], path)
    state: dict[int, dict[str, Tensor]] = {}
    for index, parameter in enumerate(_trained(model)):
        shapes = {"step": (), "exp_avg": parameter.shape, "exp_avg_sq": parameter.shape}
        state[index] = {}
        for key, shape in shapes.items():
            tensor = groups["optimizer"].get(f"{index}.{key}")
            if tensor is None or tensor.shape != shape or not torch.isfinite(tensor).all():
                raise CheckpointError(f"{path}: optimizer.{index}.{key} is missing or broken")
            # Laid out as the weight, since the fused step rounds by the place in memory.
            state[index][key] = torch.empty_like(parameter if shape else tensor).copy_(tensor)
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
