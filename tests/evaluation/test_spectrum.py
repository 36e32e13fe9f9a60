"""The picture of the spectrum."""

import numpy as np
import pytest
from pictures import path_of
from PIL import Image

import legibility as lg
from legibility.curves import spaced
from legibility.drivers import Feedback
from legibility.envs import vector_type
from legibility.envs.fleet import Fleet
from legibility.errors import InvalidInputError, OutputError
from legibility.evaluation.comparison import SCENES
from legibility.evaluation.spectrum import Spectrum
from legibility.figures.paper import spectrum_figure
from legibility.intent.metrics import potential_cost
from legibility.rollout import follow

LEVELS = (-1.0, 0.0, 1.0)


@pytest.fixture(scope="module", params=[2, 3])
def rollouts(request):
    """Three motions of an archive, in the default environment of the dimension."""
    dim = request.param
    if dim == 3:
        pytest.importorskip("mujoco", reason="the extra named panda is not installed")
    scene = lg.Scene.random(np.random.default_rng(3), dim=dim, num_goals=2)
    archive = lg.build_archive(scene, cells=8, random_candidates=512, max_candidates=2048)
    plans = [path_of(archive, level) for level in LEVELS]
    env = vector_type(None, dim)(len(LEVELS))
    env.reset(seed=0, options={"scene": scene})
    return follow(Fleet(env, 0), plans, Feedback())


@pytest.mark.parametrize("suffix", [".png", ".pdf"])
def test_is_written(rollouts, tmp_path, suffix, recwarn):
    file = tmp_path / f"spectrum{suffix}"
    spectrum_figure([Spectrum.of(rollouts)], file)
    assert file.stat().st_size > 5000
    if suffix == ".png":
        picture = np.asarray(Image.open(file).convert("RGB"))
        assert picture.shape[1] > 2000
        left = picture[:, : picture.shape[1] // 2]
        assert len(np.unique(left.reshape(-1, 3), axis=0)) > 50


def test_costs_are_those_of_the_motions(rollouts, tmp_path, monkeypatch):
    import contextlib

    from matplotlib.figure import Figure

    figure = Figure()

    @contextlib.contextmanager
    def keep(file, width, height):
        yield figure

    monkeypatch.setattr("legibility.figures.paper.figure_file", keep)
    spectrum_figure([Spectrum.of(rollouts[::-1])], tmp_path / "x.png")
    line = figure.axes[-1].lines[0]
    np.testing.assert_array_equal(line.get_xdata(), LEVELS)
    spacing = SCENES[rollouts[0].path.scene.dim].spacing
    costs = [
        potential_cost(spaced(r.states, spacing), r.path.field, r.path.target) for r in rollouts
    ]
    np.testing.assert_allclose(line.get_ydata(), costs)
    assert costs[0] > costs[1]


def test_refuses(rollouts, tmp_path):
    with pytest.raises(InvalidInputError, match="at least one motion"):
        Spectrum.of([])
    with pytest.raises(OutputError, match="must end in"):
        spectrum_figure([Spectrum.of(rollouts)], tmp_path / "x.gif")
