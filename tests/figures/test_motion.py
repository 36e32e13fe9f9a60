"""The figure of timed motions shows what they are."""

import contextlib
import dataclasses

import matplotlib.image
import numpy as np
import pytest

import legibility as lg
from legibility.errors import InvalidInputError, OutputError

pytest.importorskip("toppra", reason="timed motions are NOT TESTED")

from legibility.figures import motion as figures

SCENE = lg.Scene([0, 0.5], [[0.8, 0.6], [1, 0.3]])


@pytest.fixture(scope="module")
def motions():
    path = lg.Modulator.from_pretrained("block-reach-2d").plan(SCENE, 0, [-1, 0, 1])
    return [path[i].timed(rate=50) for i in range(3)]


def panels_of(motions, file, monkeypatch):
    """The panels of the figure, `(rows, columns)`."""
    drawn, figure_file = [], figures.figure_file

    @contextlib.contextmanager
    def kept(*arguments):
        with figure_file(*arguments) as figure:
            drawn.append(figure)
            yield figure

    monkeypatch.setattr(figures, "figure_file", kept)
    figures.motion_figure(motions, file)
    return np.reshape(drawn[0].axes, (-1, len(motions)))


def test_panels(motions, tmp_path, monkeypatch):
    panels = panels_of(motions, file := tmp_path / "motions.png", monkeypatch)
    assert panels.shape == (3, 3)
    for column, motion in zip(panels.T, motions, strict=True):
        speed = column[0].lines[0].get_ydata()
        np.testing.assert_allclose(speed, np.linalg.norm(motion.velocities, axis=-1))
        for line in column[1].lines[:2]:
            assert 0.3 < line.get_ydata().max() <= 1
        beliefs = np.array([line.get_ydata() for line in column[2].lines[:2]])
        np.testing.assert_allclose(beliefs.T, motion.posterior, atol=1e-12)
        (diamond,) = column[2].lines[3:]
        assert diamond.get_xdata()[0] == pytest.approx(motion.time_to_confidence)
        assert f"{motion.duration:.2f} s" in column[0].get_title()
    assert matplotlib.image.imread(file).std() > 0.05


def test_another_observer_has_a_row(tmp_path, monkeypatch):
    model = lg.Modulator.from_pretrained("block-reach-2d")
    path = model.plan(SCENE, 0, 1.0, observer=lg.Observer.paper(2))
    panels = panels_of([path.timed()], tmp_path / "motion.svg", monkeypatch)
    assert panels.shape == (4, 1)
    assert "the dial" in panels[3, 0].get_ylabel()


def test_refuses(motions, tmp_path):
    for number in (0, 6):
        with pytest.raises(InvalidInputError, match=f"1 to 5 timed motions, got {number}"):
            figures.motion_figure((motions * 2)[:number], tmp_path / "no.png")
    record = dataclasses.replace(motions[0], limits=None)
    with pytest.raises(InvalidInputError, match="has no limits"):
        figures.motion_figure([record], tmp_path / "no.png")
    with pytest.raises(OutputError, match="must end in"):
        figures.motion_figure(motions, tmp_path / "no.txt")
    assert not list(tmp_path.iterdir())
