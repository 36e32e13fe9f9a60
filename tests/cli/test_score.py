import csv
import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from pictures import assert_picture

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
    observers = {"dragan": lg.Observer().to_dict()}
    assert content["config"] == {"target": None, "tolerance": None, "observers": observers}
    (dial,) = content["result"]["dials"]
    assert (dial["observer"], dial["target"], dial["blocked"]) == ("dragan", 0, False)
    assert dial["range"] == pytest.approx(lg.build_archive(lg.Scene.load(files[1]), 0).range)
    rows = {row["trajectory"]: row for row in content["result"]["trajectories"]}
    assert rows["legible"]["achieved_label"] > 0.9
    assert abs(rows["straight"]["achieved_label"]) < 0.01
    assert rows["ambiguous"]["achieved_label"] < -0.99
    assert rows["straight"]["predictability"] == pytest.approx(1, abs=1e-5)
    assert all(name in output.out for name in rows)
    metrics = lg.metrics.evaluate_trajectory(np.eye(2), lg.Observer().field(
        lg.Scene.load(files[1])), 0)  # fmt: skip
    assert metrics.keys() < rows["legible"].keys()


def test_another_observer(here, cli, capsys):
    Path("t.csv").write_text("x,y\n0,0.5\n0.4,0.4\n1,0.3\n")
    Path("o.yaml").write_text("{kind: gaussian, sigma: 0.3, alpha: 0, label: rank}\n")
    assert cli("score t.csv scene.yaml --target 1 --observer o.yaml --json s.json") == 0
    observer = lg.Observer(kind="gaussian", sigma=0.3, alpha=0, label="rank")
    content = json.loads(Path("s.json").read_text())
    assert content["config"]["observers"] == {"o.yaml": observer.to_dict()}
    row = content["result"]["trajectories"][0]
    scene = lg.Scene.load("scene.yaml")
    points = np.array([[0, 0.5], [0.4, 0.4], [1, 0.3]])
    for name, value in lg.metrics.evaluate_trajectory(points, observer.field(scene), 1, 0).items():
        assert row[name] == (pytest.approx(float(value)) if np.isfinite(value) else None)
    archive = lg.build_archive(scene, 1, observer=observer)
    assert row["achieved_label"] == pytest.approx(float(archive.label_of(row["legibility_score"])))
    text = " ".join(capsys.readouterr().out.split())
    assert "o.yaml: gaussian, neutral, σ = 0.3 m" in text
    assert "nats below ℓ = 0" in text


def test_obstacles(here, capsys):
    Path("t.csv").write_text("x,y\n0,0.5\n0.8,0.6\n")
    with open("scene.yaml", "a") as file:
        file.write("obstacles: [{ball: {center: [0.4, 0.5], radius: 0.1}}]\n")
    assert main(["score", "t.csv", "scene.yaml", "--json", "s.json"]) == 0
    assert "the straight line is blocked" in capsys.readouterr().out
    result = json.loads(Path("s.json").read_text())["result"]
    assert result["dials"][0]["blocked"]
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


def recorded(name, target, rng, noise=5e-4, rest=200):
    """A motion to a goal of scene.yaml at 100 Hz, as a sensor sees it."""
    scene = lg.Scene.load("scene.yaml")
    share = np.linspace(0, 1, 300)
    share = 10 * share**3 - 15 * share**4 + 6 * share**5
    bend = 0.2 * np.sin(np.pi * share)[:, None] * [0, 1]
    motion = scene.start + share[:, None] * (scene.goals[target] - scene.start) + bend
    motion = np.pad(motion, ((rest, rest), (0, 0)), "edge")
    noisy = motion + rng.normal(0, noise, motion.shape)
    times = np.arange(len(motion)) / 100
    lines = [
        f"{name},{target},{t},{x},{y}" for t, (x, y) in zip(times, noisy.tolist(), strict=True)
    ]
    return "\n".join(lines) + "\n", motion


def test_recordings(here, cli, capsys):
    """Rests and noise change neither label nor length; each trajectory has its own target."""
    rng = np.random.default_rng(0)
    texts, motions = zip(*(recorded(n, t, rng) for n, t in (("a", 0), ("b", 1))), strict=True)
    Path("r.csv").write_text("trajectory,target,t,x,y\n" + "".join(texts))
    assert cli("score r.csv scene.yaml --observer dragan paper --csv s.csv --json s.json") == 0
    output = capsys.readouterr()
    assert output.err == ""
    rows = json.loads(Path("s.json").read_text())["result"]["trajectories"]
    assert [(r["trajectory"], r["observer"], r["target"]) for r in rows] == [
        (name, who, target) for name, target in (("a", 0), ("b", 1)) for who in ("dragan", "paper")
    ]
    scene = lg.Scene.load("scene.yaml")
    for row, motion in zip(rows[::2], motions, strict=True):
        exact = lg.score(lg.Recording(motion), scene, row["target"])
        assert row["achieved_label"] == pytest.approx(exact.achieved, abs=0.02)
        assert row["length"] == pytest.approx(exact.metrics["length"], rel=0.005)
        assert 4e-4 < row["noise"] < 9e-4
        assert 2.2 < row["duration"] < 3
    with open("s.csv") as file:
        table = list(csv.DictReader(file))
    assert [list(row) for row in table] == [list(rows[0])] * 4
    assert [float(row["achieved_label"]) for row in table] == [r["achieved_label"] for r in rows]
    for word in ("a ", "b ", "dragan", "paper", "goal 1"):
        assert word in output.out


def test_what_was_asked_goes_before_the_column(here, cli):
    text, _ = recorded("a", 0, np.random.default_rng(0))
    Path("r.csv").write_text("trajectory,target,t,x,y\n" + text)
    assert cli("score r.csv scene.yaml --target 1 --json s.json") == 0
    (row,) = json.loads(Path("s.json").read_text())["result"]["trajectories"]
    assert row["target"] == 1


def test_much_noise_is_told(here, cli, capsys):
    text, _ = recorded("shaky", 0, np.random.default_rng(0), noise=3e-3)
    Path("r.csv").write_text("trajectory,target,t,x,y\n" + text)
    assert cli("score r.csv scene.yaml") == 0
    assert re.search(r"trajectory shaky: \d+% of its length is taken for", capsys.readouterr().err)


def test_two_motions_of_one_name_are_told(here, cli, capsys):
    texts = [recorded("a", target, np.random.default_rng(0))[0] for target in (0, 1)]
    rows = ["a," + line.split(",", 3)[3] for text in texts for line in text.splitlines()]
    Path("r.csv").write_text("trajectory,x,y\n" + "\n".join(rows) + "\n")
    assert cli("score r.csv scene.yaml --target 0") == 0
    assert "between two points: do several have its name?" in capsys.readouterr().err


def test_belief(here, cli):
    text, _ = recorded("a", 0, np.random.default_rng(0))
    Path("r.csv").write_text("trajectory,target,t,x,y\n" + text)
    line = "score r.csv scene.yaml --observer dragan paper --belief"
    assert cli(f"{line} b.csv") == 0
    assert cli(f"{line} b.png") == 0
    assert_picture("b.png")
    with open("b.csv") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == ["trajectory", "observer", "t", "x", "y", "belief_0", "belief_1"]
    assert {row["observer"] for row in rows} == {"dragan", "paper"}
    assert all(abs(float(r["belief_0"]) + float(r["belief_1"]) - 1) < 1e-9 for r in rows)
    times = [float(row["t"]) for row in rows if row["observer"] == "paper"]
    assert times == sorted(times)
    assert 2 < times[0] < 2.5
    assert float(rows[-1]["belief_0"]) > 0.8


def test_tolerance(here, cli, capsys):
    Path("t.csv").write_text("x,y\n0,0.5\n0.5,1.12\n0.8,0.6\n")
    assert cli("score t.csv scene.yaml") == 0
    assert cli("score t.csv scene.yaml --tolerance 0.01") == 2
    assert "point 1, [0.5, 1.12], lies over 0.01 m outside" in capsys.readouterr().err


BAD = {
    "x,y\n0,0.5\n0.8,5\n": ("", "point 1, [0.8, 5.0], lies over"),
    "x,y\n0,0.5\n0,0.5\n": ("", "recording '1' must move"),
    "x,y,target\n0,0.5,2\n0.8,0.6,2\n": ("", "target must be a goal's index from 0 to 1, got 2"),
    "x,y\n0,0.5\n0.8,0.6\n": ("--tolerance -1", "tolerance must be a number of at least 0, got -1"),
    "x,y\n0,0.5\n0.8,0.61\n": ("--belief b.txt", "belief must end in .csv, .png, .pdf or .svg"),
    "x,y\n0,0.5\n0.8,0.62\n": ("--observer me", "observer must be dragan, paper or a file"),
}


@pytest.mark.parametrize(("content", "case"), BAD.items(), ids=lambda x: None)
def test_bad_input(content, case, here, cli, capsys):
    Path("t.csv").write_text(content)
    assert cli(f"score t.csv scene.yaml --csv s.csv {case[0]}") == 2
    assert case[1] in capsys.readouterr().err
    assert not Path("s.csv").exists()


def test_solid_scene(here, capsys):
    Path("t.csv").write_text("x,y,z\n-0.2,-0.2,0.3\n0,0.1,0.02\n")
    assert main(["score", "t.csv", "solid.yaml", "--json", "s.json"]) == 0
    content = json.loads(Path("s.json").read_text())
    assert content["config"]["observers"] == {"dragan": lg.Observer().to_dict()}
    assert abs(content["result"]["trajectories"][0]["achieved_label"]) < 1e-6


def test_no_torch(here):
    Path("t.csv").write_text("x,y\n0,0.5\n0.8,0.6\n")
    code = (
        "import sys; from legibility.cli import main; s = main(['score', 't.csv', 'scene.yaml']);"
        "sys.exit(s or 'torch' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], stdout=subprocess.DEVNULL).returncode == 0
