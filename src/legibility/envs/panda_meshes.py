"""Franka's meshes from pybullet_data, split by material for MuJoCo."""

from __future__ import annotations

import importlib.util
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

__all__ = ["franka_meshes"]

_LINKS = (*(f"link{i}" for i in range(8)), "hand", "finger")
_WHITE = [0.95, 0.95, 0.95]


def franka_meshes() -> list[tuple[str, list[float], dict[str, Any]]]:
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
    """MuJoCo's mesh arrays for each material of an OBJ file whose corners have normals."""
    points: dict[str, list[list[float]]] = {"v": [], "vn": []}
    triangles: dict[str, list[Any]] = {}
    material = ""
    for name, *words in filter(None, map(str.split, text.splitlines())):
        if name in points:
            points[name].append([float(word) for word in words])
        elif name == "usemtl":
            material = words[0]
        elif name == "f":
            first, *others = [[int(index) for index in word.split("/")[::2]] for word in words]
            triangles.setdefault(material, []).extend([first, b, c] for b, c in pairwise(others))
    vertices, normals = map(np.array, points.values())
    meshes = {}
    for material, corners in triangles.items():
        pairs, faces = np.unique(np.reshape(corners, (-1, 2)) - 1, axis=0, return_inverse=True)
        meshes[material] = {
            "uservert": vertices[pairs[:, 0]].ravel(),
            "usernormal": normals[pairs[:, 1]].ravel(),
            "userface": faces.ravel(),
            "userfacenormal": faces.ravel(),
        }
    return meshes
