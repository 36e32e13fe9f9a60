"""The arm is Franka's, and its inverse kinematics reach the whole workspace in one way."""

import copy
import itertools
import os
import pickle
import subprocess
import sys
import warnings

import gymnasium
import numpy as np
import pytest
from arms import ur5e
from hypothesis import given, settings
from hypothesis import strategies as st

from legibility.envs.panda import Simulation
from legibility.envs.pandagym import JOINT_LIMITS
from legibility.errors import InvalidInputError, MissingExtraError
from legibility.obstacles import Ball, Box
from legibility.robots.arm import PANDA, Arm, checked_points
from legibility.robots.kinematics import JOINT_MARGIN, Kinematics
from legibility.robots.limits import Limits
from legibility.scene import DEFAULT_WORKSPACE, Scene

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
    found[:3, 3] = PANDA.base[:3]
    for row, angle in zip(DENAVIT_HARTENBERG, [*angles, 0], strict=True):
        found = found @ screw(*row, angle)
    return found @ screw(0, 0.1034, 0, -np.pi / 4)


KINEMATICS = Kinematics(PANDA)


@pytest.fixture
def kinematics():
    return KINEMATICS


@pytest.fixture(scope="module")
def simulation():
    return Simulation(PANDA)


def test_model():
    model = PANDA.physics()
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
    assert np.array_equal(Kinematics(PANDA).solve(target), angles)
    assert np.array_equal(kinematics.solve(target), angles)
    for share in np.linspace(0, 1, 41):  # the way back ends in the same posture
        moved = moved + kinematics.step(moved, other + share * (target - other))
    for _ in range(5):
        moved = moved + kinematics.step(moved, target)
    assert moved == pytest.approx(angles, abs=1e-3)
    assert kinematics.step(angles, target) == pytest.approx(np.zeros(7), abs=1e-4)


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
    found = PANDA.postures(checked_points(LINE))
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
    found = PANDA.obstacle_gaps((obstacle,), PANDA.postures(checked_points(LINE))) < 0
    assert found.any() == touched
    assert not found.all()
    more = (obstacle, Ball([-0.6, 0, 1.2], 0.1))
    again = PANDA.obstacle_gaps(more, PANDA.postures(checked_points(LINE))) < 0
    assert again.tolist() == found.tolist()
    for near in PANDA.nearby(more, PANDA.postures(checked_points(LINE))):
        assert len(near.links) == len(near.gaps) == len(near.normals)
        assert np.linalg.norm(near.normals, axis=-1) == pytest.approx(1)
        assert set(near.obstacles.tolist()) <= {0, 1}


@settings(max_examples=10, deadline=None)
@given(joints, points, st.floats(0.01, 0.1))
def test_a_capsule_touches_a_ball_as_far_as_their_radii(angles, center, radius):
    """MuJoCo's contacts agree with distances between the arm's axes and a ball's centre."""
    import mujoco

    model = PANDA.physics()
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
    touched = PANDA.obstacle_gaps((Ball(center, radius),), angles[None])[0] < 0
    if gap < -1e-4:
        assert touched
    elif gap > 0.08:  # a finger, a box, is nearer than its hand by less
        assert not touched


def test_arms_do_not_feel_each_other(kinematics, simulation):
    rng = np.random.default_rng(0)
    angles = PANDA.home + rng.normal(0, 0.1, (5, 7))
    speeds = rng.normal(0, 0.3, (5, 7))
    controls = np.repeat(PANDA.home[None, None], 6, axis=1) + rng.normal(0, 0.01, (5, 6, 7))
    many = simulation.run(angles, speeds, controls)
    for i in (3, 0):
        one = copy.deepcopy(simulation).run(*(x[i : i + 1] for x in (angles, speeds, controls)))
        for all_, single in zip(many, one, strict=True):
            assert np.array_equal(all_[i], single[0])


def test_it_stands_where_it_is_told_to(simulation):
    angles, speeds, _ = simulation.run(
        PANDA.home[None], np.zeros((1, 7)), np.tile(PANDA.home, (1, 200, 1))
    )
    assert angles[0, -1] == pytest.approx(PANDA.home, abs=1e-6)  # it does not droop
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


@pytest.fixture(scope="module")
def arm():
    return ur5e()


class TestAnotherArm:
    def test_model(self, arm):
        model = arm.physics()
        assert model.nq == model.nv == model.nu == arm.joints == 6
        assert model.nmesh == 0
        assert arm.joint_names[0] == "shoulder_pan_joint"
        assert arm.joint_range.shape == (2, 6)
        assert arm.base_name == "base"
        assert arm.name == "ur5e"
        assert arm.limits.velocity == pytest.approx(np.pi)

    def test_the_gripper_points_down_wherever_it_can_be(self, arm):
        kinematics = arm.kinematics()
        sides = (np.linspace(a, b, n) for a, b, n in zip(LOW, HIGH, (3, 4, 3), strict=True))
        for target in np.array(list(itertools.product(*sides))):
            angles, gap = kinematics.reach(target)
            assert gap < 1e-6
            assert arm.first_contact((), angles[None]) is None
            assert kinematics.grasp_point(angles) == pytest.approx(target, abs=1e-6)
            assert kinematics._configuration.data.site("attachment_site").xmat.reshape(3, 3)[
                :, 2
            ] == pytest.approx([0, 0, -1], abs=1e-4)

    def test_what_it_touches(self, arm):
        kinematics = arm.kinematics()
        low = kinematics.reach(np.array([-0.1, 0, -0.02]))[0]
        assert arm.first_contact((), np.stack([arm.home, low])) == (1, "wrist_2_link", "table")
        ball = Ball(kinematics.grasp_point(arm.home), 0.05)
        far = Ball([5, 5, 5], 0.05)
        assert arm.first_contact((far, ball), arm.home[None]) == (0, "wrist_2_link", "obstacles[1]")
        folded = np.array([0, -1.5, 3.1, -1.5, 0, 0])
        assert arm.first_contact((), folded[None]) is not None
        assert arm.obstacle_gaps((far, ball), arm.home[None]) < 0

    def test_it_stands_where_it_is_told_to(self, arm):
        simulation = Simulation(arm)
        start = arm.home[None], np.zeros((1, 6))
        angles, speeds, touched = simulation.run(*start, np.tile(arm.home, (1, 200, 1)))
        assert angles[0, -1] == pytest.approx(arm.home, abs=1e-5)
        assert speeds[0, -1] == pytest.approx(0, abs=1e-4)
        assert not touched.any()

    @pytest.mark.parametrize("turn", [0.0, 1.0, np.pi])
    def test_base_and_gripper(self, turn):
        """A base elsewhere moves all with it, and the gripper points where it is told to."""
        arm = ur5e(base=[0.3, -0.2, 0.1, turn], gripper=[0, 0, -2.0], roll=0.5)
        assert arm.gripper_to_world.T @ arm.gripper_to_world == pytest.approx(np.eye(3))
        assert np.linalg.det(arm.gripper_to_world) == pytest.approx(1)
        assert arm.gripper_to_world[:, 2] == pytest.approx([0, 0, -1])
        plain = ur5e(base=[0, 0, 0, 0])
        place = plain.kinematics().grasp_point(plain.home)
        moved = arm.kinematics().grasp_point(arm.home)
        assert moved == pytest.approx(arm.base_to_world @ place + [0.3, -0.2, 0.1])
        forward = ur5e(gripper=[1, 0, 0])
        assert forward.gripper_to_world[:, 2] == pytest.approx([1, 0, 0])

    def test_environment(self, arm):
        """The same environment moves it, with the controller that made the demonstrations."""
        from legibility import Modulator
        from legibility.drivers import Feedback
        from legibility.envs.panda import PandaBlockReachVector

        one = gymnasium.make("legibility/PandaBlockReach-v0", arm=arm)
        assert one.reset(seed=0)[0]["position"].shape == (3,)
        one.close()
        env = PandaBlockReachVector(2, arm=arm)
        env.reset(seed=[0, 1], options={"num_goals": 2, "target": 0})
        modulator = Modulator.from_pretrained("panda-block-reach")
        for driver in (Feedback(), None):
            env.reset(seed=[0, 1], options={"num_goals": 2, "target": 0})
            for rollout in modulator.execute_many(env, legibility=[0.0, 0.5], driver=driver):
                assert rollout.success
                assert rollout.joint_angles.shape[1] == 6
                assert rollout.counts["table_contacts"] == rollout.counts["self_collisions"] == 0
        env.close()

    def test_picture(self, arm):
        from legibility.envs.panda_render import arm_image

        scene = Scene(start=[-0.2, -0.2, 0.3], goals=[[0, 0.1, 0.02], [0, -0.1, 0.02]])
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            one, other = (arm_image(scene, 0, a.home, size=(160, 160), arm=a) for a in (arm, PANDA))
        assert one.shape == other.shape == (160, 160, 3)
        assert (one != other).any(-1).mean() > 0.02

    def test_file(self, arm, tmp_path):
        model = os.path.relpath(arm.model, tmp_path)
        lines = [f"model: {model}", "site: attachment_site", f"home: {arm.home.tolist()}"]
        lines += ["base: [-0.7, 0, 0, 0]", "limits:", f"  velocity: {[np.pi] * 6}"]
        lines += ["  acceleration: [10, 10, 10, 10, 10, 10]", f"  jerk: {[1000.0] * 6}"]
        (file := tmp_path / "arm.yaml").write_text("\n".join(lines))
        loaded = Arm.named(str(file))
        assert loaded.kinematics().grasp_point(arm.home) == pytest.approx(
            arm.kinematics().grasp_point(arm.home)
        )
        file.write_text("model: a.xml\nshoe: 3\n")
        with pytest.raises(InvalidInputError, match=r"arm.yaml does not describe an arm: .*shoe"):
            Arm.load(file)
        file.write_text("\n".join(lines).replace("velocity", "velocitys"))
        with pytest.raises(InvalidInputError, match=r"unknown: velocitys; did you mean velocity\?"):
            Arm.load(file)
        file.write_text("- 3\n")
        with pytest.raises(InvalidInputError, match="must hold a mapping with model, site, home"):
            Arm.load(file)

    @pytest.mark.parametrize(
        ("changes", "message"),
        [
            ({"site": "tool"}, r"no site 'tool'; its sites are attachment_site"),
            ({"model": "missing.xml"}, r"cannot read the model missing.xml: "),
            ({"home": [0, 0]}, r"limits must be of the 2 joints of home, got those of 6"),
            ({"home": [0] * 5, "limits": Limits([1] * 5, [1] * 5, [1] * 5)},
             "home must have an angle of each joint, .* attachment_site: shoulder_pan_.*; got 5"),
            ({"limits": "point"}, "limits must be of the 6 joints of home, got those of a point"),
            ({"gripper": [0, 0, 0]}, "gripper must be a direction, got a vector without length"),
            ({"base": [0, 0, 0]}, r"base must be x, y, z and a turn, got \[0"),
            ({"elbow": 6}, "elbow must be a joint from 0 to 5, got 6"),
        ],
    )  # fmt: skip
    def test_refuses(self, changes, message):
        with pytest.raises(InvalidInputError, match=message):
            ur5e(**changes).physics()

    def test_names(self, monkeypatch):
        assert Arm.named("panda") is PANDA
        with pytest.raises(InvalidInputError, match="arm must be one of panda, or a YAML"):
            Arm.named("ur5e")
        with pytest.raises(
            InvalidInputError, match="cannot get the model nao: Unknown robot 'nao'"
        ):
            ur5e(model="nao").physics()
        monkeypatch.setitem(sys.modules, "mujoco_menagerie", None)
        with pytest.raises(MissingExtraError, match=r"pip install 'legibility\[arms\]'"):
            ur5e(model="universal_robots_ur5e").physics()


def test_an_arm_may_be_what_a_process_is_sent():
    arm = pickle.loads(pickle.dumps(PANDA))
    assert arm.kinematics().solve(LOW) == pytest.approx(KINEMATICS.solve(LOW))


ODD = """
<mujoco>
  <compiler angle="radian"/>
  <worldbody>
    <body pos="0 0 0.1">
      <geom type="box" size="0.05 0.05 0.05" group="5"/>
      <body name="a" pos="0 0 0.1">
        <joint name="turn" axis="0 0 1"/>
        <geom type="capsule" size="0.03 0.1" contype="0" conaffinity="0"/>
        <body name="b" pos="0 0 0.3">
          <joint name="bend" axis="0 1 0" range="-2 2" limited="true"/>
          <geom type="capsule" size="0.03 0.1" pos="0 0 0.15"/>
          <site name="tool" pos="0 0 0.3"/>
          <body name="finger" pos="0 0 0.3">
            <joint name="grip" type="slide" axis="1 0 0"/>
            <geom type="box" size="0.01 0.01 0.02"/>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position joint="bend" kp="900" kv="10" forcerange="-50 50" ctrlrange="-0.1 0.1"/>
    <motor joint="turn" gear="2" forcerange="-20 20"/>
    <motor joint="grip"/>
  </actuator>
  <keyframe><key qpos="0.1 0.2 0"/></keyframe>
</mujoco>
"""


class TestOddModel:
    """No name at the root, no range, looks with the mass, motors in another order, a gripper."""

    @pytest.fixture
    def odd(self, tmp_path):
        (file := tmp_path / "odd.xml").write_text(ODD)
        return Arm(file, "tool", [0.3, 1.2], Limits([2, 2], [10, 10], [100, 100]))

    def test_model(self, odd):
        model = odd.physics()
        assert odd.joint_names == ["turn", "bend"]
        assert odd.base_name == "base"
        assert odd.joint_range.tolist() == [[-np.inf, -2], [np.inf, 2]]
        assert model.actuator_trnid[:, 0].tolist() == [0, 1]
        assert model.actuator_gainprm[:, 0].tolist() == [400 * 20, 900]
        assert model.actuator_forcerange[:, 1].tolist() == [20, 50]
        assert model.body("a").mass > 0.1  # that of its looks

    def test_it_stands_where_it_is_told_to(self, odd):
        home = odd.home[None]
        angles, _, _ = Simulation(odd).run(home, 0 * home, np.tile(odd.home, (1, 400, 1)))
        assert angles[0, -1] == pytest.approx(odd.home, abs=1e-3)

    def test_its_own_parts_are_no_obstacles(self, odd):
        near = Ball(odd.kinematics().grasp_point(odd.home), 0.1)
        assert odd.first_contact((near,), odd.home[None])[1:] == ("b", "obstacles[0]")
        assert odd.obstacle_gaps((Ball([5, 5, 5], 0.1),), odd.home[None]) > 0

    def test_what_mujoco_refuses(self, odd, tmp_path):
        (tmp_path / "odd.xml").write_text(ODD.replace('group="5"', 'mesh="missing" type="mesh"'))
        with pytest.raises(InvalidInputError, match=r"cannot (read|use) the model .*odd.xml: "):
            odd.physics()

    @pytest.mark.parametrize(
        ("changes", "message"),
        [
            ({"limits": 5}, "limits must be legibility.Limits or a name, got 5"),
            ({"model": 5}, "model must be a file or a name, got 5"),
            ({"elbow": True}, "elbow must be a joint from 0 to 1, got True"),
            ({"lean": 3}, "lean must be of three values, got 3"),
            ({"lean": (1, (1, 2), -1)}, "lean must be a number above 0, got -1"),
        ],
    )
    def test_refuses(self, odd, changes, message):
        plain = {"model": odd.model, "site": "tool", "home": odd.home, "limits": odd.limits}
        with pytest.raises(InvalidInputError, match=message):
            Arm(**{**plain, **changes})


def test_points_from_the_base_and_back():
    """A point ahead of a base that faces along y lies beside it."""
    arm = ur5e(base=[-0.6, 0.2, 0.1, np.pi / 2])
    np.testing.assert_allclose(arm.in_world([0.3, 0, 0]), [-0.6, 0.5, 0.1], atol=1e-12)
    points = np.random.default_rng(0).normal(size=(4, 5, 3))
    np.testing.assert_allclose(arm.in_base(arm.in_world(points)), points, atol=1e-12)
    for method in (arm.in_world, arm.in_base):
        with pytest.raises(InvalidInputError, match="points"):
            method([0.3, 0])
