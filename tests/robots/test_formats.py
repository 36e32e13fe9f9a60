"""Files and messages hold the motion, as readers that are not ours find it."""

import csv
import json
import sys

import numpy as np
import pytest

import legibility as lg
from legibility.errors import InvalidInputError, MissingExtraError, OutputError
from legibility.motion.path import Path
from legibility.robots import formats

for extra in ("toppra", "mujoco", "mink"):
    pytest.importorskip(extra, reason="files of timed motions are NOT TESTED")


def motion_of(dim):
    if dim == 2:
        scene = lg.Scene(start=[0, 0.5], goals=[[0.8, 0.6], [1, 0.3]])
    else:
        scene = lg.Scene(start=[-0.2, -0.2, 0.3], goals=[[0, 0.1, 0.02], [0, -0.1, 0.02]])
    line = np.linspace(scene.start, scene.goals[0], 10)
    path = Path.through(line, scene, 0, np.array(0.5), lg.Observer())
    return path.timed("panda" if dim == 3 else None, rate=100)


@pytest.fixture(scope="module")
def arm_motion():
    return motion_of(3)


def test_csv(arm_motion, tmp_path):
    arm_motion.save(tmp_path / "motion.csv")
    with open(tmp_path / "motion.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(arm_motion.times)
    for index in (0, 17, -1):
        row = {name: float(value) for name, value in rows[index].items()}
        assert row["time"] == pytest.approx(arm_motion.times[index])
        assert [row[x] for x in "xyz"] == pytest.approx(arm_motion.positions[index], abs=1e-8)
        assert [row[f"v{x}"] for x in "xyz"] == pytest.approx(arm_motion.velocities[index])
        for kind, values in (
            ("q", arm_motion.joint_positions), ("dq", arm_motion.joint_velocities),
            ("ddq", arm_motion.joint_accelerations),
        ):  # fmt: skip
            read = [row[f"{kind}_joint{j}"] for j in range(1, 8)]
            assert read == pytest.approx(values[index], rel=1e-7, abs=1e-9)


def test_csv_is_what_score_reads(tmp_path):
    from legibility.data.recordings import read_recordings

    motion = motion_of(2)
    motion.save(tmp_path / "motion.csv")
    (recording,) = read_recordings(tmp_path / "motion.csv", 2)
    assert recording.positions == pytest.approx(motion.positions, abs=1e-8)
    assert recording.times == pytest.approx(motion.times, abs=1e-8)


def test_json(arm_motion, tmp_path):
    arm_motion.in_frame("base").save(tmp_path / "motion.json")
    content = json.loads((tmp_path / "motion.json").read_text())
    assert content["frame"] == "base"
    assert content["arm"] == "panda"
    assert content["joint_names"] == [f"joint{j}" for j in range(1, 8)]
    assert content["legibility"] == 0.5
    assert content["positions"] == arm_motion.in_frame("base").positions.tolist()
    assert content["joint_positions"] == arm_motion.joint_positions.tolist()


@pytest.mark.parametrize(("dim", "frame"), [(2, "world"), (3, "world"), (3, "base")])
def test_bag(dim, frame, tmp_path):
    """An independent reader of MCAP finds the messages of ROS 2."""
    pytest.importorskip("rosbags", reason="bags are NOT TESTED: pip install 'legibility[ros]'")
    reader = pytest.importorskip("mcap_ros2.reader")
    motion = motion_of(dim).in_frame(frame)
    motion.save(file := tmp_path / "motion.mcap")
    found = {m.channel.topic: m.ros_msg for m in reader.read_ros2_messages(str(file))}
    assert list(found) == ["/joint_trajectory", "/path"][3 - dim :]
    path = found["/path"]
    assert len(path.poses) == len(motion.times)
    assert path.header.frame_id == ("link0" if frame == "base" else "world")
    for index in (0, 9, len(motion.times) - 1):
        pose = path.poses[index]
        place = [pose.pose.position.x, pose.pose.position.y, pose.pose.position.z]
        assert place[:dim] == motion.positions[index].tolist()
        stamp = pose.header.stamp
        assert stamp.sec + 1e-9 * stamp.nanosec == pytest.approx(motion.times[index])
        turn = pose.pose.orientation
        assert np.linalg.norm([turn.x, turn.y, turn.z, turn.w]) == pytest.approx(1)
        assert abs(turn.x) == (dim == 3)  # the gripper points down
    if dim == 3:
        joints = found["/joint_trajectory"]
        assert joints.joint_names == motion.arm.joint_names
        for index in (0, 9, len(motion.times) - 1):
            point = joints.points[index]
            assert point.positions == motion.joint_positions[index].tolist()
            assert point.velocities == motion.joint_velocities[index].tolist()
            assert point.accelerations == motion.joint_accelerations[index].tolist()
            seconds = point.time_from_start.sec + 1e-9 * point.time_from_start.nanosec
            assert seconds == pytest.approx(motion.times[index])
    with pytest.raises(OutputError, match=r"cannot write the bag .*motion.mcap: it exists"):
        motion.save(file)


def test_messages_are_plain(arm_motion):
    names = [f"fr3_joint{j}" for j in range(1, 8)]
    assert formats.joint_trajectory(arm_motion, names)["joint_names"] == names
    with pytest.raises(InvalidInputError, match="joint_names must be 7, one for each joint, got 6"):
        formats.joint_trajectory(arm_motion, names[1:])
    for message in (formats.joint_trajectory(arm_motion), formats.nav_path(arm_motion)):
        assert json.loads(json.dumps(message)) == message


def test_missing_and_unknown(arm_motion, tmp_path, monkeypatch):
    with pytest.raises(OutputError, match=r"its name must end in .csv, .json, .mcap"):
        arm_motion.save(tmp_path / "motion.bag")
    formats._rosbags.cache_clear()
    monkeypatch.setitem(sys.modules, "rosbags.rosbag2", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'legibility\[ros\]'"):
        arm_motion.save(tmp_path / "motion.mcap")
    assert not list(tmp_path.iterdir())
