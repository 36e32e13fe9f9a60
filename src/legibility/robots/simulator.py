"""MuJoCo, loaded on first use, and solids as its geoms."""

from __future__ import annotations

import importlib
import os
import sys
import warnings
from typing import Any

import numpy as np

from ..checks import Array
from ..errors import MissingExtraError
from ..obstacles import Ball, Box, Obstacle


def import_mujoco(module: str = "mujoco") -> Any:
    """MuJoCo, or a module that builds on it, loaded on first use."""
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as cause:
        raise MissingExtraError(
            f"{cause.name} is not installed: pip install 'legibility[panda]'"
        ) from cause
    except Exception as cause:
        backend = os.environ.pop("MUJOCO_GL", None)  # the physics needs no OpenGL
        if backend is None:
            raise
        warnings.warn(
            f"ignoring MUJOCO_GL={backend}, which does not work: {cause}; unset it, or choose egl, "
            "osmesa or glfw",
            stacklevel=2,
        )
    for name in [n for n in sys.modules if n.partition(".")[0] in ("mujoco", "OpenGL")]:
        del sys.modules[name]
    return import_mujoco(module)


def solid_geom(obstacle: Obstacle) -> tuple[Any, Array, Array]:
    """Type, size `(3,)` [m] and pose `(4, 4)` in the world of an obstacle as a geom."""
    forms, pose = import_mujoco().mjtGeom, np.eye(4)
    assert isinstance(obstacle, Ball | Box)
    pose[:3, 3] = obstacle.center
    if isinstance(obstacle, Ball):
        return forms.mjGEOM_SPHERE, np.array([obstacle.radius, 0, 0]), pose
    pose[:3, :3] = obstacle.rotation
    return forms.mjGEOM_BOX, obstacle.size / 2, pose


def quaternion(rotation: Array) -> Array:
    """`(4,)` (w, x, y, z) of `rotation (3, 3)`."""
    found = np.zeros(4)
    import_mujoco().mju_mat2Quat(found, rotation.ravel())
    return found
