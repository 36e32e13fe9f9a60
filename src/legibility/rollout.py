"""Closed-loop execution: robots follow their paths until each reaches its goal or is stopped."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from .checks import Array
from .curves import NUM_WAYPOINTS, resample
from .drivers import Driver
from .envs.fleet import Fleet
from .envs.guard import CORRECTED
from .errors import InvalidInputError, InvalidSceneError
from .intent.metrics import SCORE_POINTS, time_to_confidence
from .models.continuation import Rest
from .motion.path import Path
from .pilot import Pilot

if TYPE_CHECKING:
    from .motion.timed import Motion
    from .robots.arm import Arm

Replan = Callable[[int, Rest], Path]
"""The new rest of the motion of a robot, given its index."""

PATIENCE = 2.0
"""Time without progress after which a robot is stopped [s]."""

RESTARTS = 3
"""How often new paths restart that time, for a robot that leaves them as well."""

_LOST = 6.0
_LEAST_PATIENCE = 10  # steps, of a robot whose steps are long


@dataclass(frozen=True, eq=False)
class Rollout:
    """One executed motion.

    Attributes:
        path: the path as first planned; its scene is the scene at the start.
        states: `(T + 1, D)` [m], positions from the start on.
        actions: `(T, D)` [m], the displacements that were sent.
        success: whether the robot reached its goal, as the environment judges.
        reason: why it ended: `reached`, `stalled` (no progress along the path), `lost` (far from
            the path), `time` (the environment's limit on steps) or `ended` (by an environment of
            your own, for a reason of its own).
        replans: the steps at which a new path was planned.
        deviation: `(T,)` [m], distance from the path that was followed at the time.
        step_seconds: duration of a control step [s].
        wall_contacts: steps in which a wall of the workspace stopped the robot, or after which one
            of your own environment was beyond it.
        contacts: steps in which the end effector ran into an obstacle, or within the scene's
            `goal_radius` of a block that is not the target.
        corrections: steps in which `safe_actions` changed the driver's action.
        joint_angles: `(T + 1, J)` [rad], of an arm; J = 0 where there is none.
        counts: other events that the environment counted, by name.
    """

    path: Path
    states: Array
    actions: Array
    success: bool
    reason: str
    replans: tuple[int, ...]
    deviation: Array
    step_seconds: float
    wall_contacts: int
    contacts: int
    corrections: int
    joint_angles: Array = field(default_factory=lambda: np.empty((0, 0)))
    counts: dict[str, int] = field(default_factory=dict)

    @property
    def legibility(self) -> float:
        """ℓ as asked."""
        return float(self.path.legibility)

    @cached_property
    def jerk(self) -> float:
        """Root mean square of the third derivative of the position [m/s³], 0 of fewer than 4."""
        third = np.diff(self.states, n=3, axis=0) / self.step_seconds**3
        return float(np.sqrt((third**2).sum(-1).mean())) if len(third) else 0.0

    def motion(self, arm: "Arm | None" = None) -> "Motion":
        """The executed motion at the control steps; with the `arm` that moved, also its joints."""
        from .motion.timed import Motion

        return Motion.recorded(self.path, self.states, self.step_seconds, self.joint_angles, arm)

    def trajectory(self, num_points: int = SCORE_POINTS) -> Array:
        """The motion at equal arc length, `(num_points, D)` [m]."""
        return resample(self.states, num_points)

    @property
    def posterior(self) -> Array:
        """P(g) of each goal at each state as the observer reads it, `(T + 1, G)`."""
        return self.path.field.posterior(self.states)

    @property
    def time_to_confidence(self) -> float:
        """Time [s] after which P(target) ≥ 0.8 for good, inf if never; lower = better."""
        progress = float(time_to_confidence(self.posterior, self.path.target))
        return round(progress * len(self.actions) * self.step_seconds, 9)

    @cached_property
    def score(self) -> float:
        """`legibility_score` of the executed motion; higher = more legible."""
        path = self.path
        return float(path.observer.score(self.trajectory(), path.scene, path.target))

    @property
    def achieved(self) -> float:
        """The label in [−1, 1] that the executed motion achieves in the scene's archive."""
        return float(self.path.archive.label_of(self.score))

    def to_dict(self) -> dict[str, Any]:
        """Values for a report; `deviation` is the mean."""
        return {
            "legibility": self.legibility,
            "achieved": self.achieved,
            "achieved_by_plan": float(self.path.achieved),
            "score": self.score,
            "success": self.success,
            "reason": self.reason,
            "replans": self.replans,
            "deviation": self.deviation.mean(),
            "wall_contacts": self.wall_contacts,
            "contacts": self.contacts,
            "corrections": self.corrections,
            "counts": self.counts,
            "time_to_confidence": self.time_to_confidence,
            "waypoints": self.path.waypoints,
            "states": self.states,
            "actions": self.actions,
            "posterior": self.posterior,
        }


@np.errstate(under="ignore")
def follow(
    fleet: Fleet,
    paths: list[Path],
    driver: Driver,
    replan: Replan | None = None,
    tolerance: float = np.inf,
) -> list[Rollout]:
    """Let the robots follow their paths until each has reached its goal or is stopped.

    Every action passes `safe_actions` before it is sent, whatever the driver returns. A robot
    that makes no progress for two seconds is stopped, and so is one far from its path, unless it
    may replan.

    Args:
        fleet: `B` robots.
        paths: a path for each, from its position.
        driver: moves them.
        replan: gives a new rest of the motion to robots that a push has taken off their paths by
            more than `tolerance` and to robots whose scene has changed; without it they go back.
            Where there is no way, they keep to their old paths, and off what is in the way.
        tolerance: [m].

    Raises:
        InvalidInputError: a path is not finite, has other waypoints, or starts or ends elsewhere.
    """
    _check_paths(paths, fleet)
    run = _Run(fleet, paths, driver)
    while run.active.any():
        run.step(run.next_actions())
        run.stop_ended(may_replan=replan is not None)
        if replan is not None:
            run.replan(replan, tolerance)
    return run.rollouts(paths)


class _Run:
    """The state of `B` robots while they follow their paths, and the record of their motions."""

    def __init__(self, fleet: Fleet, paths: list[Path], driver: Driver) -> None:
        size = fleet.size
        self.fleet = fleet
        self.pilot = Pilot(paths, driver, fleet.positions, fleet.limit, fleet.workspace)
        self.active = np.ones(size, dtype=bool)
        self.success, self.terminated, self.truncated = np.zeros((3, size), dtype=bool)
        self.scenes = fleet.scenes  # for which the paths were planned
        self.reasons = np.full(size, "", dtype=object)
        self.steps, self.restarts = np.zeros((2, size), dtype=int)
        self.wall_contacts, self.contacts, self.corrections = np.zeros((3, size), dtype=int)
        self.replans: list[list[int]] = [[] for _ in range(size)]
        self.counts = {name: np.zeros(size, dtype=int) for name in fleet.counts}
        self.states, self.joint_angles = [fleet.positions], [fleet.joint_angles]
        self.actions, self.deviations = list[Array](), list[Array]()

    def next_actions(self) -> Array:
        """The next displacement of each robot, made safe, `(B, D)` [m]; 0 for those that ended."""
        pilot = self.pilot
        wanted = pilot.wanted(self.active)
        actions = self.fleet.safe(wanted, pilot.positions, pilot.displacements)
        actions[~self.active] = 0
        self.corrections += ~(np.abs(actions - wanted) <= CORRECTED).all(-1)  # NaN is corrected
        return actions

    def step(self, actions: Array) -> None:
        """Send the actions and record the step."""
        fleet, active = self.fleet, self.active
        self.success, self.terminated, self.truncated = fleet.step(actions, active)
        positions = np.where(active[:, None], fleet.positions, self.pilot.positions)
        self.pilot.moved(positions, actions)
        self.states.append(positions)
        self.joint_angles.append(fleet.joint_angles)
        self.actions.append(actions)
        self.deviations.append(self.pilot.deviation)
        self.steps += active
        self.wall_contacts += active & fleet.wall_contacts
        self.contacts += active & fleet.contacts
        for name, number in fleet.counts.items():
            self.counts[name][active] = number[active]

    def stop_ended(self, *, may_replan: bool) -> None:
        """Note why robots end that do; one may be lost only on a path that it keeps to."""
        fleet, pilot = self.fleet, self.pilot
        lost = np.zeros_like(self.active)
        if pilot.driver.with_path and not may_replan:
            lost = pilot.deviation > _LOST * fleet.limit
        stalled = pilot.idle >= max(_LEAST_PATIENCE, round(PATIENCE / fleet.step_seconds))
        reasons = {
            "reached": self.success, "time": self.truncated, "ended": self.terminated,
            "lost": lost, "stalled": stalled,
        }  # fmt: skip
        for reason, happened in reasons.items():
            self.reasons[self.active & happened & (self.reasons == "")] = reason
        self.active &= self.reasons == ""

    def replan(self, plan: Replan, tolerance: float) -> None:
        """Give new paths to robots that were pushed off theirs or whose scene has changed."""
        fleet, pilot, scenes = self.fleet, self.pilot, self.fleet.scenes
        moved = np.linalg.norm(fleet.goals - pilot.goals, axis=-1) > 1e-9
        changed = np.array([now != then for now, then in zip(scenes, self.scenes, strict=True)])
        off = moved | changed | (pilot.deviation > tolerance)
        for row in np.flatnonzero(self.active & off).tolist():
            states = np.stack([positions[row] for positions in self.states])
            begun = scenes[row].starting_at(states[0])
            try:
                path = plan(row, pilot.rest(row, begun, scenes[row], states))
            except InvalidSceneError:
                continue
            self.scenes[row] = scenes[row]
            # A robot that leaves every new path as well restarts its stall timer only a few times.
            fresh = bool(moved[row] or self.restarts[row] < RESTARTS)
            pilot.take(row, path, fresh=fresh)
            self.restarts[row] += fresh
            self.replans[row].append(int(self.steps[row]))

    def rollouts(self, paths: list[Path]) -> list[Rollout]:
        """The motions of all robots, each up to its own end."""
        states, joint_angles = np.stack(self.states, 1), np.stack(self.joint_angles, 1)
        actions, deviations = np.stack(self.actions, 1), np.stack(self.deviations, 1)
        return [
            Rollout(
                path=path,
                states=states[i, : steps + 1],
                actions=actions[i, :steps],
                success=self.reasons[i] == "reached",
                reason=str(self.reasons[i]),
                replans=tuple(self.replans[i]),
                deviation=deviations[i, :steps],
                step_seconds=self.fleet.step_seconds,
                wall_contacts=int(self.wall_contacts[i]),
                contacts=int(self.contacts[i]),
                corrections=int(self.corrections[i]),
                joint_angles=joint_angles[i, : steps + 1],
                counts={name: int(number[i]) for name, number in self.counts.items()},
            )
            for i, (path, steps) in enumerate(zip(paths, self.steps.tolist(), strict=True))
        ]


def _check_paths(paths: list[Path], fleet: Fleet) -> None:
    """Raise unless every path is finite and leads from its robot to the intended goal."""
    shape = (NUM_WAYPOINTS + 2, fleet.workspace.shape[1])
    for path, position, goal in zip(paths, fleet.positions, fleet.goals, strict=True):
        if path.waypoints.shape != shape:
            raise InvalidInputError(
                f"a path must have waypoints of shape {shape}, got {path.waypoints.shape}"
            )
        if not np.isfinite(path.waypoints).all():
            raise InvalidInputError("a path must be finite, got one that is not")
        if np.linalg.norm(position - path.waypoints[0]) > fleet.limit:
            raise InvalidInputError(
                f"a path must start at the robot, {position.tolist()}, "
                f"got {path.waypoints[0].tolist()}"
            )
        if np.linalg.norm(goal - path.waypoints[-1]) > 1e-6:
            raise InvalidInputError(
                f"a path must end at the intended goal, {goal.tolist()}, "
                f"got {path.waypoints[-1].tolist()}"
            )
