"""Trajectories as CSV: a row a point, columns x, y[, z], and optionally `trajectory` and `t`."""

import csv
import io
import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..checks import Array
from ..errors import InvalidInputError
from ..files import read_text, write_bytes
from ..scene import START_OVERSHOOT, Scene
from .output import note

_AXES = ("x", "y", "z")
_TIMES = ("t", "time")
_NAME = "trajectory"
_KNOWN = (*_AXES, *_TIMES, _NAME)
_SEPARATORS = (",", ";", "\t", " ")
_METRES = ("m", "metre", "metres", "meter", "meters")
_COLUMN = re.compile(r"(.*?)(?:\s*[\[(]\s*(.*?)\s*[\])])?", re.DOTALL)
"""A name and perhaps a unit."""


class _Header(NamedTuple):
    """The line that names the columns, in lower case, and the units that it gives."""

    line: int
    names: list[str]
    units: dict[str, str]
    separator: str


def read_trajectories(file: str | Path, scene: Scene) -> dict[str, Array]:
    """The trajectories `(T, D)` [m] of a CSV file by their names, in the order of the file.

    Points with a time are interpolated to equal time steps; points without are taken to be at equal
    time steps. Other columns are left out, with a note on the standard error.

    Args:
        file: separated by commas, semicolons, tabs or blanks, with a header that names the columns
            x, y and in 3-D z [m]; optionally `trajectory`, a name or number that tells several
            trajectories apart, and `t` or `time`, which must rise. Capitals, blanks, a `#` or `%`
            before the header and a unit behind a name (`x [m]`) are accepted.
        scene: gives the dimension and the workspace; a point may lie beyond a wall by as much as a
            robot (`START_OVERSHOOT`).

    Raises:
        InvalidInputError: anything else, naming the line.
    """
    lines = list(io.StringIO(read_text(file, "trajectory file"), newline=""))
    header = _header(lines)
    if header is None:
        raise InvalidInputError(f"{file} is empty: a header such as x,y is needed")
    reader = csv.reader(
        lines[header.line :], delimiter=header.separator, strict=True, skipinitialspace=True
    )
    rows: dict[str, list[list[float]]] = {}
    first_lines: dict[str, int] = {}
    try:
        columns = _columns(header, scene)
        for cells in reader:
            if any(cell.strip() for cell in cells):
                name, row = _row(cells, header, columns, scene)
                first_lines.setdefault(name, header.line + reader.line_num)
                rows.setdefault(name, []).append(row)
                if len(row) > scene.dim and rows[name][:-1] and row[-1] <= rows[name][-2][-1]:
                    raise InvalidInputError(f"{columns[-1]} must rise, got {row[-1]}")
    except (csv.Error, InvalidInputError) as cause:
        raise InvalidInputError(f"{file}, line {header.line + reader.line_num}: {cause}") from cause
    if not rows:
        raise InvalidInputError(f"{file} has a header but no points")
    for name, line in first_lines.items():
        if len(rows[name]) < 2:
            problem = f"trajectory {name!r} must have at least 2 points, got 1"
            raise InvalidInputError(f"{file}, line {line}: {problem}")
    if left_out := [name or "without a name" for name in header.names if name not in _KNOWN]:
        note(f"{file}: columns left out: {', '.join(left_out)}")
    return {name: _at_equal_times(np.array(values), scene.dim) for name, values in rows.items()}


def write_trajectories(file: str | Path, names: Sequence[str], trajectories: Array) -> None:
    """Write `(N, T, D)` [m] as `read_trajectories` reads them; equal names get a count."""
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([_NAME, *_AXES[: trajectories.shape[-1]]])
    for index, trajectory in enumerate(trajectories.tolist()):
        name, count = names[index], names[: index + 1].count(names[index])
        unique = name if count == 1 else f"{name} ({count})"
        writer.writerows([unique, *map(repr, point)] for point in trajectory)
    write_bytes(file, text.getvalue().encode())


def _header(lines: Sequence[str]) -> _Header | None:
    """The first line that is not blank, or a later one below comments that name no column.

    Its separator is the one that gives most of the known columns.
    """
    first = None
    for number, line in enumerate(lines, start=1):
        if not line.strip():
            continue
        is_comment = line.lstrip()[0] in "#%"
        text = line.rstrip("\r\n").lstrip(" #%")
        options = [_split(number, text, separator) for separator in _SEPARATORS]
        header = max(options, key=lambda option: sum(name in _KNOWN for name in option.names))
        first = first or header
        if not is_comment or any(name in _AXES for name in header.names):
            is_data = all(map(_is_number, header.names))
            return first if is_data and len(first.names) == len(header.names) else header
    return first


def _split(line: int, text: str, separator: str) -> _Header:
    cells = next(csv.reader([text.lower()], delimiter=separator, skipinitialspace=True), [])
    matches = [_COLUMN.fullmatch(cell.strip()) for cell in cells]
    units = {match[1]: match[2] for match in matches if match and match[2] is not None}
    return _Header(line, [match[1] for match in matches if match], units, separator)


def _columns(header: _Header, scene: Scene) -> list[str]:
    """The names of the axes' columns and of the time's, if any."""
    axes, names = _AXES[: scene.dim], header.names
    if all(map(_is_number, re.split(r"[,;\s]+", " ".join(names).strip()))):
        example = ",".join(axes)
        raise InvalidInputError(
            f"there is no header: the first line must name the columns, as {example}"
        )
    if "z" in names and scene.dim == 2:
        raise InvalidInputError("the scene is 2D, but there is a column z: remove one or the other")
    if not set(axes) <= set(names):
        shown = ", ".join(name or "a column without a name" for name in names)
        raise InvalidInputError(
            f"the scene is {scene.dim}D: columns {', '.join(axes)} are needed, got {shown}"
        )
    times = [name for name in names if name in _TIMES]
    if len(times) > 1 or any(names.count(name) > 1 for name in _KNOWN):
        raise InvalidInputError(f"a column is there twice: {', '.join(names)}")
    for axis in axes:
        if header.units.get(axis, "m") not in _METRES:
            raise InvalidInputError(f"{axis} must be in metres, got {axis} [{header.units[axis]}]")
    return [*axes, *times]


def _row(
    cells: list[str], header: _Header, columns: Sequence[str], scene: Scene
) -> tuple[str, list[float]]:
    """The trajectory's name and the numbers in `columns` of one line."""
    if len(cells) != len(header.names):
        raise InvalidInputError(f"{len(cells)} cells, the header has {len(header.names)}")
    texts = dict(zip(header.names, map(str.strip, cells), strict=True))
    name = texts.get(_NAME, "1")
    if not name:
        raise InvalidInputError("the trajectory has no name")
    row = []
    for column in columns:
        text = texts[column]
        if not _is_number(text):
            hint = "; write a decimal point" if "," in text else ""
            raise InvalidInputError(f"{column} must be a number, got {text!r}{hint}")
        row.append(float(text))
        if not math.isfinite(row[-1]):
            raise InvalidInputError(f"{column} must be finite, got {text}")
    point = row[: scene.dim]
    if not scene.contains(point, START_OVERSHOOT[scene.dim]):
        raise InvalidInputError(f"{point} lies outside the workspace {scene.workspace.tolist()}")
    return name, row


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _at_equal_times(rows: Array, dim: int) -> Array:
    """The points `(T, dim)` of rows that may end with a time."""
    points, times = rows[:, :dim], rows[:, dim:].ravel()
    if len(times) == 0:
        return points
    even = np.linspace(times[0], times[-1], len(times))
    if np.abs(times - even).max() <= 1e-3 * (even[1] - even[0]):
        return points  # even but for rounding
    return np.stack([np.interp(even, times, column) for column in points.T], axis=-1)
