"""Stage 1, the intent-aware path diffuser: start, goal, field and ℓ to 8 waypoints (paper, V.C)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional as F

from ..checks import Array
from ..curves import NUM_WAYPOINTS
from ..errors import InvalidInputError
from ..intent.observer import Observer
from ..scene import Scene
from .conditions import Conditions
from .configuration import PathDiffuserConfig
from .diffusion import ddim, sampling_timesteps
from .inputs import DEPTH, FIELD_CHANNELS, solid_features, vector_size
from .networks import FieldEncoder, FiLMUNet, Residual, SetEncoder, fourier

LEVEL_FREQUENCIES = 12
TIME_FREQUENCIES = 16


DIAL_LEVELS = np.linspace(-1, 1, 17)
"""Levels of ℓ at which stage 1 is told the scores that its scene's archive gives them."""

LEAST_COST = 1e-30
"""−L_p below which scores count as equal."""


def dial_of(scores: Array) -> np.ndarray:
    """log(−L_p) in float32 of scores `(...)`; stage 1 reads those at `DIAL_LEVELS`."""
    return np.log(np.maximum(-scores, LEAST_COST)).astype(np.float32)


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
            self.scale = nn.Linear(len(DIAL_LEVELS) + 1, size)
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

    def encode_scene(
        self, conditions: Conditions, dial: Tensor | None, keep: Tensor | None = None
    ) -> Tensor:
        """`(B, E)` of the scene and its dial; where `keep (B,)` is false the field is dropped.

        `dial (B, 17)` is `dial_of` the scene's scores; a model without the field needs none.
        """
        if not self.config.field:
            return self._without_field(conditions)
        solids = conditions.solid_features
        features = self.encoder(conditions.image.float())
        features = features + self.distractors(*conditions.distractor_features())
        features = features + self.solids(torch.asinh(solids), solids[..., -1] > 0)
        if dial is None:
            raise InvalidInputError("dial must be that of each scene, got None")
        middle = dial[:, dial.shape[1] // 2, None]
        features = features + self.scale(torch.cat([dial - middle, middle], 1) / 4)
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
        dial: Tensor | None = None,
    ) -> Tensor:
        """Draw paths in the start–target frame, by deterministic DDIM.

        Song et al. 2021; the same noise gives the same path.

        Args:
            conditions: of `B` scenes, or of one for all.
            level: ℓ, `(B,)`.
            noise: `(B, K, D)` standard normal.
            guidance: weight w at ℓ = ±1; the configuration's if not given.
            steps: of the sampler; the configuration's if not given.
            dial: of each scene, see `encode_scene`.

        Returns:
            Waypoints `(B, K, D)`.
        """
        with torch.autocast(noise.device.type, enabled=False):
            scene = self.encode_scene(conditions, dial)
            return self.draw(conditions, scene, level, noise, guidance, steps)

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
