"""What both stages share of diffusion: the noise schedule and a deterministic sampler."""

import math
from collections.abc import Callable, Sequence

import torch
from torch import Tensor


def noise_schedule(diffusion_steps: int) -> Tensor:
    """ᾱ `(diffusion_steps,)`: squared cosine (Nichol & Dhariwal 2021), zero terminal signal."""
    from diffusers.schedulers.scheduling_ddim import DDIMScheduler

    return DDIMScheduler(
        num_train_timesteps=diffusion_steps,
        beta_schedule="squaredcos_cap_v2",
        rescale_betas_zero_snr=True,
    ).alphas_cumprod


def standard_normal(*shape: int, generator: torch.Generator) -> Tensor:
    """Noise in float32 on the CPU, whatever PyTorch's defaults."""
    return torch.randn(shape, generator=generator, dtype=torch.float32, device="cpu")


def noised(clean: Tensor, noise: Tensor, signal: Tensor) -> tuple[Tensor, Tensor]:
    """`clean` under `noise`, and the velocity v to be predicted (Salimans & Ho 2022).

    Args:
        clean: `(B, K, D)`.
        noise: `(B, K, D)` standard normal.
        signal: ᾱ of each, `(B, 1, 1)`.
    """
    noisy = signal.sqrt() * clean + (1 - signal).sqrt() * noise
    return noisy, signal.sqrt() * noise - (1 - signal).sqrt() * clean


def sampling_timesteps(diffusion_steps: int, steps: int, *, to_end: bool = False) -> list[int]:
    """`steps` of the diffusion steps, falling, evenly spaced from the last one to the middle.

    With zero terminal signal the first must be at pure noise (Lin et al. 2024). Under less noise
    than the middle's there is nothing left to choose for a model that knows all it needs, so few
    steps end there; `to_end`, they go on to the first diffusion step.
    """
    last = diffusion_steps - 1
    end = 0 if to_end else min(last // 2, diffusion_steps - steps)
    return [round(last - (last - end) * i / max(1, steps - 1)) for i in range(steps)]


def ddim(
    velocity: Callable[[Tensor, int], Tensor],
    noise: Tensor,
    signal: Tensor,
    times: Sequence[int],
    bound: float = math.inf,
) -> Tensor:
    """Denoise `noise (B, K, D)` deterministically (Song et al. 2021); the same noise, the same end.

    Args:
        velocity: v of a noisy latent `(B, K, D)` at the i-th of `times`.
        noise: standard normal.
        signal: ᾱ at each diffusion step, `(S,)`.
        times: the diffusion steps to take, falling from the last, see `sampling_timesteps`.
        bound: the clean estimate is clipped to ±`bound` at each step, which keeps strong guidance
            from running away.
    """
    latent = clean = noise
    roots, rest = signal.sqrt(), (1 - signal).sqrt()
    for i, (time, after) in enumerate(zip(times, [*times[1:], None], strict=True)):
        v = velocity(latent, i)
        kept, lost = roots[time], rest[time]
        clean, residue = kept * latent - lost * v, lost * latent + kept * v
        if math.isfinite(bound):
            clean = clean.clamp(-bound, bound)
            residue = (latent - kept * clean) / lost
        if after is not None:
            latent = roots[after] * clean + rest[after] * residue
    return clean
