"""Disturbed motions are measured as they happen."""

import dataclasses

import numpy as np
import pytest

import legibility as lg
from legibility.errors import InvalidInputError
from legibility.evaluation.configuration import ControllerConfig
from legibility.evaluation.controller import ROWS, _angle, evaluate_controller

SHORT = ControllerConfig(scenes=3, goals=(2, 3), seed=3, budget=1e3)


@pytest.fixture(scope="module")
def found():
    return evaluate_controller(lg.Modulator.from_pretrained("block-reach-2d"), SHORT)


def test_rows(found):
    rows = found["rows"]
    assert list(rows) == list(ROWS)
    assert found["dt"] == 0.05
    for name, row in rows.items():
        assert 1 <= row["motions"] <= 3
        assert row["motions"] == 3 or name.startswith("obstacle")
        assert row["success"]["mean"] == 1
        assert row["contacts"] == 0
        assert 0 < row["step"]["median"] <= row["step"]["percentile"] <= row["step"]["greatest"]
        assert (row["delay"] is None) == (row["turn"] is None) == (name == "undisturbed")
        assert 0 <= row["error"]["mean"] < 0.5


def test_a_motion_goes_on_and_a_new_plan_does_not(found):
    rows = found["rows"]
    assert rows["asked"]["turn"]["greatest"] < 15
    assert rows["asked"]["turn"]["greatest"] < rows["asked, anew"]["turn"]["greatest"]
    assert rows["asked"]["error"]["mean"] <= rows["undisturbed"]["error"]["mean"] + 0.02
    assert rows["asked"]["delay"]["greatest"] == 0  # without a limit of time, at once
    turned = [rows[name]["turned"]["mean"] for name in ("undisturbed", "pushed", "pushed, anew")]
    assert turned[0] < turned[1] < turned[2]


def test_the_same_again(found):
    again = evaluate_controller(
        lg.Modulator.from_pretrained("block-reach-2d"), dataclasses.replace(SHORT, scenes=1)
    )
    once = evaluate_controller(
        lg.Modulator.from_pretrained("block-reach-2d"), dataclasses.replace(SHORT, scenes=1)
    )
    for name, row in again["rows"].items():
        for key in ("error", "turned", "turn", "delay", "success", "contacts"):
            assert row[key] == once["rows"][name][key]


def test_another_step():
    config = dataclasses.replace(SHORT, scenes=1, dt=0.02)
    result = evaluate_controller(lg.Modulator.from_pretrained("panda-block-reach"), config)
    assert result["dt"] == 0.02
    assert all(row["success"]["mean"] == 1 for row in result["rows"].values())


@pytest.mark.parametrize(
    ("wrong", "match"),
    [
        ({"dt": 0}, "dt must be"),
        ({"budget": -1}, "budget must be"),
        ({"regime": "rooms"}, "regime must be one of"),
        ({"backend": "tpu"}, "backend must be one of"),
    ],
)
def test_refuses(wrong, match):
    with pytest.raises(InvalidInputError, match=match):
        dataclasses.replace(SHORT, **wrong)


def test_angle():
    assert _angle(np.array([1.0, 0]), np.array([0, 3.0])) == pytest.approx(90)
    assert _angle(np.array([1.0, 1]), np.array([2.0, 2])) == pytest.approx(0, abs=1e-5)
