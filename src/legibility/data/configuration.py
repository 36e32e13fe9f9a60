"""Random scenes, datasets and demonstrations by settings, which fix every byte with the code."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, fields, replace
from typing import Any

import numpy as np

from ..checks import bounded, count, positive, random_seed
from ..errors import DatasetError, InvalidInputError
from ..intent.observer import Observer
from ..motion.archive import DEFAULT_CELLS, Archive, build_archive
from ..scene import Scene
from ..seeds import STREAMS, stream_seed

VALIDATION_SCENES = 128
_NOISE, _PUSH = 0.06, 2.0


@dataclass(frozen=True)
class SceneStream:
    """Random scenes by index; the target is goal 0 in each.

    Attributes:
        stream: seed stream, train, validation or evaluation; no two share a scene.
        dim: 2 or 3.
        goals: least and most goals of a scene, from 2 to 12.
        seed: of the scenes and their archives.
    """

    stream: str
    dim: int = 2
    goals: tuple[int, int] = (2, 6)
    seed: int = 0

    def __post_init__(self) -> None:
        if self.stream not in STREAMS:
            raise InvalidInputError(
                f"stream must be one of {', '.join(STREAMS)}, got {self.stream!r}"
            )
        if self.dim not in (2, 3):
            raise InvalidInputError(f"dim must be 2 or 3, got {self.dim!r}")
        random_seed("seed", self.seed)
        goals = [count("goals", n, low=2) for n in self.goals] if np.iterable(self.goals) else []
        if len(goals) != 2 or not goals[0] <= goals[1] <= 12:
            raise InvalidInputError(
                f"goals must be two integers from 2 to 12, rising, got {self.goals}"
            )

    def scene(self, index: int) -> Scene:
        """Scene `index`."""
        rng = np.random.default_rng(stream_seed(self.stream, self.seed, index, "scene"))
        num_goals = int(rng.integers(self.goals[0], self.goals[1] + 1))
        return Scene.random(rng, dim=self.dim, num_goals=num_goals)

    def archive(self, index: int, observer: Observer, cells: int | None = None) -> Archive:
        """The archive of scene `index` for an observer."""
        seed = stream_seed(self.stream, self.seed, index, "archive")
        return build_archive(self.scene(index), observer=observer, seed=seed, cells=cells)


@dataclass(frozen=True)
class DatasetConfig(SceneStream):
    """The settings of a dataset.

    Attributes:
        scenes: number of random scenes.
        per_scene: trajectories chosen from each archive, at equal steps of ℓ.
        efficiency: among trajectories of nearly the same ℓ, one that is longer than the shortest by
            |ℓ| times this share of the straight line is chosen e times less often; so ℓ = 0 is the
            straight line, and no level takes a needless detour.
        cells: the archive's cells along each axis; 0 means the default of the dimension.
        observer: the observer of the scores and labels.
    """

    stream: str = "train"
    scenes: int = 1000
    per_scene: int = 129
    efficiency: float = 0.1
    cells: int = 0
    observer: Observer = field(default_factory=Observer)

    def __post_init__(self) -> None:
        super().__post_init__()
        count("scenes", self.scenes)
        count("per_scene", self.per_scene, low=3)
        if self.stream == "evaluation":
            raise InvalidInputError(
                "stream must be train or validation, the scenes of evaluation are for evaluations"
            )
        object.__setattr__(self, "goals", tuple(self.goals))
        if not isinstance(self.observer, Observer):
            raise InvalidInputError(
                f"observer must be a legibility.Observer, got {self.observer!r}"
            )
        object.__setattr__(self, "observer", self.observer.resolved(self.dim))
        if count("cells", self.cells, low=0) == 0:
            object.__setattr__(self, "cells", DEFAULT_CELLS[self.dim])
        count("cells", self.cells, low=2)
        positive("efficiency", self.efficiency)

    def to_dict(self) -> dict[str, Any]:
        """Plain values for the manifest."""
        return {**asdict(self), "goals": list(self.goals)}

    @classmethod
    def from_dict(cls, content: dict[str, Any]) -> DatasetConfig:
        """The inverse of `to_dict`; keys must match exactly."""
        if strange := set(content) ^ {f.name for f in fields(cls)}:
            raise DatasetError(f"dataset settings missing or unknown: {sorted(strange)}")
        try:
            return cls(**{**content, "observer": Observer(**content["observer"])})
        except (TypeError, InvalidInputError) as cause:
            raise DatasetError(f"observer or goals of a dataset are not ours: {cause}") from cause

    def for_validation(self) -> DatasetConfig:
        """The same settings for 128 scenes of the validation stream."""
        return replace(self, stream="validation", scenes=VALIDATION_SCENES)


@dataclass(frozen=True)
class DemonstrationsConfig:
    """The settings of demonstrations.

    Attributes:
        demonstrations: number in each scene; 0 makes none.
        demonstrated: number of scenes, the first ones of the dataset; 0 means all.
        noise: standard deviation of the noise on each step's displacement [m], which shows the way
            back to the path; 6 % of the largest displacement if not given.
        pushed: share of the demonstrations with one push.
        push: distance of a push [m]; twice the largest displacement if not given.
    """

    demonstrations: int = 0
    demonstrated: int = 0
    noise: float | None = None
    pushed: float = 0.25
    push: float | None = None

    def __post_init__(self) -> None:
        count("demonstrations", self.demonstrations, low=0)
        count("demonstrated", self.demonstrated, low=0)
        bounded("pushed", self.pushed, 0, 1)
        for name in ("noise", "push"):
            if getattr(self, name) is not None:
                bounded(name, getattr(self, name), 0)

    def within(self, source: DatasetConfig) -> DemonstrationsConfig:
        """The same settings with the defaults of the robot that demonstrates in a dataset.

        Raises:
            InvalidInputError: the dataset has fewer scenes or trajectories, or the noise is larger
                than a displacement.
        """
        count("demonstrations", self.demonstrations)
        for name, most in (("demonstrations", source.per_scene), ("demonstrated", source.scenes)):
            if getattr(self, name) > most:
                raise InvalidInputError(
                    f"{name} must be at most {most}, as in the dataset, got {getattr(self, name)}"
                )
        from ..envs import vector_type

        limit = vector_type(None, source.dim).max_displacement
        noise = bounded("noise", _NOISE * limit if self.noise is None else self.noise, 0, limit)
        return replace(self, noise=noise, push=_PUSH * limit if self.push is None else self.push)
