"""A path: start, waypoints, goal, and the curve through them as an observer reads it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from ..checks import Array, count
from ..curves import NUM_WAYPOINTS, arc_length, path_curve, spline_matrix
from ..errors import InvalidInputError
from ..intent.field import Field
from ..intent.metrics import SCORE_POINTS
from ..intent.observer import Observer
from ..scene import TOUCH, Scene
from .archive import Archive, scene_archive

if TYPE_CHECKING:
    from ..robots.arm import Arm
    from ..robots.limits import Limits
    from .timed import Motion

CHECK_POINTS = 768
"""Points at which a path is checked for contact."""

_PARTS = 16  # of a step between two of them, where it is near to something


@dataclass(frozen=True, eq=False)
class Path:
    """One path or `B` paths from the start of a scene to the intended goal.

    Attributes:
        scene: the scene.
        target: index of the intended goal.
        legibility: the requested ℓ, `(B?)`.
        waypoints: `(B?, K + 2, D)` [m]: start, K = 8 waypoints, goal.
        observer: defines ℓ.
        replaced: `(B?)`, whether a curve of the archive stands in for the path drawn, which could
            not be brought out of contact, of the whole arm if one executes it, or not to ℓ without
            waves or detours.
    """

    scene: Scene
    target: int
    legibility: Array
    waypoints: Array
    observer: Observer
    replaced: np.ndarray | np.bool

    @classmethod
    def through(
        cls, waypoints: Array, scene: Scene, target: int, legibility: Array, observer: Observer
    ) -> Path:
        """A path through `waypoints (B?, K + 2, D)` [m]."""
        replaced = np.zeros(waypoints.shape[:-2], dtype=bool)
        return cls(scene, target, legibility, waypoints, observer, replaced)

    @classmethod
    def of(cls, paths: Sequence[Path]) -> Path:
        """Paths of one level each, in one scene to one target, as one of `B` levels."""
        waypoints, levels, replaced = (
            np.array([getattr(path, name) for path in paths])
            for name in ("waypoints", "legibility", "replaced")
        )
        return replace(paths[0], waypoints=waypoints, legibility=levels, replaced=replaced)

    @property
    def field(self) -> Field:
        """The observer's field of the scene."""
        return self.observer.field(self.scene)

    def trajectory(self, num_points: int = SCORE_POINTS) -> Array:
        """The smooth curve through the waypoints, `(B?, num_points, D)` [m]."""
        curve = path_curve(self.waypoints, count("num_points", num_points, low=2))
        curve[..., [0, -1], :] = self.waypoints[..., [0, -1], :]  # free of rounding
        return curve

    @cached_property
    def clearance(self) -> Array:
        """Least distance [m] of the trajectory from obstacles, other goals and walls, `(B?)`."""
        curve = self.trajectory(CHECK_POINTS)
        return self.scene.clearance_at(curve, self.target).min(-1)

    @cached_property
    def feasible(self) -> np.ndarray:
        """Whether the trajectory keeps clear of everything, `(B?)`."""
        waypoints = self.waypoints.reshape(-1, *self.waypoints.shape[-2:])
        least = least_margin(self.scene, self.target, waypoints)
        return np.asarray(least >= -TOUCH * self.scene.diagonal).reshape(self.waypoints.shape[:-2])

    @cached_property
    def score(self) -> Array:
        """`legibility_score` of the trajectory, `(B?)`; higher = more legible."""
        return self.observer.score(self.trajectory(), self.scene, self.target)

    @property
    def length(self) -> Array:
        """Length [m] of the trajectory, `(B?)`."""
        return arc_length(self.trajectory())

    @property
    def archive(self) -> Archive:
        """The scene's archive, built on first use."""
        return scene_archive(self.scene, self.target, self.observer)

    @cached_property
    def achieved(self) -> Array:
        """The label in [−1, 1] that the trajectory achieves in the scene's archive, `(B?)`."""
        return self.archive.label_of(self.score)

    def timed(
        self,
        limits: Limits | str | None = None,
        rate: float = 100.0,
        *,
        arm: Arm | str | None = None,
        max_duration: float | None = None,
    ) -> Motion:
        """The path over time: from rest to rest, as fast as the limits allow, on the same curve.

        Args:
            limits: of an arm's joints or of a point, or their name in `robots.limits.LIMITS`; if
                not given, those of the arm, or `point` without one.
            rate: instants in a second [1/s].
            arm: that moves, or its name; the Panda if `limits` names limits of joints.
            max_duration: longest duration [s].

        Raises:
            InvalidInputError: an argument is out of its range or does not fit the others, the path
                has several levels, the arm cannot reach a point of it or touches something on the
                way, or the limits take longer.
            LegibilityError: no timing was found.
            MissingExtraError: toppra is not installed, or MuJoCo for an arm.
        """
        from .timed import mover, timed

        limits, arm = mover(limits, arm)
        return timed(self, limits, rate, arm, max_duration)

    def __len__(self) -> int:
        """B, the number of levels."""
        if not self.legibility.ndim:
            raise InvalidInputError("the path has one level only: use it as it is")
        return len(self.legibility)

    def __bool__(self) -> bool:
        """A path of one level has no length and yet is one."""
        return True

    def __getitem__(self, index: int) -> Path:
        """The path of one level of several."""
        if isinstance(index, bool) or not isinstance(index, int | np.integer):
            raise InvalidInputError(f"index must be an integer, got {index!r}")
        if not -len(self) <= index < len(self):
            raise IndexError(f"the path has {len(self)} levels, got index {index}")
        return replace(
            self,
            legibility=self.legibility[index],
            waypoints=self.waypoints[index],
            replaced=np.asarray(self.replaced)[index],
        )


def least_margin(scene: Scene, target: int, paths: Array) -> Array:
    """Least margin [m] of the curves through `paths (B, K + 2, D)` [m], `(B,)`.

    More points are looked at between two so near to something that the curve could touch it.
    """
    fine = spline_matrix(paths.shape[-2], _PARTS * (CHECK_POINTS - 1) + 1)
    curves = fine[::_PARTS] @ paths
    margin = scene.margin_at(curves, target)
    least = margin.min(-1)
    steps = np.diff(curves, axis=-2)
    apart = np.sqrt(np.einsum("btd,btd->bt", steps, steps))
    row, step = np.nonzero(margin[:, 1:] + margin[:, :-1] < 1.1 * apart)
    if len(row):
        between = fine[step[:, None] * _PARTS + np.arange(1, _PARTS)] @ paths[row]
        np.minimum.at(least, row, scene.margin_at(between, target).min(-1))
    return least


def straight_waypoints(start: Array, goal: Array) -> Array:
    """`(K + 2, D)` [m], the straight line from `start` to `goal (D,)` [m] as a path."""
    return np.linspace(start, goal, NUM_WAYPOINTS + 2)
