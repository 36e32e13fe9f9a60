"""Weights that were distilled beside those that they were distilled from, from measured JSON."""

from __future__ import annotations

from typing import Any

from ..errors import InvalidInputError
from .dial import FIGURES
from .wording import filled, goals_of

__all__ = ["SUFFIX", "distilled_section"]

SUFFIX = "-fast"
"""What the name of distilled weights has more than that of their teacher."""

_PLANNED = (
    "spearman", "error", "error_candidates", "at_1", "at_-1", "beyond_archive", "drawn_inside",
    "spread", "turning",
)  # fmt: skip
"""Figures that are shown, of `FIGURES`."""

_EXECUTED = ("spearman", "error", "success")

_HEADS = {"drawn_inside": "share of curves that are drawn inside the workspace"}
"""What those are called here whose text needs the row above it."""

Documents = dict[str, dict[str, dict[str, Any]]]


def distilled_section(found: Documents) -> str:
    """The dial, planned and executed, of each pair that `found` has, in Markdown.

    Args:
        found: by the weights' name and kind, `dial` and, if it was measured, `closed-loop`, the
            JSON of `legibility evaluate dial`.

    Raises:
        InvalidInputError: a pair was measured on other scenes.
    """
    parts: list[str] = []
    for kind, names in (("dial", _PLANNED), ("closed-loop", _EXECUTED)):
        pairs = [
            (name, found[name][kind])
            for fast in sorted(name for name in found if name.endswith(SUFFIX))
            if kind in found[fast] and kind in found.get(fast.removesuffix(SUFFIX), {})
            for name in (fast.removesuffix(SUFFIX), fast)
        ]
        for (_, one), (name, two) in zip(pairs[::2], pairs[1::2], strict=True):
            if any(_scenes(one)[key] != _scenes(two)[key] for key in _scenes(one)):
                raise InvalidInputError(f"{kind}-{name}.json is of other scenes than its teacher's")
        if pairs:
            parts += [_text(kind, [document for _, document in pairs]), _table(pairs, names)]
    return "\n\n".join(parts)


def _scenes(document: dict[str, Any]) -> dict[str, Any]:
    names = ("scenes", "goals", "levels", "samples")
    return {"seed": document["seed"], **{n: document["config"].get(n) for n in names}}


def _text(kind: str, documents: list[dict[str, Any]]) -> str:
    scenes = " and ".join(
        f"{len(d['result']['scenes'])} with {goals_of(d['config'])}" for d in documents[::2]
    )
    what = "Planned, one path a sample" if kind == "dial" else "The same, executed by stage 2"
    return filled(f"""\
{what}, on scenes that training never drew ({scenes}; seed {documents[0]["seed"]}): means over
scenes with 95 % intervals. All of it, and the commands, are in the model cards.""")


def _table(pairs: list[tuple[str, dict[str, Any]]], names: tuple[str, ...]) -> str:
    names = tuple(n for n in names if all(n in d["result"]["overall"] for _, d in pairs))
    head = ["weights", *(_HEADS.get(name, FIGURES[name].text) for name in names)]
    lines = [head, ["---"] * len(head)]
    for weights, document in pairs:
        overall = document["result"]["overall"]
        cells = [weights]
        for name in names:
            low, high = overall[name]["interval"]
            cells.append(f"{overall[name]['mean']:.4f} ({low:.4f} to {high:.4f})")
        lines.append(cells)
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)
