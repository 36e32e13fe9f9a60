"""How weights are made: one loop for every model, and what each is trained on."""

from .distillation import DistillationBatches, DistillationConfig, distill_path
from .goal import train_goal, tune_guidance, validate_goal
from .loop import CHECKPOINT, LOG, TrainingConfig, train
from .path import (
    FIXED_BY_DATA,
    FrameScorer,
    PathBatches,
    PathTrainingConfig,
    check_data,
    train_path,
    validate_dial,
)
from .policy import PolicyBatches, PolicyTrainingConfig, train_policy, validate_policy
from .team import Team, choose_device

__all__ = [
    "CHECKPOINT",
    "FIXED_BY_DATA",
    "LOG",
    "DistillationBatches",
    "DistillationConfig",
    "FrameScorer",
    "PathBatches",
    "PathTrainingConfig",
    "PolicyBatches",
    "PolicyTrainingConfig",
    "Team",
    "TrainingConfig",
    "check_data",
    "choose_device",
    "distill_path",
    "train",
    "train_goal",
    "train_path",
    "train_policy",
    "tune_guidance",
    "validate_dial",
    "validate_goal",
    "validate_policy",
]
