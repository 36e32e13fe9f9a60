"""The page shows every result, and the headline only what was measured."""

import json
import re

import documents
import pytest

from legibility.errors import InvalidInputError
from legibility.evaluation.configuration import EVALUATED
from legibility.report.results import KINDS, headline_table, read_results, render_page

ALL = {
    "dial": documents.dial(), "closed-loop": documents.dial(True), "eyes": documents.eyes(),
    "planning": documents.planning(), "optimum": documents.optimum(),
    "execution": documents.execution(), "transfer": documents.transfer(),
    "table1": documents.table1(), "unseen": documents.unseen(), "spectrum": documents.spectrum(),
    "ablations": documents.ablations(), "single-scene": documents.single_scene(),
    "external": documents.external(), "timing": documents.timing(),
    "controller": documents.controller(),
}  # fmt: skip


@pytest.fixture
def results():
    return {kind: {"m": document} for kind, document in ALL.items()} | {
        "bench": {"cpu": documents.bench()}
    }


def test_page_is_complete_and_tidy(results):
    page = render_page(results, "../results")
    assert set(ALL) | {"bench"} == set(KINDS)
    for kind, (title, _, picture) in KINDS.items():
        (name, document), *_ = results[kind].items()
        assert f"### {title}: {name}\n\n" in page
        assert f"Measured by `{document['command']}`." in page
        assert (f"(../results/{kind}-{name}.png)" in page) == bool(picture)
    assert page.endswith("\n")
    assert "\n\n\n" not in page
    assert not re.search(r"[ \t]+$", page, re.MULTILINE)
    for line in page.splitlines():
        assert len(line) <= 100 or line.startswith(("|", "!", "Measured"))


def test_page_without_some_kinds(results):
    page = render_page({"dial": results["dial"]}, "../results")
    assert "## Execution" not in page
    assert "| mean absolute error of ℓ |" not in page  # the headline is of the shipped models


def test_regimes_stand_side_by_side(results):
    results["dial"] = {f"m-{r}": documents.dial(regime=r) for r in EVALUATED}
    page = render_page(results, "../results")
    assert "## Regimes: m\n\n| regime | mode |" in page
    for regime in EVALUATED:
        assert page.count(f"\n| {regime} | exact | ") == 2


def test_headline(results):
    results["dial"] = {f"m-{r}": documents.dial(regime=r) for r in EVALUATED}
    results["execution"] |= {"m-obstacles": documents.execution()}
    table = headline_table(results, {"m": "ours", "n": "theirs"})
    rows = {row[0]: row[1:] for row in table.rows}
    overall = documents.dial()["result"]["overall"]
    assert rows["mean absolute error of ℓ"] == (f"{overall['quick']['error']['mean']:.4f}", "–")
    assert rows["the same, exact"] == (f"{overall['exact']['error']['mean']:.4f}", "–")
    assert rows["any room, any observer, obstacles: Spearman correlation"][0] == (
        f"{overall['quick']['spearman']['mean']:.4f}"
    )
    assert rows["success of executed motions"] == ("100.00%", "–")
    assert rows["the same, past obstacles"] == ("100.00%", "–")
    assert rows["one plan on one core, PyTorch / ONNX [ms]"] == ("– / 0.500", "– / –")


def test_headline_leaves_out_what_was_not_measured(results):
    del results["bench"], results["execution"]
    texts = [row[0] for row in headline_table(results, {"m": "ours"}).rows]
    assert texts == ["error of ℓ of the executed motion"]
    assert not any("plan on one core" in text or "success" in text for text in texts)


def test_read(tmp_path):
    (tmp_path / "dial-a-b.json").write_text(json.dumps(ALL["dial"]))
    (tmp_path / "tuning-x.json").write_text("{}")
    (tmp_path / "paper-scene.json").write_text("no JSON")
    assert read_results(tmp_path) == {"dial": {"a-b": ALL["dial"]}, "tuning": {"x": {}}}


def test_nothing_to_read(tmp_path):
    (tmp_path / "tuning-x.json").write_text("{}")
    with pytest.raises(InvalidInputError, match=r"there is no dial-\*\.json or"):
        read_results(tmp_path)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("other", KINDS)
def test_other_kinds_are_refused(kind, other, results):
    (document,) = results[other].values()
    alike = [{"execution", "transfer"}, {kind}]
    if {kind, other} in alike:
        return
    with pytest.raises(InvalidInputError, match=f"{kind}-x.json is not a result of the kind"):
        render_page({kind: {"x": document}}, "")
