import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import legibility as lg
from legibility.cli import main

EXAMPLES = Path(__file__).parents[2] / "examples"


def test_example(here, capsys):
    files = [str(EXAMPLES / "trajectories.csv"), str(EXAMPLES / "paper.yaml")]
    assert main(["score", *files, "--json", "s.json"]) == 0
    output = capsys.readouterr()
    assert output.err == ""
    content = json.loads(Path("s.json").read_text())
    assert content["legibility"] == lg.__version__
    assert content["command"] == f"legibility score {files[0]} {files[1]} --json s.json"
    assert content["config"] == {"target": 0, "observer": lg.Observer().to_dict()}
    assert content["result"]["range"] == pytest.approx(lg.build_archive(
        lg.Scene.load(files[1]), 0).range)  # fmt: skip
    assert not content["result"]["blocked"]
    rows = {row["name"]: row for row in content["result"]["trajectories"]}
    assert rows["legible"]["achieved_label"] > 0.9
    assert abs(rows["straight"]["achieved_label"]) < 0.01
    assert rows["ambiguous"]["achieved_label"] < -0.99
    assert rows["straight"]["predictability"] == pytest.approx(1, abs=1e-5)
    for name in (*rows, *lg.metrics.evaluate_trajectory(np.eye(2), lg.InformationPotentialField(
        np.array([[0, 0], [1, 1.0]]), sigma=1), 0)):  # fmt: skip
        assert name in output.out


def test_another_observer(here, cli, capsys):
    Path("t.csv").write_text("x,y\n0,0.5\n0.4,0.4\n1,0.3\n")
    Path("o.yaml").write_text("{kind: gaussian, sigma: 0.3, alpha: 0, label: rank}\n")
    assert cli("score t.csv scene.yaml --target 1 --observer o.yaml --json s.json") == 0
    observer = lg.Observer(kind="gaussian", sigma=0.3, alpha=0, label="rank")
    content = json.loads(Path("s.json").read_text())
    assert content["config"]["observer"] == observer.to_dict()
    row = content["result"]["trajectories"][0]
    scene = lg.Scene.load("scene.yaml")
    points = np.array([[0, 0.5], [0.4, 0.4], [1, 0.3]])
    for name, value in lg.metrics.evaluate_trajectory(points, observer.field(scene), 1, 0).items():
        assert row[name] == (pytest.approx(float(value)) if np.isfinite(value) else None)
    archive = lg.build_archive(scene, 1, observer=observer)
    assert row["achieved_label"] == pytest.approx(float(archive.label_of(row["legibility_score"])))
    text = " ".join(capsys.readouterr().out.split())
    assert "field_…: gaussian, neutral, σ = 0.3 m; dragan_…: Dragan’s observer" in text
    assert "nats below ℓ = 0" in text


def test_obstacles(here, capsys):
    Path("t.csv").write_text("x,y\n0,0.5\n0.8,0.6\n")
    with open("scene.yaml", "a") as file:
        file.write("obstacles: [{ball: {center: [0.4, 0.5], radius: 0.1}}]\n")
    assert main(["score", "t.csv", "scene.yaml", "--json", "s.json"]) == 0
    assert "the straight line is blocked" in capsys.readouterr().out
    result = json.loads(Path("s.json").read_text())["result"]
    assert result["blocked"]
    distance = 0.05 * np.cos(np.arctan2(0.1, 0.8))
    assert result["trajectories"][0]["clearance"] == pytest.approx(distance - 0.1, abs=1e-4)


def test_a_time_never_reached_is_null(here, capsys):
    Path("t.csv").write_text("x,y\n0.8,0.6\n1,0.3\n")
    line = "score t.csv scene.yaml --observer paper --json s.json"
    assert main(line.split()) == 0
    assert "never" in capsys.readouterr().out
    row = json.loads(Path("s.json").read_text())["result"]["trajectories"][0]
    assert row["field_time_to_confidence"] is None


def test_ends_that_are_elsewhere_are_told(here, capsys):
    Path("t.csv").write_text("x,y\n0.1,0.5\n0.8,0.6\n")
    assert main(["score", "t.csv", "scene.yaml"]) == 0
    output = capsys.readouterr()
    assert "starts 0.100 m from the start" in output.err
    assert "ends" not in output.err
    assert "starts" not in output.out


def test_many_are_summarised(here, capsys):
    lines = [f"{n},0,0.5\n{n},0.8,0.6\n" for n in range(12)]
    Path("t.csv").write_text("trajectory,x,y\n" + "".join(lines))
    assert main(["score", "t.csv", "scene.yaml"]) == 0
    assert "lowest" in capsys.readouterr().out


def test_solid_scene(here, capsys):
    Path("t.csv").write_text("x,y,z\n-0.2,-0.2,0.3\n0,0.1,0.02\n")
    assert main(["score", "t.csv", "solid.yaml", "--json", "s.json"]) == 0
    content = json.loads(Path("s.json").read_text())
    assert content["config"]["observer"] == lg.Observer().to_dict()
    assert abs(content["result"]["trajectories"][0]["achieved_label"]) < 1e-6


def test_no_torch(here):
    Path("t.csv").write_text("x,y\n0,0.5\n0.8,0.6\n")
    code = (
        "import sys; from legibility.cli import main; s = main(['score', 't.csv', 'scene.yaml']);"
        "sys.exit(s or 'torch' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], stdout=subprocess.DEVNULL).returncode == 0
