"""Table I, the comparison on held-out scenes and the spectrum, as text and tables."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

from ..evaluation.comparison import BASELINE, CANDIDATES, METHODS, METRICS, OURS, TESTED
from ..evaluation.table1 import TARGETS, paper_rows
from .table import Bold, Cell, Column, Part, Table, number
from .wording import WORLDS, percent, scenes_of

__all__ = ["spectrum_section", "table1_section", "unseen_section"]

_PAPER = {
    "diffusion policy": "Diffusion Policy",
    "legibility diffuser": "Legibility Diffuser",
    "modulator": "Legibility Modulator",
    "modulator, candidates": "Legibility Modulator",
    "oracle": "Dataset Oracle",
}
"""The paper's row of a method."""
_ARROWS: dict[str, str] = dict(zip(TESTED, "↑↓", strict=True))
_SIGNIFICANT = 0.05
_PLACES = {
    2: "The scene is read off the paper's figure, L_d is in its simulator's frame.",
    3: "The scene is ours (`examples/panda.yaml`), as the paper publishes no coordinates, so L_d "
    "too is comparable only as a ratio.",
}


def table1_section(document: dict[str, Any]) -> list[Part]:
    """Table I beside the paper's, the other metrics, and the tests."""
    config, result = document["config"], document["result"]
    dim = len(result["scene"]["start"])
    return [
        f"{config['rollouts']} rollouts of each method toward either target in "
        f"{WORLDS[result['env']]}, ℓ = 1 (seed {document['seed']}). {_PLACES[dim]} Brackets hold "
        "the ratio to the oracle, ours to our oracle and the paper's to the paper's: its L_p is of "
        "another field, so only ratios of L_p are comparable. Means are over all rollouts, arrived "
        "or not; success is that of the worse target. All methods share robots and seeds. Bold is "
        f"significantly better than Diffusion Policy (p < {_SIGNIFICANT} after Holm's correction "
        f"over the {len(result['tests'])} tests of the table), as in the paper.",
        _table1(result, paper_rows(dim)),
        "Means over both targets. The time to confidence is the share of the motion after which "
        "P(g*) ≥ 0.8 for good; never counts as 1. The plan is the time before the robot can move, "
        "on one core; the whole motion adds all action chunks, but not the simulation. The "
        f"searches drew {result['search'][0]:,} and {result['search'][1]:,} curves.",
        _other_metrics(result),
        *_tests(result, [f"{letter} {metric}" for letter in TARGETS for metric in TESTED]),
    ]


def _table1(result: dict[str, Any], paper: dict[str, dict[str, float | None]]) -> Table:
    cells = [(letter, metric) for letter in TARGETS for metric in TESTED]
    table = Table(
        "method", "success",
        *(
            Column(name, group=f"target {letter}")
            for letter, metric in cells
            for name in (f"{METRICS[metric].text} {_ARROWS[metric]}", "paper")
        ),
    )  # fmt: skip
    for name, method in result["methods"].items():
        row: list[Cell] = []
        for letter, metric in cells:
            mean = method["targets"][letter][metric]["mean"]
            text = f"{_short(mean)} ({mean / result['oracle'][letter][metric]:.2f})"
            better = _better(result, f"{letter} {metric}", name)
            row += [Bold(text) if better else text, _paper(paper, name, letter, metric)]
        success = min(t["success"]["mean"] for t in method["targets"].values())
        table.add_row(METHODS[name].text, _floor(success), *row)
    table.add_section()
    row = []
    for letter, metric in cells:
        value = result["oracle"][letter][metric]
        row += [f"{_short(value)} (1.00)", _paper(paper, "oracle", letter, metric)]
    table.add_row("Dataset Oracle, the curve itself", "–", *row)
    return table


def _other_metrics(result: dict[str, Any]) -> Table:
    others = [m for m in METRICS if m not in TESTED]
    table = Table("method", *(METRICS[m].text for m in others), "plan [ms]", "whole motion [ms]")
    for name, method in result["methods"].items():
        targets, times = method["targets"].values(), method["milliseconds"]
        table.add_row(
            METHODS[name].text,
            *(number(sum(t[m]["mean"] for t in targets) / len(targets)) for m in others),
            *(number(times[span], 1) if times else "–" for span in ("plan", "motion")),
        )
    return table


def unseen_section(document: dict[str, Any]) -> list[Part]:
    """The methods on held-out scenes, relative to the oracle, and the tests."""
    config, result = document["config"], document["result"]
    table = Table(
        "method", "success", *(f"{METRICS[m].text} {_ARROWS[m]} over oracle" for m in TESTED),
        "length over straight", "achieved ℓ, asked 1", "Spearman of ℓ", "error of ℓ",
    )  # fmt: skip
    for name, method in result["methods"].items():
        ratios: list[Cell] = []
        for metric in TESTED:
            ratio = method["ratio"][metric]
            low, high = ratio["interval"]
            text = f"{ratio['median']:.3f} ({low:.3f} to {high:.3f})"
            ratios.append(Bold(text) if _better(result, metric, name) else text)
        table.add_row(
            METHODS[name].text,
            percent(method["success"]["mean"]),
            *ratios,
            *(number(method[key]["mean"]) for key in ("length_ratio", "achieved")),
            *(
                number(method[key]["mean"], 4) if key in method else "–"
                for key in ("spearman", "error")
            ),
        )
    return [
        f"{scenes_of(document)}, in {WORLDS[result['env']]}. L_d and L_p are of "
        f"{config['rollouts']} motions a scene with ℓ = 1: medians over scenes of the ratio to the "
        "most legible trajectory of the scene's archive, itself not executed, with 95 % intervals; "
        f"an L_p below {result['least']['potential_cost']:g} counts as that much. Length and "
        "achieved ℓ are means over scenes, arrived or not. Spearman's correlation and the error "
        f"are of {config['levels']} more executed motions a scene, one of each level, for methods "
        "that take an ℓ; their success counts too. Between the ends the best of "
        f"{CANDIDATES} is chosen by labels of an archive of the scene (as is the oracle's), which "
        "takes longer than drawing the paths; the searches know only the labels of their own "
        "curves. Bold is as in Table I, paired by scene.",
        table,
        *_tests(result, list(TESTED)),
    ]


def spectrum_section(document: dict[str, Any]) -> list[Part]:
    """The cost of executed motions over the whole dial (paper, figure 3)."""
    config, result = document["config"], document["result"]
    table = Table(
        "asked ℓ",
        *(
            Column(name, group=f"target {letter}")
            for letter in result["targets"]
            for name in ("L_p", "achieved ℓ")
        ),
    )
    for index, level in enumerate(result["levels"]):
        cells = []
        for values in result["targets"].values():
            cells += [_short(values["mean"][index]), number(values["achieved"][index])]
        table.add_row(number(level, 2), *cells)
    trends = []
    for letter, values in result["targets"].items():
        means = values["mean"]
        trend = "falls at every level"
        if values["rising"]:
            most = max(after / before - 1 for before, after in pairwise(means))
            trend = f"rises at {values['rising']} of {len(means) - 1} levels, by at most {most:.2%}"
        trends.append(
            f"toward {letter} it {trend}, from {_short(means[0])} to {_short(means[-1])}, with "
            f"{_floor(values['success'])} success"
        )
    return [
        f"{config['rollouts']} motions at each of {config['levels']} levels of ℓ toward either "
        f"target of Table I, executed in {WORLDS[result['env']]} (seed {document['seed']}). The "
        f"mean of the paper's L_p: {'; '.join(trends)}. The picture's bands are 95 % intervals.",
        table,
    ]


def _tests(result: dict[str, Any], cells: list[str]) -> list[Part]:
    """The modulator's rows against all other methods: effect and adjusted p in each cell."""
    table = Table("ours", "against", *map(_cell_name, cells), text_columns=2)
    tests = {(t["cell"], t["method"], t["against"]): t for t in result["tests"]}
    for ours in OURS:
        row = "one path" if ours == OURS[0] else f"best of {CANDIDATES}"
        for name in METHODS:
            if name not in OURS:
                verdicts = (_verdict(tests[cell, ours, name]) for cell in cells)
                table.add_row(row, METHODS[name].text, *verdicts)
    return [
        "Paired two-sided Wilcoxon tests, with the rank-biserial correlation as the effect (1: "
        "better in every pair, −1: worse) and p after Holm's correction:",
        table,
    ]


def _verdict(test: dict[str, Any]) -> Cell:
    p = test["p_holm"]
    worse = p < _SIGNIFICANT and test["effect"] <= 0
    word = "worse" if worse else "better" if p < _SIGNIFICANT else "not shown"
    shown = "p < 0.001" if p < 0.001 else f"p = {p:.3f}"
    text = f"{word}, {test['effect']:+.2f}, {shown}".replace("-", "−")
    return Bold(text) if worse else text


def _cell_name(cell: str) -> str:
    *letter, metric = cell.split()
    return ": ".join([*letter, METRICS[metric].text])


def _better(result: dict[str, Any], cell: str, method: str) -> bool:
    """Whether a method is significantly better than the baseline in a cell."""
    return any(
        t["p_holm"] < _SIGNIFICANT and t["effect"] > 0
        for t in result["tests"]
        if (t["cell"], t["method"], t["against"]) == (cell, method, BASELINE)
    )


def _paper(paper: dict[str, dict[str, float | None]], name: str, letter: str, metric: str) -> str:
    if name not in _PAPER:
        return "–"
    key = f"{METRICS[metric].text}_{letter}"
    value, best = paper[_PAPER[name]][key], paper["Dataset Oracle"][key]
    assert value
    assert best
    return f"{value:g} ({value / best:.2f})"


def _floor(share: float) -> str:
    """Percent, to a tenth and never rounded up to all."""
    return f"{math.floor(1000 * share + 1e-9) / 10:.1f}%"


def _short(value: float) -> str:
    """Three significant digits."""
    return f"{value:.2e}" if 0 < abs(value) < 0.01 else f"{value:#.3g}".rstrip(".")
