"""Results that underflow are 0, however NumPy is told to handle floating-point errors."""

import numpy as np
import pytest

import legibility as lg
from legibility.data.configuration import DatasetConfig, DemonstrationsConfig
from legibility.data.dataset import generate
from legibility.data.demonstrations import demonstrate
from legibility.drivers import Feedback
from legibility.envs.block_reach_2d import BlockReach2DVector
from legibility.intent.metrics import COSTS
from legibility.intent.observer import Observer
from legibility.modulator import Modulator

SCENES = {
    "paper": lg.Scene([0, 0.5], [[0.8, 0.6], [1, 0.3]]),
    # Seen from here the target's potential is so small that exp(−x) underflows.
    "certain": lg.Scene([-1.9, 0.5], [[-1.7, 0.5], [1.9, 0.5]], [[-2, -1], [2, 2]]),
    "many": lg.Scene.random(np.random.default_rng(0), num_goals=6),
    "arm": lg.Scene.random(np.random.default_rng(0), dim=3),
}
MODELS = {2: "block-reach-2d", 3: "panda-block-reach"}


@pytest.fixture(autouse=True)
def every_error_raises():
    with np.errstate(all="raise"):
        yield


@pytest.fixture(params=SCENES.values(), ids=SCENES)
def scene(request):
    return request.param


@pytest.fixture(scope="module")
def modulators():
    return {dim: Modulator.from_pretrained(name) for dim, name in MODELS.items()}


def test_plan(scene, modulators):
    path = modulators[scene.dim].plan(scene, 0, [-1, 0, 1], num_candidates=2)
    assert np.isfinite(path.score).all()
    assert np.isfinite(path.achieved).all()
    (many,) = modulators[scene.dim].plan_many([scene], 0, 0.5)
    assert np.isfinite(many.trajectory()).all()


@pytest.mark.parametrize("driver", [None, Feedback()], ids=["policy", "feedback"])
def test_execute(modulators, driver):
    scenes = [SCENES["paper"], SCENES["many"]]
    env = BlockReach2DVector(2)
    env.reset(seed=0, options={"scene": scenes, "push": 0.1, "shift": 0.05})
    for rollout in modulators[2].execute_many(env, legibility=[-1, 1], driver=driver):
        assert np.isfinite([rollout.score, rollout.achieved]).all()


def test_an_environment_at_rest():
    env = BlockReach2DVector(1)
    env.reset(seed=0)
    env.step(np.full((1, 2), 0.05))
    for _ in range(390):  # the last displacement fades until its square underflows
        env.step(np.zeros((1, 2)))


@pytest.mark.parametrize("label", ["anchored", "rank"])
def test_archive(scene, label):
    archive = lg.build_archive(scene, observer=Observer(label=label))
    assert np.isfinite(archive.labels).all()
    assert np.isfinite(archive.label_of(archive.score_of([-1, 0.3, 1]))).all()
    assert archive.nearest(0.2) < len(archive)
    lg.build_archive(scene, observer=Observer(label=label, alpha=1000))


@pytest.mark.parametrize("reach", [1e-200, 1, 1e3, 1e100])
def test_metrics(scene, reach):
    rng = np.random.default_rng(0)
    trajectories = reach * rng.normal(size=(3, 20, scene.dim))
    trajectories[0] = scene.start
    for sigma in (1e-3, 0.15, 1e3):
        field = lg.InformationPotentialField(scene.goals, sigma)
        posterior = field.posterior(trajectories)
        np.testing.assert_allclose(posterior.sum(-1), 1)
        rating = lg.metrics.evaluate_trajectory(trajectories, field, 0, alpha=100)
        assert not any(np.isnan(values).any() for values in rating.values())
        field.grid(scene.workspace, 8, 0)
    for cost in COSTS:
        lg.metrics.trajectory_cost(trajectories, cost)
        lg.metrics.dragan_legibility(trajectories, scene.goals, 0, cost=cost)
    lg.metrics.budgeted_legibility([1e-300, 1], [1, 1e-300], 1e-200)
    lg.metrics.regularised_legibility([1e-300, 1], [1, 1e-300], 1e-200)
    lg.labels.rank_label([1e-320, 0, 1e300])
    lg.labels.anchored_label([1e-320, 0, 1e300], 1e-310)


@pytest.mark.parametrize("dim", [2, 3])
def test_dataset(dim, tmp_path):
    config = DatasetConfig(
        dim=dim, scenes=3, regime="observers", cells=8, per_scene=9, efficiency=1e-3
    )
    generate(config, tmp_path)
    if dim == 2:
        demonstrate(tmp_path, DemonstrationsConfig(demonstrations=1))
