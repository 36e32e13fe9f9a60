"""Model cards: how weights were made and how good they are."""

from collections.abc import Iterable
from typing import Any

from ..curves import NUM_WAYPOINTS
from ..errors import InvalidInputError
from ..evaluation.contest import METHODS
from ..models.hub import card_head
from ..models.provenance import TrainingRecord
from .results import Results, headline_table, model_index, well_formed
from .sections import threads_of
from .table import Part, markdown

_PAGE = "the repository's `docs/results.md`"


def render_card(name: str, config: dict[str, Any], results: Results) -> str:
    """The model card of the weights `name`, from the content of their `config.json`.

    Of `results`, the modulator needs `dial` in the regimes dragan and all and, with a stage 2,
    `closed-loop` and `execution`; Legibility Diffuser needs `tuning`.

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
        is_baseline = "goal" in records
        parts = (_baseline if is_baseline else _modulator)(name, config, records, results)
        tags = ["baseline"] if is_baseline else []
        measured = [] if is_baseline else model_index(_of_card(results, records), name)
        head = card_head(license="mit", tags=tags, model_index=measured)
        return f"{head}# {name}\n\n{markdown(parts)}\n"


def _of_card(results: Results, records: dict[str, TrainingRecord]) -> Results:
    """The results that the card of a modulator shows, which are of its stages."""
    kinds = ["dial", *(["closed-loop", "execution"] if "policy" in records else [])]
    return {kind: results.get(kind, {}) for kind in kinds}


def _modulator(
    name: str, config: dict[str, Any], records: dict[str, TrainingRecord], results: Results
) -> list[Part]:
    dials = [f"{name}-{regime}" for regime in ("dragan", "all")]
    shown = _of_card(results, records)
    for kind in shown:
        for found in dials if kind == "dial" else [name]:
            _result(results, kind, found, config, records if kind != "dial" else ["path"])
    path, record = config["path"]["config"], records["path"]
    observer, data = path["observer"], record.data
    stages = f"Stage 1, the path diffuser, turns start, goals and ℓ into {NUM_WAYPOINTS} waypoints."
    stage_2: list[Part] = []
    if "policy" in records:
        stages += " Stage 2, the path-guided policy, turns the path into actions, closed loop."
        stage_2 = ["## Training of stage 2", *_policy(records["policy"])]
    return [
        f"The Legibility Modulator for {path['dim']}-D block reaching. {stages} Load it with "
        f'`legibility.Modulator.from_pretrained("{name}")`.',
        "## Data",
        f"{data['scenes']:,} random scenes (regime `{data['regime']}`, stream `{data['stream']}`, "
        f"seed {data['seed']}), rooms of any size among them, empty or with obstacles, each seen "
        f"by {data['views']} random observers; for each of these {data['per_scene']} trajectories, "
        "chosen flat along ℓ from the scene's quality-diversity archive; labels "
        f"`{observer['label']}`, α = {observer['alpha']:g}, detour {observer['detour']:g}. SHA-256 "
        f"over the shards: `{record.digest}`.",
        "## Training of stage 1",
        *_stage_1(path, record),
        *stage_2,
        "## Metrics",
        headline_table(shown, {name: "value"}),
        f"All metrics with their intervals are in {_PAGE}.",
        "## Limits",
        "The observer is a model, not a person. Labels are ranks within a scene's archive: the "
        "same ℓ is another score in another scene, and for another observer. α, the detour and the "
        "kind of label are fixed.",
    ]


def _stage_1(path: dict[str, Any], record: TrainingRecord) -> list[Part]:
    """The training of stage 1, after that of its teacher if it was distilled."""
    batch = "{scenes} scenes × {per_scene} trajectories"
    teacher, settings = record.teacher, record.training
    if teacher is None:
        return [_trained(record, batch)]
    first = "The training of its teacher is not known."
    if known := teacher.training:
        first = f"The teacher, on data of SHA-256 `{known.digest}`: {_trained(known, batch)}"
    steps = path["sampling_steps"]
    return [
        first,
        f"A student that draws in {steps} step{'s' * (steps > 1)} without guidance was distilled "
        f"from {settings['pairs']} paths a scene of the teacher (SHA-256 `{teacher.sha256}`), "
        f"which draws in {teacher.sampling_steps} with guidance {teacher.guidance:g}: "
        f"{_trained(record, batch)}",
    ]


def _baseline(
    name: str, config: dict[str, Any], records: dict[str, TrainingRecord], results: Results
) -> list[Part]:
    method = next((m for m in METHODS if name.startswith(m.replace(" ", "-"))), None)
    if method is None:
        raise InvalidInputError(f"the name {name} is not that of a method")
    shape = config["goal"]["config"]
    parts: list[Part] = [
        f"{METHODS[method].text} for {shape['dim']}-D block reaching, a baseline of the Legibility "
        f"Modulator: two states and a goal to a chunk of {shape['chunk']} actions, of which "
        f"{shape['execute']} are executed.",
        "## Training",
        *_policy(records["goal"]),
    ]
    if shape["guidance"] > 0:
        tuning = _result(results, "tuning", name, config, ["goal"])["tuning"]
        chosen = {key: shape[key] for key in ("guidance", "guidance_decay", "guidance_share")}
        best = next((row for row in tuning if chosen.items() <= row.items()), None)
        if best is None:
            raise InvalidInputError(f"tuning-{name}.json has no row of the guidance {chosen}")
        needed = min(0.99, max(row["success"] for row in tuning))
        parts += [
            "## Guidance",
            "ε̂ = (1 + w) ε(g*) − a w ε(g⁻) − (1 − a) w ε(∅), w ← γ w after every executed chunk "
            "(Bronars, Cheng and Xu 2024), with the mean over several g⁻. Of "
            f"{len(tuning)} combinations on validation scenes (`results/tuning-{name}.json`), w = "
            f"{best['guidance']:g}, γ = {best['guidance_decay']:g}, a = {best['guidance_share']:g} "
            f"is the most legible that reaches the goal in {needed:.0%} of them: "
            f"{best['success']:.1%} success and a mean achieved ℓ of {best['achieved']:.3f}.",
        ]
    return [
        *parts,
        "## Metrics",
        f"Its comparison with the modulator is in {_PAGE}.",
        "## Limits",
        "It is trained on stage 2's demonstrations in many random scenes, and not, as by its "
        "authors, on those of a single scene; it does not reach the paper's numbers.",
    ]


def _policy(record: TrainingRecord) -> list[Part]:
    """The demonstrations and the training of a policy."""
    shown = record.demonstrations or {}
    scenes = shown["demonstrated"] or record.data["scenes"]
    return [
        f"{shown['number']:,} demonstrations, {shown['demonstrations']} in each of {scenes:,} "
        "scenes of the same data: a feedback controller follows paths of the archive, with noise "
        f"of {1e3 * shown['noise']:g} mm a step and, in {shown['pushed']:.0%}, a push of "
        f"{1e2 * shown['push']:g} cm. SHA-256 over the shards: `{record.digest}`.",
        _trained(record, "{batch:,} moments of demonstrations"),
    ]


def _trained(record: TrainingRecord, batch: str) -> str:
    """The size and the duration of a training; `batch` describes a batch."""
    settings = record.training
    return (
        f"{record.parameters:,} parameters; {settings['steps']:,} batches of "
        f"{batch.format(**settings)}, seed {settings['seed']}, in {record.seconds / 60:.0f} "
        f"minutes on {record.device} ({threads_of(vars(record))}, PyTorch {record.torch})."
    )


def _result(
    results: Results, kind: str, name: str, config: dict[str, Any], stages: Iterable[str]
) -> dict[str, Any]:
    """A result of the weights, whose hashes are checked."""
    document = results.get(kind, {}).get(name)
    if document is None:
        raise InvalidInputError(f"there is no {kind}-{name}.json beside the other results")
    if any(document["model"].get(stage) != config[stage]["sha256"] for stage in stages):
        raise InvalidInputError(f"{kind}-{name}.json is a result of other weights than {name}")
    return document["result"]
