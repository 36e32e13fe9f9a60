"""Table I as the paper has it: all networks learn in the table's scene alone, from the same data.

Diffusion Policy, Legibility Diffuser and both stages of the modulator learn from demonstrations
toward R and G; what each has to choose is then tuned for either target. What a user of the
modulator gets is also refined with ready-made curves, so its network has a row of its own.
"""

import copy
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..curves import path_curve
from ..data.configuration import DatasetConfig, DemonstrationsConfig, targets_of
from ..data.dataset import Dataset, generate
from ..data.demonstrations import Demonstrations, demonstrate
from ..envs import environment_dim, vector_type
from ..intent.metrics import SCORE_POINTS
from ..models.goal_policy import GoalPolicy
from ..models.path_diffuser import PathDiffuser
from ..models.path_policy import PathPolicy
from ..modulator import Modulator
from ..motion.archive import Archive
from ..parallel import pool, threads
from ..rollout import Rollout
from ..training.configuration import PathTrainingConfig, PolicyTrainingConfig
from ..training.loop import Run
from ..training.path import train_path
from ..training.policy import best_guidance, train_policy, try_guidance
from ..training.team import Team
from .common import Parts, gather, world
from .comparison import (
    METRICS,
    SCENES,
    TARGETS,
    TESTED,
    TableScene,
    measured,
    table_archives,
    table_jobs,
    table_of,
)
from .configuration import SingleSceneConfig
from .contest import BASELINE, METHODS, Contest, Job

GUIDED = "legibility diffuser"
_TUNED_FOR = {GUIDED: "distance_score", f"{GUIDED}, L_p": "potential_cost"}
ROWS = {
    "straight line": METHODS["straight line"].text,
    BASELINE: METHODS[BASELINE].text,
    **{row: f"{METHODS[GUIDED].text}, tuned for {METRICS[m]}" for row, m in _TUNED_FOR.items()},
    "network": METHODS["network"].text,
    "modulator": METHODS["modulator"].text,
}
"""The compared methods. Legibility Diffuser has two rows, because its best L_d is not its best L_p:
far from the other goal is not where the goal is clear."""

GUIDANCE = {
    "guidance": (2.5, 5.0, 10.0, 25.0, 40.0, 80.0, 160.0),
    "guidance_decay": (0.4, 0.6, 0.8, 0.9, 0.95, 1.0),
    "guidance_share": (0.5, 0.9, 1.0),
}
"""The settings of Legibility Diffuser to try: with one scene its weight may be large."""

EXECUTE = (1, 2, 8)
"""Other numbers of actions of a chunk to execute, with the best of `GUIDANCE`."""

OWN_GUIDANCE = (0.0, 0.3, 1.0, 2.0, 4.0)
"""The weights of stage 1's guidance to try."""

_TRAJECTORIES = 8  # of a scene in a batch of stage 1


class Learned(NamedTuple):
    """What one scene's data have taught."""

    plain: GoalPolicy
    guided: Sequence[GoalPolicy]  # of several trainings; of one, tuned, where it is executed
    path: PathDiffuser
    policy: PathPolicy


def evaluate_single_scene(
    folder: str | Path,
    config: SingleSceneConfig | None = None,
    *,
    workers: int = 1,
    cluster: str | None = None,
    progress: Callable[[int, int, str], None] = lambda done, total, line: None,
) -> dict[str, Any]:
    """Make the data, train and tune all methods, and execute them, in the scene of Table I.

    Interrupted, the same call resumes: data and trainings in `folder` are kept.

    Args:
        folder: of the data and of each training's checkpoint and log.
        config: the settings.
        workers, cluster: see `pool`; the result does not depend on them.
        progress: called with the steps and rollouts done, that of all, and a line where something
            is finished.

    Returns:
        `methods`, `tests`, `scene`, `spacing` and `unit` as of `evaluate_table1`; `demonstrated`:
        toward either target the best value of each of `METRICS` among the demonstrated paths;
        `tuning`: toward either target what was chosen for Legibility Diffuser's rows and, on its
        network's own paths, for the modulator's, and all that was tried;
        `training`: of each network the seconds, the parameters and the last metrics; `data`: the
        digests of the data and of the demonstrations.

    Raises:
        CheckpointError: the folder holds runs with other settings.
        DatasetError: the folder holds data with other settings.
    """
    config, folder = config or SingleSceneConfig(), Path(folder)
    kind = vector_type(config.env, environment_dim(config.env))
    place = SCENES[kind.dim]
    settings = int(np.prod([len(values) for values in GUIDANCE.values()]))
    tried = len(OWN_GUIDANCE) + config.networks * settings + len(_TUNED_FOR) * len(EXECUTE)
    total = (3 + config.networks) * config.training_steps + 2 * (tried * config.tuning_rollouts)
    total += len(ROWS) * len(TARGETS) * config.rollouts
    parts = Parts(progress, total)
    data, validation, shown = _data(folder, place, config, workers, cluster)
    models, training = _trained(folder, config, data, validation, shown, parts)
    archives, jobs = table_archives(_modulator(models), place), table_jobs(place, config)
    motions: dict[tuple[str, str], list[Rollout]] = {}
    tuning: dict[str, Any] = {}
    with pool(workers, cluster) as each:
        items = list(archives.items())
        tune = partial(_tuned, models, data, config, place, GUIDANCE, OWN_GUIDANCE)
        report, tuned = parts.next(len(items) * tried * config.tuning_rollouts), 0

        def advance(_: Any) -> None:
            nonlocal tuned
            tuned += 1
            report(tuned, len(items))

        for letter, (best, tuning[letter]) in zip(
            TARGETS, gather(each, tune, items, advance), strict=True
        ):
            for row in ROWS:
                own = best.get(row, best["network"])
                policies = {BASELINE: own.plain, GUIDED: own.guided[0]}
                contest = Contest(_modulator(own), policies, kind, (1, 1))
                work = [(GUIDED if row in _TUNED_FOR else row, jobs[letter], [])]
                (motions[row, letter],) = contest.motions(work, each, parts.next(config.rollouts))
            parts.tell(f"toward {letter}: all rows executed")
    return {
        **table_of(place, archives, motions, {}),
        "env": world(kind),
        "demonstrated": {
            letter: _best(data, shown, target, archives[letter], place)
            for letter, target in TARGETS.items()
        },
        "tuning": tuning,
        "training": training,
        "data": {"paths": data.digest, "demonstrations": shown.digest},
    }


def _data(
    folder: Path, place: TableScene, config: SingleSceneConfig, workers: int, cluster: str | None
) -> tuple[Dataset, Dataset, Demonstrations]:
    """Paths, others for validation, and the demonstrations of the former."""
    source = DatasetConfig(
        regime="paper", views=1, per_scene=config.demonstrations, seed=config.seed,
        given=targets_of(place.scene),
    )  # fmt: skip
    spread: dict[str, Any] = {"workers": workers, "cluster": cluster}
    data = generate(source, folder / "data", **spread)
    validation = generate(source.for_validation(), folder / "validation", **spread)
    shown = DemonstrationsConfig(demonstrations=config.demonstrations)
    return data, validation, demonstrate(folder / "data", shown, **spread)


def _trained(
    folder: Path,
    config: SingleSceneConfig,
    data: Dataset,
    validation: Dataset,
    shown: Demonstrations,
    parts: Parts,
) -> tuple[Learned, dict[str, Any]]:
    """All networks, trained on the same data, and how that went."""
    steps, team = config.training_steps, Team.join("cpu")
    common: dict[str, Any] = {"steps": steps, "seed": config.seed, "warmup": min(300, steps)}

    def run(name: str) -> Run:
        return Run(folder / name, team, parts.next(steps))

    def policy(stage: str, name: str, dropout: float, seed: int = config.seed) -> Any:
        own = {**common, "seed": seed}
        settings = PolicyTrainingConfig(**own, batch=config.batch, dropout=dropout)
        return train_policy(shown, validation, run(name), settings, stage=stage)

    scenes = config.batch // _TRAJECTORIES
    settings = PathTrainingConfig(**common, scenes=scenes, per_scene=_TRAJECTORIES)
    guided = [f"legibility-diffuser-{number}" for number in range(config.networks)]
    trained = {
        "diffusion-policy": policy("goal", "diffusion-policy", 0.0),
        **{n: policy("goal", n, 0.2, config.seed + i) for i, n in enumerate(guided)},
        "path": train_path(data, validation, run("path"), settings),
        "policy": policy("policy", "policy", 0.1),
    }
    records = {
        name: {
            "seconds": t.record.seconds, "parameters": t.record.parameters,
            "training": t.record.training, "last": t.metrics,
        }
        for name, t in trained.items()
    }  # fmt: skip
    made = {name: t.model.eval().requires_grad_(False) for name, t in trained.items()}
    tried = [made[name] for name in guided]
    return Learned(made["diffusion-policy"], tried, made["path"], made["policy"]), records


def _modulator(models: Learned) -> Modulator:
    return Modulator(models.path, models.policy, "single-scene")


@threads(1)
def _tuned(
    models: Learned,
    data: Dataset,
    config: SingleSceneConfig,
    place: TableScene,
    grid: Mapping[str, Sequence[float]],
    own: Sequence[float],
    item: tuple[str, Archive],
) -> tuple[dict[str, Learned], dict[str, Any]]:
    """The tuned models for a target, by the rows that they are tuned for, and what was tried."""
    letter, archive = item
    target, number = TARGETS[letter], config.tuning_rollouts
    scenes = [data.scenes[target]] * number

    def worth(rollouts: list[Rollout]) -> dict[str, float]:
        rows = [measured(r.states, archive, place.spacing, place.unit) for r in rollouts]
        return {metric: float(np.mean([row[metric] for row in rows])) for metric in TESTED}

    def tried(number: int, grid: Mapping[str, Sequence[float]]) -> list[dict[str, float]]:
        found = try_guidance(models.guided[number], scenes, data.observers[target], grid, worth)
        return [{"network": number, **row} for row in found]

    long = models.guided[0].config.execute
    first = [row for i in range(config.networks) for row in tried(i, {**grid, "execute": (long,)})]
    names, tuned, tuning = ["network", "execute", *grid], {}, {}
    for name, metric in _TUNED_FOR.items():
        rows = first.copy()
        best = best_guidance(rows, names, lambda row, m=metric: TESTED[m] * row[m])
        for execute in EXECUTE:  # of equal decay in a step
            decay = best["guidance_decay"] ** (execute / long)
            other = {**best, "execute": execute, "guidance_decay": decay}
            rows += tried(other.pop("network"), {key: (value,) for key, value in other.items()})
        chosen = best_guidance(rows, names, lambda row, m=metric: TESTED[m] * row[m])
        guided = copy.copy(models.guided[int(chosen["network"])])
        guided.config = replace(guided.config, **{k: chosen[k] for k in names if k != "network"})
        tuned[name] = models._replace(guided=[guided])
        tuning[name] = {"chosen": chosen, "tried": rows}

    kind = vector_type(config.env, place.scene.dim)
    jobs = [Job(place.scene, target, 1.0, seed, seed) for seed in range(number)]
    rows = []
    for weight in own:
        contest = Contest(_modulator(_guided_by(models, weight)), {}, kind, (1, 1))
        with pool() as each:
            (moved,) = contest.motions([("network", jobs, [])], each)
        success = float(np.mean([r.success for r in moved]))
        rows.append({"guidance": weight, "success": success, **worth(moved)})
    chosen = best_guidance(rows, ["guidance"], lambda row: row["distance_score"])
    tuned["network"] = _guided_by(models, chosen["guidance"])
    tuning["network"] = {"chosen": chosen, "tried": rows}
    return tuned, tuning


def _guided_by(models: Learned, weight: float) -> Learned:
    """The models with another weight of stage 1's guidance."""
    path = copy.copy(models.path)
    path.config = replace(path.config, guidance=weight)
    return models._replace(path=path)


def _best(
    data: Dataset, shown: Demonstrations, target: int, archive: Archive, place: TableScene
) -> dict[str, float]:
    """The best of each metric of the demonstrated paths toward a target."""
    toward = np.isclose(shown.paths[:, -1], data.scenes[target].goals[0]).all(-1)
    curves = path_curve(shown.paths[toward], SCORE_POINTS)
    rows = [measured(curve, archive, place.spacing, place.unit) for curve in curves]
    best = {"distance_score": max, "achieved": max}
    return {name: best.get(name, min)(row[name] for row in rows) for name in METRICS}
