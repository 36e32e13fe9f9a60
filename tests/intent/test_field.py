"""Laws of the information potential field."""

import math
import warnings
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from legibility import Field, InformationPotentialField
from legibility.errors import InvalidInputError

seeds = st.integers(0, 2**32 - 1)
dims = st.sampled_from([2, 3])
counts = st.integers(2, 8)


def random_field(rng, num_goals, dim, sigma=0.15):
    prior = rng.uniform(0.2, 1, num_goals)
    return InformationPotentialField(rng.uniform(0, 1, (num_goals, dim)), sigma, prior)


def rotation(rng, dim):
    return np.linalg.qr(rng.normal(size=(dim, dim)))[0]


def exact_potential(x, goals, sigma, prior, target):
    """−log P(g*|x) with the exponents in exact fractions and the small terms summed first."""

    def half_square(goal):
        return sum((Fraction(a) - Fraction(b)) ** 2 for a, b in zip(x, goal, strict=True)) / 2

    own = half_square(goals[target])
    odds = [
        float((own - half_square(goal)) / Fraction(sigma) ** 2) + math.log(p / prior[target])
        for goal, p in zip(goals, prior, strict=True)
    ]
    del odds[target]
    top = max(odds)
    against = top + math.log(math.fsum(math.exp(o - top) for o in odds))
    return (
        against + math.log1p(math.exp(-against)) if against > 0 else math.log1p(math.exp(against))
    )


@given(seeds, counts, dims)
def test_posterior_is_a_distribution(seed, num_goals, dim):
    rng = np.random.default_rng(seed)
    posterior = random_field(rng, num_goals, dim).posterior(rng.normal(size=(20, dim)))
    assert posterior.shape == (20, num_goals)
    assert (posterior >= 0).all()
    np.testing.assert_allclose(posterior.sum(-1), 1, rtol=1e-12)


@given(seeds, counts, dims)
def test_posterior_is_bayes_rule_with_gaussians(seed, num_goals, dim):
    rng = np.random.default_rng(seed)
    field = random_field(rng, num_goals, dim)
    x = rng.uniform(0, 1, (20, dim))
    likelihood = np.exp(-((x[:, None] - field.goals) ** 2).sum(-1) / (2 * field.sigma**2))
    joint = likelihood * field.prior
    np.testing.assert_allclose(field.posterior(x), joint / joint.sum(-1, keepdims=True), atol=1e-12)


@given(seeds, counts, dims)
def test_potential_is_minus_the_log_posterior(seed, num_goals, dim):
    rng = np.random.default_rng(seed)
    field = random_field(rng, num_goals, dim)
    x = rng.normal(size=(4, 5, dim))
    for target in range(num_goals):
        np.testing.assert_allclose(
            field.potential(x, target), -field.log_posterior(x)[..., target], rtol=1e-9, atol=1e-9
        )


@given(seeds, counts, dims)
def test_moving_turning_and_scaling_the_world_change_nothing(seed, num_goals, dim):
    rng = np.random.default_rng(seed)
    field = random_field(rng, num_goals, dim)
    x = rng.normal(size=(10, dim))
    turn, shift, scale = rotation(rng, dim), rng.normal(size=dim), rng.uniform(0.1, 10)

    def moved(points):
        return scale * points @ turn.T + shift

    other = InformationPotentialField(moved(field.goals), scale * field.sigma, field.prior)
    np.testing.assert_allclose(
        other.potential(moved(x), 0), field.potential(x, 0), rtol=1e-8, atol=1e-12
    )


@given(seeds, counts, dims)
def test_the_order_of_the_goals_does_not_matter(seed, num_goals, dim):
    rng = np.random.default_rng(seed)
    field = random_field(rng, num_goals, dim)
    x = rng.normal(size=(10, dim))
    order = rng.permutation(num_goals)
    other = InformationPotentialField(field.goals[order], field.sigma, field.prior[order])
    np.testing.assert_allclose(other.posterior(x), field.posterior(x)[:, order], atol=1e-12)
    np.testing.assert_allclose(
        other.potential(x, 0), field.potential(x, int(order[0])), rtol=1e-9, atol=1e-12
    )


@given(seeds, counts, dims, st.sampled_from([0.0, 1.0, 1e3, 1e6]))
def test_exact_at_any_distance(seed, num_goals, dim, distance):
    rng = np.random.default_rng(seed)
    field = random_field(rng, num_goals, dim)
    direction = rng.normal(size=dim)
    x = distance * direction / np.linalg.norm(direction) + rng.uniform(0, 1, dim)
    rounding = 1e-14 * (1 + distance) / field.sigma**2  # of the largest exponent
    for target in range(num_goals):
        exact = exact_potential(x, field.goals, field.sigma, field.prior, target)
        potential = field.potential(x, target)
        assert np.isfinite(potential)
        assert potential == pytest.approx(exact, rel=1e-12 + rounding, abs=1e-300)


@given(seeds, dims)
def test_exact_where_the_whole_scene_is_far_away(seed, dim):
    rng = np.random.default_rng(seed)
    goals = 1e6 + rng.uniform(0, 1, (3, dim))
    field = InformationPotentialField(goals, 0.15)
    x = 1e6 + rng.uniform(0, 1, dim)
    exact = exact_potential(x, goals, 0.15, field.prior, 1)
    assert field.potential(x, 1) == pytest.approx(exact, rel=1e-10)


@pytest.mark.parametrize("size", [1e100, 1e300])
def test_finite_for_absurd_points(size):
    field = InformationPotentialField([[0, 0], [1, 0.5], [0.2, 1]], 0.15)
    x = size * np.array([[1, 1], [-1, 1], [1, -1], [0, 1]])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for target in range(3):
            assert np.isfinite(field.potential(x, target)).all()
        assert np.isfinite(field.log_posterior(x)).all()
        np.testing.assert_allclose(field.posterior(x).sum(-1), 1)


def test_tiny_potentials_do_not_round_to_zero():
    field = InformationPotentialField([[0, 0], [1, 0]], 0.1)
    assert field.potential([-2.0, 0], 0) == pytest.approx(math.exp(-250), rel=1e-9)


def test_symmetric_values():
    field = InformationPotentialField([[0, 0], [1, 0]], 0.2)
    assert field.potential([0.5, 3], 0) == pytest.approx(math.log(2), rel=1e-12)
    assert field.potential([0.2, 0], 0) < field.potential([0.3, 0], 0)


def test_prior_moves_the_balance():
    field = InformationPotentialField([[0, 0], [1, 0]], 0.2, prior=[3, 1])
    np.testing.assert_allclose(field.posterior([0.5, 0]), [0.75, 0.25])


@pytest.mark.parametrize("dim", [2, 3])
def test_leading_axes_equal_the_loop(dim):
    rng = np.random.default_rng(0)
    field = random_field(rng, 4, dim)
    x = rng.normal(size=(2, 3, 5, dim))
    potential, posterior = field.potential(x, 2), field.posterior(x)
    assert potential.shape == (2, 3, 5)
    assert posterior.shape == (2, 3, 5, 4)
    for index in np.ndindex(2, 3, 5):
        np.testing.assert_allclose(potential[index], field.potential(x[index], 2), rtol=1e-12)
        np.testing.assert_allclose(posterior[index], field.posterior(x[index]), rtol=1e-12)


def test_grid_2d_has_y_along_the_rows():
    field = InformationPotentialField([[0, 0], [1, 0.2]], 0.3)
    grid = field.grid([[-1, 0], [1, 4]], 4, 1)
    assert grid.shape == (4, 4)
    for row, y in enumerate([0.5, 1.5, 2.5, 3.5]):
        for column, x in enumerate([-0.75, -0.25, 0.25, 0.75]):
            assert grid[row, column] == pytest.approx(field.potential([x, y], 1))


def test_grid_3d_has_depth_first():
    field = InformationPotentialField([[0, 0, 0], [1, 0.2, 0.4]], 0.3)
    grid = field.grid([[0, 0, 0], [1, 2, 4]], 2, 0)
    assert grid.shape == (2, 2, 2)
    for k, z in enumerate([1, 3]):
        for j, y in enumerate([0.5, 1.5]):
            for i, x in enumerate([0.25, 0.75]):
                assert grid[k, j, i] == pytest.approx(field.potential([x, y, z], 0))


def test_field_does_not_follow_the_array_it_was_made_from():
    goals = np.array([[0.0, 0], [1, 0]])
    field = InformationPotentialField(goals, 0.2)
    goals += 5
    assert field.goals.tolist() == [[0, 0], [1, 0]]
    with pytest.raises(ValueError, match="read-only"):
        field.goals[0] = 1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (([[0, 0]], 0.1), "goals must be at least 2, got 1"),
        (([0, 0], 0.1), "goals must have 2 axes"),
        (([[0, 0], [np.nan, 1]], 0.1), "goals must be finite"),
        (("goals", 0.1), "goals must be an array of numbers"),
        (([[0, 0], [1, 0]], 0), "sigma must be a number above 0, got 0"),
        (([[0, 0], [1, 0]], -1), "sigma must be a number above 0, got -1"),
        (([[0, 0], [1, 0]], np.nan), "sigma must be finite"),
        (([[0, 0], [1, 0]], "wide"), "sigma must be an array of numbers"),
        (([[0, 0], [1, 0]], 1e-200), "sigma must not vanish"),
        (([[0, 0], [1, 0]], 0.1, [1]), "prior must be 2 numbers above 0"),
        (([[0, 0], [1, 0]], 0.1, [1, 0]), "prior must be 2 numbers above 0"),
        (([[0, 0], [1, 0]], 0.1, [1, np.inf]), "prior must be finite"),
    ],
)
def test_bad_fields_are_named(arguments, message):
    with pytest.raises(InvalidInputError, match=message):
        InformationPotentialField(*arguments)


@pytest.mark.parametrize("x", [[0, 0, 0], 0.0, [np.nan, 0], "here", [[0], [1]]])
def test_bad_points_are_named(x):
    field = InformationPotentialField([[0, 0], [1, 0]], 0.1)
    for read in (field.posterior, field.log_posterior, lambda p: field.potential(p, 0)):
        with pytest.raises(InvalidInputError, match=r"^x must"):
            read(x)


def test_bad_grids_are_named():
    field = InformationPotentialField([[0, 0], [1, 0]], 0.1)
    with pytest.raises(InvalidInputError, match="resolution must be an integer"):
        field.grid([[0, 0], [1, 1]], 0, 0)
    with pytest.raises(InvalidInputError, match="workspace must have 2 numbers"):
        field.grid([[0, 0, 0], [1, 1, 1]], 4, 0)
    with pytest.raises(InvalidInputError, match="target must be"):
        field.grid([[0, 0], [1, 1]], 4, 2)
    with pytest.raises(InvalidInputError, match="target must be"):
        field.potential([0, 0], -1)


def random_precision(rng, dim):
    axes = rotation(rng, dim)
    return axes @ np.diag(rng.uniform(1, 50, dim)) @ axes.T


@given(seeds, counts, dims)
def test_posterior_is_bayes_rule_with_any_energy(seed, num_goals, dim):
    rng = np.random.default_rng(seed)
    goals, precision = rng.uniform(0, 1, (num_goals, dim)), random_precision(rng, dim)
    beta, log_prior = rng.uniform(0, 20), rng.normal(size=num_goals)
    field = Field(goals, precision, beta, log_prior)
    x = rng.uniform(0, 1, (20, dim))
    offset = x[:, None] - goals
    energy = np.einsum("xgi,ij,xgj->xg", offset, precision, offset) / 2
    energy += beta * np.linalg.norm(offset, axis=-1)
    joint = np.exp(log_prior - energy)
    np.testing.assert_allclose(field.posterior(x), joint / joint.sum(-1, keepdims=True), atol=1e-12)
    for target in range(num_goals):
        np.testing.assert_allclose(
            field.potential(x, target), -field.log_posterior(x)[..., target], rtol=1e-9, atol=1e-9
        )
    weights = np.exp(log_prior)
    np.testing.assert_allclose(field.prior, weights / weights.sum())


@given(seeds, counts, dims, st.sampled_from([0.0, 20.0]), st.sampled_from([0.0, 1.0, 30.0]))
def test_potential_and_gradient_are_the_potential_and_its_slope(seed, num, dim, beta, sharpness):
    rng = np.random.default_rng(seed)
    precision = sharpness * random_precision(rng, dim)
    field = Field(rng.uniform(0, 1, (num, dim)), precision, beta + 0.1, rng.normal(size=num))
    x, step = rng.uniform(-0.5, 1.5, (4, 5, dim)), 1e-6
    for target in range(num):
        potential, gradient = field.potential_and_gradient(x, target)
        np.testing.assert_allclose(potential, field.potential(x, target), rtol=1e-9, atol=1e-250)
        ends = [[field.potential(x + s * e, target) for s in (step, -step)] for e in np.eye(dim)]
        slope = np.stack([(a - b) / (2 * step) for a, b in ends], axis=-1)
        np.testing.assert_allclose(gradient, slope, rtol=1e-3, atol=1e-3)


@given(seeds, counts, dims)
def test_a_field_with_both_energies_moves_turns_and_scales_with_the_world(seed, num_goals, dim):
    rng = np.random.default_rng(seed)
    goals, precision = rng.uniform(0, 1, (num_goals, dim)), random_precision(rng, dim)
    turn, shift, scale = rotation(rng, dim), rng.normal(size=dim), rng.uniform(0.1, 10)

    def moved(points):
        return scale * points @ turn.T + shift

    x = rng.normal(size=(10, dim))
    field = Field(goals, precision, 5)
    other = Field(moved(goals), turn @ precision @ turn.T / scale**2, 5 / scale)
    np.testing.assert_allclose(
        other.potential(moved(x), 0), field.potential(x, 0), rtol=1e-8, atol=1e-12
    )


@given(seeds, dims, st.sampled_from([1e3, 1e6, 1e9]))
def test_far_away_the_boltzmann_posterior_depends_on_the_direction_alone(seed, dim, distance):
    """‖x − g‖ − ‖x − h‖ becomes (h − g)·x/‖x‖."""
    rng = np.random.default_rng(seed)
    goals, direction = rng.uniform(0, 1, (3, dim)), rng.normal(size=dim)
    direction /= np.linalg.norm(direction)
    log_posterior = Field(goals, beta=5).log_posterior(distance * direction)
    expected = 5 * goals @ direction
    np.testing.assert_allclose(
        np.diff(log_posterior), np.diff(expected), atol=20 / distance + 1e-12
    )


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({}, "sigma or beta must tell the goals apart"),
        ({"beta": -1}, "beta must be a number of at least 0, got -1"),
        ({"beta": np.nan}, "beta must be finite"),
        ({"beta": 1e200}, "beta must not be infinite beside"),
        ({"precision": np.eye(3)}, "precision must have 2 numbers"),
        ({"precision": [[1.0, 0]]}, "precision must be positive semi-definite and 2 by 2"),
        ({"precision": [[1, 0], [0, -1]]}, "precision must be positive semi-definite"),
        ({"precision": [[1, 0.5], [0, 1]]}, "precision must be positive semi-definite"),
        ({"precision": [[1, np.inf], [0, 1]]}, "precision must be finite"),
        ({"beta": 1, "log_prior": [0]}, "log_prior must be 2 numbers, got 1"),
        ({"beta": 1, "log_prior": [0, -np.inf]}, "log_prior must be finite"),
    ],
    ids=str,
)
def test_bad_energies_are_named(arguments, message):
    with pytest.raises(InvalidInputError, match=message):
        Field([[0, 0], [1, 0]], **arguments)


def test_a_precision_without_full_rank_reads_along_its_axes_alone():
    direction = np.array([3.0, 1.0])
    field = Field([[0, 0], [1, 0]], np.outer(direction, direction))
    x, across = np.array([0.3, 0.2]), np.array([-1.0, 3.0])
    np.testing.assert_allclose(field.posterior(x + across), field.posterior(x))


@pytest.mark.parametrize("sigma", [1e160, 1e200, 1e-170])
def test_a_sigma_that_tells_nothing(sigma):
    with pytest.raises(InvalidInputError, match=r"^sigma (or beta )?must"):
        InformationPotentialField([[0, 0], [1, 0]], sigma)


def test_a_field_cannot_be_changed():
    field = InformationPotentialField([[0.8, 0.6], [1.0, 0.3]], np.array(0.15))
    for name, value in (("sigma", 5.0), ("goals", field.goals + 1), ("prior", [0.5, 0.5])):
        with pytest.raises(AttributeError):
            setattr(field, name, value)
    with pytest.raises(ValueError, match="read-only"):
        field.goals[0, 0] = 1.0


def test_reprs_are_short():
    assert repr(InformationPotentialField([[0, 0], [1, 0]], 0.1)) == (
        "InformationPotentialField(goals=[[0.0, 0.0], [1.0, 0.0]], sigma=0.1, prior=[0.5, 0.5])"
    )
    field = Field([[0, 0], [1, 0]], beta=3)
    assert repr(eval(repr(field))) == repr(field)


@pytest.mark.parametrize("shape", [(0,), (3, 0), (0, 3)])
def test_of_no_points(shape):
    field = InformationPotentialField([[0.0, 0.0], [1.0, 0.0]], 0.15)
    points = np.empty((*shape, 2))
    assert field.potential(points, 0).shape == shape
    assert field.posterior(points).shape == (*shape, 2)
