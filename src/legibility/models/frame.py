"""The frame in which the networks see a scene: the start is the origin, the target (1, 0, …).

A network that sees only this frame (where the distractors pull, how far the walls are, how wide the
observer's likelihood is) need not learn that a scene may be moved, turned or scaled.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numpy as np

from ..checks import Array
from ..errors import InvalidSceneError
from ..intent.field import InformationPotentialField, potential_of_odds
from ..scene import DEFAULT_WORKSPACE, Scene

WINDOW = ((-1.75, 2.75), (-2.25, 2.25), (-1.0, 1.0))
"""The part of the frame in an image along each axis, in lengths of the straight line."""

LARGEST_SCALE = 4.0
"""A scene may be this many times larger or smaller than those of training; there the dial's mean
error is 0.1, five times that at their size."""

DEPTH = 16
"""Depth slices of an image in 3D."""

_FEW = 4

FIELD_CHANNELS = 3
"""Images of a slice: the posterior, the potential, the workspace."""


@dataclass(frozen=True, eq=False)
class Frame:
    """Translation, rotation and scale between the world and the start–target frame.

    Attributes:
        origin: `(D,)` [m], the start.
        rotation: `(D, D)`, rows are the frame's axes in the world; the first points at the target,
            the second (in 3D) is horizontal.
        scale: length of the straight line [m].
    """

    origin: Array
    rotation: Array
    scale: float

    @classmethod
    @functools.lru_cache(maxsize=64)  # a plan asks for it five times
    def of(cls, scene: Scene, target: int) -> Frame:
        """The frame of `scene` for goal `target`."""
        offset = scene.target(target) - scene.start
        scale = float(np.linalg.norm(offset))
        rotation = axes_along(offset)
        rotation.setflags(write=False)
        return cls(scene.start, rotation, scale)

    def world_to_frame(self, points: np.ndarray) -> np.ndarray:
        """`(..., D)` [m] to the frame, in lengths of the straight line."""
        return (points - self.origin) @ self.rotation.T / self.scale

    def frame_to_world(self, points: np.ndarray) -> np.ndarray:
        """The inverse of `world_to_frame`."""
        return points @ self.rotation * self.scale + self.origin


def check_scale(scene: Scene, name: str) -> None:
    """Raise `InvalidSceneError` unless the workspace is about as large as the model's in training.

    In others the labels of the network and of the archive mean different motions.
    """
    trained = math.dist(*DEFAULT_WORKSPACE[scene.dim])
    if not trained / LARGEST_SCALE <= scene.diagonal <= trained * LARGEST_SCALE:
        raise InvalidSceneError(
            f"the workspace is {scene.diagonal:.3g} m across; the model {name} plans in workspaces "
            f"of about {trained:.2g} m: give metres"
        )


def axes_along(direction: np.ndarray) -> np.ndarray:
    """Rotations `(..., D, D)`, rows are orthonormal axes, the first along `direction (..., D)`.

    In 3D the second is horizontal. A direction of no length is taken for the world's first axis.
    """
    length = np.linalg.norm(direction, axis=-1, keepdims=True)
    first = np.zeros(direction.shape[-1])
    first[0] = 1.0
    forward = np.where(length > 1e-12, direction / np.maximum(length, 1e-12), first)
    if direction.shape[-1] == 2:
        return np.stack([forward, np.stack([-forward[..., 1], forward[..., 0]], -1)], -2)
    side = np.cross([0.0, 0.0, 1.0], forward)
    length = np.linalg.norm(side, axis=-1, keepdims=True)
    side = np.where(length > 1e-6, side / np.maximum(length, 1e-12), [0.0, 1.0, 0.0])
    return np.stack([forward, side, np.cross(forward, side)], -2)


def scene_image(
    scene: Scene, target: int, field: InformationPotentialField, resolution: int
) -> np.ndarray:
    """The field and the workspace drawn in the start–target frame.

    Returns:
        `(3, H, W)` float32 in 2D, `(3·16, H, W)` in 3D with the depth slices as channels: the
        posterior of the target, its potential as log(1 + φ)/2, and the distance d to the nearest
        wall, negative outside and in lengths of the straight line, as tanh(2d).
    """
    frame, grid = Frame.of(scene, target), _grid(scene.dim, resolution)
    # Log odds are computed exactly; the rest is in float32, like the image.
    slopes, intercepts = _odds(scene, target, field)
    # A few distractors at a time: NumPy would share a larger product among threads, which then wait
    # for more and hold up those of PyTorch.
    odds = np.empty((len(slopes), grid.shape[1]), dtype=np.float32)
    for i in range(0, len(slopes), _FEW):
        odds[i : i + _FEW] = slopes[i : i + _FEW] @ grid + intercepts[i : i + _FEW, None]
    potential = potential_of_odds(odds)
    low, high = scene.workspace
    offset = (scene.start - (low + high) / 2) / frame.scale
    aside = np.abs(frame.rotation.T @ grid + offset[:, None])
    wall = ((high - low)[:, None] / 2 / frame.scale - aside).min(axis=0).astype(np.float32)
    image = np.stack([np.exp(-potential), np.log1p(potential) / 2, np.tanh(2 * wall)])
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


def scene_vector(scene: Scene, target: int, field: InformationPotentialField) -> np.ndarray:
    """Exact values beside the image: the workspace's centre and half-axes in the frame, and σ.

    Returns:
        `(vector_size(D),)` float32.
    """
    frame = Frame.of(scene, target)
    low, high = scene.workspace
    half = (high - low) / 2 / frame.scale
    centre, axes = frame.world_to_frame((low + high) / 2), frame.rotation * half
    width = math.log(frame.scale / field.sigma)
    return np.array([*centre, *axes.flat, width], dtype=np.float32)


def scene_odds(
    scene: Scene, target: int, field: InformationPotentialField
) -> tuple[np.ndarray, np.ndarray]:
    """The field in closed form: the log odds `log P(g|x) − log P(g*|x)` are linear in x.

    Returns:
        Slopes `(G − 1, D)` and intercepts `(G − 1,)` of the distractors, in the start–target frame,
        so that φ(x|g*) = log(1 + Σ_g exp(slope_g · x + intercept_g)).
    """
    slopes, intercepts = _odds(scene, target, field)
    return slopes.astype(np.float32), intercepts.astype(np.float32)


@functools.lru_cache(maxsize=64)  # the image and the exact values need it
def _odds(scene: Scene, target: int, field: InformationPotentialField) -> tuple[Array, Array]:
    """`scene_odds` in full precision."""
    corners = np.concatenate([np.zeros((1, scene.dim)), np.eye(scene.dim)])
    log_posterior = field.log_posterior(Frame.of(scene, target).frame_to_world(corners))
    others = [g for g in range(scene.num_goals) if g != target]
    odds = log_posterior[:, others] - log_posterior[:, [target]]
    return (odds[1:] - odds[0]).T, odds[0]


def vector_size(dim: int) -> int:
    """Length of `scene_vector`."""
    return dim + dim * dim + 1
