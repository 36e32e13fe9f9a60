import csv
import hashlib
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hub import fake_hub
from stubs import StubModulator

import legibility as lg
from legibility.cli.output import model_record
from legibility.modulator import Modulator


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
    assert content["model"] == model_record(weights, "path")
    assert content["model"]["path"] == digest
    assert content["seed"] == 4
    assert content["config"] == {
        "target": 0, "legibility": [-1, 0, 1, -0.5], "observer": lg.Observer().to_dict(),
        "exact": False, "refine": True, "max_detour": None, "num_candidates": 3, "guidance": 0.5,
        "steps": 3, "points": 30,
    }  # fmt: skip
    paths = content["result"]["paths"]
    assert [path["legibility"] for path in paths] == [-1, 0, 1, -0.5]
    assert "detour" in text
    assert "Dragan’s observer" in text

    scene = lg.Scene.load("scene.yaml")
    plan = lg.Modulator.from_pretrained(weights).plan(
        scene, 0, [-1, 0, 1, -0.5], seed=4, observer=lg.Observer(), num_candidates=3, guidance=0.5,
        steps=3,
    )  # fmt: skip
    assert lg.Scene.from_dict(content["result"]["scene"]) == scene
    for key, values in {"waypoints": plan.waypoints, "trajectory": plan.trajectory(30),
                        "achieved": plan.achieved, "score": plan.score, "clearance": plan.clearance,
                        "feasible": plan.feasible}.items():  # fmt: skip
        np.testing.assert_allclose([path[key] for path in paths], values, atol=1e-6)
    assert all(path["detour"] >= 1 - 1e-9 for path in paths)
    archive = lg.build_archive(scene, 0)
    assert content["result"]["range"] == pytest.approx(archive.range)
    assert content["result"]["degenerate"] == archive.degenerate


def test_csv_is_what_score_reads(planned, cli):
    content, _ = planned
    with open("out/p.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 4 * 30
    assert list(rows[0]) == ["trajectory", "x", "y"]
    assert cli("score out/p.csv scene.yaml --json s.json") == 0
    rated = json.loads(Path("s.json").read_text())["result"]["trajectories"]
    assert [row["trajectory"] for row in rated] == ["-1", "0", "1", "-0.5"]
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


def test_max_detour(here, weights, cli, capsys):
    words = "plan scene.yaml --legibility -1 1 --max-detour 1.1 --json p.json --model"
    assert cli(words, weights) == 0
    content = json.loads(Path("p.json").read_text())
    assert content["config"]["max_detour"] == 1.1
    assert max(path["detour"] for path in content["result"]["paths"]) <= 1.1 * (1 + 1e-6)
    capsys.readouterr()
    assert cli("plan scene.yaml --max-detour 0.9 --model", weights) == 2
    assert "max_detour must be a number of at least 1, got 0.9" in capsys.readouterr().err


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


@pytest.fixture
def stub(monkeypatch):
    """Paths of the scene's archive."""
    modulator = StubModulator()
    monkeypatch.setattr(Modulator, "from_pretrained", lambda name: modulator)
    return modulator


def test_observer_and_modes_reach_the_planner(here, stub, cli, capsys):
    flags = "--observer paper --exact --no-refine --json p.json --figure p.png"
    assert cli(f"plan scene.yaml {flags}") == 0
    assert stub.options["observer"] == lg.Observer.paper(2)
    assert (stub.options["exact"], stub.options["refine"]) == (True, False)
    content = json.loads(Path("p.json").read_text())
    assert content["config"]["observer"] == content["result"]["observer"]
    assert lg.Observer.from_dict(content["result"]["observer"]) == lg.Observer.paper(2)
    assert content["result"]["degenerate"]
    text = " ".join(capsys.readouterr().out.split())
    assert "gaussian, uniform, σ = 0.15 m" in text
    assert "less than 0.05 nats" in text
    assert "clearance" not in text


def test_obstacles(here, stub, cli, capsys):
    with open("scene.yaml", "a") as file:
        file.write(
            "obstacles: [{ball: {center: [0.4, 0.5], radius: 0.1}}]\nclearance: 0.05\n"
            "observer: {beta: 12}\n"
        )
    assert cli("plan scene.yaml --legibility -1:1:5 --json p.json") == 0
    result = json.loads(Path("p.json").read_text())["result"]
    assert result["blocked"]
    assert result["observer"]["beta"] == 12
    scene = lg.Scene.from_dict(result["scene"])
    for row in result["paths"]:
        clearance = scene.clearance_at(row["trajectory"], 0).min()
        assert row["clearance"] == pytest.approx(clearance, abs=2e-3)
        assert isinstance(row["feasible"], bool)
        assert row["detour"] >= 0.95
    text = " ".join(capsys.readouterr().out.split())
    assert "clearance [m]" in text
    assert "the straight line is blocked: ℓ = 0 is the shortest feasible curve" in text
    infeasible = sum(not row["feasible"] for row in result["paths"])
    assert ("not feasible" in text) == (infeasible > 0)


def test_paths_that_are_not_feasible_are_told(here, stub, cli, capsys, monkeypatch):
    def touching(scene, target, levels, observer, path=stub.path):
        found = path(scene, target, levels, observer)
        found.__dict__["feasible"] = np.arange(len(levels)) > 0
        return found

    monkeypatch.setattr(stub, "path", touching)
    assert cli("plan scene.yaml --json p.json") == 0
    assert "1 of 3 paths are not feasible" in capsys.readouterr().out


class TestTimed:
    """Timed motions on the command line."""

    @pytest.fixture(autouse=True)
    def extras(self):
        pytest.importorskip("toppra", reason="timed motions are NOT TESTED")

    def test_a_file_for_each_level(self, here, weights, cli, capsys):
        words = "plan scene.yaml --legibility -1 0 --rate 50 --out out/m.csv --json out/p.json"
        assert cli(words, "--model", weights) == 0
        assert "duration [s]" in capsys.readouterr().out
        paths = json.loads(Path("out/p.json").read_text())["result"]["paths"]
        for level, path in zip(("-1", "0"), paths, strict=True):
            rows = list(csv.DictReader(Path(f"out/m_{level}.csv").read_text().splitlines()))
            assert float(rows[1]["time"]) == 0.02
            assert float(rows[-1]["time"]) == pytest.approx(path["duration"])
            assert [float(rows[-1][x]) for x in "xy"] == pytest.approx([0.8, 0.6], abs=1e-6)
        assert "score_over_time" in paths[0]

    def test_an_arm(self, here, cli):
        for extra in ("mujoco", "mink", "rosbags", "mcap_ros2"):
            pytest.importorskip(extra, reason="timed motions of an arm are NOT TESTED")
        from mcap_ros2.reader import read_ros2_messages

        words = "plan solid.yaml --legibility 1 --arm panda --rate 200 --frame base --out m.mcap"
        assert cli(words) == 0
        joints, path = [message.ros_msg for message in read_ros2_messages("m.mcap")]
        assert len(joints.points) == len(path.poses) > 50
        assert path.poses[0].pose.position.x == pytest.approx(-0.2 + 0.6)

    @pytest.mark.parametrize(
        ("words", "message"),
        [
            ("--arm panda", "--arm needs --out, the file of a timed motion"),
            ("--out m.txt --legibility 1", "its name must end in .csv, .json, .mcap"),
            ("--rate 50", "--rate needs --out"),
            ("--frame base", "--frame needs --out"),
            ("--out m.csv --legibility 1 1", "two outputs have the file m_1.csv"),
            ("--out m.csv --legibility 1 --csv m.csv", "two outputs have the file m.csv"),
            ("--out m.csv --frame base", "frame must be one of world without an arm, got 'base'"),
            ("--out m.csv --arm panda", "an arm moves in 3-D, the scene is 2-D"),
            ("--out m.csv --max-duration -1", "max_duration must be a number above 0, got -1"),
            ("--out m.csv --rate 0", "rate must be a number above 0, got 0"),
            ("--out m.csv --limits slow", "limits must be one of panda, fr3, moveit-panda, point"),
            ("--out m.csv --arm scene.yaml", "does not describe an arm"),
            ("--out m.csv --legibility 1 --max-duration 0.01", "longer than max_duration 0.01 s"),
            ("--out m.csv --frame tool", "frame must be one of world without an arm, got 'tool'"),
        ],
    )
    def test_refuses(self, words, message, refused, weights):
        assert message in refused(f"plan scene.yaml {words} --model", weights)


def test_weights_on_the_hub(weights, here, cli, monkeypatch, tmp_path_factory, refused, capsys):
    line = "plan scene.yaml --legibility 0 --json p.json --model"
    with fake_hub(monkeypatch, tmp_path_factory.mktemp("cache")):
        Modulator.from_pretrained(weights).push_to_hub("ada/mine", branch="v1")
        assert cli(line, "ada/mine@v1") == 0
        model = json.loads(Path("p.json").read_text())["model"]
        assert model == {**model_record(weights), "name": "ada/mine@v1"}
        capsys.readouterr()
        assert "ada/mine on the Hugging Face Hub has no revision 'v2'" in refused(
            line, "ada/mine@v2"
        )
    assert "cannot reach the Hugging Face Hub" in refused(line, "ada/theirs")
