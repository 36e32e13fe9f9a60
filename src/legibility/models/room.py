"""A scene as projection sees it: in lengths of the straight line, from the start."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np

from ..checks import Array
from ..frame import Frame
from ..intent.field import Field
from ..intent.observer import Observer
from ..obstacles import Solids
from ..scene import Scene

CURVE_POINTS = 46
"""T, the points of a curve."""

PAD, SLACK = 0.02, 1e-3
"""Clearance aimed at and needed, in lengths of the straight line, where both ends allow it."""

_RISE = 0.3  # by which the pad grows over progress from an end


@dataclass(frozen=True, eq=False)
class Room:
    """A scene in lengths of the straight line, its start at the origin.

    Attributes:
        scale: length of the straight line [m].
        solids: all that must not be touched.
        bounds: centres `(O, D)` and radii `(O,)` of balls around them.
        field: the observer's.
        target: index of the intended goal.
        workspace: `(2, D)`.
        low, high: `(T, D)`, walls that leave the pad free.
        pad: `(T,)`, distance aimed at from solids.
        slack: `(T,)`, least distance from everything.
    """

    scale: float
    solids: Solids
    bounds: tuple[Array, Array]
    field: Field
    target: int
    workspace: Array
    low: Array
    high: Array
    pad: Array
    slack: Array

    @classmethod
    @functools.lru_cache(maxsize=64)
    def of(cls, scene: Scene, target: int, observer: Observer) -> Room:
        """The room of a scene, target and observer; cached."""
        scale = Frame.of(scene, target).scale
        solids, field = scene.solids(target), observer.field(scene)
        vertices = solids.vertices
        solids = Solids(
            (solids.centers - scene.start) / scale,
            solids.axes,
            solids.halves / scale,
            solids.radii / scale,
            (vertices - scene.start) / scale if vertices.shape[-3] else vertices,
            solids.polygon_radii / scale,
        )
        field = field.seen_from(scene.start, scale)
        low, high = workspace = (scene.workspace - scene.start) / scale
        ends = np.stack([np.zeros(scene.dim), field.goals[target]])
        progress = np.linspace(0, 1, CURVE_POINTS)
        rise = _RISE * np.stack([progress, 1 - progress])[..., None]

        def pad(margin: Array) -> Array:
            """`(T, …)`, given that of the two ends, `(2, …)`."""
            return np.minimum(np.maximum(margin, 0)[:, None] + rise, PAD).min(0)

        below, above = pad(ends - low), pad(high - ends)
        line = progress[:, None] * ends[1]
        apart = solids.distance(line)
        around = pad(apart[[0, -1], None])[:, 0]
        least = np.minimum(np.minimum(below, above).min(-1), around)
        slack = np.minimum(SLACK, least / 2) - 1e-9 * scene.diagonal / scale
        return cls(
            scale, solids, _balls_around(solids), field, target, workspace,
            low + below, high - above, around, slack,
        )  # fmt: skip

    def to_walls(self, points: Array) -> Array:
        """Distance `(...)` of points `(..., D)` from the nearest wall, negative beyond it."""
        low, high = self.workspace
        return np.minimum(points - low, high - points).min(-1)

    def nearest(self, points: Array, reach: float) -> tuple[Array, Array]:
        """Distance `(N,)` of `points (N, D)` from solids, and its gradient `(N, D)`.

        Beyond `reach` a smaller distance, and no gradient.
        """
        centers, radii = self.bounds
        squares = np.einsum("nd,nd->n", points, points)
        apart = squares - 2 * (centers @ points.T) + (centers * centers).sum(-1)[:, None]
        distance = (np.sqrt(np.maximum(apart, 0)) - radii[:, None]).min(0)
        normal = np.zeros_like(points)
        near = np.flatnonzero(distance < reach)
        if len(near):
            distance[near], normal[near] = self.solids.nearest(points[near])
        return distance, normal

    def clearance(self, points: Array) -> Array:
        """Distance `(...)` of points `(..., D)` from everything."""
        walls = self.to_walls(points)
        return np.minimum(
            walls, self.solids.distance(points.reshape(-1, points.shape[-1])).reshape(walls.shape)
        )


def _balls_around(solids: Solids) -> tuple[Array, Array]:
    """Centres `(O, D)` and radii `(O,)` of balls that hold each solid."""
    radii = np.sqrt((solids.halves**2).sum(-1)) + solids.radii
    if not solids.vertices.shape[-3]:
        return solids.centers, radii
    middles = solids.vertices.mean(-2)
    around = np.linalg.norm(solids.vertices - middles[:, None], axis=-1).max(-1)
    around += solids.polygon_radii
    return np.concatenate([solids.centers, middles]), np.concatenate([radii, around])
