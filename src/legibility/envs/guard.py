"""The last check of the actions that are sent, and contacts: walls, limits, obstacles."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..checks import Array
from ..obstacles import ABSENT, Solids
from ..scene import Scene

if TYPE_CHECKING:
    from ..robots.arm import Nearby

_TOUCH = 1e-10  # [m], by which a step may sink in by rounding
_CONTACT = 1e-8  # [m]
_STANDOFF = 1e-6  # [m]; on a surface itself the direction of the gradient is lost in rounding
_ARM_STANDOFF = 0.003  # [m], for what an arm's links do that its hand does not
_HALVINGS = 12
_SWEEPS = 12
CORRECTED = 1e-9
"""An action that differs from the wanted one by more than this was corrected [m]."""


class Barriers:
    """All that each of `B` robots must keep off: the obstacles and other goals of its scene.

    All are convex, so their distance is a convex function, and the plane through any point across
    the gradient there has no part of them on its far side.
    """

    def __init__(self, scenes: Sequence[Scene], targets: Sequence[int]) -> None:
        pairs = list(zip(scenes, targets, strict=True))
        exact = [scene.solids(target, inflated=False) for scene, target in pairs]
        inflated = [scene.solids(target) for scene, target in pairs]
        # Every solid is a set of its own, `(B, P, 1, …)`, those of a kind packed together.
        self._kinds = [_boxes(exact)]
        margins = [_boxes(inflated).radii - self._kinds[0].radii]
        if any(len(solids.vertices) for solids in exact):
            self._kinds.append(_polygons(exact))
            margins.append(_polygons(inflated).polygon_radii - self._kinds[1].polygon_radii)
        self._margins = np.concatenate(margins, axis=1)[..., 0] + _STANDOFF

    @classmethod
    def of(cls, scenes: Sequence[Scene], targets: Sequence[int]) -> Barriers | None:
        """Those of the scenes on the way to goals `targets`; None if there are none."""
        if any(scene.obstacles or scene.goal_radius for scene in scenes):
            return cls(scenes, targets)
        return None

    def rows(self, rows: NDArray[np.intp]) -> Barriers:
        """Those of robots `rows (N,)` only."""
        part = object.__new__(Barriers)
        part._kinds = [Solids(*(values[rows] for values in kind)) for kind in self._kinds]
        part._margins = self._margins[rows]
        return part

    def nearest(self, points: Array, *, inflated: bool) -> tuple[Array, Array]:
        """Signed distance of each solid from `points (B, 1 or P, D)` [m], and its gradient.

        Args:
            points: for each robot one point, or one for each solid.
            inflated: whether the solids are larger by the clearance and 1 µm.

        Returns:
            `(B, P)` [m] and `(B, P, D)`.
        """
        number = self._margins.shape[1]
        points = np.broadcast_to(points, (len(points), number, points.shape[-1]))[:, :, None]
        ends = np.cumsum([kind.radii.shape[1] for kind in self._kinds])[:-1]
        parts = zip(self._kinds, np.split(points, ends, axis=1), strict=True)
        found = [kind.nearest(near) for kind, near in parts]
        distance, slope = (np.concatenate(x, axis=1)[:, :, 0] for x in zip(*found, strict=True))
        return distance - self._margins * inflated, slope

    def closest(self, points: Array, steps: Array, *, inflated: bool) -> tuple[Array, Array, Array]:
        """Where the segments from `points` along `steps (B, D)` [m] come nearest to each solid.

        Returns:
            shares `(B, P)` of the segments, distances `(B, P)` [m] and gradients `(B, P, D)` there.
        """

        def at(share: Array) -> tuple[Array, Array, Array]:
            places = points[:, None] + share[..., None] * steps[:, None]
            distance, slope = self.nearest(places, inflated=inflated)
            return distance, slope, (slope * steps[:, None]).sum(-1)

        number = self._margins.shape
        distance, slope, ascent = at(np.zeros(number))
        low = np.zeros(number)
        if not (ascent < 0).any():
            return low, distance, slope
        high = np.where(ascent < 0, 1.0, 0.0)
        falls = at(high)[2] <= 0
        low[falls] = high[falls]
        if (low < high).any():
            for _ in range(_HALVINGS):
                middle = (low + high) / 2
                falls = at(middle)[2] < 0
                low, high = np.where(falls, middle, low), np.where(falls, high, middle)
        distance, slope, _ = at(low)
        return low, distance, slope

    def touched(self, points: Array, steps: Array) -> NDArray[np.bool_]:
        """Whether the segments from `points` along `steps (B, D)` [m] run into a solid, `(B,)`."""
        start = self.nearest(points[:, None], inflated=False)[0].min(1)
        touched = np.zeros(len(points), dtype=bool)
        near = np.flatnonzero(start < np.linalg.norm(steps, axis=-1) + _TOUCH)
        if len(near):
            part = self.rows(near)
            least = part.closest(points[near], steps[near], inflated=False)[1]
            touched[near] = least.min(1) < -_CONTACT
        return touched

    def planes(self, positions: Array, coasts: Array) -> tuple[Array, Array]:
        """Displacements `a (B, D)` [m] that keep off each solid: `normals · a ≥ offsets`.

        One plane separates a solid from the position and from the place where the robot would stop,
        and all that lies between. An action must leave both on their side. Where the robot would
        stop behind a solid's surface the plane is tangent to it there.

        Args:
            positions: `(B, D)` [m].
            coasts: `(B, D)` [m], by which stopped robots would move on.

        Returns:
            normals `(B, 2 P, D)` and offsets `(B, 2 P)` [m], for the positions and for the places
            where the robots would stop.
        """
        share, distance, slope = self.closest(positions, coasts, inflated=True)
        here = self.nearest(positions[:, None], inflated=True)[0]
        enters = (distance < np.minimum(here, 0)) & (here >= -CORRECTED)
        if enters.any():
            low, high = np.zeros(share.shape), share
            for _ in range(2 * _HALVINGS):
                middle = (low + high) / 2
                places = positions[:, None] + middle[..., None] * coasts[:, None]
                free = self.nearest(places, inflated=True)[0] >= np.minimum(here, 0)
                low, high = np.where(free, middle, low), np.where(free, high, middle)
            share = np.where(enters, low, share)
            places = positions[:, None] + share[..., None] * coasts[:, None]
            distance, slope = self.nearest(places, inflated=True)
        along = (slope * coasts[:, None]).sum(-1)
        offsets = [share * along - distance, (share - 1) * along - distance]
        return np.concatenate([slope, slope], axis=1), np.concatenate(offsets, axis=1)


class Planes(NamedTuple):
    """Planes between parts of `B` robots and obstacles, which move with the robot's position.

    An arm's hand does, as it does not turn; the links behind it move less than the hand.

    Attributes:
        normals: `(B, C, D)`, away from the obstacles; 0 where there is none.
        gaps: `(B, C)` [m], between the two; inf where there is none.
    """

    normals: Array
    gaps: Array

    @classmethod
    def of(cls, nearby: Sequence[Nearby]) -> Planes:
        """Those between `B` arms and what is near each."""
        most = max(1, *(len(near.gaps) for near in nearby))
        normals, gaps = np.zeros((len(nearby), most, 3)), np.full((len(nearby), most), np.inf)
        for row, near in enumerate(nearby):
            normals[row, : len(near.gaps)], gaps[row, : len(near.gaps)] = near.normals, near.gaps
        return cls(normals, gaps)

    def limits(self, rows: NDArray[np.intp], coasts: Array) -> tuple[Array, Array]:
        """Displacements that keep robots `rows (N,)` off, as `Barriers.planes` for `coasts`."""
        normals = self.normals[rows]
        offsets = np.maximum(_ARM_STANDOFF - self.gaps[rows], -1.0)  # not −inf
        rest = offsets - (normals * coasts[:, None]).sum(-1)
        return np.concatenate([normals] * 2, axis=1), np.concatenate([offsets, rest], axis=1)


def _stack(values: Sequence[Array], shape: tuple[int, ...], absent: float | Array) -> Array:
    """Values `(P, …)` of `B` scenes as `(B, P)` sets of one, with `absent` in free places."""
    filled = np.empty((len(values), *shape))
    filled[:] = absent
    for row, value in zip(filled, values, strict=True):
        row[: len(value)] = value
    return filled[:, :, None]


def _boxes(scenes: Sequence[Solids]) -> Solids:
    """The rounded boxes of `B` scenes as `(B, P)` sets of one."""
    most, dim = max(len(s.radii) for s in scenes), scenes[0].centers.shape[-1]
    none = np.empty((len(scenes), most, 0))
    return Solids(
        _stack([s.centers for s in scenes], (most, dim), 0.0),
        _stack([s.axes for s in scenes], (most, dim, dim), np.eye(dim)),
        _stack([s.halves for s in scenes], (most, dim), 0.0),
        _stack([s.radii for s in scenes], (most,), ABSENT),
        none[..., None, None],
        none,
    )


def _polygons(scenes: Sequence[Solids]) -> Solids:
    """The rounded polygons of `B` scenes as `(B, P)` sets of one."""
    most = max(len(s.vertices) for s in scenes)
    corners = max(s.vertices.shape[1] for s in scenes)
    triangle = np.array([[0.0, 0.0], [1.0, 0.0], *[[0.0, 1.0]] * (corners - 2)])
    filled = [
        np.pad(s.vertices, ((0, 0), (0, corners - s.vertices.shape[1]), (0, 0)), "edge")
        if len(s.vertices)
        else np.empty((0, corners, 2))
        for s in scenes
    ]
    size = len(scenes), most, 1
    return Solids(
        np.zeros((*size, 2)),
        np.broadcast_to(np.eye(2), (*size, 2, 2)),
        np.zeros((*size, 2)),
        np.full(size, ABSENT),
        _stack(filled, (most, corners, 2), triangle),
        _stack([s.polygon_radii for s in scenes], (most,), ABSENT),
    )


def safe_actions(
    actions: ArrayLike,
    positions: Array,
    velocities: Array,
    workspace: Array,
    limit: float,
    lag: float,
    barriers: Barriers | None = None,
    planes: Planes | None = None,
) -> Array:
    """Displacements that are safe to send, `(..., D)` [m].

    A stopped actuator of lag λ moves on by λ/(1 − λ) of its last displacement. Both from there and
    from the present position (the lag may be 0) the action must stay inside the workspace and on
    this side of a plane before each obstacle. A robot that starts at rest, receives only such
    actions and realises any share of them from 0 to 1 never leaves the workspace and never touches
    an obstacle, unless two leave no room to stop in. A robot inside an obstacle is led out.

    Args:
        actions: `(..., D)` [m], wanted displacements; NaN becomes 0.
        positions: `(..., D)` [m], present positions of the robots.
        velocities: `(..., D)` [m], their displacements in the last step.
        workspace: `(2, D)` [m], low and high corner.
        limit: largest displacement along each axis [m].
        lag: λ in [0, ½], the largest lag that the actuator may have.
        barriers: what the robots must keep off; then all arrays are `(B, D)`.
        planes: what all other parts of the robots must keep off, likewise.
    """
    wanted = np.nan_to_num(np.asarray(actions, dtype=np.float64))  # ±inf becomes ±1.8e308
    # Scaled, not clipped: a long step keeps its direction.
    wanted = wanted * (limit / np.maximum(np.abs(wanted).max(axis=-1, keepdims=True), limit))
    low, high = workspace
    coasts = lag / (1 - lag) * velocities
    rest = positions + coasts
    least, most = low - np.minimum(rest, positions), high - np.maximum(rest, positions)
    wanted = np.clip(np.clip(wanted, least, most), -limit, limit)
    if barriers is None and planes is None:
        return wanted
    reach = np.linalg.norm(coasts, axis=-1) + np.sqrt(positions.shape[-1]) * limit
    near = np.zeros(len(reach), dtype=bool)
    if barriers is not None:
        near |= barriers.nearest(positions[:, None], inflated=True)[0].min(1) < reach
    if planes is not None:
        near |= planes.gaps.min(1) < reach + _ARM_STANDOFF
    if (rows := np.flatnonzero(near)).size:
        found = (
            [] if barriers is None else [barriers.rows(rows).planes(positions[rows], coasts[rows])]
        )
        if planes is not None:
            found.append(planes.limits(rows, coasts[rows]))
        normals, offsets = (np.concatenate(x, axis=1) for x in zip(*found, strict=True))
        box = np.clip(np.stack([least[rows], most[rows]]), -limit, limit)
        wanted[rows] = _kept_off(wanted[rows], normals, offsets, box)
    return wanted


def _kept_off(actions: Array, normals: Array, offsets: Array, box: Array) -> Array:
    """`actions (N, D)` moved to where `normals (N, C, D) · a ≥ offsets (N, C)`, within the box.

    Each sweep projects on the plane that is violated most, so that a motion slides along it. In the
    end an action is shortened until it violates nothing that standing still does not violate.
    """
    rows = np.arange(len(actions))
    for _ in range(_SWEEPS):
        lacking = offsets - (normals * actions[:, None]).sum(-1)
        worst = lacking.argmax(1)
        short = np.maximum(lacking[rows, worst], 0)
        if (short <= _TOUCH / 2).all():
            return actions
        actions = np.clip(actions + short[:, None] * normals[rows, worst], *box)
    along, bound = (normals * actions[:, None]).sum(-1), np.minimum(offsets, 0) - _TOUCH
    over = along < bound
    shares = np.where(over, bound / np.where(over, along, 1), 1)
    return actions * shares.min(1, keepdims=True)
