"""A controller for a robot's own loop: a position in, a displacement out, within a time budget."""

from __future__ import annotations

import time
from collections.abc import Generator
from dataclasses import replace
from functools import partial
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from .checks import Array, finite_array, legibility_levels
from .curves import NUM_WAYPOINTS
from .drivers import Driver
from .envs.guard import Barriers, Planes, safe_actions
from .errors import InvalidInputError, InvalidSceneError
from .intent.metrics import SCORE_POINTS
from .models.continuation import Rest, brought, caught_up, continuation, mended
from .models.path_sampler import PathSampler, Sampling
from .motion.archive import scene_archive
from .motion.library import curve_library
from .motion.path import Path
from .motion.rough_archive import rough_archive
from .motion.tracking import PathTracker
from .parts import Parts
from .pilot import Pilot
from .rollout import PATIENCE, RESTARTS
from .scene import DEFAULT_WORKSPACE, START_OVERSHOOT, Scene
from .whole_arm import keeps_off

if TYPE_CHECKING:
    from .motion.timed import Motion
    from .robots.arm import Arm

REACHED = 0.02
"""Distance from the goal at which a motion that has slowed down is over [m], in a room of the
default size; it grows with the room."""

# In largest displacements: a slow robot, one that hardly moves, what is noise, and what is believed
# of a step.
_SLOW, _STILL, _NOISE, _JUMP = 0.2, 0.5, 0.1, 10.0
_LAG = 0.3
_WHILE_PLANNING = 5  # times the patience with a robot that stands while a plan is made


class Controller:
    """Moves one robot to its goal with the ℓ asked for; `Modulator.controller` makes one.

    Call `step` once every `dt` with the robot's position, and send it the displacement returned.
    When the robot is off its path, or the scene has changed, the rest of the motion is replanned, a
    part of the work in each step. Meanwhile the robot follows its old path and keeps off obstacles.
    A new rest sets out in the direction of motion, and ℓ is that of the whole motion, including the
    part already executed.

    Attributes:
        scene: as it is now, with the start of the motion.
        limit: largest displacement of a step along each axis [m].
        dt: duration of a step [s].
        arm: that moves, if any.
        replans: the steps at which a new path was taken.
        problem: why there is no way in the scene as it is now; None if there is one, as far as is
            known.
    """

    def __init__(
        self,
        path: Path,
        sampler: PathSampler,
        driver: Driver,
        *,
        limit: float,
        dt: float,
        tolerance: float,
        budget: float,
        seed: int,
        sampling: Sampling,
        exact: bool,
        max_detour: float | None,
        arm: Arm | None,
        frame: str,
    ) -> None:
        scene = path.scene
        self.scene, self.limit, self.dt, self.arm = scene, limit, dt, arm
        self.problem: str | None = None
        self.replans: list[int] = []
        self._first, self._level = path, path.legibility
        self._tolerance, self._budget = tolerance, budget
        self._base = arm if frame == "base" else None
        self._reached = REACHED * scene.diagonal / _diagonal(scene.dim)
        self._continue = partial(
            continuation, sampler=sampler, seed=seed, sampling=sampling, exact=exact,
            max_detour=max_detour, accepts=partial(keeps_off, arm),
        )  # fmt: skip
        self._archive_of, self._max_detour = scene_archive if exact else rough_archive, max_detour
        self._pilot = Pilot([path], driver, scene.start[None], limit, scene.workspace)
        self._barriers = Barriers.of([scene], [path.target])
        self._action = np.zeros(scene.dim)
        self._done = False
        self._states, self._angles = list[Array](), list[Array]()
        self._way = list[Array]()  # the states without the noise of a robot that stands
        self._still_since = 0  # the step since when the robot has hardly moved
        self._now = scene  # whatever its start
        # Those for which the last plan was begun; None asks for another.
        self._planned: tuple[Scene, Scene] | None = scene, scene
        self._planned_at = 0.0  # distance from the path [m] when it was
        self._restarts = self._waits = 0
        self._planning: Generator[Path | None, None, Path | None] | None = None
        # Read and sorted now, not in a step.
        _ = curve_library(scene.dim, path.observer.detour).by_length

    @property
    def path(self) -> Path:
        """The path followed now."""
        return self._pilot.paths[0]

    @property
    def states(self) -> Array:
        """`(T, D)` [m], the positions so far."""
        return np.reshape(self._states, (-1, self.scene.dim))

    @property
    def done(self) -> bool:
        """Whether the robot is at its goal."""
        return self._done

    @property
    def planning(self) -> bool:
        """Whether a new path is being planned."""
        return self._planning is not None

    @property
    def stalled(self) -> bool:
        """Whether the robot has made no progress for two seconds, or ten while a plan is made."""
        patience = self._patience * (_WHILE_PLANNING if self.planning else 1)
        return not self._done and max(self._pilot.idle[0], self._standing) > patience

    @property
    def _patience(self) -> int:
        """Steps without progress after which a robot has stalled."""
        return max(1, round(PATIENCE / self.dt))

    @property
    def _standing(self) -> int:
        """Steps since the robot last moved."""
        return len(self._states) - self._still_since

    @property
    def posterior(self) -> Array:
        """P(g) of each goal as the observer reads it now, `(G,)`."""
        place = self._states[-1] if self._states else self.scene.start
        return self.path.observer.field(self.scene).posterior(place)

    @property
    def achieved(self) -> float:
        """The label in [−1, 1] of the motion so far and the rest of the path, taken together.

        By the archive that the plans are made with; for the loop's pauses, as it may be built.

        Raises:
            InvalidSceneError: no curve leads to the target in the scene as it is now.
        """
        path, tracker = self.path, self._pilot.tracker
        ahead = tracker.ahead(np.linspace(0, float(tracker.remaining[0]), SCORE_POINTS))[0]
        motion = np.concatenate([*map(np.atleast_2d, self._way), ahead])
        score = path.observer.score(motion, self.scene, path.target)
        return float(self._archive_of(self.scene, path.target, path.observer).label_of(score))

    def motion(self) -> Motion:
        """The motion so far, with the time of each step, and the joints of an arm.

        Raises:
            InvalidInputError: before the second step.
        """
        from .motion.timed import Motion

        if len(self._states) < 2:
            raise InvalidInputError("there is no motion before the second step")
        path = replace(self._first, scene=self.scene, legibility=self._level)
        angles = np.array(self._angles) if self.arm is not None else np.empty((0, 0))
        return Motion.recorded(path, self.states, self.dt, angles, self.arm)

    @np.errstate(under="ignore")
    def step(
        self,
        position: ArrayLike,
        scene: Scene | None = None,
        *,
        joint_angles: ArrayLike | None = None,
    ) -> Array:
        """The next displacement of the robot, `(D,)` [m]; 0 while it is at its goal.

        It is finite, within the limit, and keeps the robot in the workspace and off obstacles; an
        arm, with all its links.

        Args:
            position: `(D,)` [m], where the robot is, in the frame that was asked for.
            scene: the scene as it is now, if it may have changed; its start does not count.
            joint_angles: `(J,)` [rad], of the arm; if not given, those of its inverse kinematics.

        Raises:
            InvalidInputError: the position is none, lies outside the workspace, or has jumped by
                more than ten displacements since the last step; the angles are none of the arm.
            InvalidSceneError: the scene does not fit the motion, or its target has jumped so far.
        """
        deadline = time.perf_counter() + self._budget
        here = finite_array("position", position, ndim=1, last=self.scene.dim)
        here = self._checked_position(self._base.in_world(here) if self._base else here.copy())
        posture = self._checked_posture(here, joint_angles)
        if scene is not None and scene is not self._now:
            self._see(scene)
        self._move(here, posture)
        if self._done:
            self._action = np.zeros_like(here)
            return self._action.copy()
        deviation = float(self._pilot.deviation[0])
        off = deviation > self._planned_at + self._tolerance
        if off or (not self.planning and self._is_stale()):
            # A scene that keeps changing does not keep a plan from getting ready.
            self._planned_at = deviation
            if self._is_stale():
                self._planned = self.scene, self._now
            self._planning = self._new_rests()
        self._plan_until(deadline)
        pilot = self._pilot
        self._action = safe_actions(
            pilot.wanted(np.ones(1, dtype=bool)), pilot.positions, pilot.displacements,
            self.scene.workspace, self.limit, _LAG, self._barriers, self._planes(),
        )[0]  # fmt: skip
        return self._action @ self._base.base_to_world if self._base else self._action.copy()

    def replan(self, legibility: float | None = None) -> None:
        """Replan the rest of the motion from the next step on, for another ℓ if one is given."""
        if legibility is not None:
            level = legibility_levels(legibility)
            if level.ndim:
                raise InvalidInputError(f"legibility must be one number, got {legibility!r}")
            self._level = level
            self._pilot.paths[0] = replace(self.path, legibility=level)
        self._planned = None

    def _is_stale(self) -> bool:
        """Whether the last plan was begun for another scene, or another plan is asked for."""
        return self._planned is None or not self._now.alike(self._planned[1], _NOISE * self.limit)

    def _move(self, here: Array, posture: Array | None) -> None:
        """Take note of the position."""
        pilot, first = self._pilot, not self._states
        moved = 0.0 if first else float(np.linalg.norm(here - self._states[-1]))
        apart = float(np.linalg.norm(here - self.scene.goals[self.path.target]))
        slow = not first and moved <= _SLOW * self.limit
        # One that has arrived may be a little off.
        near = apart <= self._reached * (1 + self._done)
        self._done = near and (slow or self._done)
        if self._done and moved == 0:
            return  # it stands: a record of that would grow for ever
        self._states.append(here)
        if posture is not None:
            self._angles.append(posture)
        if not self._way or np.linalg.norm(here - self._way[-1]) > _NOISE * self.limit:
            self._way.append(here)
        anchor = self._states[self._still_since]
        if np.linalg.norm(here - anchor) > _STILL * self.limit:
            self._still_since = len(self._states) - 1
        if first:
            pilot.start(here[None])
        else:
            pilot.moved(here[None], self._action[None])

    def _rest(self) -> Rest:
        way = np.array(self._way)
        if not np.array_equal(way[-1], self._states[-1]):
            way = np.concatenate([way, self._states[-1:]])
        return self._pilot.rest(0, *(self._planned or (self.scene, self._now)), way)

    def _new_rests(self) -> Generator[Path | None, None, Path | None]:
        """New rests of the motion, better and better ones, for where the robot is at the time."""
        since, rest = len(self._states) - 1, self._rest()
        path = yield from mended(rest)
        if path is not None:
            yield (yield from self._from_here(path, since))
        planning = self._continue(rest)
        while True:
            try:
                path = next(planning)
            except StopIteration as end:
                path = end.value
                break
            yield None if path is None else (yield from self._from_here(path, since))
        if since == len(self._states) - 1:
            return path
        rest, since = self._left(path, since), len(self._states) - 1
        scene = rest.begun.scene
        archive = yield from self._archive_of.parts(scene, path.target, path.observer)
        path, fault = yield from brought(rest, archive, self._max_detour)
        if fault == np.inf:  # one that sets out in another direction, say
            path = yield from mended(rest)
        return None if path is None else (yield from self._from_here(path, since))

    def _left(self, path: Path, since: int) -> Rest:
        """What is left of a path from where the robot was at a step."""
        tracker = PathTracker(path.waypoints[None], self.limit, self.scene.workspace)
        for before, now in pairwise(self._states[since:]):
            tracker.update(now[None], before[None])
        left = tracker.ahead(np.linspace(0, float(tracker.remaining[0]), NUM_WAYPOINTS + 2))[0]
        return replace(self._rest(), remaining=left)

    def _from_here(self, path: Path, since: int) -> Parts[Path | None]:
        """A path from where the robot was at a step, moved to where it is now."""
        now = len(self._states) - 1
        if now == since:
            return path
        moved = yield from mended(self._left(path, since))
        if moved is None or now == len(self._states) - 1:
            return moved
        return caught_up(self._left(moved, now))  # the robot will not wait

    def _plan_until(self, deadline: float) -> None:
        """Go on planning until a time is over, or there is nothing to plan."""
        while self._planning is not None:
            try:
                path = next(self._planning)
            except StopIteration as end:
                path = end.value
                self._planning, self.problem = None, None
                if path is None:  # what was found does not fit any more
                    self._planned = self.scene, self._now
                    self._planning = self._new_rests()
            except InvalidSceneError as problem:
                path = None
                self._planning, self.problem = None, str(problem)
            if path is not None:
                self._take(path)
            if time.perf_counter() >= deadline:
                return

    def _take(self, path: Path) -> None:
        """Follow a new path from here."""
        # A robot that leaves every new path as well restarts its stall timer only a few times.
        off = self._planned_at > self._tolerance
        fresh = not off or self._restarts < RESTARTS
        self._restarts += off and fresh
        self._pilot.take(0, replace(path, legibility=self._level), fresh=fresh)
        if self._standing > self._patience and self._waits < RESTARTS:  # for this plan
            self._still_since = len(self._states) - 1
            self._waits += 1
        self._planned_at = 0.0
        if self.replans[-1:] != [len(self._states) - 1]:
            self.replans.append(len(self._states) - 1)

    def _planes(self) -> Planes | None:
        """Planes between the arm and the obstacles near it."""
        if self.arm is None or not self._now.obstacles:
            return None
        return Planes.of([next(self.arm.nearby(self._now.obstacles, self._angles[-1][None]))])

    def _checked_posture(self, here: Array, joint_angles: ArrayLike | None) -> Array | None:
        """The angles `(J,)` [rad] of the arm with its grasp point `here`."""
        if self.arm is None:
            if joint_angles is not None:
                raise InvalidInputError("joint_angles are of an arm, the controller moves a point")
            return None
        if joint_angles is not None:
            return finite_array("joint_angles", joint_angles, ndim=1, last=self.arm.joints).copy()
        return self.arm.postures(here[None], near=self._angles[-1] if self._angles else None)[0]

    def _checked_position(self, here: Array) -> Array:
        low, high = self.scene.workspace
        spare = max(self.limit, START_OVERSHOOT[self.scene.dim] * self.scene.diagonal)
        if not ((here >= low - spare) & (here <= high + spare)).all():
            raise InvalidInputError(
                f"position must lie in the workspace {self.scene.workspace.tolist()} m, "
                f"got {here.tolist()}{' in the world' if self._base else ''}"
            )
        before = self._states[-1] if self._states else self._first.scene.start
        apart = float(np.linalg.norm(here - before))
        if apart > _JUMP * self.limit:
            where = "the last one" if self._states else "the path's start"
            raise InvalidInputError(
                f"position {here.tolist()} is {apart:.3g} m from {where}, at most "
                f"{_JUMP * self.limit:g} m is believed: make a new controller from there"
            )
        return here

    def _see(self, scene: Scene) -> None:
        """Take note of the scene as it is now."""
        if not isinstance(scene, Scene):
            raise InvalidSceneError(f"scene must be a legibility.Scene, got {type(scene).__name__}")
        now, target = self.scene, self.path.target
        if scene.goals.shape != now.goals.shape:
            raise InvalidSceneError(
                f"the scene must keep its {now.num_goals} goals in {now.dim}-D, got "
                f"{scene.num_goals} in {scene.dim}-D: make a new controller"
            )
        if not np.array_equal(scene.workspace, now.workspace):
            raise InvalidSceneError(
                f"the scene must keep its workspace {now.workspace.tolist()} m, got "
                f"{scene.workspace.tolist()}: make a new controller"
            )
        apart = float(np.linalg.norm(scene.goals[target] - now.goals[target]))
        if apart > _JUMP * self.limit:
            raise InvalidSceneError(
                f"the target goals[{target}] is {apart:.3g} m from where it was, at most "
                f"{_JUMP * self.limit:g} m is believed in a step: make a new controller"
            )
        self._now, self.scene = scene, scene.starting_at(self._first.scene.start)
        self._barriers = Barriers.of([scene], [target])


def _diagonal(dim: int) -> float:
    """That of the default workspace [m]."""
    low, high = np.array(DEFAULT_WORKSPACE[dim])
    return float(np.linalg.norm(high - low))
