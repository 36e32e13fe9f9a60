"""Closed-loop executions, as text and a table."""

from __future__ import annotations

from typing import Any

from ..evaluation.execution import ROWS
from .table import Part, Table, number
from .wording import WORLDS, percent, scenes_of, threads_of

__all__ = ["execution_section"]

_VIOLATIONS = ("states_outside", "actions_not_finite", "actions_over_limit", "wall_contacts")


def execution_section(document: dict[str, Any]) -> list[Part]:
    """The metrics of `legibility evaluate execution`: stage 2 and its comparisons."""
    config, result = document["config"], document["result"]
    table = Table(
        "controller", "success (95 % interval)", "within 5 cm", "Spearman", "error of ℓ",
        "deviation", "replanned", "stopped early",
    )  # fmt: skip
    for name, row in result["rows"].items():
        low, high = row["success"]["interval"]
        early = (f"{n:,} {reason}" for reason, n in sorted(row["reasons"].items())
                 if reason != "reached")  # fmt: skip
        table.add_row(
            ROWS[name].text,
            f"{percent(row['success']['mean'])} ({percent(low)} to {percent(high)})",
            percent(row["within_5_cm"]) if "within_5_cm" in row else "–",
            *(number(row[k]["mean"], 4) if k in row else "–" for k in ("spearman", "error")),
            percent(row["deviation"]["mean"]),
            percent(row["replanned"]),
            ", ".join(early),
        )
    plan = result["rows"]["policy"]
    outside, not_finite, over, stopped = (
        sum(row[kind] for row in result["rows"].values()) for kind in _VIOLATIONS
    )
    farthest = max(row["farthest_outside"] for row in result["rows"].values())
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
