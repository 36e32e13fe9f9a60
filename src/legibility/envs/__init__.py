"""Gymnasium environments; importing this package registers them."""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import gymnasium

from ..checks import one_of
from ..errors import InvalidInputError

if TYPE_CHECKING:
    from .block_reach import BlockReachVector
    from .own import Environment as Environment
    from .probing import check as check

MAX_EPISODE_STEPS = 400

ENVIRONMENTS = {
    "2d": "block_reach_2d:BlockReach2D",
    "panda": "panda:PandaBlockReach",
    "pandagym": "pandagym:PandaGymBlockReach",
}
"""Class of one robot by the environment's name in commands; that of a vector ends in `Vector`."""

DEFAULT_ENVIRONMENT = {2: "2d", 3: "panda"}
"""Default environment of a model, by dimension."""

for _entry in ENVIRONMENTS.values():
    gymnasium.register(
        id=f"legibility/{_entry.partition(':')[2]}-v0",
        entry_point=f"{__name__}.{_entry}",
        vector_entry_point=f"{__name__}.{_entry}Vector",
        max_episode_steps=MAX_EPISODE_STEPS,
    )


def environment_dim(name: str) -> int:
    """D of one of `ENVIRONMENTS`, without loading it.

    Raises:
        InvalidInputError: there is no such environment.
    """
    one_of("env", name, ENVIRONMENTS)
    return 2 if name == DEFAULT_ENVIRONMENT[2] else 3


def vector_type(name: str | None, dim: int) -> type[BlockReachVector]:
    """The vector class of an environment.

    Args:
        name: one of `ENVIRONMENTS`; by default that of the dimension.
        dim: D of the model or the scenes, which must be the environment's.

    Raises:
        InvalidInputError: there is no such environment, or it has another dimension.
        MissingExtraError: its simulator is not installed.
    """
    name = DEFAULT_ENVIRONMENT[dim] if name is None else name
    if (expected := environment_dim(name)) != dim:
        raise InvalidInputError(
            f"the environment {name} is {expected}-D, the model or scene {dim}-D"
        )
    module, _, single = ENVIRONMENTS[name].partition(":")
    return getattr(importlib.import_module(f".{module}", __name__), f"{single}Vector")


def check_render_mode(mode: Any, modes: Sequence[str]) -> None:
    """Raise unless `mode` is None or one of `modes`."""
    if mode is not None:
        one_of("render_mode", mode, modes)


def __getattr__(name: str) -> Any:
    rooms = {"Environment": ".own", "check": ".probing"}  # loaded on first use
    if name in rooms:
        return getattr(importlib.import_module(rooms[name], __name__), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
