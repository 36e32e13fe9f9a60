"""The dial, its ablations, executions and the spectrum as text and tables."""

from __future__ import annotations

import math
from collections.abc import Iterable
from itertools import pairwise
from typing import Any

from ..evaluation.ablations import COLUMNS
from ..evaluation.dial import METRICS, worst
from ..evaluation.execution import ROWS
from .bench import threads_of
from .table import Column, Part, Table, number

WORLDS = {
    "BlockReach2D": "BlockReach2D, where each robot has a gain and a lag that it does not know",
    "PandaBlockReach": "PandaBlockReach (the Panda on MuJoCo), where each arm has a response and a "
    "delay that it does not know",
    "PandaGymBlockReach": "PandaGymBlockReach (the Panda of panda-gym, never used in training)",
}


def goals_of(config: dict[str, Any]) -> str:
    """How many goals the scenes of a configuration have."""
    low, high = config["goals"]
    return f"{low} goals" if low == high else f"{low} to {high} goals"


def scenes_of(document: dict[str, Any]) -> str:
    """The held-out scenes of an evaluation."""
    config = document["config"]
    return (
        f"{config['scenes']:,} held-out random scenes with {goals_of(config)} "
        f"(seed {document['seed']})"
    )


def percent(share: float) -> str:
    """A share in percent with two decimals."""
    return f"{share:.2%}"


def at_most(share: float) -> str:
    """A share in percent, to a tenth and never rounded up to all."""
    return f"{math.floor(1000 * share + 1e-9) / 10:.1f}%"


def three_digits(value: float) -> str:
    """Three significant digits."""
    return f"{value:.2e}" if 0 < abs(value) < 0.01 else f"{value:#.3g}".rstrip(".")


def means(metrics: dict[str, Any], names: Iterable[str], digits: int = 4) -> list[str]:
    """The means of some metrics, – for those that were not measured."""
    return [number(metrics[n]["mean"], digits) if n in metrics else "–" for n in names]


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
            mean, low, high = (number(x, 4) for x in (values["mean"], *values["interval"]))
            extreme = worst(name, values)
            last = "" if extreme is None else number(extreme, 4)
            table.add_row(metric.text, mean, f"{low} to {high}", last)
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
        table.add_row(row["text"], *means(row["overall"], COLUMNS), number(row["plan_ms"], 1))
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


def execution_section(document: dict[str, Any]) -> list[Part]:
    """The metrics of `legibility evaluate execution`: stage 2 and its comparisons."""
    config, result = document["config"], document["result"]
    table = Table(
        "controller", "success (95 % interval)", "within 5 cm", "Spearman", "error of ℓ",
        "deviation", "replanned", "stopped early",
    )  # fmt: skip
    for name, row in result["rows"].items():
        mean, low, high = map(percent, (row["success"]["mean"], *row["success"]["interval"]))
        early = [(reason, n) for reason, n in sorted(row["reasons"].items()) if reason != "reached"]
        table.add_row(
            ROWS[name].text,
            f"{mean} ({low} to {high})",
            percent(row["within_5_cm"]) if "within_5_cm" in row else "–",
            *means(row, ("spearman", "error")),
            percent(row["deviation"]["mean"]),
            percent(row["replanned"]),
            ", ".join(f"{n:,} {reason}" for reason, n in early),
        )
    rows, plan = result["rows"].values(), result["rows"]["policy"]
    outside, not_finite, over, stopped = (
        sum(row[metric] for row in rows)
        for metric in (
            "states_outside",
            "actions_not_finite",
            "actions_over_limit",
            "wall_contacts",
        )
    )
    farthest = max(row["farthest_outside"] for row in rows)
    by = f" (by at most {1e3 * farthest:.1f} mm)" if farthest > 0 else ""
    counts = ", ".join(f"{n} {name.replace('_', ' ')}" for name, n in plan["counts"].items())
    return [
        f"{config['rollouts']:,} rollouts a row on {scenes_of(document)}, ℓ uniform in [−1, 1], in "
        f"{WORLDS[result['env']]}. All rows share scenes, levels, plans and robots. A push "
        "displaces the robot, a shift the target, half-way and in a random direction, by "
        f"{100 * result['disturbance']:g} cm.",
        table,
        "Spearman's correlation and the mean error compare the asked ℓ with that of the executed "
        "motion, whether it arrived or not. They are missing where the target moved, because ℓ "
        "belongs to a scene. Deviation is the mean distance from the curve followed at the time, "
        "over the length of the first curve. The plans alone have a correlation of "
        f"{number(plan['spearman_of_plan']['mean'], 4)} and an error of "
        f"{number(plan['error_of_plan']['mean'], 4)}. All rows together had {outside:,} states "
        f"outside the workspace{by}, {not_finite} actions that were not finite, {over} actions "
        f"over the limit, and {stopped} steps stopped by a wall."
        + (f" Stage 2, undisturbed, had {counts}." if counts else ""),
        f"One control step of one robot took {result['step_ms']:.2f} ms on one core, the policy "
        f"included and amortised over its chunk. With {result['at_once']} robots at once, "
        f"{result['rollouts_per_second']:.0f} rollouts a second were planned and executed on "
        f"{threads_of(result)}; the environment alone ran {result['env_steps_per_second']:,.0f} "
        "control steps a second on one core.",
    ]


def spectrum_section(document: dict[str, Any]) -> list[Part]:
    """The cost of executed motions over the whole dial (paper, figure 3)."""
    config, result = document["config"], document["result"]
    targets = result["targets"]
    heads = [Column(name, group=f"target {t}") for t in targets for name in ("L_p", "achieved ℓ")]
    table = Table("asked ℓ", *heads)
    for index, level in enumerate(result["levels"]):
        cells = []
        for values in targets.values():
            cells += [three_digits(values["mean"][index]), number(values["achieved"][index])]
        table.add_row(number(level, 2), *cells)
    trends = []
    for letter, values in targets.items():
        costs = values["mean"]
        trend = "falls at every level"
        if values["rising"]:
            most = max(after / before - 1 for before, after in pairwise(costs))
            trend = f"rises at {values['rising']} of {len(costs) - 1} levels, by at most {most:.2%}"
        trends.append(
            f"toward {letter} it {trend}, from {three_digits(costs[0])} to "
            f"{three_digits(costs[-1])}, with {at_most(values['success'])} success"
        )
    return [
        f"{config['rollouts']} motions at each of {config['levels']} levels of ℓ toward either "
        f"target of Table I, executed in {WORLDS[result['env']]} (seed {document['seed']}). The "
        f"mean of the paper's L_p: {'; '.join(trends)}. The picture's bands are 95 % intervals.",
        table,
    ]
