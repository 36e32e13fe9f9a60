"""Tables and model cards, rendered from the JSON that the evaluations wrote."""

from __future__ import annotations

from typing import Any

from ..dataset import NUM_WAYPOINTS
from ..errors import InvalidInputError
from .dial import FIGURES

__all__ = ["dial_table", "render_card", "replace_table"]

_ORDER = (
    "spearman", "error", "error_candidates", "at_1", "at_0", "at_-1", "length_ratio_at_0",
    "inside", "beyond_archive", "wrong_order", "spread",
)  # fmt: skip
_LOWER_IS_BETTER = {
    "error",
    "error_candidates",
    "length_ratio_at_0",
    "wrong_order",
    "spread",
    "at_-1",
}


def dial_table(document: dict[str, Any]) -> str:
    """The dial's figures as a Markdown table, from the JSON of `legibility evaluate dial`."""
    overall = document["result"]["overall"]
    rows = [
        "| figure | mean over scenes | 95 % interval | worst scene |",
        "| --- | --- | --- | --- |",
    ]
    for name in _ORDER:
        if name not in overall:
            continue
        figure = overall[name]
        low, high = figure["interval"]
        worst = figure["max" if name in _LOWER_IS_BETTER else "min"]
        text = FIGURES[name].split(";")[0]
        rows.append(f"| {text} | {figure['mean']:.4f} | {low:.4f} to {high:.4f} | {worst:.4f} |")
    return "\n".join(rows)


def replace_table(text: str, name: str, table: str) -> str:
    """`text` with what stands between `<!-- NAME -->` and `<!-- /NAME -->` replaced."""
    begin, end = f"<!-- {name} -->", f"<!-- /{name} -->"
    head, found, rest = text.partition(begin)
    _, closed, tail = rest.partition(end)
    if not (found and closed):
        raise InvalidInputError(f"there is no part between {begin} and {end}")
    return f"{head}{begin}\n{table}\n{end}{tail}"


def render_card(name: str, config: dict[str, Any], document: dict[str, Any]) -> str:
    """The model card of weights, from `config.json` and the JSON of `legibility evaluate dial`.

    Raises:
        InvalidInputError: the measurement is of other weights, or how they were made is not known.
    """
    if not config.get("training"):
        raise InvalidInputError(f"the configuration of {name} does not say how it was trained")
    path, training = config["path"], config["training"]
    data = training["data"]
    minutes = training["seconds"] / 60
    return f"""---
license: mit
library_name: legibility
tags: [robotics, human-robot-interaction, legibility, diffusion]
---

# {name}

Stage 1 of the Legibility Modulator, the intent-aware path diffuser, for {path["dim"]}-D block
reaching: from start, goals and ℓ in [−1, 1] to {NUM_WAYPOINTS} waypoints. Use it with
`legibility.Modulator.from_pretrained("{name}")`.

## Data

{data["scenes"]:,} random scenes with {data["goals"][0]} to {data["goals"][1]} goals (stream
`{data["stream"]}`, seed {data["seed"]}), {data["per_scene"]} trajectories a scene chosen flat along
ℓ from its quality-diversity archive; labels `{path["label"]}`, σ = {path["sigma"]} m,
α = {path["alpha"]}. SHA-256 over the shards: `{training["digest"]}`.

## Training

{training["parameters"]:,} parameters; {training["training"]["steps"]:,} steps of
{training["training"]["scenes"]} scenes × {training["training"]["per_scene"]} trajectories, seed
{training["training"]["seed"]}, in {minutes:.0f} minutes on {training["device"]}
({training["threads"]} threads, PyTorch {training["torch"]}). Made by `make weights`.

## How exact the dial is

On {len(document["result"]["scenes"])} scenes that training never drew (stream `evaluation`, seed
{document["seed"]}), {len(document["result"]["levels"])} levels of ℓ ×
{document["config"]["samples"]} paths. One path is drawn for each sample; only the row that names
candidates takes the nearest of {document["config"]["candidates"]}. One plan on one core took
{document["result"]["plan_ms"]:.1f} ms.

{dial_table(document)}

Made by `{document["command"]}`.

## Limits

The observer is a model (a Gaussian around each goal), not a person. Scenes are the unit square with
a margin of 0.1 m for start and goals; obstacles are not known. Labels are ranks within a scene's
archive: the same ℓ is a different score in another scene.
"""
