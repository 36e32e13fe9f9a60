"""Sections of the dial say what was measured, beside its limit."""

import documents
import pytest

from legibility.evaluation.configuration import EVALUATED, MODES
from legibility.evaluation.dial import METRICS
from legibility.evaluation.eyes import EYES
from legibility.report.dials import REGIMES, dial_section, eyes_section, regimes_tables
from legibility.report.table import Table


def text_of(section):
    return " ".join(part for part in section if isinstance(part, str))


def tables_of(section):
    return [part for part in section if isinstance(part, Table)]


class TestDial:
    @pytest.mark.parametrize("closed_loop", [False, True])
    def test_every_metric_is_there(self, closed_loop):
        document = documents.dial(closed_loop)
        section = dial_section(document)
        (table,) = tables_of(section)
        quick = document["result"]["overall"]["quick"]
        assert [row[0] for row in table.rows] == [METRICS[n] for n in METRICS if n in quick]
        first = table.columns.index("quick: mean")
        for row, name in zip(table.rows, quick, strict=True):
            values = quick[name]
            assert row[first] == f"{values['mean']:.4f}"
            assert row[first + 1] == "{:.4f} to {:.4f}".format(*values["interval"])
            assert row[first + 2] == f"{values['min']:.4f} to {values['max']:.4f}"
        text = text_of(section)
        assert "3 held-out random scenes with 2 to 6 goals (seed 7)" in text
        assert REGIMES["dragan"] in text
        assert ("Stage 2 executes" in text) == closed_loop

    def test_other_modes_and_limits_stand_beside(self):
        document = documents.dial()
        (table,) = tables_of(dial_section(document))
        rows = {row[0]: row for row in table.rows}
        overall = document["result"]["overall"]
        for mode in MODES:
            column = table.columns.index(f"{mode}: mean")
            assert rows[METRICS["error"]][column] == f"{overall[mode]['error']['mean']:.4f}"
        assert rows[METRICS["error"]][-1] == f"{overall['limits']['noise']['mean']:.4f}"
        assert rows[METRICS["waves"]][-1] == f"{overall['limits']['waves']['mean']:.4f}"
        assert rows[METRICS["spread"]][-1] == ""
        assert rows[METRICS["error_candidates"]][1] == "–"

    def test_ranges(self):
        assert (
            "spans 0.281 nats below ℓ = 0 (at least 0.180) and 0.291 nats above ℓ = 0 "
            "(at least 0.190)"
        ) in text_of(dial_section(documents.dial()))

    def test_degenerate_scenes_are_apart(self):
        document = documents.dial()
        assert len(tables_of(dial_section(document))) == 1
        document["result"]["degenerate"] = document["result"]["overall"] | {"scenes": 1}
        _, table = tables_of(dial_section(document))
        assert [row[0] for row in table.rows] == ["the others (3)", "a side below 0.05 nats (1)"]
        document["result"]["sound"] = None
        assert len(tables_of(dial_section(document))[-1].rows) == 1

    def test_one_number_of_goals(self):
        document = documents.dial()
        document["config"]["goals"] = [4, 4]
        assert "scenes with 4 goals" in text_of(dial_section(document))

    def test_rooms_have_any_number_of_goals(self):
        assert "3 held-out random scenes (seed 7)" in text_of(
            dial_section(documents.dial(regime="all"))
        )


def test_every_regime_is_named():
    assert tuple(REGIMES) == EVALUATED


def test_regimes():
    tables = regimes_tables({r: documents.dial(regime=r) for r in reversed(EVALUATED)})
    for table in tables:
        assert [row[:2] for row in table.rows] == [(r, m) for r in EVALUATED for m in MODES]
    labels, shapes = (dict(zip(t.columns, t.rows[1], strict=True)) for t in tables)
    overall = documents.dial()["result"]["overall"]
    assert labels["Spearman: mean"] == f"{overall['quick']['spearman']['mean']:.4f}"
    assert labels["Spearman: limit"] == f"{overall['limits']['spearman']['mean']:.4f}"
    assert labels["error of ℓ: limit"] == f"{overall['limits']['noise']['mean']:.4f}"
    assert labels["worst scene at ±1"] == f"{-overall['quick']['at_-1']['max']:.3f}"
    assert shapes["feasible"] == f"{overall['quick']['feasible']['mean']:.2%}"
    assert shapes["of the optimum"] == f"{overall['quick']['optimum']['median']:.2f}"


def test_regimes_that_were_not_measured():
    assert [len(table.rows) for table in regimes_tables({"all": documents.dial()})] == [3, 3]


def test_eyes():
    section = eyes_section(documents.eyes())
    scores, posteriors = tables_of(section)
    assert [row[0] for row in scores.rows] == list(EYES.values())
    assert scores.rows[0][1:] == ("1.000", "0.500", "0.500", "0.500", "0.500", "87.50%")
    assert posteriors.rows[0][1:3] == ("0.250", "0.250")
    assert "11 levels of ℓ, 4 samples of each, quick plans" in text_of(section)
