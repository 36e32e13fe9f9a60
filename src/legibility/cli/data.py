"""`legibility data`."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from tyro.conf import arg

from ..checks import Array
from ..data.configuration import FORMATS, DatasetConfig, DemonstrationsConfig, targets_of
from ..data.recordings import read_recordings
from ..errors import InvalidInputError
from ..intent.observer import Observer
from ..motion.archive import passable
from ..report.table import Table
from ..scene import Scene
from .options import Folder, OutputFile, Workers, choices, flags, made
from .output import (
    check_figure,
    check_file,
    check_folder,
    note,
    progress_bar,
    show,
    table,
    write_report,
)

if TYPE_CHECKING:
    from ..data.dataset import Dataset

_Flags = flags(DatasetConfig, "observer", "given", "recordings", "scenes")
_SCALE = ("alpha", "detour", "label")
_Observer = flags(Observer, *(f.name for f in fields(Observer) if f.name not in _SCALE))
_Demonstrations = flags(DemonstrationsConfig)
_SCENES = str(DatasetConfig.scenes)
_Format = Annotated[str | None, choices(FORMATS)]
_BINS = 20
_BAR = 40


def data(
    dataset: Annotated[Any, arg(constructor=_Flags)],
    observer: Annotated[Any, arg(constructor=_Observer)],
    controller: Annotated[Any, arg(constructor=_Demonstrations)],
    workers: Workers,
    scenes: Annotated[str, arg(metavar="INT|FILE")] = _SCENES,
    recordings: Annotated[Path | None, arg(name="from", metavar="FILE|DIR")] = None,
    out: Folder = None,
    info: Folder = None,
    export: _Format = None,
    source: Annotated[Folder, arg(name="data")] = None,
    figure: OutputFile = None,
    json: OutputFile = None,
) -> None:
    """Make a dataset of labelled trajectories, or describe one.

    --out DIR makes it: the same bytes for any number of workers. Interrupted, the same command
    resumes. --info DIR describes it. With --demonstrations N a feedback controller then follows N
    paths of each scene in the environment; its states and actions are stored beside them.

    With --from the trajectories are recorded motions, labelled on the dial of their scenes: a table
    as of `score` with a column scene where there are several, and target, or the goal nearest to
    the end is meant. --mix SHARE fills up with the archive's.

    --export FORMAT --data DIR --out DIR writes a dataset for other programs.

    Args:
        dataset: scenes and trajectories.
        observer: what ℓ means, whoever watches.
        controller: the demonstrations.
        workers: processes that make the data.
        scenes: number of random scenes; or a file, .yaml or .json, of one scene or of several
            (scenes: {NAME: SCENE, ...}), with each goal as the target in turn; --dim and --goals
            then count for nothing.
        recordings: recorded motions in the scenes of the file --scenes: a table, or a folder in the
            format LeRobotDataset v3.
        out: folder of the dataset to make.
        info: folder of the dataset to describe.
        export: torch (safetensors), lerobot (the demonstrations, LeRobotDataset v3) or csv.
        source: folder of the dataset to export.
        figure: with --info, a picture of one scene's archive and all labels.
        json: the description as JSON.

    Examples:
        legibility data --scenes 4096 --views 4 --per-scene 25 --workers 8 --out runs/data
        legibility data --from examples/recordings.csv --scenes examples/paper.yaml --out runs/mine
    """
    if export is not None or source is not None:
        rest = (dataset, observer, controller, workers, scenes, recordings, info, figure, json)
        plain = (_Flags(), _Observer(), _Demonstrations(), Workers(), _SCENES, *[None] * 4)
        _export(export, source, out, rest == plain)
        return
    folder = info if out is None else out
    if folder is None or (out is not None and info is not None):
        raise InvalidInputError("give either --out DIR, to make a dataset, or --info DIR")
    check_file(json, "JSON file")
    if info is not None:
        given = (dataset, observer, controller, scenes, recordings)
        if given != (_Flags(), _Observer(), _Demonstrations(), _SCENES, None):
            raise InvalidInputError("--info describes a dataset as it is; leave the rest out")
        check_figure(figure)
    elif figure is not None:
        raise InvalidInputError("--figure belongs to --info")
    from ..data.dataset import Dataset

    if out is not None:
        given, paths = _source(scenes, recordings)
        config = made(DatasetConfig, dataset, observer=made(Observer, observer), **given)
        content = make_dataset(out, config, made(DemonstrationsConfig, controller), workers, paths)
    else:
        content = Dataset.load(folder)
    config = content.config
    result = _describe(content, folder)
    write_report(json, seed=config.seed, config=config.to_dict(), result=result)
    show(*_tables(result, config, folder))
    if figure is not None:
        from ..figures.paper import archive_figure

        archive = config.archive(
            0, config.observer, cells=config.cells, max_candidates=config.candidates
        )
        curves, labels = archive.trajectories, archive.labels
        archive_figure(archive.scene, 0, curves, labels, content.labels, figure)
        show(f"picture: {figure}")


def _export(form: str | None, source: Path | None, out: Path | None, alone: bool) -> None:
    """Export the dataset in `source`; `alone` is whether nothing else is asked."""
    if form is None or source is None or out is None or not alone:
        raise InvalidInputError(
            "--export FORMAT needs --data DIR, the dataset, and --out DIR, and takes nothing else"
        )
    check_folder(out, "export")
    from ..data.export import export

    for file in export(source, form, out):
        show(str(file))


def _source(scenes: str, recordings: Path | None) -> tuple[dict[str, Any], Sequence[Array] | None]:
    """What the scenes and recordings decide of the settings, and the recorded paths, if any."""
    if scenes.isdecimal():
        if recordings is not None:
            raise InvalidInputError("--from needs --scenes FILE, where the motions were recorded")
        return {"scenes": int(scenes)}, None
    from ..data.recorded import RecordedPaths, read_scenes

    places = read_scenes(scenes)
    if recordings is None:
        given = [_passable(scene, f"{scenes}: {name}".rstrip(": "))
                 for name, scene in places.items()]  # fmt: skip
        several = tuple(itertools.chain(*given))
        return {"given": several, "scenes": len(several)}, None
    dim = next(iter(places.values())).dim
    found = RecordedPaths(read_recordings(recordings, dim, note), places)
    for names, what in (
        (found.touching, "touch something and are left out"),
        (found.off, "begin or end off the scene's start or target and are moved onto them"),
    ):
        if names:
            shown = ", ".join(names[:5]) + ", …" * (len(names) > 5)
            note(f"{len(names)} recordings {what}: {shown}")
    return found.config(), found.paths


def _passable(scene: Scene, name: str) -> tuple[Scene, ...]:
    """The scene with each of its goals as the target, to which some curve must lead."""
    for target in range(scene.num_goals):
        if not passable(scene, target):
            raise InvalidInputError(f"{name}: no curve was found to goals[{target}]")
    return targets_of(scene)


def make_dataset(
    folder: Path,
    config: DatasetConfig,
    controller: DemonstrationsConfig,
    workers: Workers,
    recorded: Sequence[Array] | None = None,
) -> Dataset:
    """Make the dataset in `folder` and its demonstrations, if any are asked."""
    from ..data.dataset import generate
    from ..data.demonstrations import demonstrate

    if controller.demonstrations:
        controller.within(config)
    elif controller != DemonstrationsConfig():
        raise InvalidInputError("settings of demonstrations need --demonstrations N")
    check_folder(folder, "dataset")
    with progress_bar("shards") as progress:
        content = generate(config, folder, recorded=recorded, **vars(workers), progress=progress)
    if controller.demonstrations:
        with progress_bar("shards of demonstrations") as progress:
            demonstrate(folder, controller, **vars(workers), progress=progress)
    return content


def _describe(dataset: Dataset, folder: Path) -> dict[str, Any]:
    """The content of the JSON, with that of demonstrations if there are any."""
    from ..data.dataset import shard_names
    from ..data.demonstrations import DEMONSTRATIONS, Demonstrations

    config, labels = dataset.config, np.clip(dataset.labels, -1, 1)
    edges = np.round(np.linspace(-1, 1, _BINS + 1), 12)
    places = dataset.scenes[:: config.views]
    goals, scenes = np.unique([s.num_goals for s in places], return_counts=True)
    means = {
        name: {"mean": dataset.summary[name].mean(), end: getattr(dataset.summary[name], end)()}
        for name, end in (("coverage", "min"), ("elites", "min"), ("candidates", "max"))
    }
    result = {
        "scenes": len(places),
        "trajectories": labels.size,
        "with_obstacles": sum(bool(s.obstacles) for s in places),
        "observers": Counter(o.kind for o in dataset.observers),
        "sha256": dataset.digest,
        "bytes": sum((folder / n).stat().st_size for n in shard_names(config)),
        "goals": dict(zip(goals.tolist(), scenes, strict=True)),
        **means,
        "dial_coverage": _dial_coverage(labels),
        "labels": {"edges": edges, "counts": np.histogram(labels, bins=edges)[0]},
    }
    if dataset.recorded is not None:
        mine = dataset.recorded[:: config.views]
        result["recorded"] = {
            "motions": sum(len(np.unique(row[row >= 0])) for row in mine),
            "of_the_archive": (mine < 0).mean(),
        }
    if (folder / DEMONSTRATIONS).exists():
        shown = Demonstrations.load(folder)
        steps = np.array([len(actions) for actions in shown.actions])
        result["demonstrations"] = {
            **asdict(shown.config),
            "number": len(shown),
            "pushed": shown.pushed.sum(),
            "steps": {"mean": steps.mean(), "max": steps.max()},
            "sha256": shown.digest,
        }
    return result


def _dial_coverage(labels: np.ndarray) -> dict[str, float]:
    """Share of 41 levels of ℓ from −1 to 1 with a label near (`NEAR`), over the rows `(S, N)`."""
    from ..data.dataset import NEAR

    near = [np.abs(labels - level).min(-1) <= NEAR for level in np.linspace(-1, 1, 41)]
    shares = np.mean(near, axis=0)
    return {"mean": shares.mean(), "min": shares.min()}


def _tables(result: dict[str, Any], config: DatasetConfig, folder: Path) -> list[Table]:
    facts = table(f"dataset {folder}", "", "", text_columns=2)
    content = config.to_dict()
    observer, given = content.pop("observer"), content.pop("given", None)
    recordings = content.pop("recordings", None)
    for name, value in {**content, **{key: observer[key] for key in _SCALE}}.items():
        facts.add_row(name, "..".join(map(str, value)) if isinstance(value, list) else str(value))
    facts.add_row("scene", "given" if given else "random")
    if recordings:
        facts.add_row("recordings", recordings)
        recorded = result["recorded"]
        again = f"{recorded['motions']} motions, repeated to {config.per_scene} a scene"
        facts.add_row("recorded", f"{again}; {recorded['of_the_archive']:.0%} of the archive's")
    facts.add_section()
    elites, coverage = result["elites"], result["coverage"]
    facts.add_row("trajectories", f"{result['trajectories']} in {result['scenes']} scenes")
    facts.add_row("with obstacles", f"{result['with_obstacles']} scenes")
    watching = (f"{number} {kind}" for kind, number in sorted(result["observers"].items()))
    facts.add_row("observers", ", ".join(watching))
    facts.add_row("elites a scene", f"{elites['mean']:.0f} (least {elites['min']})")
    facts.add_row("coverage", f"{coverage['mean']:.3f} (least {coverage['min']:.3f})")
    covered = result["dial_coverage"]
    shown = f"{covered['mean']:.0%} of ℓ (least of a scene {covered['min']:.0%})"
    facts.add_row("dial covered", shown)
    facts.add_row("size", f"{result['bytes'] / 1e6:.3g} MB")
    facts.add_row("sha256", result["sha256"])
    if shown := result.get("demonstrations"):
        facts.add_section()
        facts.add_row("demonstrations", f"{shown['number']}, {shown['pushed']} of them with a push")
        facts.add_row("steps", f"{shown['steps']['mean']:.1f} (most {shown['steps']['max']})")
        facts.add_row("sha256", shown["sha256"])
    edges, counts = result["labels"]["edges"], result["labels"]["counts"]
    labels = {f"{a:+.1f} … {b:+.1f}": n for a, b, n in zip(edges, edges[1:], counts, strict=False)}
    return [facts, _bars("goals", "scenes", result["goals"]), _bars("ℓ", "trajectories", labels)]


def _bars(name: str, items: str, counts: dict[Any, int]) -> Table:
    """A table of `counts` with a bar for each."""
    rows = Table(name, items, "", left=(2,))
    for key, value in counts.items():
        rows.add_row(str(key), str(value), "█" * round(_BAR * value / max(counts.values())))
    return rows
