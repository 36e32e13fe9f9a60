"""`legibility bench`."""

from __future__ import annotations

from dataclasses import asdict
from typing import Annotated, Any

from tyro.conf import arg

from ..errors import InvalidInputError
from ..evaluation.bench import BenchConfig, run_bench
from .options import MODELS, OutputFile, flags, made
from .output import (
    check_file,
    model_record,
    note,
    progress_bar,
    show,
    significant,
    table,
    write_report,
)

_Bench = flags(BenchConfig)
_MODELS = tuple(MODELS.values())

_MADE = {
    "archive": "candidates_per_second",
    "dataset": "scenes_per_second",
    "training": "steps_per_second",
}


def bench(
    measured: Annotated[Any, arg(constructor=_Bench)],
    model: Annotated[tuple[str, ...], arg(metavar="NAME ...")] = _MODELS,
    json: OutputFile = None,
) -> None:
    """Measure how fast planning, moving and training are here, and what they need.

    Beside ours runs, in turns, the paper's published configuration. What is measured is the
    machine as it is: leave it alone meanwhile.

    Args:
        measured: what is measured.
        model: names of weights that came with the package, or folders.
        json: everything as JSON.
    """
    settings = made(BenchConfig, measured)
    check_file(json, "JSON file")
    if not model:
        raise InvalidInputError("model must be at least one name, got none")
    used = [model_record(name) for name in model]
    with progress_bar("parts") as progress:
        result = run_bench(model, settings, progress=progress)
    write_report(
        json,
        seed=None,
        config={**asdict(settings), "weights": used},
        model=used[0],
        result=result,
    )
    for what, why in result["skipped"].items():
        note(f"SKIPPED: {what}: {why}")

    rows = table("how fast", "what", "median", "95 % interval", "calls", text_columns=1)
    for what, figure in _figures(result):
        low, high = figure["interval"]
        rows.add_row(
            what, significant(figure["median"]), f"{significant(low)} … {significant(high)}",
            str(figure["calls"]),
        )  # fmt: skip
    show(rows)


def _figures(result: dict[str, Any]) -> list[tuple[str, dict[str, Any]]]:
    """What is shown of a measurement, in its order."""
    found: list[tuple[str, dict[str, Any]]] = []
    for name, measured in result["models"].items():
        for backend, own in measured["backends"].items():
            who = f"{name}, {backend}"
            for batch, figure in own["growth"]["batch"]["ms"].items():
                found.append((f"{who}: plan {batch} [ms]", figure))
            found.append((f"{who}: plan 1 on one core [ms]", own["plan_one_core_ms"]))
            if "step_ms" in own:
                found.append((f"{who}: control step on one core [ms]", own["step_ms"]))
                found.append((f"{who}: rollouts a second", own["rollouts_per_second"]))
    for batch, figure in result["published"]["plan_ms"].items():
        found.append((f"the published configuration: {batch} [ms]", figure))
        for name, backends in result["published"]["ratio"].items():
            for backend, ratios in backends.items():
                found.append((f"over {name}, {backend}", ratios[batch]))
    for kind, pieces in _MADE.items():
        for dim, own in result[kind].items():
            found.append((f"{dim}-D: {pieces.replace('_', ' ')}", own[pieces]))
    found.append(("import legibility [ms]", result["import_ms"]))
    return found
