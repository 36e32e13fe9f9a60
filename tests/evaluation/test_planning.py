"""Error against time: every planner is asked the same levels in the same scenes."""

import json

import numpy as np
import pytest

import legibility as lg
from legibility.errors import InvalidInputError
from legibility.evaluation.configuration import PlanningConfig
from legibility.evaluation.planning import PLACES, evaluate_planning, planner_text
from legibility.figures.paper import planning_figure

SMALL = PlanningConfig(scenes=2, levels=5, search=(64, 2048), seed=1)
NAMES = ["bare", "quick", "exact", "archive", "search 64", "search 2048"]


@pytest.fixture(scope="module")
def found(tiny, coarsely):
    return evaluate_planning(tiny, SMALL)


def test_structure(found):
    assert list(found) == list(PLACES)
    for place in found.values():
        assert list(place["planners"]) == NAMES
        for row in place["planners"].values():
            assert set(row) == {"error", "feasible", "new", "known"}
            assert row["new"]["min"] > 0 < row["known"]["min"]
    assert json.loads(json.dumps(found, allow_nan=False)) == found


def test_more_care_means_less_error(found):
    """Of an untrained network: what brings paths to their ℓ needs no training."""
    for place in found.values():
        errors = {name: row["error"]["mean"] for name, row in place["planners"].items()}
        assert errors["bare"] > 3 * errors["exact"]
        assert errors["search 64"] > errors["search 2048"] > place["noise"]["mean"]
        assert errors["quick"] < errors["bare"]
        assert place["planners"]["quick"]["feasible"]["min"] == 1


def test_a_scene_is_new_once(found):
    """What an archive takes to make is in the first plan alone."""
    for place in found.values():
        for name in ("exact", "archive"):
            row = place["planners"][name]
            assert row["new"]["median"] > 2 * row["known"]["median"]


def test_a_planner_by_hand(found, tiny):
    errors = []
    for index in range(SMALL.scenes):
        judge = SMALL.stream("dragan", 2).archive(index, lg.Observer())
        errors += [
            abs(judge.label_of(tiny.plan(judge.scene, 0, level, exact=True).score) - level)
            for level in np.linspace(-1, 1, 5)
        ]
    assert found["dragan"]["planners"]["exact"]["error"]["mean"] == pytest.approx(
        np.mean(errors), abs=0.02
    )


def test_figure(found, tmp_path):
    planning_figure(found, tmp_path / "planning.png")
    assert (tmp_path / "planning.png").read_bytes().startswith(b"\x89PNG")


def test_names():
    assert planner_text("search 16384") == "search among 16,384 curves"
    assert planner_text("exact") == "Legibility Modulator, exact"


@pytest.mark.parametrize("wrong", [{"search": (0,)}, {"levels": 2}, {"scenes": 1}, {"goals": 3}])
def test_refuses(wrong):
    with pytest.raises(InvalidInputError):
        PlanningConfig(**wrong)
