import numpy as np
import pytest
import torch

from legibility.evaluation.timing import figure, interleaved, on_threads, power_law, rate, timed


@pytest.mark.parametrize("exponent", [-1.0, 0.0, 0.37, 1.0, 2.0])
def test_power_law_is_exact(exponent):
    sizes = [1, 3, 16, 1024]
    assert power_law(sizes, 2.5 * np.array(sizes) ** exponent) == pytest.approx(exponent, abs=1e-12)


def test_works_take_turns_after_a_warm_up():
    calls = []
    works = {name: timed(lambda n=name: calls.append(n), 2) for name in "ab"}
    times = interleaved(works, 1e-9, 3)
    assert calls == list("ab" * 4)
    assert [len(part) for part in times["a"]] == [1, 1, 1]
    calls.clear()
    interleaved(works, 1e-9, 1, warm_up=False)
    assert calls == list("ab")


def test_a_round_lasts():
    times = interleaved({"a": lambda: [0.0]}, 0.01, 1)
    assert len(times["a"][0]) > 1


def test_figure():
    assert figure([[3.0], [1.0, 2.0]], 10) == {"median": 20, "interval": [10, 30], "calls": 3}
    assert rate([[0.5], [0.25]], 3) == {"median": 9, "interval": [6, 12], "calls": 2}


def test_interval_holds_the_median_as_often_as_it_says():
    rng = np.random.default_rng(0)
    held = 0
    for _ in range(400):
        low, high = figure([rng.exponential(size=30)])["interval"]
        held += low <= np.log(2) <= high
    assert 0.93 <= held / 400 <= 0.99


def test_threads_are_put_back():
    before = torch.get_num_threads()
    with on_threads(before + 1):
        assert torch.get_num_threads() == before + 1
    assert torch.get_num_threads() == before
