"""Model cards of the baselines, rendered from the JSON of the comparisons."""

from __future__ import annotations

from typing import Any

from ..errors import InvalidInputError
from ..evaluation.comparison import METHODS
from .card import demonstrated, trained
from .wording import WORLDS, filled

__all__ = ["render_baseline_card"]


def render_baseline_card(
    name: str, method: str, config: dict[str, Any], documents: dict[str, dict[str, Any]]
) -> str:
    """The model card of a baseline's weights, from `config.json` and the JSON of the comparisons.

    Args:
        name: of the weights.
        method: its name in the comparisons.
        config: the content of `config.json`.
        documents: by the stem of their file, `table1-…` and `unseen-…`, in which it takes part.

    Raises:
        InvalidInputError: it is not known how the weights were made, or a measurement is of others.
    """
    entry = config["goal"]
    training, shape = entry["training"], entry["config"]
    if not training:
        raise InvalidInputError(f"the configuration of {name} does not say how it was trained")
    for stem, document in documents.items():
        used = [b for b in document["baselines"] if b["name"] == name]
        if [b.get("goal") for b in used] != [entry["sha256"]]:
            raise InvalidInputError(
                f"the measurement {stem}.json is of other weights than those of {name}"
            )
    text = METHODS[method].text
    parts = [
        f"""\
---
license: mit
library_name: legibility
tags: [robotics, human-robot-interaction, legibility, diffusion, baseline]
---

# {name}

{text} for {shape["dim"]}-D block reaching, a baseline that the Legibility Modulator is compared
with: two states and a goal to a chunk of {shape["chunk"]} actions, of which {shape["execute"]} are
executed.

## Training
""",
        demonstrated(training, shape["dim"]),
        "",
        trained(training, "{batch:,} moments of demonstrations"),
    ]
    if "tuning" in training:
        parts += ["\n## Guidance\n", _tuned(shape, training["tuning"])]
    parts += ["\n## Measured\n"]
    for stem, document in documents.items():
        own, world = document["result"]["methods"][method], WORLDS[document["result"]["env"]]
        if stem.startswith("table1"):
            figures = [
                f"{key} toward {letter} {_over(document, method, letter, metric):.3f}"
                for letter in own["targets"]
                for metric, key in (("distance_score", "L_d"), ("potential_cost", "L_p"))
            ]
            success = min(t["success"]["mean"] for t in own["targets"].values())
            where = "Scene of Table I"
        else:
            figures = [
                f"{key} {own['ratio'][metric]['median']:.3f}"
                for metric, key in (("distance_score", "L_d"), ("potential_cost", "L_p"))
            ]
            success, where = own["success"]["mean"], "Scenes never seen (medians)"
        parts += [
            filled(
                f"{where}, in {world}: success {success:.2%}; over the oracle's, "
                f"{', '.join(figures)}. Measured by `{document['command']}`."
            ),
            "",
        ]
    parts += [
        "## Limits\n",
        filled("""\
It is trained on stage 2's demonstrations, of all ways to reach a goal in many random scenes, by
stage 2's budget and with a network of its size, not on demonstrations of one scene as by its
authors; it does not reach the paper's figures."""),
        "",
    ]
    return "\n".join(parts)


def _over(document: dict[str, Any], method: str, letter: str, metric: str) -> float:
    result = document["result"]
    mean = result["methods"][method]["targets"][letter][metric]["mean"]
    return mean / result["oracle"][letter][metric]


def _tuned(shape: dict[str, Any], tuning: list[dict[str, float]]) -> str:
    """Which guidance was chosen, of which, by which rule."""
    chosen = {name: shape[name] for name in ("guidance", "guidance_decay", "guidance_share")}
    own = next((row for row in tuning if chosen.items() <= row.items()), None)
    if own is None:
        raise InvalidInputError(f"no combination that was tried is the chosen one, {chosen}")
    needed = min(0.99, max(row["success"] for row in tuning))
    most = max(tuning, key=lambda row: row["achieved"])
    return filled(f"""\
ε̂ = (1 + w) ε(g*) − a w ε(g⁻) − (1 − a) w ε(∅), w ← γ w after every executed chunk (Bronars, Cheng
and Xu 2024), with the mean over several g⁻. Of {len(tuning)} combinations tried on the validation
scenes, all recorded in `config.json`, the most legible one that reaches the goal in {needed:.0%} of
them was taken: w = {own["guidance"]:g}, γ = {own["guidance_decay"]:g},
a = {own["guidance_share"]:g}, which reached it in {own["success"]:.1%} with a mean achieved ℓ of
{own["achieved"]:.3f}. The most legible of all (w = {most["guidance"]:g},
γ = {most["guidance_decay"]:g}, a = {most["guidance_share"]:g}) has {most["achieved"]:.3f} and
reached it in {most["success"]:.1%}.""")
