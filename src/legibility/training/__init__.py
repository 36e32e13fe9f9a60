"""How weights are made: one loop for every model, and what each is trained on."""

from .loop import CHECKPOINT, LOG, TrainingConfig, choose_device, train
from .path import FrameScorer, PathBatches, train_path, validate_dial

__all__ = [
    "CHECKPOINT",
    "LOG",
    "FrameScorer",
    "PathBatches",
    "TrainingConfig",
    "choose_device",
    "train",
    "train_path",
    "validate_dial",
]
