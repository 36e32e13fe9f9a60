"""What is measured of timed motions is what they do."""

import dataclasses

import numpy as np
import pytest
from arms import UR5E, ur5e

from legibility import Limits, Modulator, Scene
from legibility.errors import InvalidInputError
from legibility.evaluation.configuration import TimingConfig
from legibility.evaluation.timing import METRICS, _shares, evaluate_timing
from legibility.files import write_document

for extra in ("toppra", "mujoco", "mink"):
    pytest.importorskip(extra, reason="the evaluation of timing is NOT TESTED")

SHORT = TimingConfig(scenes=2, goals=(2, 3), levels=3, seed=3)


@pytest.mark.parametrize(
    ("name", "limits"),
    [("block-reach-2d", None), ("panda-block-reach", "panda"), ("panda-block-reach", "fr3")],
)
def test_limits_are_kept(name, limits, coarsely):
    result = evaluate_timing(
        Modulator.from_pretrained(name), dataclasses.replace(SHORT, limits=limits)
    )
    assert list(result["metrics"]) == list(METRICS)
    for metric in ("velocity", "acceleration", "jerk"):
        assert 0.1 < result["metrics"][metric]["greatest"] <= 1
    assert result["metrics"]["ends"]["greatest"] < 1e-2
    assert result["metrics"]["deviation"]["greatest"] < 0.1
    assert 1 <= result["metrics"]["over_bound"]["median"] < 1.5
    assert result["motions"] + result["refused"] == 6
    assert result["error"]["mean"] == pytest.approx(result["planned"]["mean"], abs=0.02)
    assert result["moves"] == ("panda" if limits else "a point")


def test_what_breaks_a_limit_is_seen():
    scene = Scene(start=[0, 0.5], goals=[[0.8, 0.6], [1, 0.3]])
    motion = Modulator.from_pretrained("block-reach-2d").plan(scene, 0, 0.5).timed(rate=1000)
    assert max(_shares(motion).values()) <= 1
    hasty = dataclasses.replace(motion, limits=Limits(0.4, 2, 20))
    assert _shares(hasty)["velocity"] == pytest.approx(1.25, abs=0.01)
    late = dataclasses.replace(motion, positions=motion.positions[200:])  # starts in motion
    shares = _shares(late)
    assert shares["ends"] == pytest.approx(
        np.linalg.norm(motion.velocities[200]) / 0.5, rel=0.02, abs=0.02
    )
    assert shares["jerk"] > 100


def test_motions_that_cannot_be_timed_are_counted(coarsely, tmp_path):
    """Of an arm that stands too far away for some of them."""
    arm, limits = ur5e(), {"velocity": [3] * 6, "acceleration": [10] * 6, "jerk": [1000] * 6}
    content = {**UR5E, "model": str(arm.model), "base": [-0.9, 0, 0, 0], "limits": limits}
    write_document(file := tmp_path / "arm.yaml", content)
    config = TimingConfig(scenes=4, goals=(2, 2), levels=3, arm=str(file))
    result = evaluate_timing(Modulator.from_pretrained("panda-block-reach"), config)
    assert result["motions"] + result["refused"] == 12
    assert result["refused"] > 0
    assert 1 <= len(result["why"]) <= result["refused"]
    assert "the arm ur5e cannot" in result["why"][0]


@pytest.mark.parametrize(
    ("wrong", "message"),
    [({"levels": 1}, "levels"), ({"regime": "observers"}, "regime must be one of dragan, obst")],
)
def test_refuses(wrong, message):
    with pytest.raises(InvalidInputError, match=message):
        TimingConfig(**wrong)
