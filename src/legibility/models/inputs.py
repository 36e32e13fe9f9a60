"""What the networks see of a scene, in the start–target frame.

A network that sees only this frame (where the distractors pull, where the solids and the walls are,
who watches) need not learn where a scene lies, which way it faces, and how large it is.
"""

from __future__ import annotations

import functools
import math

import numpy as np

from ..checks import Array
from ..frame import Frame
from ..intent.field import Field, potential_of_odds
from ..obstacles import ABSENT
from ..scene import Scene

WINDOW = ((-1.75, 2.75), (-2.25, 2.25), (-1.75, 1.75))
"""The part of the frame in an image along each axis, in lengths of the straight line."""

DEPTH = 16
"""Depth slices of an image in 3D."""

FIELD_CHANNELS = 3
"""Images of a slice: the posterior, the potential, the margin."""

_MOST_ODDS = 1e8


def scene_image(scene: Scene, target: int, field: Field, resolution: int) -> np.ndarray:
    """The field and the free space drawn in the start–target frame.

    Returns:
        `(3, H, W)` float32 in 2D, `(3·16, H, W)` in 3D with the depth slices as channels: the
        posterior of the target, its potential as log(1 + φ)/2, and the margin m to obstacles, other
        goals and walls, in lengths of the straight line, as tanh(2m).
    """
    frame, columns = Frame.of(scene, target), _grid(scene.dim, resolution)
    slopes, intercepts, others = _odds(scene, target, field)
    odds = slopes @ columns + intercepts[:, None]
    if field.beta:
        goals = np.concatenate([np.eye(1, scene.dim), others])
        apart = sum((x - g[:, None]) ** 2 for x, g in zip(columns, goals.T, strict=True))
        apart = np.sqrt(apart)
        odds += field.beta * frame.scale * (apart[0] - apart[1:])
    potential = potential_of_odds(odds).astype(np.float32)
    points = frame.frame_to_world(columns.T)
    margin = (scene.margin_at(points, target) / frame.scale).astype(np.float32)
    image = np.stack([np.exp(-potential), np.log1p(potential) / 2, np.tanh(2 * margin)])
    return image.reshape(-1, resolution, resolution)


@functools.lru_cache(maxsize=8)
def _grid(dim: int, resolution: int) -> Array:
    """The image's points in the frame, `(D, N)`, in the order of its pixels."""
    sizes = (resolution, resolution, DEPTH)[:dim]
    axes = [
        low + (np.arange(size) + 0.5) / size * (high - low)
        for (low, high), size in zip(WINDOW[:dim], sizes, strict=True)
    ]
    grid = np.stack(np.meshgrid(*axes[::-1], indexing="ij")[::-1]).reshape(dim, -1)
    grid.setflags(write=False)
    return grid


def scene_vector(scene: Scene, target: int, field: Field) -> np.ndarray:
    """Exact values beside the image: the workspace and the observer, in the frame.

    Returns:
        `(vector_size(D),)` float32: centre and half-axes of the workspace; of the precision P its
        shape `P / tr P` (upper triangle) and size `log(1 + tr P)`; β.
    """
    frame = Frame.of(scene, target)
    low, high = scene.workspace
    half = (high - low) / 2 / frame.scale
    centre, axes = frame.world_to_frame((low + high) / 2), frame.rotation * half
    precision = _precision(frame, field)
    total = np.trace(precision)
    shape = precision[np.triu_indices(scene.dim)] / max(total, 1e-12)
    observer = (*shape, math.log1p(total), field.beta * frame.scale)
    return np.array([*centre, *axes.flat, *observer], dtype=np.float32)


def vector_size(dim: int) -> int:
    """Length of `scene_vector`."""
    return dim + dim * dim + dim * (dim + 1) // 2 + 2


def scene_odds(scene: Scene, target: int, field: Field) -> tuple[np.ndarray, ...]:
    """The field in closed form, in the start–target frame.

    The log odds of a distractor at g against the target at g* are
    `log P(g|x) − log P(g*|x) = slope · x + intercept + β (‖x − g*‖ − ‖x − g‖)`.

    Returns:
        Slopes `(G − 1, D)`, intercepts `(G − 1,)` and positions `(G − 1, D)` of the distractors,
        float32; β is the last of `scene_vector`.
    """
    return tuple(array.astype(np.float32) for array in _odds(scene, target, field))


def _odds(scene: Scene, target: int, field: Field) -> tuple[Array, Array, Array]:
    """`scene_odds` in float64."""
    frame = Frame.of(scene, target)
    goals, precision = frame.world_to_frame(scene.goals), _precision(frame, field)
    prior = field.log_prior - (goals @ precision * goals).sum(-1) / 2
    others = [g for g in range(scene.num_goals) if g != target]
    slopes = (goals[others] - goals[target]) @ precision
    intercepts = np.clip(prior[others] - prior[target], -_MOST_ODDS, _MOST_ODDS)
    return slopes, intercepts, goals[others]


def _precision(frame: Frame, field: Field) -> Array:
    return frame.rotation @ field.precision @ frame.rotation.T * frame.scale**2


def scene_solids(scene: Scene, target: int) -> tuple[np.ndarray, ...]:
    """`Scene.solids` in the start–target frame as float32, with one polygon at least in 2D.

    Returns:
        The arrays of `Solids`, and features `(N, solid_features(D))` of each solid: its centre, its
        half-axes as a symmetric matrix (upper triangle), its radius, and whether it is there.
    """
    frame = Frame.of(scene, target)
    solids = scene.solids(target)
    centers = frame.world_to_frame(solids.centers)
    axes = solids.axes @ frame.rotation.T
    halves, radii = solids.halves / frame.scale, solids.radii / frame.scale
    there = solids.radii > ABSENT / 2
    centers[~there] = 0
    radii[~there] = ABSENT
    vertices, owner = _small(frame.world_to_frame(solids.vertices))
    polygon_radii = solids.polygon_radii[owner] / frame.scale
    upper = np.triu_indices(scene.dim)
    matrices = axes.swapaxes(-1, -2) @ (halves[..., None] * axes)
    rows = [np.concatenate([centers, matrices[:, *upper], radii[:, None], there[:, None]], axis=-1)]
    for polygon, radius in zip(vertices, polygon_radii, strict=True):
        centre = polygon.mean(axis=0)
        offsets = polygon - centre
        values, basis = np.linalg.eigh(offsets.T @ offsets / len(polygon))
        matrix = basis @ (np.sqrt(np.maximum(values, 0))[:, None] * basis.T)
        rows.append(np.array([[*centre, *matrix[upper], radius, 1.0]]))
    if scene.dim == 2 and not len(vertices):
        vertices, polygon_radii = _NO_POLYGON[None], np.array([ABSENT])
    features = np.concatenate(rows)
    features[~features[:, -1].astype(bool)] = 0
    arrays = (centers, axes, halves, radii, vertices, polygon_radii, features)
    return tuple(array.astype(np.float32) for array in arrays)


_MOST_VERTICES = 6
_NO_POLYGON = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0], [0.0, 1.0], [0.0, 1.0]])


def _small(polygons: Array) -> tuple[Array, list[int]]:
    """Polygons `(Q, V, 2)` cut into ones of 6 vertices, and the index of that which each is of."""
    parts, owner = [], []
    for index, polygon in enumerate(polygons):
        corners = polygon[np.append(True, np.diff(polygon, axis=0).any(-1))]
        first = 1
        while first < len(corners) - 1:
            part = np.concatenate([corners[:1], corners[first : first + _MOST_VERTICES - 1]])
            parts.append(np.pad(part, ((0, _MOST_VERTICES - len(part)), (0, 0)), "edge"))
            owner.append(index)
            first += _MOST_VERTICES - 2
    shape = (0, _MOST_VERTICES, polygons.shape[-1])
    return (np.stack(parts) if parts else np.empty(shape)), owner


def stacked(arrays: list[np.ndarray], fill: float = 0.0) -> np.ndarray:
    """Arrays of different lengths as one `(B, …)`, filled up along the first axis."""
    most = max(len(array) for array in arrays)
    result = np.full((len(arrays), most, *arrays[0].shape[1:]), fill, dtype=np.float32)
    for row, array in zip(result, arrays, strict=True):
        row[: len(array)] = array
    return result


def stacked_solids(solids: list[tuple[np.ndarray, ...]]) -> tuple[np.ndarray, ...]:
    """Those of several scenes, from `scene_solids`, each as one array `(B, …)`."""
    centers, axes, halves, radii, vertices, polygon_radii, features = map(
        list, zip(*solids, strict=True)
    )
    number = max(map(len, vertices))
    for i, polygons in enumerate(vertices):
        absent = np.broadcast_to(_NO_POLYGON, (number - len(polygons), *_NO_POLYGON.shape))
        vertices[i] = np.concatenate([polygons, absent]) if number else polygons  # none in 3D
    return (
        stacked(centers), stacked(axes), stacked(halves), stacked(radii, ABSENT),
        stacked(vertices), stacked(polygon_radii, ABSENT), stacked(features),
    )  # fmt: skip


def solid_features(dim: int) -> int:
    """Number of features of a solid, see `scene_solids`."""
    return dim + dim * (dim + 1) // 2 + 2
