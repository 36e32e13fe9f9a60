"""`legibility score`."""

import io
from collections.abc import Sequence
from csv import DictWriter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from tyro.conf import Positional, arg

from ..errors import InvalidInputError
from ..figures.belief import describe
from ..files import write_bytes
from ..intent.observer import DEFAULT_OBSERVER, OBSERVERS, Observer
from ..scene import Scene
from .options import OptionalFloat, OptionalInt, OutputFile, SceneFile, choices, read_scene
from .output import (
    FIGURE_SUFFIXES,
    check_figure,
    check_file,
    dial_lines,
    dial_record,
    note,
    number,
    show,
    significant,
    table,
    timed,
    write_report,
)

if TYPE_CHECKING:
    from ..evaluation.scoring import Score
    from ..motion.archive import Archive

_SHOWN = {
    "achieved_label": "ℓ",
    "legibility_score": "L_p",
    "length_ratio": "length over shortest",
    "field_legibility": "mean belief, early first",
    "field_time_to_confidence": "share until confident",
    "clearance": "clearance [m]",
    "duration": "duration [s]",
}
"""The metrics on the terminal, the others are in the files."""
_JITTER = 0.1  # share of the length taken for noise that is worth a warning
_MANY, _JUMP = 20, 0.2  # points, and share of the diagonal between two, that look like two motions
_GAP = 0.01  # of an end from the scene's, over the diagonal, that is worth one

_Observers = Annotated[tuple[str, ...], choices(OBSERVERS, "FILE", count=" ...")]


def score(
    trajectories: Annotated[Positional[Path], arg(metavar="TRAJECTORIES", help_behavior_hint="")],
    scene: SceneFile,
    target: OptionalInt = None,
    observer: _Observers = (),
    tolerance: OptionalFloat = None,
    csv: OutputFile = None,
    belief: OutputFile = None,
    json: OutputFile = None,
) -> None:
    """Rate recorded trajectories by every metric; no model is needed.

    The file, CSV or Parquet, has a header and a row for each point: columns x, y and in 3-D z [m].
    A column named trajectory, a name or number, tells several apart. A column t or time [s], which
    must rise within a trajectory, gives the times; without it the points are taken at equal time
    steps. A column target gives the index of the intended goal. Columns that are the same for all
    points of a trajectory are passed on to --csv, others are ignored.

    Rests at both ends are cut off and noise is smoothed, so that it does not count as length. The
    achieved label is read off the scene's archive. Metrics of a belief come twice, field_… for each
    --observer and dragan_… for Dragan's observer.

    Args:
        trajectories: a file, .csv (or other text) or .parquet.
        scene: a file, .yaml or .json.
        target: index of the intended goal, from 0; if not given, that of the column target, or 0.
        observer: who reads the motions, one or several side by side; if not given, that of the
            scene's file, or dragan.
        tolerance: how far beyond a wall of the workspace a point may lie [m]; 3 % of its diagonal
            if not given.
        csv: all metrics, a row for each trajectory and observer.
        belief: each observer's belief over time, a table (.csv) or a picture of up to 5
            trajectories (.png, .pdf, .svg).
        json: everything as JSON.

    Examples:
        legibility score examples/recordings.csv examples/paper.yaml --csv out/scores.csv
        legibility score examples/recordings.csv examples/paper.yaml --observer dragan paper
    """
    for file, what in ((csv, "table"), (json, "JSON file")):
        check_file(file, what)
    is_picture = belief is not None and belief.suffix.lower() in FIGURE_SUFFIXES
    if is_picture:
        check_figure(belief)
    elif belief is not None and belief.suffix.lower() != ".csv":
        raise InvalidInputError(f"belief must end in .csv, .png, .pdf or .svg, got {belief}")
    check_file(belief, "belief")
    from ..data.recordings import read_recordings
    from ..evaluation.scoring import score

    place, watching = _observers(scene, observer)
    recordings = read_recordings(trajectories, place.dim, note)
    if is_picture:
        from ..figures.motion import check_number

        check_number(len(recordings), "recordings")
    with timed("built the archives and rated the trajectories"):
        rated = {
            name: score(recordings, place, target, observer=who, tolerance=tolerance)
            for name, who in watching.items()
        }
    _warn(next(iter(rated.values())))
    by_motion = [list(zip(rated, each, strict=True)) for each in zip(*rated.values(), strict=True)]
    rows = [_row(name, each) for motion in by_motion for name, each in motion]
    if csv is not None:
        _write_csv(csv, rows)
    if belief is not None and is_picture:
        from ..figures.recording import belief_figure

        belief_figure(rated, belief)
    elif belief is not None:
        steps = (_steps(name, each) for motion in by_motion for name, each in motion)
        _write_csv(belief, [step for part in steps for step in part])
    dials = {(name, s.archive.target): s.archive for name, each in rated.items() for s in each}
    write_report(
        json,
        seed=0,
        config={
            "target": target,
            "tolerance": tolerance,
            "observers": {name: who.to_dict() for name, who in watching.items()},
        },
        result={
            "scene": place.to_dict(),
            "dials": [
                {"observer": name, "target": goal, **dial_record(archive)}
                for (name, goal), archive in dials.items()
            ],
            "trajectories": rows,
        },
    )
    _print(f"{trajectories} in {scene}", rows, dials)


def _observers(file: Path, asked: Sequence[str]) -> tuple[Scene, dict[str, Observer]]:
    """The scene of a file, and the observers by their names."""
    if not asked:
        scene, observer = read_scene(file)
        return scene, {"dragan" if observer == DEFAULT_OBSERVER else "scene": observer}
    read = {name: read_scene(file, name) for name in asked}
    return next(iter(read.values()))[0], {name: observer for name, (_, observer) in read.items()}


def _warn(rated: Sequence["Score"]) -> None:
    """Say which recordings are much smoothed, or do not lead from start to target."""
    for each in rated:
        steps = np.linalg.norm(np.diff(each.recording.positions, axis=0), axis=-1)
        if len(steps) >= _MANY and steps.max() > _JUMP * each.archive.scene.diagonal:
            note(
                f"trajectory {each.recording.name} jumps by {number(steps.max())} m between two "
                "points: do several have its name?"
            )
        name, metrics, least = each.recording.name, each.metrics, _GAP * each.archive.scene.diagonal
        if each.recording.lost > _JITTER:
            note(
                f"trajectory {name}: {each.recording.lost:.0%} of its length is taken for noise of "
                f"{number(1e3 * each.recording.noise)} mm"
            )
        for verb, end in (("starts", "start"), ("ends", "target")):
            if (gap := metrics[f"{end}_gap"]) > least:
                problem = f"{verb} {number(gap)} m from the {end}, so its label means little"
                note(f"trajectory {name} {problem}")


def _row(observer: str, rated: "Score") -> dict[str, Any]:
    """One row of the table of all metrics."""
    recording = rated.recording
    names = {"trajectory": recording.name, "observer": observer, "target": rated.archive.target}
    return {**names, **recording.notes, "points": len(recording), **rated.metrics}


def _steps(observer: str, rated: "Score") -> list[dict[str, Any]]:
    """The rows of the table of belief over time."""
    recording = rated.recording
    names = {"trajectory": recording.name, "observer": observer}
    return [
        {
            **names,
            "t": round(time, 9),
            **dict(zip("xyz", point, strict=False)),
            **{f"belief_{goal}": share for goal, share in enumerate(shares)},
        }
        for time, point, shares in zip(
            recording.motion_times.tolist(),
            recording.motion.tolist(),
            rated.belief.tolist(),
            strict=True,
        )
    ]


def _write_csv(file: Path, rows: Sequence[dict[str, Any]]) -> None:
    """A table with a column for each key of any row."""
    columns = list(dict.fromkeys(key for row in rows for key in row))
    text = io.StringIO(newline="")
    writer = DictWriter(text, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    write_bytes(file, text.getvalue().encode())


def _print(
    title: str, rows: Sequence[dict[str, Any]], dials: dict[tuple[str, int], "Archive"]
) -> None:
    """Print a row for each trajectory and observer, and what the dials are worth."""
    shown = {key: head for key, head in _SHOWN.items() if any(key in row for row in rows)}
    several = {
        "observer": len({row["observer"] for row in rows}) > 1,
        "target": len({row["target"] for row in rows}) > 1,
    }
    names = ["trajectory", *(key for key, differs in several.items() if differs)]
    head = title if several["target"] else f"{title}, goal {rows[0]['target']}"
    heads = (*names, *shown.values())
    result = table(head, *heads, text_columns=len(names))
    for row in rows:
        values = (significant(row[key]) if key in row else "" for key in shown)
        result.add_row(*(str(row[name]) for name in names), *values)
    show(result)
    for (name, goal), archive in dials.items():
        observer = describe(archive.scene, archive.observer)
        place = f"goal {goal}, " * several["target"]
        show(f"{name}: {place}{observer}", *(f"  {line}" for line in dial_lines(archive)))
