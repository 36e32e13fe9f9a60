"""Stage 2 learns to follow paths, and a run that was cut short ends as one that was not."""

import dataclasses
import json

import numpy as np
import pytest
import torch

from legibility.data.configuration import DatasetConfig, DemonstrationsConfig
from legibility.data.dataset import generate
from legibility.data.demonstrations import demonstrate
from legibility.errors import CheckpointError, InvalidInputError
from legibility.models.checkpoint import load_tensors
from legibility.models.configuration import PathPolicyConfig
from legibility.models.diffusion import noise_schedule
from legibility.models.path_policy import PathPolicy
from legibility.training.configuration import PolicyTrainingConfig
from legibility.training.loop import CHECKPOINT, LOG
from legibility.training.policy import PolicyBatches, along_paths, train_policy, validate_policy
from legibility.training.team import Team

torch.set_num_threads(1)

CPU = Team(torch.device("cpu"))
TINY = {"channels": (8, 16), "condition": 16}
SHORT = PolicyTrainingConfig(
    steps=8, batch=32, warmup=2, validate_every=100, checkpoint_every=4, learning_rate=3e-3
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("policy")
    config = DatasetConfig(scenes=40, cells=10, per_scene=9)
    generate(config, folder / "data")
    generate(dataclasses.replace(config, stream="validation", scenes=10), folder / "validation")
    demonstrate(folder / "data", DemonstrationsConfig(demonstrations=3))
    return folder


@pytest.fixture(scope="module")
def data(folder):
    from legibility.data.demonstrations import Demonstrations

    return Demonstrations.load(folder / "data")


@pytest.fixture(scope="module")
def validation(folder):
    from legibility.data.dataset import Dataset

    return Dataset.load(folder / "validation")


def tiny():
    torch.manual_seed(0)
    model = PathPolicy(PathPolicyConfig(**TINY))
    model.signal.copy_(noise_schedule(100))
    return model


def test_batches_hold_every_step(data):
    batches = PolicyBatches(*along_paths(data, tiny().config), SHORT, CPU)
    steps = sum(len(a) for a in data.actions)
    for features, actions in (batches.guided, batches.unguided):
        assert len(features) == len(actions) == steps
        assert torch.isfinite(features).all()
        assert (actions.norm(dim=-1) <= 2**0.5 + 1e-5).all()  # in limits, turned
    # The frames differ, the lengths do not.
    torch.testing.assert_close(
        batches.guided[1].norm(dim=-1), batches.unguided[1].norm(dim=-1), atol=1e-5, rtol=1e-5
    )
    # On its path the robot goes ahead.
    assert (batches.guided[1][:, 0, 0] > 0).float().mean() > 0.9


def test_dropped_paths_are_not_seen(data):
    model = tiny()
    torch.nn.init.normal_(model.unet.outlet.weight)
    parts = along_paths(data, model.config)
    none = PolicyBatches(parts[0], parts[1], dataclasses.replace(SHORT, dropout=0.999999), CPU)
    before, _ = none.loss(model, torch.Generator().manual_seed(0))
    none.guided = [torch.full_like(x, torch.nan) for x in none.guided]
    after, _ = none.loss(model, torch.Generator().manual_seed(0))
    torch.testing.assert_close(before, after)


def test_cut_short_it_ends_the_same(data, validation, tmp_path):
    whole = train_policy(data, validation, tmp_path / "whole", SHORT, **TINY)

    class Stop(Exception):
        pass

    def stop(step, steps, figures):
        if step == 6:
            raise Stop

    with pytest.raises(Stop):
        train_policy(data, validation, tmp_path / "cut", SHORT, progress=stop, **TINY)
    assert load_tensors(tmp_path / "cut" / CHECKPOINT)[1]["step"] == 4
    again = train_policy(data, validation, tmp_path / "cut", SHORT, **TINY)
    for a, b in zip(whole.state_dict().values(), again.state_dict().values(), strict=True):
        assert torch.equal(a, b)
    with pytest.raises(CheckpointError, match="another run"):
        train_policy(
            data, validation, tmp_path / "cut", dataclasses.replace(SHORT, batch=16), **TINY
        )


def test_a_small_policy_learns_to_reach(data, validation, tmp_path):
    how = PolicyTrainingConfig(
        steps=400, batch=256, warmup=30, learning_rate=3e-3, ema=0.98,
        validate_every=400, checkpoint_every=400,
    )  # fmt: skip
    model = train_policy(data, validation, tmp_path, how, channels=(16, 32), condition=48)
    rows = [json.loads(row) for row in (tmp_path / LOG).read_text().splitlines()]
    assert rows[-1]["velocity"] < 0.7 * rows[0]["velocity"]
    assert rows[-1]["validation_success"] > 0.9
    assert rows[-1]["validation_deviation"] < 0.03
    assert validate_policy(model, validation) == {
        k: rows[-1][k] for k in rows[-1] if k.startswith("validation")
    }


def test_an_untrained_policy_does_not_reach(validation):
    figures = validate_policy(tiny().eval(), validation)
    assert figures["validation_success"] < 0.3
    assert all(np.isfinite(v) for v in figures.values())


def test_refuses(data, validation, tmp_path):
    solid = dataclasses.replace(
        validation, config=dataclasses.replace(validation.config, stream="evaluation")
    )
    with pytest.raises(InvalidInputError, match="for evaluations alone"):
        train_policy(data, solid, tmp_path, SHORT)
    for wrong in ({"batch": 0}, {"steps": 0}, {"dropout": 1.0}, {"learning_rate": -1}):
        with pytest.raises(InvalidInputError, match=next(iter(wrong))):
            PolicyTrainingConfig(**wrong)


def test_an_arm_learns_by_the_same_code(tmp_path):
    pytest.importorskip("mujoco", reason="the extra named panda is not installed")
    config = DatasetConfig(dim=3, scenes=6, cells=6, per_scene=9)
    generate(config, tmp_path / "data")
    checks = generate(
        dataclasses.replace(config, stream="validation", scenes=2), tmp_path / "validation"
    )
    shown = demonstrate(tmp_path / "data", DemonstrationsConfig(demonstrations=3))
    settings = dataclasses.replace(SHORT, steps=150, batch=128)
    model = train_policy(shown, checks, tmp_path / "run", settings, **TINY)
    assert (model.config.dim, model.config.limit) == (3, 0.02)
    rows = [json.loads(row) for row in (tmp_path / "run" / LOG).read_text().splitlines()]
    assert rows[-1]["velocity"] < rows[0]["velocity"] < 1.5
    assert 0 <= rows[-1]["validation_deviation"] < 0.5
