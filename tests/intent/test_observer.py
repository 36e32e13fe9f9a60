"""An observer fixes what ℓ means: the field, the scores and the labels of a scene."""

import json

import numpy as np
import pytest

import legibility as lg
from legibility.errors import InvalidInputError
from legibility.intent.metrics import DEFAULT_ALPHA
from legibility.intent.observer import DEFAULT_OBSERVER

SCENE = lg.Scene([0, 0.5], [[0.8, 0.6], [1.0, 0.3]])


class TestSigma:
    def test_is_the_papers_for_the_dimension(self):
        for dim, sigma in ((2, 0.15), (3, 0.08)):
            assert lg.Observer.paper(dim) == lg.Observer(sigma=sigma)
            assert lg.Observer().resolved(dim) == lg.Observer.paper(dim)
            scene = lg.Scene.random(np.random.default_rng(0), dim=dim)
            assert lg.Observer().field(scene).sigma == sigma

    def test_given_it_is_the_same_in_every_dimension(self):
        observer = lg.Observer(sigma=0.3)
        assert observer.resolved(2) is observer.resolved(3) is observer

    @pytest.mark.parametrize("dim", [1, 4, "2", None])
    def test_there_is_none_for_other_dimensions(self, dim):
        with pytest.raises(InvalidInputError, match="dim must be 2 or 3"):
            lg.Observer.paper(dim)
        with pytest.raises(InvalidInputError, match="dim must be 2 or 3"):
            lg.Observer(sigma=0.1).resolved(dim)

    def test_any_number_is_a_plain_one(self):
        observer = lg.Observer(sigma=np.array(0.1), alpha=np.float32(2))
        assert observer == lg.Observer(0.1, 2.0)
        assert hash(observer) == hash(lg.Observer(0.1, 2.0))


class TestReads:
    @pytest.mark.parametrize("dim", [2, 3])
    def test_field_and_score(self, dim):
        scene = lg.Scene.random(np.random.default_rng(1), dim=dim)
        curves = np.random.default_rng(0).uniform(*scene.workspace, (4, 20, dim))
        field = lg.InformationPotentialField(scene.goals, 0.3)
        observer = lg.Observer(sigma=0.3, alpha=1.0)
        np.testing.assert_array_equal(observer.field(scene).goals, scene.goals)
        np.testing.assert_array_equal(
            observer.field(scene).posterior(curves), field.posterior(curves)
        )
        np.testing.assert_array_equal(
            observer.score(curves, scene, 1), lg.metrics.legibility_score(curves, field, 1, 1.0)
        )

    def test_the_prior_is_uniform(self):
        np.testing.assert_array_equal(DEFAULT_OBSERVER.field(SCENE).prior, [0.5, 0.5])

    def test_the_field_of_a_scene_is_kept(self):
        field = lg.Observer().field(SCENE)
        assert field is lg.Observer.paper(2).field(lg.Scene(SCENE.start, SCENE.goals))
        assert field is lg.Observer(alpha=1.0).field(SCENE)
        assert field is not lg.Observer(sigma=0.2).field(SCENE)

    def test_labels(self):
        scores = np.array([-3.0, -2.0, -1.0, -0.5, -0.1])
        np.testing.assert_array_equal(
            lg.Observer(label="rank").labels(scores, -2.0), lg.labels.rank_label(scores)
        )
        np.testing.assert_array_equal(
            lg.Observer().labels(scores, -2.0), lg.labels.anchored_label(scores, -2.0)
        )


def test_default():
    assert lg.Observer() == DEFAULT_OBSERVER == lg.Observer(None, DEFAULT_ALPHA, "anchored")


@pytest.mark.parametrize("observer", [lg.Observer(), lg.Observer(0.2, 0.0, "rank")], ids=str)
def test_round_trip(observer):
    assert lg.Observer(**json.loads(json.dumps(observer.to_dict()))) == observer


def test_cannot_be_changed():
    with pytest.raises(AttributeError):
        lg.Observer().sigma = 0.1  # pyright: ignore


@pytest.mark.parametrize(
    "wrong",
    [
        {"sigma": 0},
        {"sigma": -0.1},
        {"sigma": np.nan},
        {"sigma": "wide"},
        {"sigma": [0.1]},
        {"alpha": -1},
        {"alpha": np.nan},
        {"alpha": np.inf},
        {"alpha": None},
        {"alpha": "fast"},
        {"alpha": [3.0]},
        {"label": "linear"},
        {"label": None},
        {"label": ["rank"]},
    ],
    ids=str,
)
def test_refuses(wrong):
    with pytest.raises(InvalidInputError, match=next(iter(wrong))):
        lg.Observer(**wrong)
