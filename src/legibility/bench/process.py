"""Start-up time and memory of a fresh process that loads a model and plans."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import torch

from ..errors import WorkerError

__all__ = ["process_metrics"]

# Peak memory is that of /proc: `resource` counts the parent's memory at the fork too.
_CHILD = """
import json, re, sys, time
times = [time.perf_counter()]
import legibility
times.append(time.perf_counter())
modulator = legibility.Modulator.from_pretrained(sys.argv[1], backend=sys.argv[2])
times.append(time.perf_counter())
import numpy
scene = legibility.Scene.random(numpy.random.default_rng(0), dim=modulator.config.dim, num_goals=4)
modulator.plan(scene, 0, 0.5)
times.append(time.perf_counter())
names = ["import_ms", "load_ms", "first_plan_ms"]
metrics = {n: 1e3 * (b - a) for n, a, b in zip(names, times, times[1:])}
try:
    with open("/proc/self/status") as file:
        metrics["memory_mb"] = int(re.search(r"VmHWM:\\s+(\\d+) kB", file.read())[1]) / 1024
except OSError:
    pass
print(json.dumps(metrics))
"""


def process_metrics(model: str, backend: str) -> dict[str, float]:
    """Metrics of one process on as many threads as PyTorch has here.

    Returns:
        `import_ms` of `import legibility`; `load_ms` from there until the model is loaded, PyTorch
        included; `first_plan_ms`; on Linux `memory_mb`, the peak resident memory [MB].

    Raises:
        WorkerError: the process failed.
    """
    run = subprocess.run(
        [sys.executable, "-P", "-W", "ignore", "-c", _CHILD, model, backend],
        env={**os.environ, "OMP_NUM_THREADS": str(torch.get_num_threads())},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    if run.returncode:
        reason = (run.stderr.strip().splitlines() or ["it wrote no error"])[-1]
        raise WorkerError(f"the process that loads {model} on {backend} failed: {reason}")
    return json.loads(run.stdout.splitlines()[-1])
