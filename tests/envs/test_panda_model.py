"""The arm is Franka's, and its inverse kinematics reach the whole workspace in one way."""

import copy
import itertools
import os
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from legibility.envs.arm import BASE, HOME, JOINT_LIMITS
from legibility.envs.panda_model import (
    JOINT_MARGIN,
    Kinematics,
    Simulation,
    checked_points,
    nearby,
    obstacle_gaps,
    physics,
    postures,
)
from legibility.errors import MissingExtraError
from legibility.obstacles import Ball, Box
from legibility.scene import DEFAULT_WORKSPACE

for extra in ("mujoco", "mink"):
    pytest.importorskip(extra, reason="the arm is NOT TESTED: pip install 'legibility[panda]'")

LOW, HIGH = np.array(DEFAULT_WORKSPACE[3])
# a, d, α of each joint and of the flange (Craig's convention), as Franka publishes them.
DENAVIT_HARTENBERG = [
    (0, 0.333, 0), (0, 0, -np.pi / 2), (0, 0.316, np.pi / 2), (0.0825, 0, np.pi / 2),
    (-0.0825, 0.384, -np.pi / 2), (0, 0, np.pi / 2), (0.088, 0, np.pi / 2), (0, 0.107, 0),
]  # fmt: skip

joints = st.tuples(*(st.floats(low, high) for low, high in JOINT_LIMITS.T)).map(np.array)
points = st.tuples(*(st.floats(a, b) for a, b in zip(LOW, HIGH, strict=True))).map(np.array)


def screw(a, d, alpha, theta):
    """The frame of the next joint in that of the last."""
    c, s, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
    return np.array([
        [c, -s, 0, a],
        [s * ca, c * ca, -sa, -d * sa],
        [s * sa, c * sa, ca, d * ca],
        [0, 0, 0, 1],
    ])  # fmt: skip


def pose(angles):
    """The grasp point's frame in the world, by Franka's table alone."""
    found = np.eye(4)
    found[:3, 3] = BASE
    for row, angle in zip(DENAVIT_HARTENBERG, [*angles, 0], strict=True):
        found = found @ screw(*row, angle)
    return found @ screw(0, 0.1034, 0, -np.pi / 4)


KINEMATICS = Kinematics()


@pytest.fixture
def kinematics():
    return KINEMATICS


@pytest.fixture(scope="module")
def simulation():
    return Simulation()


def test_model():
    model = physics()
    assert model.nq == model.nv == model.nu == 7
    assert model.jnt_range == pytest.approx(JOINT_LIMITS.T)
    assert model.actuator_forcerange[:, 1].tolist() == [87] * 4 + [12] * 3
    assert model.nmesh == 0  # numbers never depend on what is installed for the looks
    assert model.body_mass.sum() == pytest.approx(17.45, abs=0.1)
    assert 1e-3 < model.opt.timestep <= 2e-3


@given(joints)
def test_forward_kinematics_are_those_of_franka(angles):
    assert KINEMATICS.grasp_point(angles) == pytest.approx(pose(angles)[:3, 3], abs=1e-9)


def test_every_point_of_the_workspace_is_reached(kinematics):
    sides = (np.linspace(a, b, n) for a, b, n in zip(LOW, HIGH, (5, 7, 6), strict=True))
    for target in np.array(list(itertools.product(*sides))):
        angles = kinematics.solve(target)
        frame = pose(angles)
        assert frame[:3, 3] == pytest.approx(target, abs=1e-6)
        assert (angles >= JOINT_LIMITS[0] + JOINT_MARGIN - 1e-9).all()
        assert (angles <= JOINT_LIMITS[1] - JOINT_MARGIN + 1e-9).all()
        corner = target[0] == HIGH[0] and abs(target[1]) == HIGH[1] and target[2] == HIGH[2]
        lean = np.degrees(np.arccos(min(1, -frame[2, 2])))
        assert lean == pytest.approx(4.6, abs=0.1) if corner else lean < 1e-3
        assert frame[1, 0] == pytest.approx(0, abs=2e-3)  # it does not turn
        assert angles[2] == pytest.approx(0, abs=1e-4)


@settings(max_examples=20)
@given(points, points)
def test_a_position_has_one_posture(target, other):
    kinematics = KINEMATICS
    angles = kinematics.solve(target)
    moved = kinematics.solve(other)
    assert np.array_equal(Kinematics().solve(target), angles)
    assert np.array_equal(kinematics.solve(target), angles)
    for share in np.linspace(0, 1, 41):  # the way back ends in the same posture
        moved = moved + kinematics.step(moved, other + share * (target - other))
    for _ in range(5):
        moved = moved + kinematics.step(moved, target)
    assert moved == pytest.approx(angles, abs=1e-3)
    assert kinematics.step(angles, target) == pytest.approx(np.zeros(7), abs=1e-6)


def test_contacts_are_seen(kinematics, simulation):
    def touched(angles):
        return simulation.run(angles[None], np.zeros((1, 7)), angles[None, None])[2][0, 0].tolist()

    sides = (np.linspace(low, high, 4) for low, high in zip(LOW, HIGH, strict=True))
    for target in np.array(list(itertools.product(*sides))):
        assert touched(kinematics.solve(target)) == [False, False]
    assert touched(kinematics.solve(np.array([-0.1, 0, 0.005]))) == [True, False]
    assert touched(np.array([0, 0.4, 0, -3.06, 0, 1.5, 0.8])) == [False, True]


LINE = np.linspace([-0.2, -0.2, 0.3], [0, 0.2, 0.1], 50)


def test_postures_follow_a_trajectory(kinematics):
    found = postures(checked_points(LINE))
    places = np.array([kinematics.grasp_point(angles) for angles in found])
    steps = np.linalg.norm(np.diff(places, axis=0), axis=-1)
    assert steps.max() < 0.0101
    assert steps.sum() == pytest.approx(np.linalg.norm(LINE[-1] - LINE[0]), rel=1e-3)
    assert places[[0, -1]] == pytest.approx(LINE[[0, -1]], abs=2e-4)
    assert len(checked_points(LINE[:1].repeat(2, axis=0))) == 2  # without length


@pytest.mark.parametrize(
    ("obstacle", "touched"),
    [
        (Ball([-0.3, 0.0, 0.45], 0.05), True),  # the forearm alone
        (Box([-0.3, 0.0, 0.45], [0.05, 0.1, 0.05], 0.4), True),
        (Box([0.0, 0.2, 0.1], [0.04, 0.04, 0.04]), True),  # the fingers at the goal
        (Ball([-0.1, 0.0, 0.03], 0.03), False),  # under the gripper's way
        (Box([0.1, -0.2, 0.1], [0.1, 0.1, 0.1]), False),
        (Ball([-0.6, 0.0, 1.2], 0.1), False),
    ],
)
def test_an_obstacle_in_the_way_of_any_link_is_found(obstacle, touched):
    found = obstacle_gaps((obstacle,), postures(checked_points(LINE))) < 0
    assert found.any() == touched
    assert not found.all()
    more = (obstacle, Ball([-0.6, 0, 1.2], 0.1))
    again = obstacle_gaps(more, postures(checked_points(LINE))) < 0
    assert again.tolist() == found.tolist()
    for near in nearby(more, postures(checked_points(LINE))):
        assert len(near.links) == len(near.gaps) == len(near.normals)
        assert np.linalg.norm(near.normals, axis=-1) == pytest.approx(1)
        assert set(near.obstacles.tolist()) <= {0, 1}


@settings(max_examples=10, deadline=None)
@given(joints, points, st.floats(0.01, 0.1))
def test_a_capsule_touches_a_ball_as_far_as_their_radii(angles, center, radius):
    """MuJoCo's contacts agree with distances between the arm's axes and a ball's centre."""
    import mujoco

    model = physics()
    data = mujoco.MjData(model)
    data.qpos = angles
    mujoco.mj_kinematics(model, data)
    gap = np.inf
    for geom in np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_CAPSULE):
        if model.geom_bodyid[geom] > 1:  # the base does not move
            axis = data.geom_xmat[geom].reshape(3, 3)[:, 2] * model.geom_size[geom, 1]
            ends = data.geom_xpos[geom] + np.linspace(-1, 1, 2001)[:, None] * axis
            apart = np.linalg.norm(ends - center, axis=-1).min() - model.geom_size[geom, 0]
            gap = min(gap, apart - radius)
    touched = obstacle_gaps((Ball(center, radius),), angles[None])[0] < 0
    if gap < -1e-4:
        assert touched
    elif gap > 0.08:  # a finger, a box, is nearer than its hand by less
        assert not touched


def test_arms_do_not_feel_each_other(kinematics, simulation):
    rng = np.random.default_rng(0)
    angles = HOME + rng.normal(0, 0.1, (5, 7))
    speeds = rng.normal(0, 0.3, (5, 7))
    controls = np.repeat(HOME[None, None], 6, axis=1) + rng.normal(0, 0.01, (5, 6, 7))
    many = simulation.run(angles, speeds, controls)
    for i in (3, 0):
        one = copy.deepcopy(simulation).run(*(x[i : i + 1] for x in (angles, speeds, controls)))
        for all_, single in zip(many, one, strict=True):
            assert np.array_equal(all_[i], single[0])


def test_it_stands_where_it_is_told_to(simulation):
    angles, speeds, _ = simulation.run(HOME[None], np.zeros((1, 7)), np.tile(HOME, (1, 200, 1)))
    assert angles[0, -1] == pytest.approx(HOME, abs=1e-6)  # it does not droop
    assert speeds == pytest.approx(0, abs=1e-5)


@pytest.mark.parametrize("module", ["mujoco", "mink"])
def test_missing(monkeypatch, module):
    from legibility.envs.panda import PandaBlockReach

    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(
        MissingExtraError, match=r"not installed: pip install 'legibility\[panda\]'"
    ):
        PandaBlockReach()


def test_what_mujoco_cannot_draw_with():
    code = "from legibility.envs.panda import PandaBlockReach; PandaBlockReach()"
    found = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        env={**os.environ, "MUJOCO_GL": "nonsense"},
    )
    assert found.returncode == 0
    assert "UserWarning: ignoring MUJOCO_GL=nonsense" in found.stderr
