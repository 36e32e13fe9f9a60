"""The bench runs, and its rows are complete."""

import functools
import json
from collections import Counter

import pytest

from legibility.bench import measure
from legibility.report.sections import bench_section
from legibility.report.table import Table, markdown
from legibility.training.configuration import PathTrainingConfig

pytestmark = pytest.mark.usefixtures("coarsely")

TINY = (
    "bench --model block-reach-2d --seconds 0.001 --rounds 1 --threads 1 --batches 1 2 --goals 2 4"
    " --robots 2 --dataset 1 --training-steps 1 --json"
)


@pytest.fixture(scope="module")
def folder(cli, tmp_path_factory, one_thread):
    """Where the bench has written its report, of few scenes and small batches."""
    folder = tmp_path_factory.mktemp("bench")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(measure, "_SCENES", 6)
        small = functools.partial(PathTrainingConfig, scenes=4, per_scene=4)
        patch.setattr(measure, "PathTrainingConfig", small)
        for made in (measure._scenes, measure._scenes_with_obstacles):
            made.cache_clear()
        assert cli(TINY, folder / "bench-cpu.json") == 0
        for made in (measure._scenes, measure._scenes_with_obstacles):
            made.cache_clear()
    return folder


@pytest.fixture(scope="module")
def document(folder):
    return json.loads((folder / "bench-cpu.json").read_text())


def test_rows(document):
    result = document["result"]
    assert document["config"]["weights"] == [document["model"]]
    assert document["model"]["name"] == "block-reach-2d"
    assert result["machine"]["threads"] == 1
    assert result["machine"]["cpu"]
    measurements = result["measurements"]
    for row in measurements:
        assert 0 < row["low"] <= row["median"] <= row["high"]
        assert row["calls"] >= 1
    backends = {row["backend"] for row in measurements if "backend" in row}
    assert backends == ({"torch"} if result["skipped"] else {"torch", "onnx"})
    count = Counter(row["metric"] for row in measurements)
    count.pop("memory_mb", None)
    of_models = {
        "plan_ms": 3, "plan_one_core_ms": 1, "plan_obstacles_ms": 3, "control_step_ms": 1,
        "rollouts_per_second": 1, "load_ms": 1, "first_plan_ms": 1,
    }  # fmt: skip
    of_dims = {
        "archive_ms": 1, "candidates_per_second": 1, "scenes_per_second": 1,
        "training_steps_per_second": 2, "import_ms": 1,
    }  # fmt: skip
    assert count == {m: n * len(backends) for m, n in of_models.items()} | of_dims
    assert all(row["dim"] == 2 for row in measurements if "dim" in row)


def test_report(folder, document, cli, capsys):
    assert cli("report", folder, "--out", folder / "page.md") == 0
    section = bench_section(document)
    assert markdown(section) in (folder / "page.md").read_text()
    assert all(part.rows for part in section if isinstance(part, Table))
    capsys.readouterr()


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        ("--seconds 0", "seconds must be"),
        ("--batches 16 1", "batches must be increasing numbers"),
        ("--device nothing", "device 'nothing' cannot be used here"),
        ("--model none", "there are no weights 'none'"),
        ("--model", "model must be at least one name"),
        ("--json scene.yaml/j.json", "cannot write"),
    ],
)
def test_refuses(flags, message, refused):
    assert message in refused(f"bench {flags}")
