"""Labels are ranks: monotone, anchored, and blind to any monotone change of the scores."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from legibility import labels
from legibility.errors import InvalidInputError

whole = st.integers(-20, 20).map(float)  # few values, so that ties happen
score_lists = st.lists(whole, min_size=1, max_size=40)


@pytest.mark.parametrize("label", [labels.rank_label, lambda s: labels.anchored_label(s, 0.5)])
@given(scores=score_lists)
def test_monotone_in_the_score_and_within_bounds(label, scores):
    scores = np.array(scores)
    result = label(scores)
    assert result.shape == scores.shape
    assert (np.abs(result) <= 1).all()
    for score, value in zip(scores, result, strict=True):
        assert (result[scores > score] > value).all()
        assert (result[scores == score] == value).all()


@given(scores=st.lists(whole, min_size=2, max_size=40, unique=True))
def test_rank_label_reaches_both_ends_in_equal_steps(scores):
    result = labels.rank_label(scores)
    np.testing.assert_allclose(np.sort(result), np.linspace(-1, 1, len(scores)), atol=1e-15)
    assert result[np.argmin(scores)] == -1
    assert result[np.argmax(scores)] == 1


@given(scores=st.lists(whole, min_size=3, max_size=40, unique=True), data=st.data())
def test_anchored_label_reaches_both_ends_with_the_straight_line_at_zero(scores, data):
    straight = data.draw(st.sampled_from(scores))
    result = dict(zip(scores, labels.anchored_label(scores, straight), strict=True))
    assert result[straight] == 0
    below = sorted(score for score in scores if score < straight)
    above = sorted(score for score in scores if score > straight)
    n = len(below)
    assert [result[s] for s in below] == pytest.approx([-(n - i) / n for i in range(n)])
    n = len(above)
    assert [result[s] for s in above] == pytest.approx([(i + 1) / n for i in range(n)])


@given(scores=score_lists, straight=whole)
def test_any_rising_map_of_the_scores_leaves_the_labels(scores, straight):
    scores = np.array(scores)

    def rising(x):
        return np.exp(x / 7) + x**3

    np.testing.assert_array_equal(labels.rank_label(rising(scores)), labels.rank_label(scores))
    np.testing.assert_array_equal(
        labels.anchored_label(rising(scores), rising(straight)),
        labels.anchored_label(scores, straight),
    )


@given(scores=score_lists, straight=whole)
def test_turning_the_scores_round_turns_the_labels_round(scores, straight):
    scores = np.array(scores)
    np.testing.assert_allclose(
        labels.rank_label(-scores), -labels.rank_label(scores), rtol=0, atol=1e-15
    )
    np.testing.assert_array_equal(
        labels.anchored_label(-scores, -straight), -labels.anchored_label(scores, straight)
    )


@given(scores=score_lists, straight=whole, seed=st.integers(0, 2**32 - 1))
def test_the_order_of_the_scores_does_not_matter(scores, straight, seed):
    scores = np.array(scores)
    order = np.random.default_rng(seed).permutation(len(scores))
    np.testing.assert_array_equal(
        labels.rank_label(scores[order]), labels.rank_label(scores)[order]
    )
    np.testing.assert_array_equal(
        labels.anchored_label(scores[order], straight),
        labels.anchored_label(scores, straight)[order],
    )


def test_equal_scores_share_their_mean_rank():
    assert labels.rank_label([1, 2, 2, 3]).tolist() == [-1, 0, 0, 1]
    assert labels.rank_label([5, 5, 9]).tolist() == [-0.5, -0.5, 1]
    assert labels.rank_label([4, 4, 4]).tolist() == [0, 0, 0]
    assert labels.anchored_label([1, 1, 2, 3, 3], 2).tolist() == [-0.75, -0.75, 0, 0.75, 0.75]


def test_all_scores_on_one_side():
    assert labels.anchored_label([1, 2], 0).tolist() == [0.5, 1]
    assert labels.anchored_label([1, 2], 3).tolist() == [-1, -0.5]
    assert labels.anchored_label([1, 1], 1).tolist() == [0, 0]


def test_one_score():
    assert labels.rank_label([7]).tolist() == [0]


@given(scores=score_lists)
def test_knots_read_every_score_back(scores):
    label = labels.rank_label(scores)
    knots, values = labels.label_knots(scores, label)
    assert (np.diff(knots) > 0).all()
    np.testing.assert_array_equal(np.interp(scores, knots, values), label)


@pytest.mark.parametrize("scores", [[], [np.nan], [0, np.inf], [[1, 2]], 1.0, "ab", None])
def test_bad_scores_are_named(scores):
    for act in (
        labels.rank_label,
        lambda s: labels.anchored_label(s, 0),
        lambda s: labels.label_knots(s, [0]),
    ):
        with pytest.raises(InvalidInputError, match=r"^scores must"):
            act(scores)


@pytest.mark.parametrize("straight", [np.nan, [0.0], "0", None])
def test_bad_straight_scores_are_named(straight):
    with pytest.raises(InvalidInputError, match=r"^straight_score must"):
        labels.anchored_label([1, 2], straight)


def test_knots_need_a_label_for_each_score():
    with pytest.raises(InvalidInputError, match="labels must be as many as scores, 2, got 1"):
        labels.label_knots([1, 2], [0])
