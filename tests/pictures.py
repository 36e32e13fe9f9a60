"""What the tests of figures and films share."""

import numpy as np
from PIL import Image

import legibility as lg
from legibility.data.dataset import paths_of
from legibility.motion.path import Path
from legibility.rollout import Rollout

SCENES = {
    2: lg.Scene(start=[0, 0.5], goals=[[0.8, 0.6], [1, 0.3]]),
    3: lg.Scene(start=[-0.2, 0, 0.3], goals=[[0.05, -0.1, 0.04], [0, 0.1, 0.04], [0, -0.2, 0.08]]),
}


def small_archive(dim, target):
    return lg.build_archive(
        SCENES[dim], target, cells=8, random_candidates=1024, max_candidates=2048
    )


def path_of(archive, legibility):
    """The archive's paths of these levels, with that archive."""
    levels = np.asarray(legibility, dtype=float)
    waypoints = paths_of(archive)[[archive.nearest(level) for level in np.atleast_1d(levels)]]
    waypoints = waypoints if levels.ndim else waypoints[0]
    path = Path.through(waypoints, archive.scene, archive.target, levels, archive.observer)
    path.__dict__["archive"] = archive
    return path


def rollout_of(path, states, reason="reached"):
    """An execution that went through `states` in steps of 0.05 s, exactly on its path."""
    actions = np.diff(states, axis=0)
    return Rollout(
        path, states, actions, success=reason == "reached", reason=reason, replans=(),
        deviation=np.zeros(len(actions)), step_seconds=0.05, wall_contacts=0, contacts=0,
        corrections=0, joint_angles=np.empty((len(states), 0)),
    )  # fmt: skip


def assert_picture(file):
    """The file is a picture with ink and colour, and none of it is cut off at the rim."""
    with Image.open(file) as image:
        pixels = np.asarray(image.convert("RGB")).astype(int)
    assert min(pixels.shape[:2]) > 400
    assert 0.02 < (pixels.min(-1) < 200).mean() < 0.6
    assert (np.ptp(pixels, axis=-1) > 60).mean() > 0.001
    for rim in (pixels[0], pixels[-1], pixels[:, 0], pixels[:, -1]):
        assert (rim > 250).all()


def assert_vector(file):
    """The file is a whole PDF or SVG."""
    content = file.read_bytes()
    assert content.startswith(b"%PDF" if file.suffix == ".pdf" else b"<?xml")
    assert len(content) > 5000
    assert content.rstrip().endswith(b"%%EOF" if file.suffix == ".pdf" else b"</svg>")
