"""The check of an environment of your own: its robot is moved a few steps along each axis."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import Any

import numpy as np

from ..checks import Array, random_seed, short
from ..errors import InvalidInputError, LegibilityError
from .own import OwnFleet, constants_of, missing_of, outside, state_of

_PROBES = 3  # steps of a motion that `check` tries
_SHARES = (0.5, 1.0)  # of the largest displacement, that it tries
_JUMP, _FAR = 2.0, 5.0  # in displacements: of a first step, and from a target that is not reached
_REALISED = 0.1, 1.1  # share of a displacement that a step must realise
_CLIPPED = 0.8  # share of the whole action over that of half of it
_ASIDE, _SPARE = 0.25, 0.05  # of a displacement: sideways, and of the noise of a stop


def check(env: Any, seed: int = 0) -> None:
    """Raise unless a robot can be moved in an environment of your own, see `Environment`.

    What it has is read. It is reset with `seed` and moved a few steps along each axis and stopped,
    to see that an action is a displacement in metres and that the robot stops in time; noise of
    more than a tenth of such a step can be reported as a fault. It is left freshly reset.

    Raises:
        InvalidInputError: something is missing or wrong; a line for each, by name.
    """
    if problems := _problems(env, random_seed("seed", seed)):
        raise InvalidInputError("\n".join([f"{env} cannot be moved yet:", *problems]))
    env.reset(seed=seed)


def _problems(env: Any, seed: int) -> list[str]:
    """A line for each fault of an environment."""
    missing = missing_of(env)
    (limit, _, _, arm), problems = constants_of(env)
    problems += missing
    if not any(line.startswith("reset ") for line in missing):
        problems += _reset_problems(env, seed, arm)
    state, wrong = state_of(env, arm)
    problems += wrong
    if state is None or problems:
        return problems
    if problem := outside(state, limit):
        problems.append(problem)
    if state.success:
        problems.append("success must be False after a reset, got True")
    return problems or _probed(env, seed, state.scene.dim)


def _reset_problems(env: Any, seed: int, arm: Any) -> list[str]:
    """What is wrong with two resets with one seed."""
    states = []
    for _ in range(2):
        try:
            result = env.reset(seed=seed)
        except Exception as cause:
            return [f"reset(seed={seed}) raises {cause!r}"]
        if not isinstance(result, tuple) or len(result) != 2:
            return [f"reset must return observation and info, got {short(result)}"]
        states.append(state_of(env, arm)[0])
    one, two = states
    if one and two and (one.scene != two.scene or not np.array_equal(one.position, two.position)):
        return [f"reset(seed={seed}) must give one scene and position, it gave others twice"]
    return []


def _probed(env: Any, seed: int, dim: int) -> list[str]:
    """What is wrong with the motions of the robot."""
    problems, realised = [], [list[float]() for _ in range(dim)]
    for axis, share in itertools.product(range(dim), _SHARES):
        try:
            env.reset(seed=seed)
            found = list(_probed_along(OwnFleet(env, seed), axis, share, realised[axis]))
        except LegibilityError as cause:
            found = [str(cause)]
        if problems and found and share == _SHARES[-1]:
            continue  # the same again
        problems += found
    return list(dict.fromkeys(problems))


def _probed_along(
    fleet: OwnFleet, axis: int, share_sent: float, realised: list[float]
) -> Iterator[str]:
    """What is wrong with a motion along an axis, toward the middle of the workspace.

    `share_sent` is that of the largest displacement; to `realised`, the shares that the robot made
    of smaller actions, that of this one is appended.
    """
    active, places = np.ones(1, dtype=bool), [fleet.positions]
    inward = fleet.workspace.mean(0)[axis] >= places[0][0, axis]
    action = np.zeros_like(places[0])
    action[0, axis] = share_sent * fleet.limit * (1 if inward else -1)
    for step in range(2 * _PROBES):
        sent = fleet.safe(action if step < _PROBES else 0 * action, places[-1], _last(places))
        if step < _PROBES and not np.array_equal(sent, action):
            return  # something is in the way
        success, *ends = fleet.step(sent, active)
        places.append(fleet.positions)
        apart = float(np.linalg.norm(fleet.goals[0] - fleet.positions[0]))
        if success[0]:
            if apart > _FAR * fleet.limit:
                yield f"success: it is True where the robot is {apart:.3g} m from its target"
            return
        if any(end[0] for end in ends):
            if step == 0:
                yield "step: it says that the episode ends after the first step of a robot"
            return
    moved = (places[_PROBES] - places[_PROBES - 1])[0]
    size = float(np.abs(action).max())
    share = float(moved[axis] / action[0, axis])
    realised.append(share)
    aside = float(np.linalg.norm(np.delete(moved, axis)))
    jump = float(np.linalg.norm(places[1] - places[0]))
    if jump > _JUMP * max(fleet.limit, float(np.linalg.norm(moved))):
        yield f"position: it jumps by {jump:.3g} m in the first step after a reset"
        return
    if not _REALISED[0] <= share <= _REALISED[1]:
        yield (
            f"step: an action of {action[0, axis]:g} m along axis {axis} moves position by "
            f"{moved[axis]:.3g} m, it must realise a share from {_REALISED[0]:g} to 1: an action "
            "is a displacement in metres, no velocity, in the axes of position; max_displacement "
            "is the largest that the robot makes"
        )
    elif share < _CLIPPED * realised[0]:
        yield (
            f"max_displacement: of an action of {size:g} m along axis {axis} the robot makes "
            f"{share:.0%}, of a smaller one {realised[0]:.0%}: it must be the largest that it makes"
        )
    elif aside > _ASIDE * size:
        yield (
            f"step: an action of {size:g} m along axis {axis} moves position sideways by "
            f"{aside:.3g} m: actions and position must have the same axes"
        )
    else:
        coast = float(np.linalg.norm(places[-1] - places[_PROBES])) - _SPARE * size
        rate = float(np.linalg.norm(moved))
        if coast > fleet.lag / (1 - fleet.lag) * rate:
            lag = coast / (coast + rate)
            remedy = (
                f"set lag to {lag:.2g}"
                if lag <= 0.5
                else "a lag above 0.5 is too much, or max_displacement is too large to stop from"
            )
            yield (
                f"lag: sent 0, the robot moves on by {coast:.3g} m after steps of {rate:.3g} m, "
                f"more than a lag of {fleet.lag:g} allows: {remedy}"
            )


def _last(places: list[Array]) -> Array:
    """The last displacement."""
    return places[-1] - places[-2] if len(places) > 1 else np.zeros_like(places[0])
