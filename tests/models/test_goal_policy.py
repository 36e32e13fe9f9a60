"""The baselines' policy: what it sees, and that its guidance is Legibility Diffuser's."""

import json

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from legibility.errors import CheckpointError, InvalidInputError
from legibility.models.configuration import GoalPolicyConfig
from legibility.models.diffusion import noise_schedule
from legibility.models.goal_policy import GoalPolicy, goal_features, guidance_weights

SMALL = {"channels": (8, 16), "condition": 16}
WORKSPACE = np.array([[-0.1, -0.1], [1.1, 1.1]])


def make(dim=2, **changes):
    torch.manual_seed(0)
    model = GoalPolicy(GoalPolicyConfig(**{"dim": dim, **SMALL, **changes}))
    torch.nn.init.normal_(model.unet.outlet.weight, std=0.3)
    torch.nn.init.normal_(model.no_goal)
    model.signal.copy_(noise_schedule(model.config.diffusion_steps))
    return model.eval()


def noise(size, dim=2):
    return torch.randn(size, 8, dim, generator=torch.Generator().manual_seed(1))


def seen(size=4, conditions=3, seed=0):
    """Features `(B, C, F)` of goals and, last, of none."""
    rng = np.random.default_rng(seed)
    places = rng.uniform(0, 1, (size, 2))
    goals = [*rng.uniform(0, 1, (conditions - 1, size, 2)), None]
    parts = [goal_features(places, places - 0.01, g, 0.05, WORKSPACE) for g in goals]
    return np.stack(parts, axis=1), np.array([g is not None for g in goals])


class TestWhatItSees:
    def test_without_a_goal_nothing_tells_it(self):
        places = np.full((3, 2), 0.4)
        unknown = goal_features(places, places, None, 0.05, WORKSPACE)
        np.testing.assert_array_equal(unknown, unknown[[0, 0, 0]])
        known = goal_features(places, places, np.eye(3)[:, :2], 0.05, WORKSPACE)
        assert np.abs(known - unknown).max(axis=1).min() > 0.01

    def test_at_its_goal_it_looks_like_none_but_the_flag_tells(self):
        place = np.array([[0.3, 0.7]])
        at_goal = goal_features(place, place, place, 0.05, WORKSPACE)
        np.testing.assert_array_equal(at_goal, goal_features(place, place, None, 0.05, WORKSPACE))
        model, features = make(), torch.from_numpy(at_goal)
        known, unknown = (model.encode(features, torch.tensor([k])) for k in (True, False))
        assert (known - unknown).abs().max() > 1e-3

    @pytest.mark.parametrize("dim", [2, 3])
    def test_finite_and_of_its_size(self, dim):
        rng = np.random.default_rng(0)
        places, before, goals = rng.uniform(-1e3, 1e3, (3, 5, dim))
        found = goal_features(places, before, goals, 0.02, np.array([[-1.0] * dim, [1.0] * dim]))
        assert found.shape == (5, 4 * dim)
        assert found.dtype == np.float32
        assert np.isfinite(found).all()


class TestGuidance:
    @given(
        w=st.lists(st.floats(0, 20), min_size=1, max_size=4),
        share=st.floats(0, 1),
        seed=st.integers(0, 99),
    )
    @settings(max_examples=40, deadline=None)
    def test_weights_are_those_of_the_formula_and_sum_to_one(self, w, share, seed):
        guidance = np.array(w)
        there = np.random.default_rng(seed).random((len(w), 5)) < 0.5
        there[:, 0] = True
        found = guidance_weights(guidance, share, there)
        np.testing.assert_allclose(found.sum(axis=1), 1, atol=1e-9)
        np.testing.assert_allclose(found[:, 0], 1 + guidance)
        np.testing.assert_allclose(found[:, -1], -(1 - share) * guidance)
        others = found[:, 1:-1]
        assert (others[~there] == 0).all()
        np.testing.assert_allclose(others.sum(axis=1), -share * guidance, atol=1e-9)
        for row, own in zip(others, there, strict=True):
            assert np.ptp(row[own]) < 1e-12  # the mean over the other goals

    def test_it_is_the_papers_in_the_noise(self):
        """v̂ of our weights gives the ε̂ of Bronars et al., and the denoised follow."""
        torch.manual_seed(0)
        noisy, alpha = torch.randn(4, 8, 2), 0.3
        v = torch.randn(3, 4, 8, 2)
        w, a = 7.5, 0.9
        weight = torch.from_numpy(guidance_weights(np.array([w]), a, np.ones((1, 1), dtype=bool)))
        guided = torch.einsum("c,cbkd->bkd", weight[0].float(), v)

        def eps(velocity):
            return (1 - alpha) ** 0.5 * noisy + alpha**0.5 * velocity

        wanted = (1 + w) * eps(v[0]) - a * w * eps(v[1]) - (1 - a) * w * eps(v[2])
        torch.testing.assert_close(eps(guided), wanted, atol=1e-4, rtol=1e-4)

    def test_without_weight_the_other_goals_do_not_count(self):
        model = make()
        features, known = seen()
        weights = guidance_weights(np.zeros(4), 0.9, np.ones((4, 1), dtype=bool))
        alone = model.act(features[:, :1], known[:1], np.ones((4, 1)), noise(4))
        np.testing.assert_allclose(model.act(features, known, weights, noise(4)), alone, atol=1e-6)
        weights = guidance_weights(np.full(4, 5.0), 0.9, np.ones((4, 1), dtype=bool))
        assert np.abs(model.act(features, known, weights, noise(4)) - alone).max() > 1e-3

    @pytest.mark.parametrize("weight", [0.0, 10.0, 1e4])
    @pytest.mark.parametrize("steps", [1, 2, 100])
    def test_actions_stay_within_the_limit(self, weight, steps):
        model = make()
        model.scale.fill_(0.4)
        features, known = seen()
        weights = guidance_weights(np.full(4, weight), 0.5, np.ones((4, 1), dtype=bool))
        found = model.act(features, known, weights, noise(4), steps)
        assert found.shape == (4, 8, 2)
        assert np.abs(found).max() <= model.config.limit * (1 + 1e-6)

    def test_the_same_noise_gives_the_same_actions(self):
        model, (features, known) = make(), seen()
        weights = guidance_weights(np.full(4, 2.0), 0.9, np.ones((4, 1), dtype=bool))
        first, second = (model.act(features, known, weights, noise(4)) for _ in range(2))
        np.testing.assert_array_equal(first, second)
        assert np.abs(first - model.act(features, known, weights, -noise(4))).max() > 1e-6


class TestSettings:
    def test_round_trip(self):
        config = GoalPolicyConfig(dim=3, guidance=7.5, guidance_decay=0.6, guidance_share=0.9)
        assert GoalPolicyConfig.from_dict(json.loads(json.dumps(config.to_dict()))) == config
        with pytest.raises(CheckpointError, match="missing or unknown"):
            GoalPolicyConfig.from_dict({"dim": 2})

    @pytest.mark.parametrize(
        "wrong",
        [
            {"guidance": -1}, {"guidance": float("inf")}, {"guidance_decay": 1.1},
            {"guidance_decay": -0.1}, {"guidance_share": 2}, {"chunk": 7}, {"dim": 1},
        ],
        ids=str,
    )  # fmt: skip
    def test_that_no_policy_has(self, wrong):
        with pytest.raises(InvalidInputError, match=next(iter(wrong))):
            GoalPolicyConfig(**wrong)
