"""`legibility doctor`."""

from __future__ import annotations

import contextlib
import os
import platform
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
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
"""How long drawing a picture in MuJoCo may take [s]."""

_BACKENDS = {
    "egl": "apt-get install libegl1 libgl1",
    "osmesa": "apt-get install libosmesa6",
    "glfw": "needs a display; else apt-get install xvfb and call with xvfb-run",
}
"""What MuJoCo can draw with, by the value of MUJOCO_GL, and what helps on Debian and Ubuntu."""

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
    """Tell what is installed, what works here, and what to do about the rest.

    The exit status is 0 if the environment of the plane can be stepped and its weights be loaded,
    whatever else is missing, and 2 otherwise.

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
    with _drawing() as pictures, progress_bar("checks") as progress:
        for number, (name, check) in enumerate(checks.items()):
            progress(number, len(checks) + 1)
            result[name] = check()
        progress(len(checks), len(checks) + 1)
        result["gl"] = pictures()
    environment, weights = _MINIMUM
    broken = {
        f"the environment {environment}": _error_of(result["environments"], environment),
        f"the weights {weights}": _error_of(result["weights"], weights),
    }
    result["works"] = not any(broken.values())
    write_report(json, seed=None, config={}, result=result)

    show(
        _rows(_machine_rows(result), "this machine", "what", "found"),
        _rows(_package_rows(result), "packages", "extra", "package", "version", "what to do"),
        _rows(_working_rows(result), "what works", "what", "name", "found", "what to do"),
    )
    for what, error in broken.items():
        if error:
            raise LegibilityError(f"{what} does not work: {error}")
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
    """By extra, `core` first, what each package needs and what is there."""
    try:
        distribution = metadata.distribution("legibility")
    except metadata.PackageNotFoundError:  # it runs from its sources
        return {}
    found: dict[str, dict[str, dict[str, str | None]]] = {_CORE: {}}
    for extra in distribution.metadata.get_all("Provides-Extra") or []:
        found[extra] = {}
    for line in distribution.requires or []:
        named = re.match(r"[\w.-]+", line)
        extra = re.search(r"extra\s*==\s*['\"]([\w.-]+)['\"]", line)
        if named:
            group = found.setdefault(extra[1] if extra else _CORE, {})
            group[named[0]] = _package(named[0], line)
    return found


def _package(name: str, requirement: str) -> dict[str, str | None]:
    """The versions that are wanted and installed, and what is wrong with the latter."""
    wanted = re.sub(r"^[\w.-]+(\[[^\]]*\])?\s*", "", requirement.partition(";")[0]).strip()
    try:
        version = metadata.version(name)
    except metadata.PackageNotFoundError:
        return {"wanted": wanted, "version": None, "problem": "missing"}
    return {"wanted": wanted, "version": version, "problem": _unfit(version, wanted)}


def _unfit(version: str, wanted: str) -> str | None:
    try:
        from packaging.specifiers import SpecifierSet

        fits = SpecifierSet(wanted).contains(version, prereleases=True)
    except (ImportError, ValueError):  # not to be told
        return None
    return None if fits else f"{wanted} is wanted"


def _torch() -> dict[str, Any]:
    with _caught() as caught:
        import torch

        cuda = torch.cuda.is_available()
        return {
            "version": str(torch.__version__),
            "build": f"CUDA {torch.version.cuda}" if torch.version.cuda else "CPU",
            "threads": torch.get_num_threads(),
            "device": torch.cuda.get_device_name() if cuda else None,
            "error": None,
        }
    return {"error": caught[0]}


def _weights() -> dict[str, dict[str, Any]]:
    """By name, the sizes of the files [byte] and why they cannot be loaded."""
    with _caught() as caught:
        from ..models.pretrained import load_stages, pretrained_folder, pretrained_names

        names = [*pretrained_names(), *pretrained_names("goal")]
    if caught:
        return {_MINIMUM[1]: {"files": {}, "error": caught[0]}}
    found: dict[str, dict[str, Any]] = {}
    for name in names:
        with _caught() as caught:
            load_stages(pretrained_folder(name))
        sizes = {f.name: f.stat().st_size for f in pretrained_folder(name).glob("*.safetensors")}
        found[name] = {"files": dict(sorted(sizes.items())), "error": next(iter(caught), None)}
    return found


def _environments() -> dict[str, dict[str, str | None]]:
    """By name, the identifier for Gymnasium and why it cannot be made, reset and stepped."""
    with _caught() as caught:
        import gymnasium

        from ..envs import ENVIRONMENTS
    if caught:
        return {_MINIMUM[0]: {"id": None, "error": caught[0]}}
    found: dict[str, dict[str, str | None]] = {}
    for name, entry in ENVIRONMENTS.items():
        identifier = f"legibility/{entry.partition(':')[2]}-v0"
        with _caught() as caught:
            env = gymnasium.make(identifier)
            env.reset(seed=0)
            env.step(env.action_space.sample())
            env.close()
        found[name] = {"id": identifier, "error": next(iter(caught), None)}
    return found


@contextlib.contextmanager
def _drawing() -> Iterator[Callable[[], dict[str, str | None]]]:
    """Let MuJoCo draw with each backend, in the meantime; what is yielded tells how that ended."""
    try:
        metadata.version("mujoco")
    except metadata.PackageNotFoundError:
        yield dict
        return
    # A backend is chosen when MuJoCo is loaded, and one that does not fit may end the process.
    backends = [name for name in _BACKENDS if sys.platform == "linux" or name == "glfw"]
    started, deadline = {}, time.monotonic() + _PATIENCE
    for name in backends:
        started[name] = subprocess.Popen(
            [sys.executable, "-W", "ignore", "-c", _DRAW],
            env={**os.environ, "MUJOCO_GL": name},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            errors="replace",
        )

    def outcome() -> dict[str, str | None]:
        return {name: _error_line(process, deadline) for name, process in started.items()}

    try:
        yield outcome
    finally:
        for process in started.values():
            process.kill()
            process.communicate()


def _error_line(process: subprocess.Popen[str], deadline: float) -> str | None:
    try:
        _, errors = process.communicate(timeout=max(0.0, deadline - time.monotonic()))
    except subprocess.TimeoutExpired:
        return f"no picture after {_PATIENCE:g} s"
    if process.returncode == 0:
        return None
    lines = [line.strip() for line in errors.splitlines() if line.strip()]
    return lines[-1] if lines else f"MuJoCo ended with status {process.returncode}"


@contextlib.contextmanager
def _caught() -> Iterator[list[str]]:
    """What is yielded gets the error of what is done within, as a line; a doctor never fails."""
    errors: list[str] = []
    try:
        yield errors
    except Exception as error:
        text = (
            str(error) if isinstance(error, LegibilityError) else f"{type(error).__name__}: {error}"
        )
        errors.append(" ".join(text.split()) or type(error).__name__)


def _error_of(found: dict[str, dict[str, Any]], name: str) -> str | None:
    return found[name]["error"] if name in found else "missing"


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
