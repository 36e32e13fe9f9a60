"""The block reaching task in panda-gym, the paper's simulator: a Franka Panda in PyBullet."""

from __future__ import annotations

import atexit
import contextlib
import ctypes
import functools
import os
import sys
import weakref
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageColor

from ..checks import Array
from ..errors import InvalidInputError, MissingExtraError
from .arm import BASE, BLOCK, HOME, JOINT_LIMITS, VELOCITY_LIMITS, ArmVector
from .block_reach import BlockReach
from .colors import GOALS

__all__ = ["PandaGymBlockReach", "PandaGymBlockReachVector"]

_ARM, _FINGERS = list(range(7)), [9, 10]
_DOWN = np.array([1.0, 0.0, 0.0, 0.0])
"""The gripper's orientation as a quaternion (x, y, z, w)."""

_IK_STEPS = 100
"""Most steps of PyBullet's inverse kinematics. With panda-gym's 20 the solution is 3 mm off for a
displacement of 2 cm, and by all of it where the arm is almost straight."""

# PyBullet's motor aims at the speed gain × error / time step, which is highest at first.
_GAIN, _TIME_STEP = 0.1, 1 / 500
_SPEED_SHARE = 0.95
"""Of the velocity limits: a motor that would exceed it gets a lower gain."""

_BOUNDS = JOINT_LIMITS + np.array([[0.01], [-0.01]])
_BOUNDS[1, 3] = -0.46
"""Angles that the joints are sent to, `(2, 7)` [rad]. The arm is straight with joint 4 at −0.47;
beyond, the elbow would turn over."""

_LEVERS = 3e-3, 1e-5
"""How far [m] off a radian counts of the gripper's tilt, and of a joint from `HOME`, where the arm
is placed. In the far upper corners the gripper tilts a little, so that it is in its place."""
_MOST_STEPS, _TOLERANCE = 100, 1e-5

_SIZE, _SHARPNESS = 480, 2
"""Pixels of a picture, and how many times as many are drawn."""
_CAMERA = [0.95, -0.75, 0.75], [-0.22, 0.02, 0.24]
"""Where the camera is and what it looks at [m]."""
_ANGLE_OF_VIEW = 43.0
_LIGHT = [1.2, -2.0, 9.0]
_TABLE, _FLOOR, _SUPPORT = "#e8e6e1", "#c9ccd1", "#b9b9b9"
_AWAY = np.array([0.0, 0.0, -5.0])

# Links that are not neighbours and that the workspace lets come near each other: the forearm, the
# wrist and the hand with the base, the shoulder and the upper arm. −1 is the base.
_PAIRS = [
    *((a, b) for a in (4, 5) for b in (-1, 0, 1)),
    *((a, b) for a in (6, 8, 9, 10) for b in (-1, 0, 1, 2, 3)),
    (8, 4), (9, 4), (10, 4),
]  # fmt: skip


class PandaGymBlockReachVector(ArmVector):
    """Many `PandaGymBlockReach` at once, a PyBullet world each.

    Worlds are kept when an environment is closed or forgotten, for the next one of the process.
    """

    at_once = 16

    def __init__(self, num_envs: int = 1, **settings: Any) -> None:
        self._worlds: list[_World] = []
        self._give_back = weakref.finalize(self, _recycle, self._worlds)
        super().__init__(num_envs, **settings)
        for _ in range(num_envs):
            self._worlds.append(_IDLE.pop() if _IDLE else _World())

    @property
    def joint_angles(self) -> Array:
        """`(B, 7)` [rad]."""
        return np.array([world.joints() for world in self._worlds])

    def _draw_robot(self, rng: np.random.Generator, options: Mapping[str, Any]) -> dict[str, Any]:
        rng.random(2)  # as many as the arm on MuJoCo draws: the same seed draws the same scene
        return {}

    def _begin(self, index: int, robot: dict[str, Any]) -> None: ...

    def _place(self, index: int, position: Array) -> Array:
        return self._worlds[index].place(position)

    def _drive(self, indices: NDArray[Any], targets: Array) -> Array:
        positions = np.empty_like(targets)
        for row, index in enumerate(indices.tolist()):
            positions[row], counted = self._worlds[index].drive(targets[row], self.substeps)
            for name, number in zip(self.counted, counted, strict=True):
                self.counts[name][index] += number
        return positions

    def _picture(self, index: int) -> NDArray[np.uint8]:
        return _stage().picture(self._worlds[index].joints(), self.scenes[index].goals)

    def close_extras(self, **_: Any) -> None:
        """Let other environments have the worlds."""
        self._give_back()

    def __reduce_ex__(self, protocol: Any) -> Any:
        raise InvalidInputError(
            "an environment in PyBullet cannot be copied; reset another one with the same seed"
        )


class _World:
    """A PyBullet world with panda-gym's plane, table and arm, and nothing else.

    Blocks are ghosts, which no body feels: only the picture shows them.
    """

    def __init__(self, visible: bool = False) -> None:
        pybullet, panda = _import()
        with _silence():
            self.sim = pybullet(n_substeps=ArmVector.substeps)
            if not visible:  # the looks of an arm take 90 MB
                flags = self.sim.physics_client.URDF_IGNORE_VISUAL_SHAPES
                self.sim.loadURDF = functools.partial(self.sim.loadURDF, flags=flags)
            self.sim.create_plane(z_offset=-0.4)
            self.sim.create_table(length=1.1, width=0.7, height=0.4, x_offset=-0.3)
            self.arm = panda(
                self.sim, block_gripper=True, base_position=BASE.copy(), control_type="ee"
            )
        # PyBullet may be gone before its clients are, who then complain.
        atexit.register(self.sim.close)
        self.client = self.sim.physics_client
        self.body = self.sim._bodies_idx["panda"]
        self.table = self.sim._bodies_idx["table"]
        self.set_joints(HOME)
        self._fresh = self.client.saveState()

    def joints(self) -> Array:
        """Angles `(7,)` [rad]."""
        return np.array([state[0] for state in self.client.getJointStates(self.body, _ARM)])

    def set_joints(self, angles: Array) -> None:
        """The arm is at rest at `angles (7,)` [rad], the gripper closed."""
        for joint, angle in zip([*_ARM, *_FINGERS], [*angles, 0.0, 0.0], strict=True):
            self.client.resetJointState(self.body, joint, angle, 0.0)

    def place(self, position: Array) -> Array:
        """Be at rest at `position (3,)` [m], whatever was before; where that is."""
        self.client.restoreState(self._fresh)
        angles: Array = HOME
        damping = 1e-2
        error = self._error(angles, position)
        for _ in range(_MOST_STEPS):  # Levenberg and Marquardt
            jacobian = self._jacobian(angles)
            normal = jacobian.T @ jacobian + damping**2 * np.eye(7)
            step = np.linalg.solve(normal, jacobian.T @ error)
            tried: Array = angles + step * min(1.0, 0.3 / np.abs(step).max())
            found = self._error(tried, position)
            if found @ found < error @ error:
                angles, error, damping = tried, found, damping / 4
                if np.abs(step).max() < _TOLERANCE:
                    break
            else:
                damping *= 8
        self.set_joints(angles)
        self._hold(angles)
        return self._position()

    def drive(self, target: Array, substeps: int) -> tuple[Array, list[int]]:
        """Go toward `target (3,)` [m] for a control step.

        Returns:
            Where that ends `(3,)` [m], and the physics steps with a contact with the table, links
            in each other (looked for at the end of the control step only), a joint beyond its
            limits and a joint too fast.
        """
        client, body, table = self.client, self.body, self.table
        angles = self.joints()
        solution = client.calculateInverseKinematics(
            body, self.arm.ee_link, target, _DOWN, maxNumIterations=_IK_STEPS
        )
        wanted = np.clip(solution[:7], *_BOUNDS)
        fastest = (np.abs(wanted - angles) / VELOCITY_LIMITS).max() / _TIME_STEP
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
        fast = (np.abs(speed) > VELOCITY_LIMITS).any(-1)
        return self._position(), [contacts, int(collided), int(beyond.sum()), int(fast.sum())]

    def _hold(self, angles: Array, gain: float = _GAIN) -> None:
        """The motors go to `angles (7,)` [rad] from now on, the fingers stay closed."""
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
        """What is missing at `angles (7,)` [rad] to `position (3,)` [m], to the gripper down and to
        `HOME`: `(13,)` [m], see `_LEVERS` for turns.
        """
        self.set_joints(angles)
        state = self.client.getLinkState(self.body, self.arm.ee_link, computeForwardKinematics=1)
        x, y, z, w = state[1]
        # _DOWN times the inverse of the orientation; twice its vector part for small angles.
        turn = 2 * np.sign(x) * np.array([w, z, -y])
        gripper, posture = _LEVERS
        return np.concatenate([position - state[0], gripper * turn, posture * (HOME - angles)])

    def _jacobian(self, angles: Array) -> Array:
        """How `_error` shrinks with the joints' angles, `(13, 7)`."""
        still, (gripper, posture) = [0.0] * 9, _LEVERS
        linear, angular = self.client.calculateJacobian(
            self.body, self.arm.ee_link, still[:3], [*angles, 0.0, 0.0], still, still
        )
        turns = gripper * np.array(angular)[:, :7]
        return np.concatenate([np.array(linear)[:, :7], turns, posture * np.eye(7)])


class _Stage(_World):
    """A world that is only looked at, so that looking changes nothing in the others."""

    def __init__(self) -> None:
        super().__init__(visible=True)
        self._blocks: dict[str, list[int]] = {}
        client = self.client
        for body, color in ((self.table, _TABLE), (self.sim._bodies_idx["plane"], _FLOOR)):
            client.changeVisualShape(body, -1, rgbaColor=_rgba(color))
        self._view = client.computeViewMatrix(*_CAMERA, [0, 0, 1])
        self._projection = client.computeProjectionMatrixFOV(_ANGLE_OF_VIEW, 1.0, 0.1, 10.0)

    def picture(self, angles: Array, goals: Array) -> NDArray[np.uint8]:
        """The arm at `angles (7,)` [rad] among the blocks at `goals (G, 3)` [m], `(H, W, 3)`."""
        self.set_joints(angles)
        used: dict[str, int] = {}
        for index, goal in enumerate(goals):
            self._show(GOALS[index % len(GOALS)], goal, used)
            for below in np.arange(goal[2] - BLOCK, BLOCK / 4, -BLOCK):
                self._show(_SUPPORT, np.array([*goal[:2], below]), used)
        for color, bodies in self._blocks.items():
            for body in bodies[used.get(color, 0) :]:
                self._put(body, _AWAY)
        size = _SHARPNESS * _SIZE
        rgba = self.client.getCameraImage(
            size,
            size,
            self._view,
            self._projection,
            lightDirection=_LIGHT,
            lightColor=[1, 1, 1],
            lightDistance=10,
            lightAmbientCoeff=0.6,
            lightDiffuseCoeff=0.38,
            lightSpecularCoeff=0.05,
            shadow=1,
            flags=self.client.ER_NO_SEGMENTATION_MASK,
            renderer=self.client.ER_TINY_RENDERER,
        )[2]
        image = np.reshape(np.asarray(rgba, dtype=np.uint8), (size, size, 4))[..., :3]
        return np.array(Image.fromarray(image).reduce(_SHARPNESS))

    def _show(self, color: str, position: Array, used: dict[str, int]) -> None:
        """Put one more block of `color` at `position (3,)` [m]."""
        bodies, number = self._blocks.setdefault(color, []), used.get(color, 0)
        used[color] = number + 1
        if number == len(bodies):
            name = f"{color} {number}"
            self.sim.create_box(
                name, np.full(3, BLOCK / 2), 0.0, position, np.array(_rgba(color)), ghost=True
            )
            bodies.append(self.sim._bodies_idx[name])
        self._put(bodies[number], position)

    def _put(self, body: int, position: Array) -> None:
        self.client.resetBasePositionAndOrientation(body, position, [0.0, 0.0, 0.0, 1.0])


@functools.cache
def _stage() -> _Stage:
    return _Stage()


def _rgba(color: str) -> list[float]:
    return [part / 255 for part in (*ImageColor.getrgb(color), 255)]


_IDLE: list[_World] = []
"""Worlds that no environment uses now."""


def _recycle(worlds: list[_World]) -> None:
    _IDLE.extend(worlds)
    worlds.clear()


def _import() -> tuple[Any, Any]:
    """panda-gym's simulation and its robot."""
    try:
        with _silence():  # pybullet tells when it was built
            from panda_gym.envs.robots.panda import Panda
            from panda_gym.pybullet import PyBullet
    except ImportError as cause:
        hint = ""
        if sys.version_info >= (3, 12):
            version = ".".join(map(str, sys.version_info[:2]))
            hint = f"; its pybullet has wheels up to Python 3.11 only, this is {version}"
        raise MissingExtraError(
            f"panda-gym cannot be loaded ({cause}): pip install 'legibility[pandagym]'{hint}"
        ) from cause
    return PyBullet, Panda


@contextlib.contextmanager
def _silence() -> Iterator[None]:
    """What C code prints goes nowhere."""
    for stream in filter(None, (sys.stdout, sys.stderr)):
        stream.flush()
    flush = ctypes.CDLL(None).fflush if os.name == "posix" else lambda _: None
    flush(None)
    with contextlib.ExitStack() as stack:
        with contextlib.suppress(OSError), open(os.devnull, "w") as nowhere:
            for number in (1, 2):
                copy = os.dup(number)  # fails where there is none
                stack.callback(os.close, copy)
                stack.callback(os.dup2, copy, number)
                os.dup2(nowhere.fileno(), number)
        stack.callback(flush, None)
        yield


class PandaGymBlockReach(BlockReach):
    """A Franka Panda moves its gripper to one of several coloured blocks; simulated by panda-gym.

    ## Description
    The paper's simulator: the arm, table and physics of panda-gym (PyBullet), the arm standing at
    x = −0.6 on a table whose top is z = 0. The position is that of the grasp point between the
    fingertips, and the gripper points down, closed. Blocks are markers of 4 cm without contact, so
    that the grasp point can reach their centre; what holds up a higher one is drawn grey, and the
    picture does not mark the target. The
    interface is that of `PandaBlockReach`, its twin in MuJoCo.

    ## Action Space
    `Box(-0.02, 0.02, (3,), float64)`: a commanded displacement [m] for one control step (0.04 s,
    20 steps of the physics). As in panda-gym, PyBullet's inverse kinematics makes joint angles of
    the position that is meant and its position motors go there; unlike there, all motors get the
    same lower gain where a joint would exceed its velocity limit. Of a command 45 to 85 % is
    realised, the less the larger it is.

    ## Observation Space
    A `Dict`:

    * `position`: `Box((3,))` [m], the grasp point. It may be beyond the workspace by a few
      millimetres, and where the arm is stretched, near (0.1, ±0.3, 0.4), by 2 cm.
    * `goals`: `Box((6, 3))` [m], the centres of the blocks; rows beyond their number are 0.
    * `present`: `MultiBinary(6)`, which rows are blocks.
    * `target`: `Discrete(6)`, index of the block that is meant.

    ## Rewards
    Minus the distance to the target [m].

    ## Starting State
    A scene of `Scene.random`: 2 to 6 blocks on the table or stacked, the start anywhere. The arm is
    at rest, in a posture that depends on the start alone.

    ## Episode End
    * Termination: success. The grasp point is within 0.02 m of the target's centre and moved by at
      most 4 mm in this step. The step of a push or a shift is no success yet.
    * Truncation: 400 steps.

    `info` has `is_success`, `distance` [m], `speed` [m/s], `wall_contact` (the command would have
    led out of the workspace and was cut off at its wall), `disturbed` (a push or a shift in this
    step) and, counted since the episode's start, the physics steps with

    * `table_contacts`: the arm presses on the table;
    * `self_collisions`: the hull of the forearm, wrist or hand is in that of another link that is
      no neighbour; looked for once a control step, at its end;
    * `joint_limit_violations`, `velocity_limit_violations`: a measured joint angle or speed is
      beyond Franka's limits.

    ## Arguments
    `reset(seed=…, options={…})` takes

    * `scene`: a `Scene` in the default workspace; drawn if not given.
    * `target`: index of the intended goal; 0 if not given.
    * `num_goals`: of a scene that is drawn; 2 to 6 if not given.
    * `noise`: standard deviation [m] of each step's displacement; 0 if not given.
    * `push`: once half the straight line's length is travelled, the arm is displaced by so much [m]
      in a random direction, at most to the wall; 0 if not given.
    * `shift`: the same of the target block; it stays if another is in its place.
    """

    batch_type = PandaGymBlockReachVector
