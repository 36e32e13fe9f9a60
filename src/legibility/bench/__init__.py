"""Speed and memory on this machine: planning, control, data and training."""

from .run import BenchConfig, run_bench

__all__ = ["BenchConfig", "run_bench"]
