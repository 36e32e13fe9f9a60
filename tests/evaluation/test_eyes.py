"""Whose eyes: every observer sees the dial that was turned for them, others less of it."""

import json

import numpy as np
import pytest

import legibility as lg
from legibility.data.configuration import SceneStream
from legibility.errors import InvalidInputError
from legibility.evaluation.configuration import EyesConfig
from legibility.evaluation.eyes import EYES, evaluate_eyes, observers
from legibility.evaluation.statistics import rank_correlation

SMALL = EyesConfig(scenes=2, levels=5, samples=1, exact=True, seed=1)


@pytest.fixture(scope="module")
def found(tiny, coarsely):
    return evaluate_eyes(tiny, SMALL)


def test_structure(found):
    assert list(found["rows"]) == list(EYES)
    for row in found["rows"].values():
        assert list(row["seen_by"]) == list(EYES)
        assert 0 <= row["dragan_rises"]["mean"] <= 1
    assert len(found["scenes"]) == 2
    assert json.loads(json.dumps(found, allow_nan=False)) == found


def test_each_sees_their_own_dial(found):
    for name, row in found["rows"].items():
        assert row["seen_by"][name]["score"]["min"] > 0.85


def test_rows_are_means_over_scenes(found):
    cell = [scene["paper"]["seen_by"]["dragan"]["posterior"] for scene in found["scenes"]]
    entry = found["rows"]["paper"]["seen_by"]["dragan"]["posterior"]
    assert entry["mean"] == pytest.approx(np.mean(cell))
    assert entry["min"] == min(cell)


def test_a_cell_by_hand(found, tiny, monkeypatch):
    seeds, plan = [], tiny.plan

    def spy(*arguments, seed, observer, **options):
        seeds.append(seed)
        return plan(*arguments, seed=seed, observer=observer, **options)

    monkeypatch.setattr(tiny, "plan", spy)
    evaluate_eyes(tiny, EyesConfig(scenes=1, levels=5, samples=1, exact=True, seed=1))
    scene = SceneStream("evaluation", seed=1).scene(0)
    asked = np.unique([*np.linspace(-1, 1, 5), *np.round(np.linspace(-1, 1, 6), 12)])
    path = plan(scene, 0, asked, seed=seeds[0], observer=lg.Observer(), exact=True)
    counted = np.isin(asked, np.linspace(-1, 1, 5))
    gaussian = lg.Observer(kind="gaussian")
    scores = gaussian.score(path.trajectory(192), scene, 0)
    expected = rank_correlation(asked[counted], scores[counted])
    cell = found["scenes"][0]["dragan"]["seen_by"]["gaussian"]["score"]
    assert cell == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("dim", [2, 3])
def test_observers(dim):
    scene = SceneStream("evaluation", dim).scene(0)
    like = lg.Observer(alpha=2.0, detour=3.0, label="rank")
    known = observers(scene, like)
    assert list(known) == list(EYES)
    assert {observer.scale for observer in known.values()} == {like.scale}
    # Progress is what eyes behind the target read worst.
    precision = known["viewpoint"].field(scene).precision
    way = scene.goals[0] - scene.start
    values, vectors = np.linalg.eigh(precision)
    assert abs(vectors[:, 0] @ way) > 0.99 * np.linalg.norm(way)
    assert values[-1] == pytest.approx(9 * values[0])


@pytest.mark.parametrize("wrong", [{"scenes": 0}, {"levels": 2}, {"samples": 0}], ids=str)
def test_bad_settings(wrong):
    with pytest.raises(InvalidInputError, match=next(iter(wrong))):
        EyesConfig(**wrong)
