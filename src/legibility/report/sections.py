"""The result of an evaluation as a few sentences and tables; `NOTES` explains the metrics."""

from typing import Any

from ..evaluation import external
from ..evaluation.ablations import COLUMNS
from ..evaluation.comparison import EXTERNAL, TARGETS, TESTED, paper_rows
from ..evaluation.comparison import METRICS as MOTION_METRICS
from ..evaluation.contest import BASELINE, CANDIDATES, METHODS, OURS
from ..evaluation.execution import ROWS
from ..evaluation.eyes import EYES
from ..evaluation.planning import PLACES, planner_text
from ..evaluation.single_scene import ROWS as ROWS_OF_ONE_SCENE
from .dials import REGIMES, goals_of, means, percent, scenes_of
from .table import Bold, Part, Table, number, three_digits

NOTES = (
    "Scenes are random and held out; intervals are of 95 %. The achieved ℓ of a trajectory is its "
    "score read off the archive of its scene; Spearman's correlation and the error compare it with "
    "the asked ℓ, whether a motion arrived or not. Their limits are what another seed of the "
    "archive leaves: the error of its labels, and the correlation of labels with that noise, which "
    "stays below 1 where samples share a level. The deviation is the mean distance from the curve "
    "followed, over the length of the first curve. Robots have hidden gains and lags; "
    "PandaGymBlockReach (panda-gym) is never used in training. The bench times control steps, "
    "`plan_one_core_ms` and `plan_obstacles_ms` on one core, the last in new scenes or in known "
    "ones, whose archive is there.",
    "Paths come in three modes: bare, as the network draws them; quick, the default, moved out of "
    "contact and to the score that ready-made curves give ℓ; exact, to the score that the archive "
    "gives ℓ. The judge is always another archive than that. The tables of regimes and the first "
    "table of the README are of scenes in which each side of the dial spans 0.05 nats or more; in "
    "the others labels rank noise, and each section tells of them. Curves wave if they turn 0.5 "
    "rad more than the mean of the archive's of that ℓ; the share of the archive's own that do "
    "stands beside it. The way to the optimum is the gain in score over ℓ = 0, over that of the "
    "archive's best curve that is no longer; its median counts.",
    "All methods share scenes, robots and seeds. The oracle is the most legible trajectory of a "
    "scene's archive; brackets in Table I hold the ratio to it. Bold is significantly better than "
    "Diffusion Policy, or worse than another method (p < 0.05 in paired two-sided Wilcoxon tests "
    "with Holm's correction over the table); the effect is the rank-biserial correlation. The time "
    "to confidence is the share of the motion after which P(g*) ≥ 0.8 for good, to the paper's "
    "observer; never counts as 1. The plan is the time before the robot can move; the "
    "whole motion adds all action chunks, but not the simulation.",
)
"""Paragraphs about the metrics of all sections."""

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
_BENCH_CONDITIONS = ("mode", "scene", "batch", "goals", "dim", "precision")
_VIOLATIONS = {
    "states_outside": "states outside the workspace",
    "actions_not_finite": "actions that were not finite",
    "actions_over_limit": "actions over the limit",
    "wall_contacts": "steps stopped by a wall",
}


def ablations_section(document: dict[str, Any]) -> list[Part]:
    """The dial under other samplers, and of small runs that lack a part."""
    config = document["config"]
    table = Table("change", *COLUMNS.values(), "error of ℓ, mended", "one plan [ms]")
    for row in document["result"]["rows"].values():
        cells = means(row["overall"], COLUMNS), means(row, ["quick_error"])
        table.add_row(row["text"], *cells[0], *cells[1], number(row["plan_ms"], 1))
    return [
        f"Means over {scenes_of(document)}, {config['levels']} levels of ℓ, {config['samples']} "
        "samples of each, as the network draws them; the column before the last is of the plans "
        f"that a user gets. Small runs have only {config['training_steps']:,} training steps of "
        f"{config['batch_scenes']} scenes; compare them with the first one. The loss on labels is "
        "a differentiable form of the error reported here. On rank labels ℓ = 0 is not the "
        "straight line.",
        table,
    ]


def execution_section(document: dict[str, Any]) -> list[Part]:
    """The metrics of `legibility evaluate execution`: stage 2 and its comparisons."""
    config, result = document["config"], document["result"]
    table = Table(
        "controller", "success (95 % interval)", "within 5 cm", "Spearman", "error of ℓ",
        "deviation", "jerk [m/s³]", "turned [rad]", "replanned", "contacts", "stopped early",
    )  # fmt: skip
    rows = result["rows"]
    for name, row in rows.items():
        mean, low, high = map(percent, (row["success"]["mean"], *row["success"]["interval"]))
        reasons = sorted(row["reasons"].items())
        table.add_row(
            ROWS[name].text,
            f"{mean} ({low} to {high})",
            percent(row["within_5_cm"]) if "within_5_cm" in row else "–",
            *means(row, ("spearman", "error")),
            percent(row["deviation"]["mean"]),
            *means(row, ("jerk",), 1),
            *means(row, ("turned",), 2),
            percent(row["replanned"]),
            f"{row['contacts']:,}",
            ", ".join(f"{n:,} {reason}" for reason, n in reasons if reason != "reached"),
        )
    violations = [
        f"{sum(row[key] for row in rows.values()):,} {text}" for key, text in _VIOLATIONS.items()
    ]
    farthest = max(0.0, *(row["farthest_outside"] for row in rows.values()))
    plan = rows["policy"]
    counts = [f"{n} {name.replace('_', ' ')}" for name, n in plan["counts"].items()]
    correlation, error = means(plan, ("spearman_of_plan", "error_of_plan"))
    (turned,) = means(plan, ("turned_of_plan",), 2)
    return [
        f"{config['rollouts']:,} rollouts a row on {scenes_of(document)}, "
        f"{REGIMES[config['regime']]}, ℓ uniform in [−1, 1], in {result['env']}. Contacts are "
        "steps into an obstacle or another goal's block. A push displaces the robot, a shift the "
        f"target, half-way by {100 * result['disturbance']:g} cm." + _replacements(result),
        table,
        f"The plans have a correlation of {correlation} and an error of {error}, and turn through "
        f"{turned} rad. The jerk is the root mean square over a motion. All rows had "
        f"{', '.join(violations)} (at most {1e3 * farthest:.1f} mm outside)."
        + (f" Stage 2, undisturbed, had {', '.join(counts)}." if counts else ""),
    ]


def _replacements(result: dict[str, Any]) -> str:
    """What obstacles made of scenes and plans; nothing of results that do not tell."""
    text = ""
    if impassable := result.get("impassable"):
        text += f" {impassable} more scenes were drawn that the robot cannot pass."
    if replaced := result["rows"]["policy"].get("replaced"):
        text += f" A curve of the archive stood in for {replaced} plans."
    return text


def planning_section(document: dict[str, Any]) -> list[Part]:
    """The error of ℓ against the time to plan, of the modulator, of search, and of archives."""
    config, result = document["config"], document["result"]
    heads = ("error of ℓ", "feasible", "a new scene [ms]", "a known scene [ms]")
    table = Table("planner", *(f"{text}: {head}" for text in PLACES.values() for head in heads))
    for name in next(iter(result.values()))["planners"]:
        cells: list[str] = []
        for place in result.values():
            row = place["planners"][name]
            cells += [number(row["error"]["mean"], 4), percent(row["feasible"]["mean"])]
            cells += [three_digits(row[span]["median"]) for span in ("new", "known")]
        table.add_row(planner_text(name), *cells)
    cells = []
    for place in result.values():
        cells += [number(place["noise"]["mean"], 4), "", "", ""]
    table.add_row("limit: another seed of the archive", *cells)
    return [
        f"{config['scenes']:,} held-out random scenes of each kind with {goals_of(config)} (seed "
        f"{document['seed']}), Dragan's observer, {config['levels']} levels of ℓ; one core, "
        "PyTorch. Searches rank random curves as an archive does its own, elite by elite of the "
        "same grid. In a known scene they and the archive have nothing left to do but to look up "
        "a curve. Feasible is a path through eight points of the curve that was found.",
        table,
    ]


def optimum_section(document: dict[str, Any]) -> list[Part]:
    """What share of the possible gain in score plans reach."""
    config, result = document["config"], document["result"]
    table = Table(
        "turned for", "asked ℓ", "scenes", "of the optimum: plan", "of the optimum: archive",
        "of the bound: plan", "of the bound: archive", "length", left=(0,),
    )  # fmt: skip
    for eyes, ends in result["rows"].items():
        for end, row in ends.items():
            scenes = sum(scene[eyes][end] is not None for scene in result["scenes"])
            names = ("of_optimum", "archive_of_optimum", "of_bound", "archive_of_bound")
            table.add_row(
                EYES[eyes],
                end.replace("-", "−"),
                str(scenes),
                *(percent(row[n]["median"]) if row else "–" for n in names),
                number(row["length"]["median"], 2) if row else "–",
            )
    how = "exact plans" if config["exact"] else "quick plans"
    return [
        f"{scenes_of(document)}, {how}; medians over scenes with 0.05 nats or more to gain. The "
        "gain in score over ℓ = 0 is that of the plan, and of the archive's best curve that is no "
        "longer. The optimum of that length is what sequential quadratic programming reaches from "
        f"the plan and from {config['starts']} elites; the bound is certified: no motion of that "
        "length can score more, but none may score as much. The length is over the straight "
        "line's.",
        table,
    ]


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


def spectrum_section(document: dict[str, Any]) -> list[Part]:
    """The cost of executed motions over the whole dial (paper, figure 3)."""
    config, result = document["config"], document["result"]
    targets = result["targets"]
    heads = [f"target {letter}: {name}" for letter in targets for name in ("L_p", "achieved ℓ")]
    table = Table("asked ℓ", *heads)
    for index, level in enumerate(result["levels"]):
        cells = []
        for values in targets.values():
            cells += [three_digits(values["mean"][index]), number(values["achieved"][index])]
        table.add_row(number(level, 2), *cells)
    trends = [
        f"toward {letter} L_p rises at {values['rising']} of {config['levels'] - 1} steps of ℓ, "
        f"with {percent(values['success'])} success"
        for letter, values in targets.items()
    ]
    return [
        f"{config['rollouts']} motions a level toward either target of Table I, executed in "
        f"{result['env']} (seed {document['seed']}): {'; '.join(trends)}.",
        table,
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
        table.add_row(METHODS[name].text, percent(success), *row)
        rest.add_row(
            METHODS[name].text,
            *(number(sum(t[m]["mean"] for t in targets.values()) / len(targets)) for m in others),
            *(number(times[span], 1) if times else "–" for span in ("plan", "motion")),
        )
        cells_by_others = (sum(t[m]["mean"] for t in targets.values()) / 2 for m in EXTERNAL)
        others_table.add_row(METHODS[name].text, *map(number, cells_by_others))
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
        f"{config['demonstrations']} demonstrations toward either target, flat along ℓ, one "
        f"training each (seed {document['seed']}) of {config['training_steps']:,} steps with "
        f"batches of {config['batch']}. {config['rollouts']} rollouts toward either target in "
        f"{result['env']}, ℓ = 1; success is that of the worse target, and L_d and L_p are of all "
        "motions, also of those that do not arrive. Brackets hold the ratio to the best of the "
        "demonstrated paths in that metric. The modulator's own row is refined with ready-made "
        "curves, as a user gets it; its network alone knows the demonstrations and no more. The "
        "baselines execute four actions of a chunk, stage 2 one. The tests speak of robots and "
        "draws, not of other trainings.",
        table,
        f"Guidance is chosen for either target on {config['tuning_rollouts']} other robots: the "
        "modulator's, on its network's own paths, by the highest mean L_d, Legibility Diffuser's "
        "by that or by the lowest mean L_p, among the settings with which 99 % arrive.",
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
        if METHODS[name].paper not in paper:
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
            METHODS[name].text,
            percent(method["success"]["mean"]),
            *ratios,
            *means(method, ("length_ratio", "achieved"), 3),
            *means(method, ("spearman", "error")),
        )
        by_others.add_row(METHODS[name].text, *means(method, EXTERNAL, 3))
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
                table.add_row(own, texts[name], *verdicts)
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


def bench_section(document: dict[str, Any]) -> list[Part]:
    """The measurements of `legibility bench`, one a row."""
    config, result = document["config"], document["result"]
    machine = result["machine"]
    load = "" if machine["load"] is None else f", load {machine['load']:.1f}"
    table = Table(
        "metric", "model", "backend", "conditions", "median", "95 % interval", left=range(4)
    )
    for row in result["measurements"]:
        conditions = ", ".join(f"{name} {row[name]}" for name in _BENCH_CONDITIONS if name in row)
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
