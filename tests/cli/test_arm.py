"""The commands on 3-D scenes, with the shipped weights of the arm."""

import json
from pathlib import Path

import numpy as np
import pytest

import legibility as lg

SCENE = Path(__file__).parents[2] / "examples" / "panda.yaml"


def test_plan(cli, tmp_path):
    line = f"plan {SCENE} --legibility -1 0 1 --figure {tmp_path}/p.png --json"
    assert cli(line, tmp_path / "p.json") == 0
    content = json.loads((tmp_path / "p.json").read_text())
    assert content["model"]["name"] == "panda-block-reach"
    paths = content["result"]["paths"]
    assert np.shape(paths[0]["waypoints"]) == (10, 3)
    assert paths[0]["achieved"] < -0.8
    assert paths[1]["achieved"] == pytest.approx(0, abs=0.1)
    assert paths[2]["achieved"] > 0.8
    assert (tmp_path / "p.png").stat().st_size > 10_000


def test_plan_past_an_obstacle(cli, tmp_path):
    wall = "obstacles: [{box: {center: [-0.1, -0.05, 0.1], size: [0.03, 0.1, 0.2], yaw: 0.3}}]"
    scene = tmp_path / "wall.yaml"
    scene.write_text(f"{SCENE.read_text()}{wall}\nclearance: 0.01\ngoal_radius: 0.04\n")
    assert cli("plan --exact --json", tmp_path / "p.json", scene) == 0
    content = json.loads((tmp_path / "p.json").read_text())
    assert content["config"]["exact"] is True
    assert content["result"]["observer"] == lg.Observer().to_dict()
    for path in content["result"]["paths"]:
        assert path["feasible"]
        assert path["clearance"] > -1e-8  # of a wall
        assert path["achieved"] == pytest.approx(path["legibility"], abs=0.15)


@pytest.fixture
def sketched(monkeypatch):
    """Pictures are as without OpenGL, which takes half a second for one without a graphics card."""
    monkeypatch.setattr("legibility.envs.panda_render._renderer", lambda arm: None)


@pytest.mark.parametrize(("env", "module"), [("panda", "mujoco"), ("pandagym", "pybullet")])
def test_execute(env, module, cli, tmp_path, sketched):
    pytest.importorskip(module, reason=f"the environment {env} needs {module}")
    pictures = [f"--spectrum {tmp_path}/s.png", f"--video {tmp_path}/f.gif"]
    pictures = pictures[: 2 if env == "panda" else 1]  # a film of each takes its time
    line = f"execute {SCENE} --legibility -1 1 --env {env} {' '.join(pictures)}"
    assert cli(f"{line} --json", tmp_path / "e.json") == 0
    content = json.loads((tmp_path / "e.json").read_text())
    low, high = content["result"]["rollouts"]
    assert low["reason"] == high["reason"] == "reached"
    assert low["achieved"] < -0.8
    assert high["achieved"] > 0.8
    for row in (low, high):
        assert np.linalg.norm(np.subtract(row["states"][-1], lg.Scene.load(SCENE).goals[0])) < 0.02
        assert np.abs(row["actions"]).max() <= 0.02
        assert not any(row["counts"].values())
    for picture in pictures:
        assert Path(picture.split()[1]).stat().st_size > 10_000


def test_evaluate(cli, tmp_path):
    pytest.importorskip("mujoco", reason="the extra named panda is not installed")
    line = "evaluate execution --model panda-block-reach --scenes 1 --goals 2..3 --rollouts 3"
    assert cli(f"{line} --seed 9 --json", tmp_path / "x.json") == 0
    result = json.loads((tmp_path / "x.json").read_text())["result"]
    assert result["env"] == "PandaBlockReach"
    assert result["disturbance"] == pytest.approx(0.04)
    assert result["rows"]["policy"]["success"]["mean"] == 1
    assert set(result["rows"]["policy"]["counts"].values()) == {0}
    line = "evaluate dial --model panda-block-reach --scenes 1 --levels 3 --samples 1 --closed-loop"
    assert cli(f"{line} --candidates 0 --seed 9 --json", tmp_path / "y.json") == 0
    assert json.loads((tmp_path / "y.json").read_text())["result"]["env"] == "PandaBlockReach"


def test_a_scene_of_the_plane_is_refused(cli, tmp_path, capsys):
    flat = SCENE.with_name("paper.yaml")
    assert cli(f"execute {flat} --model panda-block-reach --env panda") == 2
    assert "the environment panda is 3-D, the model or scene 2-D" in capsys.readouterr().err
    assert cli(f"plan {flat} --model panda-block-reach") == 2
    assert "plans in 3D, the scene is 2D" in capsys.readouterr().err


@pytest.mark.parametrize(
    "goal", ["[0.4, 0, 0.05]", "[0.04, 0, -0.05]", "[-0.55, 0, 0.1]"],
    ids=["out of reach", "below the table", "inside the robot"],
)  # fmt: skip
def test_a_goal_that_the_arm_cannot_go_to(goal, cli, tmp_path, capsys):
    (tmp_path / "s.yaml").write_text(f"start: [-0.2, 0, 0.2]\ngoals: [[0.04, 0.1, 0.02], {goal}]\n")
    assert cli("execute", tmp_path / "s.yaml") == 2
    assert "lies outside the workspace" in capsys.readouterr().err
