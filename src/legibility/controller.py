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
from .models.continuation import Rest, brought, continuation, mended
from .models.path_sampler import PathSampler, Sampling
from .motion.archive import scene_archive
from .motion.library import curve_library
from .motion.path import Path
from .motion.rough_archive import rough_archive
from .motion.tracking import PathTracker
from .parts import finished
from .pilot import Pilot
from .rollout import PATIENCE
from .scene import START_OVERSHOOT, Scene
from .whole_arm import keeps_off

if TYPE_CHECKING:
    from .motion.timed import Motion
    from .robots.arm import Arm

REACHED = 0.02
"""Distance from the goal at which a motion that has slowed down is over [m]."""

_SLOW = 0.2
_JUMP = 10.0  # limits
_LAG = 0.3


class Controller:
    """Moves one robot to its goal with the ℓ asked for; `Modulator.controller` makes one.

    Call `step` once every `dt` with the robot's position, and send it the displacement returned.
    When the robot is pushed off its path, or the scene changes, the rest of the motion is planned
    anew, a part of the work in each step; until it is ready the robot goes on as it was, off
    whatever is in the way. A new rest sets out in the direction of motion, and ℓ is that of the
    whole motion, what is already executed included.

    Attributes:
        scene: as it is now, with the start of the motion.
        limit: largest displacement of a step along each axis [m].
        dt: duration of a step [s].
        arm: that moves, if any.
        replans: the steps at which a new path was taken.
        problem: why there is no path in the scene as it is now; None if there is.
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
        self.scene, self.limit, self.dt = path.scene, limit, dt
        self.problem: str | None = None
        self.replans: list[int] = []
        self._first, self._sampler, self._seed, self._sampling = path, sampler, seed, sampling
        self._tolerance, self._budget = tolerance, budget
        self._exact, self._max_detour, self.arm = exact, max_detour, arm
        self._base = arm if frame == "base" else None
        self._pilot = Pilot([path], driver, path.scene.start[None], limit, path.scene.workspace)
        self._barriers = Barriers.of([self.scene], [path.target])
        self._action = np.zeros(self.scene.dim)
        self._states: list[Array] = []
        self._stale = False  # whether the scene has changed since planning began
        self._planned_at = 0.0  # distance from the path [m] at that time
        self._posture: Array | None = None
        self._planning: Generator[Path | None, None, Path | None] | None = None
        self._done = False
        self._seen = path.scene
        # Read and sorted now, not in a step.
        _ = curve_library(self.scene.dim, path.observer.detour).by_length
        self._archive_of = scene_archive if exact else rough_archive

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
        """Whether the robot has reached its goal."""
        return self._done

    @property
    def planning(self) -> bool:
        """Whether a new path is being planned."""
        return self._planning is not None

    @property
    def stalled(self) -> bool:
        """Whether the robot has made no progress for two seconds."""
        return not self._done and self._pilot.idle[0] >= round(PATIENCE / self.dt)

    @property
    def posterior(self) -> Array:
        """P(g) of each goal as the observer reads it now, `(G,)`."""
        place = self._states[-1] if self._states else self.scene.start
        return self.path.observer.field(self.scene).posterior(place)

    @property
    def achieved(self) -> float:
        """The label in [−1, 1] of the motion so far and the rest of the path, taken together.

        By the archive that the plans are made with; for the loop's pauses, as it may be built.
        """
        path, tracker = self.path, self._pilot.tracker
        ahead = tracker.ahead(np.linspace(0, float(tracker.remaining[0]), SCORE_POINTS))[0]
        motion = np.concatenate([self.states, ahead])
        score = path.observer.score(motion, self.scene, path.target)
        return float(self._archive_of(self.scene, path.target, path.observer).label_of(score))

    def motion(self) -> Motion:
        """The motion so far, with the time of each step."""
        from .motion.timed import Motion

        if not self._states:
            raise InvalidInputError("there is no motion before the first step")
        path = replace(self._first, scene=self.scene)
        return Motion.recorded(path, self.states, self.dt, np.empty((0, 0)), None)

    @np.errstate(under="ignore")
    def step(
        self,
        position: ArrayLike,
        scene: Scene | None = None,
        *,
        joint_angles: ArrayLike | None = None,
    ) -> Array:
        """The next displacement of the robot, `(D,)` [m]; 0 when it has reached its goal.

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
        here = self._checked_position(self._base.in_world(here) if self._base else here)
        posture = self._checked_posture(here, joint_angles)
        changed = scene is not None and self._sees(scene)
        self._move(here)
        self._posture = posture
        if changed:
            self._done, self.problem = False, None
        if self._done:
            self._action = np.zeros_like(here)
            return self._action
        deviation = float(self._pilot.deviation[0])
        off = deviation > self._planned_at + self._tolerance
        self._stale |= changed
        if off or (self._stale and not self.planning):
            # A scene that keeps changing does not keep a plan from getting ready.
            self._stale, self._planned_at = False, deviation
            self._planning = self._new_rests()
        self._plan_until(deadline)
        pilot = self._pilot
        self._action = safe_actions(
            pilot.wanted(np.ones(1, dtype=bool)), pilot.positions, pilot.displacements,
            self.scene.workspace, self.limit, _LAG, self._barriers, self._planes(),
        )[0]  # fmt: skip
        return self._action @ self._base.base_to_world if self._base else self._action.copy()

    def replan(self, legibility: float | None = None) -> None:
        """Plan the rest of the motion anew from the next step on, for another ℓ if one is given."""
        if legibility is not None:
            level = legibility_levels(legibility)
            if level.ndim:
                raise InvalidInputError(f"legibility must be one number, got {legibility!r}")
            self._pilot.paths[0] = replace(self.path, legibility=level)
        self._planning, self._stale = None, True

    def _planes(self) -> Planes | None:
        """Planes between the arm and the obstacles near it."""
        if self.arm is None or self._posture is None or not self.scene.obstacles:
            return None
        return Planes.of([next(self.arm.nearby(self.scene.obstacles, self._posture[None]))])

    def _move(self, here: Array) -> None:
        """Take note of the position."""
        pilot = self._pilot
        self._states.append(here)
        if len(self._states) == 1:
            pilot.positions = here[None]
            pilot.deviation = pilot.tracker.distance(pilot.positions)
            return
        pilot.moved(here[None], self._action[None])
        apart = np.linalg.norm(here - self.scene.goals[self.path.target])
        moved = np.linalg.norm(here - self._states[-2])
        self._done |= bool(apart <= REACHED and moved <= _SLOW * self.limit)

    def _rest(self) -> Rest:
        return self._pilot.rest(0, self.scene, self.states)

    def _new_rests(self) -> Generator[Path | None, None, Path | None]:
        """New rests of the motion, better and better ones, for where the robot is at the time."""
        since, rest = len(self._states) - 1, self._rest()
        path = yield from mended(rest)
        yield None if path is None else self._from_here(path, since)
        planning = continuation(
            rest, self._sampler, self._seed, self._sampling, exact=self._exact,
            max_detour=self._max_detour, accepts=partial(keeps_off, self.arm),
        )  # fmt: skip
        while True:
            try:
                path = next(planning)
            except StopIteration as end:
                path = end.value
                break
            if path is not None:
                path = self._from_here(path, since)
            yield path
        if since == len(self._states) - 1:
            return path
        rest = self._left(path, since)
        since = len(self._states) - 1
        archive = self._archive_of(self.scene, path.target, path.observer)
        path, fault = yield from brought(rest, archive, self._max_detour)
        return self._from_here(path, since) if fault < np.inf else None

    def _left(self, path: Path, since: int) -> Rest:
        """What is left of a path from where the robot was at a step."""
        tracker = PathTracker(path.waypoints[None], self.limit, self.scene.workspace)
        for before, now in pairwise(self._states[since:]):
            tracker.update(now[None], before[None])
        left = tracker.ahead(np.linspace(0, float(tracker.remaining[0]), NUM_WAYPOINTS + 2))[0]
        return replace(self._rest(), remaining=left)

    def _from_here(self, path: Path, since: int) -> Path | None:
        """A path from where the robot was at a step, moved to where it is now."""
        if since == len(self._states) - 1:
            return path
        return finished(mended(self._left(path, since)))

    def _plan_until(self, deadline: float) -> None:
        """Go on planning until a time is over, or there is nothing to plan."""
        while self._planning is not None:
            try:
                path = next(self._planning)
            except StopIteration as end:
                path = end.value
                self._planning, self.problem = None, None
            except InvalidSceneError as problem:
                path = None
                self._planning, self.problem = None, str(problem)
            self._take(path)
            if time.perf_counter() >= deadline:
                return

    def _take(self, path: Path | None) -> None:
        """Follow a new path from here, if there is one."""
        if path is not None:
            self._pilot.take(0, path, fresh=True)
            self._planned_at = 0.0
            self.replans.append(len(self._states) - 1)

    def _checked_posture(self, here: Array, joint_angles: ArrayLike | None) -> Array | None:
        """The angles `(J,)` [rad] of the arm with its grasp point `here`, where they matter."""
        if joint_angles is not None:
            if self.arm is None:
                raise InvalidInputError("joint_angles are of an arm, the controller moves a point")
            return finite_array("joint_angles", joint_angles, ndim=1, last=self.arm.joints)
        if self.arm is None or not self.scene.obstacles:
            return None
        return self.arm.postures(here[None], near=self._posture)[0]

    def _checked_position(self, here: Array) -> Array:
        low, high = self.scene.workspace
        spare = max(self.limit, START_OVERSHOOT[self.scene.dim] * self.scene.diagonal)
        if not ((here >= low - spare) & (here <= high + spare)).all():
            raise InvalidInputError(
                f"position must lie in the workspace {self.scene.workspace.tolist()} m, "
                f"got {here.tolist()}"
            )
        before = self._states[-1] if self._states else self.path.scene.start
        apart = float(np.linalg.norm(here - before))
        if apart > _JUMP * self.limit:
            where = "the last one" if self._states else "the path's start"
            raise InvalidInputError(
                f"position {here.tolist()} is {apart:.3g} m from {where}, at most "
                f"{_JUMP * self.limit:g} m is believed: make a new controller from there"
            )
        return here

    def _sees(self, scene: Scene) -> bool:
        """Take note of the scene as it is now; return whether it has changed."""
        if scene == self._seen:
            return False
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
        scene.check_target(target)
        apart = float(np.linalg.norm(scene.goals[target] - now.goals[target]))
        if apart > _JUMP * self.limit:
            raise InvalidSceneError(
                f"the target goals[{target}] is {apart:.3g} m from where it was, at most "
                f"{_JUMP * self.limit:g} m is believed in a step: make a new controller"
            )
        self._seen, self.scene = scene, scene.starting_at(now.start)
        self._barriers = Barriers.of([self.scene], [target])
        return self.scene != now
