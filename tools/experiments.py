"""Run the measurements of `experiments.toml` that are missing or out of date.

    python tools/experiments.py [--workers N] [NAME ...]

runs in the current folder, where `experiments.toml` and `results/` lie.
"""

from __future__ import annotations

import argparse
import json
import re
import shlex
import subprocess
import sys
import time
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from legibility.cli.output import model_record
from legibility.errors import InvalidInputError, LegibilityError
from legibility.files import read_text

_MODULES = {
    "onnx": "onnxruntime", "panda": "mujoco", "pandagym": "panda_gym", "timing": "toppra",
    "arms": "mujoco_menagerie",
}  # fmt: skip
"""A module of each extra."""
_PARALLEL = (
    "dial", "eyes", "planning", "optimum", "external", "execution", "table1", "unseen",
    "single-scene", "ablations", "timing", "controller",
)  # fmt: skip
"""Evaluations with `--workers`, which does not change their metrics."""


@dataclass(frozen=True)
class Experiment:
    """A measurement.

    Its result is `results/NAME.json`; the other fields are explained in `experiments.toml`.
    """

    name: str
    command: str
    weights: Sequence[str]
    extras: Sequence[str] = ()
    data: str | None = None
    by_name: bool = False

    @property
    def arguments(self) -> list[str]:
        """The arguments of `legibility`, with the file of the result."""
        return [*shlex.split(self.command), "--json", f"results/{self.name}.json"]

    def missing(self) -> list[str]:
        """The needs that are not met here."""
        extras = [f"the extra {e}" for e in self.extras if find_spec(_MODULES[e]) is None]
        data = self.data is not None and not Path(self.data).is_dir()
        return extras + [f"the folder {self.data} (`make weights`)"] * data

    def is_done(self) -> bool:
        """Whether the result was made by this command with the weights as they are now."""
        try:
            document = json.loads(Path(self.arguments[-1]).read_text(encoding="utf-8"))
            command = re.sub(r" --workers \d+", "", document["command"])
            used = [*document.get("baselines", []), *document["config"].get("weights", [])]
            if "model" in document:
                used.append(document["model"])
            current = [current_record(model) for model in used]
            names = {model["name"] for model in used}
        except (OSError, ValueError, LookupError, TypeError, AttributeError, LegibilityError):
            return False
        made_so = shlex.split(command)[1:] == self.arguments and names == set(self.weights)
        return made_so and used == current


def current_record(model: dict[str, str]) -> dict[str, str]:
    """What a result that used the same stages would record now."""
    stages = set(model) - {"name", "settings"}
    return model_record(model["name"], stages.pop() if len(stages) == 1 else "*")


def read_experiments(file: Path) -> dict[str, Experiment]:
    """The entries of `experiments.toml` by name.

    Raises:
        InvalidInputError: it cannot be read, or an entry is malformed.
    """
    try:
        content = tomllib.loads(read_text(file, "experiments"))
        return {name: Experiment(name, **entry) for name, entry in content.items()}
    except (tomllib.TOMLDecodeError, TypeError, AttributeError) as cause:
        raise InvalidInputError(f"{file} is malformed: {cause}") from cause


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the experiments and return the exit status: 1 if one failed."""
    parser = argparse.ArgumentParser(prog="experiments", description="run experiments.toml")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("names", nargs="*", metavar="NAME")
    options = parser.parse_args(arguments)
    experiments = read_experiments(Path("experiments.toml"))
    for name in options.names:
        if name not in experiments:
            parser.error(f"{name} is none of {', '.join(experiments)}")
    failed = []
    for name, experiment in experiments.items():
        if name not in options.names if options.names else experiment.by_name:
            continue
        if experiment.is_done():
            print(f"done: {name}", flush=True)
        elif missing := experiment.missing():
            print(f"SKIPPED: {name} needs {', '.join(missing)}", flush=True)
        else:
            command = ["legibility", *experiment.arguments]
            if experiment.command.startswith(tuple(f"evaluate {verb}" for verb in _PARALLEL)):
                command += ["--workers", str(options.workers)]
            print(shlex.join(command), flush=True)
            started = time.monotonic()
            run = subprocess.run([sys.executable, "-m", *command], check=False)
            print(f"{name}: {time.monotonic() - started:.0f} s", flush=True)
            if run.returncode:
                failed.append(name)
    if failed:
        print(f"FAILED: {', '.join(failed)}", flush=True)
    return int(bool(failed))


if __name__ == "__main__":
    try:
        sys.exit(main())
    except InvalidInputError as error:
        sys.exit(f"experiments: {error}")
    except KeyboardInterrupt:
        sys.exit("interrupted; the same command resumes")
