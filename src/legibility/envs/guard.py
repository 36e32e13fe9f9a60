"""The last check of the actions that are sent, and contacts: walls, limits, obstacles."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..checks import Array
from ..obstacles import Solids
from ..scene import Scene

_ABSENT = -1e6  # the radius of a solid that is not there [m]
_TOUCH = 1e-10  # [m], by which a step may sink in by rounding
_CONTACT = 1e-8  # [m]
_STANDOFF = 1e-6  # [m]; on a surface itself the direction of the gradient is lost in rounding
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
        exact = [scene.solids(int(target), inflated=False) for scene, target in pairs]
        wide = [scene.solids(int(target)) for scene, target in pairs]
        most = max(len(solids.radii) for solids in exact)
        dim = scenes[0].dim

        def stack(values: list[Array], shape: tuple[int, ...], fill: float | Array) -> Array:
            filled = np.empty((len(pairs), *shape))
            filled[:] = fill
            for row, value in zip(filled, values, strict=True):
                row[: len(value)] = value
            return filled

        # Every solid is a set of its own: `(B, P, 1, …)`.
        self._boxes = [
            stack([s.centers for s in exact], (most, dim), 0.0),
            stack([s.axes for s in exact], (most, dim, dim), np.eye(dim)),
            stack([s.halves for s in exact], (most, dim), 0.0),
            stack([s.radii for s in exact], (most,), _ABSENT),
        ]
        self._margins = stack(
            [w.radii - e.radii for w, e in zip(wide, exact, strict=True)], (most,), 0.0
        )
        self._polygons: list[Array] = []
        if number := max(len(solids.vertices) for solids in exact):
            corners = max(solids.vertices.shape[1] for solids in exact)
            triangle = np.array([[0.0, 0.0], [1.0, 0.0], *[[0.0, 1.0]] * (corners - 2)])
            vertices = [_filled_up(solids.vertices, corners) for solids in exact]
            self._polygons = [
                stack(vertices, (number, corners, 2), triangle),
                stack([s.polygon_radii for s in exact], (number,), _ABSENT),
            ]
            margins = stack([w.polygon_radii for w in wide], (number,), 0.0)
            self._margins = np.concatenate([self._margins, margins], axis=1)

    @classmethod
    def of(cls, scenes: Sequence[Scene], targets: Sequence[int]) -> Barriers | None:
        """Those of the scenes on the way to goals `targets`; None if there are none."""
        if any(scene.obstacles or scene.goal_radius for scene in scenes):
            return cls(scenes, targets)
        return None

    def rows(self, rows: NDArray[np.intp]) -> Barriers:
        """Those of robots `rows (N,)` only."""
        part = object.__new__(Barriers)
        part._boxes = [values[rows] for values in self._boxes]
        part._polygons = [values[rows] for values in self._polygons]
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
        number = self._boxes[0].shape[1]
        each = points.shape[1] > 1
        size, shape = len(points), (len(points), number, 0, 0, 2)
        near = points[:, :number] if each else points
        boxes = Solids(*(v[:, :, None] for v in self._boxes), np.empty(shape), np.empty(shape[:3]))
        distance, slope = boxes.nearest(near[:, :, None])
        if self._polygons:
            near = points[:, number:] if each else points
            vertices, radii = self._polygons
            others = np.broadcast_to(np.eye(2), (*radii.shape, 1, 2, 2))
            none = np.zeros((*radii.shape, 1, 2))
            far = Solids(
                none, others, none, np.full(none.shape[:-1], _ABSENT), vertices[:, :, None],
                radii[:, :, None],
            )  # fmt: skip
            more, steeper = far.nearest(near[:, :, None])
            distance = np.concatenate([distance, more], axis=1)
            slope = np.concatenate([slope, steeper], axis=1)
        distance = distance.reshape(size, -1)
        slope = slope.reshape(*distance.shape, -1)
        return distance - (self._margins + _STANDOFF) * inflated, slope

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


def _filled_up(polygons: Array, corners: int) -> Array:
    """Polygons `(Q, V, 2)` with their last vertex repeated, `(Q, corners, 2)`."""
    if not len(polygons):
        return np.empty((0, corners, 2))
    return np.pad(polygons, ((0, 0), (0, corners - polygons.shape[1]), (0, 0)), "edge")


def safe_actions(
    actions: ArrayLike,
    positions: Array,
    velocities: Array,
    workspace: Array,
    limit: float,
    lag: float,
    barriers: Barriers | None = None,
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
    """
    wanted = np.nan_to_num(np.asarray(actions, dtype=np.float64))  # ±inf becomes ±1.8e308
    # Scaled, not clipped: a long step keeps its direction.
    wanted = wanted * (limit / np.maximum(np.abs(wanted).max(axis=-1, keepdims=True), limit))
    low, high = workspace
    coasts = lag / (1 - lag) * velocities
    rest = positions + coasts
    least, most = low - np.minimum(rest, positions), high - np.maximum(rest, positions)
    wanted = np.clip(np.clip(wanted, least, most), -limit, limit)
    if barriers is None:
        return wanted
    reach = np.linalg.norm(coasts, axis=-1) + np.sqrt(positions.shape[-1]) * limit
    near = barriers.nearest(positions[:, None], inflated=True)[0].min(1) < reach
    if (rows := np.flatnonzero(near)).size:
        normals, offsets = barriers.rows(rows).planes(positions[rows], coasts[rows])
        box = np.stack([np.maximum(least[rows], -limit), np.minimum(most[rows], limit)])
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
    over = (offsets <= CORRECTED) & (along < bound)
    shares = np.where(over, bound / np.where(over, along, 1), 1)
    return actions * shares.min(1, keepdims=True)
