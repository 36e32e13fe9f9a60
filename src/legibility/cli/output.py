"""What verbs write and print: the JSON envelope, checks of output files, tables and progress."""

from __future__ import annotations

import contextlib
import math
import os
import shlex
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextvars import ContextVar
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.text import Text

from ..errors import CheckpointError, OutputError
from ..files import file_hash, write_json
from ..report.table import Table, number, significant

__all__ = [
    "ARGUMENTS",
    "check_figure",
    "check_file",
    "check_folder",
    "model_record",
    "note",
    "number",
    "progress_bar",
    "show",
    "significant",
    "table",
    "write_report",
]

ARGUMENTS: ContextVar[Sequence[str]] = ContextVar("ARGUMENTS", default=())
"""What the command was called with, which every report repeats."""

FIGURE_SUFFIXES = (".png", ".pdf", ".svg")

_PATIENCE = 2.0
"""Work shorter than this [s] shows no progress bar."""

_LEAST_INTERVAL, _MOST_INTERVAL = 5.0, 30.0
"""Off a terminal a line of progress is printed after a tenth of the work and this least time [s],
and after the other at the latest."""


def check_file(path: Path | None, what: str) -> None:
    """Raise before any work is done if `path`, the file of `what`, cannot be written."""
    if path is None or (os.path.exists(path) and not path.is_file() and not path.is_dir()):
        return  # nothing to write, or a device or pipe such as /dev/stdout
    if path.is_dir():
        raise OutputError(f"cannot write the {what} {path}: it is a folder")
    check_folder(path.parent, what)


def check_figure(path: Path | None) -> None:
    """`check_file` of a picture, whose suffix must be of a known format too."""
    if path is not None and path.suffix.lower() not in FIGURE_SUFFIXES:
        raise OutputError(
            f"cannot write the figure {path}: its name must end in {', '.join(FIGURE_SUFFIXES)}"
        )
    check_file(path, "figure")


def check_folder(path: Path, what: str) -> None:
    """Raise if `path` is no folder that can be made and written to; nothing is left there."""
    existing = path.absolute()
    while not os.path.lexists(existing):
        existing = existing.parent
    if not existing.is_dir():
        raise OutputError(f"cannot write the {what} to {path}: {existing} is not a folder")
    try:
        with tempfile.TemporaryFile(dir=existing):  # asks the file system: root may write anywhere
            pass
    except OSError as cause:
        raise OutputError(f"cannot write the {what} to {path}: {cause.strerror}") from cause


def model_record(name_or_folder: str) -> dict[str, str]:
    """Which weights were used: the name that was given and the hash of each stage's file."""
    from ..models.pretrained import pretrained_folder

    folder = pretrained_folder(name_or_folder)
    try:
        hashes = {f.stem: file_hash(f) for f in sorted(folder.glob("*.safetensors"))}
    except OSError as cause:
        raise CheckpointError(f"cannot read the weights of {name_or_folder}: {cause}") from cause
    return {"name": name_or_folder, **hashes}


def write_report(
    file: Path | None,
    *,
    seed: int | None,
    config: dict[str, Any],
    result: dict[str, Any],
    model: dict[str, str] | None = None,
    baselines: list[dict[str, str]] | None = None,
) -> None:
    """Write what was computed, and what it takes to compute it again, to a JSON `file`, if any."""
    from .. import __version__

    if file is None:
        return
    content = {
        "legibility": __version__,
        "command": shlex.join(["legibility", *ARGUMENTS.get()]),
        "seed": seed,
        "config": config,
        **({"model": model} if model else {}),
        **({"baselines": baselines} if baselines else {}),
        "result": result,
    }
    write_json(file, _plain(content))


def _plain(value: Any) -> Any:
    """`value` with lists for arrays and None for what JSON has no number for."""
    if isinstance(value, dict):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return str(value) if isinstance(value, Path) else value


def table(title: str, *columns: str, text_columns: int = 0) -> Table:
    """An empty table, its first `text_columns` columns aligned left and the others right."""
    return Table(*columns, title=title, text_columns=text_columns)


def show(*items: Table | str) -> None:
    """Print tables and lines to the standard output, as text and not as markup."""
    console = _console(sys.stdout)
    for item in items:
        console.print(Text(item) if isinstance(item, str) else item.rich())


def note(line: str) -> None:
    """Print a line for the reader, not for the next program in a pipe."""
    _console(sys.stderr).print(Text(f"legibility: {line}"))


class _Console(Console):
    def on_broken_pipe(self) -> None:
        """Leave it to `main`; rich would exit with status 1."""
        raise BrokenPipeError


def _console(file: Any) -> Console:
    # In a file or a pipe a table may be as wide as it needs to be.
    width = None if file.isatty() else 200
    return _Console(
        file=file, width=width, highlight=False, emoji=False, soft_wrap=not file.isatty()
    )


class _ProgressLines:
    """Progress for a log file or a pipe: a line now and then, and none of quick work."""

    def __init__(self, title: str) -> None:
        self.title, self.tenths, self.time = title, 0, time.monotonic()

    def update(self, done: int, total: int) -> None:
        """Print a line if enough was done, or enough time has passed, since the last one."""
        tenths, waited = 10 * done // max(total, 1), time.monotonic() - self.time
        if waited > (_LEAST_INTERVAL if tenths != self.tenths else _MOST_INTERVAL):
            note(f"{self.title} {done} of {total}")
            self.tenths, self.time = tenths, time.monotonic()


@contextlib.contextmanager
def progress_bar(title: str) -> Iterator[Callable[..., None]]:
    """Yield `progress(done, total, line="")`, which draws a bar once the work takes a while.

    Off a terminal it prints a line after every tenth of the work or 30 s instead. `line` is a
    message that stays, above the bar or in a log file.
    """
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    console = _console(sys.stderr)
    started = time.monotonic()
    lines = _ProgressLines(title)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
    bar = Progress(*columns, TimeElapsedColumn(), TimeRemainingColumn(), console=console)
    task = bar.add_task(title, total=None)

    def progress(done: int, total: int, line: str = "") -> None:
        bar.update(task, completed=done, total=total)
        late = time.monotonic() - started > _PATIENCE
        if late and console.is_terminal and not bar.live.is_started and done < total:
            bar.start()
        if done >= total and bar.live.is_started:
            bar.stop()  # another one may follow
        if not console.is_terminal:
            lines.update(done, total)
        if line:
            bar.console.print(Text(line))

    try:
        yield progress
    finally:
        if bar.live.is_started:
            bar.stop()
