"""The paths and actions of onnxruntime are those of PyTorch."""

import dataclasses
import pickle
import sys

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from legibility import Scene
from legibility.curves import NUM_WAYPOINTS
from legibility.data.rooms import random_observer, random_room
from legibility.envs.block_reach_2d import BlockReach2DVector
from legibility.errors import CheckpointError, InvalidInputError, MissingExtraError
from legibility.models import onnx
from legibility.models.configuration import PathDiffuserConfig, PathPolicyConfig
from legibility.models.diffusion import noise_schedule
from legibility.models.path_diffuser import PathDiffuser
from legibility.models.path_policy import Observation, PathPolicy
from legibility.models.pretrained import load_stages, pretrained_folder, pretrained_names
from legibility.modulator import Modulator

seeds = st.integers(0, 2**32 - 1)
TINY = {"channels": (8, 16), "condition": 16, "encoder_width": 8, "resolution": 16}


def runtime(*packages):
    for package in packages or ("onnxruntime",):
        pytest.importorskip(package, reason="the backend onnx is NOT TESTED: install it")


@pytest.fixture(scope="module", params=pretrained_names())
def pair(request):
    """A shipped model with the backends torch and onnx."""
    runtime()
    return [Modulator.from_pretrained(request.param, backend=b) for b in ("torch", "onnx")]


@given(
    seed=seeds,
    goals=st.integers(2, 6),
    levels=st.one_of(st.floats(-1, 1), st.lists(st.floats(-1, 1), min_size=1, max_size=5)),
)
@settings(max_examples=30, deadline=None)
def test_paths_are_the_same(pair, seed, goals, levels):
    one, two = pair
    rng = np.random.default_rng(seed)
    scene = Scene.random(rng, dim=one.config.dim, num_goals=goals)
    target = int(rng.integers(goals))
    expected = one.plan(scene, target, levels, seed=seed).waypoints
    actual = two.plan(scene, target, levels, seed=seed).waypoints
    np.testing.assert_allclose(actual, expected, atol=1e-5)


@pytest.mark.parametrize("size", [1, 7, 16, 17, 150])
def test_batches_and_scenes_of_any_number_are_the_same(pair, size):
    dim, levels = pair[0].config.dim, np.linspace(-1, 1, size)
    scenes = [Scene.random(np.random.default_rng(i), dim=dim) for i in range(size)]
    one, two = (model.plan(scenes[0], 0, levels).waypoints for model in pair)
    np.testing.assert_allclose(two, one, atol=1e-5)
    ours, theirs = (model.plan_many(scenes, [0] * size, levels) for model in pair)
    for a, b in zip(ours, theirs, strict=True):
        np.testing.assert_allclose(b.waypoints, a.waypoints, atol=1e-5)


def test_only_the_models_own_steps_and_guidance_are_run(pair):
    config, model = pair[1].config, pair[1]
    scene = Scene.random(np.random.default_rng(1), dim=config.dim)
    options = {"guidance": config.guidance, "steps": config.sampling_steps}
    path = model.plan(scene, 0, 0.3, **options)
    np.testing.assert_array_equal(path.waypoints, model.plan(scene, 0, 0.3).waypoints)
    for name, own in options.items():
        with pytest.raises(InvalidInputError, match=rf"{own:g}.*only, got.*{own + 1:g}"):
            model.plan(scene, 0, 0.3, **{name: own + 1})


def observed(model, size):
    rng, dim = np.random.default_rng(0), model.config.dim
    features = rng.normal(size=(size, model.observe.in_features)).astype(np.float32)
    turn = np.linalg.qr(rng.normal(size=(size, dim, dim)))[0]
    return Observation(features, turn, rng.random(size) < 0.5)


@pytest.mark.parametrize("size", [1, 5, 100])
def test_actions_are_the_same(pair, size):
    policy = pair[0].path_policy
    observation = observed(policy, size)
    actions = pair[1]._policy.act(observation)
    np.testing.assert_allclose(actions, policy.act(observation), atol=1e-6)
    with pytest.raises(InvalidInputError, match="steps"):
        pair[1]._policy.act(observation, policy.config.sampling_steps + 1)


def test_a_path_diffuser_of_other_settings_is_exported(tmp_path):
    """And takes any number of distractors, obstacles and polygons, also none, and any observer."""
    runtime("onnxruntime", "onnxscript")
    torch.manual_seed(0)
    dim = 2
    changes = {"dim": dim, "channels": (8,), "sampling_steps": 2, "guidance": 0.7}
    model = PathDiffuser(PathDiffuserConfig(**{**TINY, **changes})).eval()
    for parameter in model.parameters():
        torch.nn.init.normal_(parameter, std=0.2)
    model.spread.uniform_(0.5, 2)
    model.signal.copy_(noise_schedule(100))
    graph = onnx.load_graph(model, tmp_path)
    assert graph == (tmp_path / "path.onnx").read_bytes() == onnx.load_graph(model, tmp_path)
    exported = onnx.OnnxPathDiffuser(model, graph)
    level = torch.tensor([-1.0, 0.2, 1])
    noise = torch.randn(3, NUM_WAYPOINTS, dim)
    rng = np.random.default_rng(0)
    for goals, obstacles in (((2, 2), (0, 0)), ((2, 5), (0, 4)), ((8, 8), (6, 8))):
        scenes = [random_room(rng, dim=dim, goals=goals, obstacles=obstacles) for _ in range(3)]
        observers = [random_observer(rng, scene, model.config.observer) for scene in scenes]
        for number in (3, 1):  # a scene for each level, or one for all
            conditions = model.conditions(scenes[:number], [0, 1, 0][:number], observers[:number])
            dial = torch.randn(number, 17)
            expected = model.sample(conditions, level, noise, dial=dial)
            actual = exported.sample(conditions, level, noise, dial=dial)
            torch.testing.assert_close(actual, expected, atol=1e-4, rtol=1e-4)


def test_a_policy_of_other_settings_is_exported_and_takes_any_weights():
    runtime("onnxruntime", "onnxscript")
    graph = None
    for seed in range(2):
        torch.manual_seed(seed)
        model = PathPolicy(PathPolicyConfig(dim=3, chunk=4, channels=(8, 16), condition=16)).eval()
        for parameter in model.parameters():
            torch.nn.init.normal_(parameter, std=0.2)
        model.signal.copy_(noise_schedule(100))
        graph = graph or onnx.export_graph(model)
        observation = observed(model, 3)
        actions = onnx.OnnxPathPolicy(model, graph).act(observation)
        np.testing.assert_allclose(actions, model.act(observation), atol=1e-6)


class TestStoredGraph:
    @pytest.fixture
    def model(self):
        return PathDiffuser(PathDiffuserConfig(**TINY))

    @pytest.fixture
    def exported(self, monkeypatch):
        """Models that were exported, without the time that it takes."""
        models = []

        def export(model):
            models.append(model)
            return onnx._fingerprint(model).encode()

        monkeypatch.setattr(onnx, "export_graph", export)
        return models

    @pytest.mark.parametrize("name", pretrained_names())
    def test_fits_the_shipped_weights(self, name, exported):
        folder = pretrained_folder(name)
        for model in load_stages(folder)[0].values():
            assert len(onnx.load_graph(model, folder)) < 500_000
        assert exported == []

    def test_is_exported_once(self, model, exported, tmp_path):
        for _ in range(2):
            onnx.load_graph(model, tmp_path)
        assert exported == [model]

    @pytest.mark.parametrize(
        ("name", "value"),
        [("guidance", 0.1), ("sampling_steps", 2), ("squash", 0.2), ("channels", (8, 8))],
    )
    def test_of_other_settings_is_replaced(self, model, exported, tmp_path, name, value):
        onnx.load_graph(model, tmp_path)
        other = PathDiffuser(dataclasses.replace(model.config, **{name: value}))
        onnx.load_graph(other, tmp_path)
        assert exported == [model, other]

    def test_in_a_folder_that_cannot_be_written_to_is_not_kept(self, model, exported, tmp_path):
        (tmp_path / "file").touch()
        for _ in range(2):
            onnx.load_graph(model, tmp_path / "file")
        assert exported == [model, model]

    @pytest.mark.parametrize(
        "graph", [b"\0" * 99, b"<weights>no.such</weights>", b"<weights>\xff</weights>"]
    )
    def test_is_corrupted(self, model, graph):
        runtime()
        with pytest.raises(CheckpointError, match="graph"):
            onnx.OnnxPathDiffuser(model, graph)

    def test_without_the_exporter(self, model, tmp_path, monkeypatch):
        monkeypatch.setitem(sys.modules, "onnxscript", None)
        with pytest.raises(MissingExtraError, match=r"pip install 'legibility\[export\]'"):
            onnx.load_graph(model, tmp_path)


def test_executed_motions_are_the_same():
    runtime()
    rollouts = []
    for backend in ("torch", "onnx"):
        env = BlockReach2DVector(3)
        env.reset(seed=0)
        model = Modulator.from_pretrained("block-reach-2d", backend=backend)
        rollouts.append(model.execute_many(env, legibility=[-1, 0, 1], seed=0))
    for one, two in zip(*rollouts, strict=True):
        assert (one.reason, len(one.states)) == (two.reason, len(two.states))
        np.testing.assert_allclose(two.states, one.states, atol=1e-4)


def test_a_model_goes_to_another_process():
    runtime()
    model = Modulator.from_pretrained("block-reach-2d", backend="onnx")
    other = pickle.loads(pickle.dumps(model))
    scene = Scene.random(np.random.default_rng(0))
    expected, actual = (m.plan(scene, 0, [-1, 0.3]).waypoints for m in (model, other))
    np.testing.assert_array_equal(actual, expected)
    rollouts = []
    for modulator in (model, other):
        env = BlockReach2DVector(2)
        env.reset(seed=0)
        rollouts.append(modulator.execute_many(env, legibility=[-1, 1], seed=0))
    for one, two in zip(*rollouts, strict=True):
        np.testing.assert_array_equal(two.states, one.states)


def test_missing_runtime_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'legibility\[onnx\]'"):
        Modulator.from_pretrained("block-reach-2d", backend="onnx")


def test_backend_that_is_missing():
    with pytest.raises(InvalidInputError, match=r"torch.*onnx.*'jax'"):
        Modulator.from_pretrained("block-reach-2d", backend="jax")
