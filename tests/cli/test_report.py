import shutil
from pathlib import Path

import pytest

EVALUATE = "evaluate dial --scenes 2 --seed 1 --levels 5 --samples 2 --candidates 2"


@pytest.fixture
def results(here, weights, cli):
    """A measurement of the tiny model in results/, its weights in models/tiny, and a page."""
    assert cli(f"{EVALUATE} --json results/dial-tiny.json --model", weights) == 0
    shutil.copytree(weights, here / "models" / "tiny")
    (here / "page.md").write_text("before\n<!-- dial-tiny -->\nold\n<!-- /dial-tiny -->\nafter\n")
    return here


def test_report(results, cli, capsys):
    assert cli("report results --readme page.md --weights models") == 0
    table = Path("results/dial-tiny.md").read_text().strip()
    assert "| Spearman correlation of asked and achieved ℓ | " in table
    assert "2 random scenes with 2 to 6 goals" in table
    assert "Measured by `legibility evaluate dial" in table
    page = Path("page.md").read_text()
    assert page == f"before\n<!-- dial-tiny -->\n{table}\n<!-- /dial-tiny -->\nafter\n"
    card = Path("models/tiny/README.md").read_text()
    assert table in card
    assert "4 random scenes with 2 to 3 goals" in card
    assert Path("results/dial-tiny.png").read_bytes().startswith(b"\x89PNG")
    assert table in capsys.readouterr().out
    assert cli("report results --readme page.md") == 0
    assert Path("page.md").read_text() == page


def test_page_without_a_place_for_the_table(results, refused, capsys):
    Path("page.md").write_text("nothing\n")
    capsys.readouterr()
    assert "<!-- dial-tiny -->" in refused("report results --readme page.md")


def test_no_results(here, refused):
    assert "dial-*.json" in refused("report .")


@pytest.mark.parametrize("content", ["", "[1]", "{}", '{"result": {}}'])
def test_broken_results(content, here, refused):
    Path("dial-x.json").write_text(content)
    refused("report .")
