"""Motions are rated as other people do, and the best within a bound is the best."""

import numpy as np
import pytest

import legibility as lg
from legibility.errors import InvalidInputError
from legibility.evaluation.configuration import ExternalConfig
from legibility.evaluation.external import (
    CLEARANCES,
    LENGTHS,
    METHODS,
    METRICS,
    YOURS,
    evaluate_external,
    rate,
)
from legibility.intent.metrics import dragan_legibility

SCENE = lg.Scene([0, 0.5], [[0.8, 0.6], [1, 0.3]])


@pytest.fixture(scope="module")
def modulator():
    return lg.Modulator.from_pretrained("block-reach-2d")


@pytest.fixture(scope="module")
def judge():
    return lg.build_archive(SCENE, cells=8, random_candidates=256, max_candidates=256)


def test_a_straight_line(judge):
    line = np.linspace(SCENE.start, SCENE.goals[0], 60)
    rated = rate(line, judge)
    assert list(rated) == list(METRICS)
    by_hand = dragan_legibility(line, SCENE.goals, 0, 20 / SCENE.size)
    assert rated["dragan_20"] == pytest.approx(by_hand, rel=1e-3)
    assert rated["length"] == pytest.approx(1)
    walls = SCENE.clearance_at(line[6:-6], 0).min() / SCENE.size
    assert rated["clearance"] == pytest.approx(walls, abs=0.01)


def test_the_number_of_points_does_not_matter(judge):
    t = np.linspace(0, 1, 2001)[:, None]
    curve = SCENE.start + t * (SCENE.goals[0] - SCENE.start)
    curve[:, 1] += 0.2 * np.sin(np.pi * t[:, 0])
    few, many = rate(curve[::20], judge), rate(curve, judge)
    for metric in METRICS:
        assert few[metric] == pytest.approx(many[metric], abs=0.02, rel=0.02), metric


@pytest.fixture(scope="module")
def result(modulator):
    return evaluate_external(modulator, ExternalConfig(scenes=3, goals=(2, 3), levels=3, seed=4))


def test_more_room_is_never_worse(result):
    assert list(result["methods"]) == list(METHODS)
    for method in result["methods"].values():
        assert [len(method[key]) for key in ("ceiling", "clear")] == [len(LENGTHS), len(CLEARANCES)]
        shares = [best["share"] for best in method["ceiling"]]
        assert shares == sorted(shares)
        shares = [best["share"] for best in method["clear"]]
        assert shares == sorted(shares, reverse=True)
        whole = [b["legibility"]["mean"] for b in method["ceiling"] if b["share"] == 1]
        assert whole == sorted(whole)


def test_legible_motions_are_legible_to_dragans_observer(result):
    legible = {name: method["dragan_20"]["mean"] for name, method in result["methods"].items()}
    assert legible["exact"] > legible["shortest"] + 0.05
    assert result["methods"]["shortest"]["length"]["mean"] == pytest.approx(1, abs=1e-3)


def test_workers_change_nothing(result, modulator):
    config = ExternalConfig(scenes=3, goals=(2, 3), levels=3, seed=4)
    assert evaluate_external(modulator, config, workers=2) == result


def test_yours(modulator, judge):
    line = np.linspace(SCENE.start, SCENE.goals[0], 60)
    way = np.array([[0, 0.5], [0.3, 0.9], [0.8, 0.6]])
    given = SCENE, 0, {"line": line, "way": way}
    result = evaluate_external(modulator, ExternalConfig(levels=2), given=given)
    own = result["methods"][YOURS]
    rated = [rate(curve, judge)["dragan_20"] for curve in (line, way)]
    assert own["dragan_20"]["mean"] == pytest.approx(np.mean(rated), rel=1e-3)
    assert own["ceiling"][0]["legibility"]["mean"] == pytest.approx(rated[0], rel=1e-3)
    assert own["ceiling"][-1]["legibility"]["mean"] == pytest.approx(max(rated), rel=1e-3)


def test_refuses(modulator):
    solid = lg.Scene([-0.2, 0, 0.2], [[0, 0.1, 0.1], [0, -0.1, 0.1]])
    with pytest.raises(InvalidInputError, match="plans in 2D, the scene is 3D"):
        evaluate_external(modulator, ExternalConfig(), given=(solid, 0, {}))
    for wrong in ({"levels": 1}, {"regime": "all"}, {"scenes": 0}):
        with pytest.raises(InvalidInputError, match=next(iter(wrong))):
            ExternalConfig(**wrong)
