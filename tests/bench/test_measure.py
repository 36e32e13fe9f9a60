"""Timings are fair to all works, and a fresh process says what it took."""

import sys

import numpy as np
import pytest

from legibility.bench.measure import interleaved, process_metrics, summary, timed
from legibility.errors import WorkerError


def test_works_take_turns_after_a_warm_up():
    calls = []
    works = [timed(lambda n=name: calls.append(n)) for name in "ab"]
    times = interleaved(works, 1e-9, 3)
    assert calls == list("ab" * 4)
    assert [len(durations) for durations in times] == [3, 3]
    calls.clear()
    interleaved(works, 1e-9, 1, warm_up=False)
    assert calls == list("ab")


def test_a_round_lasts():
    assert len(interleaved([lambda: [0.0]], 0.01, 1)[0]) > 1


def test_summary():
    assert summary([30.0, 10.0, 20.0]) == {"median": 20, "low": 10, "high": 30, "calls": 3}


def test_interval_holds_the_median_as_often_as_it_says():
    rng = np.random.default_rng(0)
    intervals = [summary(rng.exponential(size=30)) for _ in range(400)]
    held = np.mean([i["low"] <= np.log(2) <= i["high"] for i in intervals])
    assert 0.93 <= held <= 0.99


def test_a_process_that_plans():
    metrics = process_metrics("block-reach-2d", "torch")
    memory = ["memory_mb"] if sys.platform == "linux" else []
    assert list(metrics) == ["import_ms", "load_ms", "first_plan_ms", *memory]
    assert all(value > 0 for value in metrics.values())
    assert metrics.get("memory_mb", 200) < 2000


def test_a_process_that_fails():
    with pytest.raises(WorkerError, match=r"loads none on torch failed: .*no weights 'none'"):
        process_metrics("none", "torch")
