"""Which rows there are, and that none is measured or trained twice."""

import functools
import json

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
    training_steps=2, batch_scenes=4, training_scenes=2, scene_numbers=(2, 3),
)  # fmt: skip
SMALL = ["reference", "another-seed", "twice-the-steps", "distilled", "without-label-loss",
         "without-contact-loss", "without-jerk-loss", "without-field", "rank-label", "long-ways",
         "scenes-3"]  # fmt: skip
ROWS = ["as-shipped", "reference", "guidance-1", "steps-1", *SMALL[1:]]


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


def test_variants():
    rows = variants(SHORT)
    assert list(rows) == ROWS
    assert {name for name, row in rows.items() if row.run == "reference"} == {
        "reference", "guidance-1", "steps-1"
    }  # fmt: skip
    assert rows["without-label-loss"].training == {"score_weight": 0}
    assert rows["scenes-3"].scenes == 3


class TestEvaluate:
    def test_every_row_is_measured(self, evaluated):
        _, result, _ = evaluated
        assert list(result["rows"]) == ROWS
        for name, row in result["rows"].items():
            assert row["small_run"] == (name != "as-shipped")
            assert set(COLUMNS) <= set(row["overall"]) <= set(METRICS)
            assert 0 <= row["quick_error"]["mean"] <= 2
            assert row["plan_ms"] == 1.5

    def test_rows_are_of_the_weights_that_they_say(self, evaluated, model):
        _, result, _ = evaluated
        shipped = json.loads((model / "config.json").read_text())["path"]["sha256"]
        hashes = {name: row["sha256"] for name, row in result["rows"].items()}
        assert hashes["as-shipped"] == shipped
        assert hashes["reference"] == hashes["guidance-1"] == hashes["steps-1"]
        # In two steps no path has come to shake or touch more than it learns from.
        quiet = ("without-contact-loss", "without-jerk-loss")
        others = [hashes[name] for name in SMALL if name not in quiet]
        assert len({*others, shipped}) == len(SMALL) - 1

    def test_small_runs_differ_in_what_they_say(self, evaluated, data):
        folder, _, _ = evaluated
        made = {}
        for name in SMALL:
            stages, training = load_stages(folder / name / "weights")
            config, record = stages["path"].config, training["path"]
            assert record.training["scenes"] == SHORT.batch_scenes
            if name not in ("rank-label", "long-ways"):
                assert record.digest == f"{data.digest}[:{record.data['scenes']}]"
            assert config.channels == TINY.channels
            plain = PathTrainingConfig()
            losses = ("score_weight", "contact_weight", "jerk_weight")
            made[name] = {
                "data": record.data["scenes"], "efficiency": record.data["efficiency"],
                "steps": record.training["steps"], "seed": record.training["seed"],
                "field": config.field, "label": config.observer.label,
                "distilled": config.distilled,
                "lost": {x for x in losses if not record.training[x]},
            }  # fmt: skip
            if not config.distilled:
                kept = {x for x in losses if record.training[x] == getattr(plain, x)}
                assert kept | made[name]["lost"] == set(losses)
        reference = {"data": 2, "efficiency": 0.1, "steps": 2, "seed": 0, "field": True,
                     "label": "anchored", "distilled": False, "lost": set()}  # fmt: skip
        changes = {
            "reference": {},
            "another-seed": {"seed": 1},
            "twice-the-steps": {"steps": 4},
            "distilled": {"distilled": True},
            "without-label-loss": {"lost": {"score_weight"}},
            "without-contact-loss": {"lost": {"contact_weight"}},
            "without-jerk-loss": {"lost": {"jerk_weight"}},
            "without-field": {"field": False},
            "rank-label": {"label": "rank"},
            "long-ways": {"efficiency": 1000},
            "scenes-3": {"data": 3},
        }
        assert made == {name: reference | change for name, change in changes.items()}
        assert Dataset.load(folder / "rank-data").scenes == data.scenes[: 2 * 2]

    def test_progress(self, evaluated):
        _, _, told = evaluated
        done = [now for now, _, _ in told]
        assert done == sorted(done)
        assert {total for _, total, _ in told} == {done[-1]}
        lines = [line for _, _, line in told if line]
        assert len(lines) == len(ROWS)
        assert lines[4].startswith("small run of another seed: spearman ")

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
