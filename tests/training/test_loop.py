"""A run that was killed ends as one that was not, and runs of other settings are refused."""

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
from trainings import LINE, assert_same_run, rows, stop_at, train_line

import legibility as lg
from legibility.errors import CheckpointError, TrainingError
from legibility.models.checkpoint import load_tensors, save_tensors
from legibility.training.loop import CHECKPOINT, LOG
from legibility.training.team import Team

PATHS = os.pathsep.join([str(Path(lg.__file__).parents[1]), str(Path(__file__).parents[1])])


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The folder and the result of a run without interruption."""
    folder = tmp_path_factory.mktemp("whole")
    return folder, train_line(folder)


@pytest.fixture
def finished(whole, tmp_path):
    """A copy of the folder of a finished run."""
    for name in (CHECKPOINT, LOG):
        (tmp_path / name).write_bytes((whole[0] / name).read_bytes())
    return tmp_path


class TestRun:
    def test_log(self, whole):
        log = rows(whole[0])
        assert [row["step"] for row in log] == [4, 5, 8, 10, 12]
        for row in log:
            assert {"loss", "half"} <= row.keys()
            assert ("validation_weight" in row) == (row["step"] in (5, 10, 12))
            assert all(np.isfinite(value) for value in row.values())

    def test_model_is_the_moving_average(self, whole):
        tensors = load_tensors(whole[0] / CHECKPOINT)[0]
        for name, tensor in whole[1].model.state_dict().items():
            assert torch.equal(tensor, tensors[f"average.{name}"])
            assert not torch.equal(tensor, tensors[f"model.{name}"])

    def test_record_and_metrics(self, whole):
        record, metrics = whole[1].record, whole[1].metrics
        assert (record.data, record.digest) == ({"seed": 1}, "a")
        assert record.training == dataclasses.asdict(LINE)
        assert (record.parameters, record.processes, record.threads) == (4, 1, 1)
        assert (record.device, record.precision) == ("cpu", "no")
        assert 0 < record.step_seconds <= record.seconds
        last = json.loads((whole[0] / LOG).read_text().splitlines()[-1])
        assert metrics == last

    def test_progress(self, tmp_path):
        seen = []
        train_line(
            tmp_path, dataclasses.replace(LINE, steps=5),
            progress=lambda step, steps, metrics: seen.append((step, steps, bool(metrics))),
        )  # fmt: skip
        assert seen == [(i, 5, i >= 4) for i in range(1, 6)]

    def test_loss_falls(self, tmp_path):
        """The step is a law of AdamW here: a convex loss, a small rate, many steps."""
        config = dataclasses.replace(LINE, steps=300, learning_rate=0.05, ema=0.9)
        train_line(tmp_path, config)
        log = rows(tmp_path)
        assert log[-1]["loss"] < 0.1 * log[0]["loss"]

    def test_seed_fixes_the_weights(self, whole, tmp_path):
        train_line(tmp_path / "same")
        assert_same_run(whole[0], tmp_path / "same")
        other = train_line(tmp_path / "other", dataclasses.replace(LINE, seed=1))
        assert not torch.equal(other.model.layer.weight, whole[1].model.layer.weight)

    def test_random_numbers_of_others_do_not_matter(self, whole, tmp_path):
        def disturb(step, *_):
            torch.manual_seed(step)
            np.random.seed(step)  # noqa: NPY002

        train_line(tmp_path, progress=disturb)
        assert_same_run(whole[0], tmp_path)

    def test_loss_that_is_not_finite(self, tmp_path):
        def loss(model, generator):
            return model.layer.weight.sum() * torch.inf, {}

        with pytest.raises(TrainingError, match="nan at step 4; try a lower learning_rate"):
            train_line(tmp_path, loss=loss)


class TestResume:
    @pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="no SIGKILL on this system")
    def test_after_a_kill(self, whole, tmp_path):
        """After a checkpoint at step 4 and a row of the log at step 5."""
        script = """
import os, signal, sys
from pathlib import Path
from trainings import train_line
def kill(step, *_):
    if step == 6:
        os.kill(os.getpid(), signal.SIGKILL)
train_line(Path(sys.argv[1]), progress=kill)
"""
        run = subprocess.run(
            [sys.executable, "-c", script, str(tmp_path)],
            env={**os.environ, "PYTHONPATH": PATHS}, capture_output=True, text=True,
        )  # fmt: skip
        assert run.returncode == -signal.SIGKILL, run.stderr
        assert load_tensors(tmp_path / CHECKPOINT)[1]["step"] == 4
        assert [row["step"] for row in rows(tmp_path)] == [4, 5]
        seen = []
        train_line(tmp_path, progress=lambda step, *_: seen.append(step))
        assert seen == list(range(5, 13))
        assert_same_run(whole[0], tmp_path)

    @pytest.mark.parametrize("step", range(1, 13))
    def test_after_an_exception(self, whole, tmp_path, step):
        with pytest.raises(KeyboardInterrupt):
            train_line(tmp_path, progress=stop_at(step))
        train_line(tmp_path)
        assert_same_run(whole[0], tmp_path)

    def test_after_two_interruptions(self, whole, tmp_path):
        for step in (6, 7):
            with pytest.raises(KeyboardInterrupt):
                train_line(tmp_path, progress=stop_at(step))
        train_line(tmp_path)
        assert_same_run(whole[0], tmp_path)

    @pytest.mark.parametrize("validate_every", [1, 2, 3, 7, 100])
    @pytest.mark.parametrize("checkpoint_every", [1, 3, 5, 100])
    def test_with_any_intervals(self, tmp_path, validate_every, checkpoint_every):
        config = dataclasses.replace(
            LINE, validate_every=validate_every, checkpoint_every=checkpoint_every
        )
        train_line(tmp_path / "whole", config)
        with pytest.raises(KeyboardInterrupt):
            train_line(tmp_path / "parts", config, progress=stop_at(8))
        train_line(tmp_path / "parts", config)
        assert_same_run(tmp_path / "whole", tmp_path / "parts")

    def test_with_other_intervals_than_before(self, whole, tmp_path):
        with pytest.raises(KeyboardInterrupt):
            train_line(tmp_path, progress=stop_at(9))
        other = dataclasses.replace(LINE, validate_every=3, checkpoint_every=2)
        model = train_line(tmp_path, other).model
        assert torch.equal(model.layer.weight, whole[1].model.layer.weight)
        assert [row["step"] for row in rows(tmp_path)] == [4, 5, 8, 9, 10, 12]

    @pytest.mark.parametrize(
        "spoil",
        [
            lambda log: log.unlink(),
            lambda log: log.write_text(""),
            lambda log: log.write_text(log.read_text()[:-20]),
            lambda log: log.write_text(log.read_text() + '{"step": 9, "loss": 1}\n{"step": 10, "l'),
            lambda log: log.write_text("another file"),
            lambda log: log.write_bytes(b"\xff\x00"),
        ],
    )
    @pytest.mark.parametrize("step", [9, 13])
    def test_whatever_became_of_the_log(self, whole, tmp_path, step, spoil):
        """The checkpoint holds the rows, also those of a finished run."""
        if step == 9:
            with pytest.raises(KeyboardInterrupt):
                train_line(tmp_path, progress=stop_at(step))
        else:
            train_line(tmp_path)
        spoil(tmp_path / LOG)
        again = train_line(tmp_path)
        assert_same_run(whole[0], tmp_path)
        assert again.record.step_seconds > 0

    def test_of_a_finished_run_is_the_same_model(self, whole, finished):
        again = train_line(finished)
        assert torch.equal(again.model.layer.weight, whole[1].model.layer.weight)
        assert (again.record, again.metrics) == (whole[1].record, whole[1].metrics)
        for name in (CHECKPOINT, LOG):
            assert (finished / name).read_bytes() == (whole[0] / name).read_bytes()


class TestRefuses:
    @pytest.mark.parametrize(
        ("change", "message"),
        [
            ({"seed": 1}, "training.seed is 0 in the checkpoint and 1 now"),
            ({"steps": 13}, "training.steps is 12 in the checkpoint and 13 now"),
            (
                {"learning_rate": 5e-4},
                "training.learning_rate is 0.001 in the checkpoint and 0.0005 now",
            ),
            (
                {"learning_rate": 5e-4, "ema": 0.9, "seed": 1, "steps": 99},
                "training.steps is 12 in the checkpoint and 99 now; "
                "training.learning_rate is 0.001 in the checkpoint and 0.0005 now; "
                "training.ema is 0.999 in the checkpoint and 0.9 now",
            ),
        ],
    )
    def test_other_settings_of_the_training(self, finished, change, message):
        with pytest.raises(CheckpointError) as refused:
            train_line(finished, dataclasses.replace(LINE, **change))
        assert str(refused.value) == f"{finished / CHECKPOINT} is of another run: {message}"

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            ({"slope": 3.0}, r"model\.slope is 2\.0 in the checkpoint and 3\.0 now"),
            ({"digest": "b"}, r"data\.sha256 is 'a' in the checkpoint and 'b' now"),
            (
                {"team": Team(torch.device("cpu"), precision="bf16")},
                "precision is 'no' in the checkpoint and 'bf16' now",
            ),
        ],
    )
    def test_another_model_other_data_another_precision(self, finished, change, message):
        with pytest.raises(CheckpointError, match=message):
            train_line(finished, **change)

    def test_another_format(self, finished):
        tensors, header = load_tensors(finished / CHECKPOINT)
        header["settings"]["format"] = 99
        save_tensors(finished / CHECKPOINT, tensors, header)
        with pytest.raises(CheckpointError, match="format is 99 in the checkpoint and 1 now"):
            train_line(finished)

    def test_half_a_checkpoint(self, finished):
        content = (finished / CHECKPOINT).read_bytes()
        (finished / CHECKPOINT).write_bytes(content[: len(content) // 2])
        with pytest.raises(CheckpointError, match="corrupted"):
            train_line(finished)

    @pytest.mark.parametrize(
        "lost", ["model.layer.weight", "average.layer.weight", "optimizer.0.exp_avg", "optimizer."]
    )
    def test_a_checkpoint_without_a_tensor(self, finished, lost):
        tensors, header = load_tensors(finished / CHECKPOINT)
        kept = {name: x for name, x in tensors.items() if not name.startswith(lost)}
        assert len(kept) < len(tensors)
        save_tensors(finished / CHECKPOINT, kept, {**header, "step": 8})
        with pytest.raises(CheckpointError):
            train_line(finished)

    @pytest.mark.parametrize("name", ["model.layer.weight", "optimizer.0.exp_avg"])
    @pytest.mark.parametrize("value", [torch.full((1, 3), torch.nan), torch.ones(1, 1, 7)])
    def test_a_checkpoint_with_a_broken_tensor(self, finished, name, value):
        tensors, header = load_tensors(finished / CHECKPOINT)
        save_tensors(finished / CHECKPOINT, {**tensors, name: value}, {**header, "step": 8})
        with pytest.raises(CheckpointError):
            train_line(finished)

    @pytest.mark.parametrize(
        "header",
        [None, {}, [], {"step": 4}, {"settings": []}, {"settings": [], "step": 4},
         {"settings": {}, "step": "x", "seconds": 1, "log": []},
         {"settings": None, "step": 4, "seconds": 1, "log": []},
         {"settings": {}, "step": 4, "seconds": 1, "log": [3]}],
    )  # fmt: skip
    def test_something_else(self, finished, header):
        save_tensors(finished / CHECKPOINT, {"a": torch.ones(1)}, header)
        with pytest.raises(CheckpointError, match="is not a training checkpoint"):
            train_line(finished)
