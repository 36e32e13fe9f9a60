"""Each check returns the value it was given, or names it and what is allowed."""

from dataclasses import dataclass
from decimal import Decimal
from fractions import Fraction

import numpy as np
import pytest
import torch

from legibility import checks
from legibility.errors import InvalidInputError, InvalidSceneError, LegibilityError


def test_finite_array_returns_float64():
    array = checks.finite_array("x", [[1, 2], [3, 4]], ndim=2, last=2)
    assert array.dtype == np.float64
    assert array.tolist() == [[1.0, 2.0], [3.0, 4.0]]


@pytest.mark.parametrize("value", [Fraction(1, 2), Decimal("0.5"), np.float32(0.5), 0.5])
def test_finite_array_takes_every_kind_of_real_number(value):
    assert checks.finite_array("x", [value]).tolist() == [0.5]


@pytest.mark.parametrize(
    "value",
    [
        "1",
        ["1", "2"],
        [1, "2"],
        {},
        {"a": 1},
        [[1], [1, 2]],
        [1 + 2j],
        [True],
        [True, 0.5],
        [np.True_, 1],
        [[1, 2], [False, 2]],
        b"1",
        10**400,
    ],
    ids=repr,
)
def test_finite_array_rejects_what_is_not_numbers(value):
    with pytest.raises(InvalidInputError, match=r"^x must be an array of numbers, got "):
        checks.finite_array("x", value)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, None])
def test_finite_array_rejects_what_is_not_finite(bad):
    with pytest.raises(InvalidInputError, match=r"^x must be finite, got (nan|inf|-inf)$"):
        checks.finite_array("x", [1.0, bad])


def test_finite_array_checks_axes_and_size():
    with pytest.raises(InvalidInputError, match=r"x must have 2 axes, got shape \(3,\)"):
        checks.finite_array("x", [1, 2, 3], ndim=2)
    with pytest.raises(InvalidInputError, match=r"x must have at least 1 axes, got shape \(\)"):
        checks.finite_array("x", 1.0, min_ndim=1)
    with pytest.raises(InvalidInputError, match="x must have 2 or 3 numbers a point"):
        checks.finite_array("x", [1, 2, 3, 4], last=(2, 3))


def test_finite_array_raises_the_error_asked_for():
    with pytest.raises(InvalidSceneError):
        checks.finite_array("x", [np.nan], error=InvalidSceneError)


def test_long_values_are_cut_in_messages():
    with pytest.raises(InvalidInputError) as caught:
        checks.finite_array("x", "a" * 1000)
    assert len(str(caught.value)) < 120


def test_every_error_is_a_legibility_error():
    from legibility import errors

    for name in (n for n, v in vars(errors).items() if isinstance(v, type)):
        assert issubclass(getattr(errors, name), LegibilityError)


@pytest.mark.parametrize("shape", [(2,), (1, 2), (0, 2), (3, 1, 2), (5, 3)])
def test_trajectory_array_rejects(shape):
    with pytest.raises(InvalidInputError, match=r"^trajectory must have"):
        checks.trajectory_array(np.zeros(shape), 2)


def test_trajectory_array_of_any_dimension():
    assert checks.trajectory_array(np.zeros((4, 2, 3))).shape == (4, 2, 3)


@pytest.mark.parametrize("target", [0, 2, np.int64(1), np.array(1), np.uint8(2), torch.tensor(1)])
def test_target_index(target):
    index = checks.target_index(target, 3)
    assert index == target
    assert type(index) is int


@pytest.mark.parametrize(
    "target",
    [-1, 3, 1.0, np.float64(1), np.array(1.0), np.nan, "1", None, True, np.True_, [0],
     np.array([0]), torch.tensor(1.0), torch.tensor([0]), torch.tensor(True)],
)  # fmt: skip
def test_target_index_rejects(target):
    with pytest.raises(InvalidInputError, match=r"^target must be .*, got "):
        checks.target_index(target, 3)


@pytest.mark.parametrize("levels", [-1, 1, 0.25, [-1, 0, 1], np.array(0.5)])
def test_legibility_levels(levels):
    np.testing.assert_array_equal(checks.legibility_levels(levels), levels)


def test_legibility_levels_take_rounding_for_an_end():
    steps = np.arange(-1, 1.05, 0.05)
    assert steps[-1] > 1
    levels = checks.legibility_levels(steps)
    assert (levels[0], levels[-1]) == (-1, 1)
    np.testing.assert_allclose(levels, steps, rtol=0, atol=1e-12)
    assert steps[-1] > 1  # the caller's array is as it was


def test_legibility_levels_of_a_tensor():
    levels = torch.tensor([-1.0, 0.5], requires_grad=True)
    assert checks.legibility_levels(levels).tolist() == [-1, 0.5]


@pytest.mark.parametrize("levels", [1 + 1e-8, 1.001, [-1.2, 0], [], [[0.5]], np.nan, "0.5", None])
def test_legibility_levels_rejects(levels):
    with pytest.raises(InvalidInputError, match=r"^legibility must"):
        checks.legibility_levels(levels)


@pytest.mark.parametrize("value", [0, -1, np.nan, np.inf, "1", None, [1.0], True])
def test_positive_rejects(value):
    with pytest.raises(InvalidInputError, match=r"^sigma must"):
        checks.positive("sigma", value)


@pytest.mark.parametrize("value", [-0.1, 1.1, np.nan, "1", None, [0.5], True])
def test_bounded_rejects(value):
    with pytest.raises(InvalidInputError, match=r"^fraction must"):
        checks.bounded("fraction", value, 0, 1)


def test_bounded_includes_both_ends_and_may_be_open_above():
    assert [checks.bounded("x", v, 0, 1) for v in (0, 0.5, 1)] == [0, 0.5, 1]
    assert checks.bounded("x", 1e300, 0) == 1e300
    with pytest.raises(InvalidInputError, match="x must be a number of at least 0, got -1"):
        checks.bounded("x", -1, 0)


@pytest.mark.parametrize("value", [0, 1.0, np.float64(2), np.array([2]), "1", None, True, np.nan])
def test_count_rejects(value):
    with pytest.raises(InvalidInputError, match="n must be an integer of at least 1, got "):
        checks.count("n", value)


def test_random_seed():
    assert checks.random_seed("seed", np.array(3)) == 3
    for seed in (-1, 2**63, 1.0, None, True):
        with pytest.raises(InvalidInputError, match=r"^seed must be"):
            checks.random_seed("seed", seed)


def test_no_seed_is_a_new_one_each_time():
    assert checks.seed_or_entropy("seed", 3) == 3
    assert checks.seed_or_entropy("seed", None) != checks.seed_or_entropy("seed", None)
    with pytest.raises(InvalidInputError, match=r"^seed must be"):
        checks.seed_or_entropy("seed", -1)


def test_messages_are_one_line():
    with pytest.raises(InvalidInputError) as caught:
        checks.count("n", np.eye(3))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("goals", [[], [[0, 0]], [0, 0], [[0, np.nan], [1, 1]], "ab"])
def test_goals_array_rejects(goals):
    with pytest.raises(InvalidInputError, match=r"^goals must"):
        checks.goals_array(goals)


def test_prior_array_is_normalised_and_uniform_by_default():
    np.testing.assert_allclose(checks.prior_array(None, 4), 0.25)
    np.testing.assert_allclose(checks.prior_array([1, 3], 2), [0.25, 0.75])


@pytest.mark.parametrize("prior", [[1], [1, 0], [1, -1], [1, 1, 1], [[1, 1]], [1, np.nan], "ab", 1])
def test_prior_array_rejects(prior):
    with pytest.raises(InvalidInputError, match=r"^prior must"):
        checks.prior_array(prior, 2)


@pytest.mark.parametrize(
    "posterior",
    [[0.5, 0.5], [[0.5, 0.5]], [[1.0], [1.0]], [[0.5, 0.6], [0.5, 0.5]], [[1.5, -0.5]] * 2, "ab"],
)
def test_posterior_array_rejects(posterior):
    with pytest.raises(InvalidInputError, match=r"^posterior must"):
        checks.posterior_array(posterior)


@dataclass(frozen=True)
class Settings:
    kind: str = checks.choice("plain", ("plain", "fancy"))
    parts: tuple[str, ...] = checks.choice((), ("left", "right"))
    arm: str | None = checks.choice(None, ("panda",), more="FILE")
    env: str | None = checks.choice(None, ("2d", "panda"))

    def __post_init__(self):
        checks.check_choices(self)


@pytest.mark.parametrize(
    "given", [{}, {"kind": "fancy"}, {"parts": ("right", "left")}, {"arm": "a.yaml"}, {"env": "2d"}]
)
def test_choices(given):
    found = Settings(**given)
    assert all(getattr(found, name) == value for name, value in given.items())


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"kind": "fanci"}, "kind must be one of plain, fancy, got 'fanci'; did you mean fancy?"),
        ({"kind": None}, "kind must be one of plain, fancy, got None"),
        ({"kind": 3}, "kind must be one of plain, fancy, got 3"),
        ({"parts": ("left", "up")}, "parts must be one of left, right, got 'up'"),
        ({"env": "x"}, "env must be one of 2d, panda, got 'x'"),
    ],
)
def test_wrong_choices(given, message):
    with pytest.raises(InvalidInputError) as caught:
        Settings(**given)
    assert str(caught.value) == message


def test_suggestions_by_other_spellings():
    assert checks.did_you_mean("dail", {"dial": "evaluate dial"}) == "; did you mean evaluate dial?"
    assert checks.did_you_mean("zzz", {"dial": "evaluate dial"}) == ""
