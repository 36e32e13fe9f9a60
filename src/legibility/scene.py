"""A scene: start, possible goals and workspace."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .checks import Array, count, finite_array, target_index
from .errors import InvalidInputError, InvalidSceneError
from .files import read_document, write_bytes, write_json

DEFAULT_WORKSPACE = {2: ((-0.1, -0.1), (1.1, 1.1)), 3: ((-0.30, -0.30, 0.02), (0.10, 0.30, 0.40))}
"""Low and high corner [m] by dimension: the unit square with a margin, and the Panda's table."""

MIN_SEPARATION = 0.12
"""Least distance between two points of a random scene, as a share of the workspace's diagonal; the
start keeps twice that from the target."""

_ROUNDING = 1e-6

START_OVERSHOOT = {2: _ROUNDING, 3: 0.03}
"""Largest excess of a start beyond a wall, as a share of the workspace's diagonal: 24 mm at the
Panda's table, where the simulated arms overshoot by up to 22 mm."""

_AT_START, _BESIDE = 1e-4, 1e-5
_BLOCK_HEIGHT = 0.04
_KEYS = ("start", "goals", "workspace")


@dataclass(frozen=True, eq=False, init=False)
class Scene:
    """Start, goals and workspace, all in metres in the environment's world frame.

    A start a little beyond a wall (`START_OVERSHOOT`, as robots report) and a goal beyond it by
    rounding (1e-6 of the diagonal) are moved onto the wall. Scenes are immutable and hashable.

    Args:
        start: `(D,)` [m], D is 2 or 3.
        goals: `(G, D)` [m], G ≥ 2, no two alike and none at the start.
        workspace: `(2, D)` [m], low and high corner; the default is `DEFAULT_WORKSPACE[D]`.

    Raises:
        InvalidSceneError: any other value.
    """

    start: Array
    goals: Array
    workspace: Array

    def __init__(
        self, start: ArrayLike, goals: ArrayLike, workspace: ArrayLike | None = None
    ) -> None:
        error = InvalidSceneError
        start = finite_array("start", start, ndim=1, last=(2, 3), error=error)
        dim = start.shape[0]
        corners = DEFAULT_WORKSPACE[dim] if workspace is None else workspace
        goals = finite_array("goals", goals, ndim=2, last=dim, error=error)
        corners = finite_array("workspace", corners, ndim=2, last=dim, error=error)
        if len(corners) != 2 or (corners[0] >= corners[1]).any():
            raise error(f"workspace must be a low and a high corner, got {corners.tolist()}")
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
            raise error(f"{names[i]} and {names[j]} coincide at {points[i].tolist()}")

    @property
    def dim(self) -> int:
        """D, 2 or 3."""
        return self.start.shape[0]

    @property
    def num_goals(self) -> int:
        """G."""
        return len(self.goals)

    @property
    def diagonal(self) -> float:
        """Length of the workspace's diagonal [m]."""
        return float(np.linalg.norm(self.workspace[1] - self.workspace[0]))

    def target(self, index: int) -> Array:
        """Position `(D,)` [m] of goal `index`."""
        return self.goals[target_index(index, self.num_goals)]

    def distractors(self, target: int) -> Array:
        """Positions `(G − 1, D)` [m] of all other goals."""
        return np.delete(self.goals, target_index(target, self.num_goals), axis=0)

    def contains(self, points: ArrayLike, tolerance: float = 1e-9) -> np.ndarray:
        """Whether each of `points (..., D)` [m] lies in the workspace, `(...)` bool."""
        points = np.asarray(points)
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
        return Scene(start, self.goals, self.workspace)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Scene) and all(
            np.array_equal(getattr(self, name), getattr(other, name)) for name in _KEYS
        )

    def __hash__(self) -> int:
        return hash((self.start.tobytes(), self.goals.tobytes(), self.workspace.tobytes()))

    def __reduce__(self) -> tuple[type[Scene], tuple[Array, Array, Array]]:
        return Scene, (self.start, self.goals, self.workspace)  # copies stay read-only

    def to_dict(self) -> dict[str, Any]:
        """The scene as plain lists, the form of its YAML and JSON files."""
        return {name: getattr(self, name).tolist() for name in _KEYS}

    @classmethod
    def from_dict(cls, content: Any) -> Scene:
        """The inverse of `to_dict`; `workspace` may be left out."""
        if not isinstance(content, dict):
            raise InvalidSceneError(
                "a scene must be a mapping with the keys start, goals and optionally workspace; "
                f"got {'nothing' if content is None else type(content).__name__}"
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
        return cls(**content)

    def save(self, path: str | Path) -> None:
        """Write the scene as YAML or JSON, by the file's suffix (.yaml, .yml, .json)."""
        _check_suffix(path)
        if Path(path).suffix.lower() == ".json":
            write_json(path, self.to_dict())
        else:
            import yaml

            text = yaml.safe_dump(self.to_dict(), sort_keys=False, default_flow_style=None)
            write_bytes(path, text.encode())

    @classmethod
    def load(cls, path: str | Path) -> Scene:
        """Read a scene from YAML or JSON; anything else raises `InvalidSceneError`."""
        _check_suffix(path)
        content = read_document(path, "scene file", InvalidSceneError)
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


def _snapped(points: Array, workspace: Array, tolerance: float = _ROUNDING) -> Array:
    """`points (..., D)`, on the wall where outside by at most `tolerance` of the diagonal."""
    inside = np.clip(points, *workspace)
    most = tolerance * np.linalg.norm(workspace[1] - workspace[0])
    near = (np.abs(points - inside) <= most).all(-1, keepdims=True)
    return np.where(near, inside, points)


def _check_suffix(path: str | Path) -> None:
    if Path(path).suffix.lower() not in (".yaml", ".yml", ".json"):
        raise InvalidSceneError(f"a scene file ends in .yaml, .yml or .json, got {path}")
