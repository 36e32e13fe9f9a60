"""Random scenes of a seed stream, and their archives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..checks import count, random_seed
from ..errors import InvalidInputError
from ..intent.observer import Observer
from ..motion.archive import Archive, build_archive
from ..scene import Scene
from ..seeds import STREAMS, stream_seed


@dataclass(frozen=True)
class SceneStream:
    """Random scenes by index; the target is goal 0 in each.

    Attributes:
        stream: one of `STREAMS`, which share no scene.
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
        try:
            low, high = (count("goals", number, low=2) for number in self.goals)
        except (TypeError, ValueError):
            low, high = 1, 0
        if not low <= high <= 12:
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
