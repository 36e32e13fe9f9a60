import json
from pathlib import Path

import pytest

from legibility.evaluation.dial import METRICS
from legibility.evaluation.execution import ROWS
from legibility.evaluation.eyes import EYES

pytestmark = pytest.mark.usefixtures("coarsely")


def test_dial(here, weights, cli, capsys):
    flags = (
        "--scenes 2 --regime obstacles --goals 2..3 --seed 1 --levels 3 --samples 1 --candidates 2"
    )
    assert cli(f"evaluate dial {flags} --json e.json --figure e.svg --model", weights) == 0
    text = capsys.readouterr().out
    content = json.loads(Path("e.json").read_text())
    assert content["command"].startswith("legibility evaluate dial --scenes 2 ")
    assert content["seed"] == 1
    assert content["config"]["goals"] == [2, 3]
    assert content["config"]["regime"] == "obstacles"
    assert content["config"]["modes"] == ["bare", "quick", "exact"]
    assert content["config"]["guidance"] is None
    assert content["model"]["name"] == weights
    assert len(content["result"]["scenes"]) == 2
    for name, values in content["result"]["overall"]["quick"].items():
        assert METRICS[name] in text
        assert len(values["interval"]) == 2
    assert "<svg" in Path("e.svg").read_text()


def test_eyes(here, weights, cli, capsys):
    flags = "--scenes 1 --goals 2 --levels 3 --samples 1 --seed 1"
    assert cli(f"evaluate eyes {flags} --json e.json --model", weights) == 0
    text = capsys.readouterr().out
    content = json.loads(Path("e.json").read_text())
    assert content["config"]["regime"] == "dragan"
    assert list(content["result"]["rows"]) == list(EYES)
    assert "The posterior legibility:" in text


def test_planning(here, weights, cli, capsys):
    flags = "--scenes 2 --goals 2 --levels 3 --search 64 --seed 1"
    assert cli(f"evaluate planning {flags} --json e.json --figure e.svg --model", weights) == 0
    text = capsys.readouterr().out
    content = json.loads(Path("e.json").read_text())
    assert content["config"]["search"] == [64]
    assert set(content["result"]) == {"dragan", "obstacles"}
    assert "limit: another" in text
    assert "<svg" in Path("e.svg").read_text()


def test_dial_of_executed_motions(here, executable, one_thread, cli, capsys):
    flags = "--closed-loop --scenes 1 --goals 2 --levels 3 --samples 1"
    assert cli(f"evaluate dial {flags} --json e.json --figure e.png --model", executable) == 0
    text = capsys.readouterr().out
    content = json.loads(Path("e.json").read_text())
    assert content["config"]["closed_loop"] is True
    assert set(content["model"]) == {"name", "path", "policy", "settings"}
    assert {"success", "deviation"} < set(content["result"]["overall"]["quick"])
    assert "share of rollouts that reached the target" in text
    assert Path("e.png").read_bytes().startswith(b"\x89PNG")


def test_execution(here, executable, one_thread, cli, capsys):
    flags = "--scenes 1 --goals 2..3 --rollouts 3 --seed 1"
    assert cli(f"evaluate execution {flags} --json e.json --model", executable) == 0
    text = capsys.readouterr().out
    content = json.loads(Path("e.json").read_text())
    assert content["config"] == {
        "scenes": 1, "regime": "dragan", "goals": [2, 3], "seed": 1, "rollouts": 3,
        "disturbance": None, "env": None, "arm": None,
    }  # fmt: skip
    for name, row in content["result"]["rows"].items():
        assert ROWS[name].text in text
        assert sum(row["reasons"].values()) == 3


def test_ablations(here, dataset, weights, cli, one_thread, monkeypatch, capsys):
    monkeypatch.setattr("legibility.data.configuration.VALIDATION_SCENES", 2)
    monkeypatch.setattr("legibility.evaluation.ablations.plan_milliseconds", lambda *_, **__: 1.5)
    flags = (
        "--scenes 1 --goals 2 --seed 1 --levels 3 --samples 1 --sampling-steps 1 --guidance 0"
        " --training-steps 2 --batch-scenes 4 --training-scenes 2 --scene-numbers 4"
    )
    words = f"evaluate ablations {flags} --out runs --json ablations-tiny.json --data"
    assert cli(words, dataset, "--model", weights) == 0
    output = capsys.readouterr()
    content = json.loads(Path("ablations-tiny.json").read_text())
    assert content["config"]["scene_numbers"] == [4]
    assert content["model"]["name"] == weights
    rows = content["result"]["rows"]
    assert list(rows) == [
        "as-shipped", "reference", "guidance-0", "steps-1", "another-seed", "twice-the-steps",
        "distilled", "without-label-loss",
        "without-contact-loss", "without-jerk-loss", "without-field", "rank-label", "long-ways",
        "scenes-4",
    ]  # fmt: skip
    for row in rows.values():
        assert row["text"][:40] in output.out  # a longer one is wrapped
        assert f"{row['text']}: spearman " in output.err
    assert cli("report . --out page.md") == 0
    assert "| small run on rank labels | " in Path("page.md").read_text()
    assert not Path("ablations-tiny.png").exists()

    monkeypatch.setattr("legibility.training.path.PathBatches.loss", None)
    assert cli(words, dataset, "--model", weights) == 0
    assert json.loads(Path("ablations-tiny.json").read_text()) == content


def test_external(here, weights, cli, capsys):
    flags = "--scenes 2 --goals 2 --levels 3 --seed 1"
    assert cli(f"evaluate external {flags} --json external-tiny.json --model", weights) == 0
    assert "Legibility Modulator, exact" in capsys.readouterr().out
    content = json.loads(Path("external-tiny.json").read_text())
    assert content["config"]["regime"] == "obstacles"
    assert set(content["model"]) == {"name", "path", "settings"}
    Path("mine.csv").write_text("x,y\n0,0.5\n0.4,0.9\n0.8,0.6\n")
    words = "evaluate external --scene scene.yaml --trajectories mine.csv --levels 3 --json e.json"
    assert cli(words, "--model", weights) == 0
    assert "your trajectories" in capsys.readouterr().out
    assert "yours" in json.loads(Path("e.json").read_text())["result"]["methods"]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("--scene scene.yaml", "--scene and --trajectories belong together"),
        ("--trajectories mine.csv", "--scene and --trajectories belong together"),
        ("--scene scene.yaml --trajectories none.csv", "none.csv"),
        ("--scene scene.yaml --trajectories mine.csv --target 2", "target"),
        ("--scene solid.yaml --trajectories solid.csv", "plans in 2D, the scene is 3D"),
        ("--scene scene.yaml --trajectories mine.csv --scenes 3", "--scenes is of random scenes"),
        ("--scene scene.yaml --trajectories mine.csv --goals 9..12", "--goals is of random scenes"),
        ("--scene scene.yaml --trajectories mine.csv --target 1", "m off the target, at most"),
        ("--target 1", "--target belongs to --scene"),
        ("--regime all", "regime must be one of dragan, rooms, obstacles"),
        ("--levels 1", "levels must be"),
    ],
)
def test_refuses_external(words, message, here, refused):
    Path("mine.csv").write_text("x,y\n0,0.5\n0.8,0.6\n")
    Path("solid.csv").write_text("x,y,z\n-0.2,-0.2,0.3\n0,0.1,0.02\n")
    assert message in refused(f"evaluate external {words}")


def test_single_scene(here, cli, one_thread, monkeypatch, capsys):
    tried = {"guidance": (2.0,), "guidance_decay": (0.5,), "guidance_share": (1.0,)}
    monkeypatch.setattr("legibility.evaluation.single_scene.GUIDANCE", tried)
    monkeypatch.setattr("legibility.evaluation.single_scene.OWN_GUIDANCE", (0.0,))
    monkeypatch.setattr("legibility.rollout.PATIENCE", 0.25)
    flags = "--rollouts 2 --demonstrations 4 --training-steps 2 --batch 8 --tuning-rollouts 1"
    words = f"evaluate single-scene {flags} --seed 3 --out runs --json single-scene-2d.json"
    assert cli(words) == 0
    output = capsys.readouterr()
    content = json.loads(Path("single-scene-2d.json").read_text())
    assert content["config"]["demonstrations"] == 4
    assert "model" not in content
    assert "toward G: all rows executed" in output.err
    assert "the best demonstrated path" in output.out
    assert cli("report . --out page.md") == 0
    assert "### Table I, learned in its scene alone: 2d" in Path("page.md").read_text()


def test_json_is_written_before_a_picture_fails(here, weights, cli, monkeypatch):
    def fail(*_):
        raise OSError("no font")

    monkeypatch.setattr("legibility.figures.paper.dial_figure", fail)
    flags = "--scenes 1 --goals 2 --levels 3 --samples 1 --candidates 0"
    assert cli(f"evaluate dial {flags} --json e.json --figure e.png --model", weights) == 2
    assert json.loads(Path("e.json").read_text())["result"]["overall"]
