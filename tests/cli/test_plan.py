import csv
import hashlib
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import legibility as lg


@pytest.fixture
def planned(here, weights, cli, capsys):
    flags = "--legibility -1:1:3 -0.5 --seed 4 --candidates 3 --guidance 0.5 --steps 3"
    outputs = "--json out/p.json --csv out/p.csv --figure out/p.png --points 30"
    assert cli(f"plan scene.yaml {flags} {outputs} --model", weights) == 0
    output = capsys.readouterr()
    assert output.err == ""
    return json.loads(Path("out/p.json").read_text()), output.out


def test_report(planned, weights):
    content, text = planned
    digest = hashlib.sha256(Path(weights, "path.safetensors").read_bytes()).hexdigest()
    assert content["model"] == {"name": weights, "path": digest}
    assert content["seed"] == 4
    assert content["config"] == {
        "target": 0, "legibility": [-1, 0, 1, -0.5], "num_candidates": 3, "guidance": 0.5,
        "steps": 3, "points": 30,
    }  # fmt: skip
    paths = content["result"]["paths"]
    assert [path["legibility"] for path in paths] == [-1, 0, 1, -0.5]
    assert "length ratio" in text

    scene = lg.Scene.load("scene.yaml")
    plan = lg.Modulator.from_pretrained(weights).plan(
        scene, 0, [-1, 0, 1, -0.5], seed=4, num_candidates=3, guidance=0.5, steps=3
    )
    assert lg.Scene.from_dict(content["result"]["scene"]) == scene
    for key, values in {"waypoints": plan.waypoints, "trajectory": plan.trajectory(30),
                        "achieved": plan.achieved, "score": plan.score}.items():  # fmt: skip
        np.testing.assert_allclose([path[key] for path in paths], values, atol=1e-6)
    assert all(path["length_ratio"] >= 1 - 1e-9 for path in paths)


def test_csv_is_what_score_reads(planned, cli):
    content, _ = planned
    with open("out/p.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 4 * 30
    assert list(rows[0]) == ["trajectory", "x", "y"]
    assert cli("score out/p.csv scene.yaml --json s.json") == 0
    rated = json.loads(Path("s.json").read_text())["result"]["trajectories"]
    assert [row["name"] for row in rated] == ["-1", "0", "1", "-0.5"]
    achieved = [path["achieved"] for path in content["result"]["paths"]]
    np.testing.assert_allclose([r["achieved_label"] for r in rated], achieved, atol=0.05)


def test_files_are_whole(planned):
    assert sorted(os.listdir("out")) == ["p.csv", "p.json", "p.png"]
    assert Path("out/p.png").read_bytes().startswith(b"\x89PNG")


def test_levels_by_default(here, weights, cli, capsys):
    assert cli("plan scene.yaml --target 1 --model", weights) == 0
    text = capsys.readouterr().out
    for level in ("-1.000", "0.000", "1.000"):
        assert level in text
    assert not list(here.glob("*.json"))


def test_full_disk_leaves_nothing(here, weights):
    resource = pytest.importorskip("resource")
    line = [sys.executable, "-m", "legibility", "plan", "scene.yaml", "--model", weights]
    before = sorted(os.listdir())
    found = subprocess.run(
        [*line, "--figure", "p.png"],
        capture_output=True,
        text=True,
        timeout=120,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000)),
    )
    assert (found.returncode, found.stdout) == (2, "")
    assert found.stderr.startswith("legibility: error: cannot write p.png")
    assert found.stderr.count("\n") == 1
    assert sorted(os.listdir()) == before
