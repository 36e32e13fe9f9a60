"""The recipe is that of the shipped weights, unless told otherwise, and refuses by name."""

import json

import pytest

from legibility.data.configuration import DatasetConfig, DemonstrationsConfig
from legibility.errors import InvalidInputError
from legibility.intent.observer import Observer
from legibility.training.configuration import (
    DistillationConfig,
    PathTrainingConfig,
    PolicyTrainingConfig,
)
from legibility.training.recipe import Recipe


def test_defaults_are_those_of_the_commands():
    assert Recipe.of(dim=3, seed=2) == Recipe(
        data=DatasetConfig(dim=3, scenes=4096, views=4, per_scene=25, seed=2),
        shown=DatasetConfig(dim=3, scenes=3200, views=1, regime="dragan", seed=2),
        demonstrations=DemonstrationsConfig(demonstrations=4),
        path=PathTrainingConfig(seed=2),
        path_network={},
        policy=PolicyTrainingConfig(seed=2),
        policy_network={},
        student=DistillationConfig(seed=2),
    )


def test_later_layers_count():
    file = {
        "data": {"scenes": 8, "goals": [2, 3]},
        "path": {"steps": 9, "channels": [8, 16]},
        "observer": {"alpha": 2.0},
        "policy": {},
    }
    recipe = Recipe.of(file, {"data": {"scenes": None}, "path": {"steps": 7}})
    assert (recipe.data.scenes, recipe.data.goals) == (8, (2, 3))
    assert recipe.data.views == 4
    assert recipe.path.steps == 7
    assert recipe.path_network == {"channels": (8, 16)}
    assert recipe.data.observer == recipe.shown.observer == Observer(alpha=2.0)
    content = json.loads(json.dumps(recipe.to_dict()))
    assert content["path"]["channels"] == [8, 16]
    assert content["demonstrations"]["demonstrations"] == 4


@pytest.mark.parametrize(
    ("sections", "message"),
    [
        ([1], "settings must be sections of settings"),
        ({"data": 3}, "settings must be sections of settings"),
        ({"teacher": {}}, "settings have sections observer, data, .*, got teacher"),
        ({"path": {"speed": 1}}, "the section path has .*steps.*, got speed"),
        ({"data": {"demonstrations": 4}}, "the section data has .*, got demonstrations"),
        ({"data": {"seed": 1}}, "the section data has .*, got seed"),
        ({"path": {"dim": 3}}, "got dim"),
        ({"policy": {"limit": 0.1}}, "got limit"),
        ({"student": {"dropout": 0.1}}, "got dropout"),
        ({"observer": {"sigma": 0.1}}, "the section observer has alpha, detour, label, got sigma"),
        ({"data": {1: 2}}, "got 1"),
        ({"data": {"scenes": 0}}, "scenes must be an integer of at least 1, got 0"),
        ({"data": {"scenes": "many"}}, "scenes must be an integer"),
        (
            {"demonstrations": {"demonstrations": 0}},
            "demonstrations must be an integer of at least 1",
        ),
        ({"demonstrations": {"demonstrations": 100}}, "demonstrations must be at most 65"),
        ({"path": {"channels": 8}}, "a setting is of the wrong type"),
        ({"path": {"channels": [7]}}, "channels must be a multiple of 8, got 7"),
        ({"policy": {"chunk": 7}}, "chunk must be a multiple of 2, got 7"),
        ({"student": {"ends": 1}}, "ends must lie in"),
    ],
    ids=str,
)
def test_refuses(sections, message):
    with pytest.raises(InvalidInputError, match=message):
        Recipe.of(sections)
