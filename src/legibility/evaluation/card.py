"""Tables and model cards, rendered from the JSON that the evaluations wrote."""

from __future__ import annotations

from typing import Any

from ..curves import NUM_WAYPOINTS
from ..errors import InvalidInputError
from .dial import FIGURES, worst

__all__ = ["dial_section", "dial_table", "render_card", "replace_table"]


def dial_table(document: dict[str, Any]) -> str:
    """The dial's figures as a Markdown table, from the JSON of `legibility evaluate dial`."""
    overall = document["result"]["overall"]
    rows = [
        "| figure | mean over scenes | 95 % interval | worst scene |",
        "| --- | --- | --- | --- |",
    ]
    for name, figure in FIGURES.items():
        if name in overall:
            low, high = overall[name]["interval"]
            least = worst(name, overall[name])
            shown = "" if least is None else f"{least:.4f}"
            mean = overall[name]["mean"]
            rows.append(f"| {figure.text} | {mean:.4f} | {low:.4f} to {high:.4f} | {shown} |")
    return "\n".join(rows)


def dial_section(document: dict[str, Any]) -> str:
    """The table, what it was measured on and by which command, in Markdown."""
    config, result = document["config"], document["result"]
    return f"""\
On {len(result["scenes"])} random scenes with {config["goals"][0]} to {config["goals"][1]} goals
that training never drew (seed {document["seed"]}), {len(result["levels"])} levels of ℓ,
{config["samples"]} paths each. One path is drawn for a sample; only the row "with candidates" takes
the nearest of {config["candidates"]}. One plan took {result["plan_ms"]:.1f} ms on one core.

{dial_table(document)}

Measured by `{document["command"]}`."""


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
    if document["model"]["sha256"] != config["sha256"]:
        raise InvalidInputError(f"the measurement is of other weights than those of {name}")
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
({training["threads"]} threads, PyTorch {training["torch"]}).

## How exact the dial is

{dial_section(document)}

## Limits

The observer is a model (a Gaussian around each goal), not a person. It was trained on the
default workspace of {path["dim"]}-D scenes alone; obstacles are not known. Labels are ranks within
a scene's archive: the same ℓ is a different score in another scene.
"""
