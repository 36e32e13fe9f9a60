"""A computation in parts has one result, however its parts are run, and the last ones are kept."""

import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from legibility.errors import InvalidSceneError
from legibility.intent.observer import Observer
from legibility.motion.archive import forget_archives, scene_archive, shortest_curve
from legibility.motion.rough_archive import forget_rough_archives, rough_archive
from legibility.obstacles import Ball
from legibility.parts import cached_parts, finished
from legibility.scene import Scene


class Sums:
    """Sums up to a number, in as many parts, and the numbers that were asked for."""

    def __init__(self, maxsize=2):
        self.begun, self.ended = [], []

        @cached_parts(maxsize=maxsize)
        def total(number):
            """The sum of the numbers up to one of them."""
            self.begun.append(number)
            found = 0
            for i in range(1, number + 1):
                found += i
                yield
            if number > 9:
                raise InvalidSceneError(f"{number} is too many")
            self.ended.append(number)
            return [found]

        self.total = total


def in_parts(parts):
    """The result of a computation and the number of its parts."""
    number = 0
    while True:
        try:
            next(parts)
        except StopIteration as end:
            return end.value, number
        number += 1


class TestCachedParts:
    def test_in_parts_or_at_once(self):
        sums = Sums()
        assert sums.total(4) == [10]
        sums.total.cache_clear()
        assert in_parts(sums.total.parts(4)) == ([10], 4)
        assert sums.begun == [4, 4]

    def test_a_result_that_is_kept_is_not_computed_again(self):
        sums = Sums()
        first = sums.total(4)
        again, parts = in_parts(sums.total.parts(4))
        assert again is first
        assert parts == 0
        assert sums.total(4) is first
        assert sums.begun == [4]

    def test_looks_like_the_function(self):
        total = Sums().total
        assert total.__name__ == "total"
        assert total.__doc__ == "The sum of the numbers up to one of them."
        assert finished(total.__wrapped__(3)) == [6]
        assert len(total) == 0

    @given(st.lists(st.integers(0, 5), max_size=30), st.integers(1, 4), st.booleans())
    @settings(max_examples=30, deadline=None)
    def test_the_last_used_are_kept(self, numbers, maxsize, at_once):
        sums, expected = Sums(maxsize), []
        for number in numbers:
            known = number in expected
            asked = len(sums.begun)
            found = sums.total(number) if at_once else in_parts(sums.total.parts(number))[0]
            assert found == [number * (number + 1) // 2]
            assert len(sums.begun) == asked + (not known)
            expected = [*(x for x in expected if x != number), number][-maxsize:]
            assert len(sums.total) == len(expected)
            assert [(x,) in sums.total for x in range(6)] == [x in expected for x in range(6)]
        sums.total.cache_clear()
        assert len(sums.total) == 0

    def test_goes_to_other_processes_by_its_name(self):
        assert pickle.loads(pickle.dumps(rough_archive)) is rough_archive

    def test_an_error_is_not_kept(self):
        sums = Sums()
        for _ in range(2):
            with pytest.raises(InvalidSceneError, match="10 is too many"):
                sums.total(10)
        assert sums.begun == [10, 10]
        assert len(sums.total) == 0

    def test_what_is_given_up_is_not_kept(self):
        sums = Sums()
        parts = sums.total.parts(4)
        next(parts)
        parts.close()
        assert (4,) not in sums.total
        assert sums.total(4) == [10]

    @given(st.lists(st.integers(0, 3), max_size=40))
    @settings(max_examples=30, deadline=None)
    def test_interleaved(self, order):
        """Others that go on meanwhile, with the same arguments too, do not matter."""
        sums = Sums(1)
        numbers = [3, 3, 5, 1]
        running = [sums.total.parts(number) for number in numbers]
        results = {}

        def go_on(i):
            try:
                next(running[i])
            except StopIteration as end:
                results.setdefault(i, end.value)

        for i in order:
            go_on(i)
        for i in range(4):
            while i not in results:
                go_on(i)
        assert [results[i] for i in range(4)] == [[6], [6], [15], [1]]
        assert len(sums.total) == 1


class TestFinished:
    def test_returns_the_result(self):
        assert finished(Sums().total.parts(3)) == [6]

    @np.errstate(under="raise")
    def test_numbers_may_underflow(self):
        def tiny():
            yield
            return np.exp(np.array([-800.0]))

        assert finished(tiny()) == 0


@pytest.mark.parametrize("cached", [shortest_curve, rough_archive, scene_archive])
def test_what_is_computed_in_parts(cached, coarsely):
    """Archives, in many parts, with bits that do not depend on how they are run."""
    scene = Scene([0, 0.5], [[0.8, 0.6], [1, 0.3]], obstacles=[Ball([0.4, 0.53], 0.08)])
    args = (scene, 0) if cached is shortest_curve else (scene, 0, Observer())

    def numbers(result):
        return result[0] if cached is shortest_curve else result.labels

    forget_archives()
    forget_rough_archives()
    at_once = cached(*args)
    assert args in cached
    forget_archives()
    forget_rough_archives()
    assert args not in cached
    found, parts = in_parts(cached.parts(*args))
    np.testing.assert_array_equal(numbers(found), numbers(at_once))
    assert parts > 5
    assert cached(*args) is found
