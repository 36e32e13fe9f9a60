"""Timed motions: where a robot is at every instant of a path, and how fast it moves."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path as FilePath
from typing import TYPE_CHECKING

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline

from ..checks import Array, frame_name, positive
from ..errors import InvalidInputError
from ..intent.metrics import posterior_legibility, score_weights, time_to_confidence
from ..robots.arm import PANDA, Arm
from ..robots.limits import Limits
from .timing import Course, fastest_timing, over_time

if TYPE_CHECKING:
    from .path import Path

_KNOTS, _ROUNDS = 24, 8
"""Knots of the joints' splines to begin with, and most times that knots are added."""

_DEVIATION = 1e-5
"""Distance [m] from the curve above which the joints' spline gets another knot."""

_APART = 0.01
"""Twice the mean distance between the places at which the arm is checked for contacts [m]."""

_INSTANTS = 1_000_000
"""Most instants of a motion."""


@dataclass(frozen=True, eq=False)
class Motion:
    """A path over time, from rest to rest, or the record of an executed motion.

    Attributes:
        path: the path; its curve is unchanged. Of a record, the path as first planned.
        limits: that the motion keeps; none of a record.
        arm: that moves, if any.
        times: `(T,)` [s], at equal steps from 0.
        positions: `(T, D)` [m], of the point or the arm's grasp point.
        velocities: `(T, D)` [m/s].
        accelerations: `(T, D)` [m/s²].
        joint_positions: `(T, J)` [rad]; `(0, 0)` without an arm.
        joint_velocities: `(T, J)` [rad/s].
        joint_accelerations: `(T, J)` [rad/s²].
        bound: duration [s] that velocities and accelerations alone would allow; that of a record.
        frame: of positions, velocities and accelerations, one of `FRAMES`.
    """

    path: Path
    limits: Limits | None
    arm: Arm | None
    times: Array
    positions: Array
    velocities: Array
    accelerations: Array
    bound: float
    joint_positions: Array = field(default_factory=lambda: np.empty((0, 0)))
    joint_velocities: Array = field(default_factory=lambda: np.empty((0, 0)))
    joint_accelerations: Array = field(default_factory=lambda: np.empty((0, 0)))
    frame: str = "world"

    @classmethod
    def recorded(
        cls, path: Path, positions: Array, step_seconds: float, angles: Array, arm: Arm | None
    ) -> Motion:
        """The record of a motion: velocities and accelerations are central differences.

        Args:
            path: that was followed.
            positions: `(T, D)` [m], one each step.
            step_seconds: duration of a step [s].
            angles: `(T, J)` [rad], of an arm.
            arm: that moved, if any.
        """
        times = np.arange(len(positions), dtype=np.float64) * step_seconds

        def over_time(values: Array) -> tuple[Array, Array, Array]:
            velocities = np.gradient(values, step_seconds, axis=0)
            return values, velocities, np.gradient(velocities, step_seconds, axis=0)

        place, velocity, acceleration = over_time(positions)
        record = cls(path, None, arm, times, place, velocity, acceleration, float(times[-1]))
        if arm is None:
            return record
        place, velocity, acceleration = over_time(angles)
        return replace(
            record, joint_positions=place, joint_velocities=velocity,
            joint_accelerations=acceleration,
        )  # fmt: skip

    @property
    def duration(self) -> float:
        """From the first instant to the last [s]."""
        return float(self.times[-1])

    @cached_property
    def posterior(self) -> Array:
        """P(g) of each goal at each instant as the path's observer reads it, `(T, G)`."""
        return self.path.field.posterior(self.in_frame("world").positions)

    @cached_property
    def score(self) -> float:
        """The score over time, `−Σ f(t) φ(x_t|g*)`, t ∈ [0, 1] over the duration; higher = better.

        `path.score` is the same over the way travelled, which weighs slow parts no more than fast
        ones.
        """
        places = self.in_frame("world").positions
        potential = self.path.field.potential(places, self.path.target)
        return float(-potential @ score_weights(len(places), self.path.observer.alpha))

    @property
    def observed_legibility(self) -> float:
        """The mean belief in the target over time, the early one most (paper, eq. 1), in [0, 1]."""
        return float(posterior_legibility(self.posterior, self.path.target))

    @property
    def time_to_confidence(self) -> float:
        """Time [s] from which P(target) ≥ 0.8 to the end, inf if never; lower = better."""
        return float(time_to_confidence(self.posterior, self.path.target)) * self.duration

    def in_frame(self, frame: str) -> Motion:
        """The same motion measured in one of `FRAMES`.

        Raises:
            InvalidInputError: there is no such frame, or no arm that has a base.
        """
        if frame_name(frame, self.arm) == self.frame:
            return self
        assert self.arm is not None
        if frame == "base":
            move, rotation = self.arm.in_base, self.arm.base_to_world
        else:
            move, rotation = self.arm.in_world, self.arm.base_to_world.T
        return replace(
            self, frame=frame, positions=move(self.positions),
            velocities=self.velocities @ rotation, accelerations=self.accelerations @ rotation,
        )  # fmt: skip

    def save(self, file: str | FilePath) -> None:
        """Write the motion to `file`, in the format of its suffix: .csv, .json or .mcap.

        CSV has a row an instant; JSON the arrays by name; MCAP is a bag of ROS 2 with a
        `trajectory_msgs/JointTrajectory` and a `nav_msgs/Path` (extra `ros`).

        Raises:
            OutputError: the file cannot be written, or is an existing bag.
            MissingExtraError: rosbags is not installed.
        """
        from ..robots.formats import save

        save(self, file)


def mover(limits: Limits | str | None, arm: Arm | str | None) -> tuple[Limits, Arm | None]:
    """The limits and the arm that `Path.timed` is asked for, by themselves or by their names."""
    if isinstance(limits, str):
        limits = Limits.named(limits)
        arm = PANDA if arm is None and limits.joints else arm
    if isinstance(arm, str):
        arm = Arm.named(arm)
    if arm is not None and not isinstance(arm, Arm):
        raise InvalidInputError(f"arm must be a legibility.Arm or a name, got {arm!r}")
    if limits is None:
        limits = Limits.named("point") if arm is None else arm.limits
    if not isinstance(limits, Limits):
        raise InvalidInputError(f"limits must be legibility.Limits or a name, got {limits!r}")
    wanted = 0 if arm is None else arm.joints
    if limits.joints != wanted:
        kinds = [f"{n} joints" if n else "a point" for n in (limits.joints, wanted)]
        raise InvalidInputError(
            f"the limits are for {kinds[0]}, what moves is {kinds[1]}{': give arm' * (arm is None)}"
        )
    return limits, arm


def timed(
    path: Path, limits: Limits, rate: float, arm: Arm | None, max_duration: float | None
) -> Motion:
    """See `Path.timed`; `limits` and `arm` fit."""
    if path.legibility.ndim:
        raise InvalidInputError(
            f"a path of one level is timed, this one has {len(path)}: time path[0]"
        )
    rate = positive("rate", rate)
    dim = path.scene.dim
    if arm is not None and dim != 3:
        raise InvalidInputError(f"an arm moves in 3-D, the scene is {dim}-D")
    places = np.linspace(0, 1, len(path.waypoints))
    curve = make_interp_spline(places, path.waypoints, k=3)  # that of `path.trajectory`
    courses = []
    if arm is None:
        courses = [Course(curve, limits)]
    else:
        courses = [Course(_joints_along(curve, arm), limits)]
        if limits.tip is not None:
            courses.append(Course(curve, limits.tip))
    if max_duration is not None:
        max_duration = positive("max_duration", max_duration)
    timing = fastest_timing(courses)
    steps = np.ceil(timing.duration * rate - 1e-9)
    duration = float(steps / rate)
    if max_duration is not None and duration > max_duration + 1e-9:
        raise InvalidInputError(
            f"the motion takes {duration:.3f} s within the limits, longer than max_duration "
            f"{max_duration:g} s"
        )
    if steps > _INSTANTS:
        raise InvalidInputError(
            f"the motion takes {duration:.3g} s within the limits, more than {_INSTANTS:,} "
            f"instants at the rate {rate:g}"
        )
    times = np.arange(int(steps) + 1) / rate
    rates = replace(timing, duration=duration).rates(times)
    positions, velocities, accelerations, _ = over_time(curve, rates)
    motion = Motion(
        path, limits, arm, times, positions, velocities, accelerations, float(timing.bound)
    )
    if arm is None:
        return motion
    checked = np.linspace(0, 1, int(np.ceil(2 * path.length / _APART)) + 2)
    contact = arm.first_contact(path.scene.obstacles, courses[0].spline(checked))
    if contact is not None:
        index, link, thing = contact
        where = np.round(curve(checked[index]), 3).tolist()
        raise InvalidInputError(
            f"the arm {arm.name} cannot follow this path: its {link} touches {thing} where its "
            f"grasp point is at {where} m"
        )
    positions, velocities, accelerations, _ = courses[0].over_time(rates)
    return replace(
        motion, joint_positions=positions, joint_velocities=velocities,
        joint_accelerations=accelerations,
    )  # fmt: skip


def _joints_along(curve: BSpline, arm: Arm) -> BSpline:
    """The spline of joint angles that leads an arm's grasp point along a curve.

    Raises:
        InvalidInputError: the arm cannot reach a point of the curve.
    """
    kinematics = arm.kinematics()
    places = np.linspace(0, 1, _KNOTS)
    angles: list[Array] = []
    for place in places:
        angles.append(_reach(curve, arm, float(place), angles[-1] if angles else None))
    for _ in range(_ROUNDS):
        spline = make_interp_spline(places, np.array(angles), k=5)
        between = (places[1:] + places[:-1]) / 2
        reached = np.array([kinematics.grasp_point(a) for a in spline(between)])
        (off,) = np.nonzero(np.linalg.norm(reached - curve(between), axis=-1) > _DEVIATION)
        if not len(off):
            return spline
        for index in off[::-1]:
            angles.insert(index + 1, _reach(curve, arm, float(between[index]), angles[index]))
        places = np.sort(np.concatenate([places, between[off]]))
    raise InvalidInputError(f"the joints of the arm {arm.name} turn too abruptly along the path")


def _reach(curve: BSpline, arm: Arm, place: float, near: Array | None) -> Array:
    """Angles `(J,)` [rad] at a place of the curve, near others."""
    target, kinematics = curve(place), arm.kinematics()
    angles, gap = kinematics.reach(target, near)
    if gap > _DEVIATION:
        waypoint = round(place * (len(curve.c) - 1))
        raise InvalidInputError(
            f"the arm {arm.name} cannot reach {np.round(target, 4).tolist()} m, near waypoint "
            f"{waypoint} of its path, by {1e3 * gap:.3g} mm with its gripper held as it is"
        )
    return angles
