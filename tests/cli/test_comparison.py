"""The baselines are trained, compared and reported by the commands that the README names."""

import json

import pytest

from legibility.evaluation.comparison import METHODS
from legibility.models.pretrained import load_stages

pytestmark = pytest.mark.usefixtures("coarsely")


@pytest.fixture(scope="module")
def baselines(dataset, shown, cli, tmp_path_factory, one_thread):
    """Folders of tiny weights by the name of the verb that trains them."""
    folder = tmp_path_factory.mktemp("baselines")
    small = (
        "--steps 20 --batch 16 --warmup 1 --validate-every 20 --checkpoint-every 20"
        " --channels 8 16 --condition 16 --sampling-steps 2"
    )
    with pytest.MonkeyPatch.context() as patch:
        tried = {"guidance": (2.0, 5.0), "guidance_decay": (0.5,), "guidance_share": (0.9, 1.0)}
        patch.setattr("legibility.training.policy.GUIDANCE", tried)
        found = {}
        for verb in ("diffusion-policy", "legibility-diffuser"):
            found[verb] = folder / f"{verb}-tiny"
            paths = ["--data", shown, "--validation", dataset, "--out", folder / "runs" / verb]
            report = ["--weights", found[verb], "--json", folder / f"{verb}.json"]
            assert cli(f"train {verb} {small}", *paths, *report) == 0
    return found


def test_weights(baselines):
    plain, guided = (load_stages(folder) for folder in baselines.values())
    assert plain[0]["goal"].config.guidance == 0
    assert plain[1]["goal"].training["dropout"] == 0
    assert guided[1]["goal"].training["dropout"] == 0.2
    plain_report, report = (
        json.loads((baselines["diffusion-policy"].parent / f"{verb}.json").read_text())
        for verb in baselines
    )
    assert "tuning" not in plain_report["result"]
    tuning = report["result"]["tuning"]
    assert len(tuning) == 4
    assert {row["guidance"] for row in tuning} == {2.0, 5.0}
    config = guided[0]["goal"].config
    best = max(row["success"] for row in tuning)
    chosen = [
        row for row in tuning
        if (row["guidance"], row["guidance_share"]) == (config.guidance, config.guidance_share)
    ]  # fmt: skip
    assert chosen[0]["success"] >= min(0.99, best)
    assert report["result"]["last"]["step"] == 20
    assert set(report["model"]) == {"name", "goal", "settings"}


@pytest.fixture(scope="module")
def measured(baselines, cli, tmp_path_factory, one_thread):
    """Results of the comparisons."""
    folder = tmp_path_factory.mktemp("compared")
    models = [x for name, path in baselines.items() for x in (f"--{name}", path)]
    common = "--env 2d --seed 1 --search-candidates 64"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("legibility.evaluation.contest._TIMED", 1)
        for words in (
            f"table1 {common} --rollouts 2",
            f"unseen {common} --scenes 2 --rollouts 1 --levels 3",
        ):
            file = folder / "results" / f"{words.split()[0]}-2d.json"
            assert cli(f"evaluate {words} --json", file, *models) == 0
    file = folder / "results" / "spectrum-2d.json"
    words = "evaluate spectrum --levels 3 --rollouts 2 --json"
    assert cli(words, file, "--figure", folder / "spectrum.svg") == 0
    return folder


def test_what_is_written(measured, baselines):
    assert "<svg" in (measured / "spectrum.svg").read_text()
    for kind in ("table1", "unseen"):
        content = json.loads((measured / "results" / f"{kind}-2d.json").read_text())
        assert content["model"]["name"] == "block-reach-2d"
        assert [b["name"] for b in content["baselines"]] == [str(p) for p in baselines.values()]
        assert set(content["result"]["methods"]) == set(METHODS)
        assert content["config"]["search_candidates"] == 64


def test_report(measured, cli, capsys):
    results, page = measured / "results", measured / "docs" / "results.md"
    files = ["--out", page, "--pictures", results, "--tables", measured / "tables"]
    assert cli("report", results, *files) == 0
    page = page.read_text()
    for kind in ("table1", "unseen", "spectrum"):
        assert f"Measured by `legibility evaluate {kind} " in page
    assert (
        (measured / "tables" / "table1-2d-1.csv").read_text().startswith("method,success,target R")
    )
    assert r"\multicolumn{2}{c}{target R}" in (measured / "tables" / "table1-2d-1.tex").read_text()
    assert (measured / "results" / "spectrum-2d.png").read_bytes().startswith(b"\x89PNG")
    assert (measured / "tables" / "spectrum-2d.pdf").read_bytes().startswith(b"%PDF")
    capsys.readouterr()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("table1 --env 4d", "env must be one of"),
        ("table1 --rollouts 1", "rollouts must be"),
        ("table1 --diffusion-policy none", "there are no weights 'none'"),
        ("table1 --diffusion-policy block-reach-2d", "has no goal-conditioned policy"),
        ("table1 --model panda-block-reach", "the model or scene 3-D"),
        ("table1 --method nowhere:plan", "there is no module nowhere in"),
        ("unseen --method scene.yaml:plan", "there is no module scene in"),
        ("unseen --method plan", "method must be MODULE:NAME or FILE.py:NAME, got 'plan'"),
        ("unseen --scenes 1", "scenes must be"),
        ("unseen --goals 1..2", "goals must be"),
        ("spectrum --levels 2", "levels must be"),
        ("spectrum --model none", "there are no weights 'none'"),
        ("spectrum --figure f.bmp", "must end in"),
    ],
)
def test_refuses(words, message, refused, baselines):
    models = [
        x for name, path in baselines.items() for x in (f"--{name}", path)
        if not words.startswith("spectrum") and f"--{name}" not in words
    ]  # fmt: skip
    assert message in refused(f"evaluate {words}", *models)
