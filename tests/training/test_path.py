"""Training learns, and a run that was killed ends as one that was not."""

import dataclasses
import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

import legibility as lg
from legibility.curves import path_curve
from legibility.data.configuration import DatasetConfig
from legibility.data.dataset import LABEL_KNOTS, Dataset, generate
from legibility.errors import CheckpointError, InvalidInputError
from legibility.models.checkpoint import load_tensors, save_tensors
from legibility.models.configuration import PathDiffuserConfig
from legibility.models.diffusion import noise_schedule
from legibility.models.frame import Frame
from legibility.models.path_diffuser import PathDiffuser
from legibility.training.configuration import PathTrainingConfig
from legibility.training.loop import CHECKPOINT, LOG
from legibility.training.path import FrameScorer, PathBatches, train_path, validate_dial
from legibility.training.team import Team

torch.set_num_threads(1)

SOURCE = str(Path(lg.__file__).parents[1])
TINY = {"channels": (8, 16), "condition": 16, "encoder_width": 8, "resolution": 16}
SHORT = PathTrainingConfig(
    steps=12, scenes=3, per_scene=4, warmup=3, validate_every=5, checkpoint_every=4
)
CPU = Team(torch.device("cpu"))


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """Of the training and the validation data in 2D."""
    root = tmp_path_factory.mktemp("data")
    config = DatasetConfig(scenes=5, cells=8, per_scene=17)
    generate(config, root / "train")
    generate(dataclasses.replace(config, stream="validation", scenes=2), root / "validation")
    return root


@pytest.fixture(scope="module")
def data(folders):
    return Dataset.load(folders / "train")


@pytest.fixture(scope="module")
def validation(folders):
    return Dataset.load(folders / "validation")


@pytest.fixture(scope="module")
def whole(data, validation, tmp_path_factory):
    """The folder and the model of a run of `SHORT` without interruption."""
    folder = tmp_path_factory.mktemp("whole")
    return folder, train_path(data, validation, folder, SHORT, **TINY)


def rows(folder):
    """The log without its times."""
    found = [json.loads(line) for line in (folder / LOG).read_text().splitlines()]
    return [{name: value for name, value in row.items() if name != "seconds"} for row in found]


def assert_same_run(folder, other):
    assert rows(folder) == rows(other)
    (one, header), (two, head) = (load_tensors(f / CHECKPOINT) for f in (folder, other))
    assert one.keys() == two.keys()
    for name, tensor in one.items():
        assert torch.equal(tensor, two[name]), name
    assert {**header, "seconds": 0} == {**head, "seconds": 0}


class TestRun:
    def test_log(self, whole):
        found = rows(whole[0])
        assert [row["step"] for row in found] == [4, 5, 8, 10, 12]
        assert {"loss", "velocity", "label"} <= found[-1].keys()
        for row in found:
            assert ("validation_spearman" in row) == (row["step"] in (5, 10, 12))
            assert all(np.isfinite(value) for value in row.values())

    def test_model_is_of_the_data(self, whole, data):
        config = whole[1].config
        for name in ("dim", "sigma", "alpha", "label"):
            assert getattr(config, name) == getattr(data.config, name)
        assert config.channels == TINY["channels"]

    def test_model_is_the_moving_average(self, whole):
        tensors = load_tensors(whole[0] / CHECKPOINT)[0]
        for name, tensor in whole[1].state_dict().items():
            assert torch.equal(tensor, tensors[f"average.{name}"])
        assert any(
            not torch.equal(tensor, tensors[f"model.{name}"])
            for name, tensor in whole[1].state_dict().items()
        )

    def test_progress(self, data, validation, tmp_path):
        seen = []
        train_path(
            data, validation, tmp_path, dataclasses.replace(SHORT, steps=5),
            progress=lambda step, steps, figures: seen.append((step, steps, bool(figures))), **TINY,
        )  # fmt: skip
        assert seen == [(i, 5, i >= 4) for i in range(1, 6)]

    def test_seed_fixes_the_weights(self, whole, data, validation, tmp_path):
        train_path(data, validation, tmp_path / "same", SHORT, **TINY)
        assert_same_run(whole[0], tmp_path / "same")
        other = train_path(
            data, validation, tmp_path / "other", dataclasses.replace(SHORT, seed=1), **TINY
        )
        assert not torch.equal(other.level.weight, whole[1].level.weight)

    def test_random_numbers_of_others_do_not_matter(self, whole, data, validation, tmp_path):
        def disturb(step, steps, figures):
            torch.manual_seed(step)
            np.random.seed(step)  # noqa: NPY002

        train_path(data, validation, tmp_path, SHORT, progress=disturb, **TINY)
        assert_same_run(whole[0], tmp_path)


class TestResume:
    @pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="no SIGKILL on this system")
    @pytest.mark.parametrize("step", [6])  # after a checkpoint at 4 and a row of the log at 5
    def test_after_a_kill(self, folders, data, validation, whole, tmp_path, step):
        script = f"""
import os, signal, sys, torch
torch.set_num_threads(1)
from legibility.data.dataset import Dataset
from legibility.training import PathTrainingConfig, train_path
def kill(step, steps, figures):
    if step == {step}:
        os.kill(os.getpid(), signal.SIGKILL)
data, validation = (Dataset.load(sys.argv[1] + "/" + n) for n in ("train", "validation"))
train_path(data, validation, sys.argv[2], PathTrainingConfig(**{dataclasses.asdict(SHORT)}),
           progress=kill, **{TINY})
"""
        run = subprocess.run(
            [sys.executable, "-c", script, str(folders), str(tmp_path)],
            env={**os.environ, "PYTHONPATH": SOURCE},
            capture_output=True,
            text=True,
        )
        assert run.returncode == -signal.SIGKILL, run.stderr
        assert load_tensors(tmp_path / CHECKPOINT)[1]["step"] == 4
        assert [row["step"] for row in rows(tmp_path)] == [4, 5]
        seen = []
        train_path(
            data, validation, tmp_path, SHORT,
            progress=lambda step, steps, figures: seen.append(step), **TINY,
        )  # fmt: skip
        assert seen == list(range(5, 13))
        assert_same_run(whole[0], tmp_path)

    @pytest.mark.parametrize("step", [1, 4, 8, 11])
    def test_after_an_exception(self, data, validation, whole, tmp_path, step):
        def stop(done, steps, figures):
            if done == step:
                raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            train_path(data, validation, tmp_path, SHORT, progress=stop, **TINY)
        train_path(data, validation, tmp_path, SHORT, **TINY)
        assert_same_run(whole[0], tmp_path)

    def test_half_a_row_of_the_log_is_dropped(self, data, validation, whole, tmp_path):
        def stop(done, steps, figures):
            if done == 9:
                raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            train_path(data, validation, tmp_path, SHORT, progress=stop, **TINY)
        with open(tmp_path / LOG, "a") as log:
            log.write('{"step": 10, "los')
        train_path(data, validation, tmp_path, SHORT, **TINY)
        assert_same_run(whole[0], tmp_path)

    @pytest.fixture
    def finished(self, whole, tmp_path):
        """A copy of the folder of a finished run, to spoil."""
        for name in (CHECKPOINT, LOG):
            (tmp_path / name).write_bytes((whole[0] / name).read_bytes())
        return tmp_path

    def test_of_a_finished_run_is_the_same_model(self, data, validation, whole, finished):
        again = train_path(data, validation, finished, SHORT, **TINY)
        for name, tensor in whole[1].state_dict().items():
            assert torch.equal(tensor, again.state_dict()[name])
        for name in (CHECKPOINT, LOG):
            assert (finished / name).read_bytes() == (whole[0] / name).read_bytes()

    def test_log_survives_a_second_interruption(self, data, validation, whole, tmp_path):
        def stop(done, steps, figures):
            if done in (6, 7):
                raise KeyboardInterrupt

        for _ in range(2):
            with pytest.raises(KeyboardInterrupt):
                train_path(data, validation, tmp_path, SHORT, progress=stop, **TINY)
            assert [row["step"] for row in rows(tmp_path)][:1] == [4]
        train_path(data, validation, tmp_path, SHORT, **TINY)
        assert_same_run(whole[0], tmp_path)

    @pytest.mark.parametrize(
        ("change", "settings", "message"),
        [
            ({"seed": 1}, {}, r"another run \(training differ"),
            ({"steps": 13}, {}, r"another run \(training differ"),
            ({"learning_rate": 1e-4}, {}, r"another run \(training differ"),
            ({}, {"condition": 24}, r"another run \(model differ"),
            ({}, {"squash": 0.2}, r"another run \(model differ"),
        ],
    )
    def test_of_another_run(self, data, validation, whole, change, settings, message):
        with pytest.raises(CheckpointError, match=message):
            train_path(
                data, validation, whole[0], dataclasses.replace(SHORT, **change),
                **{**TINY, **settings},
            )  # fmt: skip

    def test_of_other_data(self, data, validation, whole):
        with pytest.raises(CheckpointError, match=r"another run \(data differ"):
            train_path(dataclasses.replace(data, digest="0"), validation, whole[0], SHORT, **TINY)

    def test_of_half_a_checkpoint(self, data, validation, finished):
        content = (finished / CHECKPOINT).read_bytes()
        (finished / CHECKPOINT).write_bytes(content[: len(content) // 2])
        with pytest.raises(CheckpointError, match="corrupted"):
            train_path(data, validation, finished, SHORT, **TINY)

    @pytest.mark.parametrize(
        "lost", ["model.level.weight", "average.level.weight", "optimizer.0.exp_avg",
                 "optimizer."]
    )  # fmt: skip
    def test_of_a_checkpoint_without_a_tensor(self, data, validation, finished, lost):
        tensors, header = load_tensors(finished / CHECKPOINT)
        kept = {name: x for name, x in tensors.items() if not name.startswith(lost)}
        assert len(kept) < len(tensors)
        save_tensors(finished / CHECKPOINT, kept, {**header, "step": 8})
        with pytest.raises(CheckpointError):
            train_path(data, validation, finished, SHORT, **TINY)

    @pytest.mark.parametrize("name", ["model.level.weight", "optimizer.0.exp_avg"])
    @pytest.mark.parametrize("value", ["nan", "shape"])
    def test_of_a_checkpoint_with_a_broken_tensor(self, data, validation, finished, name, value):
        tensors, header = load_tensors(finished / CHECKPOINT)
        broken = (
            torch.full_like(tensors[name], torch.nan) if value == "nan" else torch.ones(1, 1, 7)
        )
        save_tensors(finished / CHECKPOINT, {**tensors, name: broken}, {**header, "step": 8})
        with pytest.raises(CheckpointError):
            train_path(data, validation, finished, SHORT, **TINY)

    @pytest.mark.parametrize("header", [None, {}, [], {"step": 4}, {"step": 4, "seconds": 1}])
    def test_of_something_else(self, data, validation, finished, header):
        save_tensors(finished / CHECKPOINT, {"a": torch.ones(1)}, header)
        with pytest.raises(CheckpointError):
            train_path(data, validation, finished, SHORT, **TINY)


class TestPrecision:
    def test_in_bfloat16_resumes_bit_for_bit(self, data, validation, whole, tmp_path):
        def stop(done, steps, figures):
            if done == 6:
                raise KeyboardInterrupt

        run, again = ((data, validation, tmp_path / name, SHORT) for name in ("whole", "stopped"))
        train_path(*run, precision="bf16", **TINY)
        with pytest.raises(KeyboardInterrupt):
            train_path(*again, precision="bf16", progress=stop, **TINY)
        train_path(*again, precision="bf16", **TINY)
        assert_same_run(tmp_path / "whole", tmp_path / "stopped")
        losses, expected = ([row["loss"] for row in rows(f) if "loss" in row]
                            for f in (tmp_path / "whole", whole[0]))  # fmt: skip
        assert losses != expected
        np.testing.assert_allclose(losses, expected, rtol=0.02)

    def test_of_another_precision_is_another_run(self, data, validation, whole, tmp_path):
        with pytest.raises(CheckpointError, match=r"another run \(precision differ"):
            train_path(data, validation, whole[0], SHORT, precision="bf16", **TINY)
        once = dataclasses.replace(SHORT, steps=1)
        train_path(data, validation, tmp_path, once, precision="bf16", **TINY)
        with pytest.raises(CheckpointError, match=r"another run \(precision differ"):
            train_path(data, validation, tmp_path, once, **TINY)

    def test_that_is_none(self):
        with pytest.raises(InvalidInputError, match="one of no, bf16, fp16, got 'double'"):
            Team.join("cpu", "double")

    def test_products_of_float32_stay_float32(self):
        before = torch.get_float32_matmul_precision()
        torch.manual_seed(0)
        x, y = torch.randn(2, 300, 300)
        with CPU.products():
            found = x @ y
        torch.testing.assert_close(found.double(), x.double() @ y.double(), rtol=0, atol=1e-4)
        assert torch.get_float32_matmul_precision() == before


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


def tiny_model(data, seed=0, **settings):
    torch.manual_seed(seed)
    names = ("dim", "sigma", "alpha", "label")
    fixed = {name: getattr(data.config, name) for name in names}
    model = PathDiffuser(PathDiffuserConfig(**{**TINY, **fixed, **settings}))
    model.signal.copy_(noise_schedule(model.config.diffusion_steps))
    return model


class TestLoss:
    def test_falls(self, data, validation, tmp_path):
        config = dataclasses.replace(
            SHORT, steps=120, learning_rate=5e-3, ema=0.9, score_weight=1.0, validate_every=120
        )
        before = tiny_model(data)
        after = train_path(data, validation, tmp_path, config, **TINY)
        before.spread.copy_(after.spread)
        batches = PathBatches(data, after, dataclasses.replace(config, per_scene=64), CPU)
        with torch.no_grad():
            losses = [
                batches.loss(model, torch.Generator().manual_seed(0))[0]
                for model in (before, after)
            ]
        assert losses[1] < 0.8 * losses[0]

    def test_untrained_is_about_one(self, data):
        """The velocity has unit scale, so a denoiser that says 0 has a loss of 1."""
        model = tiny_model(data)
        batches = PathBatches(data, model, dataclasses.replace(SHORT, per_scene=256), CPU)
        model.spread.copy_(batches.spread(model))
        torch.nn.init.zeros_(model.unet.outlet.bias)
        _, figures = batches.loss(model, torch.Generator().manual_seed(0))
        assert 0.8 < figures["velocity"] < 1.2

    def test_spread_gives_the_latent_unit_scale(self, data):
        model = tiny_model(data)
        batches = PathBatches(data, model, SHORT, CPU)
        model.spread.copy_(batches.spread(model))
        latent = model.to_latent(batches.waypoints)
        torch.testing.assert_close(latent.square().mean((0, 1)), torch.ones_like(model.spread))
        torch.testing.assert_close(batches.spread(model), model.spread)

    def test_is_fixed_by_the_generator(self, data):
        model = tiny_model(data)
        batches = PathBatches(data, model, SHORT, CPU)
        one, two, three = (
            batches.loss(model, torch.Generator().manual_seed(seed))[0] for seed in (0, 0, 1)
        )
        assert one == two != three

    def test_reaches_every_weight(self, data):
        model = tiny_model(data)
        torch.nn.init.normal_(model.unet.outlet.weight, std=0.1)
        config = dataclasses.replace(SHORT, scenes=16, dropout=0.5)
        PathBatches(data, model, config, CPU).loss(model, torch.Generator().manual_seed(0))[
            0
        ].backward()
        idle = [n for n, p in model.named_parameters() if p.grad is None or not p.grad.abs().sum()]
        assert idle == []

    def test_score_weight_zero_is_the_velocity_alone(self, data):
        model = tiny_model(data)
        alone = dataclasses.replace(SHORT, score_weight=0, wall_weight=0)
        loss, figures = PathBatches(data, model, alone, CPU).loss(
            model, torch.Generator().manual_seed(0)
        )
        assert figures.keys() == {"velocity", "label", "wall"}
        assert loss == figures["velocity"]

    def test_batch_in_which_all_conditions_are_dropped(self, data):
        model = tiny_model(data)
        batches = PathBatches(data, model, dataclasses.replace(SHORT, scenes=1, dropout=0.9), CPU)
        for seed in range(10):
            loss, _ = batches.loss(model, torch.Generator().manual_seed(seed))
            loss.backward()
            assert torch.isfinite(loss)
            assert all(torch.isfinite(p.grad).all() for p in model.parameters())

    def test_wall_is_what_is_outside(self, data):
        model = tiny_model(data)
        batches = PathBatches(data, model, SHORT, CPU)
        _, parts = batches.loss(model, torch.Generator().manual_seed(0))
        model.spread *= 4  # the same noise reaches four times as far
        _, wider = batches.loss(model, torch.Generator().manual_seed(0))
        assert 0 <= parts["wall"] < wider["wall"]
        config = dataclasses.replace(SHORT, wall_weight=0.0)
        free, parts = PathBatches(data, model, config, CPU).loss(
            model, torch.Generator().manual_seed(0)
        )
        total = parts["velocity"] + config.score_weight * parts["label"]
        torch.testing.assert_close(free.detach(), total)


class TestFrameScorer:
    @pytest.fixture(scope="class", params=[(2, "anchored"), (2, "rank"), (3, "anchored")], ids=str)
    @staticmethod
    def scored(request, tmp_path_factory):
        dim, label = request.param
        config = DatasetConfig(
            dim=dim, scenes=4, cells=20 if dim == 2 else 9, per_scene=33, label=label, seed=2
        )
        data = generate(config, tmp_path_factory.mktemp("scored"))
        frames = [Frame.of(scene, 0) for scene in data.scenes]
        conditions = tiny_model(data).conditions(data.scenes, [0] * len(frames))
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
        assert np.abs(found - data.labels.ravel()).mean() < 0.02
        assert np.abs(found - data.labels.ravel()).max() < 0.25

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
            assert (gradient.abs().sum((1, 2)) > 0).all()
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
        """Not only of what the archive holds."""
        data, scorer, conditions, each, _ = scored
        rng = np.random.default_rng(0)
        scene, frame = data.scenes[1], Frame.of(data.scenes[1], 0)
        straight = np.linspace(scene.start, scene.goals[0], 10)
        bend = np.sin(np.linspace(0, np.pi, 10))[:, None] * rng.normal(size=(20, 1, scene.dim))
        paths = straight + 0.3 * frame.scale * bend
        field = lg.InformationPotentialField(scene.goals, data.config.sigma)
        exact = lg.metrics.legibility_score(path_curve(paths, 200), field, 0, data.config.alpha)
        waypoints = torch.from_numpy(frame.world_to_frame(paths[:, 1:-1]).astype(np.float32))
        chosen = torch.full((20,), data.config.per_scene)  # any row of scene 1
        assert (each[chosen] == 1).all()
        found = scorer.score(conditions.map(lambda x: x[chosen]), scorer.curve(waypoints))
        np.testing.assert_allclose(found, exact, rtol=0.02, atol=0.01)


class TestValidation:
    def test_of_a_model_that_ignores_the_level(self, data):
        """No ranks to correlate, no answer better than chance; never a NaN."""
        model = tiny_model(data).eval()
        torch.nn.init.zeros_(model.unet.outlet.bias)
        figures = validate_dial(model, PathBatches(data, model, SHORT, CPU))
        assert all(np.isfinite(value) for value in figures.values())
        assert abs(figures["validation_spearman"]) < 0.4
        assert figures["validation_error"] > 0.3

    def test_of_a_model_that_always_draws_the_same(self, data, monkeypatch):
        model = tiny_model(data).eval()
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
        model = tiny_model(data).eval()
        batches = PathBatches(data, model, SHORT, CPU)

        def best(conditions, level, noise, **options):
            nearest = (batches.labels - level[:, None]).abs().argmin(1)
            return batches.waypoints[torch.arange(len(level)), nearest]

        monkeypatch.setattr(model, "sample", best)
        figures = validate_dial(model, batches)
        assert figures["validation_spearman_worst"] > 0.98
        assert figures["validation_error"] < 0.09
        assert figures["validation_at_1"] > 0.7
        assert figures["validation_at_-1"] < -0.7


def test_a_small_model_learns_the_dial_on_scenes_it_never_saw(tmp_path):
    config = DatasetConfig(scenes=32, cells=16, per_scene=33)
    data = generate(config, tmp_path / "train")
    validation = generate(
        dataclasses.replace(config, scenes=8, per_scene=9, stream="validation"),
        tmp_path / "validation",
    )
    how = PathTrainingConfig(
        steps=250, scenes=16, per_scene=8, warmup=30, learning_rate=3e-3, ema=0.98,
        score_weight=1.0, validate_every=250, checkpoint_every=250,
    )  # fmt: skip
    train_path(
        data, validation, tmp_path / "run", how,
        channels=(16, 32), condition=32, encoder_width=8, resolution=16,
    )  # fmt: skip
    found = rows(tmp_path / "run")
    assert found[-1]["velocity"] < 0.7 * found[0]["velocity"]
    assert found[-1]["validation_spearman"] > 0.75
    assert found[-1]["validation_error"] < 0.3
    assert found[-1]["validation_at_1"] > 0.4
    assert found[-1]["validation_at_-1"] < -0.4


class TestSidesThatAreThin:
    """Scenes whose whole legible side lies within a millionth of the range of their scores."""

    def test_label_is_exact_and_has_a_gradient(self, tmp_path):
        config = DatasetConfig(scenes=12, per_scene=33, cells=24, stream="validation")
        data = generate(config, tmp_path)
        knots = data.score_at_label
        share = (knots[:, -1] - knots[:, 32]) / (knots[:, -1] - knots[:, 0])
        thin = int(np.argmin(share))
        assert share[thin] < 1e-6
        frame = Frame.of(data.scenes[thin], 0)
        each = torch.full((config.per_scene,), thin)
        conditions = tiny_model(data).conditions(data.scenes, [0] * 12).map(lambda x: x[each])
        waypoints = torch.from_numpy(
            frame.world_to_frame(data.waypoints[thin]).astype(np.float32)
        ).requires_grad_()
        scorer = FrameScorer(data, tiny_model(data).conditions(data.scenes, [0] * 12))
        label = scorer.label(conditions, each, scorer.curve(waypoints))
        assert np.abs(label.detach().numpy() - data.labels[thin]).max() < 0.1
        (gradient,) = torch.autograd.grad(label.sum(), waypoints)
        assert torch.isfinite(gradient).all()
        assert (gradient[17:].abs().sum((1, 2)) > 1e-3).all()
