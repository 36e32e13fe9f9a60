"""The block reaching task in panda-gym, the paper's simulator: a Franka Panda in PyBullet."""

import atexit
import contextlib
import ctypes
import functools
import os
import sys
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from ..checks import Array
from ..errors import InvalidInputError, MissingExtraError
from ..robots.arm import PANDA
from .arm import ArmVector
from .single import BlockReach

JOINT_LIMITS = np.array([
    [-2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973],
    [2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973],
])  # fmt: skip
"""Least and greatest angle of each joint, `(2, 7)` [rad] (Franka's documentation)."""

_ARM, _FINGERS = list(range(7)), [9, 10]
_DOWN = np.array([1.0, 0.0, 0.0, 0.0])
"""The gripper's orientation as a quaternion (x, y, z, w)."""

_IK_STEPS = 100
"""Most iterations of PyBullet's inverse kinematics. After panda-gym's 20 the solution is 3 mm off
for a displacement of 2 cm, and useless where the arm is almost straight."""

# PyBullet's motor aims at the speed gain × error / time step, highest in the first step.
_GAIN, _TIME_STEP = 0.1, 1 / 500
_SPEED_SHARE = 0.95
"""Share of the velocity limits above which all motors get a lower gain."""

_BOUNDS = JOINT_LIMITS + np.array([[0.01], [-0.01]])
_BOUNDS[1, 3] = -0.46
"""Range of commanded angles, `(2, 7)` [rad]. The arm is straight with joint 4 at −0.47; beyond, the
elbow would turn over."""

_LEVERS = 3e-3, 1e-5
"""Cost [m] of a radian of the gripper's tilt, and of a radian between a joint and the arm's home,
when the arm is placed. In the far upper corners the gripper tilts a little to reach its place."""

# Links that are not neighbours and may meet in the workspace: the forearm, the wrist and the hand
# with the base, the shoulder and the upper arm. −1 is the base.
_PAIRS = [
    *((a, b) for a in (4, 5) for b in (-1, 0, 1)),
    *((a, b) for a in (6, 8, 9, 10) for b in (-1, 0, 1, 2, 3)),
    (8, 4), (9, 4), (10, 4),
]  # fmt: skip


class PandaGymBlockReachVector(ArmVector):
    """Many `PandaGymBlockReach`, each in its own PyBullet world.

    The worlds of a closed or collected environment serve the next one of the process.
    """

    at_once = 16

    def __init__(self, num_envs: int = 1, **settings: Any) -> None:
        self._worlds: list[_World] = []
        super().__init__(num_envs, **settings)
        for _ in range(num_envs):
            self._worlds.append(_IDLE.pop() if _IDLE else _World())

    @property
    def joint_angles(self) -> Array:
        """`(B, 7)` [rad]."""
        return np.array([world.joints() for world in self._worlds])

    def _place(self, index: int, position: Array) -> Array:
        return self._worlds[index].place(position)

    def _drive(self, indices: NDArray[Any], targets: Array) -> Array:
        positions = np.empty_like(targets)
        for row, index in enumerate(indices.tolist()):
            positions[row], counted = self._worlds[index].drive(targets[row], self.substeps)
            for name, number in zip(self.events, counted, strict=True):
                self.counts[name][index] += number
        return positions

    def _picture(self, index: int) -> NDArray[np.uint8]:
        from .panda_render import arm_image

        angles = self._worlds[index].joints()
        return arm_image(self.scenes[index], int(self.targets[index]), angles)

    def close_extras(self, **_: Any) -> None:
        """Return the worlds for reuse."""
        _IDLE.extend(self._worlds)
        self._worlds.clear()

    def __del__(self) -> None:
        self.close_extras()

    def __reduce_ex__(self, protocol: Any) -> Any:
        raise InvalidInputError(
            "an environment in PyBullet cannot be copied; reset another one with the same seed"
        )


class _World:
    """A PyBullet world with panda-gym's plane, table and arm, and nothing else."""

    def __init__(self) -> None:
        pybullet, panda = _import()
        with _silence():
            self.sim = pybullet(n_substeps=ArmVector.substeps)
            # The visual meshes of an arm take 90 MB.
            flags = self.sim.physics_client.URDF_IGNORE_VISUAL_SHAPES
            self.sim.loadURDF = functools.partial(self.sim.loadURDF, flags=flags)
            self.sim.create_plane(z_offset=-0.4)
            self.sim.create_table(length=1.1, width=0.7, height=0.4, x_offset=-0.3)
            self.arm = panda(
                self.sim, block_gripper=True, base_position=PANDA.base[:3].copy(), control_type="ee"
            )
        # A client that outlives PyBullet's module prints an error when it is collected.
        atexit.register(self.sim.close)
        self.client = self.sim.physics_client
        self.body = self.sim._bodies_idx["panda"]
        self.table = self.sim._bodies_idx["table"]
        self.set_joints(PANDA.home)
        self._fresh = self.client.saveState()

    def joints(self) -> Array:
        """Angles `(7,)` [rad]."""
        return np.array([state[0] for state in self.client.getJointStates(self.body, _ARM)])

    def set_joints(self, angles: Array) -> None:
        """Put the arm at rest at `angles (7,)` [rad], with the gripper closed."""
        for joint, angle in zip([*_ARM, *_FINGERS], [*angles, 0.0, 0.0], strict=True):
            self.client.resetJointState(self.body, joint, angle, 0.0)

    def place(self, position: Array) -> Array:
        """Put the arm at rest at `position (3,)` [m] from a fresh state; return where it is."""
        self.client.restoreState(self._fresh)
        angles = least_squares(self._error, PANDA.home, method="lm", xtol=1e-8, args=(position,)).x
        self.set_joints(angles)
        self._hold(angles)
        return self._position()

    def drive(self, target: Array, substeps: int) -> tuple[Array, list[int]]:
        """Move toward `target (3,)` [m] for one control step; return the position reached.

        Also return the number of physics steps with each event of `events`; a self-collision is
        checked at the end of the control step only.
        """
        client, body, table = self.client, self.body, self.table
        angles = self.joints()
        solution = client.calculateInverseKinematics(
            body, self.arm.ee_link, target, _DOWN, maxNumIterations=_IK_STEPS
        )
        wanted = np.clip(solution[:7], *_BOUNDS)
        fastest = (np.abs(wanted - angles) / PANDA.limits.velocity).max() / _TIME_STEP
        self._hold(wanted, min(_GAIN, _SPEED_SHARE / max(fastest, 1e-9)))
        contacts, states = 0, []
        for _ in range(substeps):
            client.stepSimulation()
            states.append([state[:2] for state in client.getJointStates(body, _ARM)])
            contacts += any(point[9] > 0 for point in client.getContactPoints(body, table))
        angle, speed = np.moveaxis(np.array(states), -1, 0)
        collided = any(client.getClosestPoints(body, body, 0.0, a, b) for a, b in _PAIRS)
        low, high = JOINT_LIMITS
        beyond = ((angle < low) | (angle > high)).any(-1)
        fast = (np.abs(speed) > PANDA.limits.velocity).any(-1)
        return self._position(), [contacts, int(collided), int(beyond.sum()), int(fast.sum())]

    def _hold(self, angles: Array, gain: float = _GAIN) -> None:
        """Set the motors' goal `angles (7,)` [rad]; the fingers stay closed."""
        self.client.setJointMotorControlArray(
            self.body,
            [*_ARM, *_FINGERS],
            self.client.POSITION_CONTROL,
            targetPositions=[*angles, 0.0, 0.0],
            forces=self.arm.joint_forces,
            positionGains=[*[gain] * 7, _GAIN, _GAIN],
        )

    def _position(self) -> Array:
        return np.array(self.client.getLinkState(self.body, self.arm.ee_link)[0])

    def _error(self, angles: Array, position: Array) -> Array:
        """Distance of the arm at `angles (7,)` [rad] to `position (3,)` [m], to a gripper that
        points down and to the home: `(13,)` [m]; see `_LEVERS` for angles.
        """
        self.set_joints(angles)
        state = self.client.getLinkState(self.body, self.arm.ee_link, computeForwardKinematics=1)
        x, y, z, w = state[1]
        # The inverse of the orientation times _DOWN; twice its vector part for small angles.
        turn = 2 * np.sign(x) * np.array([w, z, -y])
        gripper, posture = _LEVERS
        apart = posture * (angles - PANDA.home)
        return np.concatenate([state[0] - position, -gripper * turn, apart])


_IDLE: list[_World] = []
"""Worlds without an environment, for reuse."""


def _import() -> tuple[Any, Any]:
    """panda-gym's simulation and its robot."""
    try:
        with _silence():  # pybullet prints its build time
            from panda_gym.envs.robots.panda import Panda
            from panda_gym.pybullet import PyBullet
    except ImportError as cause:
        raise MissingExtraError(
            f"panda-gym cannot be loaded ({cause}): pip install 'legibility[pandagym]'; "
            "its pybullet has wheels up to Python 3.11 only"
        ) from cause
    return PyBullet, Panda


@contextlib.contextmanager
def _silence() -> Iterator[None]:
    """Discard the output of C code."""
    for stream in filter(None, (sys.stdout, sys.stderr)):
        stream.flush()
    flush = ctypes.CDLL(None).fflush if os.name == "posix" else lambda _: None
    flush(None)
    with contextlib.ExitStack() as stack:
        with contextlib.suppress(OSError), open(os.devnull, "w") as nowhere:
            for number in (1, 2):
                copy = os.dup(number)  # fails where the stream is closed
                stack.callback(os.close, copy)
                stack.callback(os.dup2, copy, number)
                os.dup2(nowhere.fileno(), number)
        stack.callback(flush, None)
        yield


class PandaGymBlockReach(BlockReach):
    """A Franka Panda moves its gripper toward one of several coloured blocks, in panda-gym.

    ## Description
    The paper's simulator: the arm, table and physics of panda-gym (PyBullet). The task and the
    interface are those of `PandaBlockReach`, its twin in MuJoCo, which also draws the picture and
    finds the links in obstacles: these need the extra `panda`.

    ## Action Space
    `Box(-0.02, 0.02, (3,), float64)`: a commanded displacement [m] for one control step (0.04 s,
    20 physics steps). As in panda-gym, PyBullet's inverse kinematics converts the commanded
    position to joint angles, which its position motors approach; unlike there, all motors get the
    same lower gain where a joint would exceed its velocity limit. A control step realises 45 to
    85 % of a command, least of the largest.

    ## Observation Space
    That of `PandaBlockReach`. The position overshoots the walls by a few millimetres, and where the
    arm is stretched, near (0.1, ±0.3, 0.4), by 2 cm.

    ## Rewards
    Minus the distance to the target [m].

    ## Starting State
    As in `PandaBlockReach`: the same seed draws the same scene.

    ## Episode End
    As in `PandaBlockReach`, with the same `info`, but that `self_collisions` are checked once a
    control step, between the hulls of links that are no neighbours.

    ## Arguments
    Those of `BlockReach2D` but for `gain` and `lag`.

    ## Version History
    * v0: the first.
    """

    batch_type = PandaGymBlockReachVector
