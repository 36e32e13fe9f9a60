"""What verbs read from the command line beyond tyro's own types."""

from __future__ import annotations

import dataclasses
import inspect
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_type_hints

import numpy as np
from tyro.conf import Positional, arg

from ..checks import Array, legibility_levels
from ..errors import InvalidInputError
from ..scene import Scene

__all__ = [
    "MODEL",
    "MODELS",
    "Folder",
    "OptionalFloat",
    "OptionalInt",
    "OptionalText",
    "OutputFile",
    "SceneFile",
    "Where",
    "Workers",
    "flags",
    "levels",
    "made",
    "model_of",
    "span",
]

MODEL = "block-reach-2d"
"""The model that is evaluated if none is given."""

MODELS = {2: MODEL, 3: "panda-block-reach"}
"""The modulator's weights by dimension."""

SceneFile = Annotated[Positional[Path], arg(metavar="SCENE", help_behavior_hint="")]
OutputFile = Annotated[Path | None, arg(metavar="FILE", help_behavior_hint="")]
Folder = Annotated[Path | None, arg(metavar="DIR", help_behavior_hint="")]
OptionalInt = Annotated[int | None, arg(metavar="INT", help_behavior_hint="")]
OptionalFloat = Annotated[float | None, arg(metavar="FLOAT", help_behavior_hint="")]

OptionalText = Annotated[str | None, arg(metavar="STR", help_behavior_hint="")]

_OPTIONAL: dict[Any, Any] = {
    int | None: OptionalInt, float | None: OptionalFloat, str | None: OptionalText
}  # fmt: skip

Settings = TypeVar("Settings")


@dataclasses.dataclass(frozen=True)
class Workers:
    """Who does the work; what comes of it is the same for any number of workers.

    Attributes:
        workers: processes on this machine.
        cluster: address of a Dask scheduler, tcp://HOST:PORT, whose workers work instead; or local,
            a Dask cluster of --workers processes on this machine.
    """

    workers: int = 1
    cluster: OptionalText = None


@dataclasses.dataclass(frozen=True)
class Where:
    """Where a network is trained, and how exactly.

    Attributes:
        device: cpu or cuda; if not given, a GPU where there is one.
        precision: of the network's products, no (float32), bf16 or fp16; if not given, what
            `accelerate launch` was told, or no.
    """

    device: OptionalText = None
    precision: OptionalText = None


def levels(entries: Sequence[str]) -> Array:
    """Levels of legibility: each entry a number or LOW:HIGH:COUNT, which means equal steps."""
    values: list[float] = []
    for entry in entries:
        parts = entry.split(":")
        try:
            if len(parts) == 1:
                values.append(float(entry))
                continue
            low, high, steps = float(parts[0]), float(parts[1]), int(parts[2])
            if len(parts) > 3 or not 1 <= steps <= 100_000:
                raise ValueError
        except (ValueError, IndexError):
            raise InvalidInputError(
                f"legibility must be numbers or LOW:HIGH:COUNT, got {entry!r}"
            ) from None
        legibility_levels([low, high])
        values += np.round(np.linspace(low, high, steps), 12).tolist()
    if not values:
        raise InvalidInputError("legibility must be at least one number, got none")
    return legibility_levels(values) + 0.0  # −0 becomes 0


def model_of(name: str | None, scene: Scene) -> str:
    """The model that is asked for, or that of the scene's dimension."""
    return MODELS[scene.dim] if name is None else name


def span(name: str, text: str) -> tuple[int, int]:
    """A range of whole numbers: `LOW..HIGH`, or one number for both."""
    found = re.fullmatch(r"([0-9]{1,9})(?:\.\.([0-9]{1,9}))?", text.strip(), re.ASCII)
    if found is None:
        raise InvalidInputError(f"{name} must be a number or LOW..HIGH, got {text!r}")
    low, high = int(found[1]), int(found[2] or found[1])
    if low > high:
        raise InvalidInputError(f"{name} must rise from LOW to HIGH, got {text!r}")
    return low, high


def flags(settings: type, *omitted: str, **defaults: Any) -> Any:
    """The fields of a dataclass as flags, with its docstring as their help.

    Those of `omitted` are left out; `defaults` are other defaults than its own.

    The flags are not checked yet, so that what is wrong with them is told by `made` in the
    dataclass's own words. A range is a text, see `span`.
    """
    types = get_type_hints(settings)
    fields: list[Any] = []
    for field in dataclasses.fields(settings):
        if field.name in omitted:
            continue
        kind: Any = types[field.name]
        default: Any = defaults.get(field.name, field.default)
        if kind == tuple[int, int]:
            low, high = default
            kind = Annotated[str, arg(metavar="LOW..HIGH")]
            default = f"{low}..{high}"
        elif kind in _OPTIONAL:
            kind = _OPTIONAL[kind]
        fields.append((field.name, kind, dataclasses.field(default=default)))
    return dataclasses.make_dataclass(
        settings.__name__, fields, kw_only=True, namespace={"__doc__": _documentation(settings)}
    )


def _documentation(settings: type) -> str:
    """The docstring of a dataclass, with what its bases say of the fields that it inherits."""
    text = inspect.cleandoc(settings.__doc__ or "")
    for base in settings.__mro__[1:]:
        if dataclasses.is_dataclass(base):
            _, _, inherited = inspect.cleandoc(base.__doc__ or "").partition("Attributes:\n")
            text += "\n" + inherited
    return text


def made(settings: type[Settings], given: Any, **rest: Any) -> Settings:
    """The dataclass that `given`, the parsed `flags` of it, stand for."""
    types = get_type_hints(settings)
    values: dict[str, Any] = {
        name: span(name, value) if types[name] == tuple[int, int] else value
        for name, value in vars(given).items()
    }
    return settings(**values, **rest)
