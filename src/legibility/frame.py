"""The start–target frame: the start is the origin, the target (1, 0, …).

Archives are gridded and networks see scenes in it, so that a scene that is moved or scaled is the
same scene. One that is turned with its walls is so to the grid of an archive and of an image.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np

from .checks import Array
from .scene import Scene


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
        rotation = axes_along(offset / scale)
        rotation.setflags(write=False)
        return cls(scene.start, rotation, scale)

    def world_to_frame(self, points: np.ndarray) -> np.ndarray:
        """`(..., D)` [m] to the frame, in lengths of the straight line."""
        return (points - self.origin) @ self.rotation.T / self.scale

    def frame_to_world(self, points: np.ndarray) -> np.ndarray:
        """The inverse of `world_to_frame`."""
        return points @ self.rotation * self.scale + self.origin


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
