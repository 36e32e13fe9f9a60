import hashlib
import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import legibility as lg
from legibility.cli.output import model_record
from legibility.cli.train import _line
from legibility.data.dataset import Dataset


def test_report_and_weights(run, dataset):
    content = json.loads(run.with_suffix(".json").read_text())
    weights = run / "weights"
    assert content["command"].startswith("legibility train path --steps 20 ")
    assert content["config"]["training"]["steps"] == 20
    assert content["config"]["path"]["channels"] == [8, 16]
    assert content["config"]["path"]["observer"] == lg.Observer().to_dict()
    assert content["model"] == model_record(str(weights))
    digest = hashlib.sha256((weights / "path.safetensors").read_bytes()).hexdigest()
    assert content["model"]["path"] == digest
    assert content["result"]["data"] == Dataset.load(dataset).digest
    assert content["result"]["last"]["step"] == 20
    assert "validation_error" in content["result"]["last"]
    assert content["result"]["precision"] == "no"
    assert content["result"]["step_seconds"] > 0
    model = lg.Modulator.from_pretrained(weights)
    assert (
        sum(p.numel() for p in model.path_diffuser.parameters()) == content["result"]["parameters"]
    )


def test_ended_run_is_repeated_at_once(run, dataset, cli, tiny, capsys):
    before = (run / "weights" / "path.safetensors").read_bytes()
    paths = ["--data", dataset, "--validation", dataset, "--out", run]
    assert cli(f"train path --steps 20 {tiny}", *paths) == 0
    assert (run / "weights" / "path.safetensors").read_bytes() == before
    assert "weights: " in capsys.readouterr().out


def test_other_settings_in_the_same_folder(run, dataset, tiny, refused):
    paths = ["--data", dataset, "--validation", dataset, "--out", run]
    message = "training.steps is 20 in the checkpoint and 30 now"
    assert message in refused(f"train path --steps 30 {tiny}", *paths)


def test_validation_is_made_if_none_is_given(
    dataset, here, cli, tiny, one_thread, monkeypatch, capsys
):
    monkeypatch.setattr("legibility.data.configuration.VALIDATION_SCENES", 2)
    assert cli(f"train path --steps 1 {tiny} --out run --data", dataset) == 0
    made, data = Dataset.load("run/validation").config, Dataset.load(dataset).config
    assert (made.stream, made.scenes) == ("validation", 2)
    assert made.views == 1
    for name in ("regime", "goals", "observer", "cells", "candidates"):
        assert getattr(made, name) == getattr(data, name)
    assert "spearman" in capsys.readouterr().err
    assert Path("run/log.jsonl").exists()


def test_validation_data_are_not_validated_on_themselves(cli, refused, capsys):
    words = "data --scenes 1 --goals 2 --per-scene 3 --cells 6 --candidates 4096 --regime dragan"
    assert cli(f"{words} --stream validation --out v") == 0
    capsys.readouterr()
    assert "give --validation" in refused("train path --data v --out run")


def test_precision(dataset, cli, tiny, tmp_path, refused, capsys):
    words = f"train path --steps 2 {tiny} --precision"
    paths = ["--data", dataset, "--validation", dataset, "--out", tmp_path / "run"]
    assert cli(f"{words} bf16", *paths) == 0
    capsys.readouterr()
    record = lg.Modulator.from_pretrained(tmp_path / "run/weights").training["path"]
    assert record.precision == "bf16"
    message = "precision is 'bf16' in the checkpoint and 'no' now"
    assert message in refused(f"{words} no", *paths)
    assert "precision must be one of no, bf16, fp16, got 'f8'" in refused(f"{words} f8", *paths)


def test_line_of_a_validation():
    assert _line(50, {"loss": 1.0}) == ""
    assert _line(50, {"loss": 1.0, "validation_error": 0.5}) == "step 50  loss 1.0000  error 0.5000"


def test_policy_beside_the_path(run, dataset, shown, cli, tmp_path, capsys):
    assert cli("data --info", shown) == 0
    assert "8, " in capsys.readouterr().out
    weights = shutil.copytree(run / "weights", tmp_path / "weights")
    words = (
        "train policy --steps 6 --batch 16 --warmup 1 --validate-every 6 --checkpoint-every 6"
        " --channels 8 16 --condition 16"
    )
    report = tmp_path / "policy.json"
    paths = ["--data", shown, "--validation", dataset, "--out", tmp_path / "policy"]
    assert cli(words, *paths, "--weights", weights, "--json", report) == 0
    content = json.loads(report.read_text())
    assert set(content["model"]) == {"name", "path", "policy", "settings"}
    assert content["config"]["policy"]["channels"] == [8, 16]
    assert "validation_success" in content["result"]["last"]
    model = lg.Modulator.from_pretrained(weights)
    assert model.path_policy is not None
    assert model.training["policy"].demonstrations["number"] == 8


def test_student_beside_its_teachers_policy(run, dataset, cli, tmp_path, refused, capsys):
    report, out = tmp_path / "student.json", tmp_path / "student"
    words = (
        "train distill --steps 4 --scenes 2 --per-scene 4 --pairs 4 --warmup 1 --sampling-steps 2"
        " --teacher"
    )
    paths = ["--data", dataset, "--validation", dataset, "--out", out]
    assert cli(words, run / "weights", *paths, "--json", report) == 0
    content = json.loads(report.read_text())
    assert set(content["model"]) == {"name", "path", "settings"}
    assert content["config"]["path"]["guidance"] == 0
    assert content["config"]["path"]["sampling_steps"] == 2
    student = lg.Modulator.from_pretrained(out / "weights")
    made_by = student.training["path"].teacher
    teacher = (run / "weights" / "path.safetensors").read_bytes()
    assert made_by.sha256 == hashlib.sha256(teacher).hexdigest()
    assert made_by.training.training["steps"] == 20
    capsys.readouterr()

    whole = lg.Modulator.from_pretrained("block-reach-2d")
    whole.save_pretrained(tmp_path / "whole")
    assert cli(words, tmp_path / "whole", *paths[:-1], tmp_path / "fast") == 0
    found = lg.Modulator.from_pretrained(tmp_path / "fast" / "weights")
    for name, tensor in found.path_policy.state_dict().items():
        assert (tensor == whole.path_policy.state_dict()[name]).all(), name
    assert found.training["policy"] == whole.training["policy"]
    capsys.readouterr()
    own = ["--weights", tmp_path / "whole"]
    assert "must not be the teacher's own folder" in refused(
        words, tmp_path / "whole", *paths, *own
    )
    assert "has no stage 1" in refused(words, "diffusion-policy-2d", *paths)


def test_weights_beside_the_checkpoint(run, dataset, tiny, refused):
    paths = ["--data", dataset, "--validation", dataset, "--out", run, "--weights", run]
    message = f"weights must be another folder than out, got {run}"
    assert message in refused(f"train path --steps 20 {tiny}", *paths)


def test_finished_run_without_its_log_gives_its_weights(run, dataset, cli, tiny, tmp_path, capsys):
    out = shutil.copytree(run, tmp_path / "run")
    (out / "log.jsonl").unlink()
    shutil.rmtree(out / "weights")
    paths = ["--data", dataset, "--validation", dataset, "--out", out]
    assert cli(f"train path --steps 20 {tiny}", *paths) == 0
    for name in ("weights/path.safetensors", "weights/config.json", "log.jsonl"):
        assert (out / name).read_bytes() == (run / name).read_bytes()


HEAVY = {"torch", "scipy", "pyarrow", "joblib", "diffusers", "matplotlib"}


@pytest.mark.parametrize(
    "verb", ["data", "train all", "train path", "train distill", "train policy"]
)
def test_help_loads_nothing_heavy(verb):
    script = "import sys; from legibility.cli import main; main(sys.argv[1:]); print(*sys.modules)"
    words = [*verb.split(), "--help"]
    shown = subprocess.run([sys.executable, "-c", script, *words], capture_output=True, text=True)
    assert shown.stderr == ""
    help_text, _, modules = shown.stdout.rstrip().rpartition("\n")
    assert "--data DIR" in help_text or "--scenes INT" in help_text
    assert not HEAVY & set(modules.split())


def test_policy_needs_demonstrations(dataset, tmp_path, refused):
    assert "demonstrations.json" in refused(
        "train policy --steps 2", "--data", dataset, "--out", tmp_path / "out"
    )


def test_stage_2_of_others(run, dataset, tiny, refused, cli, tmp_path, capsys):
    """Stage 2 of other weights is saved beside a new stage 1, if it moves in as many dimensions."""
    paths = ["--data", dataset, "--validation", dataset, "--out", tmp_path / "o"]
    assert cli(f"train path --steps 1 {tiny} --policy block-reach-2d", *paths) == 0
    saved = lg.Modulator.from_pretrained(tmp_path / "o" / "weights")
    shipped = lg.Modulator.from_pretrained("block-reach-2d")
    ours, theirs = saved.path_policy.state_dict(), shipped.path_policy.state_dict()
    assert all((ours[name] == theirs[name]).all() for name in theirs)
    capsys.readouterr()
    paths[-1] = tmp_path / "p"
    words = f"train path --steps 1 {tiny} --policy"
    assert "policy must move in 2D, got 3D" in refused(f"{words} panda-block-reach", *paths)
    assert "has no stage 2" in refused(f"{words} diffusion-policy-2d", *paths)


SMALL = Path(__file__).parents[2] / "examples" / "small-model.yaml"


def test_all_stages_of_a_model(here, cli, one_thread, monkeypatch, capsys):
    flags = "--seed 3 --scenes 2 --demonstrated 2 --steps 6 --policy-steps 5 --json j.json --out"
    line = f"train all --settings {SMALL} {flags}"

    def stop(*_, **__):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("legibility.training.policy.train_policy", stop)
        assert cli(line, "run") == 130
    assert "interrupted; the same command resumes" in capsys.readouterr().err
    taught = Path("run/teacher/path.safetensors")
    before = taught.stat().st_mtime_ns, taught.read_bytes()
    log = Path("run/path/log.jsonl").read_bytes()
    assert cli(line, "run") == 0
    assert taught.read_bytes() == before[1]
    assert Path("run/path/log.jsonl").read_bytes() == log, "stage 1 is not trained again"
    notes = capsys.readouterr().err
    assert [f"{number} of 5: " in notes for number in range(1, 6)] == [True] * 5

    model = lg.Modulator.from_pretrained("run/weights")
    assert model.config.distilled
    assert model.stage_2().config.channels == (8, 16)
    path, policy = model.training["path"], model.training["policy"]
    assert path.teacher.training.training["steps"] == 6
    assert path.teacher.training.digest == path.digest == Dataset.load("run/data").digest
    assert (policy.training["steps"], policy.demonstrations["number"]) == (5, 4)
    assert Dataset.load("run/data").config.scenes == 2
    content = json.loads(Path("j.json").read_text())
    assert content["seed"] == 3
    seeds = [content["config"][part]["seed"] for part in content["config"]]
    assert seeds == [3] * 5
    assert set(content["model"]) == {"name", "path", "policy", "settings"}
    assert content["result"]["last"]["policy"]["step"] == 5


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("--scenes 0", "scenes must be an integer of at least 1, got 0"),
        ("--dim 4", "dim must be one of 2, 3, got 4"),
        ("--settings none.yaml", "cannot read the settings file none.yaml"),
        ("--settings speed.yaml", "the section path has "),
        ("--settings scene.yaml", "settings must be sections of settings"),
        ("--weights scene.yaml", "cannot write the weights to scene.yaml"),
    ],
)
def test_all_refuses(words, message, here, refused):
    Path("speed.yaml").write_text("path: {speed: 1}\n")
    assert message in refused(f"train all {words} --out run")


def test_all_is_one_process(refused, monkeypatch):
    monkeypatch.setenv("LOCAL_RANK", "0")
    assert "train all is one process" in refused("train all --out run")
