"""What the tests of several environments share."""

import numpy as np
import pytest

from legibility.envs.guard import safe_actions


def equal(first, second):
    """Whether two observations, infos, or tuples of them are the same to the bit."""
    if isinstance(first, dict):
        return first.keys() == second.keys() and all(equal(first[k], second[k]) for k in first)
    if isinstance(first, tuple):
        return len(first) == len(second) and all(map(equal, first, second))
    return np.array_equal(first, second)


def row(values, index):
    """One environment of what a vector returned."""
    if isinstance(values, tuple):
        return tuple(row(value, index) for value in values)
    if isinstance(values, dict):
        return {name: value[index] for name, value in values.items()}
    return values[index]


def safe(env, actions):
    return safe_actions(
        actions, env.positions, env.velocities, env.workspace, env.max_displacement,
        env.lag_range[1], env.barriers,
    )  # fmt: skip


def toward(env):
    targets = np.stack([s.goals[t] for s, t in zip(env.scenes, env.targets, strict=True)])
    return safe(env, 1.2 * (targets - env.positions))


def played(env, seed, steps=15, options=None):
    """All that an episode shows."""
    results = [env.reset(seed=seed, options=options)]
    return tuple(results + [env.step(toward(env)) for _ in range(steps)])


class FakeWindow:
    def __init__(self, image, interval):
        assert interval == pytest.approx(0.04)

    def show(self, image):
        assert image.shape == (480, 480, 3)

    def close(self): ...
