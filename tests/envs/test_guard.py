"""What `safe_actions` returns can be sent, whatever it was given."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from legibility.envs.block_reach_2d import BlockReach2DVector
from legibility.envs.fleet import safe_actions
from legibility.scene import DEFAULT_WORKSPACE

LIMIT, LAG = 0.05, 0.3
WORKSPACE = np.array(DEFAULT_WORKSPACE[2])
LOW, HIGH = WORKSPACE
MIDDLE, REST = np.full(2, 0.5), np.zeros(2)

anything = st.floats(width=64) | st.sampled_from([np.inf, -np.inf, np.nan, 1e308, -1e308, 5e-324])


def safe(actions, positions=MIDDLE, velocities=REST, limit=LIMIT):
    return safe_actions(actions, positions, velocities, WORKSPACE, limit, LAG)


@given(
    st.integers(0, 2**32 - 1),
    st.lists(arrays(float, (8, 2), elements=anything), min_size=1, max_size=4),
    st.booleans(),
)
def test_a_guarded_robot_never_touches_a_wall(seed, wild, extreme):
    """Whatever its gain and lag, even those at the ends of their ranges, and whatever is asked."""
    rng = np.random.default_rng(seed)
    env = BlockReach2DVector(8)
    gain, lag = rng.uniform(0, 1, 8), rng.uniform(0, LAG, 8)
    if extreme:
        gain, lag = rng.choice([0.5, 1], 8), rng.choice([0, LAG], 8)
    env.reset(seed=seed, options={"gain": gain, "lag": lag})
    way = rng.choice([-1, 0, 1], (8, 2))
    for step in range(80):
        if step % 20 == 0:  # to a wall, then back and forth, then something wild
            way = rng.choice([-1, 1], (8, 2))
        actions = way * rng.choice([0.01, 0.05, 1.0], (8, 1)) * rng.choice([1, 1, 1, -1], (8, 2))
        if step % 7 == 0:
            actions = wild[step % len(wild)]
        sent = safe(actions, env.positions, env.velocities)
        assert np.isfinite(sent).all()
        assert (np.abs(sent) <= LIMIT).all()
        *_, info = env.step(sent)
        assert not info["wall_contact"].any()
        assert ((env.positions >= LOW) & (env.positions <= HIGH)).all()


@pytest.mark.parametrize("lag", [0.0, 0.3])
def test_a_wall_can_be_reached(lag):
    env = BlockReach2DVector(1)
    env.reset(seed=0, options={"gain": 0.8, "lag": lag})
    for _ in range(150):
        env.step(safe([[1.0, -1.0]], env.positions, env.velocities))
    assert env.positions[0] == pytest.approx([1.1, -0.1], abs=1e-6)


@given(
    arrays(float, (3, 5, 2), elements=anything),
    arrays(float, (3, 5, 2), elements=st.floats(-0.1, 1.1)),
    arrays(float, (3, 5, 2), elements=st.floats(-0.05, 0.05)),
    st.floats(1e-6, 10),
)
def test_finite_and_within_the_limit(actions, positions, velocities, limit):
    sent = safe(actions, positions, velocities, limit)
    assert sent.shape == actions.shape
    assert np.isfinite(sent).all()
    assert (np.abs(sent) <= limit).all()


@given(
    arrays(float, (4, 2), elements=st.floats(-LIMIT, LIMIT)),
    arrays(float, (4, 2), elements=st.floats(0, 1)),
    arrays(float, (4, 2), elements=st.floats(-LIMIT, LIMIT)),
)
def test_harmless_actions_pass_unchanged(actions, positions, velocities):
    assert safe(actions, positions, velocities).tolist() == actions.tolist()


@given(st.floats(0, 2 * np.pi), st.floats(0.1, 1e300))
def test_long_actions_keep_their_direction(angle, length):
    way = np.array([np.cos(angle), np.sin(angle)])
    sent = safe(length * way)
    assert sent / np.linalg.norm(sent) == pytest.approx(way, abs=1e-9)
    assert np.abs(sent).max() == pytest.approx(LIMIT)


@pytest.mark.parametrize(
    ("action", "sent"),
    [
        ([np.nan, 0.02], [0, 0.02]),
        ([np.inf, 0.02], [LIMIT, 0]),
        ([-np.inf, np.inf], [-LIMIT, LIMIT]),
        ([1e308, -1e308], [LIMIT, -LIMIT]),
        ([1, -2], [LIMIT / 2, -LIMIT]),
    ],
)
def test_what_is_not_a_number(action, sent):
    assert safe(action) == pytest.approx(np.array(sent))


def test_along_a_wall_only_what_leads_out_is_lost():
    assert safe([0.04, 0.03], np.array([0.5, 1.1])).tolist() == [0.04, 0]
    assert safe([0.04, -0.03], np.array([0.5, 1.1])).tolist() == [0.04, -0.03]
    assert safe([0.04, 0.03], np.array([0.5, 1.08])) == pytest.approx(np.array([0.04, 0.02]))


def test_brakes_before_a_wall():
    fast = np.array([0.04, 0])
    sent = safe([0.05, 0], np.array([1.08, 0.5]), fast)
    assert sent == pytest.approx(np.array([0.02 - 0.3 / 0.7 * 0.04, 0]))
    assert safe([0, 0], np.array([1.095, 0.5]), fast)[0] < 0


def test_three_dimensions():
    workspace = np.array(DEFAULT_WORKSPACE[3])
    sent = safe_actions([0, 0, -1], np.array([0, 0, 0.03]), np.zeros(3), workspace, 0.05, 0.3)
    assert sent == pytest.approx(np.array([0, 0, -0.01]))
