"""`legibility data`."""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from tyro.conf import arg

from ..data.configuration import DatasetConfig, DemonstrationsConfig
from ..errors import InvalidInputError
from ..intent.observer import Observer
from ..motion.archive import passable
from ..report.table import Table
from ..scene import Scene
from .options import Folder, OutputFile, Workers, flags, made
from .output import check_figure, check_file, check_folder, progress_bar, show, table, write_report

if TYPE_CHECKING:
    from ..data.dataset import Dataset

_Flags = flags(DatasetConfig, "observer", "given")
_SCALE = ("alpha", "detour", "label")
_Observer = flags(Observer, *(f.name for f in fields(Observer) if f.name not in _SCALE))
_Demonstrations = flags(DemonstrationsConfig)
_Format = Annotated[
    Literal["torch", "lerobot", "csv"] | None,
    arg(metavar="{torch,lerobot,csv}", help_behavior_hint=""),
]
_BINS = 20
_BAR = 40


def data(
    dataset: Annotated[Any, arg(constructor=_Flags)],
    observer: Annotated[Any, arg(constructor=_Observer)],
    controller: Annotated[Any, arg(constructor=_Demonstrations)],
    workers: Workers,
    scene: Annotated[Path | None, arg(metavar="FILE")] = None,
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

    --export FORMAT --data DIR --out DIR writes a dataset for other programs.

    Args:
        dataset: scenes and trajectories.
        observer: what ℓ means, whoever watches.
        controller: the demonstrations.
        workers: processes that make the data.
        scene: instead of random scenes this one, with each of its goals as the target in turn;
            --dim, --scenes and --goals then count for nothing.
        out: folder of the dataset to make.
        info: folder of the dataset to describe.
        export: torch (safetensors), lerobot (the demonstrations, LeRobotDataset v3) or csv.
        source: folder of the dataset to export.
        figure: with --info, a picture of one scene's archive and all labels; DIR/info.png if not
            given.
        json: the description as JSON.
    """
    if export is not None or source is not None:
        rest = (dataset, observer, controller, workers, scene, info, figure, json)
        plain = (_Flags(), _Observer(), _Demonstrations(), Workers(), None, None, None, None)
        _export(export, source, out, rest == plain)
        return
    folder = info if out is None else out
    if folder is None or (out is not None and info is not None):
        raise InvalidInputError("give either --out DIR, to make a dataset, or --info DIR")
    check_file(json, "JSON file")
    if info is not None:
        given = (dataset, observer, controller, scene)
        if given != (_Flags(), _Observer(), _Demonstrations(), None):
            raise InvalidInputError("--info describes a dataset as it is; leave the rest out")
        figure = figure or info / "info.png"
        check_figure(figure)
    elif figure is not None:
        raise InvalidInputError("--figure belongs to --info")
    from ..data.dataset import Dataset

    if out is not None:
        given = None if scene is None else _given(scene)
        config = made(DatasetConfig, dataset, observer=made(Observer, observer), given=given)
        content = make_dataset(out, config, made(DemonstrationsConfig, controller), workers)
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


def _given(file: Path) -> Scene:
    """The scene of a file, to each of whose goals a motion leads."""
    scene = Scene.load(file)
    for target in range(scene.num_goals):
        if not passable(scene, target):
            raise InvalidInputError(f"{file}: no curve was found to goals[{target}]")
    return scene


def make_dataset(
    folder: Path, config: DatasetConfig, controller: DemonstrationsConfig, workers: Workers
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
        content = generate(config, folder, **vars(workers), progress=progress)
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
        "labels": {"edges": edges, "counts": np.histogram(labels, bins=edges)[0]},
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


def _tables(result: dict[str, Any], config: DatasetConfig, folder: Path) -> list[Table]:
    facts = table(f"dataset {folder}", "", "", text_columns=2)
    content = config.to_dict()
    observer, given = content.pop("observer"), content.pop("given", None)
    for name, value in {**content, **{key: observer[key] for key in _SCALE}}.items():
        facts.add_row(name, "..".join(map(str, value)) if isinstance(value, list) else str(value))
    facts.add_row("scene", "given" if given else "random")
    facts.add_section()
    elites, coverage = result["elites"], result["coverage"]
    facts.add_row("trajectories", f"{result['trajectories']} in {result['scenes']} scenes")
    facts.add_row("with obstacles", f"{result['with_obstacles']} scenes")
    watching = (f"{number} {kind}" for kind, number in sorted(result["observers"].items()))
    facts.add_row("observers", ", ".join(watching))
    facts.add_row("elites a scene", f"{elites['mean']:.0f} (least {elites['min']})")
    facts.add_row("coverage", f"{coverage['mean']:.3f} (least {coverage['min']:.3f})")
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
