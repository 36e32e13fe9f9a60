"""The Franka Panda in MuJoCo: its model, inverse kinematics and physics."""

from __future__ import annotations

import functools
import importlib
import os
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..checks import Array
from ..curves import arc_length, resample
from ..errors import MissingExtraError
from ..obstacles import Ball, Box, Obstacle
from .arm import BASE, HOME

_SHOULDER = np.array([BASE[0], BASE[1], BASE[2] + 0.333])
_WRIST = np.array([-0.088, 0.1034 + 0.107])
"""From the grasp point to the wrist, away from the base and up, with the gripper down [m]."""

_REACH = 0.71
"""Greatest distance of the wrist from the shoulder [m]; the stretched arm has 0.719."""

JOINT_MARGIN = 0.02
"""Distance of the joints from their limits [rad]."""

_TOLERANCE = 1e-7

_OBSTACLES = 5
"""The group of the obstacles' geoms."""

NEAR = 0.06
"""Gap between a link and an obstacle up to which it is measured [m]: more than a step's reach."""

_STEP = 0.01
"""Distance between the points at which a trajectory is checked for contacts [m]."""


def import_mujoco(module: str = "mujoco") -> Any:
    """MuJoCo, or a module that builds on it, loaded on first use."""
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as cause:
        raise MissingExtraError(
            f"{cause.name} is not installed: pip install 'legibility[panda]'"
        ) from cause
    except Exception as cause:
        backend = os.environ.pop("MUJOCO_GL", None)  # the physics needs no OpenGL
        if backend is None:
            raise
        warnings.warn(
            f"ignoring MUJOCO_GL={backend}, which does not work: {cause}; unset it, or choose egl, "
            "osmesa or glfw",
            stacklevel=2,
        )
    for name in [n for n in sys.modules if n.partition(".")[0] in ("mujoco", "OpenGL")]:
        del sys.modules[name]
    return import_mujoco(module)


def specification() -> Any:
    """The arm on its table as an `MjSpec`: geoms of group 3 collide, those of 2 are visible."""
    return import_mujoco().MjSpec.from_file(str(Path(__file__).with_name("panda.xml")))


@functools.lru_cache(maxsize=32)
def physics(obstacles: tuple[Obstacle, ...] = ()) -> Any:
    """The arm on its table as an `MjModel` of primitive shapes, shared and never changed."""
    spec = specification()
    for geom in list(spec.geoms):
        if geom.group == 2:
            spec.delete(geom)
    for obstacle in obstacles:
        form, size, pose = solid_geom(obstacle)
        turn = _quaternion(pose[:3, :3])
        spec.worldbody.add_geom(
            type=form, size=size, pos=pose[:3, 3], quat=turn, group=_OBSTACLES, margin=NEAR
        )
    return spec.compile()


def solid_geom(obstacle: Obstacle) -> tuple[Any, Array, Array]:
    """Type, size `(3,)` [m] and pose `(4, 4)` in the world of an obstacle as a geom."""
    forms, pose = import_mujoco().mjtGeom, np.eye(4)
    assert isinstance(obstacle, Ball | Box)
    pose[:3, 3] = obstacle.center
    if isinstance(obstacle, Ball):
        return forms.mjGEOM_SPHERE, np.array([obstacle.radius, 0, 0]), pose
    pose[:3, :3] = obstacle.rotation
    return forms.mjGEOM_BOX, obstacle.size / 2, pose


def _quaternion(rotation: Array) -> Array:
    quaternion = np.zeros(4)
    import_mujoco().mju_mat2Quat(quaternion, rotation.ravel())
    return quaternion


class Kinematics:
    """Forward and inverse kinematics of the grasp point.

    A quadratic programme of mink: the grasp point goes to a target, the gripper stays down and does
    not turn, the elbow stays up (joint 3 at 0), all joints stay within their limits. So a position
    has one posture, whichever way the arm came.
    """

    def __init__(self) -> None:
        mink, model = import_mujoco("mink"), physics()
        self._mujoco, self._build = import_mujoco(), mink.build_ik
        self._configuration = mink.Configuration(model)
        self._site = model.site("grasp").id
        self._frame = mink.FrameTask("grasp", "site", position_cost=1.0, orientation_cost=0.2)
        cost = np.where(np.arange(7) == 2, 1e-2, 1e-5)
        self._elbow, self._rest = (mink.PostureTask(model, cost, gain=g) for g in (0.3, 1.0))
        for task in (self._elbow, self._rest):
            task.set_target(HOME)
        self._limits = [mink.ConfigurationLimit(model, 1.0, min_distance_from_limits=JOINT_MARGIN)]
        self._pose = mink.SE3(np.array([0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0]))

    def __reduce__(self) -> tuple[type[Kinematics], tuple[()]]:
        return Kinematics, ()

    def grasp_point(self, angles: Array) -> Array:
        """The grasp point `(3,)` [m] at `angles (7,)` [rad]."""
        data = self._configuration.data
        data.qpos = angles
        self._mujoco.mj_kinematics(self._configuration.model, data)
        return data.site_xpos[self._site].copy()

    def step(self, angles: Array, target: Array) -> Array:
        """Change of the joints from `angles` toward the grasp point `target`, `(7,)` [rad]."""
        self._aim(target)
        return self._solve(angles, self._elbow)

    def solve(self, target: Array) -> Array:
        """Angles `(7,)` [rad] that put the grasp point at `target`, searched from `HOME`."""
        self._aim(target)
        angles = HOME.copy()
        for _ in range(100):
            step = self._solve(angles, self._rest)
            angles += step * min(1.0, 0.3 / max(np.abs(step).max(), 1e-12))
            if np.abs(step).max() < _TOLERANCE:
                break
        return angles

    def _aim(self, target: Array) -> None:
        self._pose.wxyz_xyz[:4] = _orientation(target)
        self._pose.wxyz_xyz[4:] = target
        self._frame.set_target(self._pose)

    def _solve(self, angles: Array, posture: Any) -> Array:
        self._configuration.update(angles)
        problem = self._build(
            self._configuration, [self._frame, posture], dt=1.0, limits=self._limits
        )
        # Away from the limits, nearly always, they do not change the minimum.
        step = np.linalg.solve(problem.P, -problem.q)
        if (problem.G @ step <= problem.h).all():
            return step
        import qpsolvers

        solution = qpsolvers.solve_problem(problem, solver="daqp").x
        return np.zeros_like(angles) if solution is None else solution


@functools.cache
def _shared_kinematics() -> Kinematics:
    return Kinematics()


class Nearby(NamedTuple):
    """Pairs of a link and an obstacle that are at most `NEAR` apart.

    Attributes:
        links: `(C,)`, names of the links.
        obstacles: `(C,)`, indices of the obstacles.
        gaps: `(C,)` [m], below 0 in contact.
        normals: `(C, 3)`, from the obstacle to the link, across a plane that separates them.
    """

    links: list[str]
    obstacles: NDArray[np.intp]
    gaps: Array
    normals: Array


def nearby(obstacles: tuple[Obstacle, ...], angles: Array) -> Iterator[Nearby]:
    """What is near obstacles, for each pose of an arm at `angles (T, 7)` [rad].

    All links that move count, with the shapes that collide in the simulation.
    """
    mujoco, model = import_mujoco(), physics(obstacles)
    data, solid = mujoco.MjData(model), model.geom_group == _OBSTACLES
    first = int(np.argmax(solid))
    for pose in angles:
        data.qpos = pose
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_collision(model, data)
        contact, number = data.contact, data.ncon
        pairs = contact.geom[:number]
        (rows,) = np.nonzero(solid[pairs].any(-1))
        pairs, from_obstacle = pairs[rows], solid[pairs[rows, 0]]
        links = model.geom_bodyid[np.where(from_obstacle, pairs[:, 1], pairs[:, 0])]
        yield Nearby(
            [model.body(link).name for link in links],
            np.where(from_obstacle, pairs[:, 0], pairs[:, 1]) - first,
            contact.dist[rows],
            np.where(from_obstacle, 1, -1)[:, None] * contact.frame[rows, :3],
        )


def obstacle_gaps(obstacles: tuple[Obstacle, ...], angles: Array) -> Array:
    """Least gap [m] between an arm at `angles (T, 7)` [rad] and an obstacle, `(T,)`.

    It is below 0 in contact, and `NEAR` at most.
    """
    return np.array([near.gaps.min(initial=NEAR) for near in nearby(obstacles, angles)])


def checked_points(trajectory: Array) -> Array:
    """Points `(P, 3)` [m] of `trajectory (T, 3)` [m] at which an arm is checked, 1 cm apart."""
    return resample(trajectory, int(np.ceil(arc_length(trajectory) / _STEP)) + 2)


def postures(points: Array) -> Array:
    """Angles `(P, 7)` [rad] that lead the grasp point through `points (P, 3)` [m], near in turn."""
    kinematics = _shared_kinematics()
    angles = [kinematics.solve(points[0])]
    for point in points[1:]:
        angles.append(angles[-1] + kinematics.step(angles[-1], point))
    return np.array(angles)


class Simulation:
    """MuJoCo's physics of many arms; a call does not depend on earlier ones."""

    def __init__(self) -> None:
        mujoco, self._model = import_mujoco(), physics()
        from mujoco import rollout

        self._data = mujoco.MjData(self._model)
        self._rollout: Any = rollout.Rollout(nthread=0)
        self._size = mujoco.mj_stateSize(self._model, mujoco.mjtState.mjSTATE_FULLPHYSICS)

    def __reduce__(self) -> tuple[type[Simulation], tuple[()]]:
        return Simulation, ()

    def run(self, angles: Array, speeds: Array, controls: Array) -> tuple[Array, Array, Array]:
        """Simulate `T` steps from `angles` [rad] and `speeds` [rad/s], `(B, 7)` each.

        The motors' goals are `controls (B, T, 7)` [rad]. Return angles and speeds after each step
        `(B, T, 7)`, and whether the arm touched the table and itself before it, `(B, T, 2)`.
        """
        start = np.zeros((len(angles), self._size))
        start[:, 1:8], start[:, 8:15] = angles, speeds
        states, sensors = self._rollout.rollout(self._model, self._data, start, controls)
        return states[..., 1:8], states[..., 8:15], sensors > 0


def _orientation(target: Array) -> Array:
    """The gripper's orientation in the world at `target`, a quaternion `(4,)` (w, x, y, z).

    It points down, its x axis along the world's. Beyond the arm's reach it leans back toward the
    base, by the least angle that suffices.
    """
    x, y, z = target - _SHOULDER
    radius = np.hypot(x, y)
    distance, arm = np.hypot(radius, z), np.hypot(*_WRIST)
    # |target + wrist, turned by the lean − shoulder| = reach, by the law of cosines.
    cosine = (_REACH**2 - distance**2 - arm**2) / (2 * distance * arm)
    lean = np.arccos(np.clip(cosine, -1, 1)) - np.arctan2(_WRIST[1], _WRIST[0])
    lean = max(0.0, lean + np.arctan2(z, radius)) / 2
    return np.array([-np.sin(lean) * y / radius, np.cos(lean), 0.0, np.sin(lean) * x / radius])
