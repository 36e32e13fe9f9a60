"""The controller in a loop: smoothness, delay and legibility when it replans.

A simulated robot realises a hidden share of each displacement, with a hidden lag. It is disturbed
once on its way. The rival is a planner without memory: a new plan from the present position, with
the same ℓ.
"""

import time
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from ..checks import Array
from ..controller import Controller
from ..curves import arc_length, resample, turning
from ..errors import InvalidSceneError
from ..intent.metrics import SCORE_POINTS
from ..modulator import Modulator
from ..motion.archive import Archive, build_archive
from ..obstacles import Ball
from ..parallel import threads
from ..scene import Scene
from ..seeds import plan_seeds, stream_seed
from .common import Progress, each_of, rounded, silent
from .configuration import ControllerConfig
from .statistics import share_interval, summary


class Row(NamedTuple):
    """A disturbance, and the answer to it."""

    text: str  # name in tables
    event: str | None
    memoryless: bool = False  # answered by a new plan from the present position


ROWS = {
    "undisturbed": Row("undisturbed", None),
    "asked": Row("asked to replan, nothing has changed", "ask"),
    "asked, anew": Row("the same, a new plan", "ask", memoryless=True),
    "pushed": Row("pushed", "push"),
    "pushed, anew": Row("the same, a new plan", "push", memoryless=True),
    "goal moved": Row("the target moved", "goal"),
    "goal moved, anew": Row("the same, a new plan", "goal", memoryless=True),
    "obstacle": Row("an obstacle on the path", "obstacle"),
    "obstacle, anew": Row("the same, a new plan", "obstacle", memoryless=True),
}
"""The rows of the table, by name."""

_GAIN, _LAG = (0.6, 0.9), (0.0, 0.3)  # of the robots, drawn
_MOMENT = 0.2, 0.7  # of the event: share of the plan's length that is behind, drawn
_DISTANCE = 2.0  # of a push and of the target's move, in displacements of 50 ms in the plane
_RADII, _PLACE = (0.04, 0.02), 0.6  # of an obstacle, over the diagonal, and its share of the rest
_SECONDS = 20.0
_MOVING = 0.1  # least displacement, over the largest, that has a direction


def evaluate_controller(
    modulator: Modulator,
    config: ControllerConfig,
    *,
    workers: int = 1,
    cluster: str | None = None,
    progress: Progress = silent,
) -> dict[str, Any]:
    """Let the controller move robots in held-out scenes, of which each is disturbed once.

    Every row of `ROWS` has the same scenes, levels, robots and moments. Arguments as of
    `evaluate_dial`; more than one worker makes steps slower.

    Returns:
        `rows`: for each of `ROWS` the number of `motions`; `success` with its interval; the
        `error` of ℓ of the whole motion, in the scene as it is at the end; the angle [degrees]
        between the displacements before and after each new path (`turn`), where the robot moves by
        a tenth of the largest displacement or more; the angle [rad] that
        motions turn through (`turned`); the time of a step [ms] (`step`); the time [s] from the
        event until the last new path (`delay`); steps in contact (`contacts`). Of `turn`, `step`
        and `delay` the `median`, the 99th `percentile` and the `greatest`.
    """
    measure = partial(_measure, modulator, config)
    found = each_of(list(range(config.scenes)), measure, workers, cluster, progress)
    rows: dict[str, Any] = {}
    for name in ROWS:
        motions = [scene[name] for scene in found if name in scene]
        success = np.array([motion["success"] for motion in motions])
        rows[name] = {
            "motions": len(motions),
            "success": {"mean": float(success.mean()), "interval": share_interval(success)},
            "error": summary(np.array([motion["error"] for motion in motions])),
            "turned": summary(np.array([motion["turned"] for motion in motions])),
            "contacts": sum(motion["contacts"] for motion in motions),
            **{key: _spread([motion[key] for motion in motions]) for key in _SPREADS},
        }
    return rounded({"rows": rows, "dt": modulator_dt(modulator, config)})


_SPREADS = ("turn", "step", "delay")


def modulator_dt(modulator: Modulator, config: ControllerConfig) -> float:
    """Duration of a step [s]."""
    from ..envs import vector_type

    own = 1 / vector_type(None, modulator.config.dim).metadata["render_fps"]
    return own if config.dt is None else config.dt


def _spread(values: list[list[float]]) -> dict[str, float] | None:
    """Median, 99th percentile and greatest of all values of all motions, if there are any."""
    every = np.concatenate(values) if values else np.empty(0)
    if not len(every):
        return None
    return {
        "median": float(np.median(every)),
        "percentile": float(np.percentile(every, 99)),
        "greatest": float(every.max()),
    }


@threads(1)
def _measure(modulator: Modulator, config: ControllerConfig, index: int) -> dict[str, Any]:
    """The metrics of each row in a scene; an obstacle that has no room is left out."""
    source = config.stream(modulator.config.dim)
    judge = source.archive(index, modulator.config.observer)
    plan_seed, robot_seed = plan_seeds(config.seed, index, 2)
    seed = stream_seed("evaluation", config.seed, index, "archive")
    found: dict[str, Any] = {}
    for name, row in ROWS.items():
        rng = np.random.default_rng(robot_seed)
        level = float(rng.uniform(-1, 1))
        controller = modulator.controller(
            judge.scene, 0, level, seed=plan_seed, observer=judge.observer, dt=config.dt,
            budget=config.budget,
        )  # fmt: skip
        try:
            motion = _Motion(modulator, controller, row, rng, config)
        except InvalidSceneError:
            continue
        found[name] = motion.metrics(level, judge, seed)
    return found


class _Motion:
    """One motion of a simulated robot.

    Raises:
        InvalidSceneError: the event has no room in the scene.
    """

    def __init__(
        self,
        modulator: Modulator,
        controller: Controller,
        row: Row,
        rng: np.random.Generator,
        config: ControllerConfig,
    ) -> None:
        self.controller, self.level = controller, float(controller.path.legibility)
        self.modulator, self.config = modulator, config
        gain, lag, moment = (rng.uniform(*span) for span in (_GAIN, _LAG, _MOMENT))
        direction = rng.standard_normal(controller.scene.dim)
        direction *= _DISTANCE * controller.limit / np.linalg.norm(direction)
        scene = self.scene = controller.scene
        event = float(moment * controller.path.length)
        position, velocity, travelled = scene.start, np.zeros(scene.dim), 0.0
        self.states, self.contacts, self.done = list[Array](), 0, False
        self.times, self.turns, self.delays = list[float](), list[float](), list[float]()
        least = _MOVING * controller.limit
        happened = None if row.event else -1
        before, known = None, 0
        for number in range(round(_SECONDS / controller.dt)):
            answer = 0.0
            if happened is None and travelled >= event:
                happened = number
                if row.event == "push":
                    position = np.clip(position + direction, *scene.workspace)
                elif row.event != "ask":
                    scene = self.scene = _changed(row.event, self.controller, position, direction)
                started = time.perf_counter()
                if row.memoryless:
                    self._restart(position)
                    known = -1
                elif row.event == "ask":
                    self.controller.replan()
                answer = time.perf_counter() - started
            started = time.perf_counter()
            action = self.controller.step(
                position, scene if scene is not controller.scene else None
            )
            self.times.append(1e3 * (time.perf_counter() - started + answer))
            self.states.append(position)
            self.contacts += bool(scene.clearance_at(position, 0) < -1e-9)
            self.done = self.controller.done
            if self.done or self.controller.stalled:
                break
            if len(self.controller.replans) > known:
                known = len(self.controller.replans)
                if before is not None and min(map(np.linalg.norm, (before, action))) > least:
                    self.turns.append(_angle(before, action))
                self.delays.append((number - (happened or 0)) * controller.dt)
            before = action
            velocity = (1 - lag) * gain * action + lag * velocity
            moved = np.clip(position + velocity, *scene.workspace)
            travelled += float(np.linalg.norm(moved - position))
            velocity, position = moved - position, moved

    def _restart(self, position: Array) -> None:
        """Let a new controller go on, as if nothing had been before."""
        self.controller = self.modulator.controller(
            self.scene.starting_at(position), 0, self.level, observer=self.controller.path.observer,
            dt=self.config.dt, budget=self.config.budget,
        )  # fmt: skip

    def metrics(self, level: float, judge: Archive, seed: np.random.SeedSequence) -> dict[str, Any]:
        """Of the motion, read by an archive of the scene as it is now."""
        if self.scene is not judge.scene:
            judge = build_archive(
                self.scene.starting_at(judge.scene.start), observer=judge.observer, seed=seed
            )
        states = resample(np.array(self.states), SCORE_POINTS)
        score = judge.observer.score(states, judge.scene, 0)
        return {
            "success": self.done,
            "error": abs(float(judge.label_of(score)) - level),
            "turned": float(turning(states)),
            "contacts": self.contacts,
            "turn": self.turns,
            "step": self.times,
            "delay": self.delays[-1:],
        }


def _changed(event: str | None, controller: Controller, position: Array, move: Array) -> Scene:
    """The scene after its target has moved, or with an obstacle on the rest of the path.

    Raises:
        InvalidSceneError: there is no room for that.
    """
    scene = controller.scene
    if event == "goal":
        goals = scene.goals.copy()
        goals[0] = np.clip(goals[0] + move, *scene.workspace)
        changed = replace(scene, goals=goals)
        changed.check_target(0)
        return changed
    rest = controller.path.trajectory(2 * SCORE_POINTS)
    rest = rest[np.linalg.norm(rest - position, axis=-1).argmin() :]
    if len(rest) > 1 and arc_length(rest) > 0:
        place = resample(rest, 101)[round(100 * _PLACE)]
        for share in _RADII:
            ball = Ball(place, share * scene.diagonal)
            if ball.signed_distance(position) < _DISTANCE * controller.limit:
                continue
            try:
                changed = replace(scene, obstacles=(*scene.obstacles, ball))
                changed.check_target(0)
                build_archive(changed.starting_at(position), max_candidates=4096)
            except InvalidSceneError:
                continue
            return changed
    raise InvalidSceneError("there is no room for an obstacle on the path")


def _angle(first: Array, second: Array) -> float:
    """Between two vectors [degrees]."""
    sizes = np.linalg.norm(first) * np.linalg.norm(second)
    return float(np.degrees(np.arccos(np.clip(first @ second / sizes, -1, 1))))
