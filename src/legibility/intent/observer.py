"""The observer of a motion: the likelihood of a position, the score's weights, the label's rule."""

from __future__ import annotations

import functools
from dataclasses import asdict, dataclass, replace
from typing import Any

from ..checks import Array, bounded, positive
from ..errors import InvalidInputError
from ..scene import Scene
from .field import InformationPotentialField
from .labels import LABELS, anchored_label, rank_label
from .metrics import DEFAULT_ALPHA, legibility_score

_PAPER_SIGMA = {2: 0.15, 3: 0.08}


@dataclass(frozen=True)
class Observer:
    """All parameters of ℓ except the scene.

    Attributes:
        sigma: spread σ of each goal's likelihood [m]; if not given, the paper's: 0.15 m in 2-D,
            0.08 m at the Panda's table.
        alpha: decay α of the score's weight over progress (paper, eq. 4).
        label: how scores become labels, `anchored` or `rank`.

    Raises:
        InvalidInputError: σ ≤ 0, α < 0 or an unknown label.
    """

    sigma: float | None = None
    alpha: float = DEFAULT_ALPHA
    label: str = "anchored"

    def __post_init__(self) -> None:
        if self.sigma is not None:
            object.__setattr__(self, "sigma", positive("sigma", self.sigma))
        object.__setattr__(self, "alpha", bounded("alpha", self.alpha, 0))
        if self.label not in LABELS:
            raise InvalidInputError(f"label must be one of {', '.join(LABELS)}, got {self.label!r}")

    @classmethod
    def paper(cls, dim: int) -> Observer:
        """The paper's observer, with its σ for the dimension."""
        return cls().resolved(dim)

    def resolved(self, dim: int) -> Observer:
        """The same observer with σ given, by default the paper's for the dimension."""
        if dim not in _PAPER_SIGMA:
            raise InvalidInputError(f"dim must be 2 or 3, got {dim!r}")
        return self if self.sigma is not None else replace(self, sigma=_PAPER_SIGMA[dim])

    def field(self, scene: Scene) -> InformationPotentialField:
        """The information potential field of a scene under a uniform prior; cached."""
        return _field(scene, self.resolved(scene.dim).sigma)

    def score(self, trajectory: Array, scene: Scene, target: int) -> Array:
        """`legibility_score` of `trajectory (..., T, D)` [m], `(...)`; higher = more legible."""
        return legibility_score(trajectory, self.field(scene), target, self.alpha)

    def labels(self, scores: Array, straight_score: float) -> Array:
        """ℓ `(N,)` of the scores `(N,)` of one scene, given that of the straight line."""
        if self.label == "rank":
            return rank_label(scores)
        return anchored_label(scores, straight_score)

    def to_dict(self) -> dict[str, Any]:
        """Plain values for a file."""
        return asdict(self)


DEFAULT_OBSERVER = Observer()


@functools.lru_cache(maxsize=64)  # each part of a plan asks for it
def _field(scene: Scene, sigma: float | None) -> InformationPotentialField:
    assert sigma is not None
    return InformationPotentialField(scene.goals, sigma)
