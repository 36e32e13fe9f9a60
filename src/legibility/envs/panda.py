"""The block reaching task with a Franka Panda in MuJoCo."""

from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from ..checks import Array
from ..robots.arm import PANDA, Arm
from ..robots.kinematics import JOINT_MARGIN, Kinematics
from ..robots.simulator import import_mujoco
from .arm import ArmVector
from .single import BlockReach

_SPEED_SHARE = 0.9
"""Share of the joints' greatest speeds that the reference may use."""

_AHEAD = 0.01
"""Most that the reference may lead a joint, as time at the joint's greatest speed [s]."""

_SEGMENT = 4
"""Physics steps between two readings of the joints."""


class PandaBlockReachVector(ArmVector):
    """Many `PandaBlockReach`; `BlockReachVector` describes how they are stepped.

    All share one model. One call of MuJoCo runs the physics steps of all arms, and events are
    counted in each of these steps.
    """

    drawn = {"response": (0.012, 0.025), "delay": (0.0, 0.008)}  # noqa: RUF012

    def __init__(self, num_envs: int = 1, *, arm: Arm = PANDA, **settings: Any) -> None:
        super().__init__(num_envs, **settings)
        self.arm, self._kinematics, self._simulation = arm, Kinematics(arm), Simulation(arm)
        self._range = arm.joint_range
        states = np.zeros((4, num_envs, arm.joints))
        self._angles, self._speeds, self._command, self._reference = states

    @property
    def joint_angles(self) -> Array:
        """`(B, J)` [rad]."""
        return self._angles.copy()

    def _place(self, index: int, position: Array) -> Array:
        angles = self._kinematics.solve(position)
        self._angles[index] = self._command[index] = self._reference[index] = angles
        self._speeds[index] = 0
        return self._kinematics.grasp_point(angles)

    def _drive(self, indices: NDArray[Any], targets: Array) -> Array:
        pairs = zip(self._angles[indices], targets, strict=True)
        wanted = np.array([angles + self._kinematics.step(angles, to) for angles, to in pairs])
        wanted = np.clip(wanted, self._range[0] + JOINT_MARGIN, self._range[1] - JOINT_MARGIN)
        for first in range(0, self.substeps, _SEGMENT):
            reference = self._follow(indices, wanted, first)
            angles, speeds, touched = self._simulation.run(
                self._angles[indices], self._speeds[indices], reference[:, :-1]
            )
            self._reference[indices] = reference[:, -1]
            self._angles[indices], self._speeds[indices] = angles[:, -1], speeds[:, -1]
            beyond = ((angles < self._range[0]) | (angles > self._range[1])).any(axis=-1)
            fast = (np.abs(speeds) > self.arm.limits.velocity).any(axis=-1)
            events = touched[..., 0], touched[..., 1], beyond, fast
            for name, occurred in zip(self.events, events, strict=True):
                self.counts[name][indices] += occurred.sum(axis=1)
        self._command[indices] = wanted
        return np.array([self._kinematics.grasp_point(angles) for angles in self._angles[indices]])

    def _follow(self, indices: NDArray[Any], wanted: Array, first: int) -> Array:
        """The joints' reference in the segment that begins with physics step `first`.

        It follows the old command until the delay is over, then the new one, `wanted (N, J)`
        [rad]. It waits for joints that cannot keep up: a large lead would pull them too fast. Of
        `(N, segment + 1, J)` [rad] the last row is the state at the end of the segment.
        """
        period = 1 / self.metadata["render_fps"] / self.substeps
        time = np.arange(_SEGMENT + 1) * period
        delay = np.maximum(self.hidden["delay"][indices, None] - first * period, 0)
        angles, response = self._angles[indices], self.hidden["response"][indices, None]
        old, lead = self._command[indices], self._reference[indices] - angles
        excess = (np.abs(lead) / (_AHEAD * self.arm.limits.velocity)).max(axis=1, keepdims=True)
        start = angles + lead / np.maximum(excess, 1)
        speeds = _SPEED_SHARE * self.arm.limits.velocity
        turn = _approach(start, old, response, delay, speeds)[:, 0]
        early = _approach(start, old, response, np.minimum(time, delay), speeds)
        late = _approach(turn, wanted, response, np.maximum(time - delay, 0), speeds)
        return np.where((time < delay)[..., None], early, late)

    def _picture(self, index: int) -> NDArray[np.uint8]:
        from .panda_render import arm_image

        return arm_image(
            self.scenes[index], int(self.targets[index]), self._angles[index], arm=self.arm
        )


def _approach(start: Array, goal: Array, response: Array, time: Array, speeds: Array) -> Array:
    """Joint angles `(N, T, J)` [rad] on the way from `start` to `goal (N, J)` at `time (N, T)` [s].

    A first-order system `x' = (goal − x) / τ` with τ = `response (N, 1)` [s]; all joints slow down
    alike for the one that would exceed its greatest of `speeds (J,)` [rad/s].
    """
    fastest = np.abs(goal - start) / (speeds * response)
    excess = np.maximum(fastest.max(axis=1, keepdims=True), 1)
    steady = (excess - 1) * response  # the time at the speed limit
    left = np.where(
        time < steady,
        1 - time / (excess * response),
        np.exp(-np.maximum(time - steady, 0) / response) / excess,
    )
    return goal[:, None] + left[..., None] * (start - goal)[:, None]


class Simulation:
    """MuJoCo's physics of many arms of a kind; a call does not depend on earlier ones."""

    def __init__(self, arm: Arm) -> None:
        mujoco, self._model = import_mujoco(), arm.physics()
        self._arm = arm
        from mujoco import rollout

        self._data = mujoco.MjData(self._model)
        self._rollout: Any = rollout.Rollout(nthread=0)
        self._size = mujoco.mj_stateSize(self._model, mujoco.mjtState.mjSTATE_FULLPHYSICS)

    def __reduce__(self) -> tuple[type[Self], tuple[Arm]]:
        return type(self), (self._arm,)

    def run(self, angles: Array, speeds: Array, controls: Array) -> tuple[Array, Array, Array]:
        """Simulate `T` steps from `angles` [rad] and `speeds` [rad/s], `(B, J)` each.

        The motors' goals are `controls (B, T, J)` [rad]. Return angles and speeds after each step
        `(B, T, J)`, and whether the arm touched the table and itself before it, `(B, T, 2)`.
        """
        start = np.zeros((len(angles), self._size))
        joints = self._arm.joints
        start[:, 1 : 1 + joints], start[:, 1 + joints : 1 + 2 * joints] = angles, speeds
        states, sensors = self._rollout.rollout(self._model, self._data, start, controls)
        after = states[..., 1 : 1 + joints], states[..., 1 + joints : 1 + 2 * joints]
        return *after, sensors > 0


class PandaBlockReach(BlockReach):
    """A Franka Panda moves its gripper toward one of several coloured blocks, in MuJoCo.

    ## Description
    The arm stands on a table at x = −0.6 m. Blocks are 4 cm wide, lie on the table (z = 0) or are
    stacked higher, and have no contact: the grasp point between the fingertips can reach their
    centres. The workspace is x [−0.30, 0.10], y [−0.30, 0.30], z [0.02, 0.40], all in metres; the
    arm overshoots its walls by less than a centimetre. The gripper points down and does not turn;
    in the two upper corners farthest from the base it leans back by up to 4.7° to reach them.
    Obstacles of a scene are drawn and counted, and stop nothing either. The observer does not know
    which block is the target and infers it from the motion.

    ## Action Space
    `Box(-0.02, 0.02, (3,), float64)`: a commanded displacement of the grasp point [m] for one
    control step (0.04 s, 20 physics steps). Inverse kinematics by mink converts it to joint
    angles, kept 0.02 rad inside their limits. The joints' reference follows these as a first-order
    system of time constant τ after a delay, at 90 % of Franka's joint speeds at most, all joints
    slowed down alike; position servos with Franka's torques follow the reference. τ, uniform in
    [0.012, 0.025] s, and the delay, uniform in [0, 0.008] s, are drawn for each episode and not
    observed. A control step realises 0.63 to 0.88 of a steady command, least of the largest.

    ## Observation Space
    That of `BlockReach2D` in 3-D: `position` is the grasp point, `goals` are the blocks' centres.

    ## Rewards
    Minus the distance to the target [m].

    ## Starting State
    As in `BlockReach2D`, with blocks on the table or stacked up to z = 0.16. The arm is at rest,
    elbow up, in a posture that depends on the start alone.

    ## Episode End
    As in `BlockReach2D`: within 0.02 m of the target's centre after a step of at most 0.004 m
    (0.1 m/s), or after 400 steps.

    `info` has the entries of `BlockReach2D` (`wall_contact`: the command was clipped at a wall) and
    the number of physics steps of the episode with each of `table_contacts`, `self_collisions`,
    `joint_limit_violations` and `velocity_limit_violations` (Franka's limits), and the number of
    control steps that ended with any link in an obstacle (`obstacle_contacts`).

    ## Arguments
    `reset(seed=…, options={…})` takes `scene`, `target`, `num_goals`, `noise`, `push` (the arm is
    placed at rest) and `shift` of `BlockReach2D`, and

    * `response`, `delay`: τ [s] and the delay [s]; drawn by default.

    `gymnasium.make(…, arm=…)` takes any `legibility.Arm` that reaches the workspace instead.

    ## Version History
    * v0: the first.
    """

    batch_type = PandaBlockReachVector
