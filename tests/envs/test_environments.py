"""Environments by name."""

import subprocess
import sys

import gymnasium
import numpy as np
import pytest
from episodes import equal, toward

from legibility.envs import DEFAULT_ENVIRONMENT, ENVIRONMENTS, MAX_EPISODE_STEPS, vector_type
from legibility.errors import InvalidInputError
from legibility.scene import Scene

NEEDS = {"2d": (), "panda": ("mujoco", "mink"), "pandagym": ("panda_gym", "pybullet")}


@pytest.fixture(params=ENVIRONMENTS)
def name(request):
    for module in NEEDS[request.param]:
        pytest.importorskip(module, reason=f"{request.param} needs {module}")
    return request.param


def test_one_by_its_name(name):
    kind = ENVIRONMENTS[name].partition(":")[2]
    dim = 2 if name == "2d" else 3
    assert vector_type(name, dim).__name__ == f"{kind}Vector"
    spec = gymnasium.spec(f"legibility/{kind}-v0")
    assert spec.max_episode_steps == MAX_EPISODE_STEPS
    with gymnasium.make(spec) as one:
        assert type(one.unwrapped).__name__ == kind
        assert isinstance(one.unwrapped.batch, vector_type(name, dim))
        assert one.unwrapped.spec is not None


def test_the_default_is_of_the_dimension(name):
    for dim, default in DEFAULT_ENVIRONMENT.items():
        if default == name:
            assert vector_type(None, dim) is vector_type(name, dim)
            assert vector_type(name, dim).dim == dim


def test_every_position_is_a_start(name):
    """Also that of an arm which overshoots a wall."""
    env = vector_type(name, 2 if name == "2d" else 3)(4)
    env.reset(seed=0)
    low, high = env.workspace
    rng, beyond = np.random.default_rng(0), 0.0
    for step in range(60):
        if step % 10 == 0:
            directions = rng.choice([-1, 1], size=(4, env.dim))
        env.step(env.max_displacement * directions)
        beyond = max(beyond, (low - env.positions).max(), (env.positions - high).max())
        for scene, position in zip(env.scenes, env.positions, strict=True):
            start = Scene(position, scene.goals, scene.workspace).start
            np.testing.assert_array_equal(start, np.clip(position, low, high))
    assert (beyond > 1e-6) == (name != "2d")


def test_all_arms_have_one_interface():
    for module in (*NEEDS["panda"], *NEEDS["pandagym"]):
        pytest.importorskip(module, reason=f"to compare the arms {module} is needed")
    one, other = (vector_type(name, 3)(1) for name in ("panda", "pandagym"))
    assert one.single_action_space == other.single_action_space
    assert one.single_observation_space == other.single_observation_space
    infos = [env.reset(seed=0)[1] for env in (one, other)]
    assert infos[0].keys() == infos[1].keys()
    assert one.scenes == other.scenes
    assert one.joint_angles.shape == other.joint_angles.shape == (1, 7)
    assert one.metadata == other.metadata
    names = ("PandaBlockReach", "PandaGymBlockReach")
    ones = [gymnasium.make(f"legibility/{kind}-v0").unwrapped for kind in names]
    assert ones[0].metadata == ones[1].metadata


@pytest.mark.parametrize(
    ("name", "dim", "match"),
    [("3d", 3, "env must be one of 2d, panda, pandagym, got '3d'"),
     ("2d", 3, "the environment 2d is 2-D, the model or scene 3-D")],
)  # fmt: skip
def test_refuses(name, dim, match):
    with pytest.raises(InvalidInputError, match=match):
        vector_type(name, dim)


@pytest.mark.parametrize(
    ("name", "module"), [("panda", "mujoco"), ("panda", "mink"), ("pandagym", "pybullet")]
)
def test_a_missing_extra_is_named(name, module):
    code = (
        f"import sys; sys.modules[{module!r}] = None\n"
        "from legibility.envs import vector_type\n"
        f"vector_type({name!r}, 3)(1)"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert run.returncode == 1
    last = run.stderr.splitlines()[-1]
    assert "MissingExtraError" in last
    assert f"pip install 'legibility[{name}]'" in last


def test_global_settings_of_numpy_and_torch_change_nothing(name):
    torch = pytest.importorskip("torch")

    def episode():
        env = vector_type(name, 2 if name == "2d" else 3)(2, render_mode="rgb_array")
        options = {"noise": 0.002, "push": 0.05, "shift": 0.05}
        results = [env.reset(seed=1, options=options)]
        results += [env.step(toward(env)) for _ in range(25)]
        results += [env.step(np.zeros_like(env.positions)) for _ in range(5)]
        return (*results, env.render() if name == "2d" else ())

    expected = episode()
    torch.set_default_dtype(torch.float64)
    try:
        with np.errstate(all="raise"):
            assert equal(episode(), expected)
    finally:
        torch.set_default_dtype(torch.float32)
