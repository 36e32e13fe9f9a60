"""Memory and start-up times of a process that does one thing, each measured in a fresh one."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ..errors import LegibilityError

__all__ = ["footprint", "import_seconds", "work"]

_STATUS = Path("/proc/self/status")

# What is above is there before us: its memory is not counted as ours.
_CHILD = """
import sys, time
started = time.perf_counter()
import {above}
loaded = time.perf_counter()
try:
    with open("{status}") as file:
        status = file.read()
except OSError:
    status = ""
import legibility
seconds = {{"above": loaded - started, "import": time.perf_counter() - loaded}}
from legibility.evaluation.footprint import work
work(sys.argv[1], seconds, status)
"""


def footprint(above: str, job: str, threads: int, **options: Any) -> dict[str, Any]:
    """Do `job` in a fresh process of Python.

    Args:
        above: module that is imported first and does not count.
        job: one of those of `work`.
        threads: of PyTorch.
        **options: of the job.

    Returns:
        `seconds` of each step, `above` and `import legibility` among them; `megabytes`, the peak of
        resident memory above that of Python with `above`, after each step; none where the system
        does not tell it (it is read from Linux's /proc).
    """
    code = _CHILD.format(above=above, status=_STATUS)
    order = json.dumps({"job": job, "threads": threads, **options})
    found = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", code, order],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    if found.returncode:
        last = (found.stderr.strip().splitlines() or ["nothing said"])[-1]
        raise LegibilityError(f"the process that measures {job} failed: {last}")
    return json.loads(found.stdout.splitlines()[-1])


def import_seconds() -> float:
    """Time [s] of `import legibility` in a fresh process."""
    return footprint("sys", "nothing", 1)["seconds"]["import"]


def work(order: str, seconds: dict[str, float], status: str) -> None:
    """The fresh process: does what `footprint` ordered and prints what it took."""
    options = json.loads(order)
    job, threads = options.pop("job"), options.pop("threads")
    base, megabytes = _megabytes(status, "VmRSS"), {}
    for name, step in _steps(job, threads, options).items():
        started = time.perf_counter()
        step()
        seconds[name] = time.perf_counter() - started
        if base is not None:
            peak = _megabytes(_STATUS.read_text(), "VmHWM")
            megabytes[name] = max(0.0, (peak or 0.0) - base)
    print(json.dumps({"seconds": seconds, "megabytes": megabytes}))


def _megabytes(status: str, key: str) -> float | None:
    found = re.search(rf"^{key}:\s+(\d+) kB", status, re.MULTILINE)
    return None if found is None else int(found[1]) / 1024


def _steps(job: str, threads: int, options: dict[str, Any]) -> dict[str, Callable[[], Any]]:
    """What a job does, one step after the other."""
    if job == "nothing":
        return {}
    if job == "archive":
        import numpy as np

        from ..motion.archive import build_archive
        from ..scene import Scene

        scene = Scene.random(np.random.default_rng(0), dim=options["dim"], num_goals=4)
        return {"archive": lambda: build_archive(scene)}
    if job == "plan":
        return _planning(threads, **options)

    import torch

    from . import workloads
    from .published import PublishedDiffuser

    torch.set_num_threads(threads)
    alone = workloads.Team(torch.device("cpu"))
    if job == "rollouts":
        model = workloads.Modulator.from_pretrained(options["model"], backend=options["backend"])
        return {job: workloads.rollouts(model, options["robots"])}
    if job == "dataset":
        return {job: workloads.dataset(options["dim"], options["scenes"])}
    if job == "published":
        return {job: lambda: PublishedDiffuser().eval().sample(1, options["steps"])}
    config = workloads.Modulator.from_pretrained(options["model"]).config
    return {job: lambda: workloads.training(config, alone, 1)()}


def _planning(
    threads: int, model: str, backend: str, batches: list[int]
) -> dict[str, Callable[[], Any]]:
    """Load, then plan: what a program that plans needs, and nothing of the bench's own."""
    import numpy as np
    import torch

    from .. import Scene

    torch.set_num_threads(threads)
    there: dict[str, Any] = {}

    def code() -> None:
        from ..modulator import Modulator

        there["type"] = Modulator

    def load() -> None:
        there["model"] = there["type"].from_pretrained(model, backend=backend)

    def plan(batch: int) -> Callable[[], Any]:
        def step() -> None:
            dim = there["model"].config.dim
            scene = Scene.random(np.random.default_rng(0), dim=dim, num_goals=4)
            there["model"].plan(scene, 0, np.linspace(-0.5, 0.5, batch))

        return step

    steps = {f"plan {batch}": plan(batch) for batch in batches}
    return {"code": code, "load": load, **steps}
