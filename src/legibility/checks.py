"""Checks of arguments, shared by all modules: each returns the value as an array or raises."""

import dataclasses
import operator
import secrets
from collections.abc import Iterable, Mapping
from numbers import Integral
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .errors import InvalidInputError

Array = NDArray[np.float64]

_ROUNDING = 1e-9
"""Largest excess of ℓ beyond ±1, such as that of the last of `np.arange(-1, 1.05, 0.05)`."""


def finite_array(
    name: str,
    value: ArrayLike,
    *,
    ndim: int | None = None,
    min_ndim: int = 0,
    last: int | tuple[int, ...] | None = None,
    error: type[InvalidInputError] = InvalidInputError,
) -> Array:
    """`value` as a float64 array of finite numbers, of `ndim` axes, the last of size `last`.

    PyTorch tensors of any device are read without their gradient. Text, complex numbers and truth
    values, which NumPy would convert, are refused.
    """
    try:
        plain = type(value) is np.ndarray  # whose dtype says it all
        array = np.asarray(value if plain else _detached(value))
        if value is None:
            raise TypeError(value)
        if array.dtype.kind not in "iufO" or (not plain and _has_truth_value(value)):
            raise TypeError(array.dtype)
        array = array.astype(np.float64, copy=False)
    except (TypeError, ValueError, OverflowError) as cause:
        raise error(f"{name} must be an array of numbers, got {short(value)}") from cause
    if (ndim is not None and array.ndim != ndim) or array.ndim < min_ndim:
        wanted = f"{ndim}" if ndim is not None else f"at least {min_ndim}"
        raise error(f"{name} must have {wanted} axes, got shape {array.shape}")
    sizes = (last,) if isinstance(last, int) else last
    if sizes and array.shape[-1] not in sizes:
        wanted = " or ".join(map(str, sizes))
        raise error(f"{name} must have {wanted} numbers a point, got shape {array.shape}")
    if not (finite := np.isfinite(array)).all():
        raise error(f"{name} must be finite, got {array[~finite].flat[0]}")
    return array


def trajectory_array(value: ArrayLike, dim: int | None = None, name: str = "trajectory") -> Array:
    """A trajectory `(..., T, D)` with at least two points, of any D if `dim` is not given."""
    array = finite_array(name, value, min_ndim=2, last=dim)
    if array.shape[-2] < 2:
        raise InvalidInputError(f"{name} must have at least 2 points, got shape {array.shape}")
    return array


def goals_array(value: ArrayLike) -> Array:
    """At least two goals, `(G, D)`."""
    goals = finite_array("goals", value, ndim=2)
    if len(goals) < 2:
        raise InvalidInputError(f"goals must be at least 2, got {len(goals)}")
    return goals


def prior_array(value: ArrayLike | None, num_goals: int) -> Array:
    """P(g) before any motion, `(G,)`, above 0 and summing to 1; uniform if `value` is None."""
    prior = np.ones(num_goals) if value is None else finite_array("prior", value, ndim=1)
    if prior.shape != (num_goals,) or (prior <= 0).any():
        raise InvalidInputError(
            f"prior must be {num_goals} numbers above 0, got {short(prior.tolist())}"
        )
    prior = prior / prior.max()
    return prior / prior.sum()


def posterior_array(value: ArrayLike) -> Array:
    """P(g) over time, `(..., T, G)`: at least two times and two goals, each time summing to 1."""
    posterior = finite_array("posterior", value, min_ndim=2)
    if min(posterior.shape[-2:]) < 2:
        raise InvalidInputError(
            f"posterior must have at least 2 times and 2 goals, got shape {posterior.shape}"
        )
    if (posterior < 0).any() or (np.abs(posterior.sum(-1) - 1) > 1e-6).any():
        raise InvalidInputError("posterior must be probabilities that sum to 1 over the goals")
    return posterior


def target_index(target: Any, num_goals: int) -> int:
    """A goal's index in `[0, num_goals)`; negative indices are not accepted."""
    index = _integer(target)
    if index is None:
        raise InvalidInputError(f"target must be an integer, got {short(target)}")
    if not 0 <= index < num_goals:
        raise InvalidInputError(
            f"target must be a goal's index from 0 to {num_goals - 1}, got {index}"
        )
    return index


def legibility_levels(value: ArrayLike) -> Array:
    """ℓ, a number or `(B,)`, in [−1, 1]; a rounding error beyond an end becomes the end."""
    levels = finite_array("legibility", value)
    if levels.ndim > 1 or levels.size == 0:
        raise InvalidInputError(
            f"legibility must be a number or a list of numbers, got shape {levels.shape}"
        )
    if np.abs(levels).max() > 1 + _ROUNDING:
        bad = levels.flat[np.abs(levels).argmax()]
        raise InvalidInputError(f"legibility must lie in [-1, 1], got {bad:.8g}")
    return np.asarray(np.clip(levels, -1, 1))


def levels_for_each(value: ArrayLike, size: int) -> Array:
    """ℓ `(size,)`, from one number or `size` of them."""
    levels = legibility_levels(value)
    if levels.ndim and len(levels) != size:
        raise InvalidInputError(f"legibility must be one number or {size}, got {len(levels)}")
    return np.broadcast_to(levels, (size,)).copy()


def for_each(name: str, value: Any, size: int) -> list[Any]:
    """`size` values, from one for all or a list of them."""
    if np.ndim(_detached(value)) == 0:
        return [value] * size
    if len(value) != size:
        raise InvalidInputError(f"{name} must be one for all or {size}, got {len(value)}")
    return list(value)


def positive(name: str, value: Any) -> float:
    """A finite number above zero."""
    number = finite_array(name, value)
    if number.ndim or number <= 0:
        raise InvalidInputError(f"{name} must be a number above 0, got {short(value)}")
    return float(number)


def bounded(name: str, value: Any, low: float, high: float = np.inf) -> float:
    """A finite number in [low, high]."""
    number = finite_array(name, value)
    if number.ndim or not low <= number <= high:
        wanted = f"of at least {low:g}" if np.isinf(high) else f"from {low:g} to {high:g}"
        raise InvalidInputError(f"{name} must be a number {wanted}, got {short(value)}")
    return float(number)


FRAMES = ("world", "base")
"""Where positions are measured: the scene's frame, or the arm's base."""


def frame_name(frame: Any, arm: object | None) -> str:
    """One of `FRAMES`; base needs an arm."""
    if arm is None:
        return one_of("frame", frame, FRAMES[:1], more=" without an arm")
    return one_of("frame", frame, FRAMES)


def one_of(name: str, value: Any, allowed: Iterable[Any], *, more: str = "") -> Any:
    """One of the `allowed` values; the error names them, what `more` there is, and the nearest."""
    choices = tuple(allowed)
    if isinstance(value, str | Integral) and value in choices:
        return value
    raise InvalidInputError(
        f"{name} must be one of {', '.join(map(str, choices))}{more}, got {short(value)}"
        f"{did_you_mean(value, map(str, choices))}"
    )


def did_you_mean(word: Any, known: Iterable[str] | Mapping[str, str]) -> str:
    """The end of an error about a `word` that resembles a `known` one; empty if it does not.

    Of a mapping the values are suggested for the keys.
    """
    import difflib

    names = known if isinstance(known, Mapping) else {name: name for name in known}
    near = difflib.get_close_matches(str(word).lower(), names, 1)
    return f"; did you mean {names[near[0]]}?" if near else ""


def choice(default: Any, allowed: Iterable[Any], *, more: str = "") -> Any:
    """A field of a dataclass of settings that takes one of the `allowed` values.

    A field of tuples takes several, and None may stand for a value that is not given. The command
    line shows the values; `check_choices` refuses others, unless there are `more`: FILE, say.
    """
    metadata = {"allowed": tuple(allowed), "more": more}
    return dataclasses.field(default=default, metadata=metadata)


def check_choices(settings: Any) -> None:
    """Raise unless each `choice` of a dataclass is one of its values, or its default."""
    for field in dataclasses.fields(settings):
        value = getattr(settings, field.name)
        if "allowed" not in field.metadata or field.metadata["more"] or value is field.default:
            continue
        for entry in value if isinstance(value, tuple) else (value,):
            one_of(field.name, entry, field.metadata["allowed"])


def count(name: str, value: Any, *, low: int = 1) -> int:
    """An integer of at least `low`."""
    number = _integer(value)
    if number is None or number < low:
        raise InvalidInputError(f"{name} must be an integer of at least {low}, got {short(value)}")
    return number


def random_seed(name: str, value: Any) -> int:
    """An integer in [0, 2⁶³), which every generator here takes."""
    seed = count(name, value, low=0)
    if seed >= 2**63:
        raise InvalidInputError(f"{name} must be below 2**63, got {value}")
    return seed


def seed_or_entropy(name: str, value: Any) -> int:
    """`random_seed`; None draws a seed from the system's entropy, as NumPy and Gymnasium do."""
    return secrets.randbits(63) if value is None else random_seed(name, value)


def _detached(value: Any) -> Any:
    """A PyTorch tensor without its gradient and on the CPU; lists of tensors likewise."""
    if isinstance(value, list | tuple):
        return [_detached(item) for item in value]
    return value.detach().cpu() if hasattr(value, "detach") else value


def _has_truth_value(value: Any) -> bool:
    """Whether `value` is or holds True or False, which NumPy would read as 1 or 0."""
    if isinstance(value, list | tuple):
        return any(map(_has_truth_value, value))
    return isinstance(value, bool) or "bool" in str(getattr(value, "dtype", ""))


def _integer(value: Any) -> int | None:
    """The integer of a number or a zero-dimensional array or tensor; None if it is not one."""
    if _has_truth_value(value) or getattr(value, "ndim", 0):
        return None
    try:
        return operator.index(value)
    except TypeError:
        return None


def short(value: Any) -> str:
    """A value in a message, cut if it is long."""
    text = " ".join(repr(value).split())
    return text if len(text) <= 60 else text[:57] + "..."
