"""A card says how weights were made, and only shows metrics of these weights."""

import copy
import re

import documents
import pytest
import yaml

from legibility.errors import InvalidInputError
from legibility.report.card import render_card

DATA = {
    "scenes": 12800, "seed": 0, "stream": "train", "goals": [2, 6], "per_scene": 129,
    "regime": "training", "views": 3,
}  # fmt: skip
TRAINED = {
    "parameters": 1304194, "seconds": 3120.0, "step_seconds": 0.18, "device": "cpu",
    "processes": 1, "precision": "no", "threads": 2, "torch": "2.13.0", "digest": "d" * 64,
    "data": DATA,
}  # fmt: skip
DEMONSTRATIONS = {
    "demonstrations": 4, "demonstrated": 3200, "number": 12800, "noise": 0.003, "pushed": 0.25,
    "push": 0.1,
}  # fmt: skip
OF_POLICY = {
    **TRAINED, "training": {"steps": 8000, "seed": 0, "batch": 1024},
    "demonstrations": DEMONSTRATIONS,
}  # fmt: skip
OBSERVER = {"kind": "boltzmann", "alpha": 3.0, "detour": 2.5, "label": "anchored"}
CONFIG = {
    "format": 3,
    "path": {
        "config": {"dim": 2, "observer": OBSERVER, "sampling_steps": 3},
        "sha256": "a" * 64,
        "training": {
            **TRAINED, "training": {"steps": 12000, "seed": 0, "scenes": 128, "per_scene": 8}
        },
    },
    "policy": {"config": {"dim": 2}, "sha256": "b" * 64, "training": OF_POLICY},
}  # fmt: skip
NAMES = {"dial": "m-dragan", "closed-loop": "m", "execution": "m"}
CHOSEN = {"guidance": 5.0, "guidance_decay": 0.5, "guidance_share": 1.0}
BASELINE = {
    "format": 3,
    "goal": {
        "config": {"dim": 2, "chunk": 8, "execute": 4, **CHOSEN},
        "sha256": "f" * 64,
        "training": OF_POLICY,
    },
}


@pytest.fixture
def results():
    return {
        "dial": {f"m-{r}": documents.dial(regime=r) for r in ("dragan", "all")},
        "closed-loop": {"m": documents.dial(True)},
        "execution": {"m": documents.execution()},
    }  # fmt: skip


def words(card):
    return " ".join(card.split())


class TestModulator:
    def test_training(self, results):
        card = words(render_card("m", CONFIG, results))
        assert "12,800 random scenes (regime `training`, stream `train`, seed 0)" in card
        assert "each seen by 3 random observers; for each of these 129 trajectories" in card
        assert "labels `anchored`, α = 3, detour 2.5." in card
        assert "12,000 batches of 128 scenes × 8 trajectories, seed 0, in 52 minutes" in card
        assert "8,000 batches of 1,024 moments of demonstrations" in card
        assert "12,800 demonstrations, 4 in each of 3,200 scenes" in card
        assert "noise of 3 mm a step and, in 25%, a push of 10 cm" in card

    def test_metrics(self, results):
        card = render_card("m", CONFIG, results)
        overall = results["dial"]["m-dragan"]["result"]["overall"]["quick"]
        assert f"| mean absolute error of ℓ | {overall['error']['mean']:.4f} |" in card
        assert "| success of executed motions | 100.00% |" in card
        assert "`docs/results.md`" in card

    def test_metrics_as_metadata(self, results):
        head = yaml.safe_load(render_card("m", CONFIG, results).split("---")[1])
        assert head["pipeline_tag"] == "robotics"
        ((model,),) = [head["model-index"]]
        assert model["name"] == "m"
        for entry in model["results"]:
            assert set(entry) == {"task", "dataset", "metrics"}
            assert set(entry["task"]) == {"type", "name"}
            assert set(entry["dataset"]) == {"type", "name", "config"}
        found = {
            (entry["dataset"]["config"], metric["type"]): metric["value"]
            for entry in model["results"]
            if entry["task"]["name"] == "The dial of planned paths"
            for metric in entry["metrics"]
        }
        overall = results["dial"]["m-dragan"]["result"]["overall"]
        for regime in ("dragan", "all"):
            assert found[regime, "mae"] == round(overall["quick"]["error"]["mean"], 4)
            assert found[regime, "mae_exact"] == round(overall["exact"]["error"]["mean"], 4)
        assert "success" in {m["type"] for entry in model["results"] for m in entry["metrics"]}

    def test_is_short_and_tidy_markdown(self, results):
        card = render_card("m", CONFIG, results)
        assert card.startswith("---\nlicense: mit\n")
        assert card.endswith(".\n")
        assert len(card.splitlines()) < 100
        assert "\n\n\n" not in card
        assert not re.search(r"[ \t]+$", card, re.MULTILINE)
        for line in card.splitlines():
            assert len(line) <= 100
        for heading in re.finditer(r"^#+ .*$", card, re.MULTILINE):
            assert card[heading.start() - 2 : heading.start()] == "\n\n"
            assert card[heading.end() : heading.end() + 2] == "\n\n"

    def test_teacher_and_student(self, results):
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
        card = words(render_card("m", config, results))
        assert "12,000 batches of 128 scenes" in card
        assert "4,000 batches of 128 scenes" in card
        assert "A student that draws in 1 step without guidance" in card
        assert f"(SHA-256 `{'e' * 64}`), which draws in 3 with guidance 0.3" in card
        assert "distilled from 64 paths a scene" in card
        config["path"]["training"]["teacher"]["training"] = None
        card = words(render_card("m", config, results))
        assert "The training of its teacher is not known. A student" in card

    def test_without_stage_2_the_dial_is_enough(self, results):
        config = {key: CONFIG[key] for key in ("format", "path")}
        assert "tage 2" not in render_card("m", config, {"dial": results["dial"]})

    @pytest.mark.parametrize("kind", ["dial", "closed-loop", "execution"])
    def test_a_missing_result(self, kind, results):
        del results[kind]
        with pytest.raises(InvalidInputError, match=f"there is no {kind}-{NAMES[kind]}.json"):
            render_card("m", CONFIG, results)

    @pytest.mark.parametrize(
        ("kind", "stage"),
        [("dial", "path"), ("closed-loop", "path"), ("closed-loop", "policy"),
         ("execution", "path"), ("execution", "policy")],
    )  # fmt: skip
    @pytest.mark.parametrize("other", ["c" * 64, None])
    def test_a_result_of_other_weights(self, kind, stage, other, results):
        results[kind][NAMES[kind]]["model"] = {**documents.MODEL, stage: other}
        problem = f"{kind}-{NAMES[kind]}.json is a result of other weights"
        with pytest.raises(InvalidInputError, match=problem):
            render_card("m", CONFIG, results)

    def test_another_stage_2_does_not_touch_the_dial_of_paths(self, results):
        results["dial"]["m-dragan"]["model"] = {**documents.MODEL, "policy": "c" * 64}
        render_card("m", CONFIG, results)

    @pytest.mark.parametrize("stage", ["path", "policy"])
    @pytest.mark.parametrize("training", [None, {"steps": 3}])
    def test_unknown_training(self, stage, training, results):
        config = copy.deepcopy(CONFIG)
        config[stage]["training"] = training
        with pytest.raises(InvalidInputError, match="m"):
            render_card("m", config, results)


class TestBaseline:
    NAME = "legibility-diffuser-x"

    @pytest.fixture
    def results(self):
        rows = [
            {**CHOSEN, "success": 0.995, "achieved": 0.25},
            {**CHOSEN, "guidance": 9.0, "success": 0.5, "achieved": 0.75},
        ]
        return {"tuning": {self.NAME: {
            "model": {"name": self.NAME, "goal": "f" * 64}, "result": {"tuning": rows}
        }}}  # fmt: skip

    def test_guidance(self, results):
        card = words(render_card(self.NAME, BASELINE, results))
        assert "Of 2 combinations on validation scenes" in card
        assert "`results/tuning-legibility-diffuser-x.json`" in card
        assert "w = 5, γ = 0.5, a = 1 is the most legible that reaches the goal in 99%" in card
        assert "99.5% success and a mean achieved ℓ of 0.250" in card
        assert "comparison with the modulator is in the repository's `docs/results.md`" in card

    def test_plain_policy_needs_no_tuning(self):
        config = copy.deepcopy(BASELINE)
        config["goal"]["config"]["guidance"] = 0.0
        assert "## Guidance" not in render_card("diffusion-policy-x", config, {})

    def test_without_tuning(self):
        with pytest.raises(InvalidInputError, match="there is no tuning-legibility-diffuser-x"):
            render_card(self.NAME, BASELINE, {})

    def test_other_weights(self, results):
        results["tuning"][self.NAME]["model"]["goal"] = "0" * 64
        with pytest.raises(InvalidInputError, match=r"\.json is a result of other weights"):
            render_card(self.NAME, BASELINE, results)

    def test_a_choice_that_was_not_tried(self, results):
        del results["tuning"][self.NAME]["result"]["tuning"][0]
        with pytest.raises(InvalidInputError, match="no row of the guidance"):
            render_card(self.NAME, BASELINE, results)

    def test_unknown_method(self, results):
        with pytest.raises(InvalidInputError, match="not that of a method"):
            render_card("someone", BASELINE, results)
