"""The inputs of stage 1 as tensors: a scene's field and free space, readable at any points."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional as F

from ..intent.observer import Observer
from ..obstacles import Solids
from ..scene import Scene
from .inputs import scene_image, scene_odds, scene_solids, scene_vector, stacked, stacked_solids

NO_ODDS = -1e9


@dataclass(frozen=True, eq=False)
class Conditions:
    """The network's inputs of `B` scenes, in their start–target frames.

    Attributes:
        image: `(B, C, H, W)`, see `scene_image`.
        vector: `(B, V)`, see `scene_vector`.
        slopes: `(B, M, D)`,
        intercepts: `(B, M)` and
        distractors: `(B, M, D)`, positions, see `scene_odds`; scenes with fewer than M distractors
            are filled up with log odds so low that they do not count.
        centers, axes, halves, radii, vertices, polygon_radii: of `Solids`, see `scene_solids`.
        solid_features: `(B, N, F)` of each solid; 0 where there is none.
    """

    image: Tensor
    vector: Tensor
    slopes: Tensor
    intercepts: Tensor
    distractors: Tensor
    centers: Tensor
    axes: Tensor
    halves: Tensor
    radii: Tensor
    vertices: Tensor
    polygon_radii: Tensor
    solid_features: Tensor

    @classmethod
    @np.errstate(under="ignore")
    def of(
        cls,
        scenes: Sequence[Scene],
        targets: Sequence[int],
        observers: Sequence[Observer],
        resolution: int,
    ) -> Conditions:
        """The inputs of `scenes`, the i-th with goal `targets[i]` and observer `observers[i]`."""
        images, vectors, odds, solids = [], [], [], []
        for scene, target, observer in zip(scenes, targets, observers, strict=True):
            parts = _scene_inputs(scene, target, observer, resolution)
            for values, value in zip((images, vectors, odds, solids), parts, strict=True):
                values.append(value)
        slopes, intercepts, distractors = map(list, zip(*odds, strict=True))
        arrays = (
            np.stack(images), np.stack(vectors),
            stacked(slopes), stacked(intercepts, NO_ODDS), stacked(distractors),
            *stacked_solids(solids),
        )  # fmt: skip
        return cls(*map(torch.from_numpy, arrays))

    def without_image(self) -> Conditions:
        """The same with an image of no pixels, to save copies after the scene is encoded."""
        return replace(self, image=self.image[:, :0])

    def map(self, function: Callable[[Tensor], Tensor]) -> Conditions:
        """The same after `function` of each tensor."""
        return Conditions(*(function(getattr(self, f.name)) for f in fields(self)))

    @property
    def beta(self) -> Tensor:
        """β `(B, 1, 1)` of Dragan's observers, 0 of gaussian ones."""
        return self.vector[:, -1, None, None]

    @property
    def solids(self) -> Solids:
        """What stands in the way."""
        return Solids(
            self.centers, self.axes, self.halves, self.radii, self.vertices, self.polygon_radii
        )

    def potential(self, points: Tensor) -> Tensor:
        """φ `(B, K)` at points `(B, K, D)`."""
        return self._odds(points)[1]

    def potential_and_gradient(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """φ `(B, K)` at points `(B, K, D)` and its gradient there, `(B, K, D)`.

        `∇φ = Σ_g P(g|x) ∇odds_g`.
        """
        odds, potential = self._odds(points)
        posterior = torch.exp(odds - potential[:, None]).transpose(1, 2)  # (B, K, M)
        toward = _unit(points[:, :, None] - self.distractors[:, None])
        pull = (posterior[..., None] * toward).sum(2)
        push = posterior.sum(-1, keepdim=True) * _unit(points - self._target(points))
        return potential, posterior @ self.slopes + self.beta * (push - pull)

    def _odds(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Log odds of the distractors, `(B, M, K)`, at points `(B, K, D)`, and φ `(B, K)`."""
        odds = self.slopes @ points.transpose(1, 2) + self.intercepts[..., None]
        nearer = _length(points - self._target(points))[:, None] - _length(
            points[:, None] - self.distractors[:, :, None]
        )
        odds = odds + self.beta * nearer
        return odds, F.softplus(odds.logsumexp(dim=1))

    @staticmethod
    def _target(points: Tensor) -> Tensor:
        """The target in the frame, `(D,)`."""
        return F.pad(points.new_ones(1), (0, points.shape[-1] - 1))

    def distractor_features(self) -> tuple[Tensor, Tensor]:
        """Features `(B, M, 2D + 4)` of each distractor, and whether there is one, `(B, M)`.

        Its position, and slope, intercept and β of its log odds, and these at the start.
        """
        there = self.intercepts > NO_ODDS / 2
        beta = self.beta[..., 0].expand_as(self.intercepts)
        nearer = 1 - _length(self.distractors)
        columns = [self.intercepts, beta, self.intercepts + beta * nearer, nearer]
        features = [self.distractors, self.slopes / 4, torch.stack(columns, dim=-1) / 4]
        return torch.asinh(torch.cat(features, dim=-1)), there

    def margin(self, points: Tensor) -> Tensor:
        """Distance `(B, K)` of points `(B, K, D)` from the nearest solid or wall."""
        return torch.minimum(self.solids.distance(points), self._walls(points)[0].amin(-1))

    def margin_and_gradient(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """`margin` `(B, K)` and its gradient `(B, K, D)` at points `(B, K, D)`."""
        solid, slope = self.solids.nearest(points)
        distances, inward = self._walls(points)
        wall = distances.amin(-1)
        side = (distances == wall[..., None]).to(points.dtype)
        wall_slope = (side / side.sum(-1, keepdim=True) * inward[1]) @ inward[0].transpose(1, 2)
        nearer = (solid < wall)[..., None]
        return torch.minimum(solid, wall), torch.where(nearer, slope, wall_slope)

    def _walls(self, points: Tensor) -> tuple[Tensor, tuple[Tensor, Tensor]]:
        """Distance `(B, K, D)` to the nearer wall along each axis of the workspace.

        And these axes as columns `(B, D, D)`, and the sign `(B, K, D)` of inward along each.
        """
        dim = points.shape[-1]
        centre, axes = self.vector[:, :dim], self.vector[:, dim : dim + dim * dim]
        axes = axes.reshape(-1, dim, dim)
        half = axes.norm(dim=1)
        axes = axes / half[:, None]
        along = (points - centre[:, None]) @ axes
        inward = torch.where(along > 0, -torch.ones_like(along), torch.ones_like(along))
        return half[:, None] - along.abs(), (axes, inward)


@functools.lru_cache(maxsize=256)  # each draw asks for them
def _scene_inputs(
    scene: Scene, target: int, observer: Observer, resolution: int
) -> tuple[Any, ...]:
    """Image, vector, odds and solids of a scene, see `inputs`."""
    field = observer.field(scene)
    return (
        scene_image(scene, target, field, resolution), scene_vector(scene, target, field),
        scene_odds(scene, target, field), scene_solids(scene, target),
    )  # fmt: skip


def _length(vectors: Tensor) -> Tensor:
    """Length `(...)` of `vectors (..., D)`, with a gradient at 0."""
    return vectors.square().sum(-1).clamp_min(1e-12).sqrt()


def _unit(vectors: Tensor) -> Tensor:
    return vectors / _length(vectors)[..., None]
