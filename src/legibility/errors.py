"""Every error that this package raises on purpose.

All of them derive from `LegibilityError`, so one ``except`` catches them; the command line prints
their message in one line and exits with status 2.
"""


class LegibilityError(Exception):
    """Base of all errors of this package."""


class InvalidInputError(LegibilityError, ValueError):
    """An argument is wrong; the message names the value and what is allowed."""


class InvalidSceneError(InvalidInputError):
    """A scene, or a scene file, is malformed."""


class CheckpointError(LegibilityError):
    """Weights or training state are missing, corrupted or of another model."""


class HubError(CheckpointError):
    """Weights cannot be had from the Hugging Face Hub, or pushed to it; the message says why."""


class DatasetError(LegibilityError):
    """A dataset is missing, incomplete, corrupted or was made with another configuration."""


class TrainingError(LegibilityError):
    """Training cannot go on; the message says what to change."""


class OutputError(LegibilityError, OSError):
    """A file cannot be written."""


class MissingExtraError(LegibilityError, ImportError):
    """An optional dependency is not installed; the message names the pip command."""


class WorkerError(LegibilityError):
    """Workers cannot be reached, or die again and again."""
