"""Sections say what was measured."""

import documents

from legibility.evaluation.comparison import EXTERNAL
from legibility.evaluation.contest import CANDIDATES, METHODS, OURS
from legibility.evaluation.controller import ROWS as DISTURBED
from legibility.evaluation.execution import ROWS
from legibility.report.comparisons import (
    external_section,
    single_scene_section,
    table1_section,
    unseen_section,
)
from legibility.report.sections import (
    ablations_section,
    controller_section,
    execution_section,
    spectrum_section,
    timing_section,
)
from legibility.report.table import Bold, Table


def text_of(section):
    return " ".join(part for part in section if isinstance(part, str))


def tables_of(section):
    return [part for part in section if isinstance(part, Table)]


def test_controller():
    section = controller_section(documents.controller())
    (table,) = tables_of(section)
    assert [row[0] for row in table.rows] == [row.text for row in DISTURBED.values()]
    assert table.rows[0][1:] == (
        "50", "98.00%", "0.0312", "–", "0.5 / 5.2 / 7.1", "–", "1.50", "0",
    )  # fmt: skip
    assert table.rows[1][4] == "0.5 / 5.2 / 7.1"
    assert table.rows[1][6] == "0.50"
    assert "a step each 40 ms, on one core by onnxruntime; planning has 3 ms" in text_of(section)


def test_timing():
    section = timing_section(documents.timing())
    (table,) = tables_of(section)
    assert table.rows[0] == ("greatest velocity over its limit", "0.500", "0.875", "0.938")
    assert "250 motions of panda at 5 levels" in text_of(section)
    assert "1 motions were refused, as the arm cannot follow their paths" in text_of(section)


class TestExecution:
    def test_every_row_is_there(self):
        (table,) = tables_of(execution_section(documents.execution()))
        assert [row[0] for row in table.rows] == [row.text for row in ROWS.values()]
        assert table.rows[0][1:] == (
            "100.00% (90.00% to 100.00%)", "99.50%", "0.9000", "0.0200", "0.12%", "12.5", "2.25",
            "25.00%", "0", "",
        )  # fmt: skip
        assert table.rows[1][-2:] == ("1,234", "1 stalled")
        assert table.rows[2][2:5] == ("–", "–", "–")

    def test_violations_are_those_of_all_rows(self):
        text, number = text_of(execution_section(documents.execution())), len(ROWS)
        assert f"{number} states outside the workspace, 0 actions that were not finite" in text
        assert f"{2 * number} actions over the limit, {3 * number} steps stopped" in text

    def test_conditions(self):
        text = text_of(execution_section(documents.execution()))
        assert "5,000 rollouts a row on 200 held-out random scenes with 2 to 6 goals" in text
        assert "half-way by 10 cm" in text
        assert "a correlation of 0.9700 and an error of 0.0100" in text

    def test_counts_of_an_arm(self):
        text = text_of(execution_section(documents.transfer()))
        assert "(at most 1.2 mm outside)" in text
        assert "undisturbed, had 0 table contacts, 2 self collisions." in text
        assert "in PandaGymBlockReach." in text


class TestAblations:
    def test_every_row_is_there(self):
        (table,) = tables_of(ablations_section(documents.ablations()))
        means = tuple(f"{0.5 + i / 100:.4f}" for i in range(7))
        cells = (*means, "0.2500", "7.2")
        assert table.rows == [("row a", *cells), ("row b", *cells)]

    def test_conditions(self):
        text = text_of(ablations_section(documents.ablations()))
        assert "50 held-out random scenes with 2 to 6 goals (seed 7)" in text
        assert "only 3,000 training steps" in text


class TestTable1:
    def test_every_method_is_there(self):
        table, _, others, by_others, _ = tables_of(table1_section(documents.table1()))
        names = [method.text for method in METHODS.values()]
        assert [row[0] for row in table.rows] == [*names, "Dataset Oracle, the curve itself"]
        assert [row[0] for row in others.rows] == names
        assert others.rows[0][1:] == ("1.500", "1.500", "1.500", "1.500", "1.2", "30.0")
        assert others.rows[-1][-2:] == ("–", "–")
        assert [row[0] for row in by_others.rows] == names
        assert by_others.rows[0][1:] == ("1.500",) * len(EXTERNAL)
        assert "time to confidence" in others.columns

    def test_what_can_be_compared_is_beside_the_papers(self):
        section = table1_section(documents.table1())
        rows = {row[0]: row for row in tables_of(section)[1].rows}
        assert rows[METHODS["modulator"].text][1:3] == ("1.50 (0.50)", "1.96 (0.97)")
        assert METHODS["straight line"].text not in rows
        assert "Toward G it gives 1.50 where the paper has 0.252" in text_of(section)
        arm = documents.table1()
        arm["result"]["scene"]["start"] = [0, 0, 0]
        section = table1_section(arm)
        assert not any("L_p" in column for column in tables_of(section)[1].columns)
        assert "scene of the arm is unknown" in text_of(section)

    def test_cells(self):
        rows = {row[0]: row for row in tables_of(table1_section(documents.table1()))[0].rows}
        ours = rows[METHODS["modulator"].text]
        assert ours[1:3] == ("99.96%", "1.50 (0.50)")
        bold = {text for text, row in rows.items() if isinstance(row[2], Bold)}
        assert bold == {METHODS[name].text for name in OURS}  # search is worse, others not shown

    def test_tests(self):
        table = tables_of(table1_section(documents.table1()))[-1]
        assert len(table.rows) == len(OURS) * (len(METHODS) - len(OURS))
        assert table.rows[0][:2] == ("network alone", "straight line")
        assert table.rows[0][2] == "better, +0.50, p < 0.001"
        assert table.rows[-1][0] == f"best of {CANDIDATES}"

    def test_worse_is_bold(self):
        document = documents.table1()
        for test in document["result"]["tests"]:
            test["effect"] = -0.25
        verdict = tables_of(table1_section(document))[-1].rows[0][2]
        assert verdict == "worse, −0.25, p < 0.001"
        assert isinstance(verdict, Bold)


def test_external():
    table, bounded = tables_of(external_section(documents.external()))
    assert table.rows[0][0] == "the shortest motion"
    assert table.rows[-1][1] == "0.125"
    assert bounded.rows[0][1:4] == ("0.750 (50%)", "–", "0.875")
    document = documents.external()
    document["result"]["methods"]["yours"] = document["result"]["methods"]["search"]
    text = text_of(external_section(document))
    assert text.startswith("A given scene; ")
    assert "your trajectories" in [row[0] for row in tables_of(external_section(document))[1].rows]


def test_single_scene():
    table, chosen, tests = tables_of(single_scene_section(documents.single_scene()))
    assert table.rows[-1][2] == "3.00 (1.00)"
    assert table.rows[0][0] == "straight line"
    assert chosen.rows[0] == (
        "Legibility Diffuser, tuned for L_d",
        "R",
        "guidance 25, guidance decay 0.8",
        "7",
    )
    assert [row[0] for row in tests.rows] == ["network alone"] * 4 + ["one path"] * 4


def test_unseen():
    section = unseen_section(documents.unseen())
    table, by_others, _ = tables_of(section)
    assert by_others.rows[0][1:] == ("0.125",) * len(EXTERNAL)
    rows = {row[0]: row[1:] for row in table.rows}
    assert list(rows) == [method.text for method in METHODS.values()]
    ratio = "0.250 (0.125 to 0.500)"
    assert rows["Diffusion Policy"] == ("75.00%", ratio, ratio, "1.500", "0.500", "–", "–")
    assert rows["Legibility Modulator"][1:3] == (ratio, ratio)
    assert all(isinstance(cell, Bold) for cell in rows["Legibility Modulator"][1:3])
    assert not isinstance(rows["Diffusion Policy"][1], Bold)
    assert rows["Legibility Modulator"][-2:] == ("0.8750", "0.0625")
    assert "10 held-out random scenes with 2 to 6 goals (seed 7)" in text_of(section)


def test_spectrum():
    section = spectrum_section(documents.spectrum())
    assert "toward R L_p rises at 0 of 2 steps of ℓ, with 100.00% success" in text_of(section)
    (table,) = tables_of(section)
    assert table.rows[0] == ("-1.00", "3.00", "-1.000", "3.00", "-1.000")
    rising = text_of(spectrum_section(documents.spectrum(rising=1)))
    assert "rises at 1 of 2 steps" in rising
