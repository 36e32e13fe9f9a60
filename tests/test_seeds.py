"""Seeds of different streams, seeds, items and uses have nothing in common."""

import itertools

import numpy as np
import pytest

from legibility.seeds import STREAMS, plan_seeds, stream_seed

USES = ("scene", "archive", "choice", "plan", "demonstration")


def test_no_two_are_alike():
    keys = list(itertools.product(STREAMS, (0, 1, 2**62), (0, 1, 500), USES))
    states = {stream_seed(*key).generate_state(4).tobytes() for key in keys}
    assert len(states) == len(keys)


def test_the_same_key_gives_the_same_seed():
    key = ("train", 3, 5, "archive")
    one, other = (stream_seed(*key).generate_state(4) for _ in range(2))
    np.testing.assert_array_equal(one, other)


def test_seeds_stay_as_they_are():
    """Data and results that are published were drawn from these."""
    assert stream_seed("train", 0, 0, "scene").generate_state(1).tolist() == [3757552657]
    assert stream_seed("evaluation", 1, 7, "archive").generate_state(1).tolist() == [1651111841]
    assert plan_seeds(1, 2, 1) == [3969349372216508706]


@pytest.mark.parametrize("key", [("test", 0, 0, "scene"), ("train", 0, 0, "lunch")])
def test_streams_and_uses_are_those_of_the_lists(key):
    with pytest.raises(ValueError):  # noqa: PT011
        stream_seed(*key)


def test_plans_have_seeds_that_every_generator_takes():
    seeds = [seed for index in range(20) for seed in plan_seeds(0, index, 50)]
    assert len(set(seeds)) == len(seeds)
    assert all(isinstance(seed, int) and 0 <= seed < 2**62 for seed in seeds)
    assert plan_seeds(0, 3, 2) == plan_seeds(0, 3, 50)[:2]
    assert set(plan_seeds(0, 3, 50)).isdisjoint(plan_seeds(0, 3, 50, "demonstration"))
