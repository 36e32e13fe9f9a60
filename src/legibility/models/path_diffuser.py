"""Stage 1, the intent-aware path diffuser: start, goal, field and ℓ to 8 waypoints (paper, V.C)."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional as F

from ..curves import NUM_WAYPOINTS
from ..intent.observer import Observer
from ..obstacles import Solids
from ..scene import Scene
from .configuration import PathDiffuserConfig
from .dial import KNOTS, Dial
from .diffusion import ddim, sampling_timesteps
from .inputs import (
    DEPTH,
    FIELD_CHANNELS,
    scene_image,
    scene_odds,
    scene_solids,
    scene_vector,
    solid_features,
    stacked,
    stacked_solids,
    vector_size,
)
from .networks import FieldEncoder, FiLMUNet, Residual, SetEncoder, fourier

NO_ODDS = -1e9
LEVEL_FREQUENCIES = 12
TIME_FREQUENCIES = 16


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


class Drawn(NamedTuple):
    """Paths drawn in the start–target frame.

    Attributes:
        waypoints: `(B, K, D)`.
        cost: log(−L_p) `(B,)` that their ℓ asks for, as the dial predicts it; None of a model
            without the field.
    """

    waypoints: Tensor
    cost: Tensor | None


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


class PathDiffuser(nn.Module):
    """Denoises the waypoints' deviation from the straight line, in the start–target frame.

    The ends of a path are not generated: they are the start and the goal, exactly.
    """

    def __init__(self, config: PathDiffuserConfig) -> None:
        super().__init__()
        self.config = config
        size = config.condition
        if config.field:
            slices = DEPTH if config.dim == 3 else 1
            self.encoder = FieldEncoder(
                FIELD_CHANNELS * slices, config.resolution, config.encoder_width, size
            )
            self.distractors = SetEncoder(2 * config.dim + 4, size)
            self.solids = SetEncoder(solid_features(config.dim), size)
            self.dial = Dial(config)
            self.scale = nn.Linear(KNOTS + 1, size)
        self.place = nn.Linear(vector_size(config.dim), size)
        self.no_field = nn.Parameter(torch.zeros(size))
        self.scene = nn.Sequential(nn.SiLU(), Residual(size))
        self.level = nn.Linear(2 * LEVEL_FREQUENCIES + 1, size)
        self.no_level = nn.Parameter(torch.zeros(size))
        self.fuse = nn.Sequential(Residual(size), Residual(size))
        self.time = nn.Sequential(
            nn.Linear(2 * TIME_FREQUENCIES + 1, size), nn.SiLU(), nn.Linear(size, size)
        )
        self.unet = FiLMUNet(3 * config.dim + 2, config.dim, config.channels, size)
        self.spread: Tensor  # of the latent over the data, set by training
        self.register_buffer("spread", torch.ones(NUM_WAYPOINTS, config.dim))
        self.signal: Tensor  # ᾱ at each diffusion step, set by training
        self.register_buffer("signal", torch.ones(config.diffusion_steps))
        self.straight: Tensor  # the waypoints of the straight line
        straight = torch.zeros(NUM_WAYPOINTS, config.dim, dtype=torch.float32)
        straight[:, 0] = torch.linspace(0, 1, NUM_WAYPOINTS + 2, dtype=torch.float32)[1:-1]
        self.register_buffer("straight", straight, persistent=False)

    def conditions(
        self, scenes: Sequence[Scene], targets: Sequence[int], observers: Sequence[Observer]
    ) -> Conditions:
        """`Conditions.of` for the model's resolution."""
        return Conditions.of(scenes, targets, observers, self.config.resolution)

    def knots(self, conditions: Conditions, readings: Tensor | None = None) -> Tensor | None:
        """The scene's dial, see `Dial`, by its `readings` if known; None without the field."""
        if not self.config.field:
            return None
        return self.dial(self.dial.readings(conditions) if readings is None else readings)

    def encode_scene(
        self, conditions: Conditions, knots: Tensor | None, keep: Tensor | None = None
    ) -> Tensor:
        """`(B, E)` of the scene and its dial; where `keep (B,)` is false the field is dropped."""
        if knots is None:
            return self._without_field(conditions)
        solids = conditions.solid_features
        features = self.encoder(conditions.image.float())
        features = features + self.distractors(*conditions.distractor_features())
        features = features + self.solids(torch.asinh(solids), solids[..., -1] > 0)
        middle = knots[:, KNOTS // 2, None]
        features = features + self.scale(torch.cat([knots - middle, middle], 1).detach() / 4)
        if keep is not None:
            features = torch.where(keep[:, None], features, self.no_field)
        return self.scene(features + self.place(torch.asinh(conditions.vector)))

    def _without_field(self, conditions: Conditions) -> Tensor:
        """The result of `encode_scene` where the field is dropped; it needs no image."""
        return self.scene(self.no_field + self.place(torch.asinh(conditions.vector)))

    def encode(self, scene: Tensor, level: Tensor, keep: Tensor | None = None) -> Tensor:
        """`(B, E)` of scene and ℓ `(B,)`; where `keep (B,)` is false ℓ is dropped."""
        features = self.level(fourier(level, LEVEL_FREQUENCIES))
        if keep is not None:
            features = torch.where(keep[:, None], features, self.no_level)
        return self.fuse(scene + features)

    def forward(
        self,
        noisy: Tensor,
        timestep: Tensor,
        context: Tensor,
        conditions: Conditions,
        keep: Tensor | None = None,
    ) -> Tensor:
        """The velocity v (Salimans & Ho 2022), `(B, K, D)`.

        The U-Net reads the noisy waypoints, the field's potential and gradient there (unless the
        model is one without the field), and the margin to solids and walls and its gradient.

        Args:
            noisy: `(B, K, D)`, noisy latent.
            timestep: `(B,)` int, of the noise schedule, or `(1,)` for all.
            context: `(B, E)` from `encode`.
            conditions: of the `B` scenes, or of one for all.
            keep: `(B,)` or `(1,)`, where it is false the field is dropped.
        """
        reading = self._read(noisy, conditions)
        if keep is not None:
            reading = reading * keep[:, None, None]
        time = timestep.float() / self.config.diffusion_steps * 2 - 1
        condition = F.silu(context + self.time(fourier(time, TIME_FREQUENCIES)))
        return self.unet(torch.cat([noisy, reading], dim=-1), condition)

    @torch.no_grad()
    def _read(self, noisy: Tensor, conditions: Conditions) -> Tensor:
        """`(B, K, 2D + 2)` of the field and the free space at `noisy (B, K, D)`."""
        # In float32 whatever the network's precision: log odds are large, their differences small.
        with torch.autocast(noisy.device.type, enabled=False):
            points = self.from_latent(noisy)
            potential, gradient = conditions.potential_and_gradient(points)
            margin, inward = conditions.margin_and_gradient(points)
        belief = torch.cat([torch.log1p(potential)[..., None] - 1, torch.asinh(gradient) / 2], -1)
        if not self.config.field:
            belief = torch.zeros_like(belief)
        return torch.cat([belief, torch.tanh(2 * margin)[..., None], inward], dim=-1)

    def to_latent(self, waypoints: Tensor) -> Tensor:
        """Waypoints `(..., K, D)` in the start–target frame to the latent."""
        deviation = waypoints - self.straight
        return torch.asinh(deviation / self.config.squash) / self.spread

    def from_latent(self, latent: Tensor) -> Tensor:
        """The inverse of `to_latent`."""
        deviation = torch.sinh((latent * self.spread).clamp(-6, 6)) * self.config.squash
        return deviation + self.straight

    @torch.no_grad()
    def sample(
        self,
        conditions: Conditions,
        level: Tensor,
        noise: Tensor,
        *,
        guidance: float | None = None,
        steps: int | None = None,
        readings: Tensor | None = None,
    ) -> Drawn:
        """Draw paths in the start–target frame, by deterministic DDIM.

        Song et al. 2021; the same noise gives the same path.

        Args:
            conditions: of `B` scenes, or of one for all.
            level: ℓ, `(B,)`.
            noise: `(B, K, D)` standard normal.
            guidance: weight w at ℓ = ±1; the configuration's if not given.
            steps: of the sampler; the configuration's if not given.
            readings: of the dial, if they are known.
        """
        with torch.autocast(noise.device.type, enabled=False):
            knots = self.knots(conditions, readings)
            scene = self.encode_scene(conditions, knots)
            waypoints = self.draw(conditions, scene, level, noise, guidance, steps)
        return Drawn(waypoints, None if knots is None else Dial.at(knots, level))

    def draw(
        self,
        conditions: Conditions,
        scene: Tensor,
        level: Tensor,
        noise: Tensor,
        guidance: float | None = None,
        steps: int | None = None,
    ) -> Tensor:
        """`sample` after `encode_scene` gave `scene (B, E)`, or `(1, E)` for all."""
        guidance = self.config.guidance if guidance is None else guidance
        times = sampling_timesteps(self.config.diffusion_steps, steps or self.config.sampling_steps)
        context = self.encode(scene, level)
        if not guidance:
            return self.denoise(conditions, context, noise, times)
        never = torch.zeros(1, dtype=torch.bool, device=noise.device)
        nothing = self.encode(self._without_field(conditions), level, never)
        weight = guidance * level[:, None, None] ** 4
        return self.denoise(conditions, context, noise, times, nothing, weight)

    def denoise(
        self,
        conditions: Conditions,
        context: Tensor,
        noise: Tensor,
        times: Sequence[int],
        nothing: Tensor | None = None,
        weight: Tensor | float = 0.0,
    ) -> Tensor:
        """Waypoints `(B, K, D)` of `noise (B, K, D)` at the diffusion steps `times`.

        Args:
            conditions: of the `B` scenes, or of one for all.
            context: `(B, E)` from `encode`.
            noise: standard normal.
            times: see `sampling_timesteps`.
            nothing: `(B, E)` from `encode` without field and ℓ, for guidance.
            weight: `(B, 1, 1)` of the guidance away from `nothing`.
        """
        steps = torch.tensor(times, device=noise.device)[:, None]
        never = torch.zeros(1, dtype=torch.bool, device=noise.device)

        def velocity(latent: Tensor, i: int) -> Tensor:
            guided = self(latent, steps[i], context, conditions)
            if nothing is None:
                return guided
            free = self(latent, steps[i], nothing, conditions, never)
            return guided + weight * (guided - free)

        return self.from_latent(ddim(velocity, noise, self.signal, times))
