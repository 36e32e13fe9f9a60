"""The settings that fix a network's shape and meaning, as `config.json` stores them."""

import dataclasses
from dataclasses import dataclass, fields
from typing import Any, Self

from ..checks import bounded, count, positive
from ..curves import NUM_WAYPOINTS
from ..errors import CheckpointError, InvalidInputError
from ..intent.observer import Observer

_RESOLUTION = {2: 32, 3: 16}


def at_most(name: str, value: Any, most: int) -> None:
    """Raise unless `value` is an integer from 1 to `most`."""
    if count(name, value) > most:
        raise InvalidInputError(f"{name} must be at most {most}, got {value}")


def _multiple_of_8(name: str, value: Any) -> None:
    if count(name, value) % 8:
        raise InvalidInputError(f"{name} must be a multiple of 8, got {value}")


@dataclass(frozen=True)
class _NetworkConfig:
    """The shared settings: the dimension, the sampler, and the form in `config.json`."""

    dim: int = 2
    channels: tuple[int, ...] = ()
    condition: int = 128
    diffusion_steps: int = 100
    sampling_steps: int = 2

    def __post_init__(self) -> None:
        if self.dim not in (2, 3):
            raise InvalidInputError(f"dim must be 2 or 3, got {self.dim!r}")
        for width in self.channels:
            _multiple_of_8("channels", width)
        count("condition", self.condition)
        at_most(
            "sampling_steps", self.sampling_steps, count("diffusion_steps", self.diffusion_steps)
        )

    def to_dict(self) -> dict[str, Any]:
        """Plain values for `config.json`."""
        content = {f.name: getattr(self, f.name) for f in fields(self)}
        if "observer" in content:
            content["observer"] = content["observer"].to_dict()
        return {**content, "channels": list(self.channels)}

    @classmethod
    def from_dict(cls, content: dict[str, Any]) -> Self:
        """The inverse of `to_dict`; keys must match exactly."""
        names = {f.name for f in fields(cls)}
        if set(content) != names:
            raise CheckpointError(
                f"settings missing or unknown: {', '.join(sorted(names ^ set(content)))}"
            )
        values = {**content, "channels": tuple(content["channels"])}
        if "observer" in names:
            values["observer"] = Observer.from_dict(content["observer"])
        return cls(**values)


BACKENDS = ("torch", "onnx")
"""What may run the networks."""


@dataclass(frozen=True)
class PathDiffuserConfig(_NetworkConfig):
    """The shape of stage 1 and the meaning of its labels.

    Attributes:
        dim: D, 2 or 3.
        observer: who watches unless told otherwise; α, detour and label are those of all observers.
        field: whether it sees the field and the obstacles' features; without it, it knows start,
            goal, workspace, ℓ and the observer's σ and β, and reads the margin at the waypoints.
        channels: of the U-Net's levels.
        condition: size of the condition.
        encoder_width: channels of the image encoder's first layer.
        resolution: height and width of the image; 0 means 32 in 2D and 16 in 3D.
        squash: deviations from the straight line, in its lengths, beyond which they are compressed
            (by asinh), so that small ones are learned as exactly as large ones.
        diffusion_steps: of the noise schedule in training.
        sampling_steps: of the deterministic sampler.
        guidance: weight w of classifier-free guidance (Ho & Salimans 2022) at ℓ = ±1:
            v̂ = v(c) + w ℓ⁴ (v(c) − v(∅)). It works at the ends alone, where samples can only err
            inwards; between them it would overshoot.
        distilled: whether it is a student, which samples with its own steps and guidance only.
        recorded: whether it learned recorded motions, whose waves are their style and no fault.
    """

    channels: tuple[int, ...] = (64, 128)
    condition: int = 192
    sampling_steps: int = 3
    observer: Observer = dataclasses.field(default_factory=Observer)
    field: bool = True
    encoder_width: int = 16
    resolution: int = 0
    squash: float = 0.1
    guidance: float = 0.3
    distilled: bool = False
    recorded: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if not isinstance(self.observer, Observer):
            raise InvalidInputError(f"observer must be a legibility.Observer, got {self.observer}")
        for name in ("field", "distilled", "recorded"):
            if not isinstance(getattr(self, name), bool):
                raise InvalidInputError(
                    f"{name} must be true or false, got {getattr(self, name)!r}"
                )
        if not self.channels or NUM_WAYPOINTS % 2 ** (len(self.channels) - 1):
            raise InvalidInputError(f"channels must be of 1 to 4 levels, got {self.channels}")
        _multiple_of_8("encoder_width", self.encoder_width)
        if count("resolution", self.resolution, low=0) == 0:
            object.__setattr__(self, "resolution", _RESOLUTION[self.dim])
        _multiple_of_8("resolution", self.resolution)
        positive("squash", self.squash)
        bounded("guidance", self.guidance, -1e3, 1e3)

    def to_dict(self) -> dict[str, Any]:
        """As of every network; `recorded` only if it is."""
        content = super().to_dict()
        return content if self.recorded else {k: v for k, v in content.items() if k != "recorded"}

    @classmethod
    def from_dict(cls, content: dict[str, Any]) -> Self:
        """The inverse of `to_dict`."""
        return super().from_dict({"recorded": False, **content})


@dataclass(frozen=True)
class ActionConfig(_NetworkConfig):
    """The shape of a policy.

    Attributes:
        dim: D, 2 or 3.
        limit: largest displacement of an action along each axis [m]; the unit of all its lengths.
        chunk: actions predicted at once; even.
        execute: how many of them are executed before the next are predicted.
        channels: of the U-Net's levels.
        condition: size of the condition.
        diffusion_steps: of the noise schedule in training.
        sampling_steps: of the deterministic sampler.
    """

    channels: tuple[int, ...] = (32, 64)
    limit: float = 0.05
    chunk: int = 8
    execute: int = 4

    def __post_init__(self) -> None:
        super().__post_init__()
        positive("limit", self.limit)
        halved = 2 ** max(0, len(self.channels) - 1)
        if not self.channels or count("chunk", self.chunk) % halved:
            raise InvalidInputError(
                f"chunk must be a multiple of {halved}, got {self.chunk} with channels "
                f"{self.channels}"
            )
        at_most("execute", self.execute, self.chunk)


@dataclass(frozen=True)
class PathPolicyConfig(ActionConfig):
    """The shape of stage 2.

    It executes one action of a chunk: a robot's response is not known well enough to send several
    open loop, and correcting the accumulated error at once makes it jerk.
    """

    execute: int = 1


@dataclass(frozen=True)
class GoalPolicyConfig(ActionConfig):
    """The shape of a baseline's policy and its guidance.

    Attributes:
        guidance: w, weight of the guidance at the start of a motion; 0 is a plain policy.
        guidance_decay: γ, by which w is multiplied after every executed chunk.
        guidance_share: a, share of the guidance that leads away from the other goals; the rest
            leads away from the unconditional prediction.
    """

    sampling_steps: int = 10
    guidance: float = 0.0
    guidance_decay: float = 1.0
    guidance_share: float = 1.0

    def __post_init__(self) -> None:
        super().__post_init__()
        bounded("guidance", self.guidance, 0)
        bounded("guidance_decay", self.guidance_decay, 0, 1)
        bounded("guidance_share", self.guidance_share, 0, 1)
