"""The comparisons of the methods as a few sentences and tables."""

from typing import Any

from ..evaluation import external
from ..evaluation.comparison import EXTERNAL, TARGETS, TESTED, paper_rows
from ..evaluation.comparison import METRICS as MOTION_METRICS
from ..evaluation.contest import BASELINE, CANDIDATES, METHODS, OURS
from ..evaluation.single_scene import ROWS as ROWS_OF_ONE_SCENE
from .dials import means, percent, scenes_of
from .table import Bold, Part, Table, number, three_digits

_BY_OTHERS = (
    "The same motions with ℓ = 1 by other people's definitions, means: the legibility that "
    "Dragan's observer sees (HRI 2013), β over the scene's size; the share of the motion after "
    "which that observer (β = 20) is confident; that legibility less a tenth of the length over "
    "the straight line's (RSS 2013); and detachment, L_d without a unit (Style-Conditioned "
    "Diffusion Policy, 2026). The dial is turned for the paper's observer."
)
_TEXTS = {name: method.text for name, method in METHODS.items()}
_ARROWS = dict(zip(TESTED, "↑↓", strict=True))
_SIGNIFICANT = 0.05


def _text(name: str) -> str:
    """A method in a table; one of the user's has its name."""
    return _TEXTS.get(name, name)


def external_section(document: dict[str, Any]) -> list[Part]:
    """Motions by other people's definitions, and the most legible within a bound."""
    methods = document["result"]["methods"]
    texts = external.METHODS | {external.YOURS: "your trajectories"}
    table = Table("method", *external.METRICS.values())
    heads = [f"length ≤ {c:g}" for c in external.LENGTHS]
    heads += [f"clear by {c:g}" for c in external.CLEARANCES]
    bounded = Table("method", *heads)
    for name, method in methods.items():
        table.add_row(texts[name], *means(method, external.METRICS, 3))
        cells = []
        for best in (*method["ceiling"], *method["clear"]):
            share = "" if best["share"] == 1 else f" ({best['share']:.0%})"
            found = best["legibility"]
            cells.append(number(found["mean"], 3) + share if found else "–")
        bounded.add_row(texts[name], *cells)
    levels = document["config"]["levels"]
    scene = "A given scene" if external.YOURS in methods else scenes_of(document)
    return [
        f"{scene}; planned motions with ℓ = 1 for Dragan's observer, means. The legibility that "
        "Dragan's observer sees (HRI 2013), β over the scene's size; the share of the motion after "
        "which that observer (β = 20) is confident; detachment (Style-Conditioned Diffusion "
        "Policy, 2026) and L_d over the scene's size; the length over the shortest motion's; the "
        "least clearance from obstacles, other goals and walls over the scene's size, but for the "
        "first and the last tenth; the share of motions that touch nothing.",
        table,
        f"The highest legibility (β = 20) of those of {levels} motions from ℓ = 0 to 1 that touch "
        "nothing and happen to stay below a ceiling on the length over the shortest (RSS 2013 "
        "bounds the cost), or to keep a clearance, over the scene's size; nobody planned for these "
        "bounds. Brackets hold the share of scenes in which there is such a motion, if not all; in "
        "the others the shortest motion counts, or none where that does not keep clear either.",
        bounded,
    ]


def table1_section(document: dict[str, Any]) -> list[Part]:
    """Table I, what of it can be compared with the paper's, the other metrics, and the tests."""
    config, result = document["config"], document["result"]
    cells = [(letter, metric) for letter in TARGETS for metric in TESTED]
    heads = [f"target {t}: {MOTION_METRICS[m]} {_ARROWS[m]}" for t, m in cells]
    table = Table("method", "success", *heads)
    others = [m for m in MOTION_METRICS if m not in TESTED]
    rest = Table("method", *(MOTION_METRICS[m] for m in others), "plan [ms]", "whole motion [ms]")
    others_table = Table("method", *EXTERNAL.values())
    oracle = result["oracle"]
    for name, method in result["methods"].items():
        targets, times = method["targets"], method["milliseconds"]
        success = min(entry["success"]["mean"] for entry in targets.values())
        row = [
            _bold_if_better(result, _over(targets[t][m]["mean"], oracle[t][m]), f"{t} {m}", name)
            for t, m in cells
        ]
        table.add_row(_text(name), percent(success), *row)
        rest.add_row(
            _text(name),
            *(number(sum(t[m]["mean"] for t in targets.values()) / len(targets)) for m in others),
            *(number(times[span], 1) if times else "–" for span in ("plan", "motion")),
        )
        cells_by_others = (sum(t[m]["mean"] for t in targets.values()) / 2 for m in EXTERNAL)
        others_table.add_row(_text(name), *map(number, cells_by_others))
    curve = [_over(oracle[t][m], oracle[t][m]) for t, m in cells]
    table.add_row(f"{METHODS['oracle'].paper}, the curve itself", "–", *curve)
    few, many = result["search"]
    return [
        f"{config['rollouts']} rollouts of each method toward either target in {result['env']}, "
        f"ℓ = 1 (seed {document['seed']}). Success is that of the worse target. The tests speak of "
        "robots and draws in this one scene; those over held-out scenes are the ones that count.",
        table,
        *_beside_paper(result),
        f"Means over both targets; the searches drew {few:,} and {many:,} curves.",
        rest,
        _BY_OTHERS,
        others_table,
        _tests(result, [" ".join(cell) for cell in cells]),
    ]


def single_scene_section(document: dict[str, Any]) -> list[Part]:
    """Table I of methods that learned in its scene alone, over the best demonstrations."""
    config, result = document["config"], document["result"]
    cells = [(letter, metric) for letter in TARGETS for metric in TESTED]
    heads = [f"target {t}: {MOTION_METRICS[m]} {_ARROWS[m]}" for t, m in cells]
    table, best = Table("method", "success", *heads), result["demonstrated"]
    for name, method in result["methods"].items():
        targets = method["targets"]
        success = min(entry["success"]["mean"] for entry in targets.values())
        row = [
            _bold_if_better(result, _over(targets[t][m]["mean"], best[t][m]), f"{t} {m}", name)
            for t, m in cells
        ]
        table.add_row(ROWS_OF_ONE_SCENE[name], percent(success), *row)
    curves = (_over(best[t][m], best[t][m]) for t, m in cells)
    table.add_row("the best demonstrated path", "–", *curves)
    chosen = Table("method", "target", "chosen", "tried", left=range(3))
    for letter, methods in result["tuning"].items():
        for name, tuned in methods.items():
            values = (f"{key.replace('_', ' ')} {v:g}" for key, v in tuned["chosen"].items())
            chosen.add_row(
                ROWS_OF_ONE_SCENE[name], letter, ", ".join(values), str(len(tuned["tried"]))
            )
    return [
        "As in the paper all networks learn in the table's scene alone: from "
        f"{config['demonstrations']} demonstrations toward either target, flat along ℓ, in "
        f"{config['training_steps']:,} steps with batches of {config['batch']} (seed "
        f"{document['seed']}). Each network is trained once, but that of Legibility Diffuser is "
        f"the best of {config['networks']}. {config['rollouts']} rollouts toward either target in "
        f"{result['env']}, ℓ = 1; success is that of the worse target, and L_d and L_p are of all "
        "motions, also of those that do not arrive. Brackets hold the ratio to the best of the "
        "demonstrated paths in that metric. The modulator's own row is refined with ready-made "
        "curves, as a user gets it; its network alone knows the demonstrations and no more. L_d "
        "grows with the distance from the other goal, L_p falls where the target is clear: the "
        "best in one is not the best in the other, so Legibility Diffuser has a row for either. "
        "The tests speak of robots and draws, not of other trainings.",
        table,
        f"Settings are chosen for either target on {config['tuning_rollouts']} other robots: the "
        "modulator's, on its network's own paths, by the highest mean L_d, Legibility Diffuser's "
        "by that or by the lowest mean L_p, among those with which 99 % arrive. All networks of "
        "Legibility Diffuser, numbered from 0, are tried, and with the best setting other numbers "
        "of actions to execute, at the same decay in a step; stage 2 executes one.",
        chosen,
        _tests(result, [" ".join(cell) for cell in cells], ROWS_OF_ONE_SCENE),
    ]


def _over(value: float, oracle: float) -> str:
    return f"{three_digits(value)} ({value / oracle:.2f})"


def _beside_paper(result: dict[str, Any]) -> list[Part]:
    """What of the table can be compared with the paper's, and why the rest cannot."""
    dim = len(result["scene"]["start"])
    paper, oracle = paper_rows(dim), METHODS["oracle"].paper
    shown = {("R", "distance_score"): "L_d_R", ("G", "distance_score"): "L_d_G"}
    if dim == 2:
        shown["R", "regularised_cost"] = "L_p_R"
        straight = result["methods"]["straight line"]["targets"]
        ours = {t: three_digits(straight[t]["regularised_cost"]["mean"]) for t in TARGETS}
        theirs = {t: f"{paper[METHODS[BASELINE].paper][f'L_p_{t}']:g}" for t in TARGETS}
        why = (
            "The paper's L_p is of a regularised field, whose potential has another unit. Toward R "
            f"it gives the straight line {ours['R']}, where the paper's Diffusion Policy, which "
            f"goes straight, has {theirs['R']}. Toward G it gives {ours['G']} where the paper has "
            f"{theirs['G']}, and readings of the paper's figure that differ by some centimetres do "
            "not explain that, so this L_p is not compared."
        )
    else:
        why = "The paper's scene of the arm is unknown, so its L_p is not compared."
    heads = [
        text
        for letter, metric in shown
        for text in (f"target {letter}: {MOTION_METRICS[metric]}", "paper")
    ]
    table = Table("method", *heads)
    for name, method in result["methods"].items():
        if name not in METHODS or METHODS[name].paper not in paper:
            continue
        row = []
        for (letter, metric), key in shown.items():
            value = method["targets"][letter][metric]["mean"]
            row.append(_over(value, result["oracle"][letter][metric]))
            theirs, best = (paper[who].get(key) for who in (METHODS[name].paper, oracle))
            row.append(f"{theirs:g} ({theirs / best:.2f})" if theirs and best else "–")
        table.add_row(METHODS[name].text, *row)
    return [f"Beside the paper's, each over its own oracle. {why}", table]


def unseen_section(document: dict[str, Any]) -> list[Part]:
    """The methods on held-out scenes, relative to the oracle, and the tests."""
    config, result = document["config"], document["result"]
    table = Table(
        "method", "success", *(f"{MOTION_METRICS[m]} {_ARROWS[m]} over oracle" for m in TESTED),
        "length over straight", "achieved ℓ, asked 1", "Spearman of ℓ", "error of ℓ",
    )  # fmt: skip
    by_others = Table("method", *EXTERNAL.values())
    for name, method in result["methods"].items():
        ratios: list[str] = []
        for metric in TESTED:
            ratio = method["ratio"][metric]
            low, high = ratio["interval"]
            text = f"{ratio['median']:.3f} ({low:.3f} to {high:.3f})"
            ratios.append(_bold_if_better(result, text, metric, name))
        table.add_row(
            _text(name),
            percent(method["success"]["mean"]),
            *ratios,
            *means(method, ("length_ratio", "achieved"), 3),
            *means(method, ("spearman", "error")),
        )
        by_others.add_row(_text(name), *means(method, EXTERNAL, 3))
    return [
        f"{scenes_of(document)}, in {result['env']}. L_d and L_p are medians over scenes of "
        f"{config['rollouts']} motions with ℓ = 1, over the oracle; an L_p below "
        f"{result['least']['potential_cost']:g} counts as that much. The last two columns are of "
        f"{config['levels']} more motions a scene, one of each level. The oracle and the best of "
        f"{CANDIDATES} know the labels of the scene's archive, the searches only those of their "
        "own curves.",
        table,
        _BY_OTHERS,
        by_others,
        _tests(result, list(TESTED)),
    ]


def _tests(result: dict[str, Any], cells: list[str], texts: dict[str, str] = _TEXTS) -> Table:
    """The modulator's rows against all other methods: effect and adjusted p in each cell.

    `texts` are those of the methods.
    """
    heads = [": ".join([*c.split()[:-1], MOTION_METRICS[c.split()[-1]]]) for c in cells]
    table = Table("ours", "against", *heads, left=range(2))
    tests = {(t["cell"], t["method"], t["against"]): t for t in result["tests"]}
    for ours, own in zip(OURS, ("network alone", "one path", f"best of {CANDIDATES}"), strict=True):
        for name in result["methods"]:
            if ours in result["methods"] and name not in OURS:
                verdicts = (_verdict(tests[cell, ours, name]) for cell in cells)
                other = texts[name] if name in texts else str(name)
                table.add_row(own, other, *verdicts)
    return table


def _verdict(test: dict[str, Any]) -> str:
    p = test["p_holm"]
    worse = p < _SIGNIFICANT and test["effect"] <= 0
    word = "worse" if worse else "better" if p < _SIGNIFICANT else "not shown"
    shown = "p < 0.001" if p < 0.001 else f"p = {p:.3f}"
    text = f"{word}, {test['effect']:+.2f}, {shown}".replace("-", "−")
    return Bold(text) if worse else text


def _bold_if_better(result: dict[str, Any], text: str, cell: str, method: str) -> str:
    """`text`, bold if `method` is significantly better than the baseline in `cell`."""
    better = any(
        t["p_holm"] < _SIGNIFICANT and t["effect"] > 0
        for t in result["tests"]
        if (t["cell"], t["method"], t["against"]) == (cell, method, BASELINE)
    )
    return Bold(text) if better else text
