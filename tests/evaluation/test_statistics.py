"""Intervals cover what they should, and correlations are scipy's."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from legibility.evaluation.statistics import (
    bootstrap_interval,
    holm,
    paired_test,
    rank_correlation,
    share_interval,
    spearman_ceiling,
    summary,
)

whole = st.integers(-5, 5).map(float)  # few values, so that ties happen


class TestInterval:
    def test_agrees_with_the_t_interval_of_normal_values(self):
        values = np.random.default_rng(0).normal(3, 2, 400)
        low, high = bootstrap_interval(values)
        expected = stats.t.interval(0.95, 399, values.mean(), stats.sem(values))
        np.testing.assert_allclose([low, high], expected, atol=0.03)

    @pytest.mark.parametrize("level", [0.5, 0.8, 0.95])
    def test_covers_the_mean_as_often_as_it_says(self, level):
        rng = np.random.default_rng(1)
        covered = []
        for _ in range(150):
            low, high = bootstrap_interval(rng.exponential(size=40) - 1, level=level)
            covered.append(low <= 0 <= high)
        assert np.mean(covered) == pytest.approx(level, abs=0.10)

    def test_shrinks_with_the_square_root_of_the_number(self):
        values = np.random.default_rng(0).normal(size=1600)
        widths = [np.diff(bootstrap_interval(values[:n]))[0] for n in (100, 1600)]
        assert widths[0] / widths[1] == pytest.approx(4, rel=0.15)

    @given(st.lists(whole, min_size=1, max_size=20), whole)
    def test_brackets_the_mean_and_moves_with_the_values(self, values, shift):
        values = np.array(values)
        low, high = bootstrap_interval(values)
        assert values.min() <= low <= values.mean() + 1e-9
        assert values.mean() - 1e-9 <= high <= values.max()
        np.testing.assert_allclose(
            bootstrap_interval(values + shift), (low + shift, high + shift), atol=1e-9
        )

    def test_same_values_same_interval(self):
        values = np.random.default_rng(0).normal(size=30)
        assert bootstrap_interval(values) == bootstrap_interval(values.copy())

    @pytest.mark.parametrize("values", [[0.3], [0.3, 0.3, 0.3]])
    def test_without_spread_it_is_the_value(self, values):
        assert bootstrap_interval(np.array(values)) == (0.3, 0.3)

    def test_of_another_statistic(self):
        values = np.random.default_rng(0).normal(5, 1, 200)
        low, high = bootstrap_interval(values, np.median)
        assert low < np.median(values) < high
        assert high - low < 0.6


class TestRankCorrelation:
    @given(st.lists(st.tuples(whole, whole), min_size=2, max_size=30))
    def test_is_spearmans(self, pairs):
        asked, achieved = np.array(pairs).T
        if np.ptp(asked) == 0 or np.ptp(achieved) == 0:
            assert rank_correlation(asked, achieved) == 0
        else:
            expected = stats.spearmanr(asked, achieved).statistic
            assert rank_correlation(asked, achieved) == pytest.approx(expected, abs=1e-12)

    @given(st.lists(whole, min_size=2, max_size=30, unique=True))
    def test_of_any_rising_or_falling_function(self, values):
        values = np.array(values)
        assert rank_correlation(values, np.exp(values)) == pytest.approx(1)
        assert rank_correlation(values, -(values**3)) == pytest.approx(-1)

    def test_of_constants(self):
        assert rank_correlation(np.arange(5.0), np.ones(5)) == 0
        assert rank_correlation(np.ones(5), np.ones(5)) == 0


class TestCeiling:
    @pytest.mark.parametrize(("levels", "samples"), [(21, 8), (11, 4), (5, 2)])
    def test_without_noise_it_is_that_of_repeated_levels(self, levels, samples):
        number = levels * samples
        asked = np.repeat(np.linspace(-1, 1, levels), samples)
        expected = np.sqrt(1 - (samples**2 - 1) / (number**2 - 1))
        assert spearman_ceiling(asked, 0) == pytest.approx(expected, abs=0.02 / number)

    def test_falls_with_noise(self):
        asked = np.repeat(np.linspace(-1, 1, 21), 8)
        ceilings = [spearman_ceiling(asked, error) for error in (0, 0.02, 0.1, 0.5, 100)]
        assert ceilings == sorted(ceilings, reverse=True)
        assert ceilings[-1] < 0.3


@given(st.lists(whole, min_size=1, max_size=20))
def test_summary(values):
    found = summary(np.array(values))
    assert found["mean"] == pytest.approx(np.mean(values))
    assert (found["min"], found["max"]) == (min(values), max(values))
    assert found["median"] == pytest.approx(np.median(values))
    assert found["interval"] == list(bootstrap_interval(np.array(values)))
    assert all(type(found[name]) is float for name in ("mean", "min", "max"))


class TestShareInterval:
    @given(st.integers(1, 60), st.data())
    def test_brackets_the_share(self, number, data):
        happened = np.arange(number) < data.draw(st.integers(0, number))
        low, high = share_interval(happened)
        assert 0 <= low <= happened.mean() <= high <= 1
        opposite = share_interval(~happened)
        assert opposite == pytest.approx((1 - high, 1 - low), abs=1e-9)

    def test_is_exact(self):
        # Without a failure in n the bound is (α/2)^(1/n).
        low, high = share_interval(np.ones(5000, dtype=bool))
        assert (low, high) == pytest.approx((0.025 ** (1 / 5000), 1), abs=1e-12)

    @pytest.mark.parametrize("share", [0.02, 0.5, 0.97])
    def test_covers_the_share_at_least_as_often_as_it_says(self, share):
        rng = np.random.default_rng(0)
        intervals = [share_interval(rng.random(80) < share) for _ in range(300)]
        assert np.mean([low <= share <= high for low, high in intervals]) > 0.95


class TestPaired:
    @given(st.lists(st.tuples(whole, whole), min_size=3, max_size=40))
    @settings(max_examples=20)  # scipy takes its time over ties
    def test_p_is_scipys(self, pairs):
        first, second = np.array(pairs).T
        found = paired_test(first, second)
        if (first == second).all():
            assert found["p"] == 1
            assert found["effect"] == 0
        else:
            wanted = stats.wilcoxon(first, second, zero_method="wilcox").pvalue
            assert found["p"] == pytest.approx(wanted, rel=1e-9)
        assert found["difference"] == pytest.approx((first - second).mean())

    @given(st.lists(st.tuples(whole, whole), min_size=3, max_size=40))
    @settings(max_examples=20)
    def test_effect_is_that_of_scipys_rank_sum(self, pairs):
        """Kerby's simple difference: T⁺ over the sum of all ranks, and back to [−1, 1]."""
        first, second = np.array(pairs).T
        number = np.count_nonzero(first - second)
        if number:
            positive = stats.wilcoxon(first - second, alternative="greater").statistic
            wanted = 2 * positive / (number * (number + 1) / 2) - 1
            assert paired_test(first, second)["effect"] == pytest.approx(wanted, abs=1e-12)

    def test_always_greater_is_one(self):
        values = np.random.default_rng(0).normal(size=100)
        found = paired_test(values + 0.1, values)
        assert found["effect"] == 1
        assert found["p"] < 1e-15
        np.testing.assert_allclose([found["difference"], *found["interval"]], 0.1)

    def test_rounding_is_no_difference(self):
        values = np.array([0.1 + 0.2, 1.0, 2.0])
        assert paired_test(values, np.array([0.3, 1.0, 2.0]))["p"] == 1

    def test_a_known_case(self):
        """Pratt's plant heights, the example of scipy's documentation."""
        difference = np.array([6, 8, 14, 16, 23, 24, 28, 29, 41, -48, 49, 56, 60, -67, 75])
        found = paired_test(difference, np.zeros(15))
        assert found["p"] == pytest.approx(0.041259765625)
        assert found["effect"] == pytest.approx((96 - 24) / 120)


class TestHolm:
    def test_a_known_case(self):
        """Computed by hand: 0.01·4, 0.02·3 (and not less), 0.03·2, 0.04."""
        np.testing.assert_allclose(holm(np.array([0.01, 0.04, 0.03, 0.005])),
                                   [0.03, 0.06, 0.06, 0.02])  # fmt: skip

    @given(st.lists(st.floats(0, 1), min_size=1, max_size=30))
    def test_laws(self, p_values):
        raw = np.array(p_values)
        found = holm(raw)
        assert (found >= raw).all()
        assert (found <= np.minimum(1, raw * len(raw)) + 1e-12).all()  # Bonferroni's at most
        assert (np.diff(found[np.argsort(raw, kind="stable")]) >= 0).all()
        # Less strict than Holm is Benjamini and Hochberg's, which scipy has.
        assert (found >= stats.false_discovery_control(raw) - 1e-12).all()
        assert found.min() == pytest.approx(min(1, raw.min() * len(raw)))
