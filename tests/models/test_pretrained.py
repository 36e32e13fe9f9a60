"""Weights come back from a folder as they were, in float16, or there is one clear error."""

import dataclasses
import json

import pytest
import torch

from legibility.errors import CheckpointError, OutputError, TrainingError
from legibility.models.checkpoint import load_tensors, save_tensors
from legibility.models.configuration import GoalPolicyConfig, PathDiffuserConfig, PathPolicyConfig
from legibility.models.goal_policy import GoalPolicy
from legibility.models.path_diffuser import PathDiffuser
from legibility.models.path_policy import PathPolicy
from legibility.models.pretrained import (
    load_stages,
    pretrained_folder,
    pretrained_names,
    save_stage,
    training_records,
)
from legibility.models.provenance import TrainingRecord

RECORD = TrainingRecord(
    data={"dim": 2}, digest="00ff", training={"steps": 3}, parameters=12, seconds=1.5,
    step_seconds=0.5, device="cpu", processes=1, precision="no", threads=2, torch="2.6",
)  # fmt: skip
TINY = {"channels": (8, 16), "condition": 16}
IMAGE = {"encoder_width": 8, "resolution": 16}


def network(stage, **changes):
    """A tiny untrained network, every parameter of it drawn."""
    torch.manual_seed(0)
    model = {
        "path": lambda: PathDiffuser(PathDiffuserConfig(**TINY | IMAGE | changes)),
        "policy": lambda: PathPolicy(PathPolicyConfig(**TINY | changes)),
        "goal": lambda: GoalPolicy(GoalPolicyConfig(**TINY | changes)),
    }[stage]()
    for parameter in model.parameters():
        torch.nn.init.normal_(parameter)
    return model


@pytest.fixture
def folder(tmp_path):
    """A model of stages 1 and 2."""
    for stage in ("path", "policy"):
        save_stage(tmp_path / "model", stage, network(stage), RECORD)
    return tmp_path / "model"


def change_config(folder, stage, change):
    content = json.loads((folder / "config.json").read_text())
    content[stage]["config"] |= change
    (folder / "config.json").write_text(json.dumps(content))


class TestRoundTrip:
    @pytest.mark.parametrize("stage", ["path", "policy", "goal"])
    def test_parameters_are_halved_and_everything_else_is_exact(self, stage, tmp_path):
        model = network(stage)
        save_stage(tmp_path, stage, model, RECORD)
        stages, records = load_stages(tmp_path)
        assert records == {stage: RECORD}
        assert stages[stage].config == model.config
        stored = load_tensors(tmp_path / f"{stage}.safetensors")[0]
        parameters, state = dict(model.named_parameters()), model.state_dict()
        assert stored.keys() == state.keys()
        for name, tensor in stages[stage].state_dict().items():
            assert tensor.dtype == state[name].dtype
            if name in parameters:
                assert stored[name].dtype == torch.float16
                assert torch.equal(tensor, state[name].half().float())
            else:
                assert torch.equal(tensor, state[name])

    def test_saved_again_it_is_the_same_file(self, folder, tmp_path):
        for stage, model in load_stages(folder)[0].items():
            save_stage(tmp_path / "again", stage, model, RECORD)
        for file in folder.iterdir():
            assert (tmp_path / "again" / file.name).read_bytes() == file.read_bytes()

    def test_only_these_files(self, folder):
        names = ["config.json", "path.safetensors", "policy.safetensors"]
        assert sorted(p.name for p in folder.iterdir()) == names

    def test_training_may_be_unknown(self, folder):
        save_stage(folder, "path", network("path"), None)
        assert training_records(folder) == {"path": None, "policy": RECORD}

    def test_a_stage_is_replaced_alone(self, folder):
        before = (folder / "path.safetensors").read_bytes()
        other = dataclasses.replace(RECORD, seconds=3.0)
        save_stage(folder, "policy", network("policy", condition=24), other)
        stages, records = load_stages(folder)
        assert stages["policy"].config.condition == 24
        assert records == {"path": RECORD, "policy": other}
        assert (folder / "path.safetensors").read_bytes() == before

    @pytest.mark.parametrize("value", [1e5, float("nan")])
    def test_what_float16_cannot_hold_is_not_written(self, tmp_path, value):
        model = network("path")
        with torch.no_grad():
            model.place.bias[0] = value
        with pytest.raises(TrainingError, match=r"place\.bias of stage path is not finite"):
            save_stage(tmp_path / "model", "path", model, RECORD)
        assert not (tmp_path / "model").exists()

    def test_a_folder_that_cannot_be_written(self, tmp_path):
        (tmp_path / "file").write_text("in the way")
        with pytest.raises(OutputError, match="cannot write"):
            save_stage(tmp_path / "file" / "model", "path", network("path"), None)


class TestRefuses:
    @pytest.mark.parametrize("file", ["config.json", "path.safetensors", "policy.safetensors"])
    def test_missing_file(self, folder, file):
        (folder / file).unlink()
        with pytest.raises(CheckpointError, match=file):
            load_stages(folder)

    @pytest.mark.parametrize("share", [0, 0.3, 0.9])
    @pytest.mark.parametrize("file", ["config.json", "path.safetensors", "policy.safetensors"])
    def test_truncated_file(self, folder, file, share):
        content = (folder / file).read_bytes()
        (folder / file).write_bytes(content[: int(share * len(content))])
        with pytest.raises(CheckpointError):
            load_stages(folder)

    def test_weights_of_another_shape(self, folder, tmp_path):
        save_stage(tmp_path / "other", "path", network("path", condition=24), None)
        (tmp_path / "other" / "path.safetensors").replace(folder / "path.safetensors")
        with pytest.raises(CheckpointError, match="shape"):
            load_stages(folder)

    def test_weights_that_were_changed(self, folder):
        tensors, _ = load_tensors(folder / "path.safetensors")
        tensors["place.bias"][0] += 1
        save_tensors(folder / "path.safetensors", tensors)
        with pytest.raises(CheckpointError, match=r"is not the file that .*config\.json names"):
            load_stages(folder)

    def test_weights_that_are_not_finite(self, folder):
        tensors, _ = load_tensors(folder / "path.safetensors")
        tensors["place.bias"][0] = torch.inf
        save_tensors(folder / "path.safetensors", tensors)
        with pytest.raises(CheckpointError, match=r"place\.bias is not finite"):
            load_stages(folder)

    @pytest.mark.parametrize(
        "text",
        ["[]", "null", "3", '"text"', "{}", '{"format": 2}', '{"format": 3, "p": 1}', "\xff"],
    )
    def test_other_configuration(self, folder, text):
        (folder / "config.json").write_text(text, encoding="latin-1")
        for read in (load_stages, training_records):
            with pytest.raises(CheckpointError):
                read(folder)

    @pytest.mark.parametrize("what", ["format", "settings"])
    def test_of_another_version(self, folder, what):
        """It says what to do."""
        if what == "settings":
            change_config(folder, "path", {"wall": 1.0})
        else:
            content = json.loads((folder / "config.json").read_text())
            (folder / "config.json").write_text(json.dumps({**content, "format": 2}))
        with pytest.raises(CheckpointError, match=r"another version of legibility.*train new ones"):
            load_stages(folder)

    @pytest.mark.parametrize("training", [3, "none", {}, {"speed": 1}, ["a"]], ids=str)
    def test_other_training_record(self, folder, training):
        content = json.loads((folder / "config.json").read_text())
        content["path"]["training"] = training
        (folder / "config.json").write_text(json.dumps(content))
        with pytest.raises(CheckpointError, match="another training record"):
            training_records(folder)

    @pytest.mark.parametrize(
        "change",
        [
            {"dim": 4},
            {"dim": "2"},
            {"observer": None},
            {"observer": {"eyes": 2}},
            {"observer": {"sigma": 0}},
            {"observer": {"sigma": -0.1}},
            {"observer": {"sigma": float("nan")}},
            {"observer": {"alpha": -1}},
            {"observer": {"alpha": float("inf")}},
            {"observer": {"label": "linear"}},
            {"observer": {"label": None}},
            {"channels": []},
            {"channels": None},
            {"channels": [7, 16]},
            {"channels": [8, 8, 8, 8, 8, 8]},
            {"condition": 0},
            {"condition": -1},
            {"encoder_width": 0},
            {"resolution": 12},
            {"squash": 0},
            {"squash": float("nan")},
            {"diffusion_steps": 0},
            {"diffusion_steps": 1e3},
            {"sampling_steps": 0},
            {"sampling_steps": 101},
            {"sampling_steps": 2.5},
            {"guidance": float("nan")},
            {"guidance": "strong"},
            {"distilled": None},
            {"speed": 1},
        ],
        ids=str,
    )
    def test_settings_that_no_model_has(self, folder, change):
        """Refused when it is loaded, not when it plans."""
        change_config(folder, "path", change)
        with pytest.raises(CheckpointError):
            load_stages(folder)


class TestShipped:
    def test_names(self):
        assert pretrained_names() == ["block-reach-2d", "panda-block-reach"]
        assert set(pretrained_names("policy")) == set(pretrained_names())
        baselines = {f"{name}-{robot}" for name in ("diffusion-policy", "legibility-diffuser")
                     for robot in ("2d", "panda")}  # fmt: skip
        assert set(pretrained_names("goal")) == baselines

    @pytest.mark.parametrize("name", [*pretrained_names(), *pretrained_names("goal")])
    def test_are_whole_stored_in_float16_and_say_how_they_were_made(self, name):
        folder = pretrained_folder(name)
        stages, records = load_stages(folder)
        for stage, model in stages.items():
            stored = load_tensors(folder / f"{stage}.safetensors")[0]
            names = [name for name, _ in model.named_parameters()]
            assert {stored[name].dtype for name in names} == {torch.float16}
            record = records[stage]
            assert record is not None
            assert record.parameters == sum(p.numel() for p in model.parameters())
            assert record.data["dim"] == model.config.dim
            if stage == "path":
                assert model.config.distilled == (record.teacher is not None)
                assert model.config.observer.to_dict() == record.data["observer"]

    @pytest.mark.parametrize("name", ["no-such-model", "", "..", "../weights", "a\0b"])
    def test_no_such_weights(self, tmp_path, monkeypatch, name):
        monkeypatch.chdir(tmp_path)
        with pytest.raises(CheckpointError):
            load_stages(pretrained_folder(name))

    def test_a_folder_is_itself(self, folder, monkeypatch):
        monkeypatch.chdir(folder.parent)
        assert pretrained_folder(folder) == folder
        assert pretrained_folder("model").resolve() == folder
