"""What is rendered says what was measured, and only of the weights that it is about."""

import copy
import re

import pytest

from legibility.errors import InvalidInputError
from legibility.evaluation.dial import FIGURES
from legibility.evaluation.distilled_table import distilled_section
from legibility.evaluation.execution import ROWS
from legibility.report.card import (
    ablations_section,
    dial_section,
    execution_section,
    render_card,
    replace_table,
)

MODEL = {"name": "m", "path": "a" * 64, "policy": "b" * 64}


def figure(mean):
    return {"mean": mean, "interval": [mean - 0.01, mean + 0.01], "min": mean - 0.1, "max": mean}


def dial(closed_loop=False):
    only = {"success", "deviation"} if closed_loop else {"error_candidates", "drawn_inside"}
    names = [n for n in FIGURES if n in only or n not in
             {"success", "deviation", "error_candidates", "drawn_inside"}]  # fmt: skip
    return {
        "command": "legibility evaluate dial --scenes 3", "seed": 7, "model": MODEL,
        "config": {"goals": [2, 6], "samples": 8, "candidates": 16, "closed_loop": closed_loop},
        "result": {**({"env": "BlockReach2D"} if closed_loop else {}),
                   "overall": {name: figure(0.5 + i / 100) for i, name in enumerate(names)},
                   "levels": [-1, 0, 1], "plan_ms": 7.25, "scenes": [{}, {}, {}]},
    }  # fmt: skip


def execution():
    rows = {}
    for number, name in enumerate(ROWS):
        rows[name] = {
            "success": {"mean": 1 - number / 1000, "interval": (0.9, 1.0)},
            "reasons": {"reached": 5000 - number, "stalled": number} if number else
            {"reached": 5000},
            "within_5_cm": 0.995, "spearman_of_plan": figure(0.97), "error_of_plan": figure(0.01),
            "counts": {}, "farthest_outside": -0.001,
            "spearman": figure(0.9), "error": figure(0.02), "deviation": figure(0.0012),
            "replanned": 0.25, "states_outside": 1, "actions_not_finite": 0,
            "actions_over_limit": 2, "wall_contacts": 3,
        }  # fmt: skip
    for key in ("spearman", "error", "within_5_cm"):
        del rows["policy, goal moved"][key]
    return {
        "command": "legibility evaluate execution --seed 7", "seed": 7, "model": MODEL,
        "config": {"rollouts": 5000, "scenes": 200, "goals": [2, 6], "disturbance": None},
        "result": {"rows": rows, "step_ms": 0.876, "rollouts_per_second": 321.4, "at_once": 256,
                   "threads": 2, "env": "BlockReach2D", "disturbance": 0.1,
                   "env_steps_per_second": 4321.0},
    }  # fmt: skip


def transfer():
    document = execution()
    document["result"]["env"] = "PandaGymBlockReach"
    for number, row in enumerate(document["result"]["rows"].values()):
        row |= {"counts": {"table_contacts": number, "self_collisions": 2},
                "farthest_outside": 0.0012}  # fmt: skip
    return document


def ablations():
    names = ("spearman", "error", "at_1", "at_-1", "at_0", "length_ratio_at_0")
    overall = {name: figure(0.5 + i / 100) for i, name in enumerate(names)}
    rows = {name: {"text": f"row {name}", "small_run": name == "b", "sha256": "a" * 64,
                   "overall": overall, "plan_ms": 7.25} for name in "ab"}  # fmt: skip
    return {
        "command": "legibility evaluate ablations --seed 7", "seed": 7, "model": MODEL,
        "config": {"scenes": 50, "goals": [2, 6], "levels": 11, "samples": 4,
                   "training_steps": 3000, "training_scenes": 3200},
        "result": {"rows": rows, "data": "d" * 64},
    }  # fmt: skip


DATA = {"scenes": 12800, "seed": 0, "stream": "train", "goals": [2, 6], "per_scene": 129}
TRAINED = {"parameters": 1304194, "seconds": 3120.0, "step_seconds": 0.18, "device": "cpu",
           "threads": 2, "torch": "2.13.0", "digest": "d" * 64, "data": DATA}  # fmt: skip
CONFIG = {
    "format": 2,
    "path": {
        "config": {"dim": 2, "sigma": 0.15, "alpha": 3.0, "label": "anchored"},
        "sha256": "a" * 64,
        "training": {**TRAINED, "training": {"steps": 12000, "seed": 0, "scenes": 128,
                                             "per_scene": 8}},
    },
    "policy": {
        "config": {"dim": 2},
        "sha256": "b" * 64,
        "training": {**TRAINED, "training": {"steps": 8000, "seed": 0, "batch": 1024},
                     "demonstrations": {"demonstrations": 4, "demonstrated": 3200, "number": 12800,
                                        "noise": 0.003, "pushed": 0.25, "push": 0.1}},
    },
}  # fmt: skip


def documents():
    return {"dial": dial(), "closed-loop": dial(True), "execution": execution()}


def cells(table):
    return [[cell.strip() for cell in line.split("|")[1:-1]] for line in table.splitlines()
            if line.startswith("|")]  # fmt: skip


class TestDial:
    @pytest.mark.parametrize("closed_loop", [False, True])
    def test_every_figure_is_there(self, closed_loop):
        document = dial(closed_loop)
        text = dial_section(document)
        rows = cells(text)[2:]
        overall = document["result"]["overall"]
        assert [row[0] for row in rows] == [FIGURES[name].text for name in overall]
        for row, figures in zip(rows, overall.values(), strict=True):
            assert row[1] == f"{figures['mean']:.4f}"
            assert row[2] == "{:.4f} to {:.4f}".format(*figures["interval"])
        assert "On 3 random scenes with 2 to 6 goals" in text
        assert ("executed by stage 2" in text) == closed_loop
        assert ("7.2 ms on one core" in text) != closed_loop
        assert text.endswith("Measured by `legibility evaluate dial --scenes 3`.")

    def test_one_number_of_goals(self):
        document = dial()
        document["config"]["goals"] = [4, 4]
        assert "scenes with 4 goals that" in " ".join(dial_section(document).split())


class TestExecution:
    def test_every_row_is_there(self):
        text = execution_section(execution())
        rows = cells(text)[2:]
        assert [row[0] for row in rows] == [row.text for row in ROWS.values()]
        assert rows[0][1:] == [
            "100.00% (90.00% to 100.00%)", "99.50%", "0.9000", "0.0200", "0.12%", "25.00%", ""
        ]  # fmt: skip
        assert rows[1][-1] == "1 stalled"
        assert rows[2][2:5] == ["–", "–", "–"]
        assert all(len(row) == 8 for row in rows)

    def test_violations_are_those_of_all_rows(self):
        text = " ".join(execution_section(execution()).split())
        number = len(ROWS)
        assert f"{number} states were outside the workspace, 0 actions not finite" in text
        assert f"{2 * number} over the limit, and {3 * number} steps were stopped" in text

    def test_what_was_measured_is_told(self):
        text = " ".join(execution_section(execution()).split())
        assert "5,000 rollouts a row on 200 random scenes with 2 to 6 goals" in text
        assert "by 10 cm in a random direction" in text
        assert "0.88 ms on one core" in text
        assert (
            "256 robots at once 321 rollouts a second were planned and executed on 2 threads; "
            "as many in the environment alone take 4,321 control steps a second" in text
        )
        assert "The plans alone have a correlation of 0.9700 and an error of 0.0100" in text

    def test_what_an_arm_counts_is_told(self):
        text = " ".join(execution_section(transfer()).split())
        assert "outside the workspace (by at most 1.2 mm)" in text
        assert "not disturbed, had 0 table contacts, 2 self collisions." in text
        assert "the Panda of panda-gym" in text


class TestAblations:
    def test_every_row_is_there(self):
        rows = cells(ablations_section(ablations()))
        assert [row[0] for row in rows[2:]] == ["row a", "row b"]
        assert rows[2][1:] == ["0.5000", "0.5100", "0.5200", "0.5300", "0.5500", "7.2 ms"]
        assert {len(row) for row in rows} == {7}

    def test_what_was_run_is_told(self):
        text = " ".join(ablations_section(ablations()).split())
        assert "50 random scenes with 2 to 6 goals that training never drew (seed 7)" in text
        assert "small runs have the same network but only 3,000 steps of training" in text
        assert "on 3,200 scenes where no other number is named" in text
        assert text.endswith("Measured by `legibility evaluate ablations --seed 7`.")


class TestDistilled:
    def test_pairs_are_beside_each_other(self):
        fast = dial()
        fast["result"]["overall"]["error"] = figure(0.25)
        found = {
            "m-fast": {"dial": fast, "closed-loop": dial(True)},
            "m": {"dial": dial(), "closed-loop": dial(True)},
            "alone-fast": {"dial": dial()}, "other": {"dial": dial()},
        }  # fmt: skip
        text = distilled_section(found)
        rows = cells(text)
        assert [row[0] for row in rows] == ["weights", "---", "m", "m-fast"] * 2
        names = ("spearman", "error", "error_candidates", "at_1", "at_-1", "beyond_archive")
        assert rows[0][1:] == [
            *(FIGURES[name].text for name in names),
            "share of curves that are drawn inside the workspace",
            FIGURES["spread"].text,
            FIGURES["turning"].text,
        ]
        assert rows[3][2] == "0.2500 (0.2400 to 0.2600)"
        assert rows[2][2] != rows[3][2]
        assert "(3 with 2 to 6 goals; seed 7)" in " ".join(text.split())

    def test_without_a_pair_there_is_nothing(self):
        assert distilled_section({"m": {"dial": dial()}, "n-fast": {"dial": dial()}}) == ""

    def test_other_scenes_are_not_compared(self):
        fast = dial()
        fast["seed"] = 8
        with pytest.raises(InvalidInputError, match=r"dial-m-fast\.json is of other scenes"):
            distilled_section({"m": {"dial": dial()}, "m-fast": {"dial": fast}})

    def test_card_tells_of_the_teacher(self):
        config = copy.deepcopy(CONFIG)
        teacher = config["path"]["training"]
        config["path"]["config"]["sampling_steps"] = 1
        config["path"]["training"] = {
            **TRAINED,
            "training": {**teacher["training"], "steps": 4000, "pairs": 64, "score_weight": 2.5,
                         "jerk_weight": 0.125},
            "teacher": {
                "sha256": "e" * 64, "training": teacher, "sampling_steps": 3, "guidance": 0.3
            },
        }  # fmt: skip
        words = " ".join(render_card("m", config, documents()).split())
        assert "12,000 batches of 128 scenes" in words
        assert "4,000 batches of 128 scenes" in words
        assert f"the teacher (SHA-256 `{'e' * 64}`) draws in 3 steps with guidance 0.3" in words
        assert "a student that draws in 1 step without" in words
        assert "drew 64 paths" in words
        assert "(weight 2.5)" in words
        assert "no more jerk than its teacher's (weight 0.125)" in words
        config["path"]["training"]["teacher"]["training"] = None
        assert "How its teacher was made is not known. Then what the teacher" in " ".join(
            render_card("m", config, documents()).split()
        )


class TestCard:
    def test_both_stages(self):
        card = render_card("m", CONFIG, documents())
        for document, section in (("dial", dial_section), ("closed-loop", dial_section),
                                  ("execution", execution_section)):  # fmt: skip
            assert section(documents()[document]) in card
        words = " ".join(card.split())
        assert "12,800 random scenes with 2 to 6 goals (stream `train`, seed 0)" in words
        assert "12,000 batches of 128 scenes × 8 trajectories, seed 0, in 52 minutes" in words
        assert "8,000 batches of 1,024 moments of demonstrations" in words
        assert "12,800 demonstrations, 4 in each of 3,200 scenes" in words
        assert "noise of 3 mm a step and, in 25%, a push of 10 cm" in words

    def test_is_tidy_markdown(self):
        card = render_card("m", CONFIG, documents())
        assert card.startswith("---\nlicense: mit\n")
        assert card.endswith(".\n")
        assert "\n\n\n" not in card
        assert not re.search(r"[ \t]+$", card, re.MULTILINE)
        for line in card.splitlines():
            assert len(line) <= 100 or line.startswith("|")
        for heading in re.finditer(r"^#+ .*$", card, re.MULTILINE):
            assert card[heading.start() - 2 : heading.start()] == "\n\n"
            assert card[heading.end() : heading.end() + 2] == "\n\n"

    def test_without_stage_2_the_dial_is_enough(self):
        config = {key: CONFIG[key] for key in ("format", "path")}
        card = render_card("m", config, {"dial": dial()})
        assert "tage 2" not in card
        assert dial_section(dial()) in card

    @pytest.mark.parametrize("kind", ["dial", "closed-loop", "execution"])
    def test_a_missing_measurement(self, kind):
        found = documents()
        del found[kind]
        with pytest.raises(InvalidInputError, match=f"there is no {kind}-m.json"):
            render_card("m", CONFIG, found)

    @pytest.mark.parametrize(
        ("kind", "stage"),
        [("dial", "path"), ("closed-loop", "path"), ("closed-loop", "policy"),
         ("execution", "path"), ("execution", "policy"), ("transfer", "policy")],
    )  # fmt: skip
    @pytest.mark.parametrize("other", ["c" * 64, None])
    def test_a_measurement_of_other_weights(self, kind, stage, other):
        found = {**documents(), "transfer": transfer()}
        found[kind]["model"] = {**MODEL, stage: other}
        with pytest.raises(InvalidInputError, match=f"{kind}-m.json is of other weights"):
            render_card("m", CONFIG, found)

    def test_another_simulator(self):
        card = render_card("m", CONFIG, {**documents(), "transfer": transfer()})
        assert execution_section(transfer()) in card

    def test_another_stage_2_does_not_touch_the_dial_of_paths(self):
        found = documents()
        found["dial"]["model"] = {**MODEL, "policy": "c" * 64}
        render_card("m", CONFIG, found)

    @pytest.mark.parametrize("stage", ["path", "policy"])
    def test_training_that_nobody_knows(self, stage):
        config = copy.deepcopy(CONFIG)
        config[stage]["training"] = None
        with pytest.raises(InvalidInputError, match=f"does not say how its {stage} was trained"):
            render_card("m", config, documents())


class TestReplace:
    def test_only_what_is_between(self):
        page = "a\n<!-- x -->\nold\n<!-- /x -->\nb\n<!-- xy -->\nkept\n<!-- /xy -->\n"
        new = replace_table(page, "x", "new")
        assert new == page.replace("old", "new")
        assert replace_table(new, "x", "new") == new

    @pytest.mark.parametrize("page", ["", "<!-- x -->", "<!-- /x --> <!-- x -->"])
    def test_no_place(self, page):
        with pytest.raises(InvalidInputError, match="no part between"):
            replace_table(page, "x", "new")
