"""Which rows there are, and that none is measured or trained twice."""

import functools
import json

import numpy as np
import pytest
import torch

from legibility.data.configuration import DatasetConfig, SceneStream
from legibility.data.dataset import Dataset, generate
from legibility.errors import CheckpointError, InvalidInputError
from legibility.evaluation.ablations import COLUMNS, evaluate_ablations, variants
from legibility.evaluation.configuration import AblationsConfig
from legibility.evaluation.dial import METRICS
from legibility.intent.observer import Observer
from legibility.models.configuration import PathDiffuserConfig
from legibility.models.diffusion import noise_schedule
from legibility.models.path_diffuser import PathDiffuser
from legibility.models.pretrained import load_stages, save_stage
from legibility.training.configuration import PathTrainingConfig
from legibility.training.loop import LOG

TINY = PathDiffuserConfig(channels=(8,), condition=16, encoder_width=8, resolution=16)
SHORT = AblationsConfig(
    scenes=1, goals=(2, 2), levels=3, samples=1, sampling_steps=(1,), guidance=(1.0,),
    training_steps=2, training_scenes=2, scene_numbers=(2, 3),
)  # fmt: skip
ROWS = ["as-shipped", "steps-1", "guidance-1", "reference", "without-field", "rank-label",
        "scenes-3"]  # fmt: skip
SMALL = ROWS[3:]


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    """Weights of a network that learned nothing."""
    folder = tmp_path_factory.mktemp("model")
    torch.manual_seed(0)
    network = PathDiffuser(TINY)
    network.signal.copy_(noise_schedule(TINY.diffusion_steps))
    save_stage(folder, "path", network, None)
    return folder


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    config = DatasetConfig(scenes=4, views=2, cells=8, candidates=4096, per_scene=9)
    return generate(config, tmp_path_factory.mktemp("data"))


@pytest.fixture(scope="module")
def small(coarsely):
    """One thread, few scenes to train and validate on, each archive once, and no plan is timed."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("legibility.data.configuration.VALIDATION_SCENES", 2)
        patch.setattr("legibility.evaluation.ablations.plan_milliseconds", lambda *_, **__: 1.5)
        few = functools.partial(PathTrainingConfig, scenes=4, per_scene=4)
        patch.setattr("legibility.evaluation.ablations.PathTrainingConfig", few)
        patch.setattr(SceneStream, "archive", functools.cache(SceneStream.archive))
        yield
    torch.set_num_threads(threads)


@pytest.fixture(scope="module")
def evaluated(model, data, small, tmp_path_factory):
    """The folder, the result and what was told meanwhile."""
    folder, told = tmp_path_factory.mktemp("runs"), []
    result = evaluate_ablations(
        model, data, folder, SHORT, progress=lambda *args: told.append(args)
    )
    return folder, result, told


class TestVariants:
    def test_rows(self):
        assert list(variants(SHORT, TINY)) == ROWS

    def test_what_the_weights_are_like_anyway_is_no_row(self):
        config = AblationsConfig(sampling_steps=(3, 4), guidance=(0.3, 0.0))
        found = [name for name, v in variants(config, TINY).items() if not v.scenes]
        assert found == ["as-shipped", "steps-4", "guidance-0"]

    @pytest.mark.parametrize(
        ("changes", "message"),
        [
            ({"sampling_steps": (101,)}, "sampling_steps must be at most 100"),
            ({"sampling_steps": (0,)}, "sampling_steps must be"),
            ({"guidance": (np.nan,)}, "guidance must be finite"),
        ],
    )
    def test_what_cannot_be_sampled(self, changes, message):
        with pytest.raises(InvalidInputError, match=message):
            variants(AblationsConfig(**changes), TINY)


class TestEvaluate:
    def test_every_row_is_measured(self, evaluated):
        _, result, _ = evaluated
        assert list(result["rows"]) == ROWS
        for name, row in result["rows"].items():
            assert row["small_run"] == (name in SMALL)
            assert set(COLUMNS) <= set(row["overall"]) <= set(METRICS)
            assert row["plan_ms"] == 1.5

    def test_rows_are_of_the_weights_that_they_say(self, evaluated, model):
        _, result, _ = evaluated
        shipped = json.loads((model / "config.json").read_text())["path"]["sha256"]
        hashes = {name: row["sha256"] for name, row in result["rows"].items()}
        assert [name for name in ROWS if hashes[name] == shipped] == ROWS[:3]
        assert len({hashes[name] for name in SMALL}) == len(SMALL)

    def test_small_runs_differ_in_what_they_say(self, evaluated, data):
        folder, _, _ = evaluated
        made = {}
        for name in SMALL:
            stages, training = load_stages(folder / name / "weights")
            config = stages["path"].config
            made[name] = (config.field, config.observer.label, training["path"].data["scenes"])
            assert training["path"].training["steps"] == 2
            if name != "rank-label":
                assert training["path"].digest == f"{data.digest}[:{made[name][2]}]"
            assert config.channels == TINY.channels
        assert made == {
            "reference": (True, "anchored", 2),
            "without-field": (False, "anchored", 2),
            "rank-label": (True, "rank", 2),
            "scenes-3": (True, "anchored", 3),
        }
        assert Dataset.load(folder / "rank-data").scenes == data.scenes[: 2 * 2]

    def test_progress(self, evaluated):
        _, _, told = evaluated
        done = [now for now, _, _ in told]
        assert done == sorted(done)
        assert {total for _, total, _ in told} == {done[-1]}
        lines = [line for _, _, line in told if line]
        assert len(lines) == len(ROWS)
        assert lines[4].startswith("small run without the field: spearman ")

    def test_nothing_is_trained_twice(self, evaluated, model, data, small, monkeypatch):
        folder, result, _ = evaluated
        logs = {name: (folder / name / LOG).read_bytes() for name in SMALL}
        monkeypatch.setattr("legibility.training.path.PathBatches.loss", None)
        assert evaluate_ablations(model, data, folder, SHORT) == result
        assert logs == {name: (folder / name / LOG).read_bytes() for name in SMALL}

    def test_other_training_in_the_same_folder(self, evaluated, model, data, small):
        folder, _, _ = evaluated
        other = AblationsConfig(**{**vars(SHORT), "training_steps": 3})
        with pytest.raises(CheckpointError, match=r"training\.steps is 2 in the .* and 3 now"):
            evaluate_ablations(model, data, folder, other)

    @pytest.mark.parametrize(
        ("changes", "message"),
        [
            ({"stream": "validation"}, "stream train and label anchored, theirs are validation"),
            (
                {"observer": Observer(label="rank")},
                "stream train and label anchored, theirs are train and rank",
            ),
            ({"observer": Observer(detour=2)}, r"the data have detour 2\.0, the model 2\.5"),
            ({"dim": 3}, "the data have dim 3, the model 2"),
        ],
    )
    def test_data_that_are_not_for_the_model(self, changes, message, model, tmp_path):
        config = DatasetConfig(**{
            "scenes": 3, "views": 1, "goals": (2, 2), "cells": 6, "candidates": 4096,
            "per_scene": 3, **changes,
        })  # fmt: skip
        data = generate(config, tmp_path / "data")
        with pytest.raises(InvalidInputError, match=message):
            evaluate_ablations(model, data, tmp_path / "out", SHORT)
        assert not (tmp_path / "out").exists()
