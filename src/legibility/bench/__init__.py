"""Speed and memory on this machine: planning, control, data and training."""

from .configuration import BenchConfig
from .run import run_bench

__all__ = ["BenchConfig", "run_bench"]
