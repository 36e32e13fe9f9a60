"""Arms: what they look like, where their joints put the grasp point, and what they touch.

An arm is any MJCF model of a chain of hinges with a site at its grasp point. It stands on a table,
and its gripper keeps one direction, so a position of the grasp point has one posture.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..checks import Array, did_you_mean, finite_array, positive
from ..curves import arc_length, resample
from ..errors import InvalidInputError
from ..files import at_home, read_document
from ..obstacles import Obstacle
from . import ARM_NAMES
from . import model as models
from .kinematics import Kinematics
from .limits import Limits
from .model import NEAR
from .simulator import import_mujoco

_STEP = 0.01
"""Distance between the points at which a trajectory is checked for contacts [m]."""


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
                content["limits"] = _limits(limits)
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
            f"{did_you_mean(name, ARM_NAMES)}"
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

    def in_world(self, points: ArrayLike) -> Array:
        """Points `(..., 3)` [m] measured from the base, in the world."""
        points = finite_array("points", points, last=3)
        return points @ self.base_to_world.T + self.base[:3]

    def in_base(self, points: ArrayLike) -> Array:
        """Points `(..., 3)` [m] of the world, measured from the base."""
        points = finite_array("points", points, last=3)
        return (points - self.base[:3]) @ self.base_to_world

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
        return models.specification(self)

    def physics(self, obstacles: tuple[Obstacle, ...] = ()) -> Any:
        """The arm on its table as an `MjModel` of what collides, shared and never changed."""
        return models.physics(self, obstacles)

    def kinematics(self) -> Kinematics:
        """Forward and inverse kinematics, shared in this process."""
        return _kinematics(self)

    def postures(self, points: Array, near: Array | None = None) -> Array:
        """Angles `(P, J)` [rad] that lead the grasp point through `points (P, 3)` [m], in turn.

        They follow from those `near`, of a point just before, or from home.
        """
        kinematics, angles = self.kinematics(), list[Array]()
        for point in points:
            before = angles[-1] if angles else near
            found = kinematics.solve(point) if before is None else before
            angles.append(found if before is None else found + kinematics.step(found, point))
        return np.array(angles)

    def nearby(self, obstacles: tuple[Obstacle, ...], angles: Array) -> Iterator[Nearby]:
        """What is near obstacles, for each pose of the arm at `angles (T, J)` [rad].

        All links that move count, with the shapes that collide in the simulation.
        """
        model = self.physics(obstacles)
        solid = model.geom_group == models.OBSTACLES
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
        solid = model.geom_group == models.OBSTACLES
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

    def touches(
        self, obstacles: tuple[Obstacle, ...], position: ArrayLike
    ) -> list[tuple[str, int]]:
        """Links that touch obstacles with the grasp point at a position `(3,)` [m], and which.

        The base, which never moves, does not count.
        """
        point = finite_array("position", position, ndim=1, last=3)
        if not obstacles:
            return []
        (near,) = self.nearby(obstacles, self.postures(point[None]))
        pairs = zip(near.links, near.obstacles.tolist(), near.gaps, strict=True)
        return sorted({(link, obstacle) for link, obstacle, gap in pairs if gap < 0})

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

ARMS = dict(zip(ARM_NAMES, (PANDA,), strict=True))
"""The arms that the package knows by name."""


def _limits(content: dict[str, Any]) -> Limits:
    """Limits by the names of their values, with a mapping of a point's for `tip`."""
    names = [f.name for f in fields(Limits)]
    if unknown := [str(name) for name in content if name not in names]:
        raise InvalidInputError(
            f"limits have the keys {', '.join(names)}; unknown: {', '.join(unknown)}"
            f"{did_you_mean(unknown[0], names)}"
        )
    tip = content.get("tip")
    return Limits(**{**content, "tip": _limits(tip) if isinstance(tip, dict) else tip})
