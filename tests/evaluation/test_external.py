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
    _best,
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
    assert rated["feasible"] == 1
    outside = line + np.linspace(0, 1, 60)[:, None] * [0.4, 0]
    assert rate(outside, judge)["feasible"] == 0


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
    least = result["methods"]["shortest"]["dragan_20"]["mean"]
    for method in result["methods"].values():
        assert [len(method[key]) for key in ("ceiling", "clear")] == [len(LENGTHS), len(CLEARANCES)]
        shares = [best["share"] for best in method["ceiling"]]
        assert shares == sorted(shares)
        shares = [best["share"] for best in method["clear"]]
        assert shares == sorted(shares, reverse=True)
        best = [best["legibility"]["mean"] for best in method["ceiling"]]
        assert best == sorted(best)
        assert best[0] >= least - 1e-6  # where nothing fits the shortest counts


def test_a_motion_in_contact_does_not_count():
    rows = [{"all": [{"dragan_20": 0.9, "feasible": 0.0, "length": 1.0},
                     {"dragan_20": 0.7, "feasible": 1.0, "length": 1.2}]}]  # fmt: skip
    shortest = [{"dragan_20": 0.5, "length": 1.0}]
    for length, best, share in ((1.1, 0.5, 0), (1.3, 0.7, 1)):
        found = _best(rows, shortest, lambda m, c=length: m["length"] <= c)
        assert (found["legibility"]["mean"], found["share"]) == (best, share)
    found = _best(rows, shortest, lambda m: False)
    assert found == {"legibility": None, "share": 0}


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
