"""What tests of training share: settings, a tiny network, and a model that trains in no time."""

import json
from dataclasses import dataclass

import torch
from torch import nn

from legibility.models.checkpoint import load_tensors
from legibility.models.configuration import PathDiffuserConfig
from legibility.models.diffusion import noise_schedule
from legibility.models.path_diffuser import PathDiffuser
from legibility.models.provenance import Source
from legibility.training.configuration import PathTrainingConfig, TrainingConfig
from legibility.training.loop import CHECKPOINT, LOG, Run, train
from legibility.training.team import Team

torch.set_num_threads(1)

CPU = Team(torch.device("cpu"))
TINY = {"channels": (8, 16), "condition": 16, "encoder_width": 8, "resolution": 16}
SHORT = PathTrainingConfig(
    steps=8, scenes=3, per_scene=4, warmup=3, validate_every=5, checkpoint_every=4
)
LINE = TrainingConfig(steps=12, warmup=3, validate_every=5, checkpoint_every=4)


def rows(folder):
    """The log without its times."""
    lines = (folder / LOG).read_text().splitlines()
    return [{k: v for k, v in json.loads(line).items() if k != "seconds"} for line in lines]


def stop_at(*steps):
    """A progress that interrupts the training at each of `steps`."""

    def progress(step, *_):
        if step in steps:
            raise KeyboardInterrupt

    return progress


def assert_same_run(folder, other):
    """Raise unless two runs have the same log and checkpoint, apart from times."""

    def untimed(header):
        log = [{**row, "seconds": 0} for row in header["log"]]
        return {**header, "seconds": 0, "log": log}

    assert rows(folder) == rows(other)
    (one, head), (two, header) = (load_tensors(f / CHECKPOINT) for f in (folder, other))
    assert untimed(head) == untimed(header)
    assert one.keys() == two.keys()
    for name, tensor in one.items():
        assert torch.equal(tensor, two[name]), name


def tiny_diffuser(data, seed=0, **settings):
    """A tiny stage 1 for `data` that has learned nothing."""
    fixed = {"dim": data.config.dim, "observer": data.config.observer}
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        model = PathDiffuser(PathDiffuserConfig(**{**TINY, **fixed, **settings}))
    model.signal.copy_(noise_schedule(model.config.diffusion_steps))
    return model


@dataclass(frozen=True)
class LineConfig:
    slope: float = 2.0
    shift: tuple[float, ...] = (1.0, 0.0)

    def to_dict(self):
        return {"slope": self.slope, "shift": list(self.shift)}


class Line(nn.Module):
    """A linear model."""

    def __init__(self, config):
        super().__init__()
        self.config = config
        self.layer = nn.Linear(3, 1)


def train_line(folder, config=LINE, *, digest="a", progress=None, team=CPU, loss=None, **shape):
    """Train a `Line` in `folder`."""
    torch.manual_seed(config.seed)
    model = Line(LineConfig(**shape))

    def error(model, generator):
        x = torch.randn(64, 3, generator=generator)
        square = (model.layer(x)[:, 0] - model.config.slope * x.sum(-1)).square().mean()
        return square, {"half": square.detach() / 2}

    def validate(average):
        return {"validation_weight": float(average.layer.weight.mean().detach())}

    options = {"progress": progress} if progress else {}
    run = Run(folder, team, **options)
    return train(model, loss or error, validate, config, run, Source({"seed": 1}, digest))
