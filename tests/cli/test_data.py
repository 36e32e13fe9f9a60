import json
from pathlib import Path

import numpy as np
import pytest

from legibility.data.configuration import targets_of
from legibility.data.dataset import Dataset
from legibility.scene import Scene


def test_describes(dataset, here, cli, capsys):
    assert cli("data --figure a/info.png --json i.json --info", dataset) == 0
    text = capsys.readouterr().out
    content = json.loads(Path("i.json").read_text())
    data = Dataset.load(dataset)
    assert content["command"].startswith("legibility data --figure ")
    assert content["seed"] == 0
    assert content["config"] == data.config.to_dict()
    result = content["result"]
    assert (result["scenes"], result["trajectories"]) == (4, 4 * 2 * 17)
    assert result["with_obstacles"] == 0
    assert sum(result["observers"].values()) == 4 * 2
    assert result["sha256"] == data.digest
    assert sum(result["goals"].values()) == 4
    assert sum(result["labels"]["counts"]) == 4 * 2 * 17
    assert result["coverage"]["mean"] == np.mean(data.summary["coverage"])
    assert "█" in text
    for setting in ("2..3", "observers", "detour", "anchored"):
        assert setting in text
    assert Path("a/info.png").read_bytes().startswith(b"\x89PNG")


def test_describing_writes_nothing_that_was_not_named(dataset, here, cli):
    before = sorted([*dataset.iterdir(), *here.iterdir()])
    assert cli("data --info", dataset) == 0
    assert sorted([*dataset.iterdir(), *here.iterdir()]) == before


@pytest.mark.parametrize("where", ["", "--cluster local"])
def test_same_bytes_from_the_same_command(where, dataset, data_flags, here, cli):
    if where:
        pytest.importorskip("distributed", reason="Dask is NOT TESTED: the extra is missing")
    line = f"data {data_flags} --workers 2 {where} --json d.json --out"
    assert cli(line, "again") == 0
    names = {file.name for file in dataset.iterdir()}
    assert names == {file.name for file in Path("again").iterdir()}
    for name in names:
        assert (dataset / name).read_bytes() == Path("again", name).read_bytes()
    assert json.loads(Path("d.json").read_text())["config"]["goals"] == [2, 3]
    assert cli(line, "again") == 0  # there already


def test_three_dimensions(here, cli):
    flags = (
        "--dim 3 --regime rooms --goals 3 --seed 5 --stream validation --views 1 --per-scene 9"
        " --cells 6 --candidates 4096 --alpha 2 --detour 2 --label rank"
    )
    assert cli(f"data --scenes 1 {flags} --out d --json d.json") == 0
    assert cli("data --info d --figure d.svg") == 0
    assert "<svg" in Path("d.svg").read_text()
    data = Dataset.load("d")
    assert data.config.observer.scale == (2, 2, "rank")
    assert data.observers == [data.config.observer]
    config = json.loads(Path("d.json").read_text())["config"]
    assert (config["dim"], config["regime"], config["stream"]) == (3, "rooms", "validation")


def test_obstacles_are_counted(here, cli):
    flags = "--regime obstacles --scenes 2 --views 1 --per-scene 3 --cells 6 --candidates 4096"
    assert cli(f"data {flags} --out d --json d.json") == 0
    assert json.loads(Path("d.json").read_text())["result"]["with_obstacles"] == 2


def test_a_given_scene(here, cli, capsys):
    flags = "--regime paper --views 1 --per-scene 9 --cells 6 --candidates 4096"
    assert cli(f"data --scenes scene.yaml {flags} --demonstrations 3 --out d --json d.json") == 0
    assert "given" in capsys.readouterr().out
    data = Dataset.load("d")
    given = Scene.load("scene.yaml")
    assert data.config.given == targets_of(given)
    assert data.config.goals == (2, 2)
    assert [scene.goals.tolist() for scene in data.scenes] == [
        given.goals.tolist(), given.goals[::-1].tolist()
    ]  # fmt: skip
    content = json.loads(Path("d.json").read_text())["config"]
    assert content["given"] == [scene.to_dict() for scene in targets_of(given)]
    assert cli("data --info d --figure d.svg") == 0
    assert cli(f"data --scenes solid.yaml {flags} --out e") == 0
    assert Dataset.load("e").config.dim == 3


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("--scenes none.yaml --out d", "none.yaml"),
        ("--scenes scene.yaml --info d", "leave the rest out"),
        ("--scenes scene.yaml --per-scene 2 --out d", "per_scene"),
        ("--scenes walled.yaml --out d", "walled.yaml: no curve was found to goals[1]"),
    ],
)
def test_refuses_a_given_scene(words, message, here, refused):
    wall = "obstacles:\n  - box: {center: [0.9, 0.5], size: [0.05, 1.2]}\n"
    Path("walled.yaml").write_text("start: [0, 0.5]\ngoals: [[0.5, 0.5], [1.0, 0.5]]\n" + wall)
    assert message in refused(f"data {words}")


def write_recordings(number=3):
    """Recorded motions in scene.yaml, with waves, rests and noise; returns the file's name."""
    scene, rng = Scene.load("scene.yaml"), np.random.default_rng(0)
    share = np.linspace(0, 1, 100)
    lines = ["trajectory,t,x,y"]
    for index in range(number):
        for target in (0, 1):
            along = scene.goals[target] - scene.start
            wave = rng.normal(0, 0.2) * np.sin(np.pi * share) + 0.03 * np.sin(3 * np.pi * share)
            points = scene.start + share[:, None] * along
            points += wave[:, None] * np.array([-along[1], along[0]])
            points = np.pad(points, ((50, 50), (0, 0)), "edge")
            points += rng.normal(0, 5e-4, points.shape)
            lines += [f"{index}-{target},{t / 100},{x},{y}" for t, (x, y) in enumerate(points)]
    Path("r.csv").write_text("\n".join(lines) + "\n")
    return "r.csv"


def test_recordings(here, cli, capsys):
    flags = "--regime dragan --views 1 --per-scene 8 --cells 6 --candidates 4096"
    line = f"data --from {write_recordings()} --scenes scene.yaml {flags}"
    assert cli(f"{line} --out d --json d.json") == 0
    output = capsys.readouterr().out
    assert "dial covered" in output
    content = json.loads(Path("d.json").read_text())
    assert content["config"]["recordings"] in output
    assert 0 < content["result"]["dial_coverage"]["min"] < 1
    data = Dataset.load("d")
    assert data.labels.shape == (2, 8)
    assert cli(f"{line} --mix 0.5 --out e --json e.json") == 0
    mixed = json.loads(Path("e.json").read_text())["result"]["dial_coverage"]
    assert mixed["min"] > content["result"]["dial_coverage"]["min"]
    assert cli("data --info d --figure d.svg") == 0


def test_recordings_are_trained_on(here, cli):
    """From recordings to a plan, with stage 2 of the shipped weights."""
    flags = "--regime dragan --views 1 --per-scene 8 --cells 6 --candidates 4096"
    assert cli(f"data --from {write_recordings()} --scenes scene.yaml {flags} --out d") == 0
    line = "train path --data d --out t --steps 2 --scenes 2 --per-scene 4 --channels 8 16"
    assert cli(f"{line} --policy block-reach-2d") == 0
    assert cli("execute scene.yaml --model t/weights --legibility 0.5") == 0


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("--from r.csv --out d", "--from needs --scenes FILE"),
        ("--from none.csv --scenes scene.yaml --out d", "cannot read the trajectory file"),
        ("--from r.csv --scenes solid.yaml --out d", "the scene is 3D: columns x, y, z"),
        ("--from r.csv --scenes none.yaml --out d", "cannot read the scene file"),
        ("--from r.csv --scenes scene.yaml --mix 2 --out d", "mix must be a number from 0 to 1"),
        ("--scenes scene.yaml --mix 0.5 --out d", "mix belongs to recordings"),
        ("--scenes 0 --out d", "scenes must be an integer of at least 1"),
    ],
)
def test_refuses_recordings(words, message, here, refused):
    write_recordings(1)
    assert message in refused(f"data {words}")
    assert not Path("d").exists()


@pytest.mark.parametrize("form", ["torch", "lerobot", "csv"])
def test_export(form, shown, here, cli, capsys):
    assert cli(f"data --export {form} --out a/b --data", shown) == 0
    written = capsys.readouterr().out.split()
    assert written
    assert sorted(written) == sorted(str(p) for p in Path("a/b").rglob("*") if p.is_file())


@pytest.mark.parametrize(
    "words",
    ["--export csv --out d", "--export csv --data d", "--data d --out e", "--export csv --data d"
     " --out e --seed 1", "--export csv --data d --out e --json j.json"],
)  # fmt: skip
def test_refuses_half_an_export(words, refused):
    assert "--export FORMAT needs --data DIR, the dataset, and --out DIR" in refused(
        f"data {words}"
    )


def test_refuses_an_export(dataset, refused):
    line = "data --export lerobot --out d --data"
    assert "has no demonstrations" in refused(line, dataset)
    assert "cannot read the dataset manifest" in refused(line, "nothing")
    Path("e").mkdir()
    Path("e/mine").write_text("mine")
    assert "it is there and not empty" in refused("data --export csv --out e --data", dataset)
