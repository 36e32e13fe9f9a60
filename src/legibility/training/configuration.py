"""The settings of each training."""

from dataclasses import dataclass, fields
from functools import partial

from ..checks import bounded, count, positive, random_seed
from ..errors import InvalidInputError

DEVICES = ("cpu", "cuda")
"""The devices that are named most; PyTorch knows others, such as cuda:1."""

PRECISIONS = ("no", "bf16", "fp16")
"""Of the products of a network in training; `no` is float32, mixed with nothing."""

FIXED_BY_DATA = ("dim", "observer", "recorded")
"""Settings of stage 1 that follow from its data."""


def _share(name: str, value: float) -> None:
    if bounded(name, value, 0, 1) == 1:
        raise InvalidInputError(f"{name} must lie in [0, 1), got {value}")


_WEIGHTS = ("weight_decay", "score_weight", "contact_weight", "jerk_weight")
_CHECKS = {
    "seed": random_seed,
    "warmup": partial(count, low=0),
    "learning_rate": positive,
    **dict.fromkeys(_WEIGHTS, partial(bounded, low=0)),
    **dict.fromkeys(("dropout", "ema", "ends"), _share),
}
"""The checks of settings by name; all others are counts of at least 1."""


@dataclass(frozen=True)
class TrainingConfig:
    """Settings of a training that all models share.

    Attributes:
        steps: optimiser steps.
        learning_rate: its highest value, after the warm-up; from there it falls to 0 (cosine).
        warmup: steps of linear warm-up.
        weight_decay: of AdamW.
        dropout: probability of dropping the condition: field and ℓ together in stage 1, the path in
            stage 2, the goal in a baseline.
        ema: decay of the exponential moving average of the weights, which is the trained model.
        seed: of the initial weights and of every batch.
        validate_every: steps between validations; a resumed run may change it.
        checkpoint_every: steps between checkpoints; a resumed run may change it.
    """

    steps: int = 12000
    learning_rate: float = 1e-3
    warmup: int = 500
    weight_decay: float = 1e-4
    dropout: float = 0.1
    ema: float = 0.999
    seed: int = 0
    validate_every: int = 1000
    checkpoint_every: int = 500

    def __post_init__(self) -> None:
        for field in fields(self):
            _CHECKS.get(field.name, count)(field.name, getattr(self, field.name))


@dataclass(frozen=True)
class PathTrainingConfig(TrainingConfig):
    """Settings of the training of stage 1.

    Attributes:
        scenes: scenes in a batch.
        per_scene: trajectories of each scene in a batch.
        score_weight: weight of the loss on the achieved label; that on the velocity weighs 1.
        contact_weight: weight of the distance, in lengths of the straight line, by which the
            denoised curve comes too near to solids and walls.
        jerk_weight: weight of the loss on jerk beyond that of the path learned.
    """

    steps: int = 3500
    warmup: int = 300
    scenes: int = 512
    per_scene: int = 8
    score_weight: float = 5.0
    contact_weight: float = 40.0
    jerk_weight: float = 0.03


@dataclass(frozen=True)
class DistillationConfig(PathTrainingConfig):
    """Settings of the distillation of a student.

    Attributes:
        sampling_steps: steps in which the student draws.
        pairs: pairs of noise and path that the teacher draws in each scene, evenly over the dial.
        ends: share of the pairs at ℓ = ±1.
    """

    steps: int = 4000
    learning_rate: float = 7e-4
    dropout: float = 0.0
    contact_weight: float = 100.0
    jerk_weight: float = 0.1
    sampling_steps: int = 1
    pairs: int = 24
    ends: float = 0.2

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.dropout:
            raise InvalidInputError(
                f"dropout must be 0, as a student always has its conditions, got {self.dropout}"
            )


@dataclass(frozen=True)
class PolicyTrainingConfig(TrainingConfig):
    """Settings of the training of a policy.

    Attributes:
        batch: steps of demonstrations in a batch.
    """

    steps: int = 8000
    batch: int = 1024
