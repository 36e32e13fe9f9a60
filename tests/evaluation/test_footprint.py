import sys

import pytest

from legibility.errors import LegibilityError
from legibility.evaluation.footprint import footprint


def test_a_process_that_plans():
    found = footprint("torch", "plan", 1, model="block-reach-2d", backend="torch", batches=[1, 2])
    steps = ["code", "load", "plan 1", "plan 2"]
    assert list(found["seconds"]) == ["above", "import", *steps]
    assert all(seconds > 0 for seconds in found["seconds"].values())
    if sys.platform == "linux":
        assert list(found["megabytes"]) == steps
        memory = list(found["megabytes"].values())
        assert memory == sorted(memory)
        assert 0 < memory[-1] < 1000


def test_a_process_that_fails():
    with pytest.raises(LegibilityError, match=r"measures archive failed: KeyError: 'dim'"):
        footprint("sys", "archive", 1)
