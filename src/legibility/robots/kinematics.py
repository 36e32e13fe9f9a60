"""Where the joints of an arm put its grasp point, and which angles put it where it should be."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..checks import Array
from .simulator import import_mujoco, quaternion

if TYPE_CHECKING:
    from .arm import Arm

JOINT_MARGIN = 0.02
"""Distance of the joints from their limits [rad]."""

_TOLERANCE = 1e-7  # [rad]
_STEPS = 50


class Kinematics:
    """Forward and inverse kinematics of the grasp point.

    A quadratic programme of mink: the grasp point goes to a target, the gripper keeps its direction
    and does not turn, the elbow stays at home, all joints stay within their limits. So a position
    has one posture, whichever way the arm came.
    """

    def __init__(self, arm: Arm) -> None:
        mink, model = import_mujoco("mink"), arm.physics()
        self._arm, self._mujoco, self._build = arm, import_mujoco(), mink.build_ik
        self._configuration = mink.Configuration(model)
        self._site = model.site(arm.site).id
        self._frame = mink.FrameTask(arm.site, "site", position_cost=1.0, orientation_cost=0.2)
        cost = np.where(np.arange(arm.joints) == arm.elbow, 1e-2, 1e-5)
        self._elbow, self._rest = (mink.PostureTask(model, cost, gain=g) for g in (0.3, 1.0))
        for task in (self._elbow, self._rest):
            task.set_target(arm.home)
        self._limits = [mink.ConfigurationLimit(model, 1.0, min_distance_from_limits=JOINT_MARGIN)]
        self._pose = mink.SE3(np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]))
        self._upright = quaternion(arm.gripper_to_world)

    def __reduce__(self) -> tuple[type[Kinematics], tuple[Arm]]:
        return Kinematics, (self._arm,)

    def grasp_point(self, angles: Array) -> Array:
        """The grasp point `(3,)` [m] at `angles (J,)` [rad]."""
        data = self._configuration.data
        data.qpos = angles
        self._mujoco.mj_kinematics(self._configuration.model, data)
        return data.site_xpos[self._site].copy()

    def step(self, angles: Array, target: Array) -> Array:
        """Change of the joints from `angles` toward the grasp point `target`, `(J,)` [rad]."""
        self._aim(target)
        return self._solve(angles, self._elbow)

    def solve(self, target: Array) -> Array:
        """Angles `(J,)` [rad] that put the grasp point at `target`, searched from home."""
        self._aim(target)
        angles = self._arm.home.copy()
        for _ in range(100):
            step = self._solve(angles, self._rest)
            angles += step * min(1.0, 0.3 / max(np.abs(step).max(), 1e-12))
            if np.abs(step).max() < _TOLERANCE:
                break
        return angles

    def reach(self, target: Array, near: Array | None = None) -> tuple[Array, float]:
        """Angles `(J,)` [rad] nearest to `target` that follow from those `near`, or from home.

        The second value is the distance that is left [m].
        """
        angles = self.solve(target) if near is None else near.copy()
        for _ in range(_STEPS):
            step = self.step(angles, target)
            angles = angles + step
            if np.abs(step).max() < _TOLERANCE:
                break
        return angles, float(np.linalg.norm(self.grasp_point(angles) - target))

    def _aim(self, target: Array) -> None:
        self._pose.wxyz_xyz[:4] = self._orientation(target)
        self._pose.wxyz_xyz[4:] = target
        self._frame.set_target(self._pose)

    def _solve(self, angles: Array, posture: Any) -> Array:
        self._configuration.update(angles)
        problem = self._build(
            self._configuration, [self._frame, posture], dt=1.0, limits=self._limits
        )
        # Away from the limits, nearly always, they do not change the minimum.
        step = np.linalg.solve(problem.P, -problem.q)
        if problem.G is None or (problem.G @ step <= problem.h).all():
            return step
        import qpsolvers

        solution = qpsolvers.solve_problem(problem, solver="daqp").x
        return np.zeros_like(angles) if solution is None else solution

    def _orientation(self, target: Array) -> Array:
        """The gripper's orientation in the world at `target`, a quaternion `(4,)` (w, x, y, z).

        Beyond the arm's reach it leans back toward the base, by the least angle that suffices.
        """
        if self._arm.lean is None:
            return self._upright
        height, wrist, reach = self._arm.lean
        x, y, z = target - self._arm.base[:3] - [0, 0, height]
        radius = max(np.hypot(x, y), 1e-9)
        distance, arm = np.hypot(radius, z), np.hypot(*wrist)
        # |target + wrist, turned by the lean − shoulder| = reach, by the law of cosines.
        cosine = (reach**2 - distance**2 - arm**2) / (2 * distance * arm)
        lean = np.arccos(np.clip(cosine, -1, 1)) - np.arctan2(wrist[1], wrist[0])
        lean = max(0.0, lean + np.arctan2(z, radius)) / 2
        back = [np.cos(lean), np.sin(lean) * y / radius, -np.sin(lean) * x / radius, 0.0]
        turned = np.zeros(4)
        self._mujoco.mju_mulQuat(turned, back, self._upright)
        return turned
