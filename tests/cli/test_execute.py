import contextlib
import csv
import io
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from stubs import StubModulator

import legibility as lg
from legibility.cli import main
from legibility.envs.block_reach_2d import BlockReach2DVector
from legibility.modulator import Modulator

pytestmark = pytest.mark.usefixtures("coarsely")

LINE = "execute scene.yaml --target 1 --legibility -1:1:3 --seed 4 --push 0.1 --noise 0.001"


@pytest.fixture(scope="module")
def folder(tmp_path_factory, one_thread):
    """Where `LINE` has written all that it can."""
    folder = tmp_path_factory.mktemp("execute")
    (folder / "scene.yaml").write_text("start: [0.0, 0.5]\ngoals: [[0.8, 0.6], [1.0, 0.3]]\n")
    outputs = "--json o/e.json --csv o/e.csv --figure o/e.png --video o/e.gif --out o/m.csv"
    printed = io.StringIO()
    with contextlib.chdir(folder), contextlib.redirect_stdout(printed):
        assert main([*LINE.split(), *outputs.split()]) == 0
    (folder / "printed").write_text(printed.getvalue())
    return folder


@pytest.fixture
def executed(folder, monkeypatch):
    monkeypatch.chdir(folder)
    return json.loads(Path("o/e.json").read_text()), Path("printed").read_text()


def test_motions_at_control_steps(executed):
    content, _ = executed
    for level, rollout in zip(("-1", "0", "1"), content["result"]["rollouts"], strict=True):
        rows = list(csv.DictReader(Path(f"o/m_{level}.csv").read_text().splitlines()))
        places = np.array([[float(row[x]) for x in "xy"] for row in rows])
        assert places == pytest.approx(np.array(rollout["states"]))
        times = [float(row["time"]) for row in rows]
        assert np.diff(times) == pytest.approx(0.05)
        velocities = np.array([[float(row[f"v{x}"]) for x in "xy"] for row in rows])
        assert velocities[1:-1] == pytest.approx((places[2:] - places[:-2]) / 0.1)


def test_report(executed):
    content, text = executed
    assert set(content["model"]) == {"name", "path", "policy", "settings"}
    assert content["seed"] == 4
    assert content["config"] == {
        "env": "BlockReach2D", "target": 1, "legibility": [-1, 0, 1], "replan": True,
        "observer": lg.Observer().to_dict(), "exact": False, "refine": True,
        "max_detour": None, "num_candidates": 1,
        "noise": 0.001, "push": 0.1, "shift": 0,
    }  # fmt: skip
    result = content["result"]
    scene = lg.Scene.from_dict(result["scene"])
    assert scene == lg.Scene.load("scene.yaml")
    assert result["target"] == 1
    assert lg.Observer(**result["observer"]) == lg.Observer()
    rows = result["rollouts"]
    assert [row["legibility"] for row in rows] == [-1, 0, 1]
    for row in rows:
        assert row["reason"] in text
        assert row["success"] == (row["reason"] == "reached")
        assert len(row["states"]) == len(row["actions"]) + 1 == len(row["posterior"])
        assert np.abs(row["actions"]).max() <= 0.05
        assert scene.contains(row["states"]).all()
        held = np.array(row["posterior"])[:, 1] >= 0.8
        if row["time_to_confidence"] is None:
            assert not held[-1]
        else:
            assert held[round(row["time_to_confidence"] / 0.05) :].all()


def test_is_what_the_package_does(executed):
    content, _ = executed
    env = BlockReach2DVector(3)
    options = {"scene": lg.Scene.load("scene.yaml"), "target": 1, "push": 0.1, "noise": 0.001}
    env.reset(seed=[4, 4, 4], options=options)
    assert len(set(env.hidden["gain"])) == 1  # ℓ alone makes the difference
    modulator = lg.Modulator.from_pretrained("block-reach-2d")
    rollouts = modulator.execute_many(env, legibility=[-1, 0, 1], seed=4, observer=lg.Observer())
    for row, rollout in zip(content["result"]["rollouts"], rollouts, strict=True):
        np.testing.assert_allclose(row["states"], rollout.states, atol=1e-9)
        assert row["achieved"] == pytest.approx(rollout.achieved, abs=1e-6)
        assert row["replans"] == list(rollout.replans)


def test_csv_is_what_score_reads(executed, cli, tmp_path):
    content, _ = executed
    with open("o/e.csv", newline="") as file:
        assert len(list(csv.DictReader(file))) % 3 == 0
    assert cli("score o/e.csv scene.yaml --target 1 --json", tmp_path / "s.json") == 0
    rated = json.loads((tmp_path / "s.json").read_text())["result"]["trajectories"]
    assert [row["trajectory"] for row in rated] == ["-1", "0", "1"]
    achieved = [row["achieved"] for row in content["result"]["rollouts"]]
    np.testing.assert_allclose([r["achieved_label"] for r in rated], achieved, atol=0.05)


def test_files_are_whole(executed):
    content, _ = executed
    names = ["e.csv", "e.gif", "e.json", "e.png", "m_-1.csv", "m_0.csv", "m_1.csv"]
    assert sorted(os.listdir("o")) == names
    with Image.open("o/e.gif") as film:
        longest = max(len(row["actions"]) for row in content["result"]["rollouts"])
        assert film.n_frames <= longest + 1  # equal frames become one
    with Image.open("o/e.png") as picture:
        assert min(picture.size) > 400


def test_same_seed_same_picture(executed, cli, tmp_path):
    assert cli(f"{LINE} --figure", tmp_path / "again.png") == 0
    assert (tmp_path / "again.png").read_bytes() == Path("o/e.png").read_bytes()


def test_levels_by_default(here, executable, cli, capsys):
    """A model that has learned nothing is stopped with a reason, not with an error."""
    assert cli("execute scene.yaml --shift 0.1 --no-replan --model", executable) == 0
    text = capsys.readouterr().out
    for level in ("-1.000", "0.000", "1.000"):
        assert level in text
    assert sorted(os.listdir()) == ["scene.yaml", "solid.yaml"]


def test_shipped_model_arrives(executed):
    rows = executed[0]["result"]["rollouts"]
    assert [row["reason"] for row in rows] == ["reached"] * 3
    assert [row["replans"] != [] for row in rows].count(True) >= 1


def test_full_disk_leaves_nothing(here):
    resource = pytest.importorskip("resource")
    before = sorted(os.listdir())
    found = subprocess.run(
        [sys.executable, "-m", "legibility", *["execute", "scene.yaml", "--legibility", "0"],
         "--video", "f.gif"],
        capture_output=True,
        text=True,
        timeout=120,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000)),
    )  # fmt: skip
    assert (found.returncode, found.stdout) == (2, "")
    lines = [
        line for line in found.stderr.splitlines() if not line.startswith("legibility: frames")
    ]
    assert len(lines) == 1
    assert lines[0].startswith("legibility: error: cannot write f.gif")
    assert sorted(os.listdir()) == before


@pytest.mark.parametrize("observer", ["dragan", "paper"])
def test_beliefs_of_dragans_observer_and_of_the_dials(observer, here, cli, capsys, monkeypatch):
    stub = StubModulator()
    monkeypatch.setattr(Modulator, "from_pretrained", lambda name: stub)
    with open("scene.yaml", "a") as file:
        file.write("obstacles: [{ball: {center: [0.4, 0.3], radius: 0.1}}]\n")
    flags = f"--observer {observer} --exact --no-refine --json e.json --figure e.png"
    assert cli(f"execute scene.yaml {flags}") == 0
    assert (stub.options["exact"], stub.options["refine"]) == (True, False)
    result = json.loads(Path("e.json").read_text())["result"]
    found = lg.Observer.from_dict(result["observer"])
    assert found == {"dragan": lg.Observer(), "paper": lg.Observer.paper(2)}[observer]
    assert not result["blocked"]
    scene = lg.Scene.from_dict(result["scene"])
    for row in result["rollouts"]:
        states = np.array(row["states"])
        for name, reader in (("dragan_posterior", lg.Observer()), ("posterior", found)):
            np.testing.assert_allclose(row[name], reader.field(scene).posterior(states), atol=1e-9)
        assert row["clearance"] == pytest.approx(scene.clearance_at(states, 0).min())
        assert isinstance(row["feasible"], bool)
        assert (row["dragan_time_to_confidence"] == row["time_to_confidence"]) or found != (
            lg.Observer()
        )
    text = capsys.readouterr().out
    assert "Dragan’s observer" in text
    assert ("the dial’s observer" in text) == (observer == "paper")
    assert "clearance [mm]" in text
    assert "nats below ℓ = 0" in text
