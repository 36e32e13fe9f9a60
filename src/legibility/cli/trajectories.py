"""Trajectories as CSV: a row a point, columns x, y[, z], and if wanted `trajectory` and `t`."""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..checks import Array
from ..errors import InvalidInputError
from ..files import read_text, write_bytes
from ..scene import START_OVERSHOOT, Scene
from .output import note

__all__ = ["read_trajectories", "write_trajectories"]

_AXES = ("x", "y", "z")
_TIMES = ("t", "time")
_NAME = "trajectory"
_KNOWN = (*_AXES, *_TIMES, _NAME)
_SEPARATORS = (",", ";", "\t", " ")
_METRES = ("m", "metre", "metres", "meter", "meters")
_UNIT = re.compile(r"(.*?)\s*[\[(]\s*(.*?)\s*[\])]")


@dataclass(frozen=True)
class _Header:
    """The line that names the columns.

    Attributes:
        line: its number, from 1.
        names: of all columns, without units, in lower case.
        units: of the columns that name one.
        separator: between the cells.
    """

    line: int
    names: list[str]
    units: dict[str, str]
    separator: str


@dataclass
class _Rows:
    """The rows of one trajectory, in the order of the file."""

    first_line: int
    points: list[list[float]] = field(default_factory=list)
    times: list[float] = field(default_factory=list)


def read_trajectories(file: str | Path, scene: Scene) -> dict[str, Array]:
    """The trajectories `(T, D)` [m] of a CSV file by their names, in the order of the file.

    Points with a time are read at equal time steps, linear between the given ones; points without
    are taken to be at equal time steps. Other columns are left out, which a note on the standard
    error says.

    Args:
        file: separated by commas, semicolons, tabs or blanks, with a header that names the columns
            x, y and in 3-D z [m]; if wanted `trajectory`, a name or number that tells several
            trajectories apart, and `t` or `time`, which must rise. Capitals, blanks, a `#` or `%`
            before the header and a unit behind a name (`x [m]`) are read over.
        scene: gives the dimension and the workspace, beyond which a point may be only as far as a
            robot (`START_OVERSHOOT`).

    Raises:
        InvalidInputError: anything else, naming the line.
    """

    def fail(line: int, message: str) -> InvalidInputError:
        return InvalidInputError(f"{file}, line {line}: {message}")

    lines = list(io.StringIO(read_text(file, "trajectory file"), newline=""))
    header = _header(lines)
    if header is None:
        raise InvalidInputError(f"{file} is empty: a header such as x,y is needed")
    axes, time = _columns(header, scene, lambda message: fail(header.line, message))
    overshoot = START_OVERSHOOT * scene.diagonal
    reader = csv.reader(lines[header.line :], delimiter=header.separator, strict=True,
                        skipinitialspace=True)  # fmt: skip
    trajectories: dict[str, _Rows] = {}
    try:
        for cells in reader:
            line = header.line + reader.line_num
            if not any(cell.strip() for cell in cells):
                continue
            if len(cells) != len(header.names):
                raise fail(line, f"{len(cells)} cells, the header has {len(header.names)}")
            row = dict(zip(header.names, (cell.strip() for cell in cells), strict=True))
            name = row.get(_NAME, "1")
            if not name:
                raise fail(line, "the trajectory has no name")
            rows = trajectories.setdefault(name, _Rows(line))
            point = [_number(row[axis], axis, line, fail) for axis in axes]
            if not scene.contains(point, overshoot):
                raise fail(line, f"{point} lies outside the workspace {scene.workspace.tolist()}")
            rows.points.append(point)
            if time is not None:
                rows.times.append(_number(row[time], time, line, fail))
                if len(rows.times) > 1 and rows.times[-1] <= rows.times[-2]:
                    raise fail(line, f"{time} must rise, got {row[time]}")
    except csv.Error as cause:
        raise fail(header.line + reader.line_num, str(cause)) from cause
    if not trajectories:
        raise InvalidInputError(f"{file} has a header but no points")
    for name, rows in trajectories.items():
        if len(rows.points) < 2:
            raise fail(rows.first_line, f"trajectory {name!r} must have at least 2 points, got 1")
    left_out = [name or "without a name" for name in header.names if name not in _KNOWN]
    if left_out:
        note(f"{file}: columns left out: {', '.join(left_out)}")
    return {name: _at_equal_times(rows) for name, rows in trajectories.items()}


def write_trajectories(file: str | Path, names: Sequence[str], trajectories: Array) -> None:
    """Write `(N, T, D)` [m] as `read_trajectories` reads them; equal names get a count."""
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([_NAME, *_AXES[: trajectories.shape[-1]]])
    seen: dict[str, int] = {}
    for name, trajectory in zip(names, trajectories, strict=True):
        seen[name] = seen.get(name, 0) + 1
        unique = name if seen[name] == 1 else f"{name} ({seen[name]})"
        writer.writerows([unique, *map(repr, point)] for point in trajectory.tolist())
    write_bytes(file, text.getvalue().encode())


def _header(lines: Sequence[str]) -> _Header | None:
    """The first line that is not blank; comments before it that name no column are read over.

    It is separated by whatever makes most of its cells columns that are known.
    """
    first = None
    for number, line in enumerate(lines, start=1):
        text = line.rstrip("\r\n")
        if not text.strip():
            continue
        if is_comment := text.lstrip().startswith(("#", "%")):
            text = text.lstrip().lstrip("#%")
        options = [_split(number, text, separator) for separator in _SEPARATORS]
        header = max(options, key=lambda option: sum(name in _KNOWN for name in option.names))
        first = first or header
        if not is_comment or any(name in _AXES for name in header.names):
            return header
    return first


def _split(line: int, text: str, separator: str) -> _Header:
    names, units = [], {}
    for cell in next(csv.reader([text], delimiter=separator, skipinitialspace=True), []):
        name = cell.strip().lower()
        if with_unit := _UNIT.fullmatch(name):
            name = with_unit[1]
            units[name] = with_unit[2]
        names.append(name)
    return _Header(line, names, units, separator)


def _columns(
    header: _Header, scene: Scene, fail: Callable[[str], InvalidInputError]
) -> tuple[tuple[str, ...], str | None]:
    """The names of the axes' columns and of the time's, if any."""
    axes, names = _AXES[: scene.dim], header.names
    if all(map(_is_number, re.split(r"[,;\s]+", " ".join(names).strip()))):
        raise fail(f"there is no header: the first line must name the columns, as {','.join(axes)}")
    missing = [axis for axis in axes if axis not in names]
    if missing or ("z" in names and scene.dim == 2):
        shown = ", ".join(name or "a column without a name" for name in names)
        raise fail(f"the scene is {scene.dim}D: columns {', '.join(axes)} are needed, got {shown}")
    times = [name for name in names if name in _TIMES]
    if len(times) > 1 or any(names.count(name) > 1 for name in _KNOWN):
        raise fail(f"a column is there twice: {', '.join(names)}")
    for axis in axes:
        if header.units.get(axis, "m") not in _METRES:
            raise fail(f"{axis} must be in metres, got {axis} [{header.units[axis]}]")
    return axes, next(iter(times), None)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _number(
    text: str, column: str, line: int, fail: Callable[[int, str], InvalidInputError]
) -> float:
    try:
        value = float(text)
    except ValueError:
        hint = "; write a decimal point" if "," in text else ""
        raise fail(line, f"{column} must be a number, got {text!r}{hint}") from None
    if not math.isfinite(value):
        raise fail(line, f"{column} must be finite, got {text}")
    return value


def _at_equal_times(rows: _Rows) -> Array:
    points, times = np.array(rows.points), np.array(rows.times)
    if not rows.times:
        return points
    even = np.linspace(times[0], times[-1], len(times))
    if np.abs(times - even).max() <= 1e-3 * (even[1] - even[0]):
        return points  # even but for rounding
    return np.stack([np.interp(even, times, column) for column in points.T], axis=-1)
