"""`legibility data`."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from tyro.conf import arg

from ..data.configuration import DatasetConfig, DemonstrationsConfig
from ..data.dataset import Dataset, generate, shard_names
from ..data.demonstrations import DEMONSTRATIONS, Demonstrations, demonstrate
from ..errors import InvalidInputError
from ..intent.observer import Observer
from ..report.table import Column, Table
from .options import Folder, OutputFile, Workers, flags, made
from .output import check_figure, check_file, check_folder, progress_bar, show, table, write_report

_Flags = flags(DatasetConfig, "observer")
_Observer = flags(Observer)
_Demonstrations = flags(DemonstrationsConfig)
_BINS = 20
_BAR = 40


def data(
    dataset: Annotated[Any, arg(constructor=_Flags)],
    observer: Annotated[Any, arg(constructor=_Observer)],
    controller: Annotated[Any, arg(constructor=_Demonstrations)],
    workers: Workers,
    out: Folder = None,
    info: Folder = None,
    figure: OutputFile = None,
    json: OutputFile = None,
) -> None:
    """Make a dataset of labelled trajectories, or describe one.

    With --out DIR it is made: the same bytes for any number of workers. Interrupted, the same
    command goes on where it stopped. With --info DIR it is described. With --demonstrations N a
    feedback controller then follows N paths of each scene in the environment; its states and
    actions are stored beside them.

    Args:
        dataset: what the dataset is made of.
        observer: whose scores and labels.
        controller: what the demonstrations are made of.
        workers: who makes it.
        out: folder of the dataset to make.
        info: folder of a dataset to describe.
        figure: with --info, a picture of one scene's archive and all labels; else DIR/info.png.
        json: the description as JSON.
    """
    if (out is None) == (info is None):
        raise InvalidInputError("give either --out DIR, to make a dataset, or --info DIR")
    check_file(json, "JSON file")
    if out is not None:
        settings = made(DatasetConfig, dataset, observer=made(Observer, observer))
        shown = made(DemonstrationsConfig, controller)
        if figure is not None:
            raise InvalidInputError("--figure belongs to --info")
        if shown.demonstrations:
            shown.within(settings)
        elif shown != DemonstrationsConfig():
            raise InvalidInputError("what is said of demonstrations needs --demonstrations N")
        check_folder(out, "dataset")
        with progress_bar("shards") as progress:
            made_or_read = generate(settings, out, **vars(workers), progress=progress)
        if shown.demonstrations:
            with progress_bar("shards of demonstrations") as progress:
                demonstrate(out, shown, **vars(workers), progress=progress)
        folder = out
    else:
        assert info is not None
        if dataset != _Flags() or observer != _Observer() or controller != _Demonstrations():
            raise InvalidInputError("--info describes a dataset as it was made; leave the rest out")
        folder = info
        made_or_read = Dataset.load(folder)
        figure = folder / "info.png" if figure is None else figure
        check_figure(figure)
    config = made_or_read.config
    result = _describe(made_or_read, folder)
    write_report(json, seed=config.seed, config=config.to_dict(), result=result)
    if figure is not None:
        _draw(made_or_read, figure)
    show(*_tables(result, config, folder))
    if figure is not None:
        show(f"picture: {figure}")


def _draw(dataset: Dataset, figure: Path) -> None:
    from ..figures.plan import archive_figure

    config = dataset.config
    archive = config.source.archive(0, config.observer, config.cells)
    archive_figure(archive.scene, 0, archive.trajectories, archive.labels, dataset.labels, figure)


def _describe(dataset: Dataset, folder: Path) -> dict[str, Any]:
    labels = np.clip(dataset.labels, -1, 1)
    edges = np.round(np.linspace(-1, 1, _BINS + 1), 12)
    counts, _ = np.histogram(labels, bins=edges)
    goals, scenes = np.unique([s.num_goals for s in dataset.scenes], return_counts=True)
    summary = dataset.summary
    return {
        "scenes": len(dataset.scenes),
        "trajectories": labels.size,
        "sha256": dataset.digest,
        "bytes": sum((folder / n).stat().st_size for n in shard_names(dataset.config)),
        "goals": dict(zip(goals.tolist(), scenes, strict=True)),
        "coverage": {"mean": summary["coverage"].mean(), "min": summary["coverage"].min()},
        "elites": {"mean": summary["elites"].mean(), "min": summary["elites"].min()},
        "candidates": {"mean": summary["candidates"].mean(), "max": summary["candidates"].max()},
        "labels": {"edges": edges, "counts": counts},
        **_demonstrated(folder),
    }


def _demonstrated(folder: Path) -> dict[str, Any]:
    """Of the demonstrations in `folder`, if there are any."""
    if not (folder / DEMONSTRATIONS).exists():
        return {}
    found = Demonstrations.load(folder)
    steps = np.array([len(actions) for actions in found.actions])
    return {
        "demonstrations": {
            **asdict(found.config),
            "number": len(found),
            "pushed": found.pushed.sum(),
            "steps": {"mean": steps.mean(), "max": steps.max()},
            "sha256": found.digest,
        }
    }


def _tables(result: dict[str, Any], config: DatasetConfig, folder: Path) -> list[Table]:
    facts = table(f"dataset {folder}", "", "", text_columns=2)
    for name, value in config.to_dict().items():
        shown = "..".join(map(str, value)) if isinstance(value, list) else str(value)
        facts.add_row(name, shown)
    facts.add_section()
    facts.add_row("trajectories", f"{result['trajectories']} in {result['scenes']} scenes")
    facts.add_row(
        "elites a scene", f"{result['elites']['mean']:.0f} (least {result['elites']['min']})"
    )
    facts.add_row(
        "coverage", f"{result['coverage']['mean']:.3f} (least {result['coverage']['min']:.3f})"
    )
    facts.add_row("size", f"{result['bytes'] / 1e6:.3g} MB")
    facts.add_row("sha256", result["sha256"])
    if demonstrations := result.get("demonstrations"):
        facts.add_section()
        steps = demonstrations["steps"]
        facts.add_row(
            "demonstrations",
            f"{demonstrations['number']}, {demonstrations['pushed']} of them with a push",
        )
        facts.add_row("steps of each", f"{steps['mean']:.1f} (most {steps['max']})")
        facts.add_row("sha256", demonstrations["sha256"])

    goals = {str(n): int(k) for n, k in result["goals"].items()}
    edges, counts = result["labels"]["edges"], result["labels"]["counts"]
    labels = {f"{a:+.1f} … {b:+.1f}": n for a, b, n in zip(edges, edges[1:], counts, strict=False)}
    return [facts, _bars("goals", "scenes", goals), _bars("ℓ", "trajectories", labels)]


def _bars(name: str, what: str, counts: dict[str, int]) -> Table:
    rows = Table(name, what, Column("", left=True), text_columns=0)
    most = max(counts.values())
    for key, value in counts.items():
        rows.add_row(key, str(value), "█" * round(_BAR * value / most))
    return rows
