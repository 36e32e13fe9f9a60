import sys

import pytest

from legibility.bench.process import process_metrics
from legibility.errors import WorkerError


def test_a_process_that_plans():
    metrics = process_metrics("block-reach-2d", "torch")
    memory = ["memory_mb"] if sys.platform == "linux" else []
    assert list(metrics) == ["import_ms", "load_ms", "first_plan_ms", *memory]
    assert all(value > 0 for value in metrics.values())
    assert metrics.get("memory_mb", 200) < 2000


def test_a_process_that_fails():
    with pytest.raises(WorkerError, match=r"loads none on torch failed: .*no weights 'none'"):
        process_metrics("none", "torch")
