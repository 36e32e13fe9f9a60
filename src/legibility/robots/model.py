"""The MJCF model of an arm, on its table, ready for kinematics, contacts and physics."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import InvalidInputError, MissingExtraError
from ..files import at_home
from ..obstacles import Obstacle
from .simulator import import_mujoco, quaternion, solid_geom

if TYPE_CHECKING:
    from .arm import Arm

NEAR = 0.06
"""Gap between a link and an obstacle up to which it is measured [m]: more than a step's reach."""

OBSTACLES = 5
"""The group of the obstacles' geoms."""

_TABLE = Path(__file__).with_name("table.xml")

_SLOW = 0.02
"""Lag [s] of a model's servos above which stiffer ones take their place."""

_STIFFNESS, _DAMPING_TIME, _TORQUE = 400.0, 1 / 75, 100.0
"""Of the stiffer servos: stiffness over the greatest torque [1/rad], damping over stiffness [s],
and the torque where the model has none [N m]."""


def specification(arm: Arm) -> Any:
    """An arm on its table as an `MjSpec`: geoms of group 2 are looks.

    Raises:
        InvalidInputError: the model cannot be read, or has no such site or other joints.
    """
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
        geom.group = min(geom.group, OBSTACLES - 1)
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
    table = import_mujoco().MjSpec.from_file(str(_TABLE))
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
def physics(arm: Arm, obstacles: tuple[Obstacle, ...]) -> Any:
    """An arm on its table as an `MjModel` of what collides, with obstacles of group `OBSTACLES`."""
    spec = specification(arm)
    if without := [link for link in spec.bodies[1:] if not link.explicitinertial]:
        whole = compiled(spec, arm.model)  # the looks that go have the mass
        for link in without:
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
            group=OBSTACLES, margin=NEAR,
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
