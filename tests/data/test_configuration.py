"""Settings of datasets and demonstrations: filled in, checked, and the same after a round trip."""

import json

import numpy as np
import pytest

import legibility as lg
from legibility.data.configuration import DatasetConfig, DemonstrationsConfig
from legibility.errors import DatasetError, InvalidInputError
from legibility.motion.archive import DEFAULT_CELLS


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
