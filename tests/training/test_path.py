"""Stage 1: its losses, its scorer, and a run that was killed ends as one that was not."""

import dataclasses
import json

import numpy as np
import pytest
import torch
from trainings import CPU, SHORT, TINY, assert_same_run, rows, stop_at, tiny_diffuser

from legibility.data.configuration import DatasetConfig
from legibility.data.dataset import generate
from legibility.errors import CheckpointError, InvalidInputError
from legibility.intent.observer import Observer
from legibility.training.configuration import PathTrainingConfig
from legibility.training.loop import Run
from legibility.training.path import PathBatches, train_path, validate_dial
from legibility.training.team import Team


@pytest.fixture(scope="module")
def whole(data, validation, tmp_path_factory):
    """The folder and the model of a run of `SHORT` without interruption."""
    folder = tmp_path_factory.mktemp("whole")
    return folder, train_path(data, validation, Run(folder, CPU), SHORT, **TINY).model


class TestRun:
    def test_log(self, whole):
        log = rows(whole[0])
        assert [row["step"] for row in log] == [4, 5, 8]
        parts = {"loss", "velocity", "label", "contact", "jerk"}
        metrics = {"validation_feasible"}
        assert parts | metrics <= log[-1].keys()
        assert all(np.isfinite(value) for row in log for value in row.values())

    def test_model_is_of_the_data(self, whole, data):
        config = whole[1].config
        assert (config.dim, config.observer) == (data.config.dim, data.config.observer)
        assert config.channels == TINY["channels"]

    def test_resumes_bit_for_bit(self, data, validation, whole, tmp_path):
        with pytest.raises(KeyboardInterrupt):
            train_path(data, validation, Run(tmp_path, CPU, stop_at(6)), SHORT, **TINY)
        train_path(data, validation, Run(tmp_path, CPU), SHORT, **TINY)
        assert_same_run(whole[0], tmp_path)

    @pytest.mark.parametrize(
        ("settings", "message"),
        [
            ({"condition": 24}, r"model\.condition is 16 in the checkpoint and 24 now"),
            ({"squash": 0.2}, r"model\.squash is 0\.1 in the checkpoint and 0\.2 now"),
        ],
    )
    def test_another_network_in_the_same_folder(self, data, validation, whole, settings, message):
        with pytest.raises(CheckpointError, match=message):
            train_path(data, validation, Run(whole[0], CPU), SHORT, **{**TINY, **settings})

    def test_validation_data_of_another_observer(self, data, validation, tmp_path):
        config = dataclasses.replace(validation.config, observer=Observer(alpha=1.0))
        other = dataclasses.replace(validation, config=config)
        with pytest.raises(InvalidInputError, match=r"validation data have alpha 1\.0, the model"):
            train_path(data, other, Run(tmp_path, CPU), SHORT, **TINY)


class TestPrecision:
    def test_in_bfloat16_resumes_bit_for_bit(self, data, validation, whole, tmp_path):
        team = Team.join("cpu", "bf16")

        def train(name, **options):
            return train_path(
                data, validation, Run(tmp_path / name, team, **options), SHORT, **TINY
            )

        train("whole")
        with pytest.raises(KeyboardInterrupt):
            train("parts", progress=stop_at(6))
        train("parts")
        assert_same_run(tmp_path / "whole", tmp_path / "parts")
        losses, expected = (
            [row["loss"] for row in rows(f)] for f in (tmp_path / "whole", whole[0])
        )
        assert losses != expected
        np.testing.assert_allclose(losses, expected, rtol=0.05)

    def test_that_is_none(self):
        with pytest.raises(InvalidInputError, match="one of no, bf16, fp16, got 'double'"):
            Team.join("cpu", "double")


class TestConfig:
    @pytest.mark.parametrize(
        "wrong",
        [
            {"steps": 0},
            {"scenes": 0},
            {"per_scene": 1.5},
            {"learning_rate": 0},
            {"learning_rate": np.nan},
            {"warmup": -1},
            {"warmup": 1.5},
            {"weight_decay": -1},
            {"weight_decay": np.nan},
            {"dropout": 1},
            {"dropout": -0.1},
            {"dropout": "some"},
            {"score_weight": -1},
            {"score_weight": np.nan},
            {"contact_weight": -1},
            {"jerk_weight": np.nan},
            {"ema": 1.0},
            {"seed": -1},
            {"validate_every": 0},
            {"checkpoint_every": 0},
        ],
        ids=str,
    )
    def test_bad_values(self, wrong):
        with pytest.raises(InvalidInputError, match=next(iter(wrong))):
            PathTrainingConfig(**wrong)


class TestLoss:
    def test_falls_along_its_gradient(self, data):
        model = tiny_diffuser(data)
        batches = PathBatches(data, model, dataclasses.replace(SHORT, per_scene=64), CPU)
        model.spread.copy_(batches.spread(model))

        def loss():
            return batches.loss(model, torch.Generator().manual_seed(0))[0]

        before = loss()
        before.backward()
        gradients = [(p, p.grad) for p in model.parameters() if p.grad is not None]
        slope = sum(g.square().sum() for _, g in gradients)
        step = 2e-4 * before.detach() / slope
        with torch.no_grad():
            for parameter, gradient in gradients:
                parameter -= step * gradient
            fall = before - loss()
        assert 0.5 * step * slope < fall < 1.5 * step * slope

    def test_untrained_is_about_one(self, data):
        """The velocity has unit scale, so a denoiser that says 0 has a loss of 1."""
        model = tiny_diffuser(data)
        batches = PathBatches(data, model, dataclasses.replace(SHORT, per_scene=256), CPU)
        model.spread.copy_(batches.spread(model))
        torch.nn.init.zeros_(model.unet.outlet.bias)
        _, figures = batches.loss(model, torch.Generator().manual_seed(0))
        assert 0.8 < figures["velocity"] < 1.2

    def test_spread_gives_the_latent_unit_scale(self, data):
        model = tiny_diffuser(data)
        batches = PathBatches(data, model, SHORT, CPU)
        model.spread.copy_(batches.spread(model))
        latent = model.to_latent(batches.waypoints)
        torch.testing.assert_close(latent.square().mean((0, 1)), torch.ones_like(model.spread))
        torch.testing.assert_close(batches.spread(model), model.spread)

    def test_is_fixed_by_the_generator(self, data):
        model = tiny_diffuser(data)
        batches = PathBatches(data, model, SHORT, CPU)
        one, two, three = (
            batches.loss(model, torch.Generator().manual_seed(seed))[0] for seed in (0, 0, 1)
        )
        assert one == two != three

    def test_reaches_every_weight(self, data):
        model = tiny_diffuser(data)
        torch.nn.init.normal_(model.unet.outlet.weight, std=0.1)
        config = dataclasses.replace(SHORT, scenes=16, dropout=0.5)
        PathBatches(data, model, config, CPU).loss(model, torch.Generator().manual_seed(0))[
            0
        ].backward()
        idle = [n for n, p in model.named_parameters() if p.grad is None or not p.grad.abs().sum()]
        assert idle == []

    def test_is_the_sum_of_its_parts_by_their_weights(self, data):
        model = tiny_diffuser(data)
        weights = {"score_weight": 2.0, "contact_weight": 3.0, "jerk_weight": 0.5}
        for factor in (0.0, 1.0):
            config = dataclasses.replace(SHORT, **{k: factor * w for k, w in weights.items()})
            batches = PathBatches(data, model, config, CPU)
            loss, parts = batches.loss(model, torch.Generator().manual_seed(0))
            assert parts.keys() == {"velocity", "label", "contact", "jerk"}
            more = 2 * parts["label"] + 3 * parts["contact"] + parts["jerk"] / 2
            torch.testing.assert_close(loss.detach(), parts["velocity"] + factor * more)

    def test_batch_in_which_all_conditions_are_dropped(self, data):
        model = tiny_diffuser(data)
        batches = PathBatches(data, model, dataclasses.replace(SHORT, scenes=1, dropout=0.9), CPU)
        for seed in range(10):
            loss, _ = batches.loss(model, torch.Generator().manual_seed(seed))
            loss.backward()
            assert torch.isfinite(loss)
            assert all(torch.isfinite(p.grad).all() for p in model.parameters())

    def test_what_swings_wide_touches_more(self, data):
        model = tiny_diffuser(data)
        batches = PathBatches(data, model, SHORT, CPU)
        _, parts = batches.loss(model, torch.Generator().manual_seed(0))
        model.spread *= 4  # the same noise reaches four times as far
        _, wider = batches.loss(model, torch.Generator().manual_seed(0))
        assert 0 <= parts["contact"] < wider["contact"]


class TestValidation:
    def test_of_a_model_that_ignores_the_level(self, data):
        """No ranks to correlate, no answer better than chance; never a NaN."""
        model = tiny_diffuser(data).eval()
        torch.nn.init.zeros_(model.unet.outlet.bias)
        figures = validate_dial(model, PathBatches(data, model, SHORT, CPU))
        assert all(np.isfinite(value) for value in figures.values())
        assert abs(figures["validation_spearman"]) < 0.4
        assert figures["validation_error"] > 0.3

    def test_of_a_model_that_always_draws_the_same(self, data, monkeypatch):
        model = tiny_diffuser(data).eval()
        straight = model.from_latent(torch.zeros(len(data.scenes), 8, 2))
        monkeypatch.setattr(model, "sample", lambda *_, **__: straight)
        batches = PathBatches(data, model, SHORT, CPU)
        figures = validate_dial(model, batches)
        assert all(np.isfinite(value) for value in figures.values())
        json.dumps(figures, allow_nan=False)
        assert figures["validation_spearman"] == pytest.approx(0, abs=0.05)
        each, points = torch.arange(len(straight)), batches.scorer.curve(straight)
        label = batches.scorer.label(batches.conditions, each, points).clamp(-1, 1)
        error = (torch.linspace(-1, 1, 11) - label[:, None]).abs().mean()
        assert figures["validation_error"] == pytest.approx(float(error), abs=1e-4)

    def test_of_a_model_that_draws_the_data(self, data, monkeypatch):
        model = tiny_diffuser(data).eval()
        batches = PathBatches(data, model, SHORT, CPU)

        def best(conditions, level, noise, **options):
            nearest = (batches.labels - level[:, None]).abs().argmin(1)
            return batches.waypoints[torch.arange(len(level)), nearest]

        monkeypatch.setattr(model, "sample", best)
        figures = validate_dial(model, batches)
        assert figures["validation_spearman_worst"] > 0.9
        assert figures["validation_error"] < 0.2
        assert figures["validation_feasible"] > 0.9
        assert figures["validation_at_1"] > 0.5
        assert figures["validation_at_-1"] < -0.5


def test_a_small_model_learns_the_dial_on_scenes_it_never_saw(tmp_path):
    config = DatasetConfig(
        scenes=24, views=1, cells=12, per_scene=17, candidates=4096, regime="dragan"
    )
    data = generate(config, tmp_path / "train")
    validation = generate(
        dataclasses.replace(config, scenes=8, per_scene=9, stream="validation"),
        tmp_path / "validation",
    )
    how = PathTrainingConfig(
        steps=120, scenes=16, per_scene=8, warmup=20, learning_rate=4e-3, ema=0.95,
        score_weight=1.0, validate_every=120, checkpoint_every=120,
    )  # fmt: skip
    shape = {"channels": (16, 32), "condition": 32, "encoder_width": 8, "resolution": 16}
    metrics = train_path(data, validation, Run(tmp_path / "run", CPU), how, **shape).metrics
    assert metrics["validation_spearman"] > 0.5
    assert metrics["validation_error"] < 0.45
    assert metrics["validation_at_1"] > 0.1
    assert metrics["validation_at_-1"] < -0.1
