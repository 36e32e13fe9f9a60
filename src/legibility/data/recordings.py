"""Recordings on disk: tables of CSV and Parquet, a row a point, with columns x, y[, z].

Optional columns: `trajectory` tells several apart, `t` or `time` gives the times, `target` the
intended goal, `scene` the scene.
"""

import contextlib
import csv
import io
import math
import re
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..checks import Array
from ..errors import InvalidInputError
from ..files import at_home, read_text, write_bytes
from ..motion.recording import Recording

AXES = ("x", "y", "z")
"""Columns of a position."""
_TIMES = ("t", "time")
_NAME, _TARGET, _SCENE = "trajectory", "target", "scene"
_KNOWN = (*AXES, *_TIMES, _NAME, _TARGET, _SCENE)
_SEPARATORS = (",", ";", "\t", " ")
_METRES = ("m", "metre", "metres", "meter", "meters")
_SECONDS = ("s", "sec", "second", "seconds")
_COLUMN = re.compile(r"(.*?)(?:\s*[\[(]\s*(.*?)\s*[\])])?", re.DOTALL)
"""A name and perhaps a unit."""


class _Header(NamedTuple):
    """The names of the columns, in lower case, and the units that they give."""

    line: int
    names: list[str]
    units: dict[str, str]
    separator: str = ""


class _Row(NamedTuple):
    """One point of a recording, and what holds for all of it."""

    numbers: list[float]
    target: int | None
    scene: str | None
    others: dict[str, str]


def read_recordings(
    file: str | Path, dim: int, note: Callable[[str], object] = lambda line: None
) -> list[Recording]:
    """The recordings of a table or of a folder, in their order.

    Args:
        file: a folder in the format LeRobotDataset v3 (see `read_lerobot`), whose tasks' texts name
            the scenes; or a table, as `.parquet` or as text: separated by commas, semicolons, tabs
            or blanks, with a header that names the columns x, y and in 3-D z [m]. Optional columns:
            `trajectory`, a name or number that tells several apart; `t` or `time` [s], which must
            rise; `target`, the index of the intended goal, and `scene`, a name, each the same for
            all points of a trajectory. Capitals, blanks, a `#` or `%` before the header and a unit
            behind a name (`x [m]`) are accepted.
        dim: D of the scene.
        note: is called with a line about columns that are ignored: others, unless they are the same
            for all points of each trajectory, which become its notes.

    Raises:
        InvalidInputError: anything else, naming the line or row.
    """
    if at_home(file).is_dir():
        return _of_lerobot(file, dim)
    is_parquet = Path(file).suffix.lower() == ".parquet"
    header, rows = (_parquet if is_parquet else _text)(file)
    word = "row" if is_parquet else "line"
    found: dict[str, list[_Row]] = {}
    first: dict[str, int] = {}
    with _named(f"{file}, {word} {header.line}"):
        columns = _columns(header, dim)
    for place, cells in rows:
        with _named(f"{file}, {word} {place}"):
            name, row = _row(cells, header, columns)
            first.setdefault(name, place)
            points = found.setdefault(name, [])
            points.append(row)
            _check_next(points[-2:], columns, dim)
    if not found:
        raise InvalidInputError(f"{file} has a header but no points")
    for name, place in first.items():
        if len(found[name]) < 2:
            problem = f"trajectory {name!r} must have at least 2 points, got 1"
            raise InvalidInputError(f"{file}, {word} {place}: {problem}")
    # What is the same for all points of each trajectory says something of the trajectory.
    passed = [
        name
        for name in header.names
        if name and name not in _KNOWN
        and all(row.others[name] == rows[0].others[name] for rows in found.values() for row in rows)
    ]  # fmt: skip
    ignored = [name for name in header.names if name not in (*_KNOWN, *passed)]
    if ignored:
        note(f"{file}: columns ignored: {', '.join(name or 'without a name' for name in ignored)}")
    return [_recording(name, rows, dim, passed) for name, rows in found.items()]


def _of_lerobot(folder: str | Path, dim: int) -> list[Recording]:
    from .lerobot import read_lerobot  # which reads much else

    found = []
    for number, episode in enumerate(read_lerobot(folder)):
        if (size := episode.positions.shape[-1]) != dim:
            raise InvalidInputError(f"{folder}: the motions are {size}D, the scene is {dim}D")
        name = str(number)
        found.append(Recording(episode.positions, episode.times, name, scene=episode.task))
    return found


@contextlib.contextmanager
def _named(place: str) -> Iterator[None]:
    """Name the place of an error within."""
    try:
        yield
    except InvalidInputError as cause:
        raise InvalidInputError(f"{place}: {cause}") from cause


def _recording(name: str, rows: Sequence[_Row], dim: int, passed: Sequence[str]) -> Recording:
    numbers, first = np.array([row.numbers for row in rows]), rows[0]
    times = numbers[:, dim] if numbers.shape[-1] > dim else None
    notes = {column: first.others[column] for column in passed}
    return Recording(numbers[:, :dim], times, name, first.target, first.scene, notes)


def _check_next(rows: Sequence[_Row], columns: Sequence[str], dim: int) -> None:
    """Raise unless the last of two rows of a trajectory may follow the other."""
    if len(rows) < 2:
        return
    before, after = rows
    if len(after.numbers) > dim and after.numbers[-1] <= before.numbers[-1]:
        raise InvalidInputError(
            f"{columns[-1]} must rise, got {after.numbers[-1]}: do several motions have one name?"
        )
    for name in (_TARGET, _SCENE):
        old, new = getattr(before, name), getattr(after, name)
        if old != new:
            raise InvalidInputError(
                f"{name} must be the same for all of a trajectory, got {new} after {old}"
            )


def _text(file: str | Path) -> tuple[_Header, Iterator[tuple[int, list[str]]]]:
    """The header of a text file, and its lines as numbers and cells."""
    lines = list(io.StringIO(read_text(file, "trajectory file"), newline=""))
    header = _header(lines)
    if header is None:
        raise InvalidInputError(f"{file} is empty: a header such as x,y is needed")
    return header, _lines(file, lines, header)


def _lines(
    file: str | Path, lines: Sequence[str], header: _Header
) -> Iterator[tuple[int, list[str]]]:
    reader = csv.reader(
        lines[header.line :], delimiter=header.separator, strict=True, skipinitialspace=True
    )
    try:
        for cells in reader:
            if any(cell.strip() for cell in cells):
                yield header.line + reader.line_num, cells
    except csv.Error as cause:
        line = header.line + reader.line_num
        raise InvalidInputError(f"{file}, line {line}: {cause}") from cause


def _parquet(file: str | Path) -> tuple[_Header, Iterator[tuple[int, list[str]]]]:
    """The columns of a Parquet file, and its rows as numbers and cells."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        table = pq.read_table(at_home(file))
    except (OSError, pa.ArrowException) as cause:
        reason = getattr(cause, "strerror", None) or "not a Parquet file"
        raise InvalidInputError(f"cannot read the trajectory file {file}: {reason}") from cause
    header = _split(0, list(table.column_names))
    cells = zip(*(column.to_pylist() for column in table.columns), strict=True)
    return header, ((i, ["" if c is None else str(c) for c in row]) for i, row in enumerate(cells))


def write_trajectories(file: str | Path, names: Sequence[str], trajectories: Array) -> None:
    """Write `(N, T, D)` [m] as `read_trajectories` reads them; equal names get a count."""
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([_NAME, *AXES[: trajectories.shape[-1]]])
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
        options = [
            _split(number, next(csv.reader([text], delimiter=s, skipinitialspace=True), []), s)
            for s in _SEPARATORS
        ]
        header = max(options, key=lambda option: sum(name in _KNOWN for name in option.names))
        first = first or header
        if not is_comment or any(name in AXES for name in header.names):
            is_data = all(map(_is_number, header.names))
            return first if is_data and len(first.names) == len(header.names) else header
    return first


def _split(line: int, cells: Sequence[str], separator: str = "") -> _Header:
    """A header of the names and units in `cells`."""
    matches = [_COLUMN.fullmatch(cell.lower().strip()) for cell in cells]
    units = {match[1]: match[2] for match in matches if match and match[2] is not None}
    return _Header(line, [match[1] for match in matches if match], units, separator)


def _columns(header: _Header, dim: int) -> list[str]:
    """The names of the axes' columns and of the time's, if any."""
    axes, names = AXES[:dim], header.names
    if all(map(_is_number, re.split(r"[,;\s]+", " ".join(names).strip()))):
        example = ",".join(axes)
        raise InvalidInputError(
            f"there is no header: the first line must name the columns, as {example}"
        )
    if "z" in names and dim == 2:
        raise InvalidInputError("the scene is 2D, but there is a column z: remove one or the other")
    if not set(axes) <= set(names):
        shown = ", ".join(name or "a column without a name" for name in names)
        raise InvalidInputError(
            f"the scene is {dim}D: columns {', '.join(axes)} are needed, got {shown}"
        )
    times = [name for name in names if name in _TIMES]
    if len(times) > 1 or any(names.count(name) > 1 for name in _KNOWN):
        raise InvalidInputError(f"a column is there twice: {', '.join(names)}")
    for columns, allowed, unit in ((axes, _METRES, "metres"), (times, _SECONDS, "seconds")):
        for name in columns:
            if header.units.get(name, allowed[0]) not in allowed:
                raise InvalidInputError(
                    f"{name} must be in {unit}, got {name} [{header.units[name]}]"
                )
    return [*axes, *times]


def _row(cells: list[str], header: _Header, columns: Sequence[str]) -> tuple[str, _Row]:
    """The trajectory's name and the values of one line."""
    if len(cells) != len(header.names):
        raise InvalidInputError(f"{len(cells)} cells, the header has {len(header.names)}")
    texts = dict(zip(header.names, map(str.strip, cells), strict=True))
    name = texts.get(_NAME, "1")
    if not name:
        raise InvalidInputError("the trajectory has no name")
    numbers = []
    for column in columns:
        text = texts[column]
        if not _is_number(text):
            hint = "; write a decimal point" if "," in text else ""
            raise InvalidInputError(f"{column} must be a number, got {text!r}{hint}")
        numbers.append(float(text))
        if not math.isfinite(numbers[-1]):
            raise InvalidInputError(f"{column} must be finite, got {text}")
    target = texts.get(_TARGET)
    if target is not None and not re.fullmatch(r"[0-9]{1,9}(\.0*)?", target):
        raise InvalidInputError(f"target must be the index of a goal, got {target!r}")
    if (scene := texts.get(_SCENE)) == "":
        raise InvalidInputError("the scene has no name")
    others = {column: texts[column] for column in texts if column and column not in _KNOWN}
    return name, _Row(numbers, None if target is None else int(float(target)), scene, others)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
