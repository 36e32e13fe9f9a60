"""The noise schedule and the sampler that both stages share."""

from math import inf

import pytest
import torch

from legibility.models.diffusion import ddim, noise_schedule, noised, sampling_timesteps


class TestSchedule:
    def test_last_step_is_noise_alone(self):
        signal = noise_schedule(100)
        assert signal.shape == (100,)
        assert signal[-1] == pytest.approx(0, abs=1e-6)
        assert signal[0] > 0.99
        assert (signal.diff() < 0).all()

    @pytest.mark.parametrize("diffusion_steps", [1, 7, 100])
    def test_every_number_of_steps_begins_at_the_last_and_is_as_many(self, diffusion_steps):
        for steps in range(1, diffusion_steps + 1):
            times = sampling_timesteps(diffusion_steps, steps)
            assert len(times) == steps
            assert times[0] == diffusion_steps - 1
            assert min(times) >= 0
            assert times == sorted(set(times), reverse=True)
            whole = sampling_timesteps(diffusion_steps, steps, to_end=True)
            assert whole == sorted(set(whole), reverse=True)
            assert len(whole) == steps
            assert steps == 1 or (whole[0], whole[-1]) == (diffusion_steps - 1, 0)


class TestSampler:
    def test_a_denoiser_that_knows_the_answer_is_followed(self):
        """With the true velocity of one latent, every number of steps ends at that latent."""
        generator = torch.Generator().manual_seed(5)
        wanted, noise = torch.randn(2, 3, 8, 2, generator=generator)
        signal = noise_schedule(100)

        def velocity(latent, i):
            alpha = signal[times[i]]
            rest = (latent - alpha.sqrt() * wanted) / (1 - alpha).sqrt()
            return alpha.sqrt() * rest - (1 - alpha).sqrt() * wanted

        for steps in (1, 2, 5, 100):
            times = sampling_timesteps(100, steps)
            found = ddim(velocity, noise, signal, times)
            torch.testing.assert_close(found, wanted, atol=1e-3, rtol=1e-3)

    def test_bounded_it_ends_within_the_bound_however_strong_the_velocity(self):
        noise = torch.randn(4, 8, 2, generator=torch.Generator().manual_seed(0))
        signal = noise_schedule(100)
        for steps in (1, 2, 10, 100):
            times = sampling_timesteps(100, steps, to_end=True)
            found = ddim(lambda x, i: -50 * x - 7, noise, signal, times, bound=1.5)
            assert torch.isfinite(found).all()
            assert found.abs().max() <= 1.5

    def test_a_bound_that_is_never_met_changes_nothing(self):
        noise = torch.randn(4, 8, 2, generator=torch.Generator().manual_seed(0))
        signal, times = noise_schedule(100), sampling_timesteps(100, 10)
        free, bounded = (ddim(lambda x, i: 0.3 * x, noise, signal, times, b) for b in (inf, 1e3))
        torch.testing.assert_close(free, bounded, atol=1e-4, rtol=1e-4)

    def test_velocity_and_noisy_give_back_clean_and_noise(self):
        generator = torch.Generator().manual_seed(0)
        clean, noise = torch.randn(2, 4, 8, 3, generator=generator)
        signal = torch.tensor([0.0, 0.3, 0.9, 1.0])[:, None, None]
        noisy, velocity = noised(clean, noise, signal)
        torch.testing.assert_close(signal.sqrt() * noisy - (1 - signal).sqrt() * velocity, clean)
        torch.testing.assert_close((1 - signal).sqrt() * noisy + signal.sqrt() * velocity, noise)
