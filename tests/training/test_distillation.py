"""A student draws what its teacher draws, in fewer steps."""

import dataclasses

import numpy as np
import pytest
import torch
from trainings import CPU, assert_same_run, rows, stop_at, tiny_diffuser

from legibility.data.configuration import DatasetConfig
from legibility.data.dataset import generate
from legibility.errors import CheckpointError, InvalidInputError
from legibility.intent.observer import Observer
from legibility.models.path_diffuser import PathDiffuser
from legibility.models.provenance import TeacherRecord
from legibility.training.configuration import DistillationConfig
from legibility.training.loop import Run
from legibility.training.path import DistillationBatches, distill_path

SHORT = DistillationConfig(
    steps=60, scenes=4, per_scene=8, pairs=12, ends=0.25, warmup=3, learning_rate=2e-3, ema=0.9,
    score_weight=0.0, contact_weight=0.0, validate_every=60, checkpoint_every=40,
)  # fmt: skip
BRIEF = dataclasses.replace(SHORT, steps=4, checkpoint_every=2)


@pytest.fixture(scope="module")
def data(data):
    return data.first(2)  # two views of each


def make_teacher(data, seed=0, std=0.3, **settings):
    """One whose paths depend on the noise and whose guidance counts."""
    model = tiny_diffuser(data, seed, **{"guidance": 0.5, **settings}).eval().requires_grad_(False)
    generator = torch.Generator().manual_seed(seed)
    torch.nn.init.normal_(model.unet.outlet.weight, std=std, generator=generator)
    torch.nn.init.normal_(model.no_field, generator=generator)
    torch.nn.init.normal_(model.no_level, generator=generator)
    return model


@pytest.fixture(scope="module")
def teacher(data):
    return make_teacher(data)


def distill(teacher, data, run, config, **options):
    """A student that is validated in the scenes of its training."""
    weights = sum(float(p.double().abs().sum()) for p in teacher.state_dict().values())
    settings = teacher.config.sampling_steps, teacher.config.guidance
    record = TeacherRecord(str(weights), *settings)
    return distill_path(teacher, data, data, run, config, record, **options)


def distance(model, batches):
    """Mean distance of what `model` draws from the pairs of `batches`."""
    scenes = torch.arange(len(batches.labels)).repeat_interleave(batches.labels.shape[1])
    paths = model.sample(
        batches.conditions.map(lambda x: x[scenes]),
        batches.labels.flatten(),
        batches.noise.flatten(0, 1),
        dial=batches.dials[scenes],
    )
    return float((paths - batches.waypoints.flatten(0, 1)).norm(dim=-1).mean())


def drawn(teacher, data, config=SHORT):
    batches = DistillationBatches(data, teacher, config, CPU)
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
def test_a_student_learns_what_its_teacher_draws(data, tmp_path, steps):
    """The worst of five seeds on two instruction sets: 0.44 of the distance before."""
    teacher = make_teacher(data, std=0.1)
    config = dataclasses.replace(SHORT, sampling_steps=steps, learning_rate=5e-3, jerk_weight=0.0)
    seen = []
    student = distill(
        teacher, data, Run(tmp_path, CPU), config, drawn=lambda *at: seen.append(at)
    ).model
    assert seen[-1] == (4, 4)
    assert student.config == dataclasses.replace(
        teacher.config, sampling_steps=steps, guidance=0.0, distilled=True
    )
    batches = drawn(teacher, data, config)
    untrained = PathDiffuser(student.config).eval()
    untrained.load_state_dict(teacher.state_dict())
    assert distance(student, batches) < 0.75 * distance(untrained, batches)
    last = rows(tmp_path)[-1]
    assert {"loss", "path", "label", "contact", "jerk"} <= last.keys()


def test_a_finished_run_draws_nothing(teacher, data, tmp_path):
    seen = []
    first, again = (
        distill(teacher, data, Run(tmp_path, CPU), BRIEF, drawn=lambda *at: seen.append(at)).model
        for _ in range(2)
    )
    assert seen.count((4, 4)) == 1
    assert torch.equal(first.level.weight, again.level.weight)


WEIGHTS = {"label": "score_weight", "contact": "contact_weight", "jerk": "jerk_weight"}


@pytest.mark.parametrize("part", WEIGHTS)
@pytest.mark.parametrize("seed", range(2))
def test_a_part_of_the_loss_counts_by_its_weight_and_falls_along_its_gradient(data, part, seed):
    teacher = make_teacher(data, seed)
    student = tiny_diffuser(data, seed + 10, sampling_steps=1, guidance=0.0)
    generator = torch.Generator().manual_seed(seed)
    torch.nn.init.normal_(student.unet.outlet.weight, std=0.3, generator=generator)
    if part != "label":
        student.spread *= 3  # so that its paths leave the workspace and have more jerk
    config = dataclasses.replace(SHORT, per_scene=32, jerk_weight=0.0)
    batches = drawn(teacher, data, config)

    def loss(weight):
        batches.config = dataclasses.replace(config, **{WEIGHTS[part]: weight})
        return batches.loss(student, torch.Generator().manual_seed(seed))

    (with_it, parts), (without, _) = loss(2.0), loss(0.0)
    torch.testing.assert_close((with_it - without).detach(), 2 * parts[part], rtol=1e-3, atol=1e-5)
    (with_it - without).backward()
    gradients = [(p, p.grad / 2) for p in student.parameters() if p.grad is not None]
    slope = float(sum(g.square().sum() for _, g in gradients))
    assert slope > 0
    step = 2e-4 * float(parts[part]) / slope
    with torch.no_grad():
        for parameter, gradient in gradients:
            parameter -= step * gradient
    fall = float(parts[part] - loss(0.0)[1][part])
    assert 0.3 * step * slope < fall < 2 * step * slope


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


@pytest.mark.parametrize("settings", [{}, {"dim": 3}, {"field": False}, {"guidance": 0.0}], ids=str)
def test_any_teacher_and_a_run_in_parts(settings, data, tmp_path):
    """A run that was interrupted after a checkpoint ends as one that was not."""
    if settings.get("dim") == 3:
        config = DatasetConfig(
            dim=3, scenes=2, views=1, cells=5, per_scene=17, candidates=4096, regime="all"
        )
        data = generate(config, tmp_path / "data")
    model = make_teacher(data, **settings)
    config = dataclasses.replace(BRIEF, sampling_steps=2)

    def student(name, **options):
        return distill(model, data, Run(tmp_path / name, CPU, **options), config).model

    whole = student("whole")
    with pytest.raises(KeyboardInterrupt):
        student("parts", progress=stop_at(3))
    student("parts")
    assert_same_run(tmp_path / "whole", tmp_path / "parts")
    trained = not settings.get("field", True)
    assert torch.equal(whole.no_field, model.no_field) != trained


def test_another_teacher_is_another_run(teacher, data, tmp_path):
    run = Run(tmp_path, CPU)
    distill(teacher, data, run, BRIEF)
    other = PathDiffuser(teacher.config)
    other.load_state_dict({k: v + 0.01 for k, v in teacher.state_dict().items()})
    with pytest.raises(CheckpointError, match=r"teacher\.sha256 is '"):
        distill(other, data, run, BRIEF)
    stronger = PathDiffuser(dataclasses.replace(teacher.config, guidance=0.7))
    stronger.load_state_dict(teacher.state_dict())
    with pytest.raises(CheckpointError, match=r"teacher\.guidance is 0\.5 in .* and 0\.7 now"):
        distill(stronger, data, run, BRIEF)


def test_record_of_the_teacher(teacher, data, tmp_path):
    record = TeacherRecord("abc", 3, 0.5)
    run = Run(tmp_path, CPU)
    assert distill_path(teacher, data, data, run, BRIEF, record).record.teacher == record


def test_bad_input(teacher, data, tmp_path):
    run = Run(tmp_path, CPU)
    other = PathDiffuser(dataclasses.replace(teacher.config, observer=Observer(alpha=1.0)))
    with pytest.raises(InvalidInputError, match=r"the data have alpha 3\.0, the model 1\.0"):
        distill(other, data, run, SHORT)
    with pytest.raises(InvalidInputError, match="sampling_steps must be at most 100, got 101"):
        distill(teacher, data, run, dataclasses.replace(SHORT, sampling_steps=101))
    for values, message in (
        ({"pairs": 0}, "pairs must be"),
        ({"ends": 1.0}, "ends must"),
        ({"sampling_steps": 0}, "sampling_steps must be"),
        ({"dropout": 0.1}, "dropout must be 0"),
        ({"jerk_weight": -0.1}, "jerk_weight must"),
    ):
        with pytest.raises(InvalidInputError, match=message):
            dataclasses.replace(SHORT, **values)
