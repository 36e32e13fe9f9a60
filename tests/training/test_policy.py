"""Stage 2 learns to follow paths, and a run that was cut short ends as one that was not."""

import dataclasses

import numpy as np
import pytest
import torch
from trainings import CPU, assert_same_run, rows, stop_at

from legibility.data.configuration import DatasetConfig, DemonstrationsConfig
from legibility.data.dataset import Dataset, generate
from legibility.data.demonstrations import Demonstrations, demonstrate
from legibility.errors import CheckpointError, InvalidInputError
from legibility.intent.observer import Observer
from legibility.models.configuration import PathPolicyConfig
from legibility.models.diffusion import noise_schedule
from legibility.models.path_policy import PathPolicy
from legibility.training.configuration import PolicyTrainingConfig
from legibility.training.loop import Run
from legibility.training.policy import PolicyBatches, along_paths, train_policy, validate_policy

TINY = {"channels": (8, 16), "condition": 16}
SHORT = PolicyTrainingConfig(
    steps=8, batch=32, warmup=2, validate_every=100, checkpoint_every=4, learning_rate=3e-3
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("policy")
    config = DatasetConfig(
        scenes=24, views=1, cells=8, per_scene=9, candidates=4096, regime="dragan"
    )
    generate(config, folder / "data")
    generate(dataclasses.replace(config, stream="validation", scenes=6), folder / "validation")
    demonstrate(folder / "data", DemonstrationsConfig(demonstrations=4))
    return folder


@pytest.fixture(scope="module")
def data(folder):
    return Demonstrations.load(folder / "data")


@pytest.fixture(scope="module")
def validation(folder):
    return Dataset.load(folder / "validation")


def tiny():
    torch.manual_seed(0)
    model = PathPolicy(PathPolicyConfig(**TINY))
    model.signal.copy_(noise_schedule(100))
    return model


def test_batches_hold_every_step(data):
    batches = PolicyBatches(*along_paths(data, 8), SHORT, CPU)
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
    config = dataclasses.replace(SHORT, dropout=0.999999)
    none = PolicyBatches(*along_paths(data, 8), config, CPU)
    before, _ = none.loss(model, torch.Generator().manual_seed(0))
    none.guided = [torch.full_like(x, torch.nan) for x in none.guided]
    after, _ = none.loss(model, torch.Generator().manual_seed(0))
    torch.testing.assert_close(before, after)


def test_resumes_bit_for_bit(data, validation, tmp_path):
    def train(name, config=SHORT, **options):
        return train_policy(data, validation, Run(tmp_path / name, CPU, **options), config, **TINY)

    record = train("whole").record
    assert (record.data, record.digest) == (data.dataset.to_dict(), data.digest)
    assert record.demonstrations == {**dataclasses.asdict(data.config), "number": len(data)}
    with pytest.raises(KeyboardInterrupt):
        train("parts", progress=stop_at(6))
    train("parts")
    assert_same_run(tmp_path / "whole", tmp_path / "parts")
    with pytest.raises(CheckpointError, match=r"training\.batch is 32 in the .* and 16 now"):
        train("parts", dataclasses.replace(SHORT, batch=16))


def test_a_small_policy_learns_to_reach(data, validation, tmp_path):
    """The worst of five seeds on two instruction sets: success 1, 0.011, velocity 0.71."""
    how = PolicyTrainingConfig(
        steps=250, batch=128, warmup=30, learning_rate=4e-3, ema=0.97,
        validate_every=250, checkpoint_every=250,
    )  # fmt: skip
    run = Run(tmp_path, CPU)
    model = train_policy(data, validation, run, how, channels=(16, 32), condition=32).model
    log = rows(tmp_path)
    assert log[-1]["velocity"] < 0.9 * log[0]["velocity"]
    assert log[-1]["validation_success"] > 0.7
    assert log[-1]["validation_deviation"] < 0.04
    assert validate_policy(model, validation) == {
        k: log[-1][k] for k in log[-1] if k.startswith("validation")
    }


def test_an_untrained_policy_does_not_reach(validation):
    figures = validate_policy(tiny().eval(), validation)
    assert figures["validation_success"] < 0.3
    assert all(np.isfinite(v) for v in figures.values())


def test_refuses(data, validation, tmp_path):
    config = dataclasses.replace(validation.config, dim=3, observer=Observer())
    solid = dataclasses.replace(validation, config=config)
    with pytest.raises(InvalidInputError, match="the validation data are 3-D, the data 2-D"):
        train_policy(data, solid, Run(tmp_path, CPU), SHORT)
    for wrong in ({"batch": 0}, {"steps": 0}, {"dropout": 1.0}, {"learning_rate": -1}):
        with pytest.raises(InvalidInputError, match=next(iter(wrong))):
            PolicyTrainingConfig(**wrong)


def test_an_arm_learns_by_the_same_code(tmp_path):
    pytest.importorskip("mujoco", reason="the extra named panda is not installed")
    config = DatasetConfig(
        dim=3, scenes=6, views=1, cells=6, per_scene=9, candidates=4096, regime="dragan"
    )
    generate(config, tmp_path / "data")
    checks = generate(
        dataclasses.replace(config, stream="validation", scenes=1), tmp_path / "validation"
    )
    shown = demonstrate(tmp_path / "data", DemonstrationsConfig(demonstrations=3))
    settings = dataclasses.replace(SHORT, steps=100, batch=128)
    model = train_policy(shown, checks, Run(tmp_path / "run", CPU), settings, **TINY).model
    assert (model.config.dim, model.config.limit) == (3, 0.02)
    log = rows(tmp_path / "run")
    assert log[-1]["velocity"] < log[0]["velocity"] < 1.5
    assert 0 <= log[-1]["validation_deviation"] < 0.5
