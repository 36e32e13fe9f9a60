"""Files and messages of timed motions: CSV, JSON, and the messages of ROS 2 in an MCAP bag."""

from __future__ import annotations

import csv
import functools
import io
import os
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..checks import Array
from ..errors import InvalidInputError, MissingExtraError, OutputError
from ..files import at_home, atomic_path, write_bytes, write_json
from .simulator import quaternion

if TYPE_CHECKING:
    from ..motion.timed import Motion

SUFFIXES = (".csv", ".json", ".mcap")

TOPICS = {"/joint_trajectory": "trajectory_msgs/msg/JointTrajectory", "/path": "nav_msgs/msg/Path"}
"""Those of a bag: the first where there is an arm."""

_AXES = "xyz"


def check(file: str | Path) -> None:
    """Raise before any work is done if a motion cannot be saved to `file`.

    Raises:
        OutputError: its suffix is of no known format, or it is a bag that exists.
        MissingExtraError: rosbags is not installed.
    """
    path = at_home(file)
    if path.suffix.lower() not in SUFFIXES:
        raise OutputError(
            f"cannot write the motion {file}: its name must end in {', '.join(SUFFIXES)}"
        )
    if path.suffix.lower() == ".mcap":
        if os.path.lexists(path):
            raise OutputError(f"cannot write the bag {file}: it exists already")
        _rosbags()


def save(motion: Motion, file: str | Path) -> None:
    """See `Motion.save`."""
    check(file)
    suffix = at_home(file).suffix.lower()
    if suffix == ".json":
        write_json(file, _document(motion))
    elif suffix == ".csv":
        write_bytes(file, _table(motion).encode())
    else:
        _save_bag(motion, file)


def joint_trajectory(motion: Motion, joint_names: Sequence[str] | None = None) -> dict[str, Any]:
    """A `trajectory_msgs/JointTrajectory` as plain lists and numbers.

    `rosidl_runtime_py.set_message_fields` takes it. There are no points without an arm.

    Args:
        motion: a timed motion.
        joint_names: of the robot's own description, such as `fr3_joint1`; the model's if not given.

    Raises:
        InvalidInputError: there is another number of names than of joints.
    """
    names = [] if motion.arm is None else motion.arm.joint_names
    if joint_names is not None:
        if len(joint_names) != len(names):
            raise InvalidInputError(
                f"joint_names must be {len(names)}, one for each joint, got {len(joint_names)}"
            )
        names = list(joint_names)
    rows = zip(
        motion.times, motion.joint_positions, motion.joint_velocities, motion.joint_accelerations,
        strict=False,
    )  # fmt: skip
    points = [
        {
            "positions": q.tolist(), "velocities": dq.tolist(), "accelerations": ddq.tolist(),
            "effort": [], "time_from_start": _stamp(t),
        }
        for t, q, dq, ddq in rows
    ]  # fmt: skip
    return {"header": _header(motion, 0.0), "joint_names": names, "points": points}


def nav_path(motion: Motion) -> dict[str, Any]:
    """A `nav_msgs/Path` as plain lists and numbers; the gripper's lean is left out."""
    w, x, y, z = _orientation(motion).tolist()
    poses = [
        {
            "header": _header(motion, t),
            "pose": {
                "position": dict(zip(_AXES, [*place.tolist(), 0.0][:3], strict=True)),
                "orientation": {"x": x, "y": y, "z": z, "w": w},
            },
        }
        for t, place in zip(motion.times, motion.positions, strict=True)
    ]
    return {"header": _header(motion, 0.0), "poses": poses}


def _header(motion: Motion, time: float) -> dict[str, Any]:
    frame = "world" if motion.arm is None or motion.frame == "world" else motion.arm.base_name
    return {"stamp": _stamp(time), "frame_id": frame}


def _stamp(time: float) -> dict[str, int]:
    nanoseconds = round(1e9 * float(time))
    return {"sec": nanoseconds // 10**9, "nanosec": nanoseconds % 10**9}


def _orientation(motion: Motion) -> Array:
    """That of the gripper in the motion's frame, `(4,)` (w, x, y, z)."""
    if motion.arm is None:
        return np.array([1.0, 0.0, 0.0, 0.0])
    gripper = motion.arm.gripper_to_world
    return quaternion(gripper if motion.frame == "world" else motion.arm.base_to_world.T @ gripper)


def _document(motion: Motion) -> dict[str, Any]:
    path = motion.path
    arm = motion.arm
    return {
        "legibility": float(path.legibility),
        "target": path.target,
        "frame": motion.frame,
        "arm": None if arm is None else arm.name,
        "joint_names": [] if arm is None else arm.joint_names,
        **{name: getattr(motion, name).tolist() for name in _ARRAYS},
    }


_ARRAYS = (
    "times", "positions", "velocities", "accelerations", "joint_positions", "joint_velocities",
    "joint_accelerations",
)  # fmt: skip


def _table(motion: Motion) -> str:
    """CSV: `time`, `x`, …, `vx`, …, `ax`, … and, of each joint, `q_NAME`, `dq_NAME`, `ddq_NAME`."""
    axes = _AXES[: motion.positions.shape[1]]
    heads = ["time", *(f"{kind}{axis}" for kind in ("", "v", "a") for axis in axes)]
    columns = [motion.times[:, None], motion.positions, motion.velocities, motion.accelerations]
    if motion.arm is not None:
        heads += [f"{kind}_{n}" for kind in ("q", "dq", "ddq") for n in motion.arm.joint_names]
        columns += [motion.joint_positions, motion.joint_velocities, motion.joint_accelerations]
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(heads)
    writer.writerows(
        [repr(value) for value in row.tolist()] for row in np.concatenate(columns, axis=1)
    )
    return text.getvalue()


def _save_bag(motion: Motion, file: str | Path) -> None:
    writer, storage, store = _rosbags()
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder) / "motion"
        with writer(bag, version=9, storage_plugin=storage.MCAP) as open_bag:
            for topic, make in zip(TOPICS, (joint_trajectory, nav_path), strict=True):
                if motion.arm is None and make is joint_trajectory:
                    continue
                kind = TOPICS[topic]
                connection = open_bag.add_connection(topic, kind, typestore=store)
                message = _message(store, kind, make(motion))
                open_bag.write(connection, 0, store.serialize_cdr(message, kind))
        with atomic_path(file) as temporary:
            temporary.write_bytes((bag / "motion.mcap").read_bytes())


def _message(store: Any, kind: str, content: dict[str, Any]) -> Any:
    """The message of a type from plain lists and numbers."""
    values = {}
    for name, (node, detail) in store.fielddefs[kind][1]:
        value = content[name]
        if node == 2:  # another message
            value = _message(store, detail, value)
        elif node in (3, 4) and detail[0][0] == 2:  # an array or a list of messages
            value = [_message(store, detail[0][1], item) for item in value]
        elif node in (3, 4) and detail[0][1][0] == "float64":
            value = np.array(value, dtype=np.float64)
        values[name] = value
    return store.types[kind](**values)


@functools.cache
def _rosbags() -> tuple[Any, Any, Any]:
    """The writer, its storages, and the messages of ROS 2 Jazzy."""
    try:
        from rosbags.rosbag2 import StoragePlugin, Writer
        from rosbags.typesys import Stores, get_typestore
    except ModuleNotFoundError as cause:
        raise MissingExtraError(
            f"{cause.name} is not installed, which writes bags: pip install 'legibility[ros]'"
        ) from cause
    return Writer, StoragePlugin, get_typestore(Stores.ROS2_JAZZY)
