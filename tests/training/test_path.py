"""Stage 1: its losses, its scorer, and a run that was killed ends as one that was not."""

import dataclasses
import json

import numpy as np
import pytest
import torch
from trainings import CPU, SHORT, TINY, assert_same_run, rows, stop_at, tiny_diffuser

from legibility.curves import path_curve
from legibility.data.configuration import DatasetConfig
from legibility.data.dataset import LABEL_KNOTS, generate
from legibility.errors import CheckpointError, InvalidInputError
from legibility.frame import Frame
from legibility.intent.observer import Observer
from legibility.training import path
from legibility.training.configuration import PathTrainingConfig
from legibility.training.loop import Run
from legibility.training.path import FrameScorer, PathBatches, train_path, validate_dial
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
        assert {"loss", "velocity", "label", "contact", "jerk", "validation_feasible"} <= log[
            -1
        ].keys()
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


def conditions_of(data):
    return tiny_diffuser(data).conditions(data.scenes, [0] * len(data.scenes), data.observers)


class TestFrameScorer:
    @pytest.fixture(
        scope="class",
        params=[(2, "anchored", "all"), (2, "rank", "observers"), (3, "anchored", "all")],
        ids=str,
    )
    @staticmethod
    def scored(request, tmp_path_factory):
        dim, label, regime = request.param
        config = DatasetConfig(
            dim=dim, scenes=2, views=2, cells=20 if dim == 2 else 9, per_scene=33, seed=2,
            regime=regime, candidates=8192, observer=Observer(label=label),
        )  # fmt: skip
        data = generate(config, tmp_path_factory.mktemp("scored"))
        frames = [Frame.of(scene, 0) for scene in data.scenes]
        conditions = conditions_of(data)
        waypoints = [f.world_to_frame(w) for f, w in zip(frames, data.waypoints, strict=True)]
        each = torch.arange(len(frames)).repeat_interleave(config.per_scene)
        return (
            data,
            FrameScorer(data, conditions),
            conditions.map(lambda x: x[each]),
            each,
            torch.from_numpy(np.concatenate(waypoints).astype(np.float32)),
        )

    def test_score_is_the_legibility_score(self, scored):
        data, scorer, conditions, _, waypoints = scored
        found = scorer.score(conditions, scorer.curve(waypoints)).numpy()
        exact = data.scores.ravel()
        np.testing.assert_allclose(found, exact, rtol=0.02, atol=0.01)
        assert np.abs(found - exact).mean() < 0.005 * np.abs(exact).mean()

    def test_label_is_the_archives(self, scored):
        data, scorer, conditions, each, waypoints = scored
        found = scorer.label(conditions, each, scorer.curve(waypoints)).numpy()
        gaps = np.abs(found - data.labels.ravel())[self.trusted(scorer, each)]
        assert gaps.mean() < 0.02
        assert gaps.max() < 0.25

    @staticmethod
    def trusted(scorer, each):
        """The rows of scenes whose sides of the dial are wide enough to mean something."""
        return (scorer.trust[each].amin(1) == 1).numpy()

    def test_label_of_the_knots(self, scored, monkeypatch):
        _, scorer, conditions, each, waypoints = scored
        for index in range(0, len(LABEL_KNOTS), 8):
            wanted = -torch.exp(-scorer.knots[each, index])
            monkeypatch.setattr(scorer, "score", lambda *_, wanted=wanted: wanted)
            found = scorer.label(conditions, each, scorer.curve(waypoints))
            np.testing.assert_allclose(found, LABEL_KNOTS[index], atol=2e-3)

    def test_label_goes_on_beyond_the_ends(self, scored, monkeypatch):
        _, scorer, conditions, each, waypoints = scored
        for end, sign in ((0, -1), (-1, 1)):
            beyond = -torch.exp(-scorer.knots[each, end] - sign * 0.1)
            monkeypatch.setattr(scorer, "score", lambda *_, beyond=beyond: beyond)
            found = scorer.label(conditions, each, scorer.curve(waypoints))
            assert (sign * found > 1).all()

    def test_gradient_is_finite_and_that_of_the_score(self, scored):
        _, scorer, conditions, each, waypoints = scored
        waypoints = waypoints.clone().requires_grad_()
        for value in (
            scorer.score(conditions, scorer.curve(waypoints)),
            scorer.label(conditions, each, scorer.curve(waypoints)),
        ):
            (gradient,) = torch.autograd.grad(value.sum(), waypoints)
            assert torch.isfinite(gradient).all()
            assert (gradient.abs().sum((1, 2)) > 0).float().mean() > 0.9
        step = 1e-2 * torch.nn.functional.normalize(gradient.flatten(1)).view_as(gradient)
        with torch.no_grad():
            up = scorer.label(conditions, each, scorer.curve(waypoints + step))
            down = scorer.label(conditions, each, scorer.curve(waypoints - step))
        assert ((up - down) > 0).float().mean() > 0.95

    @pytest.mark.parametrize("place", [0.0, 1.0, 1e3])
    def test_gradient_is_finite_where_waypoints_coincide(self, scored, place):
        _, scorer, conditions, each, waypoints = scored
        waypoints = torch.full_like(waypoints, place).requires_grad_()
        value = scorer.label(conditions, each, scorer.curve(waypoints))
        (gradient,) = torch.autograd.grad(value.sum(), waypoints)
        assert torch.isfinite(value).all()
        assert torch.isfinite(gradient).all()

    def test_of_any_smooth_curve(self, scored):
        """Not only of what the archive holds: score and label are the observer's."""
        data, scorer, conditions, each, _ = scored
        rng, row = np.random.default_rng(0), 1
        scene, observer, frame = (
            data.scenes[row],
            data.observers[row],
            Frame.of(data.scenes[row], 0),
        )
        straight = np.linspace(scene.start, scene.goals[0], 10)
        bend = np.sin(np.linspace(0, np.pi, 10))[:, None] * rng.normal(size=(20, 1, scene.dim))
        paths = straight + 0.3 * frame.scale * bend
        exact = observer.score(path_curve(paths, 200), scene, 0)
        waypoints = torch.from_numpy(frame.world_to_frame(paths[:, 1:-1]).astype(np.float32))
        chosen = torch.full((20,), row * data.config.per_scene)  # any trajectory of the row
        assert (each[chosen] == row).all()
        conditions, points = conditions.map(lambda x: x[chosen]), scorer.curve(waypoints)
        np.testing.assert_allclose(scorer.score(conditions, points), exact, rtol=0.02, atol=0.01)
        if self.trusted(scorer, each)[chosen].all():
            label = np.interp(exact, data.score_at_label[row], LABEL_KNOTS)
            found = scorer.label(conditions, each[chosen], points).clamp(-1, 1)
            assert np.abs(found.numpy() - label).max() < 0.1

    def test_contact_is_zero_exactly_for_curves_that_keep_the_pad(self, scored):
        data, scorer, conditions, each, waypoints = scored
        generator = torch.Generator().manual_seed(0)
        waypoints = waypoints + 0.1 * torch.randn(waypoints.shape, generator=generator)
        points = scorer.curve(waypoints)
        contact = scorer.contact(conditions, points).numpy()
        margin = []
        for row, scene in enumerate(data.scenes):
            frame, curves = Frame.of(scene, 0), points[each == row].double().numpy()
            margin.append(scene.margin_at(frame.frame_to_world(curves), 0).min(-1) / frame.scale)
        short = path._PAD - np.concatenate(margin)
        assert (contact[short < -1e-3] == 0).all()
        assert (contact[short > 1e-3] > short[short > 1e-3] / 4.1 - 1e-3).all()
        assert (contact <= 1.25 * np.maximum(short, 0) + 1e-3).all()
        assert (short < -1e-3).any()
        assert (short > 1e-3).any()

    def test_jerk_costs_beyond_that_of_the_other_path(self, scored):
        _, scorer, _, _, waypoints = scored
        assert (scorer.jerk(waypoints, waypoints) == 0).all()
        waves = waypoints + 0.2 * torch.tensor([1.0, -1] * 4)[:, None]
        assert (scorer.jerk(waves, waypoints) > 0.5).all()
        assert (scorer.jerk(waypoints, waves) == 0).all()

    def test_error_is_of_the_label_and_trusts_narrow_sides_less(self, scored, monkeypatch):
        _, scorer, conditions, each, waypoints = scored
        points = scorer.curve(waypoints)
        level = torch.where(torch.arange(len(each)) % 2 == 0, 1.0, -1.0)
        monkeypatch.setattr(scorer, "trust", torch.ones_like(scorer.trust))
        for achieved, loss in ((1.5 * level, 0.0), (0.5 * level, 0.45), (-1.0 * level, 1.95)):
            monkeypatch.setattr(scorer, "label", lambda *_, achieved=achieved: achieved)
            found = scorer.error(conditions, each, points, level)
            torch.testing.assert_close(found, torch.full_like(found, loss))
        scorer.trust[:, 1] = 0.1  # the legible side
        found = scorer.error(conditions, each, points, level)
        torch.testing.assert_close(found, torch.where(level > 0, 0.195, 1.95))


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
        figures = validate_dial(model, PathBatches(data, model, SHORT, CPU))
        assert all(np.isfinite(value) for value in figures.values())
        json.dumps(figures, allow_nan=False)
        assert figures["validation_spearman"] == pytest.approx(0, abs=0.05)
        assert figures["validation_error"] == pytest.approx(
            np.abs(np.linspace(-1, 1, 11)).mean(), abs=0.02
        )

    def test_of_a_model_that_draws_the_data(self, data, monkeypatch):
        model = tiny_diffuser(data).eval()
        batches = PathBatches(data, model, SHORT, CPU)

        def best(conditions, level, noise, **options):
            nearest = (batches.labels - level[:, None]).abs().argmin(1)
            return batches.waypoints[torch.arange(len(level)), nearest]

        monkeypatch.setattr(model, "sample", best)
        figures = validate_dial(model, batches)
        assert figures["validation_spearman_worst"] > 0.9
        assert figures["validation_error"] < 0.1
        assert figures["validation_feasible"] > 0.9
        assert figures["validation_at_1"] > 0.7
        assert figures["validation_at_-1"] < -0.7


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


class TestSidesThatAreThin:
    """Scenes whose whole legible side lies within a millionth of the range of their scores."""

    def test_label_is_exact_and_has_a_gradient(self, tmp_path):
        config = DatasetConfig(
            scenes=12, views=1, per_scene=33, cells=16, candidates=4096, regime="paper",
            stream="validation",
        )  # fmt: skip
        data = generate(config, tmp_path)
        knots = data.score_at_label
        share = (knots[:, -1] - knots[:, 32]) / (knots[:, -1] - knots[:, 0])
        thin = int(np.argmin(share))
        assert share[thin] < 1e-6
        frame = Frame.of(data.scenes[thin], 0)
        each = torch.full((config.per_scene,), thin)
        conditions = conditions_of(data).map(lambda x: x[each])
        waypoints = torch.from_numpy(
            frame.world_to_frame(data.waypoints[thin]).astype(np.float32)
        ).requires_grad_()
        scorer = FrameScorer(data, conditions_of(data))
        label = scorer.label(conditions, each, scorer.curve(waypoints))
        assert np.abs(label.detach().numpy() - data.labels[thin]).max() < 0.1
        (gradient,) = torch.autograd.grad(label.sum(), waypoints)
        assert torch.isfinite(gradient).all()
        assert (gradient[17:].abs().sum((1, 2)) > 1e-3).all()
