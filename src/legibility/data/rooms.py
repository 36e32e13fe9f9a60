"""Random rooms, obstacles and observers, for training and for held-out evaluations."""

from dataclasses import replace

import numpy as np

from ..checks import Array
from ..errors import InvalidSceneError
from ..intent.observer import DEFAULT_OBSERVER, Observer
from ..obstacles import Ball, Box, Obstacle, Polygon
from ..scene import Scene

_SIZES = (0.2, 6.0)  # [m], of a room's diagonal
_ASPECT = 4.0
_APART, _FROM_TARGET = 0.08, 0.2  # shares of the diagonal of the part that start and goals lie in
_RADIUS = (0.04, 0.12)  # of an obstacle, likewise
_GAP = 0.015  # least distance of an obstacle from start and goals, likewise
_NEAR = 0.6  # share of the obstacles near the straight line
_TRIES = 64


def random_room(
    rng: np.random.Generator, *, dim: int, goals: tuple[int, int], obstacles: tuple[int, int]
) -> Scene:
    """A room of any size, aspect and place, with obstacles; the target is goal 0.

    The diagonal varies over a factor of 30, the sides over 4 : 1. Start and goals lie anywhere in a
    part of the room. Half of the rooms keep motions off the other goals, and some off obstacles by
    a clearance.

    Args:
        rng: source of randomness.
        dim: 2 or 3.
        goals: least and most goals.
        obstacles: least and most obstacles.
    """
    while True:
        size = np.exp(rng.uniform(*np.log(_SIZES)))
        sides = np.exp(rng.uniform(0, np.log(_ASPECT), dim))
        sides *= size / np.linalg.norm(sides)
        low = rng.uniform(-10, 10, dim) * size
        part = 1.0 if rng.random() < 0.6 else rng.uniform(0.2, 1)
        corner = low + rng.uniform(0, 1 - part, dim) * sides
        reach = part * size
        points = _apart(rng, corner, part * sides, int(rng.integers(goals[0], goals[1] + 1)), reach)
        if points is None:
            continue
        gaps = np.linalg.norm(points[[0, 1], None] - points[2:], axis=-1)
        radius = rng.uniform(0.1, 0.7) * min(gaps.min(), 0.1 * reach) if rng.random() < 0.5 else 0.0
        margin = rng.uniform(0, 0.02) * reach if rng.random() < 0.3 else 0.0
        scene = Scene(points[0], points[1:], [low, low + sides], (), radius, margin)
        return add_obstacles(rng, scene, obstacles, reach)


def _apart(
    rng: np.random.Generator, corner: Array, sides: Array, goals: int, reach: float
) -> Array | None:
    """Start and goals `(1 + G, D)` in a box, apart from each other, or None after many tries."""
    for _ in range(_TRIES):
        points = corner + rng.random((goals + 1, len(sides))) * sides
        if len(sides) == 3 and rng.random() < 0.3:  # on a table
            points[1:, 2] = corner[2]
        gaps = np.linalg.norm(points[:, None] - points, axis=-1)
        far = gaps[0, 1] >= _FROM_TARGET * reach
        if far and gaps[np.triu_indices(goals + 1, 1)].min() >= _APART * reach:
            return points
    return None


def add_obstacles(
    rng: np.random.Generator, scene: Scene, number: tuple[int, int], reach: float | None = None
) -> Scene:
    """The scene with random obstacles off start and goals, most of them near the straight line.

    Args:
        rng: source of randomness.
        scene: the target is goal 0.
        number: least and most obstacles; fewer where there is no place.
        reach: length [m] that their sizes are a share of; the workspace's diagonal if not given.
    """
    reach = scene.diagonal if reach is None else reach
    obstacles: list[Obstacle] = list(scene.obstacles)
    keep_off = scene.clearance + _GAP * reach
    points = np.concatenate([scene.start[None], scene.goals])
    for _ in range(int(rng.integers(number[0], number[1] + 1))):
        for _ in range(_TRIES):
            obstacle = _random_obstacle(rng, scene, reach)
            if obstacle.signed_distance(points).min() >= keep_off:
                obstacles.append(obstacle)
                break
    return Scene(
        scene.start, scene.goals, scene.workspace, obstacles, scene.goal_radius, scene.clearance
    )


def _random_obstacle(rng: np.random.Generator, scene: Scene, reach: float) -> Obstacle:
    low, high = scene.workspace
    radius = rng.uniform(*_RADIUS) * reach
    if rng.random() < _NEAR:
        along = scene.start + rng.uniform(0.15, 0.85) * (scene.goals[0] - scene.start)
        centre = along + rng.normal(0, 0.06 * reach, scene.dim)
    else:
        centre = rng.uniform(low, high)
    kind = rng.random()
    if kind < 0.4:
        return Ball(centre, radius)
    if kind < 0.75 or scene.dim == 3:
        return Box(centre, 2 * radius * rng.uniform(0.35, 1.2, scene.dim), rng.uniform(0, np.pi))
    angles = np.sort(rng.uniform(0, 2 * np.pi, int(rng.integers(3, 7))))
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    try:
        return Polygon(centre + radius * circle)
    except InvalidSceneError:  # corners too near each other
        return Ball(centre, radius)


def random_observer(rng: np.random.Generator, scene: Scene, like: Observer) -> Observer:
    """Any observer with the α, detour and label of `like`.

    Either kind; σ over a factor of six and β over one of twelve about their defaults; gaussians
    with covariances up to 4 : 1 in any direction; priors neutral, uniform, between, and random.
    """
    scale = {"alpha": like.alpha, "detour": like.detour, "label": like.label}
    if rng.random() < 0.5:
        beta = 20 / scene.size * np.exp(rng.uniform(np.log(0.25), np.log(3)))
        observer = Observer(beta=float(beta), **scale)
    else:
        sigma = 0.15 * scene.size * np.exp(rng.uniform(-0.5, 0.5) * np.log(6))
        eyes, depth = None, 3.0
        if rng.random() < 0.5:
            direction = rng.normal(size=scene.dim)
            away = 3 * scene.size * direction / np.linalg.norm(direction)
            eyes = tuple((scene.goals.mean(axis=0) + away).tolist())
            depth = float(rng.uniform(1, 4))
        observer = Observer(
            kind="gaussian", sigma=float(sigma), viewpoint=eyes, depth=depth, **scale
        )
    kind = rng.random()
    if kind < 0.4:
        return observer
    if kind < 0.65:
        return replace(observer, prior="uniform")
    if kind < 0.85:  # between uniform and neutral
        log_prior = rng.random() * observer.field(scene).log_prior
    else:
        log_prior = rng.normal(size=scene.num_goals)
    weights = np.exp(np.maximum(log_prior - log_prior.max(), -100))
    return replace(observer, prior=tuple(weights.tolist()))


def default_like(like: Observer) -> Observer:
    """The default observer with the α, detour and label of `like`."""
    alpha, detour, label = like.scale
    return replace(DEFAULT_OBSERVER, alpha=alpha, detour=detour, label=label)
