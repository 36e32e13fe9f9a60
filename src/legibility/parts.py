"""Long computations in parts, between which a control loop goes on.

A computation in parts is a generator that yields between them and returns its result.
"""

from __future__ import annotations

import functools
from collections import OrderedDict
from collections.abc import Callable, Generator, Hashable
from typing import Any, Generic, TypeVar

import numpy as np

T = TypeVar("T")
Parts = Generator[None, None, T]


def finished(parts: Generator[Any, None, T]) -> T:
    """The result of a computation, all parts at once."""
    with np.errstate(under="ignore"):
        while True:
            try:
                next(parts)
            except StopIteration as end:
                return end.value


class CachedParts(Generic[T]):
    """A function that computes in parts, with its last results; called, it does all at once."""

    def __init__(self, function: Callable[..., Parts[T]], maxsize: int) -> None:
        self._function, self._maxsize = function, maxsize
        self._results: OrderedDict[tuple[Hashable, ...], T] = OrderedDict()
        self.__qualname__ = function.__qualname__
        functools.update_wrapper(self, function)

    def __call__(self, *args: Any) -> T:
        return finished(self.parts(*args))

    def __reduce__(self) -> str:
        """By its name, as functions are."""
        return self.__qualname__

    def __len__(self) -> int:
        """How many results are kept."""
        return len(self._results)

    def __contains__(self, args: tuple[Hashable, ...]) -> bool:
        """Whether the result for these arguments is kept."""
        return args in self._results

    def parts(self, *args: Any) -> Parts[T]:
        """The computation, which is over at once if its result is kept."""
        kept = self._results.pop(args, None)
        result = (yield from self._function(*args)) if kept is None else kept
        self._results[args] = result
        if len(self._results) > self._maxsize:
            self._results.popitem(last=False)
        return result

    def cache_clear(self) -> None:
        """Forget all results."""
        self._results.clear()


def cached_parts(maxsize: int) -> Callable[[Callable[..., Parts[T]]], CachedParts[T]]:
    """Keep the last `maxsize` results of a function that computes in parts."""
    return functools.partial(CachedParts, maxsize=maxsize)
