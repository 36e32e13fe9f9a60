"""The tables of the bench, made from the JSON of `legibility bench`."""

from __future__ import annotations

from typing import Any

__all__ = ["bench_section", "bench_tables"]

BenchTable = tuple[str, list[str], list[list[str]], list[str]]
"""Title, head, rows and notes."""

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


def bench_tables(document: dict[str, Any]) -> list[BenchTable]:
    """Planning by batch and by goals, motion, data and training, and processes.

    Args:
        document: with the `config` and the `result` of `run_bench`.
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
    conditions = (
        f"{machine['cpu']}, {machine['cores']} cores, {machine['threads']} "
        f"thread{'s' * (machine['threads'] > 1)}, PyTorch {machine['torch']}{load}. Medians with "
        f"95 % intervals over {config['rounds']} interleaved rounds of {config['seconds']:g} s or "
        "one call. Planning goes from a scene of 4 goals to checked paths."
    )
    skipped = [f"Skipped: {reason}." for reason in result["skipped"]]
    moved = f"Rollouts of {config['robots']} 2-D robots or {config['arms']} arms at once."
    trained = f"Archives and dataset by one process; training of stage 1 on {machine['device']}."
    imported = _cell(rows, {"metric": "import_ms"})
    loaded = f"Loading includes PyTorch; before it, `import legibility` takes {imported} ms."
    model = ["model", "backend"]
    return [
        _table("Planning", rows, model, by_batch, [conditions, *skipped]),
        _table("Planning one path, by the number of goals", rows, model, by_goals, []),
        _table("Motion", rows, model, _MOTION, [moved]),
        _table("Data and training", rows, ["dim"], _MAKING, [trained]),
        _table("A fresh process", rows, model, _PROCESS, [loaded]),
    ]


def bench_section(document: dict[str, Any]) -> str:
    """The tables in Markdown."""
    parts = []
    for title, head, rows, notes in bench_tables(document):
        lines = [f"| {' | '.join(cells)} |" for cells in (head, ["---"] * len(head), *rows)]
        parts += [f"**{title}**", "\n".join(lines), *notes]
    return "\n\n".join([*parts, f"Measured by `{document['command']}`."])


def _table(
    title: str,
    measurements: list[dict[str, Any]],
    keys: list[str],
    columns: Columns,
    notes: list[str],
) -> BenchTable:
    """A row for each combination of `keys`, a column for the measurements that match its dict."""
    metrics = {column["metric"] for column in columns.values()}
    measured = [m for m in measurements if m["metric"] in metrics]
    groups = [{k: m[k] for k in keys} for m in measured]
    rows = [
        [*map(str, group.values()), *(_cell(measured, group | c) for c in columns.values())]
        for i, group in enumerate(groups)
        if group not in groups[:i]
    ]
    return title, [*keys, *columns], rows, notes


def _cell(measurements: list[dict[str, Any]], wanted: dict[str, Any]) -> str:
    """Median and interval of the measurement that matches `wanted`."""
    for m in measurements:
        if wanted.items() <= m.items():
            return f"{_short(m['median'])} ({_short(m['low'])} to {_short(m['high'])})"
    return "–"


def _short(value: float) -> str:
    """Three significant digits."""
    return f"{value:,.0f}" if value >= 100 else f"{value:#.3g}".rstrip(".")
