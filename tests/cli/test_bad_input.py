"""Every bad input of the first issue: status 2, one line, no half-written file."""

import json
import os
import shutil
from pathlib import Path

import pytest

SCENES = {
    "NaN": ("start: [0, .nan]\ngoals: [[0.8, 0.6], [1, 0.3]]\n", "finite"),
    "infinite": ("start: [0, 0.5]\ngoals: [[0.8, .inf], [1, 0.3]]\n", "finite"),
    "one goal": ("start: [0, 0.5]\ngoals: [[0.8, 0.6]]\n", "at least 2"),
    "goals coincide": ("start: [0, 0.5]\ngoals: [[0.8, 0.6], [0.8, 0.6]]\n", "coincide"),
    "start on a goal": ("start: [0.8, 0.6]\ngoals: [[0.8, 0.6], [1, 0.3]]\n", "coincide"),
    "outside": ("start: [0, 5]\ngoals: [[0.8, 0.6], [1, 0.3]]\n", "outside the workspace"),
    "text": ("start: [0, a]\ngoals: [[0.8, 0.6], [1, 0.3]]\n", "numbers"),
    "empty": ("", "a scene must be a mapping"),
    "malformed": ("start: [0, 0.5\n", "not valid YAML"),
    "no goals": ("start: [0, 0.5]\n", "missing"),
    "exponent": ("start: [0, 5e-1]\ngoals: [[0.8, 0.6], [1, 0.3]]\n", "write 0.5"),
    "yes": ("start: [yes, 0.5]\ngoals: [[0.8, 0.6], [1, 0.3]]\n", "numbers"),
    "twice": ("start: [0, 0.5]\ngoals: [[0.8, 0.6], [1, 0.3]]\nstart: [0, 0]\n", "repeated"),
    "obstacle over the start": (
        "start: [0, 0.5]\ngoals: [[0.8, 0.6], [1, 0.3]]\n"
        "obstacles: [{ball: {center: [0, 0.5], radius: 0.1}}]\n",
        "obstacles[0] lies over the start",
    ),
    "no obstacle": (
        "start: [0, 0.5]\ngoals: [[0.8, 0.6], [1, 0.3]]\nobstacles: [{cone: 1}]\n",
        "an obstacle must be a mapping with one key, ball, box or polygon",
    ),
    "no observer": (
        "start: [0, 0.5]\ngoals: [[0.8, 0.6], [1, 0.3]]\nobserver: {detour: 0.5}\n",
        "detour must",
    ),
    "4D": ("start: [0, 0, 0, 0]\ngoals: [[1, 0, 0, 0], [0, 1, 0, 0]]\n", "2 or 3 numbers"),
}


@pytest.mark.parametrize(("text", "message"), SCENES.values(), ids=SCENES.keys())
def test_scene(text, message, here, refused):
    Path("bad.yaml").write_text(text)
    Path("t.csv").write_text("x,y\n0,0.5\n0.8,0.6\n")
    assert message in refused("plan bad.yaml --json j.json")
    assert message in refused("score t.csv bad.yaml --json j.json")


@pytest.mark.parametrize("name", ["nothing.yaml", "scene.txt", "."])
def test_scene_file(name, refused):
    refused("plan --json j.json", name)


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        ("--target 2", "target must be a goal's index from 0 to 1, got 2"),
        ("--target -1", "target must be"),
        ("--legibility 1.5", "legibility must lie in [-1, 1], got 1.5"),
        ("--legibility 0 nan", "finite"),
        ("--legibility high", "legibility must be numbers or LOW:HIGH:COUNT, got 'high'"),
        ("--legibility", "at least one"),
        ("--candidates 0", "at least 1"),
        ("--guidance nan", "guidance must be finite"),
        ("--steps 0", "at least 1"),
        ("--steps 100000", "at most"),
        ("--points 1", "points must be"),
        ("--seed -1", "seed must be"),
        ("--seed 99999999999999999999999", "seed must be"),
    ],
)
def test_plan(flags, message, weights, refused):
    line = f"plan scene.yaml {flags} --json j.json --csv c.csv --figure f.png --model"
    assert message in refused(line, weights)


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        ("--target 2", "target must be a goal's index from 0 to 1, got 2"),
        ("--legibility 1.5", "legibility must lie in [-1, 1], got 1.5"),
        ("--legibility", "at least one"),
        ("--legibility -1:1:26", "shows 1 to 25 motions, got 26"),
        ("--seed -1", "seed must be"),
        ("--noise -1", "noise must"),
        ("--noise nan", "noise must"),
        ("--push -0.1", "push must"),
        ("--shift inf", "shift must"),
    ],
)
def test_execute(flags, message, refused):
    line = f"execute scene.yaml {flags} --json j.json --csv c.csv --figure f.png --video f.gif"
    assert message in refused(line)


@pytest.mark.parametrize("name", ["f.avi", "f", "f.png", "scene.yaml/f.gif", "."])
def test_film(name, refused):
    assert "cannot write" in refused("execute scene.yaml --model none --video", name)


def test_film_without_ffmpeg(here, refused, monkeypatch):
    monkeypatch.setenv("PATH", str(here))
    message = refused("execute scene.yaml --model none --json j.json --video f.mp4")
    assert "cannot write the film f.mp4: .mp4 needs ffmpeg" in message


def test_scene_that_does_not_fit_the_environment(refused):
    Path("wide.yaml").write_text(
        "start: [0, 0.5]\ngoals: [[0.8, 0.6], [1, 0.3]]\nworkspace: [[-1, -1], [2, 2]]\n"
    )
    line = "--json j.json --figure f.png --video f.gif"
    assert "the environment 2d is 2-D, the model or scene 3-D" in refused(
        f"execute solid.yaml --env 2d {line}"
    )
    assert "the environment panda is 3-D" in refused(f"execute wide.yaml --env panda {line}")
    assert "env must be one of 2d, panda, pandagym" in refused(f"execute wide.yaml --env x {line}")
    assert "the scene's workspace must be" in refused(f"execute wide.yaml {line}")


def test_model_without_stage_2(weights, refused):
    for line in (
        "execute scene.yaml --json j.json --figure f.png --video f.gif --model",
        "evaluate execution --scenes 1 --rollouts 3 --json j.json --model",
        "evaluate dial --closed-loop --scenes 1 --json j.json --model",
    ):
        assert "no stage 2" in refused(line, weights)


def test_cluster(refused):
    for line in ("data --scenes 1 --out d", "evaluate dial --scenes 1 --json j.json"):
        assert "cluster must be local or an address" in refused(f"{line} --cluster nowhere")


def test_wrong_dimension_for_the_model(weights, refused):
    message = refused("plan solid.yaml --json j.json --model", weights)
    assert "plans in 2D, the scene is 3D" in message


@pytest.mark.parametrize("content", ["", "x,y\n0,0\n1,nan\n", "x,y\n0,0\n", "x,z\n0,0\n1,1\n"])
def test_csv(content, refused):
    Path("t.csv").write_text(content)
    assert "t.csv" in refused("score t.csv scene.yaml --json j.json")


@pytest.mark.parametrize(
    "flags", ["--observer nobody", "--observer t.csv", "--observer nothing.yaml", "--target 9"]
)
def test_score(flags, refused):
    Path("t.csv").write_text("x,y\n0,0.5\n0.8,0.6\n")
    refused(f"score t.csv scene.yaml --json j.json {flags}")


def damaged_weights(name: str, weights: str) -> str:
    if name == "no such model":
        return "no-such-model"
    folder = Path(shutil.copytree(weights, "model"))
    tensors, config = folder / "path.safetensors", folder / "config.json"
    if name == "no weight file":
        tensors.unlink()
    elif name == "cut short":
        tensors.write_bytes(tensors.read_bytes()[:-100])
    elif name == "not weights":
        tensors.write_text("hello")
    elif name == "no configuration":
        config.unlink()
    elif name == "not a configuration":
        config.write_text("{")
    return str(folder)


@pytest.mark.parametrize(
    "damage",
    ["no such model", "no weight file", "cut short", "not weights", "no configuration",
     "not a configuration"],
)  # fmt: skip
def test_weights(damage, here, weights, refused):
    model = damaged_weights(damage, weights)
    refused("plan scene.yaml --json j.json --figure f.png --model", model)
    refused("evaluate dial --scenes 1 --json j.json --model", model)


@pytest.mark.parametrize("change", [
    lambda content: content.update(format=2),
    lambda content: content["path"]["config"].update(
        observer={"sigma": 0.15, "alpha": 3.0, "label": "anchored"}
    ),
    lambda content: content["path"]["config"].pop("squash"),
], ids=["format", "observer", "setting"])  # fmt: skip
def test_weights_of_another_version(change, here, weights, refused):
    file = Path(shutil.copytree(weights, "model")) / "config.json"
    content = json.loads(file.read_text())
    change(content)
    file.write_text(json.dumps(content))
    for line in ("plan scene.yaml --model model", "evaluate dial --scenes 1 --model model"):
        message = refused(line)
        assert "the weights in model are of another version of legibility" in message
        assert "train new ones with `legibility data` and `legibility train`" in message


@pytest.mark.parametrize(
    "flags",
    ["--json scene.yaml/j.json", "--json .", "--csv scene.yaml/c.csv", "--figure f.bmp",
     "--figure f", "--figure scene.yaml/f.png"],
)  # fmt: skip
def test_output_is_checked_before_the_model_is_loaded(flags, refused):
    assert "cannot write" in refused(f"plan scene.yaml --model none {flags}")


@pytest.mark.skipif(not os.path.isdir("/proc/self"), reason="/proc of Linux, read-only to root too")
def test_read_only_output(dataset, weights, refused):
    Path("t.csv").write_text("x,y\n0,0.5\n0.8,0.6\n")
    for line in (
        ["plan scene.yaml --json /proc/legibility/j.json --model", weights],
        ["score t.csv scene.yaml --json /proc/j.json"],
        ["data --scenes 1 --out /proc/legibility"],
        ["data --figure /proc/f.png --info", dataset],
        ["train path --out /proc/legibility --data", dataset],
        ["evaluate dial --json /proc/j.json --model", weights],
        ["evaluate execution --json /proc/j.json --model", weights],
        ["evaluate ablations --out /proc/legibility --data", dataset],
        ["execute scene.yaml --video /proc/f.gif --model", weights],
        ["execute scene.yaml --figure /proc/legibility/f.png --model", weights],
    ):
        assert "cannot write" in refused(*line)


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        ("", "give either"),
        ("--out d --info d", "give either"),
        ("--info d", "cannot read"),
        ("--info d --scenes 3", "leave the rest out"),
        ("--out d --figure f.png", "--figure belongs to --info"),
        ("--out d --scenes 0", "at least 1"),
        ("--out d --goals 6..2", "goals must"),
        ("--out d --goals 1..3", "goals must"),
        ("--out d --goals few", "goals must be a number or LOW..HIGH, got 'few'"),
        ("--out d --dim 4", "dim must be one of 2, 3"),
        ("--out d --stream test", "stream must be"),
        ("--out d --label best", "label must be"),
        ("--out d --detour 0.5", "detour must"),
        ("--out d --alpha -1", "alpha must"),
        ("--out d --regime any", "regime must be one of paper, dragan, observers, rooms"),
        ("--out d --views 0", "views must be"),
        ("--out d --cells 1", "cells must be"),
        ("--out d --candidates 10", "candidates must be"),
        ("--out d --noise 0.1", "settings of demonstrations need --demonstrations N"),
        ("--out d --seed -1", "seed must be"),
        ("--out scene.yaml", "is not a folder"),
    ],
)
def test_data(flags, message, refused):
    assert message in refused(f"data --json j.json {flags}")


def test_data_of_another_configuration(dataset, data_flags, refused):
    for changed in ("--scenes 5", "--views 1", "--detour 2"):
        assert "another configuration" in refused(f"data {data_flags} {changed} --out", dataset)


def test_data_that_was_changed(dataset, here, refused):
    shutil.copytree(dataset, "d")
    shard = Path("d/train-00000.parquet")
    shard.write_bytes(shard.read_bytes()[:-1])
    assert "not as it was written" in refused("data --info d")
    assert "not as it was written" in refused("train path --data d --out r")


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        ("--steps 0", "steps must be"),
        ("--learning-rate nan", "learning_rate must be"),
        ("--dropout 1", "dropout must"),
        ("--contact-weight -1", "contact_weight must"),
        ("--jerk-weight nan", "jerk_weight must"),
        ("--seed -1", "seed must be"),
        ("--validation nothing", "cannot read"),
        ("--out scene.yaml", "is not a folder"),
    ],
)
def test_train(flags, message, dataset, refused):
    assert message in refused(f"train path --out r {flags} --data", dataset)


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        ("--scenes 0", "scenes must be"),
        ("--goals 1..3", "goals must"),
        ("--levels 2", "levels must be"),
        ("--samples -1", "samples must be"),
        ("--guidance nan", "guidance must be"),
        ("--steps 0", "steps must be"),
        ("--figure f.doc", "must end in"),
    ],
)
def test_evaluate(flags, message, weights, refused):
    line = f"evaluate dial --scenes 1 {flags} --json j.json --model"
    assert message in refused(line, weights)


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        ("--scenes 0", "scenes must be"),
        ("--rollouts 2", "rollouts must be a multiple of scenes, three or more in each"),
        ("--scenes 2 --rollouts 7", "rollouts must be a multiple of scenes"),
        ("--goals 1..3", "goals must"),
        ("--disturbance -1", "disturbance must"),
        ("--seed -1", "seed must be"),
    ],
)
def test_evaluate_execution(flags, message, refused):
    line = f"evaluate execution --scenes 1 --rollouts 3 {flags} --json j.json"
    assert message in refused(line)


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        ("--scenes 0", "scenes must be"),
        ("--goals 1..3", "goals must"),
        ("--seed -1", "seed must be"),
        ("--levels 2", "levels must be"),
        ("--samples 0", "samples must be"),
        ("--sampling-steps 101", "steps must be at most 100"),
        ("--guidance nan", "guidance must be finite"),
        ("--training-steps 0", "training_steps must be"),
        ("--training-scenes 0", "training_scenes must be"),
        ("--training-scenes 5", "the data have 4 scenes, 5 are asked"),
        ("--scene-numbers 2 0", "scene_numbers must be"),
        ("--scene-numbers 9", "the data have 4 scenes, 9 are asked"),
        ("--out scene.yaml", "is not a folder"),
        ("--json .", "it is a folder"),
        ("--model nothing", "there are no weights 'nothing'"),
        ("--data nothing", "cannot read the dataset manifest"),
        ("--workers 0", "workers must be"),
        ("--device nothing", "device 'nothing' cannot be used"),
    ],
)
def test_evaluate_ablations(flags, message, dataset, weights, refused):
    line = "evaluate ablations --training-scenes 2 --scene-numbers 4 --out o --json j.json --model"
    assert message in refused(line, weights, "--data", dataset, *flags.split())
