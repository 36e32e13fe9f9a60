"""The picture of the arm, with OpenGL and without."""

import warnings

import numpy as np
import pytest

from legibility import Scene
from legibility.envs import panda_render
from legibility.envs.panda_render import arm_image
from legibility.errors import InvalidInputError
from legibility.obstacles import Ball, Box
from legibility.robots.arm import PANDA

pytest.importorskip("mujoco", reason="the arm is NOT TESTED: pip install 'legibility[panda]'")

SCENE = Scene([-0.2, -0.1, 0.3], [[0, 0.15, 0.02], [0, -0.1, 0.10]])
RED, GREEN, BLUE = (193, 18, 31), (0, 158, 115), (30, 60, 250)
TRAIL = (np.linspace(SCENE.start, SCENE.goals[0], 20), (0.12, 0.24, 1.0, 1.0), 0.006)


def share_of(picture, color):
    """The share of pixels whose hue is that of `color`, in light or shade."""
    pixels = picture / np.maximum(picture.sum(-1, keepdims=True), 1)
    return (np.abs(pixels - np.array(color) / sum(color)).max(-1) < 0.04).mean()


@pytest.fixture(params=["OpenGL", "a sketch"])
def drawn(request, monkeypatch):
    """Pictures of either kind; bare primitive shapes, which are quicker to load."""
    monkeypatch.setattr(panda_render, "_LOCAL", type(panda_render._LOCAL)())
    if request.param == "a sketch":
        panda_render._LOCAL.arm, panda_render._LOCAL.renderer = PANDA, None
        yield
        return
    monkeypatch.setattr(panda_render, "_franka_meshes", list)
    panda_render._looks.cache_clear()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        renderer = panda_render._renderer(PANDA)
    if renderer is None:
        pytest.skip("pictures by OpenGL are NOT TESTED: neither EGL nor OSMesa works here")
    yield
    panda_render._looks.cache_clear()


def test_a_scene(drawn):
    picture = arm_image(SCENE, 0, PANDA.home, trails=[TRAIL], size=(320, 240))
    assert picture.dtype == np.uint8
    assert picture.shape == (240, 320, 3)
    assert (picture[0, 0] >= 250).all()
    for color, low, high in ((RED, 3e-4, 0.02), (GREEN, 3e-4, 0.02), (BLUE, 1e-3, 0.03)):
        assert low < share_of(picture, color) < high
    assert np.array_equal(arm_image(SCENE, 0, PANDA.home, trails=[TRAIL], size=(320, 240)), picture)
    moved = PANDA.home + 0.4 * np.eye(7)[0]
    assert (arm_image(SCENE, 0, moved, trails=[TRAIL], size=(320, 240)) != picture).any()
    bare = arm_image(SCENE, None, PANDA.home, size=(320, 240))
    assert share_of(bare, BLUE) < 1e-4
    assert (arm_image(SCENE, 0, PANDA.home, size=(320, 240)) != bare).any()  # the ring


@pytest.mark.parametrize("solid", [Ball, Box])
def test_obstacles(drawn, solid):
    place = np.array([0.0, 0.0, 0.2])
    size = (0.06,) if solid is Ball else ([0.1, 0.06, 0.1], 0.7)
    scene = Scene(SCENE.start, SCENE.goals, obstacles=[solid(place, *size)])
    bare, picture = (arm_image(s, None, PANDA.home, size=(320, 240)) for s in (SCENE, scene))
    changed = (picture != bare).any(-1)
    assert 0.002 < changed.mean() < 0.1
    assert np.argwhere(changed).mean(axis=0) == pytest.approx([160, 185], abs=6)


def test_both_see_the_same(monkeypatch):
    """Blocks lie in the same place of the picture with OpenGL and without."""
    monkeypatch.setattr(panda_render, "_LOCAL", type(panda_render._LOCAL)())
    monkeypatch.setattr(panda_render, "_franka_meshes", list)
    panda_render._looks.cache_clear()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        if panda_render._renderer(PANDA) is None:
            pytest.skip("pictures by OpenGL are NOT TESTED: neither EGL nor OSMesa works here")
    centres = []
    for renderer in (panda_render._renderer(PANDA), None):
        panda_render._LOCAL.arm, panda_render._LOCAL.renderer = PANDA, renderer
        picture = arm_image(SCENE, None, PANDA.home, size=(400, 300))
        pixels = picture / np.maximum(picture.sum(-1, keepdims=True), 1)
        seen = np.abs(pixels - np.array(RED) / sum(RED)).max(-1) < 0.04
        centres.append(np.argwhere(seen).mean(axis=0))
    panda_render._looks.cache_clear()
    assert centres[0] == pytest.approx(centres[1], abs=1.5)


def test_without_opengl_it_says_so_once(monkeypatch):
    def fail(way, arm):
        raise RuntimeError("no display")

    monkeypatch.setattr(panda_render, "_LOCAL", type(panda_render._LOCAL)())
    monkeypatch.setattr(panda_render, "_Renderer", fail)
    with pytest.warns(UserWarning, match=r"no display.* only sketched; apt-get install libegl1"):
        arm_image(SCENE, 0, PANDA.home)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        arm_image(SCENE, 0, PANDA.home)


def test_sizes_and_targets_are_checked():
    with pytest.raises(InvalidInputError, match="width must be an integer of at least 16, got 0"):
        arm_image(SCENE, 0, PANDA.home, size=(0, 480))
    with pytest.raises(InvalidInputError, match="index from 0 to 1, got 2"):
        arm_image(SCENE, 2, PANDA.home)
    with pytest.raises(InvalidInputError, match="pieces, got 5"):
        arm_image(SCENE, 0, PANDA.home, trails=[(np.zeros((5500, 3)), (1, 0, 0, 1), 0.01)])


def test_meshes_are_split_by_material():
    text = "\n".join((
        "v 0 0 0", "v 1 0 0", "v 1 1 0", "v 0 1 0", "vn 0 0 1", "vt 0 0",
        "usemtl white", "f 1/1/1 2/1/1 3/1/1 4/1/1",
        "usemtl dark", "f 4//1 1//1 2//1",
    ))  # fmt: skip
    parts = panda_render._split(text)
    triangles = {
        name: part["uservert"].reshape(-1, 3)[part["userface"]].reshape(-1, 3, 3).tolist()
        for name, part in parts.items()
    }
    o, x, xy, y = [0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]
    assert triangles == {"white": [[o, x, xy], [o, xy, y]], "dark": [[y, o, x]]}
    assert len(parts["dark"]["uservert"]) == 9  # without the vertex of the other


def test_franka_meshes_load():
    pytest.importorskip("pybullet_data", reason="Franka's meshes are NOT TESTED: no pybullet_data")
    parts = panda_render._franka_meshes()
    assert {link for link, _, _ in parts} == {*(f"link{i}" for i in range(8)), "hand", "finger"}
    panda_render._looks.cache_clear()
    model = panda_render._looks(PANDA)
    assert model.nmesh == len(parts)
    assert model.nq == 7
