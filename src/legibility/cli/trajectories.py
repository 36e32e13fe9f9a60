"""Trajectories as CSV: a row a point, columns x, y[, z], and if wanted `trajectory` and `t`."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..checks import Array
from ..errors import InvalidInputError
from ..files import read_text, write_bytes
from ..scene import Scene

__all__ = ["read_trajectories", "write_trajectories"]

_AXES = ("x", "y", "z")
_TIMES = ("t", "time")
_NAME = "trajectory"


@dataclass
class _Rows:
    """The rows of one trajectory, in the order of the file."""

    first_line: int
    points: list[list[float]] = field(default_factory=list)
    times: list[float] = field(default_factory=list)


def read_trajectories(file: str | Path, scene: Scene) -> dict[str, Array]:
    """The trajectories `(T, D)` [m] of a CSV file by their names, in the order of the file.

    Points with a time are read at equal time steps, linear between the given ones; points without
    are taken to be at equal time steps.

    Args:
        file: a header with the columns x, y and in 3D z [m]; if wanted `trajectory`, a name or
            number that tells several trajectories apart, and `t` or `time` [s], which must rise.
        scene: gives the dimension and the workspace, which no point may leave.

    Raises:
        InvalidInputError: anything else, naming the line.
    """

    def fail(line: int, message: str) -> InvalidInputError:
        return InvalidInputError(f"{file}, line {line}: {message}")

    reader = csv.reader(io.StringIO(read_text(file, "trajectory file"), newline=""), strict=True)
    found: dict[str, _Rows] = {}
    try:
        header = [cell.strip().lower() for cell in next(reader, [])]
        if not any(header):
            raise InvalidInputError(f"{file} is empty: a header such as x,y is needed")
        axes, time = _columns(header, scene, lambda message: fail(1, message))
        for cells in reader:
            line = reader.line_num
            if not any(cell.strip() for cell in cells):
                continue
            if len(cells) != len(header):
                raise fail(line, f"{len(cells)} cells, the header has {len(header)}")
            row = dict(zip(header, (cell.strip() for cell in cells), strict=True))
            name = row.get(_NAME, "1")
            if not name:
                raise fail(line, "the trajectory has no name")
            rows = found.setdefault(name, _Rows(line))
            point = [_number(row[axis], axis, line, fail) for axis in axes]
            if not scene.contains(point, 1e-6):
                raise fail(line, f"{point} lies outside the workspace {scene.workspace.tolist()}")
            rows.points.append(point)
            if time is not None:
                rows.times.append(_number(row[time], time, line, fail))
                if len(rows.times) > 1 and rows.times[-1] <= rows.times[-2]:
                    raise fail(line, f"{time} must rise, got {row[time]}")
    except csv.Error as cause:
        raise fail(reader.line_num, str(cause)) from cause
    if not found:
        raise InvalidInputError(f"{file} has a header but no points")
    for name, rows in found.items():
        if len(rows.points) < 2:
            raise fail(rows.first_line, f"trajectory {name!r} must have at least 2 points, got 1")
    return {name: _at_equal_times(rows) for name, rows in found.items()}


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


def _columns(
    header: list[str], scene: Scene, fail: Callable[[str], InvalidInputError]
) -> tuple[tuple[str, ...], str | None]:
    """The names of the axes' columns and of the time's, if any."""
    axes = _AXES[: scene.dim]
    known = {*_AXES, *_TIMES, _NAME}
    unknown = [name for name in header if name not in known]
    if unknown:
        raise fail(
            f"unknown column {unknown[0]!r}; the columns are {', '.join(axes)}, trajectory, t"
        )
    missing = [axis for axis in axes if axis not in header]
    if missing or ("z" in header and scene.dim == 2):
        given = ", ".join(name for name in header if name in _AXES) or "none of them"
        raise fail(f"the scene is {scene.dim}D: columns {', '.join(axes)} are needed, got {given}")
    times = [name for name in header if name in _TIMES]
    if len(set(header)) < len(header) or len(times) > 1:
        raise fail(f"a column is there twice: {', '.join(header)}")
    return axes, next(iter(times), None)


def _number(
    text: str, column: str, line: int, fail: Callable[[int, str], InvalidInputError]
) -> float:
    try:
        value = float(text)
    except ValueError:
        raise fail(line, f"{column} must be a number, got {text!r}") from None
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
