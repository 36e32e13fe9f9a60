"""`legibility doctor`."""

import contextlib
import os
import platform
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from importlib import metadata
from textwrap import shorten
from typing import NamedTuple

from ..errors import LegibilityError
from ..report.table import Table
from .options import MODEL, OutputFile
from .output import check_file, progress_bar, show, write_report

_BROKEN = "–"
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


class Part(NamedTuple):
    """A row of the report: a part of the installation, its state, – if broken, and a remedy."""

    part: str
    name: str
    state: str
    remedy: str = ""


def doctor(json: OutputFile = None) -> None:
    """Report the installation, whether each part works here, and remedies.

    The exit status is 0 if the 2-D environment can be stepped and its weights can be loaded,
    whatever else is missing, and 2 otherwise.

    Args:
        json: everything as JSON.

    Examples:
        legibility doctor
        legibility doctor --quiet --json out/doctor.json
    """
    check_file(json, "JSON file")
    checks = (_machine, _packages, _environments, _weights, _renderers, _ffmpeg)
    table = Table("part", "name", "state", "remedy", left=range(4))
    parts: list[Part] = []
    with progress_bar("checks") as progress:
        for number, check in enumerate(checks):
            progress(number, len(checks))
            table.add_section()
            for part in check():
                parts.append(part)
                table.add_row(*part)
    core = ("environment", "2d"), ("weights", MODEL)
    broken = [part for part in parts if part[:2] in core and part.state == _BROKEN]
    result = {"works": not broken, "parts": [part._asdict() for part in parts]}
    write_report(json, seed=None, config={}, result=result)
    show(table)
    for part, name, _, problem in broken:
        raise LegibilityError(f"the core does not work: {part} {name}: {problem}")
    show("the core works")


def _attempt(part: str, name: str, check: Callable[[str], str]) -> Part:
    """The state that `check(name)` returns, or its error as one line."""
    try:
        return Part(part, name, check(name))
    except Exception as error:  # a doctor never fails
        text = " ".join(f"{error}".split())
        if not text or not isinstance(error, LegibilityError):
            text = f"{type(error).__name__}: {text}".rstrip(": ")
        return Part(part, name, _BROKEN, text)


def _machine() -> Iterable[Part]:
    from .. import __version__

    affinity = getattr(os, "sched_getaffinity", None)
    cores = len(affinity(0)) if affinity else os.cpu_count()
    python = f"{platform.python_version()} ({platform.python_implementation()})"
    yield Part("machine", "legibility", __version__)
    yield Part("machine", "Python", python)
    yield Part("machine", "system", f"{platform.platform()}, {cores} cores")
    yield _attempt("machine", "torch", _torch)


def _torch(_: str) -> str:
    import torch

    build = f"CUDA {torch.version.cuda}" if torch.version.cuda else "CPU"
    device = f", {torch.cuda.get_device_name()}" if torch.cuda.is_available() else ""
    return f"{torch.__version__}, {build}, {torch.get_num_threads()} threads{device}"


def _packages() -> Iterator[Part]:
    """The packages that the distribution and its extras require; none if it runs from sources."""
    try:
        from packaging.requirements import Requirement

        requirements = list(map(Requirement, metadata.requires("legibility") or []))
    except ImportError:  # of packaging or of the distribution
        return
    for requirement in requirements:
        match = re.search(r"extra == \W([\w.-]+)", str(requirement.marker))
        part, wanted = (f"extra {match[1]}", f"[{match[1]}]") if match else ("core", "")
        try:
            version, problem = metadata.version(requirement.name), ""
            if not requirement.specifier.contains(version, prereleases=True):
                problem = f"{requirement.specifier} is wanted: pip install --upgrade "
        except metadata.PackageNotFoundError:
            version, problem = _BROKEN, "missing: pip install "
        remedy = f"{problem}'legibility{wanted}'" if problem else ""
        yield Part(part, requirement.name, version, remedy)


def _environments() -> Iterable[Part]:
    from ..envs import ENVIRONMENTS

    def step(name: str) -> str:
        import gymnasium

        env = gymnasium.make(f"legibility/{ENVIRONMENTS[name].partition(':')[2]}-v0")
        env.reset(seed=0)
        env.step(env.action_space.sample())
        env.close()
        return "works"

    return [_attempt("environment", name, step) for name in ENVIRONMENTS]


def _weights() -> Iterable[Part]:
    def load(name: str) -> str:
        from ..models.pretrained import load_stages, pretrained_folder

        folder = pretrained_folder(name)
        load_stages(folder)
        files = sorted(folder.glob("*.safetensors"))
        return ", ".join(f"{file.name} {file.stat().st_size / 1e6:.1f} MB" for file in files)

    names = {MODEL: None}
    with contextlib.suppress(Exception):  # which loading the model reports
        from ..models.pretrained import pretrained_names

        names |= dict.fromkeys([*pretrained_names(), *pretrained_names("goal")])
    return [_attempt("weights", name, load) for name in names]


def _renderers() -> Iterable[Part]:
    try:
        metadata.version("mujoco")
    except metadata.PackageNotFoundError:
        return []
    backends = [name for name in _BACKENDS if sys.platform == "linux" or name == "glfw"]
    with ThreadPoolExecutor() as threads:
        return list(threads.map(lambda name: _attempt("MuJoCo's pictures", name, _draw), backends))


def _draw(backend: str) -> str:
    """Draw a picture in MuJoCo, in a process of its own, which a renderer may end."""
    try:
        process = subprocess.run(
            [sys.executable, "-W", "ignore", "-c", _DRAW],
            env={**os.environ, "MUJOCO_GL": backend}, stdin=subprocess.DEVNULL,
            capture_output=True, text=True, errors="replace", timeout=_PATIENCE,
        )  # fmt: skip
        if process.returncode == 0:
            return "works"
        status = f"MuJoCo ended with status {process.returncode}"
        error = [status, *filter(str.strip, process.stderr.splitlines())][-1]
    except subprocess.TimeoutExpired:
        error = f"no picture after {_PATIENCE:g} s"
    raise LegibilityError(f"{_BACKENDS[backend]} ({shorten(error, 70)})")


def _ffmpeg() -> Iterable[Part]:
    file = shutil.which("ffmpeg")
    remedy = "" if file else "apt-get install ffmpeg (films can be .gif only)"
    return [Part("films as .mp4", "ffmpeg", file or _BROKEN, remedy)]
