"""The paper's numbers, the laws of each metric, and bad inputs to all."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from legibility import Field, InformationPotentialField, Observer, Scene, metrics
from legibility.errors import InvalidInputError

seeds = st.integers(0, 2**32 - 1)
dims = st.sampled_from([2, 3])
counts = st.integers(2, 8)
START, GOALS = np.array([0, 0.5]), np.array([[0.8, 0.6], [1, 0.3]])


def random_case(seed, num_goals, dim, num_points=20):
    """A field, a target and a wandering trajectory from anywhere to the target."""
    rng = np.random.default_rng(seed)
    field = InformationPotentialField(rng.uniform(0, 1, (num_goals, dim)), 0.15)
    target = int(rng.integers(num_goals))
    knots = np.concatenate([rng.uniform(0, 1, (3, dim)), field.goals[target, None]])
    t = np.linspace(0, 1, num_points)[:, None]
    weights = [(1 - t) ** 3, 3 * t * (1 - t) ** 2, 3 * t**2 * (1 - t), t**3]
    trajectory = sum(w * k for w, k in zip(weights, knots, strict=True))
    return rng, field, target, trajectory


def random_posterior(seed, num_times, num_goals):
    return np.random.default_rng(seed).dirichlet(np.full(num_goals, 0.5), size=num_times)


class TestPaper:
    """REFERENCE.md: straight lines of the 2-D scene in the simulator's frame, 0.02 m a step.

    The start is t = 1; σ = 0.15 units is 0.075 m, for a unit is 0.5 m in that frame.
    """

    @pytest.fixture(params=[0, 1], ids=["R", "G"])
    def case(self, request):
        def frame(points):
            return np.stack([-0.5 * points[..., 1] + 0.65, 0.5 * points[..., 0] - 0.3], axis=-1)

        start, goals, target = frame(START), frame(GOALS), request.param
        way = goals[target] - start
        along = np.arange(0, np.linalg.norm(way), 0.02)[:, None]
        return start + along * way / np.linalg.norm(way), goals, target

    def test_distance_score(self, case):
        assert metrics.distance_score(*case) == pytest.approx((1.546, 1.201)[case[2]], abs=5e-4)

    def test_squared_distance_score(self, case):
        score = metrics.distance_score(*case, squared=True)
        assert score == pytest.approx((0.69, 0.41)[case[2]], abs=5e-3)

    def test_potential_cost(self, case):
        trajectory, goals, target = case
        field = InformationPotentialField(goals, sigma=0.15 * 0.5)
        cost = metrics.potential_cost(trajectory, field, target)
        assert cost == pytest.approx((1.26e-2, 23.93)[target], rel=2e-3)


@given(seeds, counts, dims)
def test_sums_equal_their_loops(seed, num_goals, dim):
    _, field, target, trajectory = random_case(seed, num_goals, dim)
    others = [g for i, g in enumerate(field.goals) if i != target]
    terms = list(enumerate(trajectory, start=1))
    distance = sum(min(math.dist(g, x) for g in others) / t for t, x in terms)
    squared = sum(min(math.dist(g, x) for g in others) ** 2 / t for t, x in terms)
    own = field.goals[target]
    ratio = sum(min(math.dist(g, x) / math.dist(g, own) for g in others) / t for t, x in terms)
    cost = sum(-math.log(field.posterior(x)[target]) / t for t, x in terms)
    assert metrics.distance_score(trajectory, field.goals, target) == pytest.approx(distance)
    assert metrics.distance_score(trajectory, field.goals, target, True) == pytest.approx(squared)
    assert metrics.detachment(trajectory, field.goals, target) == pytest.approx(ratio)
    assert metrics.potential_cost(trajectory, field, target) == pytest.approx(cost, rel=1e-9)


@given(seeds, counts, dims)
def test_score_does_not_depend_on_how_the_polyline_is_cut(seed, num_goals, dim):
    rng, field, target, trajectory = random_case(seed, num_goals, dim, num_points=6)
    finer = np.concatenate(
        [
            a + np.sort(np.append(rng.random(5), 0))[:, None] * (b - a)
            for a, b in itertools.pairwise(trajectory)
        ]
        + [trajectory[-1:]]
    )
    assert metrics.legibility_score(finer, field, target) == pytest.approx(
        metrics.legibility_score(trajectory, field, target), rel=1e-9, abs=1e-12
    )


@pytest.mark.parametrize(("num_points", "tolerance"), [(50, 1e-3), (1000, 1e-5)])
@given(seeds, counts, dims)
def test_score_of_a_curve_does_not_depend_on_its_sampling(
    num_points, tolerance, seed, num_goals, dim
):
    _, field, target, coarse = random_case(seed, num_goals, dim, num_points)
    fine = random_case(seed, num_goals, dim, 5000)[-1]
    scores = [metrics.legibility_score(x, field, target) for x in (coarse, fine)]
    scale = field.potential(fine, target).max()
    assert scores[0] == pytest.approx(scores[1], rel=0, abs=tolerance * scale)


@given(seeds, counts, dims)
def test_moving_turning_and_scaling_the_world_change_no_score(seed, num_goals, dim):
    rng, field, target, trajectory = random_case(seed, num_goals, dim)
    turn = np.linalg.qr(rng.normal(size=(dim, dim)))[0]
    shift, scale = rng.normal(size=dim), rng.uniform(0.1, 10)

    def moved(points):
        return scale * points @ turn.T + shift

    other = InformationPotentialField(moved(field.goals), scale * field.sigma)
    here = metrics.evaluate_trajectory(trajectory, field, target, beta=10)
    there = metrics.evaluate_trajectory(moved(trajectory), other, target, beta=10 / scale)
    lengths = {"length", "distance_score"}
    for name in set(here) - {n for n in here if "guess" in n or "confidence" in n}:
        expected = here[name] * (scale if name in lengths else 1)
        assert there[name] == pytest.approx(expected, rel=1e-7, abs=1e-10), name


@given(seeds, counts, dims)
def test_the_order_of_the_goals_does_not_matter(seed, num_goals, dim):
    rng, field, target, trajectory = random_case(seed, num_goals, dim)
    order = rng.permutation(num_goals)
    other = InformationPotentialField(field.goals[order], field.sigma)
    here = metrics.evaluate_trajectory(trajectory, field, target)
    there = metrics.evaluate_trajectory(trajectory, other, int(np.argmax(order == target)))
    for name, value in here.items():
        assert there[name] == pytest.approx(value, rel=1e-9, abs=1e-12), name


@given(seeds, counts, dims)
def test_leading_axes_equal_the_loop(seed, num_goals, dim):
    _, field, target, _ = random_case(seed, num_goals, dim)
    many = np.random.default_rng(seed).uniform(0, 1, (2, 3, 12, dim))
    together = metrics.evaluate_trajectory(many, field, target)
    for index in np.ndindex(2, 3):
        for name, value in metrics.evaluate_trajectory(many[index], field, target).items():
            assert value.shape == ()
            assert together[name].shape == (2, 3)
            np.testing.assert_allclose(together[name][index], value, rtol=1e-9, err_msg=name)


@given(seeds, st.sampled_from([1e3, 1e6]))
def test_finite_far_away(seed, distance):
    _, field, target, trajectory = random_case(seed, 3, 2)
    for name, value in metrics.evaluate_trajectory(trajectory + distance, field, target).items():
        assert np.isfinite(value) or ("_time_" in name or "_guess" in name), name


def test_early_points_weigh_more_with_larger_alpha():
    field = InformationPotentialField(GOALS, 0.15)
    late = np.array([START, [0.5, 0.9], GOALS[0]])  # away from G at first
    early = np.array([START, [0.5, 0.1], GOALS[0]])  # towards G at first
    gaps = [
        metrics.legibility_score(late, field, 0, alpha)
        - metrics.legibility_score(early, field, 0, alpha)
        for alpha in (0, 3)
    ]
    assert gaps[0] > 0
    weights = metrics.score_weights(11, 3.0)
    assert weights.sum() == pytest.approx(1)
    np.testing.assert_allclose(weights[2:-1] / weights[1:-2], math.exp(-0.3))
    np.testing.assert_allclose(metrics.score_weights(5, 0.0), [1 / 8, 1 / 4, 1 / 4, 1 / 4, 1 / 8])


class TestDragan:
    """The observer of HRI 2013."""

    @pytest.mark.parametrize("cost", metrics.COSTS)
    @given(seeds, counts, dims)
    def test_equals_the_formula(self, cost, seed, num_goals, dim):
        rng, field, _, trajectory = random_case(seed, num_goals, dim, num_points=9)
        prior, beta, dt = rng.uniform(0.2, 1, num_goals), 3.0, 0.1
        posterior = metrics.dragan_posterior(trajectory, field.goals, beta, prior, cost, dt)

        def best(a, g, steps):
            distance = math.dist(a, g)
            return distance if cost == "length" else distance**2 / (2 * steps * dt)

        for i in range(9):
            so_far = metrics.trajectory_cost(trajectory[: i + 1], cost, dt) if i else 0.0
            joint = [
                p
                * math.exp(
                    -beta
                    * (so_far + best(trajectory[i], g, max(8 - i, 1)) - best(trajectory[0], g, 8))
                )
                for g, p in zip(field.goals, prior, strict=True)
            ]
            np.testing.assert_allclose(posterior[i], np.array(joint) / sum(joint), rtol=1e-9)

    @pytest.mark.parametrize("cost", metrics.COSTS)
    @given(seeds, counts, dims)
    def test_is_a_distribution_that_begins_at_the_prior(self, cost, seed, num_goals, dim):
        rng, field, _, trajectory = random_case(seed, num_goals, dim)
        prior = rng.dirichlet(np.ones(num_goals)) + 0.01
        posterior = metrics.dragan_posterior(trajectory, field.goals, prior=prior, cost=cost)
        assert posterior.shape == (20, num_goals)
        np.testing.assert_allclose(posterior.sum(-1), 1, rtol=1e-12)
        np.testing.assert_allclose(posterior[0], prior / prior.sum(), rtol=1e-12)

    @pytest.mark.parametrize("cost", metrics.COSTS)
    @given(seeds, counts, dims)
    def test_the_best_motion_never_loses_belief(self, cost, seed, num_goals, dim):
        """Its own cost so far and to go is constant; any other goal's can only grow."""
        _, field, target, trajectory = random_case(seed, num_goals, dim)
        t = np.linspace(0, 1, 12)[:-1, None]  # the last point has no time left
        straight = trajectory[0] + t * (field.goals[target] - trajectory[0])
        if cost == "squared_velocity":
            straight = np.concatenate([straight, field.goals[None, target]])
        belief = metrics.dragan_posterior(straight, field.goals, cost=cost)[:-1, target]
        assert (np.diff(belief) >= -1e-12).all()

    @pytest.mark.parametrize("cost", metrics.COSTS)
    def test_stable_for_huge_beta_and_distance(self, cost):
        trajectory = np.array([[0, 0], [1e6, 2e6], [1, 0]])
        posterior = metrics.dragan_posterior(trajectory, [[1, 0], [0, 1]], beta=1e8, cost=cost)
        assert np.isfinite(posterior).all()
        np.testing.assert_allclose(posterior.sum(-1), 1)
        assert posterior[-1, 0] == 1

    @given(seeds, counts, dims, st.floats(0.01, 100))
    def test_beta_not_given_follows_the_size_of_start_and_goals(self, seed, num_goals, dim, scale):
        _, field, _, trajectory = random_case(seed, num_goals, dim)
        points = np.concatenate([trajectory[:1], field.goals])
        size = np.linalg.norm(points[:, None] - points, axis=-1).max()
        expected = metrics.dragan_posterior(trajectory, field.goals, 20 / size)
        large, goals = scale * trajectory, scale * field.goals
        np.testing.assert_allclose(metrics.dragan_posterior(large, goals), expected, atol=1e-9)
        # Squared velocity: 20 over ½ size² / duration, whatever the duration.
        squared = metrics.dragan_posterior(
            trajectory, field.goals, 20 / (size**2 / (2 * 19 * 0.1)), None, "squared_velocity", 0.1
        )
        for step in (0.1, 1.0):
            again = metrics.dragan_posterior(large, goals, cost="squared_velocity", time_step=step)
            np.testing.assert_allclose(again, squared, atol=1e-9)

    def test_each_start_has_its_beta(self):
        many = np.random.default_rng(0).uniform(0, 5, (4, 10, 2))
        together = metrics.dragan_posterior(many, GOALS)
        for one, posterior in zip(many, together, strict=True):
            np.testing.assert_allclose(metrics.dragan_posterior(one, GOALS), posterior)

    def test_time_step_only_rescales_beta(self):
        _, field, _, trajectory = random_case(0, 3, 2)
        a = metrics.dragan_posterior(
            trajectory, field.goals, beta=2, cost="squared_velocity", time_step=0.5
        )
        b = metrics.dragan_posterior(trajectory, field.goals, beta=4, cost="squared_velocity")
        np.testing.assert_allclose(a, b)

    def test_legibility_is_that_of_its_posterior(self):
        _, field, target, trajectory = random_case(0, 3, 2)
        posterior = metrics.dragan_posterior(trajectory, field.goals, beta=5)
        assert metrics.dragan_legibility(
            trajectory, field.goals, target, beta=5
        ) == metrics.posterior_legibility(posterior, target)

    def test_bending_away_from_the_distractor_is_more_legible(self):
        t = np.linspace(0, 1, 30)[:, None]
        straight = START + t * (GOALS[0] - START)
        away, towards = (straight + s * np.sin(np.pi * t) * [0, 0.2] for s in (1, -1))
        legibility = [metrics.dragan_legibility(x, GOALS, 0) for x in (towards, straight, away)]
        assert legibility == sorted(legibility)

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            ({"beta": 0}, "beta must be a number above 0"),
            ({"beta": np.nan}, "beta must be finite"),
            ({"prior": [1, 2, 3]}, "prior must be 2 numbers"),
            ({"prior": [1, 0]}, "prior must be 2 numbers"),
            ({"cost": "jerk"}, "cost must be one of length, squared_velocity, got 'jerk'"),
            ({"time_step": 0}, "time_step must be a number above 0"),
        ],
    )
    def test_bad_arguments_are_named(self, change, message):
        line = np.linspace(START, GOALS[0], 5)
        with pytest.raises(InvalidInputError, match=message):
            metrics.dragan_posterior(line, GOALS, **change)
        with pytest.raises(InvalidInputError, match=message):
            metrics.dragan_legibility(line, GOALS, 0, **change)


class TestCosts:
    def test_trajectory_cost(self):
        points = np.array([[0, 0], [3, 4], [3, 5]])
        assert metrics.trajectory_cost(points) == 6
        assert metrics.trajectory_cost(points, "squared_velocity", time_step=2) == 26 / 4

    @given(seeds, dims)
    def test_predictability_is_one_for_straight_lines_alone(self, seed, dim):
        rng, _, _, trajectory = random_case(seed, 2, dim)
        value = metrics.predictability(trajectory)
        assert 0 < value < 1
        straight = trajectory[0] + np.sort(rng.random(9))[:, None] * trajectory[-1]
        assert metrics.predictability(straight) == pytest.approx(1)
        assert metrics.predictability(straight) <= 1

    def test_predictability_at_the_ends_of_its_range(self):
        assert metrics.predictability([[0, 0], [1, 1], [0, 0]]) == 0
        assert metrics.predictability(np.ones((5, 3))) == 1

    def test_regularised_and_budgeted_legibility(self):
        legibility, cost = [0.9, 0.8, 0.5], [3, 2, 1]
        np.testing.assert_allclose(
            metrics.regularised_legibility(legibility, cost, 0.1), [0.6, 0.6, 0.4]
        )
        assert metrics.regularised_legibility(legibility, cost, 0).tolist() == legibility
        assert metrics.budgeted_legibility(legibility, cost, 2).tolist() == [-np.inf, 0.8, 0.5]

    def test_bad_arguments_are_named(self):
        for act in (metrics.regularised_legibility, metrics.budgeted_legibility):
            with pytest.raises(InvalidInputError, match="legibility and cost must have one shape"):
                act([1, 2], [1], 1)
            with pytest.raises(InvalidInputError, match=r"(weight|budget) must be a number"):
                act([1], [1], -1)
            with pytest.raises(InvalidInputError, match="legibility must be finite"):
                act([np.nan], [1], 1)
        with pytest.raises(InvalidInputError, match="cost must be one of"):
            metrics.trajectory_cost(np.zeros((3, 2)), "energy")
        with pytest.raises(InvalidInputError, match="time_step must be"):
            metrics.trajectory_cost(np.zeros((3, 2)), time_step=-1)
        with pytest.raises(InvalidInputError, match="must not coincide"):
            metrics.detachment(np.zeros((3, 2)), [[1, 1], [1, 1]], 0)


class TestPosteriors:
    """Readings that serve every observer."""

    BELIEF = np.array([0.2, 0.6, 0.9, 0.5, 0.8, 0.85, 0.8, 0.9, 0.95, 1, 1])
    POSTERIOR = np.stack([BELIEF, 1 - BELIEF], axis=-1)

    def test_time_to_confidence(self):
        assert metrics.time_to_confidence(self.POSTERIOR, 0) == 0.4
        assert metrics.time_to_confidence(self.POSTERIOR, 0, threshold=0.9) == 0.7
        assert metrics.time_to_confidence(self.POSTERIOR, 0, threshold=0) == 0
        assert metrics.time_to_confidence(self.POSTERIOR, 1) == np.inf

    def test_earliest_correct_guess(self):
        assert metrics.earliest_correct_guess(self.POSTERIOR, 0) == 0.1
        assert metrics.earliest_correct_guess(self.POSTERIOR, 0, margin=0.3) == 0.2
        assert metrics.earliest_correct_guess(self.POSTERIOR, 1) == 0
        assert metrics.earliest_correct_guess(np.full((3, 2), 0.5), 0) == np.inf

    def test_early_intent(self):
        first = np.mean([0.2, 0.6, 0.9, 0.5])
        assert metrics.early_intent(self.POSTERIOR, 0) == pytest.approx(first)
        assert metrics.early_intent(self.POSTERIOR, 0, 0) == 0.2
        assert metrics.early_intent(self.POSTERIOR, 0, 1) == pytest.approx(self.BELIEF.mean())

    def test_legibility_of_known_beliefs(self):
        assert metrics.posterior_legibility(np.full((7, 4), 0.25), 2) == pytest.approx(0.25)
        t = np.linspace(0, 1, 2001)
        rising = np.stack([t, 1 - t], axis=-1)  # ∫ t (1 − t) / ∫ (1 − t) = 1/3
        assert metrics.posterior_legibility(rising, 0) == pytest.approx(1 / 3, abs=1e-6)
        step = np.array([[1.0, 0.0]] * 5 + [[0.0, 1.0]] * 5)
        assert metrics.posterior_legibility(step, 0) > metrics.posterior_legibility(step, 1)

    def test_entropy(self):
        np.testing.assert_allclose(metrics.posterior_entropy(np.full((3, 5), 0.2)), math.log(5))
        certain = metrics.posterior_entropy(np.eye(3))
        assert certain.tolist() == [0, 0, 0]
        assert not np.signbit(certain).any()

    @given(seeds, st.integers(2, 30), counts)
    def test_ranges(self, seed, num_times, num_goals):
        posterior = random_posterior(seed, num_times, num_goals)
        entropy = metrics.posterior_entropy(posterior)
        assert entropy.shape == (num_times,)
        assert (entropy >= 0).all()
        assert (entropy <= math.log(num_goals) + 1e-12).all()
        totals = np.zeros(2)
        for target in range(num_goals):
            totals += [
                metrics.posterior_legibility(posterior, target),
                metrics.early_intent(posterior, target),
            ]
            for time in (
                metrics.time_to_confidence(posterior, target),
                metrics.earliest_correct_guess(posterior, target),
            ):
                assert 0 <= time <= 1 or time == np.inf
        np.testing.assert_allclose(totals, 1)

    @given(seeds, st.integers(2, 30), counts)
    def test_times_mean_what_they_say(self, seed, num_times, num_goals):
        posterior = random_posterior(seed, num_times, num_goals)
        belief, others = posterior[:, 0], posterior[:, 1:].max(-1)
        sure = [i for i in range(num_times) if (belief[i:] >= 0.6).all()]
        ahead = [i for i in range(num_times) if belief[i] > others[i] + 0.1]
        for found, indices in (
            (metrics.time_to_confidence(posterior, 0, 0.6), sure),
            (metrics.earliest_correct_guess(posterior, 0, 0.1), ahead),
        ):
            assert found == (indices[0] / (num_times - 1) if indices else np.inf)

    @given(seeds, st.floats(0, 1), st.floats(0, 1))
    def test_asking_for_more_takes_longer(self, seed, a, b):
        posterior = np.random.default_rng(seed).dirichlet([2, 1, 1], size=(4, 15))
        low, high = sorted((a, b))
        for read in (metrics.time_to_confidence, metrics.earliest_correct_guess):
            assert (read(posterior, 0, low) <= read(posterior, 0, high)).all()

    READERS = (
        metrics.posterior_legibility,
        metrics.time_to_confidence,
        metrics.earliest_correct_guess,
        metrics.early_intent,
    )

    @pytest.mark.parametrize("read", READERS)
    def test_leading_axes_equal_the_loop(self, read):
        many = np.random.default_rng(0).dirichlet([2, 1, 1], size=(2, 3, 15))
        result = read(many, 1)
        assert result.shape == (2, 3)
        for index in np.ndindex(2, 3):
            assert result[index] == pytest.approx(read(many[index], 1))

    @pytest.mark.parametrize("read", READERS)
    @pytest.mark.parametrize(
        "posterior",
        [[0.5, 0.5], [[0.5, 0.5]], [[1.0], [1.0]], [[0.6, 0.6]] * 2, [[np.nan, 1]] * 2, "ab"],
    )
    def test_bad_posteriors_are_named(self, read, posterior):
        with pytest.raises(InvalidInputError, match=r"^posterior must"):
            read(posterior, 0)
        with pytest.raises(InvalidInputError, match=r"^posterior must"):
            metrics.posterior_entropy(posterior)

    @pytest.mark.parametrize("read", READERS)
    @pytest.mark.parametrize("target", [-1, 2, 0.5, None])
    def test_bad_targets_are_named(self, read, target):
        with pytest.raises(InvalidInputError, match="target must be"):
            read(self.POSTERIOR, target)

    @pytest.mark.parametrize("value", [-0.1, 1.1, np.nan, "1"])
    def test_bad_options_are_named(self, value):
        for read, name in zip(self.READERS[1:], ("threshold", "margin", "fraction"), strict=True):
            with pytest.raises(InvalidInputError, match=f"^{name} must"):
                read(self.POSTERIOR, 0, value)


class TestBadTrajectories:
    FIELD = InformationPotentialField(GOALS, 0.15)
    LINE = np.linspace(START, GOALS[0], 5)
    METRICS = (
        lambda x, target=0, field=FIELD: metrics.legibility_score(x, field, target),
        lambda x, target=0, field=FIELD: metrics.potential_cost(x, field, target),
        lambda x, target=0, field=FIELD: metrics.distance_score(x, field.goals, target),
        lambda x, target=0, field=FIELD: metrics.detachment(x, field.goals, target),
        lambda x, target=0, field=FIELD: metrics.dragan_legibility(x, field.goals, target),
        lambda x, target=0, field=FIELD: metrics.evaluate_trajectory(x, field, target),
    )

    @pytest.mark.parametrize("metric", METRICS)
    @pytest.mark.parametrize(
        "trajectory",
        [[], [0, 0], [[0, 0]], [[0, 0, 0]] * 3, [[0, np.nan], [1, 1]], [[0, np.inf], [1, 1]],
         "line", None, [[0, 0], [1]], [["0", "0"], ["1", "1"]]],
        ids=repr,
    )  # fmt: skip
    def test_are_named(self, metric, trajectory):
        with pytest.raises(InvalidInputError, match=r"^trajectory must"):
            metric(trajectory)

    @pytest.mark.parametrize("metric", [metrics.predictability, metrics.trajectory_cost])
    @pytest.mark.parametrize("trajectory", [[], [[0, 0]], [[0, np.nan], [1, 1]], "line", None])
    def test_are_named_without_goals(self, metric, trajectory):
        with pytest.raises(InvalidInputError, match=r"^trajectory must"):
            metric(trajectory)

    @pytest.mark.parametrize("metric", METRICS)
    @pytest.mark.parametrize("target", [-1, 2, 1.0, "0", None, True])
    def test_targets_are_named(self, metric, target):
        with pytest.raises(InvalidInputError, match=r"^target must be"):
            metric(self.LINE, target)

    @pytest.mark.parametrize("goals", [[], [[0, 0]], [0, 0], [[0, np.nan], [1, 1]], "ab"])
    def test_goals_are_named(self, goals):
        for metric in (metrics.distance_score, metrics.detachment, metrics.dragan_legibility):
            with pytest.raises(InvalidInputError, match=r"^goals must"):
                metric(self.LINE, goals, 0)

    @pytest.mark.parametrize("alpha", [-1, np.nan, np.inf, "3", None, [3.0]])
    def test_alphas_are_named(self, alpha):
        with pytest.raises(InvalidInputError, match=r"^alpha must"):
            metrics.legibility_score(self.LINE, self.FIELD, 0, alpha)
        with pytest.raises(InvalidInputError, match=r"^alpha must"):
            metrics.evaluate_trajectory(self.LINE, self.FIELD, 0, alpha)


@given(seeds, counts, dims)
def test_dragans_observer_is_shown_as_the_default_observer_sees_it(seed, num_goals, dim):
    """Whatever the field's own observer."""
    _, paper, target, trajectory = random_case(seed, num_goals, dim)
    scene = Scene(trajectory[0], paper.goals, [np.full(dim, -1), np.full(dim, 2)])
    default = Observer().field(scene)
    assert isinstance(default, Field)
    shown = metrics.evaluate_trajectory(trajectory, paper, target)
    own = metrics.evaluate_trajectory(trajectory, default, target)
    for name in ("legibility", "early_intent", "mean_entropy"):
        assert own[f"field_{name}"] == pytest.approx(own[f"dragan_{name}"], rel=1e-9)
        assert shown[f"dragan_{name}"] == pytest.approx(own[f"dragan_{name}"], rel=1e-12)


def test_every_public_name_is_there():
    for name in metrics.__all__:
        assert hasattr(metrics, name)


def test_evaluate_trajectory_agrees_with_the_single_metrics():
    _, field, target, trajectory = random_case(3, 4, 3)
    result = metrics.evaluate_trajectory(trajectory, field, target, alpha=2, beta=5)
    posterior = metrics.dragan_posterior(trajectory, field.goals, 5)
    assert result["legibility_score"] == metrics.legibility_score(trajectory, field, target, 2)
    assert result["dragan_legibility"] == metrics.posterior_legibility(posterior, target)
    assert (
        result["field_mean_entropy"]
        == metrics.posterior_entropy(field.posterior(trajectory)).mean()
    )
    assert all(isinstance(value, np.ndarray) for value in result.values())
