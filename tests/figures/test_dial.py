import sys

import numpy as np
import pytest
from matplotlib import rcParams
from PIL import Image

import legibility as lg
from legibility.data.dataset import paths_of
from legibility.errors import InvalidInputError, OutputError
from legibility.figures.dial import archive_figure, dial_figure, plan_figure
from legibility.modulator import Path

SCENES = {
    2: lg.Scene(start=[0, 0.5], goals=[[0.8, 0.6], [1, 0.3]]),
    3: lg.Scene(start=[-0.2, 0, 0.3], goals=[[0.05, -0.1, 0.04], [0, 0.1, 0.04], [0, -0.2, 0.08]]),
}
TARGETS = {2: 0, 3: 1}
NINE = np.linspace(-1, 1, 9)


@pytest.fixture(scope="module", params=[2, 3], ids=["2d", "3d"])
def archive(request):
    return lg.build_archive(
        SCENES[request.param], TARGETS[request.param], cells=8, random_candidates=1024,
        max_candidates=2048,
    )  # fmt: skip


def path_of(archive, legibility):
    levels = np.asarray(legibility, dtype=float)
    waypoints = paths_of(archive)[[archive.nearest(level) for level in np.atleast_1d(levels)]]
    path = Path(
        archive.scene, archive.target, levels, waypoints if levels.ndim else waypoints[0],
        np.zeros(levels.shape, dtype=bool), archive.field, archive.alpha, archive.label,
    )  # fmt: skip
    path.__dict__["archive"] = archive
    return path


def dial(scenes=5, levels=7):
    rng = np.random.default_rng(0)
    asked = np.linspace(-1, 1, levels)
    achieved = np.clip(asked + rng.normal(0, 0.05, (scenes, levels)), -1, 1)
    rows = [
        {"scene": i, "goals": 2, "spearman": 0.99, "achieved": row.tolist(),
         "error_by_level": np.abs(row - asked).tolist()}
        for i, row in enumerate(achieved)
    ]  # fmt: skip
    figure = {"mean": 0.99, "interval": [0.98, 1.0], "min": 0.97, "max": 1.0}
    overall = dict.fromkeys(("spearman", "error", "error_candidates"), figure)
    return {"overall": overall, "levels": asked.tolist(), "plan_ms": 2.0, "scenes": rows}


def assert_picture(file):
    """The file is a picture with ink and colour, and none of it is cut off at the rim."""
    with Image.open(file) as image:
        pixels = np.asarray(image.convert("RGB")).astype(int)
    assert min(pixels.shape[:2]) > 400
    assert 0.02 < (pixels.min(-1) < 200).mean() < 0.6
    assert (np.ptp(pixels, axis=-1) > 60).mean() > 0.001
    for rim in (pixels[0], pixels[-1], pixels[:, 0], pixels[:, -1]):
        assert (rim > 250).all()


def assert_vector(file):
    content = file.read_bytes()
    assert content.startswith(b"%PDF" if file.suffix == ".pdf" else b"<?xml")
    assert len(content) > 5000
    assert content.rstrip().endswith(b"%%EOF" if file.suffix == ".pdf" else b"</svg>")


@pytest.mark.parametrize("legibility", [NINE, 0.8, [0.0, 0.0], np.repeat(NINE, 4)],
                         ids=["nine", "one", "twice", "many"])  # fmt: skip
def test_plan(archive, legibility, tmp_path):
    plan_figure(path_of(archive, legibility), tmp_path / "plan.png")
    assert_picture(tmp_path / "plan.png")


def test_archive(archive, tmp_path):
    args = archive.scene, archive.target, archive.trajectories, archive.labels
    archive_figure(*args, archive.labels.reshape(1, -1).astype(np.float32), tmp_path / "a.png")
    assert_picture(tmp_path / "a.png")


@pytest.mark.parametrize("scenes", [1, 5, 301])
def test_dial(scenes, tmp_path):
    dial_figure(dial(scenes), tmp_path / "dial.png")
    assert_picture(tmp_path / "dial.png")


def test_dial_without_candidates(tmp_path):
    result = dial()
    del result["overall"]["error_candidates"]
    dial_figure(result, tmp_path / "dial.png")
    assert_picture(tmp_path / "dial.png")


def drawings(archive):
    return {
        "plan": lambda file: plan_figure(path_of(archive, NINE), file),
        "archive": lambda file: archive_figure(
            archive.scene,
            archive.target,
            archive.trajectories,
            archive.labels,
            archive.labels,
            file,
        ),
        "dial": lambda file: dial_figure(dial(), file),
    }


@pytest.mark.parametrize(("what", "suffix"), [("plan", ".pdf"), ("archive", ".svg")])
def test_vector_formats(archive, what, suffix, tmp_path):
    drawings(archive)[what](tmp_path / f"figure{suffix}")
    assert_vector(tmp_path / f"figure{suffix}")


@pytest.mark.parametrize("what", ["plan", "archive", "dial"])
@pytest.mark.parametrize("name", ["figure.jpg", "figure", "figure.png.txt"])
def test_other_suffixes_are_refused(archive, what, name, tmp_path):
    with pytest.raises(OutputError, match=r"must end in \.png, \.pdf, \.svg"):
        drawings(archive)[what](tmp_path / "new" / name)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("suffix", [".PNG", ".pdf", ".svg"])
def test_same_bytes_from_the_same_input_whatever_the_users_style(suffix, tmp_path, monkeypatch):
    first, second = tmp_path / f"first{suffix}", tmp_path / f"second{suffix}"
    dial_figure(dial(), first)
    monkeypatch.setitem(rcParams, "lines.linewidth", 9)
    dial_figure(dial(), second)
    assert first.read_bytes() == second.read_bytes()
    if suffix == ".PNG":
        assert_picture(first)
    else:
        assert_vector(first)
    assert sorted(tmp_path.iterdir()) == [first, second]


def test_no_global_state(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.pyplot", None)  # importing it now fails
    names = set(rcParams) - {"backend"}  # reading that one would choose a backend
    before = {name: rcParams[name] for name in names}
    dial_figure(dial(), tmp_path / "dial.png")
    assert {name: rcParams[name] for name in names} == before


@pytest.mark.parametrize("spoil", [
    lambda r: r.pop("levels"),
    lambda r: r["scenes"][0].pop("achieved"),
    lambda r: r["scenes"][0]["achieved"].pop(),
    lambda r: r["levels"].pop(),
    lambda r: r["overall"].update(spearman=None),
    lambda r: r.update(scenes=[]),
])  # fmt: skip
def test_a_malformed_result_is_refused(spoil, tmp_path):
    result = dial()
    spoil(result)
    with pytest.raises(InvalidInputError, match="not a result of `legibility evaluate dial`"):
        dial_figure(result, tmp_path / "dial.png")
    assert not list(tmp_path.iterdir())
