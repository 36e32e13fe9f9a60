"""Figures of plans and archives."""

import numpy as np
import pytest
from pictures import assert_picture, assert_vector, path_of, small_archive

from legibility.errors import OutputError
from legibility.figures.paper import archive_figure, plan_figure

NINE = np.linspace(-1, 1, 9)


@pytest.fixture(scope="module", params=[(2, 0), (3, 1)], ids=["2d", "3d"])
def archive(request):
    return small_archive(*request.param)


@pytest.fixture(params=["plan", "archive"])
def draw(request, archive):
    if request.param == "plan":
        return lambda file: plan_figure(path_of(archive, NINE), file)
    labels = archive.labels.reshape(1, -1).astype(np.float32)
    arguments = archive.scene, archive.target, archive.trajectories, archive.labels, labels
    return lambda file: archive_figure(*arguments, file)


@pytest.mark.parametrize("legibility", [0.8, [0.0, 0.0], np.repeat(NINE, 4)],
                         ids=["one", "twice", "many"])  # fmt: skip
def test_levels(archive, legibility, tmp_path):
    plan_figure(path_of(archive, legibility), tmp_path / "plan.png")
    assert_picture(tmp_path / "plan.png")


def test_picture_whatever_numpy_is_set_to(draw, tmp_path):
    draw(tmp_path / "first.png")
    assert_picture(tmp_path / "first.png")
    with np.errstate(all="raise"):
        draw(tmp_path / "second.png")
    assert (tmp_path / "first.png").read_bytes() == (tmp_path / "second.png").read_bytes()


@pytest.mark.parametrize("suffix", [".pdf", ".svg"])
def test_vector_formats(draw, suffix, tmp_path):
    draw(tmp_path / f"figure{suffix}")
    assert_vector(tmp_path / f"figure{suffix}")


def test_other_suffixes_are_refused(draw, tmp_path):
    with pytest.raises(OutputError, match=r"must end in \.png, \.pdf, \.svg"):
        draw(tmp_path / "new" / "figure.jpg")
    assert not list(tmp_path.iterdir())
