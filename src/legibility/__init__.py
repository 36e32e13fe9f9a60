"""Robot motion with a dial for legibility, from most ambiguous (−1) to most legible (1)."""

import importlib
from typing import TYPE_CHECKING, Any

from . import envs as envs  # registers the Gymnasium environments; making one loads its code
from . import errors
from .intent import labels, metrics
from .intent.field import Field, InformationPotentialField
from .intent.observer import Observer
from .motion.archive import Archive, build_archive
from .motion.path import Path
from .motion.recording import Recording
from .obstacles import Ball, Box, Polygon
from .scene import Scene

if TYPE_CHECKING:
    from .data.recordings import read_recordings
    from .evaluation.scoring import Score, score
    from .modulator import Modulator
    from .motion.timed import Motion
    from .robots.arm import Arm
    from .robots.limits import Limits
    from .rollout import Rollout

__version__ = "0.1.0"

__all__ = [
    "Archive",
    "Arm",
    "Ball",
    "Box",
    "Field",
    "InformationPotentialField",
    "Limits",
    "Modulator",
    "Motion",
    "Observer",
    "Path",
    "Polygon",
    "Recording",
    "Rollout",
    "Scene",
    "Score",
    "__version__",
    "build_archive",
    "errors",
    "labels",
    "metrics",
    "read_recordings",
    "score",
]

_LAZY = {
    "Arm": "robots.arm",
    "Limits": "robots.limits",
    "Modulator": "modulator",
    "Motion": "motion.timed",
    "Rollout": "rollout",
    "Score": "evaluation.scoring",
    "read_recordings": "data.recordings",
    "score": "evaluation.scoring",
}
"""Loaded on first use, since some load torch or much of SciPy."""


def __getattr__(name: str) -> Any:
    if name in _LAZY:
        return getattr(importlib.import_module(f".{_LAZY[name]}", __name__), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
