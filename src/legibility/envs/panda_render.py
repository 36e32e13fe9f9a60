"""The picture of an arm at its table, with blocks, obstacles and trajectories."""

from __future__ import annotations

import ctypes.util
import functools
import importlib.util
import itertools
import logging
import os
import threading
import warnings
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageColor, ImageDraw

from ..checks import Array, count
from ..errors import InvalidInputError
from ..obstacles import Box
from ..robots.arm import PANDA, Arm
from ..robots.model import compiled
from ..robots.simulator import import_mujoco, solid_geom
from ..scene import Scene
from .arm import BLOCK
from .colors import GOALS, INK, OBSTACLE

_LOG = logging.getLogger(__name__)

_STACK, _RING = (0.80, 0.80, 0.79, 1.0), 0.75 * BLOCK * 2**0.5
_SMOOTH, _FINE = 2, 3
"""The picture is drawn this many times larger and reduced, with OpenGL and as a sketch."""
_MAX_SHAPES = 5_000
_SUN = np.array([-0.25, -0.35, 0.9])
"""Direction of the light in a sketch."""
_SQUARE = ((-1, -1), (-1, 1), (1, 1), (1, -1))

_LINKS = (*(f"link{i}" for i in range(8)), "hand", "finger")
_WHITE = [0.95, 0.95, 0.95]


_AZIMUTH, _ELEVATION, _DISTANCE, _LOOKAT = 150.0, -28.0, 2.1, (-0.22, 0.0, 0.25)
"""The camera: direction of its view [degrees], and distance from the middle of the picture [m].
Its vertical field of view is 30°."""


class Trail(NamedTuple):
    """A trajectory `points (T, 3)` [m] as a tube of colour `rgba` (0 to 1) and `radius` [m]."""

    points: Array
    rgba: Sequence[float]
    radius: float = 0.004


def arm_image(
    scene: Scene,
    target: int | None,
    angles: Array,
    *,
    trails: Iterable[Trail] = (),
    size: tuple[int, int] = (480, 480),
    arm: Arm = PANDA,
) -> NDArray[np.uint8]:
    """The arm among a scene's blocks and obstacles, `(H, W, 3)`.

    A block has the colour of its index, a ring marks the target, the support of a stacked block is
    grey, an obstacle violet grey. Without OpenGL it is a plain drawing, and a warning says so once.

    Args:
        scene: the current scene.
        target: index of the goal that the ring marks, if any.
        angles: `(J,)` [rad], of the arm's joints.
        trails: trajectories drawn as tubes, 5000 points in all at most.
        size: width and height [pixels].
        arm: the arm.
    """
    width, height = (
        count(name, n, low=16) for name, n in zip(("width", "height"), size, strict=True)
    )
    solids, tubes = [*_blocks(scene), *_obstacles(scene)], list(trails)
    if target is not None:
        turn = np.linspace(0, 2 * np.pi, 49)
        circle = np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=-1)
        middle = scene.target(target) - [0, 0, BLOCK / 2 - 0.002]
        tubes.append(Trail(middle + _RING * circle, _rgba(INK), 0.0016))
    pieces = len(solids) + sum(len(tube[0]) - 1 for tube in tubes)
    if pieces > _MAX_SHAPES:
        raise InvalidInputError(
            f"blocks, obstacles and trails must be at most {_MAX_SHAPES} pieces, got {pieces}"
        )
    renderer = _renderer(arm)
    shapes = _shapes(_looks(arm) if renderer else arm.physics(), angles, solids, tubes)
    if renderer is None:
        return _sketch(shapes, width, height)
    return renderer.draw(shapes, width, height)


def _rgba(color: str) -> tuple[float, ...]:
    return (*(channel / 255 for channel in ImageColor.getrgb(color)), 1.0)


class _Solid(NamedTuple):
    """A geom: its type, size `(3,)` [m], pose `(4, 4)` and colour."""

    form: Any
    size: Array
    pose: Array
    rgba: Sequence[float]


def _obstacles(scene: Scene) -> Iterator[_Solid]:
    for obstacle in scene.obstacles:
        yield _Solid(*solid_geom(obstacle), _rgba(OBSTACLE))


def _blocks(scene: Scene) -> Iterator[_Solid]:
    """The goals' blocks and those that support them."""
    half = BLOCK / 2

    def block(center: Array, size: Sequence[float], rgba: Sequence[float]) -> _Solid:
        return _Solid(*solid_geom(Box(center, 2 * np.array(size))), rgba)

    for index, goal in enumerate(scene.goals):
        yield block(goal, (half, half, half), _rgba(GOALS[index % len(GOALS)]))
        bottom = goal[2] - half
        while bottom > 1e-3:  # the lowest block is cut to the room that is left
            height = min(BLOCK, bottom)
            # Slightly slimmer, so that it hides no goal's block in the same place.
            edges = 0.95 * half, 0.95 * half, height / 2
            yield block(np.array([*goal[:2], bottom - height / 2]), edges, _STACK)
            bottom -= height


def _shapes(model: Any, angles: Array, solids: Iterable[_Solid], tubes: Iterable[Trail]) -> Any:
    """The arm, the solids and the tubes as MuJoCo's `MjvScene`, which needs no OpenGL."""
    mujoco = import_mujoco()
    data, shapes = mujoco.MjData(model), mujoco.MjvScene(model, maxgeom=_MAX_SHAPES + 500)
    data.qpos[:] = angles
    mujoco.mj_forward(model, data)
    view, option = mujoco.MjvCamera(), mujoco.MjvOption()
    view.azimuth, view.elevation, view.distance = _AZIMUTH, _ELEVATION, _DISTANCE
    view.lookat[:] = _LOOKAT
    option.geomgroup[3] = 1
    everything = mujoco.mjtCatBit.mjCAT_ALL
    mujoco.mjv_updateScene(model, data, option, None, view, everything, shapes)
    geoms = shapes.geoms

    def add(solid: _Solid, category: Any) -> Any:
        geom = geoms[shapes.ngeom]
        shapes.ngeom += 1
        place, turn = solid.pose[:3, 3], solid.pose[:3, :3].ravel()
        color = np.array(solid.rgba, dtype=np.float32)
        mujoco.mjv_initGeom(geom, solid.form, solid.size, place, turn, color)
        geom.category, geom.specular, geom.shininess = category, 0.2, 0.3
        return geom

    for solid in solids:
        add(solid, mujoco.mjtCatBit.mjCAT_DYNAMIC)
    form, category = mujoco.mjtGeom.mjGEOM_CAPSULE, mujoco.mjtCatBit.mjCAT_DECOR  # no shadow
    for points, rgba, radius in tubes:
        for start, end in itertools.pairwise(np.asarray(points, dtype=np.float64)):
            geom = add(_Solid(form, np.full(3, radius), np.eye(4), rgba), category)
            mujoco.mjv_connector(geom, form, radius, start, end)
    return shapes


_LOCAL = threading.local()
"""OpenGL's contexts belong to threads."""


def _renderer(arm: Arm) -> _Renderer | None:
    """The renderer of an arm, whose meshes it holds; there is one at a time."""
    if getattr(_LOCAL, "arm", None) is not arm:
        _LOCAL.arm, _LOCAL.renderer = arm, None
        causes = []
        for way in _ways():
            try:
                _LOCAL.renderer = _Renderer(importlib.import_module(way), arm)
                _LOG.info("MuJoCo draws by %s", way)
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
    """Draws shapes with OpenGL."""

    def __init__(self, way: Any, arm: Arm) -> None:
        self._context = way.GLContext(640, 480)
        self._context.make_current()
        self._mujoco = mujoco = import_mujoco()
        self._gl = mujoco.MjrContext(_looks(arm), mujoco.mjtFontScale.mjFONTSCALE_100)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._gl)

    def draw(self, shapes: Any, width: int, height: int) -> NDArray[np.uint8]:
        self._context.make_current()
        wide, high = width * _SMOOTH, height * _SMOOTH
        if (self._gl.offWidth, self._gl.offHeight) != (wide, high):
            self._mujoco.mjr_resizeOffscreen(wide, high, self._gl)
        area = self._mujoco.MjrRect(0, 0, wide, high)
        self._mujoco.mjr_render(area, shapes, self._gl)
        pixels = np.empty((high, wide, 3), dtype=np.uint8)
        self._mujoco.mjr_readPixels(pixels, None, area, self._gl)
        return np.array(Image.fromarray(pixels[::-1]).reduce(_SMOOTH))


@functools.lru_cache(maxsize=8)
def _looks(arm: Arm) -> Any:
    """The model that is drawn: what the arm looks like, the Panda in Franka's meshes if there are.

    Where a model has no looks, its shapes that collide are drawn.
    """
    mujoco, spec = import_mujoco(), arm.specification()
    meshes = _franka_meshes() if arm.model == PANDA.model else []
    if not any(geom.group == 2 for geom in spec.geoms):
        return arm.physics()
    bodies = {body.name: body for body in spec.bodies}
    for geom in list(spec.geoms):
        if geom.group == 3 or (meshes and geom.group == 2):
            spec.delete(geom)
    for number, (link, rgba, arrays) in enumerate(meshes):
        shell = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
        mesh = spec.add_mesh(name=f"mesh{number}", inertia=shell, **arrays)
        for body in ("left_finger", "right_finger") if link == "finger" else (link,):
            bodies[body].add_geom(
                type=mujoco.mjtGeom.mjGEOM_MESH, meshname=mesh.name, rgba=rgba,
                contype=0, conaffinity=0, mass=0, group=2,
            )  # fmt: skip
    return compiled(spec, arm.model)


def _franka_meshes() -> list[tuple[str, list[float], dict[str, Any]]]:
    """Link, colour and MuJoCo's mesh arrays of each part; none without pybullet_data."""
    package = importlib.util.find_spec("pybullet_data")
    if package is None or package.origin is None:
        return []
    folder = Path(package.origin).parent / "franka_panda" / "meshes"
    parts = []
    for link in _LINKS:
        detailed, rough = (folder / name / f"{link}.obj" for name in ("visual", "collision"))
        path = detailed if detailed.is_file() else rough
        if not path.is_file():
            return []
        colors = _colors(path.with_suffix(".mtl"))
        for material, arrays in _split(path.read_text()).items():
            parts.append((link, [*colors.get(material, _WHITE), 1.0], arrays))
    return parts


def _colors(path: Path) -> dict[str, list[float]]:
    """The diffuse colour of each material of an MTL file."""
    colors, name = {}, ""
    for words in map(str.split, path.read_text().splitlines() if path.is_file() else ()):
        if words[:1] == ["newmtl"]:
            name = words[1]
        elif words[:1] == ["Kd"]:
            colors[name] = [float(word) for word in words[1:4]]
    return colors


def _split(text: str) -> dict[str, dict[str, Any]]:
    """MuJoCo's mesh arrays for each material of an OBJ file."""
    vertices, triangles, material = [], {}, ""
    for name, *words in filter(None, map(str.split, text.splitlines())):
        if name == "v":
            vertices.append([float(word) for word in words])
        elif name == "usemtl":
            material = words[0]
        elif name == "f":
            first, *others = [int(word.split("/")[0]) - 1 for word in words]
            fan = [(first, b, c) for b, c in itertools.pairwise(others)]
            triangles.setdefault(material, []).extend(fan)
    meshes = {}
    for material, faces in triangles.items():
        used, faces = np.unique(faces, return_inverse=True)
        corners = np.array(vertices)[used]
        meshes[material] = {"uservert": corners.ravel(), "userface": faces.ravel()}
    return meshes


def _sketch(shapes: Any, width: int, height: int) -> NDArray[np.uint8]:
    """Draw capsules, spheres and boxes without OpenGL: the table first, then the far ones."""
    mujoco = import_mujoco()
    view = mujoco.mjv_averageCamera(*shapes.camera)
    eye, forward, up = map(np.array, (view.pos, view.forward, view.up))
    axes = np.stack([np.cross(forward, up), -up, forward])
    size = np.array([width, height]) * _FINE
    focus = size[1] / 2 * view.frustum_near / view.frustum_top
    image = Image.new("RGB", tuple(size.tolist()), "white")
    pen = ImageDraw.Draw(image)

    def place(points: Array) -> tuple[Array, Array]:
        """Pixel position of `points (N, 3)` [m], and pixels of a metre there, `(N, 1)`."""
        seen = (points - eye) @ axes.T
        scale = focus / np.maximum(seen[:, 2:], 1e-3)
        return size / 2 + seen[:, :2] * scale, scale

    table, *others = shapes.geoms[: shapes.ngeom]
    others.sort(key=lambda geom: forward @ (geom.pos - eye), reverse=True)
    for geom in [table, *others]:
        centre, turn, rgb = geom.pos, geom.mat, geom.rgba[:3]
        if geom.type == mujoco.mjtGeom.mjGEOM_CAPSULE:
            radius, half = geom.size[0], geom.size[2] * turn[:, 2]
            ends, scale = place(np.stack([centre - half, centre + half]))
            for share, light in ((1.0, 0.72), (0.85, 1.0)) if radius > 0.01 else ((1.0, 1.0),):
                thick, fill = radius * scale.mean() * share, _color(rgb * light)
                pen.line(ends.ravel().tolist(), fill, max(1, round(2 * thick)))
                for end in ends:
                    pen.ellipse([*(end - thick), *(end + thick)], fill)
            continue
        if geom.type == mujoco.mjtGeom.mjGEOM_SPHERE:
            ((x, y),), scale = place(centre[None])
            for share, light in ((1.0, 0.72), (0.85, 1.0)):
                thick = geom.size[0] * scale[0, 0] * share
                pen.ellipse([x - thick, y - thick, x + thick, y + thick], _color(rgb * light))
            continue
        for axis, side in itertools.product(range(3), (-1, 1)):
            normal = side * turn[:, axis]
            if normal @ (eye - centre - normal * geom.size[axis]) > 0:  # faces the camera
                corners = np.insert(_SQUARE, axis, side, axis=1) * geom.size
                fill = _color(rgb * (0.65 + 0.35 * max(0.0, normal @ _SUN)))
                pen.polygon(place(centre + corners @ turn.T)[0].ravel().tolist(), fill)
    return np.array(image.reduce(_FINE))


def _color(rgb: Array) -> tuple[int, ...]:
    return tuple(np.round(255 * np.minimum(rgb, 1)).astype(int).tolist())
