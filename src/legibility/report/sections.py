"""The result of an evaluation as a few sentences and tables; `NOTES` explains the metrics."""

from typing import Any

from ..evaluation.ablations import COLUMNS
from ..evaluation.controller import ROWS as DISTURBED
from ..evaluation.execution import ROWS
from ..evaluation.eyes import EYES
from ..evaluation.planning import PLACES, planner_text
from ..evaluation.timing import METRICS as TIMED
from .dials import REGIMES, goals_of, means, percent, scenes_of
from .table import Part, Table, number, three_digits

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
        "a differentiable form of the error reported here. Paths of the run without the field are "
        "only moved out of contact, not to ℓ. On rank labels ℓ = 0 is not the straight line.",
        table,
    ]


def timing_section(document: dict[str, Any]) -> list[Part]:
    """Timed motions: their limits, their time, and what they show."""
    config, result = document["config"], document["result"]
    table = Table("of a motion", "median", "99th percentile", "greatest", left=range(1))
    for name, text in TIMED.items():
        row = result["metrics"][name]
        table.add_row(text, *(three_digits(row[k]) for k in ("median", "percentile", "greatest")))
    error, planned = (three_digits(result[key]["mean"]) for key in ("error", "planned"))
    number = result["motions"] + result["refused"]
    parts: list[Part] = [
        f"{scenes_of(document)}; {number:,} motions of {result['moves']} at {config['levels']} "
        "levels of ℓ, 1,000 instants a second. Velocity, acceleration and jerk are finite "
        "differences of positions, with rest before and after. The deviation is that of an arm's "
        "grasp point by its joint angles. The bound on the duration is that of the fastest timing "
        "within velocities and accelerations, which jumps in its acceleration. The error of ℓ of "
        f"the motions as timed is {error}, that of the plans {planned}.",
        table,
    ]
    if result["refused"]:
        reasons = "; ".join(result["why"])
        parts.append(
            f"{result['refused']} motions were refused, as the arm cannot follow their paths, for "
            f"example: {reasons}."
        )
    return parts


def controller_section(document: dict[str, Any]) -> list[Part]:
    """The controller in a loop, disturbed on the way."""
    config, result = document["config"], document["result"]
    table = Table(
        "on the way", "motions", "success", "error of ℓ", "turn [°]: median / 99 % / greatest",
        "step [ms]: median / 99 % / greatest", "until the last new path [s]", "turned [rad]",
        "contacts",
    )  # fmt: skip
    for name, row in result["rows"].items():
        table.add_row(
            DISTURBED[name].text,
            str(row["motions"]),
            percent(row["success"]["mean"]),
            number(row["error"]["mean"], 4),
            _three(row["turn"]),
            _three(row["step"]),
            number(row["delay"]["median"], 2) if row["delay"] else "–",
            number(row["turned"]["mean"], 2),
            str(row["contacts"]),
        )
    networks = {"torch": "PyTorch", "onnx": "onnxruntime"}[config["backend"]]
    return [
        f"{scenes_of(document)}, ℓ uniform in [−1, 1], a step each {1e3 * result['dt']:g} ms, on "
        f"one core by {networks}; planning has {1e3 * config['budget']:g} ms of each. A simulated "
        "robot realises 60 % to 90 % of a displacement, with a lag. Once on its way it is pushed "
        "by two displacements, its target moves as far, or a ball appears on its path. The turn is "
        "that between the displacements before and after a new path is taken. The error is that "
        "of the whole motion, in the scene as it is at the end. A new plan starts from the present "
        "position with the same ℓ; it blocks the loop, and its time counts as that of a step.",
        table,
    ]


def _three(values: dict[str, float] | None) -> str:
    """Median, 99th percentile and the greatest of some values, if there are any."""
    if values is None:
        return "–"
    return " / ".join(number(values[key], 1) for key in ("median", "percentile", "greatest"))


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
