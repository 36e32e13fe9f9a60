"""One table in four forms, each of which says the same."""

import csv
import io

import pytest
from rich.console import Console

from legibility.report.table import Bold, Table, markdown, number, significant, three_digits


@pytest.fixture
def table():
    table = Table("method", "target R: L_d ↑", "target R: paper", title="Table")
    table.add_row("ours, 50%", Bold("1.5"), "−1")
    table.add_section()
    table.add_row("a_b | [c] & d", "2.5", "–")
    return table


def test_markdown(table):
    assert table.markdown() == (
        "**Table**\n\n"
        "| method | target R: L_d ↑ | target R: paper |\n"
        "| --- | ---: | ---: |\n"
        "| ours, 50% | **1.5** | −1 |\n"
        "| a_b ∣ [c] & d | 2.5 | – |"
    )


def test_latex(table):
    assert table.latex("made by x").splitlines() == [
        "% made by x",
        r"\begin{tabular}{lrr}",
        r"\toprule",
        r"\multicolumn{1}{c}{} & \multicolumn{2}{c}{target R} \\",
        r"\cmidrule(lr){2-3}",
        r"method & \(L_d\) \(\uparrow\) & paper \\",
        r"\midrule",
        r"ours, 50\% & \textbf{1.5} & \(-\)1 \\",
        r"a\_b | [c] \& d & 2.5 & -- \\",
        r"\bottomrule",
        r"\end{tabular}",
    ]


def test_latex_without_groups_has_one_head():
    table = Table("a", "b")
    table.add_row("1", "2")
    assert r"\cmidrule" not in table.latex()
    assert table.latex().count(r"\\") == 2


def test_csv(table):
    assert list(csv.reader(io.StringIO(table.csv()))) == [
        ["method", "target R: L_d ↑", "target R: paper"],
        ["ours, 50%", "1.5", "−1"],
        ["a_b | [c] & d", "2.5", "–"],
    ]


def test_terminal_shows_cells_as_they_are(table):
    console = Console(file=io.StringIO(), width=100)
    console.print(table.rich())
    text = console.file.getvalue()
    for words in ("Table", "target R: L_d ↑", "ours, 50%", "1.5", "a_b | [c] & d"):
        assert words in text


def test_terminal_without_heads():
    table = Table("", "")
    table.add_row("a", "b")
    console = Console(file=io.StringIO(), width=100)
    console.print(table.rich())
    assert len(console.file.getvalue().splitlines()) == 3


def test_rows_have_a_cell_for_each_column(table):
    with pytest.raises(AssertionError):
        table.add_row("one")


def test_paragraphs_are_filled():
    text = markdown(["word " * 50, Table("a")])
    paragraph, table = text.split("\n\n")
    assert max(map(len, paragraph.splitlines())) <= 100
    assert table == "| a |\n| --- |"


def test_numbers():
    assert [number(x, 2) for x in (-0.001, 0.005, -1.5)] == ["0.00", "0.01", "-1.50"]
    assert [significant(x) for x in (0.01234, 1.2345, float("inf"), float("nan"), 0.0)] == [
        "0.0123", "1.234", "never", "–", "0.000"
    ]  # fmt: skip
    assert [three_digits(x) for x in (0.001234, 0.5, 99.96, 1234.5, 0.0)] == [
        "1.23e-03", "0.500", "100", "1,234", "0.00"
    ]  # fmt: skip


def test_no_line_of_a_paragraph_begins_a_list():
    text = markdown(["word " * 18 + "counts as 1. The rest follows."])
    assert text.splitlines()[1] == "as 1. The rest follows."
