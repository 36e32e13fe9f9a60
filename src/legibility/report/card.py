"""Model cards: how weights were made and how good they are."""

from __future__ import annotations

from typing import Any

from ..curves import NUM_WAYPOINTS
from ..errors import InvalidInputError
from ..evaluation.comparison import METHODS
from ..models.provenance import TrainingRecord
from .results import Results, headline_table, well_formed
from .table import Part, Table, markdown, number
from .wording import WORLDS, goals_of, percent, threads_of

__all__ = ["render_card"]

_HEAD = """\
---
license: mit
library_name: legibility
tags: [robotics, human-robot-interaction, legibility, diffusion{tag}]
---

# {name}

"""
_POINTER = (
    "All metrics with their intervals, and the commands that measured them, are in the "
    "repository's `docs/results.md`."
)


def render_card(name: str, config: dict[str, Any], results: Results) -> str:
    """The model card of weights.

    Args:
        name: of the weights.
        config: the content of their `config.json`.
        results: of `read_results`. The modulator needs `dial` and, with a stage 2, `closed-loop`
            and `execution`; Legibility Diffuser needs `tuning`.

    Raises:
        InvalidInputError: a result is missing or of other weights, or the training is not known.
    """
    with well_formed(f"cannot make the card of {name}"):
        records = {}
        for stage, entry in config.items():
            if stage != "format":
                if not entry["training"]:
                    raise InvalidInputError(
                        f"the configuration of {name} does not say how its {stage} was trained"
                    )
                records[stage] = TrainingRecord.from_dict(entry["training"])
        if "goal" in records:
            head, parts = _HEAD.format(name=name, tag=", baseline"), _baseline
        else:
            head, parts = _HEAD.format(name=name, tag=""), _modulator
        return head + markdown(parts(name, config, records, results)) + "\n"


def _modulator(
    name: str, config: dict[str, Any], records: dict[str, TrainingRecord], results: Results
) -> list[Part]:
    kinds = ["dial", *(["closed-loop", "execution"] if "policy" in records else [])]
    for kind in kinds:
        if name not in results.get(kind, {}):
            raise InvalidInputError(f"there is no {kind}-{name}.json beside the other results")
        for stage in records if kind != "dial" else ["path"]:
            _check(f"{kind}-{name}", results[kind][name]["model"], name, stage, config)
    path, record = config["path"]["config"], records["path"]
    observer, data = path["observer"], record.data
    stages = f"Stage 1, the path diffuser, turns start, goals and ℓ into {NUM_WAYPOINTS} waypoints."
    if "policy" in records:
        stages += " Stage 2, the path-guided policy, turns the path into actions, closed loop."
    parts: list[Part] = [
        f"The Legibility Modulator for {path['dim']}-D block reaching. {stages} Load it with "
        f'`legibility.Modulator.from_pretrained("{name}")`.',
        "## Data",
        f"{data['scenes']:,} random scenes with {goals_of(data)} (stream `{data['stream']}`, seed "
        f"{data['seed']}), {data['per_scene']} trajectories a scene, chosen flat along ℓ from its "
        f"quality-diversity archive; labels `{observer['label']}`, σ = {observer['sigma']} m, α = "
        f"{observer['alpha']}. SHA-256 over the shards: `{record.digest}`.",
        "## Training of stage 1",
        *_stage_1(path, record),
    ]
    if "policy" in records:
        policy = records["policy"]
        parts += [
            "## Training of stage 2",
            _demonstrated(policy, path["dim"]),
            _trained(policy, "{batch:,} moments of demonstrations"),
        ]
    table = headline_table({kind: results[kind] for kind in kinds}, {name: "value"})
    return [
        *parts,
        "## Metrics",
        table,
        _POINTER,
        "## Limits",
        "The observer is a model (a Gaussian around each goal), not a person. The weights were "
        f"trained in the default workspace of {path['dim']}-D scenes only and know no obstacles. "
        "Labels are ranks within a scene's archive: the same ℓ is another score in another scene.",
    ]


def _stage_1(path: dict[str, Any], record: TrainingRecord) -> list[Part]:
    """The training of stage 1, after that of its teacher if it was distilled."""
    batch = "{scenes} scenes × {per_scene} trajectories"
    teacher, settings = record.teacher, record.training
    if teacher is None:
        return [_trained(record, batch)]
    first: list[Part] = ["The training of its teacher is not known."]
    if teacher.training is not None:
        first = [
            f"First a teacher, on data of SHA-256 `{teacher.training.digest}`:",
            _trained(teacher.training, batch),
        ]
    steps = path["sampling_steps"]
    return [
        *first,
        f"Then a student that draws in {steps} step{'s' * (steps > 1)} without guidance was "
        f"distilled from the teacher (SHA-256 `{teacher.sha256}`), which draws in "
        f"{teacher.sampling_steps} with guidance {teacher.guidance:g}. In every scene the teacher "
        f"drew {settings['pairs']} paths over the whole dial; from the same noise the student "
        "learns to draw nearly the same path, to achieve the asked label (weight "
        f"{settings['score_weight']:g}), and to have no more jerk (weight "
        f"{settings['jerk_weight']:g}). The time includes the teacher's draws:",
        _trained(record, batch),
    ]


def _baseline(
    name: str, config: dict[str, Any], records: dict[str, TrainingRecord], results: Results
) -> list[Part]:
    method = next((m for m in METHODS if name.startswith(m.replace(" ", "-"))), None)
    if method is None:
        raise InvalidInputError(f"the name {name} is not that of a method")
    shape, record = config["goal"]["config"], records["goal"]
    parts: list[Part] = [
        f"{METHODS[method].text} for {shape['dim']}-D block reaching, a baseline of the Legibility "
        f"Modulator: two states and a goal to a chunk of {shape['chunk']} actions, of which "
        f"{shape['execute']} are executed.",
        "## Training",
        _demonstrated(record, shape["dim"]),
        _trained(record, "{batch:,} moments of demonstrations"),
    ]
    if shape["guidance"] > 0:
        tuning = results.get("tuning", {}).get(name)
        if tuning is None:
            raise InvalidInputError(f"there is no tuning-{name}.json beside the other results")
        _check(f"tuning-{name}", tuning["model"], name, "goal", config)
        parts += ["## Guidance", _tuned(name, shape, tuning["result"]["tuning"])]
    table = Table("", "success", "L_d over oracle", "L_p over oracle")
    for kind in ("table1", "unseen"):
        for environment, document in results.get(kind, {}).items():
            for used in document["baselines"]:
                if used["name"] == name:
                    _check(f"{kind}-{environment}", used, name, "goal", config)
                    _add_comparison(table, kind, method, document["result"])
    if table.rows:
        parts += ["## Metrics", "At ℓ = 1; on held-out scenes medians.", table, _POINTER]
    return [
        *parts,
        "## Limits",
        "It is trained on stage 2's demonstrations, which reach goals in many random scenes in all "
        "ways, with stage 2's budget and network size, and not, as by its authors, on "
        "demonstrations of a single scene; it does not reach the paper's numbers.",
    ]


def _add_comparison(table: Table, kind: str, method: str, result: dict[str, Any]) -> None:
    metrics = ("distance_score", "potential_cost")
    values, world = result["methods"][method], WORLDS[result["env"]]
    if kind == "unseen":
        ratios = (number(values["ratio"][m]["median"]) for m in metrics)
        table.add_row(f"held-out scenes, {world}", percent(values["success"]["mean"]), *ratios)
        return
    for letter, target in values["targets"].items():
        ratios = (number(target[m]["mean"] / result["oracle"][letter][m]) for m in metrics)
        table.add_row(
            f"Table I toward {letter}, {world}", percent(target["success"]["mean"]), *ratios
        )


def _tuned(name: str, shape: dict[str, Any], tuning: list[dict[str, float]]) -> str:
    """The chosen guidance and the rule of the choice."""
    chosen = {key: shape[key] for key in ("guidance", "guidance_decay", "guidance_share")}
    best = next((row for row in tuning if chosen.items() <= row.items()), None)
    if best is None:
        raise InvalidInputError(f"tuning-{name}.json has no row of the chosen guidance {chosen}")
    needed = min(0.99, max(row["success"] for row in tuning))
    most = max(tuning, key=lambda row: row["achieved"])
    return (
        "ε̂ = (1 + w) ε(g*) − a w ε(g⁻) − (1 − a) w ε(∅), w ← γ w after every executed chunk "
        "(Bronars, Cheng and Xu 2024), with the mean over several g⁻. Of "
        f"{len(tuning)} combinations tried on validation scenes (`results/tuning-{name}.json`), "
        f"this is the most legible one that reaches the goal in {needed:.0%} of them: w = "
        f"{best['guidance']:g}, γ = {best['guidance_decay']:g}, a = {best['guidance_share']:g}, "
        f"with {best['success']:.1%} success and a mean achieved ℓ of {best['achieved']:.3f}. The "
        f"most legible of all (w = {most['guidance']:g}, γ = {most['guidance_decay']:g}, a = "
        f"{most['guidance_share']:g}) achieves {most['achieved']:.3f} with {most['success']:.1%} "
        "success."
    )


def _demonstrated(record: TrainingRecord, dim: int) -> str:
    """The demonstrations that a policy learned from."""
    shown = record.demonstrations or {}
    scenes = shown["demonstrated"] or record.data["scenes"]
    return (
        f"{shown['number']:,} demonstrations, {shown['demonstrations']} in each of {scenes:,} "
        "scenes of the same data: a feedback controller follows paths of the archive in "
        f"{'BlockReach2D' if dim == 2 else 'PandaBlockReach, on MuJoCo'}, with noise of "
        f"{1e3 * shown['noise']:g} mm a step and, in {shown['pushed']:.0%}, a push of "
        f"{1e2 * shown['push']:g} cm. SHA-256 over the shards: `{record.digest}`."
    )


def _trained(record: TrainingRecord, batch: str) -> str:
    """The size and the duration of a training; `batch` describes a batch."""
    settings = record.training
    alone = settings["steps"] * record.step_seconds / 60
    return (
        f"{record.parameters:,} parameters; {settings['steps']:,} batches of "
        f"{batch.format(**settings)}, seed {settings['seed']}, in {record.seconds / 60:.0f} "
        f"minutes on {record.device} ({threads_of(vars(record))}, PyTorch {record.torch}), "
        "validation included. The machine is shared: at the speed of the fastest tenth of the log "
        f"the batches alone take {alone:.0f} minutes."
    )


def _check(stem: str, used: dict[str, str], name: str, stage: str, config: dict[str, Any]) -> None:
    if used.get(stage) != config[stage]["sha256"]:
        raise InvalidInputError(f"{stem}.json is a result of other weights than {name}")
