"""Arms: what they look like, where their joints put the grasp point, and what they touch.

An arm is any MJCF model of a chain of hinges with a site at its grasp point. It stands on a table,
and its gripper keeps one direction, so a position of the grasp point has one posture.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..checks import Array, finite_array, positive
from ..curves import arc_length, resample
from ..errors import InvalidInputError, MissingExtraError
from ..files import at_home, read_document
from ..obstacles import Obstacle
from .limits import Limits
from .simulator import import_mujoco, quaternion, solid_geom

JOINT_MARGIN = 0.02
"""Distance of the joints from their limits [rad]."""

NEAR = 0.06
"""Gap between a link and an obstacle up to which it is measured [m]: more than a step's reach."""

TABLE = Path(__file__).with_name("table.xml")

_TOLERANCE = 1e-7  # [rad]
_STEPS = 50

_OBSTACLES = 5
"""The group of the obstacles' geoms."""

_STEP = 0.01
"""Distance between the points at which a trajectory is checked for contacts [m]."""

_SLOW = 0.02
"""Lag [s] of a model's servos above which stiffer ones take their place."""

_STIFFNESS, _DAMPING_TIME, _TORQUE = 400.0, 1 / 75, 100.0
"""Of the stiffer servos: stiffness over the greatest torque [1/rad], damping over stiffness [s],
and the torque where the model has none [N m]."""


class Lean(NamedTuple):
    """How the gripper leans back toward the base to reach places beyond the arm's reach.

    Attributes:
        shoulder: height above the base [m] of the point about which the arm stretches.
        wrist: from the grasp point to the wrist, away from the base and up, `(2,)` [m].
        reach: greatest distance of the wrist from the shoulder [m].
    """

    shoulder: float
    wrist: tuple[float, float]
    reach: float


@dataclass(frozen=True, eq=False)
class Arm:
    """An arm on a table.

    Attributes:
        model: the MJCF file, or the name of a model of MuJoCo Menagerie (extra `arms`).
        site: name of the model's site at the grasp point; its z axis is the gripper's direction.
        home: angles `(J,)` [rad] at which inverse kinematics start, which choose among postures.
        limits: of its joints.
        base: where it stands: x, y, z [m], and its turn about z [rad].
        gripper: direction in which the gripper points, `(3,)`; down if not given.
        roll: turn of the gripper about that direction [rad]; 0 keeps its x axis along that of the
            base as nearly as it can be.
        elbow: index of the joint that a redundant arm keeps at its home.
        lean: how the gripper leans back at places that are far away; if not given, they cannot be
            reached.
        name: of the arm.

    Raises:
        InvalidInputError: the limits are not of as many joints as the home, or a value is none.
    """

    model: str | Path
    site: str
    home: Array
    limits: Limits
    base: Array
    gripper: Array
    roll: float
    elbow: int | None
    lean: Lean | None
    name: str

    def __init__(
        self,
        model: str | Path,
        site: str,
        home: ArrayLike,
        limits: Limits | str,
        *,
        base: ArrayLike = (0, 0, 0, 0),
        gripper: ArrayLike = (0, 0, -1),
        roll: float = 0.0,
        elbow: int | None = None,
        lean: Lean | None = None,
        name: str | None = None,
    ) -> None:
        home = finite_array("home", home, ndim=1)
        base = finite_array("base", base, ndim=1)
        gripper = finite_array("gripper", gripper, ndim=1, last=3)
        if base.shape != (4,):
            raise InvalidInputError(f"base must be x, y, z and a turn, got {base.tolist()}")
        if not np.linalg.norm(gripper):
            raise InvalidInputError("gripper must be a direction, got a vector without length")
        limits = Limits.named(limits) if isinstance(limits, str) else limits
        if not isinstance(limits, Limits):
            raise InvalidInputError(f"limits must be legibility.Limits or a name, got {limits!r}")
        if not isinstance(model, str | Path):
            raise InvalidInputError(f"model must be a file or a name, got {model!r}")
        if limits.joints != len(home):
            raise InvalidInputError(
                f"limits must be of the {len(home)} joints of home, got those of "
                f"{limits.joints or 'a point'}"
            )
        if elbow is not None and (type(elbow) is not int or elbow not in range(len(home))):
            raise InvalidInputError(f"elbow must be a joint from 0 to {len(home) - 1}, got {elbow}")
        if lean is not None:
            try:
                height, wrist, reach = lean
            except (TypeError, ValueError) as cause:
                raise InvalidInputError(f"lean must be of three values, got {lean!r}") from cause
            away, up = finite_array("lean", wrist, ndim=1, last=2).tolist()
            lean = Lean(positive("lean", height), (away, up), positive("lean", reach))
        file = at_home(model)
        model = file.resolve() if file.is_file() else model
        values = {
            "model": model, "site": site, "home": home, "limits": limits, "base": base,
            "gripper": gripper / np.linalg.norm(gripper), "elbow": elbow, "lean": lean,
            "roll": float(finite_array("roll", roll, ndim=0)),
            "name": str(name or Path(model).stem),
        }  # fmt: skip
        for key, value in values.items():
            object.__setattr__(self, key, value)

    @classmethod
    def load(cls, file: str | Path) -> Arm:
        """Read an arm from YAML or JSON: the arguments by their names.

        `model` may be relative to the file; `limits` is a name, or a mapping of `velocity`,
        `acceleration` and `jerk`, and of `braking` and `tip`, which is such a mapping of a point.

        Raises:
            InvalidInputError: the file cannot be read, or does not describe an arm.
        """
        content = read_document(file, "arm")
        if not isinstance(content, dict):
            raise InvalidInputError(f"{file} must hold a mapping with model, site, home and limits")
        content = dict(content)
        try:
            if isinstance(limits := content.get("limits"), dict):
                tip = limits.get("tip")
                if isinstance(tip, dict):
                    limits = {**limits, "tip": Limits(**tip)}
                content["limits"] = Limits(**limits)
            beside = at_home(file).parent / str(content.get("model"))
            if beside.is_file():
                content["model"] = beside
            return cls(**content)
        except (TypeError, InvalidInputError) as cause:
            raise InvalidInputError(f"{file} does not describe an arm: {cause}") from cause

    @classmethod
    def named(cls, name: str) -> Arm:
        """One of `ARMS`, or the arm of a YAML or JSON file.

        Raises:
            InvalidInputError: there is none of that name.
        """
        if name in ARMS:
            return ARMS[name]
        if Path(name).suffix in (".yaml", ".yml", ".json"):
            return cls.load(name)
        raise InvalidInputError(
            f"arm must be one of {', '.join(ARMS)}, or a YAML or JSON file, got {name!r}"
        )

    @property
    def joints(self) -> int:
        """J."""
        return len(self.home)

    @property
    def base_to_world(self) -> Array:
        """The base's axes in the world, `(3, 3)`."""
        cos, sin = np.cos(self.base[3]), np.sin(self.base[3])
        return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])

    @property
    def gripper_to_world(self) -> Array:
        """The gripper's axes in the world where it does not lean, `(3, 3)`."""
        forward = self.base_to_world[:, 0]
        across = forward - (forward @ self.gripper) * self.gripper
        if np.linalg.norm(across) < 1e-6:  # it points forward
            across = np.array([0.0, 0.0, 1.0])
        across /= np.linalg.norm(across)
        side = np.cross(self.gripper, across)
        x = np.cos(self.roll) * across + np.sin(self.roll) * side
        frame = np.stack([x, np.cross(self.gripper, x), self.gripper], axis=1)
        return frame.astype(np.float64)

    @property
    def base_name(self) -> str:
        """Of the model's first body."""
        model = self.physics()
        return model.body(int(model.body_rootid[model.site(self.site).bodyid[0]])).name

    @property
    def joint_names(self) -> list[str]:
        """Of the model, from the base on."""
        model = self.physics()
        return [model.joint(i).name for i in range(self.joints)]

    @property
    def joint_range(self) -> Array:
        """Least and greatest angle of each joint, `(2, J)` [rad]; infinite where there is none."""
        model = self.physics()
        return np.where(model.jnt_limited, model.jnt_range.T, [[-np.inf], [np.inf]])

    def specification(self) -> Any:
        """The arm on its table as an `MjSpec`: geoms of group 2 are looks, and touch nothing."""
        return _specification(self)

    def physics(self, obstacles: tuple[Obstacle, ...] = ()) -> Any:
        """The arm on its table as an `MjModel` of what collides, shared and never changed."""
        return _physics(self, obstacles)

    def kinematics(self) -> Kinematics:
        """Forward and inverse kinematics, shared in this process."""
        return _kinematics(self)

    def postures(self, points: Array) -> Array:
        """Angles `(P, J)` [rad] that lead the grasp point through `points (P, 3)` [m], in turn."""
        kinematics = self.kinematics()
        angles = [kinematics.solve(points[0])]
        for point in points[1:]:
            angles.append(angles[-1] + kinematics.step(angles[-1], point))
        return np.array(angles)

    def nearby(self, obstacles: tuple[Obstacle, ...], angles: Array) -> Iterator[Nearby]:
        """What is near obstacles, for each pose of the arm at `angles (T, J)` [rad].

        All links that move count, with the shapes that collide in the simulation.
        """
        model = self.physics(obstacles)
        solid = model.geom_group == _OBSTACLES
        first = int(np.argmax(solid))
        for data in _posed(model, angles):
            contact = data.contact
            pairs = contact.geom[: data.ncon]
            (rows,) = np.nonzero(solid[pairs].any(-1))
            pairs, from_obstacle = pairs[rows], solid[pairs[rows, 0]]
            links = model.geom_bodyid[np.where(from_obstacle, pairs[:, 1], pairs[:, 0])]
            yield Nearby(
                [model.body(link).name for link in links],
                np.where(from_obstacle, pairs[:, 0], pairs[:, 1]) - first,
                contact.dist[rows],
                np.where(from_obstacle, 1, -1)[:, None] * contact.frame[rows, :3],
            )

    def first_contact(
        self, obstacles: tuple[Obstacle, ...], angles: Array
    ) -> tuple[int, str, str] | None:
        """The first of the poses `angles (T, J)` [rad] in which the arm touches anything, if any.

        Its index, the link, and what it touches: an obstacle, the table, or another link.
        """
        model = self.physics(obstacles)
        solid = model.geom_group == _OBSTACLES
        first = int(np.argmax(solid))

        def name(geom: int) -> str:
            if solid[geom]:
                return f"obstacles[{geom - first}]"
            body = int(model.geom_bodyid[geom])
            return model.body(body).name if body else "table"

        for index, data in enumerate(_posed(model, angles)):
            for row in np.flatnonzero(data.contact.dist[: data.ncon] < 0):
                things = sorted(data.contact.geom[row], key=lambda g: model.geom_bodyid[g] == 0)
                return index, name(things[0]), name(things[1])
        return None

    def obstacle_gaps(self, obstacles: tuple[Obstacle, ...], angles: Array) -> Array:
        """Least gap [m] between the arm at `angles (T, J)` [rad] and an obstacle, `(T,)`.

        It is below 0 in contact, and `NEAR` at most.
        """
        return np.array([near.gaps.min(initial=NEAR) for near in self.nearby(obstacles, angles)])


def _posed(model: Any, angles: Array) -> Iterator[Any]:
    """An `MjData` with the contacts of each pose at `angles (T, J)` [rad]."""
    mujoco = import_mujoco()
    data = mujoco.MjData(model)
    for pose in angles:
        data.qpos = pose
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_collision(model, data)
        yield data


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


def _specification(arm: Arm) -> Any:
    mujoco = import_mujoco()
    robot, chain, root = _chain(arm)
    names = [joint.name for joint in chain]
    for part in (*robot.equalities, *robot.tendons, *robot.keys, *robot.sensors, *robot.lights):
        robot.delete(part)
    for joint in list(robot.joints):
        if joint.name not in names:
            robot.delete(joint)  # of a gripper, which is held still
    root.name = root.name or "base"
    for link in robot.bodies[1:]:
        link.gravcomp = 1
    for geom in robot.geoms:
        geom.group = min(geom.group, _OBSTACLES - 1)
    _add_servos(robot, names)
    turn = np.array([np.cos(arm.base[3] / 2), 0, 0, np.sin(arm.base[3] / 2)])
    root.set_frame(robot.worldbody.add_frame(pos=arm.base[:3], quat=turn))
    _add_table(robot)
    forms = mujoco.mjtObj
    touch = {"type": mujoco.mjtSensor.mjSENS_CONTACT, "reftype": forms.mjOBJ_XBODY,
             "refname": root.name, "intprm": [1, 0, 1]}  # fmt: skip
    robot.add_sensor(name="table", objtype=forms.mjOBJ_GEOM, objname="room/table", **touch)
    robot.add_sensor(name="self", objtype=forms.mjOBJ_XBODY, objname=root.name, **touch)
    return robot


def _chain(arm: Arm) -> tuple[Any, list[Any], Any]:
    """The model as an `MjSpec`, its joints from the base to the site, and its first body."""
    mujoco = import_mujoco()
    try:
        robot = mujoco.MjSpec.from_file(str(_file(arm.model)))
    except (ValueError, OSError) as cause:
        reason = " ".join(str(cause).split())
        raise InvalidInputError(f"cannot read the model {arm.model}: {reason}") from cause
    sites = {site.name: site for site in robot.sites}
    if arm.site not in sites:
        known = ", ".join(sorted(name for name in sites if name)) or "none"
        raise InvalidInputError(f"{arm.model} has no site {arm.site!r}; its sites are {known}")
    chain, root = [], sites[arm.site].parent
    while True:
        chain = [*root.joints, *chain]
        if root.parent is None or root.parent.name == "world":
            break
        root = root.parent
    names = [joint.name for joint in chain]
    if (
        len(chain) != len(arm.home)
        or not all(names)
        or any(joint.type != mujoco.mjtJoint.mjJNT_HINGE for joint in chain)
    ):
        raise InvalidInputError(
            f"home must have an angle of each joint, a hinge with a name, from the base to the "
            f"site {arm.site}: {', '.join(names) or 'there is none'}; got {len(arm.home)}"
        )
    return robot, chain, root


def _add_servos(robot: Any, names: list[str]) -> None:
    """Put a position servo at each of joints `names`, in their order, and no other motor.

    The model's own stiffness, damping and torque remain where it has a servo that hardly lags.
    """
    mujoco, own = import_mujoco(), {}
    for motor in list(robot.actuators):
        _, stiffness, damping = motor.biasprm[:3]
        most = float(motor.forcerange[1]) or _TORQUE
        own[motor.target] = most, _STIFFNESS * most, _STIFFNESS * most * _DAMPING_TIME
        plain = motor.gear[0] == 1 and motor.dyntype == mujoco.mjtDyn.mjDYN_NONE
        if plain and stiffness < 0 and damping / stiffness <= _SLOW:
            own[motor.target] = most, -stiffness, -damping
        robot.delete(motor)
    default = _TORQUE, _STIFFNESS * _TORQUE, _STIFFNESS * _TORQUE * _DAMPING_TIME
    for name in names:
        most, stiffness, damping = own.get(name, default)
        servo = robot.add_actuator(
            name=f"{name}_servo", target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT,
            forcerange=[-most, most],
        )  # fmt: skip
        servo.set_to_position(kp=stiffness, kv=damping)


def _add_table(robot: Any) -> None:
    """Put a table, lights and the physics of all that is simulated into a model."""
    table = import_mujoco().MjSpec.from_file(str(TABLE))
    for part in ("option", "stat", "visual"):
        setattr(robot, part, getattr(table, part))
    robot.attach(table, frame=robot.worldbody.add_frame(), prefix="room/")


def _file(model: str | Path) -> Path:
    """The MJCF file of a model."""
    path = at_home(model)
    if path.suffix == ".xml" or path.is_file():
        return path
    try:
        import mujoco_menagerie
    except ModuleNotFoundError as cause:
        raise MissingExtraError(
            f"{model} is no file, and mujoco-menagerie, which knows models by name, is not "
            "installed: pip install 'legibility[arms]'"
        ) from cause
    try:
        robot = mujoco_menagerie.get(str(model))
        return robot.xml(robot.default_model)
    except mujoco_menagerie.MenagerieError as cause:
        raise InvalidInputError(f"cannot get the model {model}: {cause}") from cause


@functools.lru_cache(maxsize=64)
def _physics(arm: Arm, obstacles: tuple[Obstacle, ...]) -> Any:
    spec = _specification(arm)
    whole = compiled(spec, arm.model)
    for link in spec.bodies[1:]:
        if not link.explicitinertial:  # the looks that go have the mass
            body = whole.body(link.id)
            link.mass, link.ipos, link.iquat = float(body.mass[0]), body.ipos, body.iquat
            link.inertia, link.explicitinertial = body.inertia, True
    for geom in list(spec.geoms):
        if not geom.contype and not geom.conaffinity:
            spec.delete(geom)
    meshes = {geom.meshname for geom in spec.geoms}
    for mesh in list(spec.meshes):
        if mesh.name not in meshes:
            spec.delete(mesh)
    for obstacle in obstacles:
        form, size, pose = solid_geom(obstacle)
        spec.worldbody.add_geom(
            type=form, size=size, pos=pose[:3, 3], quat=quaternion(pose[:3, :3]),
            group=_OBSTACLES, margin=NEAR,
        )  # fmt: skip
    return compiled(spec, arm.model)


def compiled(spec: Any, model: str | Path) -> Any:
    """The `MjModel` of a specification.

    Raises:
        InvalidInputError: MuJoCo refuses the `model` that it was made from.
    """
    try:
        return spec.compile()
    except ValueError as cause:
        reason = " ".join(str(cause).split())
        raise InvalidInputError(f"cannot use the model {model}: {reason}") from cause


@functools.lru_cache(maxsize=8)
def _kinematics(arm: Arm) -> Kinematics:
    return Kinematics(arm)


def checked_points(trajectory: Array) -> Array:
    """Points `(P, 3)` [m] of `trajectory (T, 3)` [m] at which an arm is checked, 1 cm apart."""
    return resample(trajectory, int(np.ceil(arc_length(trajectory) / _STEP)) + 2)


PANDA = Arm(
    Path(__file__).with_name("panda.xml"), "grasp", [0.0, 0.41, 0.0, -1.85, 0.0, 2.26, 0.79],
    "panda", base=[-0.6, 0, 0, 0], elbow=2, lean=Lean(0.333, (-0.088, 0.1034 + 0.107), 0.71),
    name="panda",
)  # fmt: skip
"""The Franka Panda with its hand, behind the table of the paper."""

ARMS = {"panda": PANDA}
"""The arms that the package knows by name."""
