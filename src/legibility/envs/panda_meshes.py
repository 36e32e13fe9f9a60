"""Franka's meshes from pybullet_data, split by material for MuJoCo."""

from __future__ import annotations

import importlib.util
from itertools import pairwise
from pathlib import Path

__all__ = ["franka_meshes"]


def franka_meshes() -> list[tuple[str, str, bytes, list[float]]]:
    """Name, body, OBJ file and colour of each mesh; none without pybullet_data."""
    package = importlib.util.find_spec("pybullet_data")
    if package is None or package.origin is None:
        return []
    folder = Path(package.origin).parent / "franka_panda" / "meshes"
    parts = []
    for link in (*(f"link{i}" for i in range(8)), "hand", "finger"):
        visual, rough = folder / "visual" / f"{link}.obj", folder / "collision" / f"{link}.obj"
        path = visual if visual.is_file() else rough
        if not path.is_file():
            return []
        colors = _colors(path.with_suffix(".mtl"))
        for number, (material, text) in enumerate(_split(path.read_text()).items()):
            rgba = [*colors.get(material, (0.95, 0.95, 0.95)), 1.0]
            parts.append((f"{link}_{number}", link, text.encode(), rgba))
    return parts


def _colors(path: Path) -> dict[str, tuple[float, ...]]:
    """The diffuse colour of each material of an MTL file."""
    colors, name = {}, ""
    if path.is_file():
        for words in map(str.split, path.read_text().splitlines()):
            if words[:1] == ["newmtl"]:
                name = words[1]
            elif words[:1] == ["Kd"]:
                colors[name] = tuple(float(word) for word in words[1:4])
    return colors


def _split(text: str) -> dict[str, str]:
    """An OBJ file for each material of an OBJ file."""
    shared: dict[str, list[str]] = {"v": [], "vn": []}
    faces: dict[str, list[list[tuple[int, int | None]]]] = {}
    material = ""
    for words in map(str.split, text.splitlines()):
        if not words:
            continue
        if words[0] in shared:
            shared[words[0]].append(" ".join(words))
        elif words[0] == "usemtl":
            material = words[1]
        elif words[0] == "f":
            corners = [word.split("/") for word in words[1:]]
            faces.setdefault(material, []).append(
                [(int(c[0]), int(c[2]) if len(c) > 2 and c[2] else None) for c in corners]
            )
    files = {}
    for material, polygons in faces.items():
        lines, places = [], {"v": {}, "vn": {}}
        for corner in (corner for polygon in polygons for corner in polygon):
            for kind, number in zip(("v", "vn"), corner, strict=True):
                if number is not None and number not in places[kind]:
                    places[kind][number] = len(places[kind]) + 1
                    lines.append(shared[kind][number - (number > 0)])
        for polygon in polygons:
            ends = [
                str(places["v"][v]) + ("" if n is None else f"//{places['vn'][n]}")
                for v, n in polygon
            ]
            # A fan of triangles, which MuJoCo requires.
            lines += [f"f {ends[0]} {b} {c}" for b, c in pairwise(ends[1:])]
        files[material] = "\n".join(lines) + "\n"
    return files
