"""The measurements of speed and memory, as text and a table."""

from __future__ import annotations

from typing import Any

from .table import Part, Table, three_digits

_CONDITIONS = ("batch", "goals", "dim", "precision")


def bench_section(document: dict[str, Any]) -> list[Part]:
    """The measurements of `legibility bench`, one a row."""
    config, result = document["config"], document["result"]
    machine = result["machine"]
    load = "" if machine["load"] is None else f", load {machine['load']:.1f}"
    table = Table(
        "metric", "model", "backend", "conditions", "median", "95 % interval", left=range(4)
    )
    for row in result["measurements"]:
        conditions = ", ".join(f"{name} {row[name]}" for name in _CONDITIONS if name in row)
        median, low, high = (three_digits(row[name]) for name in ("median", "low", "high"))
        labels = row.get("model", ""), row.get("backend", ""), conditions
        table.add_row(row["metric"], *labels, median, f"{low} to {high}")
    return [
        f"{machine['cpu']}, {machine['cores']} cores, {threads_of(machine)}, PyTorch "
        f"{machine['torch']}{load}; training on {machine['device']}. {config['rounds']} "
        f"interleaved rounds of {config['seconds']:g} s or one call; rollouts of "
        f"{config['robots']} 2-D robots or {config['arms']} arms at once. A plan goes from a scene "
        "to checked paths; loading includes PyTorch.",
        *(f"Skipped: {reason}." for reason in result["skipped"]),
        table,
    ]


def threads_of(facts: dict[str, Any]) -> str:
    """The number of threads of a measurement."""
    return f"{facts['threads']} thread{'s' * (facts['threads'] > 1)}"
