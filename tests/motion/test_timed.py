"""Timed motions keep the curve and the limits, of points and of arms, and say what they cannot."""

import numpy as np
import pytest
from arms import ur5e
from hypothesis import given, settings
from hypothesis import strategies as st

import legibility as lg
from legibility.curves import arc_length
from legibility.errors import InvalidInputError
from legibility.motion.path import Path
from legibility.robots.arm import PANDA
from legibility.robots.limits import LIMITS, Limits

for extra in ("toppra", "mujoco", "mink"):
    pytest.importorskip(extra, reason="timed motions are NOT TESTED")

LOW, HIGH = np.array([[-0.25, -0.25, 0.05], [0.05, 0.25, 0.35]])
seeds = st.integers(0, 2**32 - 1)


def solid_path(seed=0, *, goals=((0.0, 0.15, 0.02), (0.0, -0.15, 0.02)), obstacles=()):
    """A path of the arm through the middle of the table, bent by random amounts."""
    rng = np.random.default_rng(seed)
    start = rng.uniform(LOW, HIGH)
    scene = lg.Scene(start=start, goals=goals, obstacles=list(obstacles))
    line = np.linspace(start, scene.goals[0], 10)
    bend = np.sin(np.linspace(0, np.pi, 10))[:, None] * rng.uniform(-0.1, 0.1, 3)
    return Path.through(np.clip(line + bend, LOW - 0.03, HIGH + 0.04), scene, 0, np.array(0.5),
                        lg.Observer())  # fmt: skip


def flat_path(legibility=0.5):
    scene = lg.Scene(start=[0, 0.5], goals=[[0.8, 0.6], [1, 0.3]])
    line = np.linspace(scene.start, scene.goals[0], 10)
    line[1:-1, 1] += 0.15 * np.sin(np.linspace(0, np.pi, 8))
    return Path.through(line, scene, 0, np.array(legibility), lg.Observer())


def shares(positions, rate, limits):
    """Greatest velocity, acceleration and jerk by finite differences, at rest around the motion."""
    rest = np.repeat(positions[[0, -1]], 5, axis=0)
    whole = np.concatenate([rest[:5], positions, rest[5:]])
    found = []
    for order, limit in enumerate((limits.velocity, limits.acceleration, limits.jerk), 1):
        change = np.diff(whole, n=order, axis=0) * rate**order
        size = np.abs(change) if limits.joints else np.linalg.norm(change, axis=-1)
        found.append((size / limit).max())
    return np.array(found)


@settings(max_examples=10, deadline=None)
@given(seeds, st.sampled_from(["panda", "fr3", "moveit-panda"]))
def test_an_arm_keeps_its_limits_and_the_curve(seed, name):
    path = solid_path(seed)
    motion = path.timed(name, rate=1000)
    assert shares(motion.joint_positions, 1000, LIMITS[name]).max() <= 1
    assert np.diff(motion.times) == pytest.approx(1e-3)
    curve = path.trajectory(20_001)
    kinematics = PANDA.kinematics()
    for index in np.linspace(0, len(motion.times) - 1, 40).astype(int):
        place = kinematics.grasp_point(motion.joint_positions[index])
        assert np.linalg.norm(place - motion.positions[index]) < 1e-4
        assert np.linalg.norm(curve - place, axis=-1).min() < 1e-4
    assert motion.joint_velocities[[0, -1]] == pytest.approx(0, abs=1e-5)
    assert motion.positions[[0, -1]] == pytest.approx(path.waypoints[[0, -1]], abs=1e-6)


def test_the_same_for_a_point():
    path = flat_path()
    motion = path.timed(rate=1000)
    assert shares(motion.positions, 1000, LIMITS["point"]).max() <= 1
    for waypoint in path.waypoints:  # met, but for the time between two instants
        assert np.linalg.norm(motion.positions - waypoint, axis=-1).min() < 3e-4
    assert arc_length(motion.positions) == pytest.approx(path.length, rel=1e-3)
    assert motion.joint_positions.shape == (0, 0)
    faster = path.timed(Limits(1, 4, 40), rate=100)
    assert faster.duration < motion.duration
    assert faster.times == pytest.approx(np.arange(len(faster.times)) / 100)


def test_derivatives_are_of_the_positions():
    motion = solid_path().timed("panda", rate=1000)
    for name in ("positions", "joint_positions"):
        velocities = getattr(motion, name.replace("positions", "velocities"))
        accelerations = getattr(motion, name.replace("positions", "accelerations"))
        moved = np.gradient(getattr(motion, name), 1e-3, axis=0)[1:-1]
        assert np.abs(moved - velocities[1:-1]).max() < 0.02 * np.abs(velocities).max()
        changed = np.gradient(velocities, 1e-3, axis=0)[1:-1]
        assert np.abs(changed - accelerations[1:-1]).max() < 0.1 * np.abs(accelerations).max()


def test_what_the_observer_sees_over_time():
    path = flat_path()
    motion = path.timed(rate=100)
    assert motion.posterior.shape == (len(motion.times), 2)
    assert motion.posterior == pytest.approx(path.field.posterior(motion.positions))
    assert 0 <= motion.time_to_confidence <= motion.duration
    assert 0 < motion.observed_legibility < 1
    # At a constant speed time is the way travelled.
    steady = path.timed(Limits(0.05, 1e3, 1e7), rate=100)
    assert steady.score == pytest.approx(float(path.score), abs=5e-3)
    assert motion.score != pytest.approx(steady.score, abs=0.02)


def test_another_arm():
    arm = ur5e()
    path = solid_path(3)
    motion = path.timed(arm=arm, rate=500)
    assert motion.joint_positions.shape[1] == 6
    assert shares(motion.joint_positions, 500, arm.limits).max() <= 1
    slow = path.timed(Limits(*(x / 3 for x in (arm.limits.velocity, arm.limits.acceleration,
                                               arm.limits.jerk))), arm=arm)  # fmt: skip
    assert slow.duration > motion.duration
    calm = Limits(arm.limits.velocity, arm.limits.acceleration, arm.limits.jerk,
                  tip=Limits(0.25, 1, 10))  # fmt: skip
    motion = path.timed(calm, arm=arm, rate=500)
    assert shares(motion.positions, 500, calm.tip).max() <= 1


def test_a_record_of_an_executed_motion():
    path = solid_path()
    motion = path.timed("panda", rate=1000)
    every = slice(0, None, 10)
    record = lg.Motion.recorded(
        path, motion.positions[every], 0.01, motion.joint_positions[every], PANDA
    )
    assert record.limits is None
    assert record.times == pytest.approx(motion.times[every])
    for name in ("velocities", "joint_velocities"):
        off = np.abs(getattr(record, name)[1:-1] - getattr(motion, name)[every][1:-1]).max()
        assert off < 0.1 * np.abs(getattr(motion, name)).max()
    assert record.score == pytest.approx(motion.score, abs=0.02)
    assert record.joint_accelerations.shape == record.joint_positions.shape


@pytest.mark.parametrize("turn", [0.0, 0.7])
def test_frames(turn):
    arm = ur5e(base=[-0.7, 0.05, 0.01, turn])
    motion = solid_path(3).timed(arm=arm)
    base = motion.in_frame("base")
    rotation, origin = arm.base_to_world, arm.base[:3]
    assert base.positions @ rotation.T + origin == pytest.approx(motion.positions)
    assert base.velocities @ rotation.T == pytest.approx(motion.velocities)
    assert base.in_frame("world").positions == pytest.approx(motion.positions)
    assert base.in_frame("world").accelerations == pytest.approx(motion.accelerations)
    assert base.in_frame("base") is base
    assert base.posterior == pytest.approx(motion.posterior)
    assert base.score == pytest.approx(motion.score)
    with pytest.raises(InvalidInputError, match="frame must be one of world, base, got 'tool'"):
        motion.in_frame("tool")
    with pytest.raises(InvalidInputError, match="world without an arm"):
        flat_path().timed().in_frame("base")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"rate": 0}, "rate must be a number above 0, got 0"),
        ({"limits": "ur5e"}, "limits must be one of panda, fr3, moveit-panda, point, got 'ur5e'"),
        ({"arm": "ur5e"}, "arm must be one of panda, or a YAML or JSON file, got 'ur5e'"),
        ({"limits": "point", "arm": "panda"}, "limits are for a point, what moves is 7 joints"),
        ({"limits": Limits([1], [1], [1])}, "limits are for 1 joints, what moves is a point"),
        ({"max_duration": 0.1}, r"takes \d\.\d+ s within the limits, longer than max_duration 0.1"),
        ({"max_duration": -1}, "max_duration must be a number above 0, got -1"),
    ],
)
def test_refuses(arguments, message):
    with pytest.raises(InvalidInputError, match=message):
        solid_path().timed(**arguments)


@pytest.mark.parametrize(
    ("size", "limits"),
    [
        (0.45, Limits(0.5, 0.01, 0.01)),  # slow to speed up
        (1.0, Limits(0.004, 1, 10)),  # minutes
        (50.0, Limits(1, 1, 10)),
        (1e-5, Limits(0.5, 2, 20)),
        (1.0, Limits(1e3, 1e5, 1e8)),
    ],
)
def test_any_size_and_speed(size, limits):
    scene = lg.Scene(start=[0, 0], goals=[[size, 0], [0, size]],
                     workspace=[[-size, -size], [2 * size, 2 * size]])  # fmt: skip
    line = np.linspace(scene.start, scene.goals[0], 10)
    line[1:-1, 1] += 0.1 * size * np.sin(np.linspace(0, np.pi, 8))
    path = Path.through(line, scene, 0, np.array(0.0), lg.Observer())
    motion = path.timed(limits, rate=1000)
    assert shares(motion.positions, 1000, limits).max() <= 1
    assert motion.bound <= motion.duration <= 1.5 * motion.bound + 0.05


def test_what_takes_too_long():
    path = flat_path()
    crawl = Limits(1e-6, 1, 1)
    with pytest.raises(
        InvalidInputError, match=r"takes \d+.* s within .* longer than max_duration"
    ):
        path.timed(crawl, 1.0, max_duration=60)
    with pytest.raises(InvalidInputError, match="more than 1,000,000 instants at the rate 100"):
        path.timed(crawl)
    with pytest.raises(
        InvalidInputError, match=r"more than 1,000,000 instants at the rate 1e\+300"
    ):
        path.timed(rate=1e300)


def test_a_joint_that_its_limits_let_move_no_more():
    """The FR3 stops before the ends of the Panda's range."""
    stretched = Path.through(
        np.linspace([0.08, -0.2, 0.39], [0, 0.15, 0.1], 10),
        lg.Scene(start=[0.08, -0.2, 0.39], goals=[[0, 0.15, 0.1], [0, -0.15, 0.02]]), 0,
        np.array(0.0), lg.Observer(),
    )  # fmt: skip
    low = LIMITS["fr3"]
    braking = low.braking.copy()
    braking[1, 0, 1] = 0.5  # joint 2 may not come below
    bound = Limits(low.velocity, low.acceleration, low.jerk, braking)
    with pytest.raises(InvalidInputError, match=r"joint 2 comes too near to an end of its range"):
        stretched.timed(bound, arm=PANDA)


@pytest.mark.parametrize("rate", [2, 1000])
def test_contacts_do_not_hang_on_the_rate(rate):
    path = solid_path(obstacles=[lg.Ball([-0.3, 0.0, 0.45], 0.08)])
    with pytest.raises(InvalidInputError, match="touches obstacles"):
        path.timed("panda", rate)


def test_scenes_that_are_not_for_an_arm():
    with pytest.raises(InvalidInputError, match="an arm moves in 3-D, the scene is 2-D"):
        flat_path().timed("panda")
    with pytest.raises(InvalidInputError, match="a path of one level is timed, this one has 2"):
        flat_path([0.1, 0.2]).timed()
    scene = lg.Scene(start=[0, 0, 0.2], goals=[[0.9, 0, 0.2], [0, 0.2, 0.1]],
                     workspace=[[-1, -1, 0], [1, 1, 1]])  # fmt: skip
    line = np.linspace(scene.start, scene.goals[0], 10)
    wall = Path.through(line, scene, 0, np.array(0.0), lg.Observer())
    with pytest.raises(InvalidInputError, match=r"cannot reach \[.*\] m, near waypoint \d .* mm"):
        wall.timed("panda")


def test_an_arm_in_the_way():
    """The whole arm is checked, not only its grasp point."""
    path = solid_path(obstacles=[lg.Ball([-0.3, 0.0, 0.45], 0.08)])
    assert path.feasible
    with pytest.raises(
        InvalidInputError, match=r"its link\d touches obstacles\[0\] where its grasp"
    ):
        path.timed("panda")
    assert path.timed("point").duration > 0
