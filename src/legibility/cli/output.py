"""Output of the verbs: the JSON envelope, checks of output files, tables and progress."""

import contextlib
import hashlib
import json
import logging
import math
import os
import shlex
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextvars import ContextVar
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.text import Text

from ..errors import CheckpointError, InvalidInputError, OutputError
from ..files import file_hash, write_json
from ..motion.archive import SMALLEST_RANGE, Archive
from ..report.table import Table
from ..report.table import number as number
from ..report.table import significant as significant

ARGUMENTS: ContextVar[Sequence[str]] = ContextVar("ARGUMENTS", default=())
"""The command's arguments, which every report repeats."""

_QUIET: ContextVar[bool] = ContextVar("QUIET", default=False)
"""Whether nothing but errors is printed, see `speaking`."""

_LOG = logging.getLogger("legibility")
"""Every module tells its own logger below this one what it reads, writes and loads."""

FIGURE_SUFFIXES = (".png", ".pdf", ".svg")

_PATIENCE = 2.0
"""Work shorter than this [s] shows no progress bar."""

_LEAST_INTERVAL, _MOST_INTERVAL = 5.0, 30.0
"""Bounds of the time [s] between two lines of progress off a terminal."""


@contextlib.contextmanager
def speaking(quiet: bool, verbose: bool) -> Iterator[None]:
    """Set how much is printed within the block.

    With `quiet` nothing but errors: no table, no progress, no note and no warning; what is asked
    for in files is written. With `verbose` also what is read, written and loaded, and how long it
    took, on the standard error.

    Raises:
        InvalidInputError: both are asked.
    """
    if quiet and verbose:
        raise InvalidInputError("give --quiet or --verbose, not both")
    token, level, teller = _QUIET.set(quiet), _LOG.level, _Teller()
    if verbose:
        _LOG.addHandler(teller)
        _LOG.setLevel(logging.INFO)
    try:
        with warnings.catch_warnings(action="ignore") if quiet else contextlib.nullcontext():
            yield
    finally:
        _LOG.info("ended")
        _LOG.removeHandler(teller)
        _LOG.setLevel(level)
        _QUIET.reset(token)


class _Teller(logging.Handler):
    """Prints what the package logs, after the time since the command began."""

    def __init__(self) -> None:
        super().__init__()
        self.began = time.monotonic()

    def emit(self, record: logging.LogRecord) -> None:
        note(f"{time.monotonic() - self.began:.2f} s: {record.getMessage()}")


@contextlib.contextmanager
def timed(what: str) -> Iterator[None]:
    """Tell how long the block took, if --verbose is given."""
    began = time.monotonic()
    yield
    _LOG.info("%s in %.3f s", what, time.monotonic() - began)


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
    """Raise unless `path` is a folder that can be made and written to; leave nothing there."""
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


def model_record(name_or_folder: str, stages: str = "*") -> dict[str, str]:
    """The name of the weights, and what of them made a result.

    Hashes of the file of each stage that matches `stages`, and of the settings of all these.
    """
    from ..models.pretrained import pretrained_folder

    folder = pretrained_folder(name_or_folder)
    try:
        hashes = {f.stem: file_hash(f) for f in sorted(folder.glob(f"{stages}.safetensors"))}
        entries = json.loads((folder / "config.json").read_text(encoding="utf-8"))
        settings = json.dumps({s: entries[s]["config"] for s in hashes}, sort_keys=True)
    except (OSError, ValueError, LookupError, TypeError) as cause:
        raise CheckpointError(f"cannot read the weights of {name_or_folder}: {cause}") from cause
    digest = hashlib.sha256(settings.encode()).hexdigest()
    return {"name": name_or_folder, **hashes, "settings": digest}


def write_report(
    file: Path | None,
    *,
    seed: int | None,
    config: dict[str, Any],
    result: dict[str, Any],
    model: dict[str, str] | None = None,
    baselines: list[dict[str, str]] | None = None,
) -> None:
    """Write a result, with all that is needed to reproduce it, to a JSON `file`, if any."""
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


def dial_record(archive: Archive) -> dict[str, Any]:
    """What one scene's dial is worth, for a report."""
    return {"range": archive.range, "degenerate": archive.degenerate, "blocked": archive.blocked}


def dial_lines(archive: Archive) -> list[str]:
    """What one scene's dial is worth, for the terminal."""
    low, high = map(significant, archive.range)
    lines = [f"the dial spans {low} nats below ℓ = 0 and {high} nats above"]
    if archive.degenerate:
        lines.append(f"a side spans less than {SMALLEST_RANGE:g} nats: its labels say little")
    belief = archive.field.posterior(archive.scene.goals[archive.target])
    if belief.argmax() != archive.target:
        share = significant(belief[archive.target])
        lines.append(f"the observer believes in the target by {share} only when the robot is there")
    if archive.blocked:
        lines.append("the straight line is blocked: ℓ = 0 is the shortest feasible curve")
    return lines


def _plain(value: Any) -> Any:
    """`value` with lists for arrays and None for numbers that JSON cannot express."""
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
    return Table(*columns, title=title, left=range(text_columns))


def show(*items: Table | str) -> None:
    """Print tables and lines to the standard output, as text and not as markup."""
    if _QUIET.get():
        return
    console = _Console(sys.stdout)
    for item in items:
        console.print(Text(item) if isinstance(item, str) else item.rich())


def note(line: str) -> None:
    """Print a line for the reader, not for the next program in a pipe."""
    if not _QUIET.get():
        _Console(sys.stderr).print(Text(f"legibility: {line}"))


class _Console(Console):
    def __init__(self, file: Any) -> None:
        is_file = not file.isatty()  # or a pipe, where a table may be as wide as it needs to be
        width = 200 if is_file else None
        super().__init__(file=file, width=width, highlight=False, emoji=False, soft_wrap=is_file)

    def on_broken_pipe(self) -> None:
        """Leave it to `main`; rich would exit with status 1."""
        raise BrokenPipeError


@contextlib.contextmanager
def progress_bar(title: str) -> Iterator[Callable[..., None]]:
    """Yield `progress(done, total, line="")`, which draws a bar once the work takes a while.

    Off a terminal it prints a line after every tenth of the work or 30 s instead. `line` is a
    message that stays, above the bar or in a log file.
    """
    if _QUIET.get():
        yield lambda *_: None
        return
    from rich.progress import MofNCompleteColumn, Progress, TimeElapsedColumn

    console = _Console(sys.stderr)
    columns = (*Progress.get_default_columns(), MofNCompleteColumn(), TimeElapsedColumn())
    bar = Progress(*columns, console=console)
    task = bar.add_task(title, total=None)
    tenths, began = 0, time.monotonic()
    noted, patient_until, items = began, began + _PATIENCE, 0

    def progress(done: int, total: int, line: str = "") -> None:
        nonlocal tenths, noted, items
        now, reached, items = time.monotonic(), 10 * done // max(total, 1), done
        bar.update(task, completed=done, total=total)
        if not console.is_terminal:
            if now - noted > (_LEAST_INTERVAL if reached != tenths else _MOST_INTERVAL):
                note(f"{title} {done} of {total}")
                tenths, noted = reached, now
        elif done >= total:
            stop()  # another bar may follow
        elif now > patient_until:
            bar.start()
        if line:
            console.print(Text(line))

    def stop() -> None:
        if bar.live.is_started:
            bar.stop()

    try:
        yield progress
    finally:
        stop()
        _LOG.info("%d %s in %.2f s", items, title, time.monotonic() - began)
