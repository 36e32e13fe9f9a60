"""`legibility doctor`."""

from __future__ import annotations

import contextlib
import os
import platform
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from importlib import metadata
from textwrap import shorten
from typing import Any

from ..errors import LegibilityError
from ..report.table import Table
from .options import OutputFile
from .output import check_file, progress_bar, show, table, write_report

_CORE = "core"
_MINIMUM = "2d", "block-reach-2d"
"""The environment and the weights that must work."""

_PATIENCE = 15.0
"""Time limit of a picture in MuJoCo [s]."""

_BACKENDS = {
    "egl": "apt-get install libegl1 libgl1",
    "osmesa": "apt-get install libosmesa6",
    "glfw": "needs a display; else apt-get install xvfb and call with xvfb-run",
}
"""Remedies on Debian and Ubuntu for MuJoCo's renderers, by the value of MUJOCO_GL."""

_DRAW = """
import mujoco
model = mujoco.MjModel.from_xml_string("<mujoco><worldbody><geom size='1'/></worldbody></mujoco>")
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)
with mujoco.Renderer(model, 32, 32) as renderer:
    renderer.update_scene(data)
    assert renderer.render().any(), "the picture is black"
"""


def doctor(json: OutputFile = None) -> None:
    """Report the installation, whether each part works here, and remedies.

    The exit status is 0 if the 2-D environment can be stepped and its weights be loaded, whatever
    else is missing, and 2 otherwise.

    Args:
        json: everything as JSON.
    """
    check_file(json, "JSON file")
    checks: dict[str, Callable[[], Any]] = {
        "system": _system,
        "packages": _packages,
        "torch": _torch,
        "weights": _weights,
        "environments": _environments,
        "ffmpeg": lambda: shutil.which("ffmpeg"),
    }
    result: dict[str, Any] = {}
    # A renderer is chosen when MuJoCo is loaded, and a wrong one may end the process.
    with ThreadPoolExecutor() as threads, progress_bar("checks") as progress:
        backends = _backends()
        errors = threads.map(_renderer_error, backends)
        for number, (name, check) in enumerate(checks.items()):
            progress(number, len(checks) + 1)
            result[name] = check()
        progress(len(checks), len(checks) + 1)
        result["gl"] = dict(zip(backends, errors, strict=True))
    environment, weights = _MINIMUM
    broken = {
        f"the environment {environment}": _error_of(result["environments"], environment),
        f"the weights {weights}": _error_of(result["weights"], weights),
    }
    result["works"] = not any(broken.values())
    write_report(json, seed=None, config={}, result=result)

    show(
        _rows(_machine_rows(result), "this machine", "part", "version"),
        _rows(_package_rows(result), "packages", "extra", "package", "version", "remedy"),
        _rows(_working_rows(result), "parts that work", "part", "name", "state", "remedy"),
    )
    for part, error in broken.items():
        if error:
            raise LegibilityError(f"{part} does not work: {error}")
    show("the core works")


def _system() -> dict[str, Any]:
    from .. import __version__

    affinity = getattr(os, "sched_getaffinity", None)
    return {
        "legibility": __version__,
        "python": platform.python_version(),
        "implementation": platform.python_implementation(),
        "platform": platform.platform(),
        "machine": platform.machine(),
        "cores": len(affinity(0)) if affinity else os.cpu_count(),
    }


def _packages() -> dict[str, dict[str, dict[str, str | None]]]:
    """By extra, `core` first: the version of each package wanted and installed, and the problem."""
    try:
        from packaging.requirements import Requirement

        distribution = metadata.distribution("legibility")
    except ImportError:  # also of a distribution: it runs from its sources
        return {}
    extras = distribution.metadata.get_all("Provides-Extra") or []
    packages: dict[str, dict[str, dict[str, str | None]]] = {e: {} for e in (_CORE, *extras)}
    for requirement in map(Requirement, distribution.requires or []):
        extra = re.search(r"extra == \W([\w.-]+)", str(requirement.marker))
        version = problem = None
        try:
            version = metadata.version(requirement.name)
            if not requirement.specifier.contains(version, prereleases=True):
                problem = f"{requirement.specifier} is wanted"
        except metadata.PackageNotFoundError:
            problem = "missing"
        packages[extra[1] if extra else _CORE][requirement.name] = {
            "wanted": str(requirement.specifier), "version": version, "problem": problem,
        }  # fmt: skip
    return packages


def _torch() -> dict[str, Any]:
    with _caught() as errors:
        import torch

        cuda = torch.cuda.is_available()
        return {
            "version": str(torch.__version__),
            "build": f"CUDA {torch.version.cuda}" if torch.version.cuda else "CPU",
            "threads": torch.get_num_threads(),
            "device": torch.cuda.get_device_name() if cuda else None,
            "error": None,
        }
    return {"error": errors[0]}


def _weights() -> dict[str, dict[str, Any]]:
    """By name: the sizes of the files [byte] and the error of loading them."""
    with _caught() as errors:
        from ..models.pretrained import load_stages, pretrained_folder, pretrained_names

        names = [*pretrained_names(), *pretrained_names("goal")]
    if errors:
        return {_MINIMUM[1]: {"files": {}, "error": errors[0]}}
    weights: dict[str, dict[str, Any]] = {}
    for name in names:
        with _caught() as errors:
            load_stages(pretrained_folder(name))
        files = sorted(pretrained_folder(name).glob("*.safetensors"))
        sizes = {file.name: file.stat().st_size for file in files}
        weights[name] = {"files": sizes, "error": next(iter(errors), None)}
    return weights


def _environments() -> dict[str, dict[str, str | None]]:
    """By name: Gymnasium's identifier and the error of making, resetting and stepping it."""
    with _caught() as errors:
        import gymnasium

        from ..envs import ENVIRONMENTS
    if errors:
        return {_MINIMUM[0]: {"id": None, "error": errors[0]}}
    environments: dict[str, dict[str, str | None]] = {}
    for name, entry in ENVIRONMENTS.items():
        identifier = f"legibility/{entry.partition(':')[2]}-v0"
        with _caught() as errors:
            env = gymnasium.make(identifier)
            env.reset(seed=0)
            env.step(env.action_space.sample())
            env.close()
        environments[name] = {"id": identifier, "error": next(iter(errors), None)}
    return environments


def _backends() -> list[str]:
    """The values of MUJOCO_GL to try; none without MuJoCo."""
    try:
        metadata.version("mujoco")
    except metadata.PackageNotFoundError:
        return []
    return [name for name in _BACKENDS if sys.platform == "linux" or name == "glfw"]


def _renderer_error(backend: str) -> str | None:
    """The error of a picture in MuJoCo with a renderer, drawn in a process of its own."""
    try:
        process = subprocess.run(
            [sys.executable, "-W", "ignore", "-c", _DRAW],
            env={**os.environ, "MUJOCO_GL": backend}, stdin=subprocess.DEVNULL,
            capture_output=True, text=True, errors="replace", timeout=_PATIENCE,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return f"no picture after {_PATIENCE:g} s"
    if process.returncode == 0:
        return None
    lines = [line.strip() for line in process.stderr.splitlines() if line.strip()]
    return lines[-1] if lines else f"MuJoCo ended with status {process.returncode}"


@contextlib.contextmanager
def _caught() -> Iterator[list[str]]:
    """Yield a list that receives the error of the body as one line; a doctor never fails."""
    errors: list[str] = []
    try:
        yield errors
    except Exception as error:
        known = isinstance(error, LegibilityError)
        text = " ".join(f"{error}".split())
        errors.append(text if known and text else f"{type(error).__name__}: {text}".rstrip(": "))


def _error_of(parts: dict[str, dict[str, Any]], name: str) -> str | None:
    return parts[name]["error"] if name in parts else "missing"


def _rows(rows: Iterator[tuple[str, ...]], title: str, *columns: str) -> Table:
    result = table(title, *columns, text_columns=len(columns))
    for row in rows:
        result.add_row(*row)
    return result


def _machine_rows(result: dict[str, Any]) -> Iterator[tuple[str, str]]:
    system, torch = result["system"], result["torch"]
    yield "legibility", system["legibility"]
    yield "Python", f"{system['python']} ({system['implementation']})"
    yield "system", f"{system['platform']}, {system['cores']} cores"
    if torch["error"]:
        yield "torch", torch["error"]
    else:
        device = f", {torch['device']}" if torch["device"] else ""
        yield "torch", f"{torch['version']}, {torch['build']}, {torch['threads']} threads{device}"


def _package_rows(result: dict[str, Any]) -> Iterator[tuple[str, str, str, str]]:
    for extra, entries in result["packages"].items():
        wanted = "legibility" if extra == _CORE else f"legibility[{extra}]"
        for name, entry in entries.items():
            upgrade = "--upgrade " if entry["version"] else ""
            remedy = f"{entry['problem']}: pip install {upgrade}'{wanted}'"
            yield extra, name, entry["version"] or "–", remedy if entry["problem"] else ""


def _working_rows(result: dict[str, Any]) -> Iterator[tuple[str, str, str, str]]:
    for name, entry in result["environments"].items():
        yield "environment", name, "works" if entry["error"] is None else "–", entry["error"] or ""
    for name, entry in result["weights"].items():
        sizes = ", ".join(f"{f} {size / 1e6:.1f} MB" for f, size in entry["files"].items())
        yield "weights", name, sizes or "–", entry["error"] or ""
    for name, error in result["gl"].items():
        remedy = "" if error is None else f"{_BACKENDS[name]} ({shorten(error, 70)})"
        yield "MuJoCo's pictures", name, "works" if error is None else "–", remedy
    ffmpeg = result["ffmpeg"]
    remedy = "" if ffmpeg else "apt-get install ffmpeg (films can be .gif only)"
    yield "films as .mp4", "ffmpeg", ffmpeg or "–", remedy
