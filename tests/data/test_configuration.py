"""Settings: filled in, checked, the same after a round trip; streams of random scenes."""

import json

import numpy as np
import pytest

import legibility as lg
from legibility.data.configuration import DatasetConfig, DemonstrationsConfig, SceneStream
from legibility.errors import DatasetError, InvalidInputError
from legibility.motion.archive import DEFAULT_CELLS
from legibility.seeds import STREAMS


class TestDataset:
    def test_defaults_of_the_dimension_are_filled_in(self):
        for dim, sigma in ((2, 0.15), (3, 0.08)):
            config = DatasetConfig(dim=dim)
            assert (config.observer.sigma, config.cells) == (sigma, DEFAULT_CELLS[dim])

    @pytest.mark.parametrize(
        "config",
        [
            DatasetConfig(),
            DatasetConfig(dim=3, scenes=3, seed=5, stream="validation", goals=(3, 3)),
            DatasetConfig(
                per_scene=33, efficiency=0.5, cells=9, observer=lg.Observer(0.2, 1.0, "rank")
            ),
        ],
        ids=str,
    )
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
        config = DatasetConfig(scenes=9000, seed=3, cells=9)
        other = config.for_validation()
        assert (other.stream, other.scenes) == ("validation", 128)
        assert (other.seed, other.cells, other.observer) == (3, 9, config.observer)

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
            ({"demonstrations": 130}, "at most 129"),
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


class TestArchive:
    def test_is_of_the_scene_and_the_observer(self):
        stream, observer = SceneStream("validation", seed=1), lg.Observer(0.3, 1.0, "rank")
        archive = stream.archive(2, observer, cells=9)
        assert archive.scene == stream.scene(2)
        assert archive.observer == observer
        assert archive.field.sigma == 0.3
        assert archive.target == 0
        assert len(archive) <= 81

    def test_other_observers_read_the_same_curves(self):
        stream = SceneStream("train")
        one, other = (stream.archive(0, lg.Observer(sigma=sigma), cells=8) for sigma in (0.1, 0.3))
        np.testing.assert_array_equal(one.controls, other.controls)
        assert (one.scores != other.scores).any()

    def test_its_seed_is_of_the_index(self):
        stream, scene = SceneStream("train"), SceneStream("train").scene(0)
        ours = stream.archive(0, lg.Observer(), cells=8)
        assert not np.array_equal(ours.controls, lg.build_archive(scene, cells=8).controls)
        again = stream.archive(0, lg.Observer(), cells=8)
        np.testing.assert_array_equal(ours.controls, again.controls)


@pytest.mark.parametrize(
    "wrong",
    [
        {"stream": "test"},
        {"stream": None},
        {"dim": 4},
        {"dim": "2"},
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
