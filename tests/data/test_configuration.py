"""Settings: filled in, checked, the same after a round trip; streams of random scenes."""

import dataclasses
import json
from typing import ClassVar

import numpy as np
import pytest

import legibility as lg
from legibility.data.configuration import REGIMES, DatasetConfig, DemonstrationsConfig, SceneStream
from legibility.errors import DatasetError, InvalidInputError
from legibility.intent.observer import KINDS
from legibility.motion.archive import DEFAULT_CELLS, build_archive
from legibility.scene import DEFAULT_WORKSPACE
from legibility.seeds import STREAMS

LIKE = lg.Observer(alpha=1.0, detour=2.0, label="rank")


class TestDataset:
    def test_cells_of_the_dimension_are_filled_in(self):
        """Coarser than an archive that judges."""
        for dim in (2, 3):
            assert 2 <= DatasetConfig(dim=dim).cells <= DEFAULT_CELLS[dim]

    @pytest.mark.parametrize(
        "config",
        [
            DatasetConfig(),
            DatasetConfig(dim=3, scenes=3, seed=5, stream="validation", goals=(3, 3)),
            DatasetConfig(
                regime="all", views=5, candidates=5000, per_scene=33, efficiency=0.5, cells=9,
                observer=lg.Observer(alpha=1.0, detour=2.0, label="rank"),
            ),
            DatasetConfig(observer=lg.Observer(prior=(1, 2), beta=3.0)),
        ],
        ids=str,
    )  # fmt: skip
    def test_round_trip(self, config):
        assert DatasetConfig.from_dict(json.loads(json.dumps(config.to_dict()))) == config

    @pytest.mark.parametrize(
        "change",
        [{"speed": 1}, {"observer": None}, {"observer": {"eyes": 2}}, {"goals": 3}],
        ids=str,
    )
    def test_settings_that_are_not_ours(self, change):
        with pytest.raises(DatasetError, match=next(iter(change))):
            DatasetConfig.from_dict({**DatasetConfig().to_dict(), **change})

    def test_for_validation(self):
        config = DatasetConfig(scenes=9000, seed=3, cells=9, regime="all")
        other = config.for_validation()
        assert (other.stream, other.scenes, other.views) == ("validation", 128, 1)
        assert (other.seed, other.cells, other.regime) == (3, 9, "all")
        assert other.observer == config.observer

    @pytest.mark.parametrize(
        "wrong",
        [
            {"dim": 4},
            {"dim": "2"},
            {"dim": [2]},
            {"scenes": 0},
            {"scenes": 1.5},
            {"seed": -1},
            {"seed": 0.5},
            {"stream": "test"},
            {"stream": "evaluation"},
            {"regime": "home"},
            {"views": 0},
            {"views": 1.5},
            {"candidates": 100},
            {"goals": (1, 4)},
            {"goals": (4, 3)},
            {"goals": (2, 13)},
            {"goals": (2.5, 4)},
            {"goals": (2,)},
            {"goals": 3},
            {"goals": "ab"},
            {"per_scene": 2},
            {"per_scene": 3.5},
            {"observer": None},
            {"observer": "rank"},
            {"efficiency": 0},
            {"efficiency": np.nan},
            {"efficiency": "much"},
            {"cells": 1},
            {"cells": 2.5},
        ],
        ids=str,
    )
    def test_bad_values(self, wrong):
        with pytest.raises(InvalidInputError, match=next(iter(wrong))):
            DatasetConfig(**wrong)


class TestDemonstrations:
    @pytest.mark.parametrize(
        "wrong",
        [{"noise": -1}, {"pushed": 1.5}, {"push": float("nan")}, {"demonstrations": -1}],
        ids=str,
    )
    def test_bad_values(self, wrong):
        with pytest.raises(InvalidInputError, match=next(iter(wrong))):
            DemonstrationsConfig(**wrong)

    @pytest.mark.parametrize(
        ("wrong", "match"),
        [
            ({"demonstrations": 66}, "at most 65"),
            ({"demonstrations": 1, "demonstrated": 999}, "at most 9"),
            ({"demonstrations": 0}, "at least 1"),
            ({"demonstrations": 1, "noise": 0.06}, r"noise must be a number from 0 to 0\.05"),
        ],
        ids=str,
    )
    def test_more_than_there_is(self, wrong, match):
        with pytest.raises(InvalidInputError, match=match):
            DemonstrationsConfig(**wrong).within(DatasetConfig(scenes=9))

    def test_noise_and_push_are_those_of_the_robot(self):
        config = DemonstrationsConfig(demonstrations=1).within(DatasetConfig())
        assert config.noise == pytest.approx(0.06 * 0.05)
        assert config.push == pytest.approx(2 * 0.05)
        given = DemonstrationsConfig(demonstrations=1, noise=0.0, push=0.3)
        assert given.within(DatasetConfig()) == given


@pytest.mark.parametrize("dim", [2, 3])
def test_streams_seeds_and_indices_never_share_a_scene(dim):
    scenes = [
        SceneStream(stream, dim, seed=seed).scene(index)
        for stream in STREAMS
        for seed in (0, 1, 2)
        for index in (0, 1, 2)
    ]
    points = {point.tobytes() for scene in scenes for point in scene.goals}
    assert len(points) == sum(scene.num_goals for scene in scenes)


@pytest.mark.parametrize("dim", [2, 3])
def test_a_scene_depends_on_its_index_alone(dim):
    first, again = (SceneStream("train", dim, seed=7) for _ in range(2))
    scenes = [first.scene(index) for index in range(5)]
    assert [again.scene(index) for index in reversed(range(5))] == scenes[::-1]
    assert all(scene.dim == dim for scene in scenes)


def test_number_of_goals():
    numbers = [SceneStream("train", goals=(3, 4)).scene(i).num_goals for i in range(12)]
    assert set(numbers) == {3, 4}


class TestRegimes:
    @pytest.mark.parametrize("regime", REGIMES)
    @pytest.mark.parametrize("dim", [2, 3])
    def test_draws_what_it_says(self, dim, regime):
        stream = SceneStream("train", dim, regime)
        scenes = [stream.scene(index) for index in range(12)]
        observers = [stream.observer_of(i, scene, LIKE) for i, scene in enumerate(scenes)]
        assert all(observer.scale == LIKE.scale for observer in observers)
        usual = [np.array_equal(s.workspace, DEFAULT_WORKSPACE[dim]) for s in scenes]
        numbers = [len(scene.obstacles) for scene in scenes]
        assert max(numbers) <= 4
        if regime == "training":
            assert {*usual} == {True, False}
            assert 0 in numbers
            assert max(numbers) > 0
            return
        assert {*usual} == {regime not in ("rooms", "all")}
        if regime == "obstacles":
            assert min(numbers) >= 1
        elif regime == "all":
            assert len({*numbers}) > 2
        else:
            assert max(numbers) == 0
        if regime in ("observers", "all"):
            assert {observer.kind for observer in observers} == set(KINDS)
        else:
            own = lg.Observer.paper(dim) if regime == "paper" else lg.Observer()
            wanted = dataclasses.replace(own, alpha=1.0, detour=2.0, label="rank")
            assert observers == [wanted] * 12

    def test_training_draws_every_observer(self):
        """A share of the paper's and of the default one, and others."""
        stream, scene = SceneStream("train", regime="training"), SceneStream("train").scene(0)
        observers = [stream.observer_of(index, scene, LIKE) for index in range(100)]
        default = dataclasses.replace(lg.Observer(), alpha=1.0, detour=2.0, label="rank")
        shares = [
            np.mean([o == default for o in observers]),
            np.mean([o.kind == "gaussian" and o.prior == "uniform" for o in observers]),
            np.mean([isinstance(o.prior, tuple) for o in observers]),
            np.mean([o.viewpoint is not None for o in observers]),
        ]
        assert min(shares) > 0.04

    @pytest.mark.parametrize("dim", [2, 3])
    def test_in_every_scene_a_curve_leads_to_the_target(self, dim):
        stream = SceneStream("train", dim, "all", seed=1)
        for index in range(4):
            scene = stream.scene(index)
            archive = build_archive(scene, cells=4, random_candidates=1024, max_candidates=1024)
            assert scene.feasible(archive.trajectories, 0).any()

    def test_views_of_a_scene_are_observers_of_their_own(self):
        stream = SceneStream("train", regime="observers")
        scene = stream.scene(3)
        views = [stream.observer_of(3, scene, LIKE, view) for view in range(4)]
        assert len(set(views)) == 4
        assert views == [stream.observer_of(3, scene, LIKE, view) for view in range(4)]
        assert views[0] == stream.observer_of(3, scene, LIKE)


class TestArchive:
    SMALL: ClassVar = {"cells": 8, "random_candidates": 1024, "max_candidates": 2048}

    def test_is_of_the_scene_and_its_observer(self):
        stream = SceneStream("validation", regime="observers", seed=1)
        archive = stream.archive(2, LIKE, **self.SMALL)
        assert archive.scene == stream.scene(2)
        assert archive.observer == stream.observer_of(2, archive.scene, LIKE)
        assert archive.target == 0

    def test_its_seed_is_of_the_index(self):
        stream, scene = SceneStream("train"), SceneStream("train").scene(0)
        ours = stream.archive(0, lg.Observer(), **self.SMALL)
        other = lg.build_archive(scene, **self.SMALL)
        assert not np.array_equal(ours.controls, other.controls)
        again = stream.archive(0, lg.Observer(), **self.SMALL)
        np.testing.assert_array_equal(ours.controls, again.controls)


@pytest.mark.parametrize(
    "wrong",
    [
        {"stream": "test"},
        {"stream": None},
        {"dim": 4},
        {"dim": "2"},
        {"regime": "home"},
        {"regime": None},
        {"seed": -1},
        {"seed": 0.5},
        {"seed": None},
        {"goals": (1, 4)},
        {"goals": (4, 3)},
        {"goals": (2, 13)},
        {"goals": (2.5, 4)},
        {"goals": (2, 3, 4)},
        {"goals": 3},
    ],
    ids=str,
)
def test_a_stream_refuses(wrong):
    with pytest.raises(InvalidInputError, match=next(iter(wrong))):
        SceneStream(**{"stream": "train", **wrong})
