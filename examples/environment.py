"""Move the robot of an environment of your own: here a cart that takes velocities."""

import gymnasium
import numpy as np

import legibility as lg


class Cart(gymnasium.Env):
    """Yours: a cart among bins that takes velocities [m/s] and observes in words of its own."""

    action_space = gymnasium.spaces.Box(-1.0, 1.0, (2,))
    observation_space = gymnasium.spaces.Dict(
        cart_xy=gymnasium.spaces.Box(0.0, 4.0, (2,)), bins_xy=gymnasium.spaces.Box(0.0, 4.0, (2, 2))
    )

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.xy, self.velocity = np.array([0.4, 2.0]), np.zeros(2)
        self.bins = np.array([[3.4, 2.4], [3.6, 1.2]]) + self.np_random.uniform(-0.2, 0.2, (2, 2))
        return {"cart_xy": self.xy, "bins_xy": self.bins}, {}

    def step(self, action):
        self.velocity = 0.2 * self.velocity + 0.8 * action
        self.xy = self.xy + 0.1 * self.velocity
        arrived = bool(np.linalg.norm(self.xy - self.bins[0]) < 0.05)
        return {"cart_xy": self.xy, "bins_xy": self.bins}, 0.0, arrived, False, {}


class LegibleCart(gymnasium.Wrapper):
    """What `legibility.envs.Environment` asks for."""

    dt, max_displacement, target = 0.1, 0.1, 0  # 1 m/s for 0.1 s
    scene = None  # before the first reset

    def reset(self, **options):
        seen, info = self.env.reset(**options)
        self.position, self.success = seen["cart_xy"], False
        self.scene = lg.Scene(
            self.position, seen["bins_xy"], [[0, 0], [4, 4]], [lg.Ball([2, 1.9], 0.3)]
        )
        return seen, info

    def step(self, displacement):
        seen, reward, arrived, truncated, info = self.env.step(displacement / self.dt)
        self.position, self.success = seen["cart_xy"], arrived
        return seen, reward, arrived, truncated, info


env = LegibleCart(Cart())
lg.envs.check(env)  # raises with a line for each thing that is missing
modulator = lg.Modulator.from_pretrained("block-reach-2d")
for level in (-1, 0, 1):
    env.reset(seed=0)
    rollout = modulator.execute(env, legibility=level)
    print(level, rollout.reason, round(rollout.achieved, 2), len(rollout.actions), rollout.contacts)
