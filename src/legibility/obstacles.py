"""Obstacles and their signed distance, in closed form, in NumPy and in PyTorch.

An obstacle is a ball, a box or, in 2D, a convex polygon. `Solids` packs any number of them into
arrays, so that one formula serves one scene in NumPy and a batch of scenes in PyTorch.
"""

from __future__ import annotations

import functools
import sys
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from .checks import Array, finite_array, positive
from .errors import InvalidInputError, InvalidSceneError

_TINY = 1e-30  # least square under a root, whose gradient at 0 is infinite; exporters drop sums
ABSENT = -1e6
"""The radius of a solid that is not there: farther than any room is large."""


class _Obstacle(ABC):
    """Obstacles are immutable; equal ones compare equal and hash alike."""

    def _set(self, **values: Array | float | None) -> None:
        for name, value in values.items():
            if isinstance(value, np.ndarray):
                value = value + 0.0
                value.setflags(write=False)
            object.__setattr__(self, name, value)

    @property
    @abstractmethod
    def dim(self) -> int:
        """D, 2 or 3."""

    @abstractmethod
    def to_dict(self) -> dict[str, Any]:
        """Plain values, the form in scene files; `obstacle_from_dict` is the inverse."""

    def signed_distance(self, points: ArrayLike) -> Array:
        """Distance [m] of `points (..., D)` [m] from the surface, `(...)`, negative inside."""
        points = finite_array("points", points, min_ndim=1, last=self.dim)
        flat = points.reshape(-1, self.dim)
        return solids_of([self], self.dim).distance(flat).reshape(points.shape[:-1])

    @functools.cached_property
    def _text(self) -> str:
        return repr(self.to_dict())

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Obstacle) and self._text == other._text

    def __hash__(self) -> int:
        return hash(self._text)

    def __reduce__(self) -> tuple[Any, ...]:
        return obstacle_from_dict, (self.to_dict(),)  # copies stay read-only

    def __repr__(self) -> str:
        ((kind, values),) = self.to_dict().items()
        values = {"vertices": values} if kind == "polygon" else values
        if "yaw" in values:
            values = {**values, "rotation": values["yaw"]}
            del values["yaw"]
        inner = ", ".join(f"{name}={value}" for name, value in values.items())
        return f"{type(self).__name__}({inner})"


@dataclass(frozen=True, eq=False, init=False, repr=False)
class Ball(_Obstacle):
    """A disc in 2D, a sphere in 3D.

    Args:
        center: `(D,)` [m].
        radius: [m], above 0.

    Raises:
        InvalidSceneError: any other value.
    """

    center: Array
    radius: float

    def __init__(self, center: ArrayLike, radius: float) -> None:
        center = finite_array("center", center, ndim=1, last=(2, 3), error=InvalidSceneError)
        self._set(center=center, radius=_size("radius", radius))

    @property
    def dim(self) -> int:
        """D, 2 or 3."""
        return len(self.center)

    def to_dict(self) -> dict[str, Any]:
        """`{"ball": {"center": …, "radius": …}}`."""
        return {"ball": {"center": self.center.tolist(), "radius": self.radius}}


@dataclass(frozen=True, eq=False, init=False, repr=False)
class Box(_Obstacle):
    """A rectangle in 2D, a cuboid in 3D, turned in any way.

    Args:
        center: `(D,)` [m].
        size: `(D,)` [m], full length along each of its own axes, above 0.
        rotation: the yaw [rad], by which it is turned in the plane or about the vertical, or a
            rotation matrix `(D, D)` from its own axes to the world's; none if not given. A yaw is
            kept as the attribute `yaw`.

    Raises:
        InvalidSceneError: any other value.
    """

    center: Array
    size: Array
    rotation: Array
    yaw: float | None

    def __init__(
        self, center: ArrayLike, size: ArrayLike, rotation: ArrayLike | None = None
    ) -> None:
        error = InvalidSceneError
        center = finite_array("center", center, ndim=1, last=(2, 3), error=error)
        dim = len(center)
        size = finite_array("size", size, ndim=1, last=dim, error=error)
        if (size <= 0).any():
            raise error(f"size must be above 0 along each axis, got {size.tolist()}")
        turned = finite_array("rotation", 0.0 if rotation is None else rotation, error=error)
        yaw = float(turned) if turned.ndim == 0 else None
        if yaw is not None:
            turned = _yawed(yaw, dim)
        if turned.shape != (dim, dim) or not (
            np.allclose(turned @ turned.T, np.eye(dim), atol=1e-6) and np.linalg.det(turned) > 0
        ):
            raise error(
                f"rotation must be a yaw or a rotation matrix {(dim, dim)}, got {turned.tolist()}"
            )
        self._set(center=center, size=size, rotation=turned, yaw=yaw)

    @property
    def dim(self) -> int:
        """D, 2 or 3."""
        return len(self.center)

    def to_dict(self) -> dict[str, Any]:
        """`{"box": {"center": …, "size": …, "yaw": …}}`, or `rotation` if it was a matrix."""
        content: dict[str, Any] = {"center": self.center.tolist(), "size": self.size.tolist()}
        if self.yaw is None:
            content["rotation"] = self.rotation.tolist()
        elif self.yaw:
            content["yaw"] = self.yaw
        return {"box": content}


@dataclass(frozen=True, eq=False, init=False, repr=False)
class Polygon(_Obstacle):
    """A convex polygon, in 2D.

    Args:
        vertices: `(V, 2)` [m], V ≥ 3, in order around it, either way.

    Raises:
        InvalidSceneError: any other value; a polygon that is not convex or has no area.
    """

    vertices: Array

    def __init__(self, vertices: ArrayLike) -> None:
        error = InvalidSceneError
        vertices = finite_array("vertices", vertices, ndim=2, last=2, error=error)
        if len(vertices) < 3:
            raise error(f"vertices must be at least 3, got {len(vertices)}")
        edges = np.roll(vertices, -1, axis=0) - vertices
        after = np.roll(edges, -1, axis=0)
        turns = edges[:, 0] * after[:, 1] - edges[:, 1] * after[:, 0]
        if turns.sum() < 0:
            vertices, turns = vertices[::-1], -turns[::-1]
        lengths = np.linalg.norm(edges, axis=-1)
        angles = np.arctan2(edges[:, 1], edges[:, 0])
        winding = np.abs(((np.diff(angles, append=angles[:1]) + np.pi) % (2 * np.pi) - np.pi).sum())
        if (
            lengths.min() == 0
            or turns.min() < -1e-9 * lengths.max() ** 2
            or turns.max() <= 1e-12 * lengths.max() ** 2
            or winding > 2.5 * np.pi
        ):
            raise error(
                f"vertices must be those of a convex polygon, in order, got {vertices.tolist()}"
            )
        self._set(vertices=vertices)

    @property
    def dim(self) -> int:
        """2."""
        return 2

    def to_dict(self) -> dict[str, Any]:
        """`{"polygon": [[x, y], …]}`."""
        return {"polygon": self.vertices.tolist()}


Obstacle = Ball | Box | Polygon

_KEYS = {"ball": ({"center", "radius"}, set()), "box": ({"center", "size"}, {"yaw", "rotation"})}


def obstacle_from_dict(content: Any) -> Obstacle:
    """The obstacle of a scene file, one of `ball`, `box` and `polygon`."""
    if (
        not isinstance(content, dict)
        or len(content) != 1
        or not content.keys() <= {*_KEYS, "polygon"}
    ):
        raise InvalidSceneError(
            f"an obstacle must be a mapping with one key, ball, box or polygon, got {content!r}"
        )
    ((kind, values),) = content.items()
    if kind == "polygon":
        return Polygon(values)
    needed, optional = _KEYS[kind]
    keys = set(values) if isinstance(values, dict) else None
    if keys is None or not needed <= keys <= needed | optional or {"yaw", "rotation"} <= keys:
        raise InvalidSceneError(
            f"a {kind} has the keys {', '.join(sorted(needed | optional))}, got {values!r}"
        )
    if kind == "ball":
        return Ball(values["center"], values["radius"])
    return Box(values["center"], values["size"], values.get("yaw", values.get("rotation")))


class Solids(NamedTuple):
    """Obstacles as arrays, of one scene or of a batch of scenes, in NumPy or in PyTorch.

    Each is a box or a polygon, rounded: it reaches `radius` beyond. A ball is a box of no size. A
    place of no obstacle has a radius far below 0.

    Attributes:
        centers: `(..., O, D)`.
        axes: `(..., O, D, D)`, the rows are a box's own axes.
        halves: `(..., O, D)`, half the size along each of them.
        radii: `(..., O)`.
        vertices: `(..., Q, V, D)`, counter-clockwise, filled up by the last one; Q = 0 in 3D.
        polygon_radii: `(..., Q)`.
    """

    centers: Any
    axes: Any
    halves: Any
    radii: Any
    vertices: Any
    polygon_radii: Any

    def distance(self, points: Any) -> Any:
        """Signed distance `(..., K)` of points `(..., K, D)` from the nearest solid."""
        return self.nearest(points, gradient=False)[0]

    def nearest(self, points: Any, gradient: bool = True) -> tuple[Any, Any]:
        """Signed distance `(..., K)` of points `(..., K, D)`, and its gradient `(..., K, D)`."""
        xp = np if isinstance(points, np.ndarray) else sys.modules["torch"]
        # Points come last, where arrays are long: sums over a short last axis are slow in NumPy.
        columns = xp.swapaxes(points, -1, -2)[..., None, :, :]
        distances, slopes = self._boxes(xp, columns, gradient)
        if self.vertices.shape[-3]:
            more, steeper = self._polygons(xp, columns, gradient)
            distances = xp.concatenate([distances, more], -2)
            slopes = xp.concatenate([slopes, steeper], -3) if gradient else None
        least = xp.amin(distances, -2)
        if not gradient:
            return least, None
        slopes = _mean(distances == least[..., None, :], slopes)
        return least, xp.swapaxes(slopes, -1, -2)

    def _boxes(self, xp: Any, columns: Any, gradient: bool) -> tuple[Any, Any]:
        """Distances `(..., O, K)` and gradients `(..., O, D, K)` at `columns (..., 1, D, K)`."""
        local = self.axes @ (columns - self.centers[..., None])
        beyond = abs(local) - self.halves[..., None]
        outer = beyond.clip(min=0)
        reach = xp.sqrt((outer * outer).sum(-2).clip(min=_TINY))
        most = xp.amax(beyond, -2)
        distance = reach + most.clip(max=0) - self.radii[..., None]
        if not gradient:
            return distance, None
        # Not `face / face.sum()`, which is of PyTorch's default dtype.
        face = (beyond == most[..., None, :]) + 0 * outer
        face = face / face.sum(-2)[..., None, :]
        slope = xp.where(most[..., None, :] > 0, outer / reach[..., None, :], face)
        return distance, xp.swapaxes(self.axes, -1, -2) @ xp.where(local < 0, -slope, slope)

    def _polygons(self, xp: Any, columns: Any, gradient: bool) -> tuple[Any, Any]:
        """As `_boxes`, `(..., Q, K)` and `(..., Q, 2, K)`."""
        # Not `roll`, which takes ten times as long in NumPy.
        following = xp.concatenate([self.vertices[..., 1:, :], self.vertices[..., :1, :]], -2)
        edges = following - self.vertices
        corner_x, corner_y = (self.vertices[..., i, None] for i in (0, 1))  # (..., Q, V, 1)
        edge_x, edge_y = (edges[..., i, None] for i in (0, 1))
        squared = edge_x * edge_x + edge_y * edge_y
        x, y = (columns[..., None, i, :] - c for i, c in ((0, corner_x), (1, corner_y)))
        along = ((x * edge_x + y * edge_y) / squared.clip(min=_TINY)).clip(min=0, max=1)
        gap_x, gap_y = x - along * edge_x, y - along * edge_y  # (..., Q, V, K)
        apart = gap_x * gap_x + gap_y * gap_y
        closest = xp.amin(apart, -2)
        length = xp.sqrt(squared.clip(min=_TINY))
        depth = xp.where(squared > 0, (x * edge_y - y * edge_x) / length, -np.inf)
        deepest = xp.amax(depth, -2)
        inside, reach = deepest <= 0, xp.sqrt(closest.clip(min=_TINY))
        distance = xp.where(inside, deepest, reach) - self.polygon_radii[..., None]
        if not gradient:
            return distance, None
        normals = xp.stack([edge_y, -edge_x], -2) / length[..., None, :]
        inward = _mean(depth == deepest[..., None, :], normals)
        gaps = xp.stack([gap_x, gap_y], -2)
        outward = _mean(apart == closest[..., None, :], gaps) / reach[..., None, :]
        return distance, xp.where(inside[..., None, :], inward, outward)


def _mean(chosen: Any, vectors: Any) -> Any:
    """The mean over V of `vectors (..., V, D, K)` where `chosen (..., V, K)`."""
    return (chosen[..., None, :] * vectors).sum(-3) / chosen.sum(-2)[..., None, :]


def solids_of(
    obstacles: Sequence[Any], dim: int, margin: float = 0.0, balls: Array | None = None,
    ball_radius: float = 0.0,
) -> Solids:  # fmt: skip
    """The obstacles of one scene as arrays in NumPy; a place of no obstacle if there are none.

    Args:
        obstacles: of dimension `dim`.
        dim: D.
        margin: by which each reaches farther [m].
        balls: centres `(N, D)` of more balls, which get no margin.
        ball_radius: theirs.
    """
    rows: list[tuple[Array, Array, Array, float]] = []
    polygons: list[Array] = []
    for obstacle in obstacles:
        if isinstance(obstacle, Polygon):
            polygons.append(obstacle.vertices)
        elif isinstance(obstacle, Box):
            rows.append((obstacle.center, obstacle.rotation.T, obstacle.size / 2, margin))
        else:
            rows.append((obstacle.center, np.eye(dim), np.zeros(dim), obstacle.radius + margin))
    for center in () if balls is None else balls:
        rows.append((center, np.eye(dim), np.zeros(dim), ball_radius))
    if not rows:
        rows.append((np.zeros(dim), np.eye(dim), np.zeros(dim), ABSENT))
    most = max((len(p) for p in polygons), default=0)
    vertices = np.zeros((len(polygons), most, dim))
    for i, polygon in enumerate(polygons):
        vertices[i] = np.pad(polygon, ((0, most - len(polygon)), (0, 0)), "edge")
    centers, axes, halves, radii = (np.array(column) for column in zip(*rows, strict=True))
    return Solids(centers, axes, halves, radii, vertices, np.full(len(polygons), margin))


def _size(name: str, value: Any) -> float:
    try:
        return positive(name, value)
    except InvalidInputError as cause:
        raise InvalidSceneError(str(cause)) from cause


def _yawed(yaw: float, dim: int) -> Array:
    """The rotation matrix `(D, D)` of a turn in the plane, or about the vertical."""
    rotation = np.eye(dim)
    rotation[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
    return rotation
