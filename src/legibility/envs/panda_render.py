"""The picture of the Franka Panda at its table, with blocks and trajectories as tubes."""

from __future__ import annotations

import ctypes.util
import functools
import importlib
import os
import threading
import warnings
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageColor, ImageDraw

from ..checks import Array, count
from ..errors import InvalidInputError
from ..scene import Scene
from .arm import BLOCK
from .colors import GOALS, INK
from .panda_meshes import franka_meshes
from .panda_model import import_mujoco, physics, specification

__all__ = ["FRONT", "Camera", "Trail", "arm_image"]

_STACK, _RING = (0.80, 0.80, 0.79, 1.0), 0.75 * BLOCK * 2**0.5
_SMOOTH, _FINE = 2, 3
"""The picture is drawn this many times larger and reduced, with OpenGL and as a sketch."""
_MAX_SHAPES = 5_000


class Camera(NamedTuple):
    """The camera of a picture.

    Attributes:
        azimuth: of the view's direction [degrees].
        elevation: of the view's direction; negative looks down [degrees].
        distance: from `lookat` [m].
        lookat: the middle of the picture [m].
        angle: vertical field of view [degrees].
    """

    azimuth: float = 140.0
    elevation: float = -22.0
    distance: float = 2.35
    lookat: tuple[float, float, float] = (-0.25, 0.0, 0.22)
    angle: float = 30.0


FRONT = Camera(150.0, -28.0, 2.1, (-0.22, 0.0, 0.25), 30.0)
"""Nearer than the default and more from the front."""


class Trail(NamedTuple):
    """A trajectory as a tube.

    Attributes:
        points: `(T, 3)` [m].
        rgba: its colour, each channel from 0 to 1.
        radius: of the tube [m].
    """

    points: Array
    rgba: Sequence[float]
    radius: float = 0.004


class _Shape(NamedTuple):
    """A box of half edges `size` or, from `centre` to `end`, a tube of radius `size[0]`."""

    centre: Array
    size: tuple[float, ...]
    rgba: tuple[float, ...]
    end: Array | None = None


def arm_image(
    scene: Scene,
    target: int | None,
    angles: Array,
    *,
    trails: Iterable[Trail] = (),
    size: tuple[int, int] = (480, 480),
    camera: Camera = Camera(),  # noqa: B008 (immutable)
) -> NDArray[np.uint8]:
    """The arm among a scene's blocks, `(H, W, 3)`.

    A block has the colour of its index, a ring marks the target, the support of a stacked block is
    grey. Without OpenGL it is a plain drawing, and a warning says so once.

    Args:
        scene: the current scene.
        target: index of the goal that the ring marks, if any.
        angles: `(7,)` [rad], of the arm's joints.
        trails: trajectories drawn as tubes, 5000 points in all at most.
        size: width and height [pixels].
        camera: the camera.
    """
    width, height = (
        count(name, n, low=16) for name, n in zip(("width", "height"), size, strict=True)
    )
    shapes = [*_blocks(scene, target), *_tubes(trails)]
    if len(shapes) > _MAX_SHAPES:
        raise InvalidInputError(
            f"blocks and trails must be at most {_MAX_SHAPES} pieces, got {len(shapes)}"
        )
    renderer = _renderer()
    if renderer is None:
        return _Sketch(width, height, camera).draw(angles, shapes)
    return renderer.draw(angles, shapes, width, height, camera)


def _rgba(color: str) -> tuple[float, ...]:
    return (*(channel / 255 for channel in ImageColor.getrgb(color)), 1.0)


def _blocks(scene: Scene, target: int | None) -> list[_Shape]:
    shapes = []
    half = BLOCK / 2
    for index, goal in enumerate(scene.goals):
        shapes.append(_Shape(goal, (half,) * 3, _rgba(GOALS[index % len(GOALS)])))
        bottom = goal[2] - half
        while bottom > 1e-3:  # the lowest block is cut to the room that is left
            height = min(BLOCK, bottom)
            centre = np.array([*goal[:2], bottom - height / 2])
            # Slightly slimmer, so that it hides no goal's block in the same place.
            shapes.append(_Shape(centre, (0.95 * half, 0.95 * half, height / 2), _STACK))
            bottom -= height
    if target is not None:
        middle = scene.target(target) - [0, 0, half - 0.002]
        turn = np.linspace(0, 2 * np.pi, 49)
        ring = middle + _RING * np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=-1)
        shapes += _tubes([Trail(ring, _rgba(INK), 0.0016)])
    return shapes


def _tubes(trails: Iterable[Trail]) -> list[_Shape]:
    return [
        _Shape(start, (radius,) * 3, tuple(rgba), end)
        for points, rgba, radius in trails
        for start, end in zip(np.asarray(points)[:-1], np.asarray(points)[1:], strict=True)
    ]


# ------------------------------------------------------------------------------------ with OpenGL

_LOCAL = threading.local()
"""OpenGL's contexts belong to threads."""


def _renderer() -> _Renderer | None:
    if not hasattr(_LOCAL, "renderer"):
        _LOCAL.renderer = None
        causes = []
        for way in _ways():
            try:
                _LOCAL.renderer = _Renderer(importlib.import_module(way))
                break
            except Exception as cause:  # drivers fail in many ways; the sketch always works
                causes.append(f"{way}: {type(cause).__name__}: {cause}")
        else:
            warnings.warn(
                f"MuJoCo cannot draw here ({'; '.join(causes)}), so the arm is only sketched; "
                "apt-get install libegl1 libgl1, or libosmesa6, helps",
                stacklevel=3,
            )
    return _LOCAL.renderer


def _ways() -> list[str]:
    """Modules with a `GLContext`: the user's choice, or first those that need no display."""
    import_mujoco()
    if os.environ.get("MUJOCO_GL") or os.name != "posix":
        return ["mujoco"]
    libraries = (("mujoco.egl", "EGL"), ("mujoco.osmesa", "OSMesa"))
    windowless = [module for module, library in libraries if ctypes.util.find_library(library)]
    return [*windowless, "mujoco"]


class _Renderer:
    def __init__(self, way: Any) -> None:
        self._context = way.GLContext(640, 480)
        self._context.make_current()
        self._mujoco = mujoco = import_mujoco()
        self._model = _looks()
        self._data = mujoco.MjData(self._model)
        self._scene = mujoco.MjvScene(self._model, maxgeom=_MAX_SHAPES + 500)
        self._option = mujoco.MjvOption()
        self._gl = mujoco.MjrContext(self._model, mujoco.mjtFontScale.mjFONTSCALE_100)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._gl)

    def draw(
        self, angles: Array, shapes: list[_Shape], width: int, height: int, camera: Camera
    ) -> NDArray[np.uint8]:
        mujoco, scene = self._mujoco, self._scene
        self._context.make_current()
        wide, high = width * _SMOOTH, height * _SMOOTH
        if (self._gl.offWidth, self._gl.offHeight) != (wide, high):
            mujoco.mjr_resizeOffscreen(wide, high, self._gl)
        self._data.qpos[:] = angles
        mujoco.mj_forward(self._model, self._data)
        view = mujoco.MjvCamera()
        view.azimuth, view.elevation = camera.azimuth, camera.elevation
        view.distance, view.lookat[:] = camera.distance, camera.lookat
        self._model.vis.global_.fovy = camera.angle
        everything = mujoco.mjtCatBit.mjCAT_ALL
        mujoco.mjv_updateScene(self._model, self._data, self._option, None, view, everything, scene)
        geoms = scene.geoms
        for shape in shapes:
            self._add(geoms[scene.ngeom], shape)
            scene.ngeom += 1
        area = mujoco.MjrRect(0, 0, wide, high)
        mujoco.mjr_render(area, scene, self._gl)
        pixels = np.empty((high, wide, 3), dtype=np.uint8)
        mujoco.mjr_readPixels(pixels, None, area, self._gl)
        return np.array(Image.fromarray(pixels[::-1]).reduce(_SMOOTH))

    def _add(self, geom: Any, shape: _Shape) -> None:
        mujoco, tube = self._mujoco, shape.end is not None
        kind = mujoco.mjtGeom.mjGEOM_CAPSULE if tube else mujoco.mjtGeom.mjGEOM_BOX
        centre, rgba = shape.centre.astype(np.float64), np.array(shape.rgba, dtype=np.float32)
        mujoco.mjv_initGeom(geom, kind, np.array(shape.size), centre, np.eye(3).ravel(), rgba)
        geom.category = mujoco.mjtCatBit.mjCAT_DYNAMIC
        geom.specular, geom.shininess = 0.2, 0.3
        if shape.end is not None:
            geom.category = mujoco.mjtCatBit.mjCAT_DECOR  # casts no shadow
            end = shape.end.astype(np.float64)
            mujoco.mjv_connector(geom, kind, shape.size[0], centre, end)


@functools.cache
def _looks() -> Any:
    """The model that is drawn: the joints of the physics with Franka's meshes, where there are."""
    mujoco, spec = import_mujoco(), specification()
    bodies = {body.name: body for body in spec.bodies}
    meshes = franka_meshes()
    for geom in list(spec.geoms):
        if geom.group == 3 or (meshes and geom.group == 2):
            spec.delete(geom)
    for name, link, text, rgba in meshes:
        spec.assets = {**spec.assets, f"{name}.obj": text}
        mesh = spec.add_mesh(name=name, file=f"{name}.obj")
        mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
        for body in ("left_finger", "right_finger") if link == "finger" else (link,):
            bodies[body].add_geom(
                type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name, rgba=rgba,
                contype=0, conaffinity=0, mass=0, group=2,
            )  # fmt: skip
    return spec.compile()


# --------------------------------------------------------------------------------- without OpenGL


_SUN = np.array([-0.25, -0.35, 0.9])
_BODY, _EDGE = (0.90, 0.91, 0.92), (0.55, 0.56, 0.58)


class _Sketch:
    """Capsules and boxes, the far ones first, in the perspective of the OpenGL picture."""

    def __init__(self, width: int, height: int, camera: Camera) -> None:
        azimuth, elevation, half = np.radians([camera.azimuth, camera.elevation, camera.angle / 2])
        flat = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
        forward = np.cos(elevation) * flat + [0, 0, np.sin(elevation)]
        right = np.array([flat[1], -flat[0], 0.0])
        self._axes = np.stack([right, np.cross(right, forward), forward])
        self._eye = np.array(camera.lookat) - camera.distance * forward
        self._size = np.array([width, height]) * _FINE
        self._scale = self._size[1] / 2 / np.tan(half)
        self._image = Image.new("RGB", tuple(self._size.tolist()), "white")
        self._pen = ImageDraw.Draw(self._image)

    def draw(self, angles: Array, shapes: list[_Shape]) -> NDArray[np.uint8]:
        mujoco, model = import_mujoco(), physics()
        data = mujoco.MjData(model)
        data.qpos[:] = angles
        mujoco.mj_kinematics(model, data)
        items = [*shapes]
        for i in range(model.ngeom):
            centre, size = data.geom_xpos[i].copy(), model.geom_size[i]
            turn = data.geom_xmat[i].reshape(3, 3)
            if i == model.geom("table").id:
                self._box(centre, size, turn, tuple(model.geom_rgba[i]))  # below the rest
            elif model.geom_type[i] == mujoco.mjtGeom.mjGEOM_BOX:
                items.append(_Shape(centre, tuple(size), (*_EDGE, 1.0)))
            else:
                half = size[1] * turn[:, 2]
                items.append(_Shape(centre - half, (size[0],) * 3, (*_BODY, 1.0), centre + half))

        def depth(shape: _Shape) -> float:
            middle = shape.centre if shape.end is None else (shape.centre + shape.end) / 2
            return float(self._axes[2] @ (middle - self._eye))

        for shape in sorted(items, key=depth, reverse=True):
            if shape.end is None:
                self._box(shape.centre, np.array(shape.size), np.eye(3), shape.rgba)
            else:
                self._tube(shape.centre, shape.end, shape.size[0], shape.rgba)
        return np.array(self._image.reduce(_FINE))

    def _place(self, points: Array) -> Array:
        """Pixel position of `points (..., 3)` [m], and pixels of a metre there, `(..., 3)`."""
        seen = (points - self._eye) @ self._axes.T
        scale = self._scale / np.maximum(seen[..., 2:], 1e-3)
        return np.concatenate([self._size / 2 + seen[..., :2] * [1, -1] * scale, scale], axis=-1)

    def _box(self, centre: Array, size: Array, turn: Array, rgba: tuple[float, ...]) -> None:
        for axis in range(3):
            for side in (-1, 1):
                normal = side * turn[:, axis]
                if normal @ (self._eye - centre - normal * size[axis]) <= 0:
                    continue
                corners = np.full((4, 3), float(side))
                corners[:, np.arange(3) != axis] = [[-1, -1], [-1, 1], [1, 1], [1, -1]]
                face = self._place(centre + (corners * size) @ turn.T)[:, :2]
                light = 0.65 + 0.35 * max(0.0, float(normal @ _SUN))
                self._pen.polygon(face.ravel().tolist(), fill=_color(rgba, light))

    def _tube(self, start: Array, end: Array, radius: float, rgba: tuple[float, ...]) -> None:
        ends = self._place(np.stack([start, end]))
        thick = radius * ends[:, 2].mean()
        layers = ((1.0, 0.72), (0.85, 1.0)) if radius > 0.01 else ((1.0, 1.0),)
        for share, light in layers:
            width, fill = thick * share, _color(rgba, light)
            self._pen.line(ends[:, :2].ravel().tolist(), fill=fill, width=max(1, round(2 * width)))
            for x, y in ends[:, :2]:
                self._pen.ellipse((x - width, y - width, x + width, y + width), fill=fill)


def _color(rgba: tuple[float, ...], light: float) -> tuple[int, int, int]:
    red, green, blue = (round(255 * min(1.0, share * light)) for share in rgba[:3])
    return red, green, blue
