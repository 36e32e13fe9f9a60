"""The picture shows each block, the target and the end effector where they are."""

import os
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import ImageColor

from legibility import Scene
from legibility.envs.colors import GOALS, INK, OBSTACLE
from legibility.envs.render import draw_scene
from legibility.obstacles import Ball, Box, Polygon

SCENE = Scene([0, 0.5], [[0.8, 0.6], [1, 0.3], [0.2, 1.0], [0.3, 0.1]])
AWAY = np.array([0.5, 0.8])
WAYS = np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])


def color_at(image, point, size=480):
    """The colour at `point` [m] of the default workspace."""
    x, y = 0.06 * size + 0.88 * size * (np.asarray(point) + 0.1) / 1.2
    return tuple(int(c) for c in image[int(size - y), int(x)])


def test_picture():
    image = draw_scene(SCENE, 1, AWAY)
    assert image.shape == (480, 480, 3)
    assert image.dtype == np.uint8
    for goal, color in zip(SCENE.goals, GOALS, strict=False):
        for inside in np.array([[0, 0], [0.02, 0.02], [-0.02, 0.02], [0.025, -0.02]]):
            assert color_at(image, goal + inside) == ImageColor.getrgb(color)
    assert color_at(image, AWAY) == (255, 255, 255)
    for side in 0.017 * WAYS:
        assert max(color_at(image, AWAY + side)) < 120


@pytest.mark.parametrize("target", range(4))
def test_the_ring_is_about_the_target(target):
    image = draw_scene(SCENE, target, AWAY)
    for index, goal in enumerate(SCENE.goals):
        for way in np.array([[1, 0], [-1, 0], [0, 1], [0, -1]]):
            across = [
                color_at(image, goal + radius * way) for radius in np.linspace(0.045, 0.06, 9)
            ]
            assert (ImageColor.getrgb(INK) in across) == (index == target)


def test_the_end_effector_is_above_the_block():
    image = draw_scene(SCENE, 0, SCENE.goals[0])
    assert color_at(image, SCENE.goals[0]) == (255, 255, 255)
    assert color_at(image, SCENE.goals[0] + np.array([0.025, 0.02])) == ImageColor.getrgb(GOALS[0])


@given(st.integers(0, 2**32 - 1), st.integers(2, 12))
def test_any_scene(seed, number):
    rng = np.random.default_rng(seed)
    scene = Scene.random(rng, num_goals=min(number, 7))
    image = draw_scene(scene, int(rng.integers(scene.num_goals)), rng.choice(scene.workspace))
    assert image.shape == (480, 480, 3)
    for i in range(scene.num_goals):
        assert (image == ImageColor.getrgb(GOALS[i])).all(-1).any()


@pytest.mark.parametrize(
    "solid",
    [Ball([0.5, 0.5], 0.1), Box([0.5, 0.5], [0.3, 0.1], 0.5),
     Polygon([[0.4, 0.4], [0.6, 0.45], [0.5, 0.65]])],
)  # fmt: skip
def test_an_obstacle_is_where_it_is(solid):
    scene = Scene(SCENE.start, SCENE.goals, obstacles=[solid])
    image, bare = draw_scene(scene, 0, AWAY), draw_scene(SCENE, 0, AWAY)
    for point in np.random.default_rng(0).uniform(0.32, 0.7, (200, 2)):
        distance = solid.signed_distance(point)
        if distance < -0.005:
            assert color_at(image, point) == ImageColor.getrgb(OBSTACLE)
        elif distance > 0.005:
            assert color_at(image, point) == color_at(bare, point)


def test_corners_and_other_shapes():
    wide = Scene([0, 0.5], [[-0.1, -0.1], [2, 1.1]], [[-0.1, -0.1], [2, 1.1]])
    image = draw_scene(wide, 1, np.array([2, -0.1]))
    assert image.shape == (299, 480, 3)
    many = Scene([0, 0], [[0.1 * i, 0.5] for i in range(9)])
    assert draw_scene(many, 8, many.start).shape == (480, 480, 3)


def test_the_same_picture_again_and_nothing_is_kept():
    first = draw_scene(SCENE, 0, AWAY)
    kept = first.copy()
    first[:] = 0
    assert np.array_equal(draw_scene(SCENE, 0, AWAY), kept)


BACKEND = """
from matplotlib.backend_bases import FigureManagerBase
from matplotlib.backends.backend_agg import FigureCanvasAgg
events = []
class FigureManager(FigureManagerBase):
    def show(self): events.append("open")
    def destroy(self): events.append("close")
class FigureCanvas(FigureCanvasAgg):
    manager_class = FigureManager
    def draw_idle(self): events.append(tuple(self.figure.axes[0].images[0].get_array()[0, 0]))
    def start_event_loop(self, timeout): events.append(timeout)
"""


def run(code, backend, path):
    return subprocess.run(
        [sys.executable, "-W", "error::UserWarning", "-c", code],
        capture_output=True, text=True, cwd=path,
        env=os.environ | {"MPLBACKEND": backend, "PYTHONPATH": str(path), "DISPLAY": ""},
    )  # fmt: skip


def test_window(tmp_path):
    """On a backend that records what is asked of it."""
    (tmp_path / "recorder.py").write_text(BACKEND)
    code = (
        "import numpy as np\n"
        "from matplotlib import pyplot\n"
        "from legibility.envs.render import Window\n"
        "images = [np.full((60, 80, 3), i, np.uint8) for i in (7, 8)]\n"
        "window = Window(images[0], 0.05)\n"
        "for image in images: window.show(image)\n"
        "window.close(); window.show(images[0]); window.close()\n"
        "import recorder\n"
        "print([e if not isinstance(e, tuple) else int(e[0]) for e in recorder.events])\n"
    )
    found = run(code, "module://recorder", tmp_path)
    assert found.stderr == ""
    assert found.stdout.strip() == "['open', 7, 0.05, 8, 0.05, 'close']"


@pytest.mark.parametrize("backend", ["agg", "svg", "module://broken"])
def test_no_display(tmp_path, backend):
    (tmp_path / "broken.py").write_text("raise ImportError('no such toolkit')")
    code = (
        "import gymnasium, legibility\n"
        "env = gymnasium.make('legibility/BlockReach2D-v0', render_mode='human')\n"
        "try: env.reset(seed=0)\n"
        "except legibility.errors.OutputError as error: print(error)\n"
        "env.close()\n"
    )
    found = run(code, backend, tmp_path)
    assert found.stderr == ""
    assert "needs a display and a GUI toolkit such as tkinter" in found.stdout
    assert ("no such toolkit" if "broken" in backend else f"backend is {backend}") in found.stdout
