"""Stage 1, the intent-aware path diffuser: start, goal, field and ℓ to 8 waypoints (paper, V.C)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional as F

from ..curves import NUM_WAYPOINTS
from ..intent.observer import Observer
from ..scene import Scene
from .configuration import PathDiffuserConfig
from .diffusion import ddim, sampling_timesteps
from .frame import DEPTH, FIELD_CHANNELS, scene_image, scene_odds, scene_vector, vector_size
from .networks import DistractorEncoder, FieldEncoder, FiLMUNet, Residual, fourier

NO_ODDS = -1e4
LEVEL_FREQUENCIES = 12
TIME_FREQUENCIES = 16


@dataclass(frozen=True, eq=False)
class Conditions:
    """The network's inputs of `B` scenes, in their start–target frames.

    Attributes:
        image: `(B, C, H, W)`, see `scene_image`.
        vector: `(B, V)`, see `scene_vector`.
        slopes: `(B, M, D)` and
        intercepts: `(B, M)` of the distractors' log odds, see `scene_odds`; scenes with fewer than
            M distractors are filled up with log odds so low that they do not count.
    """

    image: Tensor
    vector: Tensor
    slopes: Tensor
    intercepts: Tensor

    @classmethod
    @np.errstate(under="ignore")
    def of(
        cls, scenes: list[Scene], targets: list[int], observer: Observer, resolution: int
    ) -> Conditions:
        """The inputs of `scenes`, with goal `targets[i]` as the target of the i-th."""
        most = max(scene.num_goals for scene in scenes) - 1
        images, vectors = [], []
        slopes = np.zeros((len(scenes), most, scenes[0].dim), dtype=np.float32)
        intercepts = np.full((len(scenes), most), NO_ODDS, dtype=np.float32)
        for i, (scene, target) in enumerate(zip(scenes, targets, strict=True)):
            field = observer.field(scene)
            images.append(scene_image(scene, target, field, resolution))
            vectors.append(scene_vector(scene, target, field))
            others = scene.num_goals - 1
            slopes[i, :others], intercepts[i, :others] = scene_odds(scene, target, field)
        arrays = (np.stack(images), np.stack(vectors), slopes, intercepts)
        return cls(*map(torch.from_numpy, arrays))

    def without_image(self) -> Conditions:
        """The same with an image of no pixels, to save copies after the scene is encoded."""
        return Conditions(self.image[:, :0], self.vector, self.slopes, self.intercepts)

    def map(self, function: Callable[[Tensor], Tensor]) -> Conditions:
        """The same after `function` of each tensor."""
        return Conditions(*(function(getattr(self, f.name)) for f in fields(self)))

    def potential(self, points: Tensor) -> Tensor:
        """φ `(B, K)` at points `(B, K, D)`."""
        return self._odds(points)[1]

    def potential_and_gradient(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """φ `(B, K)` at points `(B, K, D)` and `∇φ = Σ_g P(g|x) slope_g` there, `(B, K, D)`."""
        odds, potential = self._odds(points)
        posterior = torch.exp(odds - potential[:, None])
        return potential, posterior.transpose(1, 2) @ self.slopes

    def _odds(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Log odds of the distractors, `(B, M, K)`, at points `(B, K, D)`, and φ `(B, K)`."""
        odds = self.slopes @ points.transpose(1, 2) + self.intercepts[..., None]
        return odds, F.softplus(odds.logsumexp(dim=1))

    def distractors(self) -> tuple[Tensor, Tensor]:
        """Features `(B, M, 2D + 1)` of each distractor, and whether there is one, `(B, M)`.

        Its position relative to the target, and slope and intercept of its log odds (by asinh).
        """
        variance = torch.exp(-2 * self.vector[:, -1])[:, None, None]  # σ² in the frame
        features = [self.slopes * variance, torch.asinh(self.slopes) / 4]
        features.append(torch.asinh(self.intercepts)[..., None] / 4)
        return torch.cat(features, dim=-1), self.intercepts > NO_ODDS

    def wall_distance(self, points: Tensor) -> Tensor:
        """Distance `(B, K)` of points `(B, K, D)` from the nearest wall, negative outside."""
        dim = points.shape[-1]
        centre, axes = self.vector[:, :dim], self.vector[:, dim : dim + dim * dim]
        axes = axes.reshape(-1, dim, dim)
        half = axes.norm(dim=1)
        along = (points - centre[:, None]) @ (axes / half[:, None])
        return (half[:, None] - along.abs()).amin(dim=-1)


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
            self.distractors = DistractorEncoder(2 * config.dim + 1, size)
        self.place = nn.Linear(vector_size(config.dim), size)
        self.no_field = nn.Parameter(torch.zeros(size))
        self.scene = nn.Sequential(nn.SiLU(), Residual(size))
        self.level = nn.Linear(2 * LEVEL_FREQUENCIES + 1, size)
        self.no_level = nn.Parameter(torch.zeros(size))
        self.fuse = nn.Sequential(Residual(size), Residual(size))
        self.time = nn.Sequential(
            nn.Linear(2 * TIME_FREQUENCIES + 1, size), nn.SiLU(), nn.Linear(size, size)
        )
        self.unet = FiLMUNet(2 * config.dim + 2, config.dim, config.channels, size)
        self.spread: Tensor  # of the latent over the data, set by training
        self.register_buffer("spread", torch.ones(NUM_WAYPOINTS, config.dim))
        self.signal: Tensor  # ᾱ at each diffusion step, set by training
        self.register_buffer("signal", torch.ones(config.diffusion_steps))
        self.straight: Tensor  # the waypoints of the straight line
        straight = torch.zeros(NUM_WAYPOINTS, config.dim, dtype=torch.float32)
        straight[:, 0] = torch.linspace(0, 1, NUM_WAYPOINTS + 2, dtype=torch.float32)[1:-1]
        self.register_buffer("straight", straight, persistent=False)

    def conditions(self, scenes: list[Scene], targets: list[int]) -> Conditions:
        """`Conditions.of` for the model's observer and resolution."""
        return Conditions.of(scenes, targets, self.config.observer, self.config.resolution)

    def encode_scene(self, conditions: Conditions, keep: Tensor | None = None) -> Tensor:
        """`(B, E)` of the scene; where `keep (B,)` is false the field is dropped."""
        if not self.config.field:
            return self._without_field(conditions)
        features = self.encoder(conditions.image) + self.distractors(*conditions.distractors())
        if keep is not None:
            features = torch.where(keep[:, None], features, self.no_field)
        return self.scene(features + self.place(conditions.vector))

    def _without_field(self, conditions: Conditions) -> Tensor:
        """The result of `encode_scene` where the field is dropped; it needs no image."""
        return self.scene(self.no_field + self.place(conditions.vector))

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
        model is one without the field), and the distance to the nearest wall.

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
        """`(B, K, D + 2)` of the field and the walls at the points of `noisy (B, K, D)`."""
        # In float32 whatever the network's precision: log odds are large, their differences small.
        with torch.autocast(noisy.device.type, enabled=False):
            points = self.from_latent(noisy)
            potential, gradient = conditions.potential_and_gradient(points)
            wall_distance = conditions.wall_distance(points)
        reading = torch.cat([
            torch.log1p(potential)[..., None] - 1,
            torch.asinh(gradient) / 2,
            torch.tanh(2 * wall_distance)[..., None],
        ], dim=-1)  # fmt: skip
        if not self.config.field:
            reading[..., :-1] = 0
        return reading

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
    ) -> Tensor:
        """Draw waypoints `(B, K, D)` in the start–target frame, by deterministic DDIM.

        Song et al. 2021; the same noise gives the same path.

        Args:
            conditions: of `B` scenes, or of one for all.
            level: ℓ, `(B,)`.
            noise: `(B, K, D)` standard normal.
            guidance: weight w at ℓ = ±1; the configuration's if not given.
            steps: of the sampler; the configuration's if not given.
        """
        with torch.autocast(noise.device.type, enabled=False):
            scene = self.encode_scene(conditions)
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
