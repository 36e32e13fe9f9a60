"""Table I and the comparison on scenes never seen, rendered from their JSON."""

from __future__ import annotations

import csv
import io
import math
from itertools import pairwise
from typing import Any

from ..evaluation.comparison import BASELINE, CANDIDATES, METHODS, METRICS, OURS, TESTED
from ..evaluation.table1 import TARGETS, paper_rows
from .wording import WORLDS, filled, goals_of

__all__ = [
    "spectrum_section",
    "table1_csv",
    "table1_latex",
    "table1_section",
    "unseen_section",
]

_PAPER = {
    "diffusion policy": "Diffusion Policy",
    "legibility diffuser": "Legibility Diffuser",
    "modulator": "Legibility Modulator",
    "modulator, candidates": "Legibility Modulator",
    "oracle": "Dataset Oracle",
}
"""The paper's row of a method."""
_COLUMNS = {"distance_score": "L_d", "potential_cost": "L_p"}
_SIGNIFICANT = 0.05


def table1_section(document: dict[str, Any]) -> str:
    """Table I beside the paper's, the other figures, and the tests, in Markdown."""
    config, result = document["config"], document["result"]
    dim = len(result["scene"]["start"])
    paper = paper_rows(dim)
    head = ["method", "success"]
    for letter in TARGETS:
        for metric, arrow in zip(TESTED, "↑↓", strict=True):
            head += [f"{letter}: {_COLUMNS[metric]} {arrow} (over oracle)", "paper"]
    rows = [_cells(head), _cells(["---"] * len(head))]
    for name in METHODS:
        method = result["methods"][name]
        success = min(t["success"]["mean"] for t in method["targets"].values())
        line = [METHODS[name].text, _share(success)]
        for letter in TARGETS:
            for metric in TESTED:
                mean, ratio = _figure(result, name, letter, metric)
                bold = "**" * _better(result, f"{letter} {metric}", name, BASELINE)
                line += [f"{bold}{mean}{bold} ({ratio:.2f})", _paper(paper, name, letter, metric)]
        rows.append(_cells(line))
    line = ["Dataset Oracle, the curve itself", "–"]
    for letter in TARGETS:
        for metric in TESTED:
            value = result["oracle"][letter][metric]
            line += [f"{_short(value)} (1.00)", _paper(paper, "oracle", letter, metric)]
    rows.append(_cells(line))
    others = [m for m in METRICS if m not in TESTED]
    more = [
        _cells(["method", *(METRICS[m].text for m in others), "plan [ms]", "whole motion [ms]"]),
        _cells(["---"] * (len(others) + 3)),
    ]
    for name in METHODS:
        method = result["methods"][name]
        times = method["milliseconds"]
        means = [
            sum(t[m]["mean"] for t in method["targets"].values()) / len(TARGETS) for m in others
        ]
        shown = [f"{times[what]:.1f}" if times else "–" for what in ("plan", "motion")]
        more.append(_cells([METHODS[name].text, *(f"{m:.3f}" for m in means), *shown]))
    intro = filled(f"""\
{config["rollouts"]} rollouts a method toward either target in {WORLDS[result["env"]]}, ℓ = 1
(seed {document["seed"]}). {_HOW[dim]} In brackets, ours over our oracle and the paper's over the
paper's: its L_p is of another field, so only the ratios of L_p can be compared. Means are over all
rollouts, arrived or not; success is that of the worse target. All methods have the same robots and
seeds of their plans. Bold is significantly better than Diffusion Policy (p < {_SIGNIFICANT} after
Holm's correction over the {len(result["tests"])} tests of the table), as in the paper.""")
    meaning = filled(f"""\
Means over both targets. The time to confidence is the share of the motion after which
P(g*) ≥ 0.8 for good; never counts as 1. A plan is what happens before the robot can move, on one
core; the whole motion adds all chunks of actions, but not the simulation. The searches drew
{result["search"][0]:,} and {result["search"][1]:,} curves.""")
    return f"""\
{intro}

{chr(10).join(rows)}

{meaning}

{chr(10).join(more)}

{_tests(result, [f"{letter} {metric}" for letter in TARGETS for metric in TESTED])}

Measured by `{document["command"]}`."""


_HOW = {
    2: "The scene is the paper's as read off its figure, L_d in its simulator's frame.",
    3: "The scene is ours (`examples/panda.yaml`), as the paper publishes no coordinates, so its "
    "L_d too can only be compared as ratios.",
}


def unseen_section(document: dict[str, Any]) -> str:
    """The methods on random scenes as ratios to the oracle, in Markdown."""
    config, result = document["config"], document["result"]
    head = [
        "method", "success", "L_d ↑ over oracle", "L_p ↓ over oracle", "length over straight",
        "achieved ℓ, asked 1", "Spearman of ℓ", "error of ℓ",
    ]  # fmt: skip
    rows = [_cells(head), _cells(["---"] * len(head))]
    for name in METHODS:
        method = result["methods"][name]
        line = [METHODS[name].text, f"{method['success']['mean']:.2%}"]
        for metric in TESTED:
            ratio = method["ratio"][metric]
            low, high = ratio["interval"]
            bold = "**" * _better(result, metric, name, BASELINE)
            line.append(f"{bold}{ratio['median']:.3f}{bold} ({low:.3f} to {high:.3f})")
        line += [f"{method['length_ratio']['mean']:.3f}", f"{method['achieved']['mean']:.3f}"]
        line += [
            f"{method[key]['mean']:.4f}" if key in method else "–" for key in ("spearman", "error")
        ]
        rows.append(_cells(line))
    intro = filled(f"""\
{config["scenes"]} random scenes with {goals_of(config)} that training never drew
(seed {document["seed"]}), in {WORLDS[result["env"]]}. L_d and L_p are of {config["rollouts"]}
motions a scene with ℓ = 1: medians over scenes of the ratio to the most legible trajectory of the
scene's archive, itself not executed, with 95 % intervals; an L_p below
{result["least"]["potential_cost"]:g} counts as that much. Length and achieved ℓ are means over
scenes, arrived or not. Spearman's correlation and the error are of {config["levels"]} more executed
motions a scene, one of each level, for methods that take an ℓ; their success counts too. Between
the ends the best of {CANDIDATES} is chosen by labels of an archive of the scene (as is the
oracle's), which takes longer than drawing the paths; the searches know the labels of their own
curves alone. Bold as above, paired by scene.""")
    return f"""\
{intro}

{chr(10).join(rows)}

{_tests(result, list(TESTED))}

Measured by `{document["command"]}`."""


def spectrum_section(document: dict[str, Any]) -> str:
    """What the spectrum's figure shows, in Markdown."""
    config, result = document["config"], document["result"]
    parts = []
    for letter, own in result["targets"].items():
        means = own["mean"]
        falls = "falls at every level"
        if own["rising"]:
            most = max(after / before - 1 for before, after in pairwise(means))
            falls = f"rises at {own['rising']} of {len(means) - 1} levels, by at most {most:.2%}"
        parts.append(
            f"toward {letter} it {falls}, from {_short(means[0])} to {_short(means[-1])}, with "
            f"{_share(own['success'])} success"
        )
    text = filled(f"""\
{config["rollouts"]} motions at each of {config["levels"]} levels of ℓ toward either target,
executed in {WORLDS[result["env"]]} (seed {document["seed"]}). The mean of the paper's L_p:
{"; ".join(parts)}. Bands are 95 % intervals.""")
    return f"{text}\n\nMeasured by `{document['command']}`."


def table1_latex(document: dict[str, Any]) -> str:
    """Table I as a `tabular` for booktabs in the paper's layout, its figures beside ours."""
    result = document["result"]
    dim = len(result["scene"]["start"])
    paper = paper_rows(dim)
    lines = [
        f"% made by `legibility report` from: {document['command']}",
        r"\begin{tabular}{l c *{8}{c}}",
        r"\toprule",
        r"& \textbf{SR} & \multicolumn{4}{c}{\textbf{Target R}} "
        r"& \multicolumn{4}{c}{\textbf{Target G}} \\",
        r"\cmidrule(lr){3-6}\cmidrule(lr){7-10}",
        rf"\textbf{{Method ({dim}D)}} & "
        + r"& \(L_d \uparrow\) & paper & \(L_p \downarrow\) & paper " * 2
        + r"\\",
        r"\midrule",
    ]
    for name in METHODS:
        if name == "oracle":
            lines.append(r"\midrule")
        method = result["methods"][name]
        success = min(t["success"]["mean"] for t in method["targets"].values())
        line = [METHODS[name].text, _share(success).replace("%", r"\%")]
        for letter in TARGETS:
            for metric in TESTED:
                mean, ratio = _figure(result, name, letter, metric)
                if _better(result, f"{letter} {metric}", name, BASELINE):
                    mean = rf"\textbf{{{mean}}}"
                line += [f"{mean} ({ratio:.2f})", _paper(paper, name, letter, metric)]
        lines.append(" & ".join(line).replace("–", "--") + r" \\")
    lines += [r"\bottomrule", r"\end{tabular}", ""]
    return "\n".join(lines)


def table1_csv(document: dict[str, Any]) -> str:
    """Table I as CSV, a row a method, target and metric, the paper's figure beside ours."""
    result = document["result"]
    dim = len(result["scene"]["start"])
    paper = paper_rows(dim)
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([
        "environment", "method", "target", "metric", "success", "mean", "low", "high",
        "over_oracle", "paper", "paper_over_oracle",
    ])  # fmt: skip
    for name in METHODS:
        for letter, own in result["methods"][name]["targets"].items():
            for metric in METRICS:
                value, ratio = own[metric]["mean"], ""
                theirs = theirs_ratio = ""
                if metric in TESTED:
                    ratio = f"{value / result['oracle'][letter][metric]:.6g}"
                    if name in _PAPER:
                        key = f"{_COLUMNS[metric]}_{letter}"
                        figure, best = paper[_PAPER[name]][key], paper["Dataset Oracle"][key]
                        theirs, theirs_ratio = f"{figure:g}", f"{figure / best:.4g}"  # pyright: ignore
                writer.writerow([
                    result["env"], name, letter, metric, own["success"]["mean"], f"{value:.6g}",
                    *(f"{x:.6g}" for x in own[metric]["interval"]), ratio, theirs, theirs_ratio,
                ])  # fmt: skip
    return text.getvalue()


def _tests(result: dict[str, Any], cells: list[str]) -> str:
    """The modulator's rows against all others: effect and adjusted p in each cell."""
    head = ["ours", "against", *(_cell_name(cell) for cell in cells)]
    rows = [_cells(head), _cells(["---"] * len(head))]
    found = {(t["cell"], t["method"], t["against"]): t for t in result["tests"]}
    for ours in OURS:
        for name in METHODS:
            if name in OURS:
                continue
            tests = [found[cell, ours, name] for cell in cells]
            own = "one path" if ours == OURS[0] else f"best of {CANDIDATES}"
            rows.append(_cells([own, METHODS[name].text, *map(_verdict, tests)]))
    text = filled("""\
Paired two-sided Wilcoxon tests, with the rank-biserial correlation as the effect (1: better in
every pair, −1: worse) and p after Holm's correction:""")
    return text + "\n\n" + "\n".join(rows)


def _verdict(test: dict[str, Any]) -> str:
    p = test["p_holm"]
    word = "not shown"
    if p < _SIGNIFICANT:
        word = "better" if test["effect"] > 0 else "**worse**"
    shown = "p < 0.001" if p < 0.001 else f"p = {p:.3f}"
    return f"{word}, {test['effect']:+.2f}, {shown}".replace("-", "−")


def _cell_name(cell: str) -> str:
    *letter, metric = cell.split()
    return ": ".join([*letter, _COLUMNS[metric]])


def _better(result: dict[str, Any], cell: str, method: str, against: str) -> bool:
    """Whether a method is significantly better in a cell."""
    return any(
        t["p_holm"] < _SIGNIFICANT and t["effect"] > 0
        for t in result["tests"]
        if (t["cell"], t["method"], t["against"]) == (cell, method, against)
    )


def _figure(result: dict[str, Any], name: str, letter: str, metric: str) -> tuple[str, float]:
    mean = result["methods"][name]["targets"][letter][metric]["mean"]
    return _short(mean), mean / result["oracle"][letter][metric]


def _paper(paper: dict[str, dict[str, float | None]], name: str, letter: str, metric: str) -> str:
    if name not in _PAPER:
        return "–"
    key = f"{_COLUMNS[metric]}_{letter}"
    value, best = paper[_PAPER[name]][key], paper["Dataset Oracle"][key]
    assert value
    assert best
    return f"{value:g} ({value / best:.2f})"


def _share(share: float) -> str:
    """Percent, to a tenth and never rounded up to all."""
    return f"{math.floor(1000 * share + 1e-9) / 10:.1f}%"


def _short(value: float) -> str:
    """Three significant digits."""
    return f"{value:.2e}" if 0 < abs(value) < 0.01 else f"{value:#.3g}".rstrip(".")


def _cells(texts: list[str]) -> str:
    return f"| {' | '.join(texts)} |"
