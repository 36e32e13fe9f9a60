"""The observer of a motion: who watches, how they read a position, and what ℓ means to them."""

from __future__ import annotations

import functools
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from ..checks import (
    Array,
    bounded,
    check_choices,
    choice,
    did_you_mean,
    finite_array,
    positive,
    prior_array,
)
from ..errors import InvalidInputError
from ..files import read_document, write_document
from ..scene import Scene
from .field import Field, InformationPotentialField
from .labels import LABELS, anchored_label, rank_label
from .metrics import BETA_SHARE, DEFAULT_ALPHA, legibility_score

KINDS = ("boltzmann", "gaussian")
"""The likelihoods of a position given the goal."""

PRIORS = ("neutral", "uniform")
"""The named priors."""

OBSERVERS = ("dragan", "paper")
"""The named observers."""

_PAPER_SIGMA = {2: 0.15, 3: 0.08}
_SIGMA_SHARE, _DEPTH = 0.15, 3.0
_LARGEST_BETA = 1e6  # over the scene's size


@dataclass(frozen=True, repr=False)
class Observer:
    """All parameters of ℓ except the scene.

    The default is the observer of Dragan et al. (HRI 2013) who takes a motion's length for its
    cost: the cost so far is the same for every goal and cancels, so their posterior is a field.

    Attributes:
        kind: `boltzmann`, energy `E_g(x) = β ‖x − g‖`, or `gaussian`,
            `E_g(x) = ½ (x − g)ᵀ Σ⁻¹ (x − g)` (paper, section V.A).
        prior: `neutral`, such that the posterior at the start is uniform, so that nobody has
            decided before anything moves; `uniform` (the paper's); or a weight above 0 for each
            goal.
        sigma: spread σ of a gaussian [m]; if not given, 0.15 times the scene's size.
        beta: rationality β of a boltzmann [1/m]; if not given, 20 over the scene's size.
        viewpoint: position of a gaussian's eyes, `(D,)` [m]. Along the line of sight to the mean of
            the goals positions are read less well: `Σ = σ² (I + (depth² − 1) d dᵀ)`.
        depth: spread along the line of sight over that across it, at least 1.
        alpha: decay α of the score's weight over progress (paper, eq. 4).
        detour: largest length of a motion on the dial over the shortest feasible one.
        label: how scores become labels, `anchored` or `rank`.

    The scene's size is the largest distance among start and goals.

    Raises:
        InvalidInputError: a value out of its range, or one that the kind does not have.
    """

    kind: str = choice("boltzmann", KINDS)
    prior: str | tuple[float, ...] = "neutral"
    sigma: float | None = None
    beta: float | None = None
    viewpoint: tuple[float, ...] | None = None
    depth: float = _DEPTH
    alpha: float = DEFAULT_ALPHA
    detour: float = 2.5
    label: str = choice("anchored", LABELS)

    def __post_init__(self) -> None:
        def put(name: str, value: Any) -> None:
            object.__setattr__(self, name, value)

        check_choices(self)
        if not isinstance(self.prior, str):
            weights = finite_array("prior", self.prior, ndim=1)
            prior_array(weights, max(2, len(weights)))
            put("prior", tuple(weights.tolist()))
        elif self.prior not in PRIORS:
            raise InvalidInputError(
                f"prior must be one of {', '.join(PRIORS)}, or a weight for each goal, "
                f"got {self.prior!r}{did_you_mean(self.prior, PRIORS)}"
            )
        foreign = ("sigma", "viewpoint") if self.kind == "boltzmann" else ("beta",)
        for name in foreign:
            if getattr(self, name) is not None:
                raise InvalidInputError(f"a {self.kind} observer has no {name}")
        for name in ("sigma", "beta"):
            if getattr(self, name) is not None:
                put(name, positive(name, getattr(self, name)))
        if self.viewpoint is not None:
            eyes = finite_array("viewpoint", self.viewpoint, ndim=1, last=(2, 3))
            put("viewpoint", tuple(eyes.tolist()))
        put("depth", bounded("depth", self.depth, 1))
        if self.viewpoint is None and self.depth != _DEPTH:
            raise InvalidInputError(
                f"depth {self.depth:g} belongs to a viewpoint, which is not given"
            )
        put("alpha", bounded("alpha", self.alpha, 0))
        put("detour", bounded("detour", self.detour, 1))

    @classmethod
    def paper(cls, dim: int) -> Observer:
        """The paper's observer in D dimensions: gaussian, uniform, σ = 0.15 m, or 0.08 m in 3D."""
        if dim not in _PAPER_SIGMA:
            raise InvalidInputError(f"dim must be 2 or 3, got {dim!r}")
        return cls(kind="gaussian", prior="uniform", sigma=_PAPER_SIGMA[dim])

    def field(self, scene: Scene) -> Field:
        """The field of a scene; cached."""
        return _field(scene, self)

    def score(self, trajectory: Array, scene: Scene, target: int) -> Array:
        """`legibility_score` of `trajectory (..., T, D)` [m], `(...)`; higher = more legible."""
        return legibility_score(trajectory, self.field(scene), target, self.alpha)

    def labels(self, scores: Array, anchor_score: float) -> Array:
        """ℓ `(N,)` of the scores `(N,)` of one scene, given that of the motion at ℓ = 0."""
        if self.label == "rank":
            return rank_label(scores)
        return anchored_label(scores, anchor_score)

    @property
    def scale(self) -> tuple[float, float, str]:
        """What ℓ means whoever watches, `(alpha, detour, label)`; models keep to theirs."""
        return self.alpha, self.detour, self.label

    def __repr__(self) -> str:
        values = [(f.name, getattr(self, f.name), f.default) for f in fields(self)]
        given = {name: value for name, value, default in values if value != default}
        return f"Observer({', '.join(f'{name}={value!r}' for name, value in given.items())})"

    def to_dict(self) -> dict[str, Any]:
        """Plain values for a file."""
        content = {f.name: getattr(self, f.name) for f in fields(self)}
        return {k: list(v) if isinstance(v, tuple) else v for k, v in content.items()}

    @classmethod
    def from_dict(cls, content: Any) -> Observer:
        """The inverse of `to_dict`; any key may be left out."""
        names = [f.name for f in fields(cls)]
        if not isinstance(content, dict):
            raise InvalidInputError(
                f"an observer must be a mapping with keys among {', '.join(names)}, got {content!r}"
            )
        if unknown := sorted(map(str, content.keys() - set(names))):
            raise InvalidInputError(
                f"an observer has the keys {', '.join(names)}; unknown: {', '.join(unknown)}"
            )
        return cls(**content)

    def save(self, path: str | Path) -> None:
        """Write the observer as JSON (.json) or YAML, without what is not given."""
        write_document(path, {k: v for k, v in self.to_dict().items() if v is not None})

    @classmethod
    def load(cls, path: str | Path) -> Observer:
        """Read an observer from YAML or JSON, or that of a scene file (key `observer`).

        There it is a mapping, or the path of an observer's file beside the scene's, or `dragan` or
        `paper`.
        """
        content = read_document(path, "observer file", InvalidInputError)
        of_scene = isinstance(content, dict) and "start" in content
        dim = Scene.load(path).dim if of_scene else 0
        try:
            if of_scene:
                return observer_of(content.get("observer"), dim, Path(path).parent)
            return cls.from_dict(content)
        except InvalidInputError as cause:
            raise InvalidInputError(f"{path}: {cause}") from cause


DEFAULT_OBSERVER = Observer()


def observer_of(given: Any, dim: int, folder: Path = Path()) -> Observer:
    """The observer that `given` means in D dimensions: Dragan's, unless it says another.

    It may be `dragan` or `paper`, the name of a file relative to `folder`, or a mapping.
    """
    if given is None or given == "dragan":
        return DEFAULT_OBSERVER
    if given == "paper":
        return Observer.paper(dim)
    if isinstance(given, dict):
        return Observer.from_dict(given)
    if not isinstance(given, str) or not given.lower().endswith((".yaml", ".yml", ".json")):
        raise InvalidInputError(
            f"observer must be dragan, paper or a file, .yaml or .json, got {given!r}"
            f"{did_you_mean(given, OBSERVERS)}"
        )
    return Observer.load(folder / given)


@functools.lru_cache(maxsize=64)  # each part of a plan asks for it
def _field(scene: Scene, observer: Observer) -> Field:
    goals, size = scene.goals, scene.size
    precision, beta = np.zeros((scene.dim, scene.dim)), 0.0
    if observer.kind == "boltzmann":
        beta = BETA_SHARE / size if observer.beta is None else observer.beta
        if not beta * size <= _LARGEST_BETA:
            raise InvalidInputError(
                f"beta must be at most {_LARGEST_BETA / size:g} 1/m in a scene of {size:g} m, "
                f"got {beta:g}"
            )
    else:
        sigma = _SIGMA_SHARE * size if observer.sigma is None else observer.sigma
        if observer.viewpoint is None and observer.prior == "uniform":
            return InformationPotentialField(goals, sigma)
        precision = np.eye(scene.dim) - _along_sight(scene, observer)
        with np.errstate(all="ignore"):
            precision = precision / np.float64(sigma) ** 2
        if not np.isfinite(precision).all():
            raise InvalidInputError(f"sigma must not vanish beside the scene's size, got {sigma}")
    if observer.prior == "neutral":
        offsets = scene.start - goals
        log_prior = np.einsum("gi,ij,gj->g", offsets, precision, offsets) / 2
        log_prior = log_prior + beta * np.linalg.norm(offsets, axis=-1)
        log_prior -= log_prior.mean()
    elif observer.prior == "uniform":
        log_prior = np.zeros(len(goals))
    else:
        log_prior = np.log(prior_array(observer.prior, len(goals)))
    return Field(goals, precision, beta, log_prior)


def _along_sight(scene: Scene, observer: Observer) -> Array:
    """`(1 − 1/depth²) d dᵀ`, by which the line of sight d lowers the precision, `(D, D)`."""
    if observer.viewpoint is None:
        return np.zeros((scene.dim, scene.dim))
    if len(observer.viewpoint) != scene.dim:
        raise InvalidInputError(
            f"viewpoint must be {scene.dim} numbers in this scene, got {list(observer.viewpoint)}"
        )
    sight = scene.goals.mean(axis=0) - np.array(observer.viewpoint)
    farthest = np.abs(sight).max()
    if farthest < 1e-6 * scene.size:
        raise InvalidInputError(
            f"viewpoint must not lie in the middle of the goals, got {list(observer.viewpoint)}"
        )
    sight /= farthest  # whose square may be infinite
    return (1 - observer.depth**-2) * np.outer(sight, sight) / (sight @ sight)
