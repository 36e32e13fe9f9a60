"""What onnxruntime draws is what PyTorch draws."""

import pickle
import sys

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from legibility import Scene
from legibility.envs.block_reach_2d import BlockReach2DVector
from legibility.errors import InvalidInputError, MissingExtraError
from legibility.models.configuration import PathDiffuserConfig, PathPolicyConfig
from legibility.models.diffusion import noise_schedule
from legibility.models.path_diffuser import PathDiffuser
from legibility.models.path_policy import Observation, PathPolicy
from legibility.models.pretrained import pretrained_names
from legibility.modulator import Modulator

seeds = st.integers(0, 2**32 - 1)


@pytest.fixture(autouse=True)
def _installed(request):
    if "missing" not in request.node.name:
        reason = "the backend onnx is NOT TESTED: pip install 'legibility[onnx]'"
        pytest.importorskip("onnx", reason=reason)
        pytest.importorskip("onnxruntime", reason=reason)


@pytest.fixture(scope="module", params=pretrained_names())
def pair(request):
    """A shipped model as PyTorch runs it, and as onnxruntime does."""
    pytest.importorskip("onnxruntime", reason="the backend onnx is NOT TESTED")
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
    found = two.plan(scene, target, levels, seed=seed).waypoints
    np.testing.assert_allclose(found, expected, atol=1e-5)


@pytest.mark.parametrize(
    "options", [{"guidance": 0.0}, {"guidance": 1.0, "steps": 1}, {"steps": 5}]
)
def test_guidance_and_steps_are_heeded(pair, options):
    if pair[0].distilled:
        pytest.skip("a student has no others than its own")
    scene = Scene.random(np.random.default_rng(1), dim=pair[0].config.dim)
    default, *paths = (
        model.plan(scene, 0, [-1, 0.3, 1], **given).waypoints
        for model, given in ((pair[1], {}), (pair[0], options), (pair[1], options))
    )
    np.testing.assert_allclose(paths[1], paths[0], atol=1e-5)
    assert np.abs(paths[1] - default).max() > 1e-4


def test_large_batches_and_many_scenes_are_the_same_whatever_the_threads(pair):
    dim, levels = pair[0].config.dim, np.linspace(-1, 1, 150)
    scenes = [Scene.random(np.random.default_rng(i), dim=dim) for i in range(150)]
    threads = torch.get_num_threads()
    try:
        for number in (1, 2):
            torch.set_num_threads(number)
            one, two = (model.plan(scenes[0], 0, levels).waypoints for model in pair)
            np.testing.assert_allclose(two, one, atol=1e-5)
            ours, theirs = (model.plan_many(scenes, [0] * 150, levels) for model in pair)
            for a, b in zip(ours, theirs, strict=True):
                np.testing.assert_allclose(b.waypoints, a.waypoints, atol=1e-5)
    finally:
        torch.set_num_threads(threads)


@pytest.mark.parametrize("field", [True, False])
@pytest.mark.parametrize("channels", [(8,), (8, 16), (8, 16, 16), (8, 8, 16, 16)])
@pytest.mark.parametrize("dim", [2, 3])
def test_networks_of_any_shape(dim, channels, field):
    from legibility.models.onnx import OnnxPathDiffuser

    torch.manual_seed(0)
    shape = {"condition": 16, "encoder_width": 8, "resolution": 16}
    model = PathDiffuser(
        PathDiffuserConfig(dim=dim, channels=channels, field=field, **shape)
    ).eval()
    torch.nn.init.normal_(model.unet.outlet.weight, std=0.3)
    torch.nn.init.normal_(model.no_field)
    torch.nn.init.normal_(model.no_level)
    for block in model.unet.blocks():
        for norm in block.norms:
            torch.nn.init.normal_(norm.weight)
            torch.nn.init.normal_(norm.bias)
    model.spread.uniform_(0.5, 2)
    model.signal.copy_(noise_schedule(100))
    scenes = [Scene.random(np.random.default_rng(i), dim=dim, num_goals=2 + i) for i in range(3)]
    conditions, level = model.conditions(scenes, [0, 1, 2]), torch.tensor([-1.0, 0.2, 1])
    noise = torch.randn(3, 8, dim)
    expected = model.sample(conditions, level, noise)
    found = OnnxPathDiffuser(model).sample(conditions, level, noise)
    torch.testing.assert_close(found, expected, atol=1e-5, rtol=1e-5)


@pytest.mark.parametrize("steps", [None, 1, 4])
@pytest.mark.parametrize("size", [1, 100])
@pytest.mark.parametrize("dim", [2, 3])
def test_actions_are_the_same(dim, size, steps):
    from legibility.models.onnx import OnnxPathPolicy

    torch.manual_seed(0)
    model = PathPolicy(PathPolicyConfig(dim=dim, channels=(8, 16), condition=16)).eval()
    torch.nn.init.normal_(model.unet.outlet.weight)
    torch.nn.init.normal_(model.no_path)
    model.scale.fill_(0.4)
    model.signal.copy_(noise_schedule(100))
    rng = np.random.default_rng(0)
    features = rng.normal(size=(size, model.observe.in_features)).astype(np.float32)
    turn = np.linalg.qr(rng.normal(size=(size, dim, dim)))[0]
    observation = Observation(features, turn, rng.random(size) < 0.5)
    noise = torch.randn(size, 8, dim)
    np.testing.assert_allclose(
        OnnxPathPolicy(model).act(observation, noise, steps),
        model.act(observation, noise, steps),
        atol=1e-6,
    )


def test_executed_motions_are_the_same():
    rollouts = []
    for backend in ("torch", "onnx"):
        env = BlockReach2DVector(3)
        env.reset(seed=0)
        model = Modulator.from_pretrained("block-reach-2d", backend=backend)
        rollouts.append(model.execute(env, legibility=[-1, 0, 1], seed=0))
    for one, two in zip(*rollouts, strict=True):
        assert (one.reason, len(one.states)) == (two.reason, len(two.states))
        np.testing.assert_allclose(two.states, one.states, atol=1e-4)


def test_a_model_goes_to_another_process():
    model = Modulator.from_pretrained("block-reach-2d", backend="onnx")
    other = pickle.loads(pickle.dumps(model))
    scene = Scene.random(np.random.default_rng(0))
    expected, found = (m.plan(scene, 0, [-1, 0.3]).waypoints for m in (model, other))
    np.testing.assert_array_equal(found, expected)
    rollouts = []
    for each in (model, other):
        env = BlockReach2DVector(2)
        env.reset(seed=0)
        rollouts.append(each.execute(env, legibility=[-1, 1], seed=0))
    for one, two in zip(*rollouts, strict=True):
        np.testing.assert_array_equal(two.states, one.states)


def test_missing_runtime_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'legibility\[onnx\]'"):
        Modulator.from_pretrained("block-reach-2d", backend="onnx")


def test_backend_that_is_missing():
    with pytest.raises(InvalidInputError, match=r"torch.*onnx.*'jax'"):
        Modulator.from_pretrained("block-reach-2d", backend="jax")
