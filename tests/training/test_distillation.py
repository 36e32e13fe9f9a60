"""A student draws what its teacher draws, in fewer steps."""

import dataclasses
import json

import numpy as np
import pytest
import torch

from legibility.data.configuration import DatasetConfig
from legibility.data.dataset import Dataset, generate
from legibility.errors import CheckpointError, InvalidInputError
from legibility.models.configuration import PathDiffuserConfig
from legibility.models.diffusion import noise_schedule
from legibility.models.path_diffuser import PathDiffuser
from legibility.training.configuration import DistillationConfig
from legibility.training.distillation import DistillationBatches, distill_path
from legibility.training.loop import LOG
from legibility.training.team import Team

torch.set_num_threads(1)

SHORT = DistillationConfig(
    steps=60, scenes=4, per_scene=8, pairs=12, ends=0.25, warmup=3, learning_rate=2e-3, ema=0.9,
    score_weight=0.0, wall_weight=0.0, validate_every=60, checkpoint_every=40,
)  # fmt: skip


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    return generate(DatasetConfig(scenes=4, cells=8, per_scene=17), tmp_path_factory.mktemp("data"))


@pytest.fixture(scope="module")
def teacher():
    """One whose paths depend on the noise and whose guidance counts."""
    with torch.random.fork_rng():
        torch.manual_seed(0)
        config = PathDiffuserConfig(
            channels=(8, 16), condition=16, encoder_width=8, resolution=16, guidance=0.5
        )
        model = PathDiffuser(config).eval().requires_grad_(False)
        torch.nn.init.normal_(model.unet.outlet.weight, std=0.3)
        torch.nn.init.normal_(model.no_field)
        torch.nn.init.normal_(model.no_level)
    model.signal.copy_(noise_schedule(100))
    return model


def distance(model, batches):
    """Mean distance of what `model` draws from the pairs of `batches`."""
    scenes = torch.arange(len(batches.labels)).repeat_interleave(batches.labels.shape[1])
    found = model.sample(
        batches.conditions.map(lambda x: x[scenes]),
        batches.labels.flatten(),
        batches.noise.flatten(0, 1),
    )
    return float((found - batches.waypoints.flatten(0, 1)).norm(dim=-1).mean())


def drawn(teacher, data, config=SHORT):
    batches = DistillationBatches(data, teacher, config, Team(torch.device("cpu")))
    batches.draw()
    return batches


def test_pairs_are_what_the_teacher_draws_all_over_the_dial(teacher, data):
    batches = drawn(teacher, data)
    assert distance(teacher, batches) < 1e-6
    levels = batches.labels.numpy()
    assert levels.shape == (4, 12)
    assert (np.diff(levels, axis=1) >= 0).all()
    for end in (-1, 1):
        shares = (levels == end).mean(axis=1)
        assert (shares >= 1 / 12).all()
        assert (shares <= 2 / 12).all()


def test_ends_may_be_left_out(teacher, data):
    levels = drawn(teacher, data, dataclasses.replace(SHORT, ends=0.0)).labels
    assert levels.abs().max() < 1


@pytest.mark.parametrize("steps", [1, 2])
def test_a_student_learns_what_its_teacher_draws(teacher, data, tmp_path, steps):
    config = dataclasses.replace(SHORT, sampling_steps=steps)
    seen = []
    student = distill_path(
        teacher, data, data, tmp_path, config, drawn=lambda done, total: seen.append((done, total))
    )
    assert seen[-1] == (4, 4)
    assert student.config == dataclasses.replace(teacher.config, sampling_steps=steps, guidance=0.0)
    batches = drawn(teacher, data)
    untrained = PathDiffuser(student.config).eval()
    untrained.load_state_dict(teacher.state_dict())
    assert distance(student, batches) < 0.7 * distance(untrained, batches)
    found = [json.loads(line) for line in (tmp_path / LOG).read_text().splitlines()]
    assert {"loss", "path", "label", "wall", "jerk", "validation_error"} <= found[-1].keys()


def test_a_finished_run_draws_nothing(teacher, data, tmp_path):
    short = dataclasses.replace(SHORT, steps=2)
    seen = []
    first, again = (
        distill_path(teacher, data, data, tmp_path, short, drawn=lambda *at: seen.append(at))
        for _ in range(2)
    )
    assert seen.count((4, 4)) == 1
    assert torch.equal(first.level.weight, again.level.weight)


def test_the_label_alone_can_be_learned(teacher, data, tmp_path):
    config = dataclasses.replace(SHORT, score_weight=100.0)
    before, after = (
        [json.loads(line) for line in (folder / LOG).read_text().splitlines()][-1]["label"]
        for folder, own in ((tmp_path / "a", SHORT), (tmp_path / "b", config))
        if distill_path(teacher, data, data, folder, own)
    )
    assert after < 0.5 * before


def jerk(model, batches):
    """Mean of the squared third differences along the paths that `model` draws of the pairs."""
    scenes = torch.arange(len(batches.labels)).repeat_interleave(batches.labels.shape[1])
    conditions = batches.conditions.map(lambda x: x[scenes])
    found = model.sample(conditions, batches.labels.flatten(), batches.noise.flatten(0, 1)).numpy()
    ends = np.zeros((len(found), 1, found.shape[2]))
    paths = np.concatenate([ends, found, ends + np.eye(1, found.shape[2])], axis=1)
    wave = paths[:, 3:] - 3 * paths[:, 2:-1] + 3 * paths[:, 1:-2] - paths[:, :-3]
    return (wave**2).sum((1, 2)).mean()


def test_paths_learn_to_have_less_jerk(teacher, data, tmp_path):
    batches = drawn(teacher, data)
    without, much = (
        jerk(
            distill_path(
                teacher, data, data, tmp_path / str(weight),
                dataclasses.replace(SHORT, score_weight=100.0, jerk_weight=weight),
            ),
            batches,
        )
        for weight in (0.0, 10.0)
    )  # fmt: skip
    assert much < 0.7 * without


def test_a_path_with_its_teachers_jerk_costs_nothing(teacher, data):
    alone = dataclasses.replace(teacher.config, sampling_steps=1, guidance=0.0)
    unguided = PathDiffuser(alone).eval()
    unguided.load_state_dict(teacher.state_dict())
    batches = drawn(unguided, data)
    _, parts = batches.loss(unguided, torch.Generator().manual_seed(0))
    assert float(parts["path"]) < 1e-8
    assert float(parts["jerk"]) < 1e-4
    batches.waypoints = unguided.straight.expand_as(batches.waypoints)
    _, parts = batches.loss(unguided, torch.Generator().manual_seed(0))
    assert float(parts["jerk"]) > 1


def test_a_run_goes_on_as_if_not_interrupted(teacher, data, tmp_path):
    class Stop(Exception):
        pass

    def stop(step, steps, figures):
        if step == 50:
            raise Stop

    whole = distill_path(teacher, data, data, tmp_path / "whole", SHORT)
    with pytest.raises(Stop):
        distill_path(teacher, data, data, tmp_path / "parts", SHORT, progress=stop)
    resumed = distill_path(teacher, data, data, tmp_path / "parts", SHORT)
    for name, tensor in whole.state_dict().items():
        assert torch.equal(tensor, resumed.state_dict()[name]), name


@pytest.mark.parametrize("settings", [{"dim": 3}, {"field": False}, {"guidance": 0.0}])
def test_any_teacher_and_a_run_in_parts(settings, tmp_path):
    """A run that was interrupted after a checkpoint ends as one that was not."""
    torch.manual_seed(0)
    shape = {"channels": (8, 16), "condition": 16, "encoder_width": 8, "resolution": 16}
    model = PathDiffuser(PathDiffuserConfig(**{"sigma": 0.15, **shape, **settings})).eval()
    model.signal.copy_(noise_schedule(100))
    torch.nn.init.normal_(model.unet.outlet.weight, std=0.3)
    config = DatasetConfig(dim=model.config.dim, sigma=0.15, scenes=3, cells=6, per_scene=17)
    data = generate(config, tmp_path / "data")
    short = dataclasses.replace(SHORT, steps=4, checkpoint_every=2, sampling_steps=2)
    whole = distill_path(model, data, data, tmp_path / "whole", short)

    def stop(step, steps, figures):
        if step == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        distill_path(model, data, data, tmp_path / "parts", short, progress=stop)
    resumed = distill_path(model, data, data, tmp_path / "parts", short)
    for name, tensor in whole.state_dict().items():
        assert torch.equal(tensor, resumed.state_dict()[name]), name
    trained = not settings.get("field", True)
    assert torch.equal(whole.no_field, model.no_field) != trained


def test_another_teacher_is_another_run(teacher, data, tmp_path):
    short = dataclasses.replace(SHORT, steps=1)
    distill_path(teacher, data, data, tmp_path, short)
    other = PathDiffuser(teacher.config)
    other.load_state_dict({k: v + 0.01 for k, v in teacher.state_dict().items()})
    with pytest.raises(CheckpointError, match="teacher"):
        distill_path(other, data, data, tmp_path, short)


def test_bad_input(teacher, data, tmp_path):
    other = PathDiffuser(dataclasses.replace(teacher.config, sigma=0.3))
    with pytest.raises(InvalidInputError, match=r"the data have sigma 0\.15, the model 0\.3"):
        distill_path(other, data, data, tmp_path, SHORT)
    reported = dataclasses.replace(
        data, config=dataclasses.replace(data.config, stream="evaluation")
    )
    assert isinstance(reported, Dataset)
    with pytest.raises(InvalidInputError, match="evaluations alone"):
        distill_path(teacher, reported, data, tmp_path, SHORT)
    with pytest.raises(InvalidInputError, match="sampling_steps must be at most 100, got 101"):
        distill_path(teacher, data, data, tmp_path, dataclasses.replace(SHORT, sampling_steps=101))
    for values, message in (
        ({"pairs": 0}, "pairs must be"),
        ({"ends": 1.0}, "ends must"),
        ({"sampling_steps": 0}, "sampling_steps must be"),
        ({"dropout": 0.1}, "dropout must be 0"),
        ({"jerk_weight": -0.1}, "jerk_weight must"),
    ):
        with pytest.raises(InvalidInputError, match=message):
            dataclasses.replace(SHORT, **values)
