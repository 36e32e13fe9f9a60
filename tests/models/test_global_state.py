"""Plans and actions are the same whatever PyTorch's global state, to rounding."""

import contextlib

import numpy as np
import pytest
import torch

from legibility import Scene
from legibility.models.path_policy import Observation
from legibility.models.pretrained import load_stages, pretrained_folder, pretrained_names
from legibility.modulator import Modulator

BACKENDS = ["torch", "onnx"]


@contextlib.contextmanager
def restored(set_state, value, default):
    set_state(value)
    try:
        yield
    finally:
        set_state(default)


STATES = {
    "default dtype": lambda: restored(torch.set_default_dtype, torch.float64, torch.float32),
    "half": lambda: restored(torch.set_default_dtype, torch.float16, torch.float32),
    "default device": lambda: restored(torch.set_default_device, "meta", None),
    "device context": lambda: torch.device("meta"),
    "inference mode": torch.inference_mode,
    "no gradients": torch.no_grad,
    "autocast": lambda: torch.autocast("cpu", dtype=torch.bfloat16),
    "threads": lambda: restored(torch.set_num_threads, 2, torch.get_num_threads()),
}


def plans(model):
    scenes = [Scene.random(np.random.default_rng(i), dim=model.config.dim) for i in range(3)]
    one = model.plan(scenes[0], 0, [-1, -0.4, 0, 1], seed=1)
    many = model.plan_many(scenes, [0, 1, 0], [-1, 0.5, 1])
    return np.concatenate([one.waypoints, [path.waypoints for path in many]])


def actions(model):
    """Of stage 2 as the backend runs it."""
    policy, rng = model.path_policy, np.random.default_rng(0)
    dim = policy.config.dim
    features = rng.normal(size=(4, policy.observe.in_features)).astype(np.float32)
    observation = Observation(features, np.stack([np.eye(dim)] * 4), rng.random(4) < 0.5)
    return model._policy.act(observation)


def load(name, backend):
    if backend == "onnx":
        pytest.importorskip("onnxruntime", reason="the backend onnx is NOT TESTED")
    return Modulator.from_pretrained(name, backend=backend)


@pytest.mark.parametrize("state", STATES)
@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("name", pretrained_names())
def test_plans_and_actions_are_the_same(name, backend, state):
    model = load(name, backend)
    expected = plans(model), actions(model)
    with STATES[state]():
        for other in (model, load(name, backend)):
            np.testing.assert_allclose(plans(other), expected[0], atol=1e-5)
            np.testing.assert_allclose(actions(other), expected[1], atol=1e-5)
    loaded_there = other
    np.testing.assert_allclose(plans(loaded_there), expected[0], atol=1e-5)


@pytest.mark.parametrize("state", STATES)
def test_actions_of_a_baseline_are_the_same(state):
    def act(model):
        rng, config = np.random.default_rng(0), model.config
        features = rng.normal(size=(3, 2, model.observe.in_features)).astype(np.float32)
        weights = np.tile([1.5, -0.5], (3, 1))
        noise = torch.from_numpy(rng.normal(size=(3, config.chunk, config.dim)).astype(np.float32))
        return model.act(features, np.array([True, False]), weights, noise)

    def load_goal():
        return load_stages(pretrained_folder(pretrained_names("goal")[0]))[0]["goal"].eval()

    model = load_goal()
    expected = act(model)
    with STATES[state]():
        for other in (model, load_goal()):
            np.testing.assert_allclose(act(other), expected, atol=1e-5)
