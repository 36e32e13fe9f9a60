"""Random rooms with obstacles of every kind."""

import numpy as np

from legibility.errors import InvalidSceneError
from legibility.obstacles import Ball, Box, Polygon
from legibility.scene import Scene

_START, _GOALS = [-0.2, -0.2, 0.25], [[0.0, 0.15, 0.06], [0.0, -0.1, 0.06]]
BESIDE = Scene(_START, _GOALS, obstacles=[Ball([-0.1, -0.02, 0.24], 0.04)])
"""A ball in the way of the Panda's hand, not of its grasp point."""
OVER = Scene(_START, _GOALS, obstacles=[Ball([0.0, 0.15, 0.2], 0.04)])
"""A ball over the target, in the way of the Panda's hand there."""


def obstacle(rng, dim=2, size=0.15):
    """A random obstacle of the default workspace."""
    low, high = np.array([[0, 0], [1, 1]] if dim == 2 else [[-0.3, -0.3, 0.02], [0.1, 0.3, 0.4]])
    center, kind = rng.uniform(low, high), rng.integers(dim)
    if kind == 0 or (dim == 3 and kind == 2):
        return Ball(center, rng.uniform(0.2, 1) * size)
    if (kind == 1 and rng.random() < 0.5) or dim == 3:
        return Box(center, rng.uniform(0.2, 2, dim) * size, rng.uniform(0, 3))
    corners = np.linspace(0, 2 * np.pi, rng.integers(3, 8), endpoint=False) + rng.uniform(0, 3)
    return Polygon(center + size * np.stack([np.cos(corners), np.sin(corners)], axis=-1))


def room(rng, num_obstacles, dim=2, clearance=0.0, goal_radius=0.03, size=0.15):
    """A random scene with obstacles off its start and target 0."""
    while True:
        empty = Scene.random(rng, dim=dim)
        obstacles = [obstacle(rng, dim, size) for _ in range(num_obstacles)]
        try:
            scene = Scene(
                empty.start, empty.goals, None, obstacles, goal_radius, clearance
            )  # fmt: skip
            scene.check_target(0)
        except InvalidSceneError:
            continue
        return scene
