"""The optimum is better than any curve of its length that we know, and the bound than any other."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import legibility as lg
from legibility.curves import arc_length, path_curve
from legibility.errors import InvalidInputError
from legibility.evaluation.configuration import OptimumConfig
from legibility.evaluation.eyes import observers
from legibility.evaluation.optimum import best_within, bound, evaluate_optimum
from legibility.motion.archive import scene_archive
from legibility.motion.path import straight_waypoints


@given(seed=st.integers(0, 999), dim=st.sampled_from([2, 3]), sign=st.sampled_from([1, -1]))
@settings(deadline=None, max_examples=4)
def test_no_curve_surpasses_the_bound_of_its_length(seed, dim, sign):
    scene = lg.Scene.random(np.random.default_rng(seed), dim=dim, num_goals=3)
    known = list(observers(scene, lg.Observer()).values())
    archive = scene_archive(scene, 0, known[seed % len(known)])
    lengths = arc_length(archive.trajectories)
    order = np.argsort(lengths)
    for index in order[:: max(1, len(order) // 4)]:
        most = bound(scene, 0, archive.observer, sign, lengths[index] * 1.001)
        able = lengths <= lengths[index]
        assert (sign * archive.scores[able]).max() <= sign * most + 1e-6


def test_longer_motions_may_score_more():
    scene, observer = lg.Scene([0, 0.5], [[0.8, 0.6], [1, 0.3]]), lg.Observer()
    straight = np.linalg.norm(scene.goals[0] - scene.start)
    for sign in (1, -1):
        bounds = [sign * bound(scene, 0, observer, sign, s * straight) for s in (1, 1.5, 2.5)]
        assert bounds == sorted(bounds)
    line = straight_waypoints(scene.start, scene.goals[0])
    score = observer.score(path_curve(line, 200), scene, 0)
    for sign in (1, -1):  # of the straight line's length there is no other motion
        assert bound(scene, 0, observer, sign, straight) == pytest.approx(score, abs=0.1)


def test_the_optimum_is_found():
    scene, observer = lg.Scene([0, 0.5], [[0.8, 0.6], [1, 0.3]]), lg.Observer()
    archive = scene_archive(scene, 0, observer)
    lengths = arc_length(archive.trajectories)
    line = straight_waypoints(scene.start, scene.goals[0])
    for sign in (1, -1):
        found = best_within(archive, sign, 1.5 * lengths.min(), line, starts=3)
        best = (sign * archive.scores[lengths <= 1.5 * lengths.min()]).max()
        assert best < sign * found.best < sign * found.most


def test_evaluation(tiny, coarsely):
    config = OptimumConfig(scenes=2, starts=2, exact=True, seed=1)
    found = evaluate_optimum(tiny, config)
    assert json.loads(json.dumps(found, allow_nan=False)) == found
    for ends in found["rows"].values():
        for row in filter(None, ends.values()):
            assert 0.5 < row["of_optimum"]["median"] <= 1.01
            assert row["of_bound"]["median"] < row["of_optimum"]["median"] + 1e-6
            assert row["length"]["max"] < 2.6


def test_refuses():
    for wrong in ({"starts": 0}, {"regime": "obstacles"}):
        with pytest.raises(InvalidInputError):
            OptimumConfig(**wrong)
