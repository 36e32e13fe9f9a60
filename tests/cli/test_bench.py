"""The bench runs, and what it says of itself holds together."""

import json

import pytest

from legibility.evaluation import bench
from legibility.evaluation.bench_table import bench_section

TINY = (
    "bench --model block-reach-2d --seconds 0.001 --rounds 2 --threads 1 --batches 1 2 --goals 2 3"
    " --candidates 2 3 --scenes 1 2 --robots 2 --curves 512 1024 --dataset 1"
    " --training-steps 1 --published 1 --published-steps 1 --json"
)
PROCESS = {"seconds": {"above": 1.0, "plan 1": 0.1}, "megabytes": {"plan 1": 20.0}}


@pytest.fixture(scope="module")
def folder(cli, tmp_path_factory, one_thread):
    """With bench-cpu.json, in which the measurements of fresh processes are made up."""
    folder = tmp_path_factory.mktemp("bench")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bench, "footprint", lambda *args, **options: PROCESS)
        patch.setattr(bench, "import_seconds", lambda: 0.1)
        assert cli(TINY, folder / "bench-cpu.json") == 0
    return folder


@pytest.fixture(scope="module")
def document(folder):
    return json.loads((folder / "bench-cpu.json").read_text())


def figures(value):
    if isinstance(value, dict):
        if "median" in value:
            yield value
        for part in value.values():
            yield from figures(part)


def test_every_figure_lies_in_its_interval(document):
    found = list(figures(document["result"]))
    assert len(found) > 40
    for figure in found:
        low, high = figure["interval"]
        assert 0 < low <= figure["median"] <= high
        assert figure["calls"] >= 1


def test_what_is_measured(document):
    result = document["result"]
    assert document["model"]["name"] == "block-reach-2d"
    assert document["config"]["weights"] == [document["model"]]
    assert result["machine"]["threads"] == 1
    model = result["models"]["block-reach-2d"]
    assert set(model["backends"]) | set(result["skipped"]) >= {"torch", "onnx"}
    for own in model["backends"].values():
        assert list(own["growth"]) == ["batch", "goals", "candidates", "scenes"]
        for axis in own["growth"].values():
            assert len(axis["ms"]) == 2
            assert isinstance(axis["exponent"], float)
        assert own["step_ms"]["median"] > 0
        assert own["rollouts_per_second"]["median"] > 0
        assert own["process"]["megabytes"]["plan 1"]["median"] == 20
    for kind in ("archive", "dataset", "training"):
        assert list(result[kind]) == ["2"]
    assert result["dataset"]["2"]["growth"]["exponent"] is None
    assert result["training"]["2"]["batch"] == 1024
    assert list(result["archive"]["2"]["growth"]["ms"]) == ["512", "1024"]


def test_ratios_hold_together(document):
    result = document["result"]
    published = result["published"]
    assert 72.5e6 < published["parameters"]["unet"] < 72.7e6
    fastest, slowest = published["plan_ms"]["1"]["interval"]
    assert list(published["ratio"]) == ["block-reach-2d"]
    for backend, ratios in published["ratio"]["block-reach-2d"].items():
        low, high = published["ours_ms"]["block-reach-2d"][backend]["1"]["interval"]
        least, most = ratios["1"]["interval"]
        assert fastest / high * (1 - 1e-9) <= least <= most <= slowest / low * (1 + 1e-9)
    for model in result["models"].values():
        for own in model["backends"].values():
            for batch, floor in model["floor"].items():
                plan = own["growth"]["batch"]["ms"][batch]["median"]
                assert own["paths_per_second"][batch] == pytest.approx(1e3 * int(batch) / plan)
                drawn = own["draw_ms"][batch]["median"]
                assert own["over_floor"][batch] == pytest.approx(drawn / floor["ms"])


def test_report(folder, document, cli, capsys):
    page = folder / "page.md"
    page.write_text("<!-- bench-cpu -->\n<!-- /bench-cpu -->\n")
    assert cli("report", folder, "--readme", page) == 0
    section = bench_section(document)
    assert page.read_text() == f"<!-- bench-cpu -->\n{section}\n<!-- /bench-cpu -->\n"
    assert "| paths | published [ms] | ours | backend | ours [ms] | times faster |" in section
    assert f"Measured by `{document['command']}`." in section
    assert section in capsys.readouterr().out


def test_a_backend_that_is_missing_is_named(document):
    result = {**document["result"], "skipped": {"onnx": "not installed"}}
    assert "Left out: onnx: not installed." in bench_section({**document, "result": result})


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        ("--seconds 0", "seconds must be"),
        ("--rounds 0", "rounds must be"),
        ("--threads 0", "threads must be"),
        ("--robots 0", "robots must be"),
        ("--batches 16 1", "batches must be numbers that rise"),
        ("--batches 0 1", "batches must be"),
        ("--goals 1 2", "goals must be from 2 to 12"),
        ("--published 16 1", "published must be numbers that rise"),
        ("--published-steps 101", "published_steps must be at most 100"),
        ("--device nothing", "device 'nothing' cannot be used here"),
        ("--model none", "there are no weights 'none'"),
        ("--model", "model must be at least one name"),
        ("--json scene.yaml/j.json", "cannot write"),
    ],
)
def test_refuses(flags, message, refused):
    assert message in refused(f"bench {flags}")
