"""Stage 2: what it sees, in which frame, and what it says."""

import dataclasses
import json

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from legibility.errors import CheckpointError, InvalidInputError
from legibility.models.configuration import PathPolicyConfig
from legibility.models.diffusion import noise_schedule
from legibility.models.path_policy import Observation, PathPolicy
from legibility.motion.tracking import PathTracker

SMALL = {"channels": (8, 16), "condition": 16}
EVERYWHERE = {dim: np.array([[-9.0] * dim, [9.0] * dim]) for dim in (2, 3)}


def make(dim=2, **changes):
    torch.manual_seed(0)
    model = PathPolicy(PathPolicyConfig(**{"dim": dim, **SMALL, **changes}))
    torch.nn.init.normal_(model.unet.outlet.weight, std=0.3)
    torch.nn.init.normal_(model.no_path)
    model.signal.copy_(noise_schedule(model.config.diffusion_steps))
    return model.eval()


def situation(dim, seed, size=5):
    """Paths, where robots are on them, where they were, and how far they have come."""
    rng = np.random.default_rng(seed)
    paths = np.cumsum(rng.normal(0, 0.08, (size, 10, dim)) + 0.05, axis=1)
    progress = rng.uniform(0, 0.6, size)
    beside, before = rng.normal(0, 0.01, (2, size, dim))
    return paths, progress, beside, before


def observe(paths, progress, beside, before, with_path=True, turn=None, shift=0.0):
    dim = paths.shape[-1]
    turn = np.eye(dim) if turn is None else turn
    tracker = PathTracker(paths @ turn.T + shift, 0.05, EVERYWHERE[dim])
    tracker.progress = progress * tracker.lengths
    places = tracker.ahead(np.zeros(1))[:, 0] + beside @ turn.T
    return Observation.of(
        places, places + before @ turn.T, paths[:, -1] @ turn.T + shift, 0.05,
        tracker if with_path else None,
    )  # fmt: skip


def turning(dim, angle):
    c, s = np.cos(angle), np.sin(angle)
    turn = np.eye(dim)
    turn[:2, :2] = [[c, -s], [s, c]]
    return turn


@pytest.mark.parametrize("with_path", [True, False])
@pytest.mark.parametrize("dim", [2, 3])
@given(seed=st.integers(0, 999), angle=st.floats(0, 6.28), shift=st.floats(-1, 1))
@settings(max_examples=15, deadline=None)
def test_turned_and_moved_it_sees_the_same_and_acts_turned(dim, with_path, seed, angle, shift):
    parts, turn = situation(dim, seed), turning(dim, angle)
    plain = observe(*parts, with_path=with_path)
    other = observe(*parts, with_path=with_path, turn=turn, shift=shift)
    np.testing.assert_allclose(other.features, plain.features, atol=1e-4)
    np.testing.assert_allclose(other.rotation, plain.rotation @ turn.T, atol=1e-6)
    model = make(dim)
    np.testing.assert_allclose(model.act(other), model.act(plain) @ turn.T, atol=1e-4)


def test_without_the_path_only_the_goal_counts():
    paths, *rest = situation(2, 3)
    bent = paths.copy()
    bent[:, 1:-1] += 0.1
    goals, places = paths[:, -1], paths[:, 0]
    del rest
    seen = [Observation.of(places, places, goals, 0.05, None) for _ in (paths, bent)]
    np.testing.assert_array_equal(seen[0].features, seen[1].features)
    assert not seen[0].has_path.any()
    trackers = [PathTracker(p, 0.05, EVERYWHERE[2]) for p in (paths, bent)]
    seen = [Observation.of(places, places, goals, 0.05, t) for t in trackers]
    assert np.abs(seen[0].features - seen[1].features).max() > 0.01


@pytest.mark.parametrize("dim", [2, 3])
def test_finite_where_there_is_nothing_to_see(dim):
    """At the goal, at rest, with a path of no length."""
    point = np.full((1, dim), 0.3)
    tracker = PathTracker(np.full((1, 10, dim), 0.3), 0.05, EVERYWHERE[dim])
    for along in (tracker, None):
        seen = Observation.of(point, point, point, 0.05, along)
        assert np.isfinite(seen.features).all()
        np.testing.assert_allclose(seen.rotation[0] @ seen.rotation[0].T, np.eye(dim), atol=1e-12)


def test_far_away_is_compressed():
    place, goal = np.zeros((1, 2)), np.array([[1e6, 0.0]])
    assert np.abs(Observation.of(place, place, goal, 0.05, None).features).max() < 20


def test_acts_without_chance():
    model, seen = make(), observe(*situation(2, 0))
    found = model.act(seen)
    assert found.shape == (5, 8, 2)
    np.testing.assert_array_equal(found, model.act(seen))
    for steps in (1, 3, 100):
        assert np.isfinite(model.act(seen, steps)).all()


def test_settings_round_trip():
    config = PathPolicyConfig(dim=3, limit=0.03, channels=(16, 24, 32), execute=2)
    assert PathPolicyConfig.from_dict(json.loads(json.dumps(config.to_dict()))) == config
    with pytest.raises(CheckpointError, match="missing or unknown"):
        PathPolicyConfig.from_dict({"dim": 2})


@pytest.mark.parametrize(
    "wrong",
    [
        {"dim": 4}, {"limit": 0}, {"limit": float("nan")}, {"chunk": 7}, {"chunk": 0},
        {"execute": 9}, {"execute": 0}, {"channels": ()}, {"channels": (7,)}, {"condition": 0},
        {"diffusion_steps": 0}, {"sampling_steps": 101}, {"sampling_steps": 0},
    ],
    ids=str,
)  # fmt: skip
def test_settings_that_no_policy_has(wrong):
    with pytest.raises(InvalidInputError, match=next(iter(wrong))):
        PathPolicyConfig(**wrong)


def test_settings_are_frozen():
    with pytest.raises(dataclasses.FrozenInstanceError):
        PathPolicyConfig().dim = 3  # pyright: ignore
