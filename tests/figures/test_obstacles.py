"""Obstacles in figures: drawn where they are, in both dimensions."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon as Patch
from pictures import SCENES, assert_picture, path_of, rollout_of

import legibility as lg
from legibility.figures import obstacles as drawing
from legibility.figures.film import execution_figure
from legibility.figures.paper import plan_figure
from legibility.figures.scene_axes import scene_axes
from legibility.obstacles import Ball, Box, Polygon

SHAPES = {
    2: [
        Ball([0.4, 0.3], 0.1),
        Box([0.6, 0.9], [0.3, 0.1], 0.5),
        Polygon([[0.2, 0], [0.5, 0], [0.4, 0.2]]),
    ],
    3: [Ball([-0.1, -0.05, 0.2], 0.05), Box([-0.2, 0.2, 0.1], [0.08, 0.06, 0.2], 0.4)],
}
CASES = [(dim, shape) for dim, shapes in SHAPES.items() for shape in shapes]


def crowded(dim):
    scene = SCENES[dim]
    return lg.Scene(
        scene.start, scene.goals, obstacles=SHAPES[dim], clearance=0.02, goal_radius=0.05
    )


@given(
    case=st.sampled_from(CASES), angles=st.tuples(*[st.floats(-7, 7)] * 2), margin=st.floats(0, 0.5)
)
def test_an_outline_keeps_its_distance_from_whichever_side_it_is_seen(case, angles, margin):
    dim, shape = case
    a, e = angles
    plane = np.array([
        [-np.sin(a), np.cos(a), 0],
        [-np.sin(e) * np.cos(a), -np.sin(e) * np.sin(a), np.cos(e)],
    ]) if dim == 3 else np.array([[np.cos(a), np.sin(a)], [-np.sin(a), np.cos(a)]])  # fmt: skip
    corners, radius = drawing._shape(shape)
    outline = drawing._outline(corners, radius + margin, plane)
    np.testing.assert_allclose(shape.signed_distance(outline), margin, atol=1e-9)
    np.testing.assert_allclose(outline[0], outline[-1], atol=1e-9)


@pytest.mark.parametrize("shape", SHAPES[3], ids=["ball", "box"])
def test_faces_lie_on_the_surface_and_look_outward(shape):
    for face in drawing._faces(shape):
        np.testing.assert_allclose(shape.signed_distance(face), 0, atol=1e-9)
        normal = np.cross(face[2] - face[0], face[3] - face[1])
        centre = face.mean(axis=0)
        assert shape.signed_distance(centre + 0.01 * normal / np.linalg.norm(normal)) > 0.009
        assert normal @ (centre - shape.center) > 0


def test_axes_show_obstacles_clearances_and_goals_that_motions_keep_from():
    scene, figure = crowded(2), Figure()
    axes = scene_axes(figure, figure.add_gridspec(1, 1)[0], scene, 0, scene.goals[None])
    patches = [patch for patch in axes.patches if isinstance(patch, Patch)]
    assert len(patches) == 3
    lines = [line for line in axes.lines if isinstance(line, Line2D) and len(line.get_xdata()) > 9]
    gaps = [scene.clearance_at(line.get_xydata(), 0) for line in lines]
    assert len(lines) == 4
    assert all(gap.max() <= scene.clearance + 1e-9 for gap in gaps)
    np.testing.assert_allclose(gaps[-1], 0, atol=1e-9)  # around the other goal
    colors = {line.get_color() for line in lines}
    assert len(colors) == 2
    assert set(drawing.key(scene)) == {"obstacle", "clearance to keep"}
    assert drawing.key(SCENES[2]) == {}


@pytest.mark.parametrize("dim", [2, 3])
def test_figures_of_a_scene_with_obstacles(dim, tmp_path):
    scene = crowded(dim)
    archive = lg.build_archive(scene, 0, cells=6, random_candidates=1024, max_candidates=1024)
    plan_figure(path_of(archive, [-1, 0, 1]), tmp_path / "plan.png")
    path = path_of(archive, 0.5)
    rollout = rollout_of(path, path.trajectory(12))
    execution_figure([rollout], tmp_path / "film.png")
    for name in ("plan", "film"):
        assert_picture(tmp_path / f"{name}.png")


def test_a_high_wall_does_not_shrink_the_scene():
    scene = SCENES[3]
    wall = Box([-0.2, 0.25, 5], [0.05, 0.05, 10])
    assert drawing.highest(lg.Scene(scene.start, scene.goals, obstacles=[wall])) == 0.4
    assert drawing.highest(scene) == -np.inf
