"""All methods learn from the same demonstrations in one scene, and are tuned for what is shown."""

import dataclasses
import json

import numpy as np
import pytest
import torch

from legibility.data.dataset import Dataset
from legibility.data.demonstrations import Demonstrations
from legibility.errors import CheckpointError, DatasetError, InvalidInputError
from legibility.evaluation.comparison import SCENES, TARGETS, TESTED
from legibility.evaluation.configuration import SingleSceneConfig
from legibility.evaluation.single_scene import GUIDED, ROWS, evaluate_single_scene
from legibility.report.comparisons import single_scene_section
from legibility.report.table import markdown

SHORT = SingleSceneConfig(
    rollouts=3, seed=2, demonstrations=6, training_steps=2, batch=16, tuning_rollouts=2,
    networks=2,
)  # fmt: skip
OWN_GUIDANCE = (0.0, 1.0)
RUNS = ("diffusion-policy", "legibility-diffuser-0", "legibility-diffuser-1", "path", "policy")


@pytest.fixture(scope="module")
def small():
    """One thread, few settings to try, and archives that are made in no time."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    with pytest.MonkeyPatch.context() as patch:
        module = "legibility.evaluation.single_scene"
        tried = {"guidance": (2.0, 5.0), "guidance_decay": (0.5,), "guidance_share": (1.0,)}
        patch.setattr(f"{module}.GUIDANCE", tried)
        patch.setattr(f"{module}.OWN_GUIDANCE", OWN_GUIDANCE)
        patch.setattr(f"{module}.EXECUTE", (1,))
        patch.setattr("legibility.rollout.PATIENCE", 0.25)  # of robots that have learned nothing
        yield
    torch.set_num_threads(threads)


@pytest.fixture(scope="module")
def evaluated(small, tmp_path_factory):
    """The folder, the result and what was told meanwhile."""
    folder, told = tmp_path_factory.mktemp("single"), []
    result = evaluate_single_scene(folder, SHORT, progress=lambda *args: told.append(args))
    return folder, result, told


def test_all_learn_from_the_same_demonstrations(evaluated):
    folder, result, _ = evaluated
    data, shown = Dataset.load(folder / "data"), Demonstrations.load(folder / "data")
    assert result["data"] == {"paths": data.digest, "demonstrations": shown.digest}
    assert [scene.goals[0].tolist() for scene in data.scenes] == SCENES[2].scene.goals.tolist()
    assert data.labels.shape == (2, SHORT.demonstrations)
    assert len(shown) <= 2 * SHORT.demonstrations
    assert set(result["training"]) == set(RUNS)
    assert {d["training"]["steps"] for d in result["training"].values()} == {2}
    seeds = {name: d["training"]["seed"] for name, d in result["training"].items()}
    assert seeds == dict.fromkeys(RUNS, 2) | {"legibility-diffuser-1": 3}
    assert {p.name for p in folder.iterdir()} == {*RUNS, "data", "validation"}


def test_every_row_is_measured(evaluated):
    _, result, _ = evaluated
    assert list(result["methods"]) == list(ROWS)
    for method in result["methods"].values():
        assert list(method["targets"]) == list(TARGETS)
        for own in method["targets"].values():
            assert sum(own["reasons"].values()) == SHORT.rollouts
    straight = result["methods"]["straight line"]["targets"]["R"]
    assert result["demonstrated"]["R"]["distance_score"] > straight["distance_score"]["mean"]
    assert result["demonstrated"]["R"]["achieved"] == pytest.approx(1, abs=0.2)


def test_the_best_of_what_was_tried_is_chosen(evaluated):
    _, result, _ = evaluated
    for tuning in result["tuning"].values():
        assert list(tuning) == [GUIDED, f"{GUIDED}, L_p", "network"]
        assert [row["guidance"] for row in tuning["network"]["tried"]] == list(OWN_GUIDANCE)
        for name in (GUIDED, f"{GUIDED}, L_p"):
            *first, other = tuning[name]["tried"]
            assert [(row["network"], row["guidance"], row["execute"]) for row in first] == [
                (0, 2, 4), (0, 5, 4), (1, 2, 4), (1, 5, 4)
            ]  # fmt: skip
            assert (other["execute"], other["guidance_decay"]) == (1, 0.5**0.25)
        for name, tuned in tuning.items():
            most = max(row["success"] for row in tuned["tried"])
            rows = [row for row in tuned["tried"] if row["success"] >= min(0.99, most)]
            best = max(rows, key=lambda row: row["distance_score"])
            if "L_p" in name:
                best = min(rows, key=lambda row: row["potential_cost"])
            assert tuned["chosen"] == {name: best[name] for name in tuned["chosen"]}


def test_progress(evaluated):
    _, _, told = evaluated
    done = [now for now, _, _ in told]
    assert done == sorted(done)
    assert {total for _, total, _ in told} == {done[-1]}
    assert [line[:8] for _, _, line in told if line] == ["toward R", "toward G"]


def test_nothing_is_trained_twice(evaluated, small, monkeypatch):
    folder, result, _ = evaluated
    monkeypatch.setattr("legibility.training.path.PathBatches.loss", None)
    monkeypatch.setattr("legibility.training.policy.PolicyBatches.loss", None)
    assert evaluate_single_scene(folder, SHORT) == result


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        ({"training_steps": 3}, CheckpointError, "training.steps is 2 in the checkpoint and 3 now"),
        ({"demonstrations": 5}, DatasetError, "holds a dataset of another configuration"),
    ],
)
def test_other_settings_in_the_same_folder(changes, error, message, evaluated, small):
    with pytest.raises(error, match=message):
        evaluate_single_scene(evaluated[0], dataclasses.replace(SHORT, **changes))


@pytest.mark.parametrize(
    "wrong",
    [
        {"rollouts": 1},
        {"seed": -1},
        {"demonstrations": 2},
        {"batch": 0},
        {"batch": 12},
        {"tuning_rollouts": 0},
        {"networks": 0},
        {"env": "pandagym"},
    ],
    ids=str,
)
def test_refuses(wrong):
    with pytest.raises(InvalidInputError, match=next(iter(wrong))):
        SingleSceneConfig(**wrong)


def test_texts(evaluated):
    from legibility.cli.output import _plain

    _, result, _ = evaluated
    plain = json.loads(json.dumps(_plain(result)))
    document = {"seed": 2, "config": dataclasses.asdict(SHORT), "result": plain}
    section = markdown(single_scene_section(document))
    assert "6 demonstrations toward either target" in " ".join(section.split())
    assert "| the best demonstrated path | – | " in section
    best = result["demonstrated"]["G"]["distance_score"]
    assert f"{best:.3g} (1.00)" in section
    for tests in TESTED:
        assert np.isfinite([t["p_holm"] for t in result["tests"] if tests in t["cell"]]).all()
