"""The exactness of the dial, and of its ablations, as text and tables."""

from __future__ import annotations

from typing import Any

from ..evaluation.ablations import COLUMNS
from ..evaluation.dial import METRICS, worst
from .table import Part, Table, number
from .wording import WORLDS, scenes_of

__all__ = ["ablations_section", "dial_section"]


def dial_section(document: dict[str, Any]) -> list[Part]:
    """The metrics of `legibility evaluate dial`, of planned paths or of executed motions."""
    config, result = document["config"], document["result"]
    if config["closed_loop"]:
        how = (
            f"Stage 2 executes every path in {WORLDS[result['env']]}, and the executed motion is "
            "scored. A motion ends within 2 cm of its target, so it may be a little shorter than "
            "its path."
        )
    else:
        how = (
            "Each sample is a single path; only the row “with candidates” takes the nearest of "
            f"{config['candidates']}. One plan took {result['plan_ms']:.1f} ms on one core."
        )
    table = Table("metric", "mean over scenes", "95 % interval", "worst scene")
    for name, metric in METRICS.items():
        if name in result["overall"]:
            values = result["overall"][name]
            low, high = values["interval"]
            extreme = worst(name, values)
            table.add_row(
                metric.text, number(values["mean"], 4), f"{number(low, 4)} to {number(high, 4)}",
                "" if extreme is None else number(extreme, 4),
            )  # fmt: skip
    return [
        f"{scenes_of(document)}, {config['levels']} levels of ℓ, {config['samples']} samples of "
        f"each. {how}",
        table,
    ]


def ablations_section(document: dict[str, Any]) -> list[Part]:
    """The dial under other samplers, and of small runs that lack a part."""
    config = document["config"]
    table = Table("change", *COLUMNS.values(), "one plan [ms]")
    for row in document["result"]["rows"].values():
        means = (number(row["overall"][name]["mean"], 4) for name in COLUMNS)
        table.add_row(row["text"], *means, number(row["plan_ms"], 1))
    return [
        f"Means over {scenes_of(document)}, {config['levels']} levels of ℓ, {config['samples']} "
        "samples of each. The first rows are the shipped weights under other settings of the "
        f"sampler. Small runs have the same network but only {config['training_steps']:,} training "
        f"steps, on {config['training_scenes']:,} scenes unless the row names another number; "
        "compare them with the first small run. Without the field and on rank labels, a path on "
        "the wrong side of the straight line is not redrawn; on rank labels ℓ = 0 is not the "
        "straight line. Lengths are relative to the straight line; plans are timed on one core.",
        table,
    ]
