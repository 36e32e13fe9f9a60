"""Models for evaluations: one that has learned nothing, and one that meets every ℓ exactly."""

import json
import shutil

import pytest
import torch
from trainings import TINY

from legibility.models.configuration import PathDiffuserConfig
from legibility.models.diffusion import noise_schedule
from legibility.models.path_diffuser import PathDiffuser
from legibility.models.pretrained import load_stages, pretrained_folder
from legibility.modulator import Modulator


class Exact(Modulator):
    """Plans exactly, whatever it was asked for."""

    def plan_many(self, *scenes, **options):
        return super().plan_many(*scenes, **{**options, "exact": True})


def untrained(dim=2):
    with torch.random.fork_rng():
        torch.manual_seed(0)
        model = PathDiffuser(PathDiffuserConfig(dim=dim, **TINY))
        torch.nn.init.normal_(model.unet.outlet.weight, std=0.3)
    model.spread.fill_(0.5)
    model.signal.copy_(noise_schedule(100))
    return model


@pytest.fixture(scope="session")
def tiny():
    return Modulator(untrained())


@pytest.fixture(scope="session")
def stage_2(tmp_path_factory):
    """The shipped stage 2 alone."""
    folder, shipped = tmp_path_factory.mktemp("stage-2"), pretrained_folder("block-reach-2d")
    content = json.loads((shipped / "config.json").read_text())
    del content["path"]
    (folder / "config.json").write_text(json.dumps(content))
    shutil.copy(shipped / "policy.safetensors", folder)
    return load_stages(folder)[0]["policy"]


@pytest.fixture(scope="session")
def exact(stage_2):
    return Exact(untrained(), stage_2)
