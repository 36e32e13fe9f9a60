"""Tables and model cards, rendered from the JSON that the evaluations wrote."""

from __future__ import annotations

from typing import Any

from ..curves import NUM_WAYPOINTS
from ..errors import InvalidInputError
from ..evaluation.ablations import COLUMNS
from ..evaluation.dial import FIGURES, worst
from ..evaluation.execution import ROWS
from .wording import WORLDS, filled, goals_of, threads_of

__all__ = [
    "ablations_section",
    "demonstrated",
    "dial_section",
    "dial_table",
    "execution_section",
    "render_card",
    "replace_table",
    "trained",
]


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
    if config["closed_loop"]:
        how = f"""\
Every path is executed by stage 2 in {WORLDS[result["env"]]}, and what is scored is the executed
motion. One that arrives ends within 2 cm of the target, so it may be a little shorter than its
path."""
    else:
        how = f"""\
One path is drawn for a sample; only the row "with candidates" takes the nearest of
{config["candidates"]}. One plan took {result["plan_ms"]:.1f} ms on one core."""
    on = filled(f"""\
On {len(result["scenes"])} random scenes with {goals_of(config)} that training never drew
(seed {document["seed"]}), {len(result["levels"])} levels of ℓ, {config["samples"]} paths each.
{how}""")
    return f"""\
{on}

{dial_table(document)}

Measured by `{document["command"]}`."""


def execution_section(document: dict[str, Any]) -> str:
    """Executed motions by stage 2 and by what it is held against, in Markdown."""
    config, result = document["config"], document["result"]
    table = [
        "| what moves the robot | success (95 % interval) | within 5 cm | Spearman | error of ℓ "
        "| distance from the curve | planned anew | stopped early |",
        "| --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for name, row in result["rows"].items():
        low, high = row["success"]["interval"]
        dial = [f"{row[key]['mean']:.4f}" if key in row else "–" for key in ("spearman", "error")]
        near = f"{row['within_5_cm']:.2%}" if "within_5_cm" in row else "–"
        ends = [
            f"{number:,} {reason}"
            for reason, number in sorted(row["reasons"].items())
            if reason != "reached"
        ]
        table.append(
            f"| {ROWS[name].text} | {row['success']['mean']:.2%} ({low:.2%} to {high:.2%}) "
            f"| {near} | {' | '.join(dial)} | {row['deviation']['mean']:.2%} "
            f"| {row['replanned']:.2%} | {', '.join(ends)} |"
        )
    plan = result["rows"]["policy"]
    kinds = ("states_outside", "actions_not_finite", "actions_over_limit", "wall_contacts")
    found = [sum(row[kind] for row in result["rows"].values()) for kind in kinds]
    on = filled(f"""\
{config["rollouts"]:,} rollouts a row on {config["scenes"]} random scenes with
{goals_of(config)} that training never drew (seed {document["seed"]}), ℓ uniform in [−1, 1], in
{WORLDS[result["env"]]}. All rows share scenes, levels, plans and robots. A push displaces the
robot, a move the target, by {100 * result["disturbance"]:g} cm in a random direction half-way.""")
    means = filled(f"""\
Spearman's correlation and the mean error compare the asked ℓ with that of the executed motion,
whether it arrived or not; where the target moved there is none, as ℓ belongs to a scene. The
distance is that from the curve that was followed at the time, over the length of the first. The
plans alone have a correlation of {plan["spearman_of_plan"]["mean"]:.4f} and an error of
{plan["error_of_plan"]["mean"]:.4f}. In all rows together {found[0]:,} states were outside the
workspace{_farthest(result)}, {found[1]} actions not finite, {found[2]} over the limit, and
{found[3]} steps were stopped by a wall.{_counted(result)}""")
    speed = filled(f"""\
One control step of one robot took {result["step_ms"]:.2f} ms on one core, the policy included and
amortised over its chunk. With {result["at_once"]} robots at once
{result["rollouts_per_second"]:.0f} rollouts a second were planned and executed on
{threads_of(result)}; as many in the environment alone take
{result["env_steps_per_second"]:,.0f} control steps a second on one core.""")
    return f"""\
{on}

{chr(10).join(table)}

{means}

{speed}

Measured by `{document["command"]}`."""


def ablations_section(document: dict[str, Any]) -> str:
    """The dial of weights sampled otherwise and of small runs that lack a part, in Markdown."""
    config = document["config"]
    table = [
        f"| what is changed | {' | '.join(COLUMNS.values())} | one plan |",
        "| --- " * (len(COLUMNS) + 2) + "|",
    ]
    for row in document["result"]["rows"].values():
        figures = " | ".join(f"{row['overall'][name]['mean']:.4f}" for name in COLUMNS)
        table.append(f"| {row['text']} | {figures} | {row['plan_ms']:.1f} ms |")
    on = filled(f"""\
Means over {config["scenes"]} random scenes with {goals_of(config)} that training never drew (seed
{document["seed"]}), {config["levels"]} levels of ℓ, {config["samples"]} paths each. The first rows
are the weights themselves, sampled otherwise. The small runs have the same network but only
{config["training_steps"]:,} steps of training, on {config["training_scenes"]:,} scenes where no
other number is named, so they are to be compared with the first of them, not with the weights.
Without the field, and on rank labels, a path on the wrong side of the straight line is not drawn
again; on rank labels ℓ = 0 is not the straight line. Lengths are in those of the straight line; a
plan was timed on one core.""")
    return f"""\
{on}

{chr(10).join(table)}

Measured by `{document["command"]}`."""


def _farthest(result: dict[str, Any]) -> str:
    farthest = max(row["farthest_outside"] for row in result["rows"].values())
    return f" (by at most {1e3 * farthest:.1f} mm)" if farthest > 0 else ""


def _counted(result: dict[str, Any]) -> str:
    """What an arm's environment counted in the rows in which stage 2 moves it undisturbed."""
    counts = result["rows"]["policy"]["counts"]
    if not counts:
        return ""
    found = ", ".join(f"{number} {name.replace('_', ' ')}" for name, number in counts.items())
    return f" Stage 2, not disturbed, had {found}."


def replace_table(text: str, name: str, table: str) -> str:
    """`text` with what stands between `<!-- NAME -->` and `<!-- /NAME -->` replaced."""
    begin, end = f"<!-- {name} -->", f"<!-- /{name} -->"
    head, found, rest = text.partition(begin)
    _, closed, tail = rest.partition(end)
    if not (found and closed):
        raise InvalidInputError(f"there is no part between {begin} and {end}")
    return f"{head}{begin}\n{table}\n{end}{tail}"


def render_card(name: str, config: dict[str, Any], documents: dict[str, dict[str, Any]]) -> str:
    """The model card of weights, from `config.json` and the JSON of the evaluations.

    Args:
        name: of the weights.
        config: the content of `config.json`.
        documents: by kind, `dial` and, with a stage 2, `closed-loop`, `execution` and, if it was
            measured, `transfer`.

    Raises:
        InvalidInputError: a measurement is missing or of other weights, or how they were made is
            not known.
    """
    stages = {stage: entry for stage, entry in config.items() if stage != "format"}
    needed = {"dial": ["path"]}
    if "policy" in stages:
        needed |= {"closed-loop": ["path", "policy"], "execution": ["path", "policy"]}
        if "transfer" in documents:
            needed["transfer"] = ["path", "policy"]
    for kind, used in needed.items():
        if kind not in documents:
            raise InvalidInputError(f"there is no {kind}-{name}.json beside the other measurements")
        for stage in used:
            if documents[kind]["model"].get(stage) != stages[stage]["sha256"]:
                raise InvalidInputError(
                    f"the measurement {kind}-{name}.json is of other weights than those of {name}"
                )
    for stage, entry in stages.items():
        if not entry["training"]:
            raise InvalidInputError(
                f"the configuration of {name} does not say how its {stage} was trained"
            )
    path, training = stages["path"]["config"], stages["path"]["training"]
    data = training["data"]
    does = _STAGE_1 + _STAGE_2 if "policy" in stages else _STAGE_1
    parts = [
        f"""\
---
license: mit
library_name: legibility
tags: [robotics, human-robot-interaction, legibility, diffusion]
---

# {name}

The Legibility Modulator for {path["dim"]}-D block reaching.

{does}
Use it with `legibility.Modulator.from_pretrained("{name}")`.

## Data
""",
        filled(f"""\
{data["scenes"]:,} random scenes with {goals_of(data)} (stream `{data["stream"]}`, seed
{data["seed"]}), {data["per_scene"]} trajectories a scene chosen flat along ℓ from its
quality-diversity archive; labels `{path["label"]}`, σ = {path["sigma"]} m, α = {path["alpha"]}.
SHA-256 over the shards: `{training["digest"]}`."""),
        "\n## Training of stage 1\n",
        *_stage_1(path, training),
    ]
    if "policy" in stages:
        policy = stages["policy"]["training"]
        parts += [
            "\n## Training of stage 2\n",
            demonstrated(policy, path["dim"]),
            "",
            trained(policy, "{batch:,} moments of demonstrations"),
        ]
    parts += ["\n## How exact the dial is\n", dial_section(documents["dial"])]
    if "policy" in stages:
        parts += [
            "\n## How well motions are executed\n",
            execution_section(documents["execution"]),
            "\n## How exact the dial of executed motions is\n",
            dial_section(documents["closed-loop"]),
        ]
    if "transfer" in documents:
        parts += [
            "\n## How well motions are executed in a simulator that was not trained in\n",
            execution_section(documents["transfer"]),
        ]
    parts += [
        "\n## Limits\n",
        filled(f"""\
The observer is a model (a Gaussian around each goal), not a person. It was trained on the default
workspace of {path["dim"]}-D scenes alone; obstacles are not known. Labels are ranks within a
scene's archive: the same ℓ is a different score in another scene."""),
        "",
    ]
    return "\n".join(parts)


_STAGE_1 = f"""\
* Stage 1, the intent-aware path diffuser: from start, goals and ℓ in [−1, 1] to {NUM_WAYPOINTS}
  waypoints.
"""
_STAGE_2 = """\
* Stage 2, the path-guided policy: from two states, goal and path to actions, closed loop.
"""


def _stage_1(config: dict[str, Any], training: dict[str, Any]) -> list[str]:
    """How stage 1 was trained; of one that was distilled, how its teacher was before."""
    batch = "{scenes} scenes × {per_scene} trajectories"
    teacher = training.get("teacher")
    if teacher is None:
        return [trained(training, batch)]
    steps, before = config["sampling_steps"], teacher["sampling_steps"]
    settings, own = training["training"], teacher["training"]
    first = ["How its teacher was made is not known."]
    if own is not None:
        first = [
            f"First a teacher, on data of SHA-256 `{own['digest']}`:\n", trained(own, batch)
        ]  # fmt: skip
    return [
        *first,
        "",
        filled(f"""\
Then what the teacher (SHA-256 `{teacher["sha256"]}`) draws in {before} steps with guidance
{teacher["guidance"]:g} was distilled into a student that draws in {steps} step{"s" * (steps > 1)}
without. In every scene of the data above the teacher drew {settings["pairs"]} paths, ℓ all over
the dial; from the same noise the student is to draw nearly the same path, the label that its path
achieves is to be the asked one (weight {settings["score_weight"]:g}), and the path is to have no
more jerk than its teacher's (weight {settings.get("jerk_weight", 0):g}). The first of these minutes
were the teacher's:"""),
        "",
        trained(training, batch),
    ]


def demonstrated(training: dict[str, Any], dim: int) -> str:
    """The demonstrations that a policy learned from."""
    shown = training["demonstrations"]
    scenes = shown["demonstrated"] or training["data"]["scenes"]
    return filled(f"""\
{shown["number"]:,} demonstrations, {shown["demonstrations"]} in each of {scenes:,} scenes
of the same data: a feedback controller follows paths of the archive in
{"BlockReach2D" if dim == 2 else "PandaBlockReach, on MuJoCo"}, with noise of
{1e3 * shown["noise"]:g} mm a step and, in {shown["pushed"]:.0%}, a push of
{1e2 * shown["push"]:g} cm. SHA-256 over the shards: `{training["digest"]}`.""")


def trained(training: dict[str, Any], batch: str) -> str:
    """How a network was trained, on batches as the text `batch` says."""
    settings = training["training"]
    alone = settings["steps"] * training["step_seconds"] / 60
    return filled(f"""\
{training["parameters"]:,} parameters; {settings["steps"]:,} batches of {batch.format(**settings)},
seed {settings["seed"]}, in {training["seconds"] / 60:.0f} minutes on {training["device"]}
({threads_of(training)}, PyTorch {training["torch"]}), validation included. The
machine is shared: by the quickest tenth of the log the batches alone take {alone:.0f} minutes.""")
