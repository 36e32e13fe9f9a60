"""A scene: start, possible goals, workspace and obstacles."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .checks import Array, bounded, count, finite_array, target_index, trajectory_array
from .errors import InvalidInputError, InvalidSceneError
from .files import read_document, write_document
from .obstacles import Obstacle, Solids, obstacle_from_dict, solids_of

DEFAULT_WORKSPACE = {2: ((-0.1, -0.1), (1.1, 1.1)), 3: ((-0.30, -0.30, 0.02), (0.10, 0.30, 0.40))}
"""Low and high corner [m] by dimension: the unit square with a margin, and the Panda's table."""

MIN_SEPARATION = 0.12
"""Least distance between two points of a random scene, as a share of the workspace's diagonal; the
start keeps twice that from the target."""

_ROUNDING = 1e-6

START_OVERSHOOT = {2: _ROUNDING, 3: 0.03}
"""Largest excess of a start beyond a wall, as a share of the workspace's diagonal: 24 mm at the
Panda's table, where the simulated arms overshoot by up to 22 mm."""

TOUCH = 1e-9
"""A motion may touch what it must keep clear of, to this share of the workspace's diagonal."""

_DIAGONALS = 1e-9, 1e6  # least and largest of a workspace [m]
_AT_START, _BESIDE = 1e-4, 1e-5
_BLOCK_HEIGHT = 0.04
_KEYS = ("start", "goals", "workspace", "obstacles", "goal_radius", "clearance")


@dataclass(frozen=True, eq=False, init=False, repr=False)
class Scene:
    """Start, goals, workspace and obstacles, all in metres in the environment's world frame.

    A start a little beyond a wall (`START_OVERSHOOT`, as robots report) and a goal beyond it by
    rounding (1e-6 of the diagonal) are moved onto the wall. Scenes are immutable and hashable.

    Args:
        start: `(D,)` [m], D is 2 or 3.
        goals: `(G, D)` [m], G ≥ 2, no two alike and none at the start.
        workspace: `(2, D)` [m], low and high corner; the default is `DEFAULT_WORKSPACE[D]`.
        obstacles: `Ball`, `Box` or, in 2D, `Polygon`; none over the start.
        goal_radius: [m], distance that a motion keeps from the centres of the other goals.
        clearance: [m], distance that a motion keeps from obstacles.

    Raises:
        InvalidSceneError: any other value.
    """

    start: Array
    goals: Array
    workspace: Array
    obstacles: tuple[Obstacle, ...]
    goal_radius: float
    clearance: float

    def __init__(
        self,
        start: ArrayLike,
        goals: ArrayLike,
        workspace: ArrayLike | None = None,
        obstacles: Sequence[Obstacle] = (),
        goal_radius: float = 0.0,
        clearance: float = 0.0,
    ) -> None:
        error = InvalidSceneError
        start = finite_array("start", start, ndim=1, last=(2, 3), error=error)
        dim = start.shape[0]
        corners = DEFAULT_WORKSPACE[dim] if workspace is None else workspace
        goals = finite_array("goals", goals, ndim=2, last=dim, error=error)
        corners = finite_array("workspace", corners, ndim=2, last=dim, error=error)
        if len(corners) != 2 or (corners[0] >= corners[1]).any():
            raise error(f"workspace must be a low and a high corner, got {corners.tolist()}")
        with np.errstate(over="ignore"):
            size = float(np.linalg.norm(corners[1] - corners[0]))
        if not _DIAGONALS[0] <= size <= _DIAGONALS[1]:
            raise error(
                f"workspace must have a diagonal from {_DIAGONALS[0]:g} to {_DIAGONALS[1]:g} m, "
                f"got {size:g}"
            )
        start = _snapped(start, corners, START_OVERSHOOT[dim])
        goals = _snapped(goals, corners)
        for name, array in (("start", start), ("goals", goals), ("workspace", corners)):
            array = array + 0.0  # a copy, with −0 turned into 0 so that equal scenes hash alike
            array.setflags(write=False)
            object.__setattr__(self, name, array)
        if self.num_goals < 2:
            raise error(f"goals must be at least 2, got {self.num_goals}")
        points = np.concatenate([self.start[None], self.goals])
        names = ["start", *(f"goals[{i}]" for i in range(self.num_goals))]
        for name, point in zip(names, points, strict=True):
            if not self.contains(point, 0):
                raise error(
                    f"{name} {point.tolist()} lies outside the workspace {corners.tolist()}"
                )
        gaps = np.linalg.norm(points[:, None] - points[None], axis=-1)
        gaps[np.tril_indices(len(points))] = np.inf
        i, j = np.unravel_index(np.argmin(gaps), gaps.shape)
        if gaps[i, j] < _ROUNDING * self.diagonal:
            raise error(
                f"{names[i]} and {names[j]} coincide at {points[i].tolist()}, or are too near to "
                f"each other beside the workspace's diagonal of {self.diagonal:g} m"
            )
        object.__setattr__(self, "obstacles", _obstacles(obstacles, dim))
        for name, value in (("goal_radius", goal_radius), ("clearance", clearance)):
            try:
                object.__setattr__(self, name, bounded(name, value, 0))
            except InvalidInputError as cause:
                raise error(str(cause)) from cause
        self._check_free(names[0], self.start)
        if (nearest := gaps[0, 1:].min()) < self.goal_radius:
            raise error(
                f"start lies {nearest:.3g} m from a goal, within goal_radius {self.goal_radius:g}"
            )

    def _check_free(self, name: str, point: Array) -> None:
        """Raise if an obstacle lies over `point`, or within the clearance of it."""
        for i, obstacle in enumerate(self.obstacles):
            apart = float(obstacle.signed_distance(point))
            if apart < self.clearance - TOUCH * self.diagonal:
                where = "over" if apart < 0 else f"{apart:.3g} m from"
                raise InvalidSceneError(
                    f"obstacles[{i}] lies {where} the {name} {point.tolist()}"
                    + (f", within the clearance {self.clearance:g}" if apart >= 0 else "")
                )

    def check_target(self, target: int) -> int:
        """The index of a goal; raises `InvalidSceneError` unless a motion can end there."""
        target = target_index(target, self.num_goals)
        if self.solids(target).distance(self.goals[target, None])[0] >= 0:
            return target
        self._check_free(f"target goals[{target}]", self.goals[target])
        near = np.linalg.norm(self.distractors(target) - self.goals[target], axis=-1).min()
        if near < self.goal_radius:
            raise InvalidSceneError(
                f"target goals[{target}] lies {near:.3g} m from another goal, within goal_radius "
                f"{self.goal_radius:g}"
            )
        return target

    def solids(self, target: int | None = None, *, inflated: bool = True) -> Solids:
        """Everything that a motion to goal `target` must not touch, as arrays; cached.

        The obstacles, larger by the clearance if `inflated`, and the other goals.
        """
        return _solids(self, target, inflated)

    def clearance_at(self, points: ArrayLike, target: int | None = None) -> Array:
        """Distance [m] of `points (..., D)` [m] from everything solid and the walls, `(...)`.

        Negative in contact and beyond a wall. The other goals are solid if a target is given.
        """
        return self._distance(points, self.solids(target, inflated=False))

    def margin_at(self, points: ArrayLike, target: int | None = None) -> Array:
        """As `clearance_at`, less the clearance that a motion must keep: negative if infeasible."""
        return self._distance(points, self.solids(target))

    def _distance(self, points: ArrayLike, solids: Solids) -> Array:
        points = finite_array("points", points, min_ndim=1, last=self.dim)
        (low, high), dims = self.workspace, range(self.dim)
        # One coordinate at a time: reductions over a short last axis are slow in NumPy.
        gaps = [np.minimum(points[..., d] - low[d], high[d] - points[..., d]) for d in dims]
        walls = functools.reduce(np.minimum, gaps)
        if not self.obstacles and not self.goal_radius:
            return walls
        flat = points.reshape(-1, self.dim)
        return np.minimum(walls, solids.distance(flat).reshape(walls.shape))

    def feasible(self, curves: ArrayLike, target: int) -> np.ndarray:
        """Whether each of `curves (..., T, D)` [m] keeps clear of everything, `(...)` bool."""
        curves = trajectory_array(curves, self.dim, "curves")
        return np.asarray(self.margin_at(curves, target).min(-1) >= -TOUCH * self.diagonal)

    @property
    def size(self) -> float:
        """The largest distance among start and goals [m], from which observers take σ and β."""
        points = np.concatenate([self.start[None], self.goals])
        return float(np.linalg.norm(points[:, None] - points[None], axis=-1).max())

    @property
    def dim(self) -> int:
        """D, 2 or 3."""
        return self.start.shape[0]

    @property
    def num_goals(self) -> int:
        """G."""
        return len(self.goals)

    @functools.cached_property
    def diagonal(self) -> float:
        """Length of the workspace's diagonal [m]."""
        return float(np.linalg.norm(self.workspace[1] - self.workspace[0]))

    def target(self, index: int) -> Array:
        """Position `(D,)` [m] of goal `index`."""
        return self.goals[target_index(index, self.num_goals)]

    def distractors(self, target: int) -> Array:
        """Positions `(G − 1, D)` [m] of all other goals."""
        return np.delete(self.goals, target_index(target, self.num_goals), axis=0)

    def contains(self, points: ArrayLike, tolerance: float = TOUCH) -> np.ndarray:
        """Whether each of `points (..., D)` [m] lies in the workspace, `(...)` bool.

        Or beyond it by at most `tolerance`, a share of the diagonal.
        """
        points, tolerance = np.asarray(points), tolerance * self.diagonal
        if points.dtype.kind not in "iuf" or points.shape[-1:] != (self.dim,):
            raise InvalidInputError(
                f"points must be numbers of shape (..., {self.dim}), got shape {points.shape}"
            )
        low, high = self.workspace
        return ((points >= low - tolerance) & (points <= high + tolerance)).all(-1)

    def starting_at(self, position: Array) -> Scene:
        """The scene for a robot that now stands at `position (D,)` [m].

        The same scene if it stands at the start, to an arm's accuracy. A position beyond a wall is
        moved onto it, one on a goal to just beside it.
        """
        if np.linalg.norm(position - self.start) < _AT_START:
            return self
        start, least = np.clip(position, *self.workspace), _BESIDE * self.diagonal
        if np.linalg.norm(self.goals - start, axis=-1).min() < least:
            inward = self.workspace.mean(axis=0) - start
            inward[0] += 1e-9  # in the very middle any direction leads inward
            start = start + 2 * least * inward / np.linalg.norm(inward)
        return self._from(start)

    def _from(self, start: Array) -> Scene:
        """The scene from another start, which is moved off obstacles.

        Where that is not possible, and near a goal, the motion must keep clear of less.
        """
        obstacles, margin = list(self.obstacles), self.clearance
        solids = solids_of(obstacles, self.dim, margin)
        for _ in range(8):
            distance, slope = solids.nearest(start[None])
            if distance[0] >= 0:
                break
            start = start + (TOUCH * self.diagonal - distance[0]) * slope[0]
            start = np.clip(start, *self.workspace)
        apart = [float(obstacle.signed_distance(start)) for obstacle in obstacles]
        nearest = float(np.linalg.norm(self.goals - start, axis=-1).min())
        return Scene(
            start,
            self.goals,
            self.workspace,
            [o for o, gap in zip(obstacles, apart, strict=True) if gap >= 0],
            min(self.goal_radius, nearest),
            max(0.0, min([margin, *(gap for gap in apart if gap >= 0)])),
        )

    def alike(self, other: Scene, tolerance: float) -> bool:
        """Whether two scenes are built alike, and no number but of their starts differs by more."""
        if self is other:
            return True
        ours, theirs = (_numbers({**s.to_dict(), "start": []}) for s in (self, other))
        return ours.keys() == theirs.keys() and all(
            abs(value - theirs[place]) <= tolerance for place, value in ours.items()
        )

    def __eq__(self, other: object) -> bool:
        if self is other:
            return True
        return isinstance(other, Scene) and all(
            np.array_equal(getattr(self, name), getattr(other, name)) for name in _KEYS
        )

    def __hash__(self) -> int:
        return self._hash

    @functools.cached_property
    def _hash(self) -> int:
        arrays = (self.start.tobytes(), self.goals.tobytes(), self.workspace.tobytes())
        return hash((arrays, self.obstacles, self.goal_radius, self.clearance))

    def __repr__(self) -> str:
        content = self.to_dict()
        if np.array_equal(self.workspace, DEFAULT_WORKSPACE[self.dim]):
            del content["workspace"]
        if self.obstacles:
            content["obstacles"] = list(self.obstacles)
        return f"Scene({', '.join(f'{name}={value}' for name, value in content.items())})"

    def __reduce__(self) -> tuple[type[Scene], tuple[Any, ...]]:
        return Scene, tuple(getattr(self, name) for name in _KEYS)  # copies stay read-only

    def to_dict(self) -> dict[str, Any]:
        """The scene as plain lists, the form of its YAML and JSON files."""
        content: dict[str, Any] = {name: getattr(self, name).tolist() for name in _KEYS[:3]}
        if self.obstacles:
            content["obstacles"] = [obstacle.to_dict() for obstacle in self.obstacles]
        for name in ("goal_radius", "clearance"):
            if getattr(self, name):
                content[name] = getattr(self, name)
        return content

    @classmethod
    def from_dict(cls, content: Any) -> Scene:
        """The inverse of `to_dict`; all but `start` and `goals` may be left out."""
        if not isinstance(content, dict):
            raise InvalidSceneError(
                "a scene must be a mapping with the keys start, goals and optionally others, got "
                f"{'nothing' if content is None else type(content).__name__}"
            )
        differences = {
            "unknown": content.keys() - _KEYS,
            "missing": {"start", "goals"} - content.keys(),
        }
        if any(differences.values()):
            parts = [
                f"{word} {sorted(map(str, keys))}" for word, keys in differences.items() if keys
            ]
            raise InvalidSceneError(f"a scene has the keys {', '.join(_KEYS)}: {', '.join(parts)}")
        content = {k: v for k, v in content.items() if v is not None or k not in _KEYS[2:]}
        obstacles = content.get("obstacles", ())
        if not isinstance(obstacles, list | tuple):
            raise InvalidSceneError(f"obstacles must be a list, got {obstacles!r}")
        return cls(**{**content, "obstacles": [obstacle_from_dict(o) for o in obstacles]})

    def save(self, path: str | Path) -> None:
        """Write the scene as YAML or JSON, by the file's suffix (.yaml, .yml, .json)."""
        _check_suffix(path)
        write_document(path, self.to_dict())

    @classmethod
    def load(cls, path: str | Path) -> Scene:
        """Read a scene from YAML or JSON; anything else raises `InvalidSceneError`."""
        _check_suffix(path)
        content = read_document(path, "scene file", InvalidSceneError)
        if isinstance(content, dict):
            content.pop("observer", None)  # read by `Observer.load`
        try:
            return cls.from_dict(content)
        except InvalidSceneError as cause:
            raise InvalidSceneError(f"{path}: {cause}") from cause

    @classmethod
    def random(
        cls,
        rng: np.random.Generator,
        *,
        dim: int = 2,
        num_goals: int | None = None,
        target: int = 0,
    ) -> Scene:
        """A scene with start and goals anywhere in the default workspace.

        Points are at least `MIN_SEPARATION` of the workspace's diagonal apart, the start twice that
        from goal `target`. In 3D the goals are blocks on the table or stacked up to four high.

        Args:
            rng: source of randomness.
            dim: 2 or 3.
            num_goals: G, 2 to 12; drawn from 2 to 6 if not given.
            target: index of the goal that the start keeps away from.
        """
        if not isinstance(rng, np.random.Generator):
            raise InvalidInputError(f"rng must be a numpy.random.Generator, got {rng!r}")
        if dim not in (2, 3):
            raise InvalidInputError(f"dim must be 2 or 3, got {dim!r}")
        if num_goals is None:
            num_goals = int(rng.integers(2, 7))
        if count("num_goals", num_goals, low=2) > 12:
            raise InvalidInputError(f"num_goals must be from 2 to 12, got {num_goals}")
        target = target_index(target, num_goals)
        low, high = np.array(DEFAULT_WORKSPACE[dim])
        gap = MIN_SEPARATION * np.linalg.norm(high - low)
        pairs = np.triu_indices(num_goals + 1, k=1)
        while True:  # rejecting whole scenes is unbiased
            points = rng.uniform(low, high, size=(num_goals + 1, dim))
            if dim == 3:
                points[1:, 2] = low[2] + _BLOCK_HEIGHT * rng.integers(0, 4, size=num_goals)
            gaps = np.linalg.norm(points[pairs[0]] - points[pairs[1]], axis=-1)
            if gaps.min() >= gap and np.linalg.norm(points[0] - points[1 + target]) >= 2 * gap:
                return cls(points[0], points[1:])


def _obstacles(obstacles: Any, dim: int) -> tuple[Obstacle, ...]:
    if not isinstance(obstacles, Sequence) or isinstance(obstacles, str):
        raise InvalidSceneError(f"obstacles must be a list, got {obstacles!r}")
    for i, obstacle in enumerate(obstacles):
        if not isinstance(obstacle, Obstacle):
            raise InvalidSceneError(
                f"obstacles[{i}] must be a Ball, a Box or a Polygon, got {obstacle!r}"
            )
        if obstacle.dim != dim:
            raise InvalidSceneError(f"obstacles[{i}] is {obstacle.dim}D, the scene is {dim}D")
    return tuple(obstacles)


@functools.lru_cache(maxsize=128)  # each part of a plan asks for it
def _solids(scene: Scene, target: int | None, inflated: bool) -> Solids:
    balls = None
    if target is not None:
        others = scene.distractors(target)  # checks the target
        balls = others if scene.goal_radius else None
    margin = scene.clearance if inflated else 0.0
    return solids_of(scene.obstacles, scene.dim, margin, balls, scene.goal_radius)


def _snapped(points: Array, workspace: Array, tolerance: float = _ROUNDING) -> Array:
    """`points (..., D)`, on the wall where outside by at most `tolerance` of the diagonal."""
    inside = np.clip(points, *workspace)
    most = tolerance * np.linalg.norm(workspace[1] - workspace[0])
    near = (np.abs(points - inside) <= most).all(-1, keepdims=True)
    return np.where(near, inside, points)


def _numbers(value: Any, place: str = "") -> dict[str, float]:
    """All numbers in plain values by their places."""
    if isinstance(value, dict | list | tuple):
        items = value.items() if isinstance(value, dict) else enumerate(value)
        return {k: v for name, item in items for k, v in _numbers(item, f"{place}/{name}").items()}
    return {place: float(value)}


def _check_suffix(path: str | Path) -> None:
    if Path(path).suffix.lower() not in (".yaml", ".yml", ".json"):
        raise InvalidSceneError(f"a scene file ends in .yaml, .yml or .json, got {path}")
