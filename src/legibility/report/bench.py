"""The measurements of speed and memory, as text and tables."""

from __future__ import annotations

from typing import Any

from .table import Column, Part, Table
from .wording import threads_of

__all__ = ["bench_section", "measured"]

Columns = dict[str, dict[str, Any]]
"""By its head, the metric of a column and its further conditions."""

_MOTION: Columns = {
    "control step on one core [ms]": {"metric": "control_step_ms"},
    "rollouts a second": {"metric": "rollouts_per_second"},
}
_MAKING: Columns = {
    "archive [ms]": {"metric": "archive_ms"},
    "candidates a second": {"metric": "candidates_per_second"},
    "scenes a second": {"metric": "scenes_per_second"},
    "training steps a second": {"metric": "training_steps_per_second", "precision": "float32"},
    "in bf16": {"metric": "training_steps_per_second", "precision": "bf16"},
}
_PROCESS: Columns = {
    "load [ms]": {"metric": "load_ms"},
    "first plan [ms]": {"metric": "first_plan_ms"},
    "peak memory [MB]": {"metric": "memory_mb"},
}


def bench_section(document: dict[str, Any]) -> list[Part]:
    """The metrics of `legibility bench`.

    They are planning by batch and by goals, motion, data and training, and a fresh process.
    """
    config, result = document["config"], document["result"]
    rows, machine = result["measurements"], result["machine"]
    by_batch: Columns = {
        f"{n:,} path{'s' * (n > 1)} [ms]": {"metric": "plan_ms", "batch": n, "goals": 4}
        for n in config["batches"]
    }
    by_batch["1 path on one core [ms]"] = {"metric": "plan_one_core_ms"}
    by_goals = {
        f"{n} goals [ms]": {"metric": "plan_ms", "batch": 1, "goals": n} for n in config["goals"]
    }
    load = "" if machine["load"] is None else f", load {machine['load']:.1f}"
    model = ["model", "backend"]
    return [
        f"{machine['cpu']}, {machine['cores']} cores, {threads_of(machine)}, PyTorch "
        f"{machine['torch']}{load}. Medians with 95 % intervals over {config['rounds']} "
        f"interleaved rounds of {config['seconds']:g} s or one call. Planning goes from a scene of "
        "4 goals to checked paths.",
        *(f"Skipped: {reason}." for reason in result["skipped"]),
        _table("Planning", rows, model, by_batch),
        _table("Planning one path, by the number of goals", rows, model, by_goals),
        _table("Motion", rows, model, _MOTION),
        f"Rollouts of {config['robots']} 2-D robots or {config['arms']} arms at once.",
        _table("Data and training", rows, ["dim"], _MAKING),
        f"Archives and dataset by one process; training of stage 1 on {machine['device']}.",
        _table("A fresh process", rows, model, _PROCESS),
        "Loading includes PyTorch; before it, `import legibility` takes "
        f"{measured(rows, metric='import_ms')} ms.",
    ]


def measured(measurements: list[dict[str, Any]], **conditions: Any) -> str:
    """Median and interval of the first measurement under `conditions`, – if there is none."""
    for row in measurements:
        if conditions.items() <= row.items():
            return f"{_short(row['median'])} ({_short(row['low'])} to {_short(row['high'])})"
    return "–"


def _table(
    title: str, measurements: list[dict[str, Any]], keys: list[str], columns: Columns
) -> Table:
    """A row for each combination of `keys`, a column for the measurements that match its dict."""
    table = Table(*(Column(key, left=True) for key in keys), *map(Column, columns), title=title)
    metrics = {column["metric"] for column in columns.values()}
    rows = [m for m in measurements if m["metric"] in metrics]
    groups = [{key: m[key] for key in keys} for m in rows]
    for i, group in enumerate(groups):
        if group not in groups[:i]:
            cells = (measured(rows, **group, **column) for column in columns.values())
            table.add_row(*map(str, group.values()), *cells)
    return table


def _short(value: float) -> str:
    """Three significant digits."""
    return f"{value:,.0f}" if value >= 100 else f"{value:#.3g}".rstrip(".")
