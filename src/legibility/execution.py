"""Closing the loop: robots follow their paths in an environment, and somebody watches them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
import torch
from numpy.typing import NDArray

from .checks import Array, target_index
from .curves import NUM_WAYPOINTS, resample
from .envs.guard import safe_actions
from .errors import InvalidInputError
from .intent.metrics import SCORE_POINTS, legibility_score
from .models.diffusion import standard_normal
from .models.path_policy import Observation, PathPolicy
from .motion.tracking import PathTracker, feedback_action
from .path import Path

if TYPE_CHECKING:
    from .models.onnx import OnnxPathPolicy

__all__ = ["Driver", "Feedback", "Fleet", "Policy", "Replay", "Rollout", "follow"]

_PATIENCE = 2.0
_PROGRESS = 0.2
_LOST = 6.0
_PUSHES = 3


@dataclass(frozen=True, eq=False)
class Rollout:
    """One executed motion.

    Attributes:
        path: the path as first planned; its scene is the scene at the start.
        states: `(T + 1, D)` [m], positions from the start on.
        actions: `(T, D)` [m], the displacements that were sent.
        success: whether the environment says so.
        reason: why it ended: `reached`, `stalled` (no progress along the path), `lost` (far from
            the path) or `time` (the environment's limit on steps).
        replans: at which steps a new path was planned.
        deviation: `(T,)` [m], distance from the path that was followed at the time.
        step_seconds: time of a control step [s].
        wall_contacts: steps in which the motion would have left the workspace.
        joint_angles: `(T + 1, J)` [rad], of an arm; J = 0 where there is none.
        counts: what else the environment counted, by name: contacts and violations of an arm.
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
    joint_angles: Array = field(default_factory=lambda: np.empty((0, 0)))
    counts: dict[str, int] = field(default_factory=dict)

    @property
    def legibility(self) -> float:
        """ℓ as asked."""
        return float(self.path.legibility)

    def trajectory(self, num_points: int = SCORE_POINTS) -> Array:
        """The motion at equal arc length, `(num_points, D)` [m]."""
        return resample(self.states, num_points)

    @property
    def posterior(self) -> Array:
        """P(g) of each goal at each state as the observer reads it, `(T + 1, G)`."""
        return self.path.field.posterior(self.states)

    @cached_property
    def score(self) -> float:
        """`legibility_score` of the executed motion; higher = more legible."""
        path = self.path
        return float(legibility_score(self.trajectory(), path.field, path.target, path.alpha))

    @property
    def achieved(self) -> float:
        """The label in [−1, 1] that the executed motion achieves in the scene's archive."""
        return float(self.path.archive.label_of(self.score))


class Fleet:
    """One face for one environment, a vector of ours, or Gymnasium's `SyncVectorEnv`.

    Attributes:
        size: B, environments.
        limit: largest displacement of an action along each axis [m].
        lag: largest lag that the actuators may have.
        workspace: `(2, D)` [m].
        counted: names of what the environment counts over an episode.
        step_seconds: time of a control step [s].
    """

    def __init__(self, env: Any, seed: int) -> None:
        self._env = env
        inner: Any = getattr(env, "unwrapped", None)
        if hasattr(inner, "scenes"):
            self._parts = [inner]
        elif hasattr(inner, "batch"):
            self._parts = [inner.batch]
        elif hasattr(inner, "envs") and all(hasattr(e.unwrapped, "batch") for e in inner.envs):
            self._parts = [e.unwrapped.batch for e in inner.envs]
        else:
            raise InvalidInputError(
                f"env must be an environment of legibility or a vector of them, got {env}"
            )
        self._single = not hasattr(inner, "num_envs")
        first = self._parts[0]
        self.limit, self.lag = first.max_displacement, first.lag_range[1]
        self.workspace, self.counted = first.workspace, first.counted
        self.step_seconds = 1 / first.metadata["render_fps"]
        if any(not part.scenes for part in self._parts):
            env.reset(seed=seed)
        if self._gather("done").any():
            raise InvalidInputError("an episode has ended: reset the environment before executing")
        self.size = len(self.scenes)

    def _gather(self, name: str) -> Any:
        return np.concatenate([getattr(part, name) for part in self._parts])

    @property
    def scenes(self) -> list[Any]:
        """The scenes as they are now."""
        return [scene for part in self._parts for scene in part.scenes]

    @property
    def targets(self) -> NDArray[np.int64]:
        """`(B,)`, index of the goal that is meant."""
        return self._gather("targets")

    @property
    def positions(self) -> Array:
        """`(B, D)` [m]."""
        return self._gather("positions")

    @property
    def joint_angles(self) -> Array:
        """`(B, J)` [rad]; a point in the plane has none."""
        return self._gather("joint_angles")

    def set_targets(self, targets: Sequence[Any]) -> None:
        """Mean other goals `(B,)` from now on; nothing changes if one of them is not there."""
        for scene, target in zip(self.scenes, targets, strict=True):
            target_index(target, scene.num_goals)
        index = 0
        for part in self._parts:
            for i in range(len(part.scenes)):
                part.set_target(i, int(targets[index]))
                index += 1

    def step(self, actions: Array) -> tuple[NDArray[Any], NDArray[Any], dict[str, Any]]:
        """Send `actions (B, D)` [m]; which succeeded and which ended, and the info."""
        _, _, terminated, truncated, info = self._env.step(actions[0] if self._single else actions)
        if self._single:
            info = {name: np.asarray(value)[None] for name, value in info.items()}
        success = np.atleast_1d(terminated)
        return success, success | np.atleast_1d(truncated), info


class Driver(Protocol):
    """What turns the place on a path into the next displacements.

    Attributes:
        with_path: whether it follows the path; else progress is the way to the goal.
    """

    with_path: bool

    def __call__(
        self,
        rows: NDArray[np.intp],
        positions: Array,
        previous: Array,
        goals: Array,
        tracker: PathTracker,
    ) -> Array:
        """`(N, C, D)` [m], the next C displacements of the robots `rows (N,)` of `B`."""
        ...


class Policy:
    """Stage 2. Without the path it is to reach the goal anyhow."""

    def __init__(
        self,
        model: PathPolicy | OnnxPathPolicy,
        seed: int,
        steps: int | None = None,
        with_path: bool = True,
    ) -> None:
        self.model, self.steps, self.with_path = model, steps, with_path
        self.generator = torch.Generator("cpu").manual_seed(seed)

    def __call__(
        self,
        rows: NDArray[np.intp],
        positions: Array,
        previous: Array,
        goals: Array,
        tracker: PathTracker,
    ) -> Array:
        """See `Driver`."""
        config = self.model.config
        seen = Observation.of(
            positions[rows], previous[rows], goals[rows], config.limit,
            tracker.of(rows) if self.with_path else None,
        )  # fmt: skip
        noise = standard_normal(len(rows), config.chunk, config.dim, generator=self.generator)
        return self.model.act(seen, noise, self.steps)[:, : config.execute]


class Feedback:
    """The feedback controller that made the demonstrations."""

    with_path = True

    def __call__(
        self,
        rows: NDArray[np.intp],
        positions: Array,
        previous: Array,
        goals: Array,
        tracker: PathTracker,
    ) -> Array:
        """See `Driver`."""
        return feedback_action(tracker.of(rows), positions[rows])[:, None]


class Replay:
    """The path's own displacements, whatever becomes of them."""

    with_path = True

    def __init__(self, limit: float) -> None:
        self.limit = limit

    def __call__(
        self,
        rows: NDArray[np.intp],
        positions: Array,
        previous: Array,
        goals: Array,
        tracker: PathTracker,
    ) -> Array:
        """See `Driver`."""
        step = self.limit / 2
        number = int(np.ceil(tracker.lengths[rows].max() / step)) + 1
        arc = np.minimum(step * np.arange(number), tracker.lengths[rows, None])
        return np.diff(tracker.of(rows).points(arc), axis=1)


def follow(
    fleet: Fleet,
    paths: list[Path],
    driver: Driver,
    *,
    plan_again: Callable[[list[int], Array], list[Path]] | None = None,
    tolerance: float = np.inf,
) -> list[Rollout]:
    """Let the robots follow their paths until each has reached its goal or is stopped.

    Every action is made safe (`safe_actions`) before it is sent, whatever the driver says. A robot
    that makes no progress for two seconds is stopped with a reason, and so is one far from its
    path, unless it may plan again.

    Args:
        fleet: `B` robots.
        paths: one for each, from where it is.
        driver: what moves them.
        plan_again: paths for some robots from where they are (indices, positions `(N, D)`) when a
            push has taken them off the path by more than `tolerance`, or their goal was moved;
            without it they go back to the path.
        tolerance: [m].
    """
    size, limit = fleet.size, fleet.limit
    shape = (NUM_WAYPOINTS + 2, fleet.workspace.shape[1])
    for path in paths:
        if path.waypoints.shape != shape:
            raise InvalidInputError(
                f"a path must have waypoints of shape {shape}, got {path.waypoints.shape}"
            )
    positions = previous = fleet.positions
    gap = np.linalg.norm(positions - np.stack([p.waypoints[0] for p in paths]), axis=-1)
    if not (gap <= limit).all():
        worst = int(np.nan_to_num(gap, nan=np.inf).argmax())
        raise InvalidInputError(
            f"a path must start at the robot, {positions[worst].tolist()}, "
            f"got {paths[worst].waypoints[0].tolist()}"
        )
    if not all(np.isfinite(p.waypoints).all() for p in paths):
        raise InvalidInputError("a path must be finite, got one that is not")
    tracker = PathTracker(np.stack([p.waypoints for p in paths]), limit, fleet.workspace)
    goals = np.stack([p.waypoints[-1] for p in paths])
    patience = round(_PATIENCE / fleet.step_seconds)
    states, actions, deviations, contacts = [positions], [], [], np.zeros(size, dtype=int)
    joints = [fleet.joint_angles]
    counts = {name: np.zeros(size, dtype=int) for name in fleet.counted}
    steps = np.zeros(size, dtype=int)
    reasons = np.full(size, "", dtype=object)
    replans: list[list[int]] = [[] for _ in range(size)]
    queue: list[Array] = [np.empty((0, positions.shape[1]))] * size
    best, since = np.full(size, np.inf), np.zeros(size, dtype=int)
    renewed = np.zeros(size, dtype=int)

    active = np.ones(size, dtype=bool)
    while active.any():
        empty = np.flatnonzero(active & np.array([not len(q) for q in queue]))
        if len(empty):
            for row, chunk in zip(
                empty, driver(empty, positions, previous, goals, tracker), strict=True
            ):
                queue[row] = chunk
        wanted = np.zeros_like(positions)
        for row in np.flatnonzero(active):
            wanted[row], queue[row] = queue[row][0], queue[row][1:]
        sent = safe_actions(
            wanted, positions, positions - previous, fleet.workspace, limit, fleet.lag
        )
        sent[~active] = 0
        success, ended, info = fleet.step(sent)
        previous, positions = positions, np.where(active[:, None], fleet.positions, positions)
        tracker.update(positions, previous)
        off = tracker.distance(positions)
        states.append(positions)
        joints.append(fleet.joint_angles)
        actions.append(sent)
        deviations.append(off)
        contacts += active & np.asarray(info["wall_contact"])
        for name, number in counts.items():
            number[active] = info[name][active]
        steps += active

        left = tracker.remaining + off
        lost = (off > _LOST * limit) & (plan_again is None)
        if not driver.with_path:
            left, lost = np.linalg.norm(positions - goals, axis=-1), np.zeros(size, dtype=bool)
        better = left < best - _PROGRESS * limit
        best, since = np.where(better, left, best), np.where(better, 0, since + 1)
        for reason, now in (
            ("reached", success),
            ("time", ended),
            ("lost", lost),
            ("stalled", since >= patience),
        ):
            reasons[active & now & (reasons == "")] = reason
        active &= reasons == ""

        if plan_again is not None:
            moved = np.stack([s.goals[t] for s, t in zip(fleet.scenes, fleet.targets, strict=True)])
            elsewhere = np.linalg.norm(moved - goals, axis=-1) > 1e-9
            again = active & ((off > tolerance) | elsewhere)
            rows = np.flatnonzero(again)
            if len(rows):
                new = plan_again(rows.tolist(), positions[rows])
                tracker.replace(rows, np.stack([p.waypoints for p in new]))
                goals[rows] = moved[rows]
                # Who is off every new path too must not be watched from anew each time.
                anew = rows[elsewhere[rows] | (renewed[rows] < _PUSHES)]
                best[anew], since[anew] = np.inf, 0
                renewed[anew] += 1
                for row in rows:
                    queue[row] = queue[row][:0]
                    replans[row].append(int(steps[row]))

    track, sent, off = np.stack(states, 1), np.stack(actions, 1), np.stack(deviations, 1)
    angles = np.stack(joints, 1)
    return [
        Rollout(
            path=paths[i],
            states=track[i, : steps[i] + 1],
            actions=sent[i, : steps[i]],
            success=reasons[i] == "reached",
            reason=str(reasons[i]),
            replans=tuple(replans[i]),
            deviation=off[i, : steps[i]],
            step_seconds=fleet.step_seconds,
            wall_contacts=int(contacts[i]),
            joint_angles=angles[i, : steps[i] + 1],
            counts={name: int(number[i]) for name, number in counts.items()},
        )
        for i in range(size)
    ]
