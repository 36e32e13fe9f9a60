"""The figure of the dial, and what the shared style promises for every figure."""

import os
import subprocess
import sys

import numpy as np
import pytest
from matplotlib import rcParams
from pictures import assert_picture, assert_vector

from legibility.errors import InvalidInputError, OutputError
from legibility.figures.paper import dial_figure


def dial(scenes=5, levels=7):
    rng = np.random.default_rng(0)
    asked = np.linspace(-1, 1, levels)
    achieved = np.clip(asked + rng.normal(0, 0.05, (scenes, levels)), -1, 1)
    rows = [
        {"scene": i, "goals": 2, "quick": {"achieved": row.tolist(),
         "error_by_level": np.abs(row - asked).tolist()}}
        for i, row in enumerate(achieved)
    ]  # fmt: skip
    figure = {"mean": 0.99, "interval": [0.98, 1.0], "min": 0.97, "max": 1.0}
    metrics = dict.fromkeys(("spearman", "error"), figure)
    overall = {"scenes": scenes, "quick": metrics, "exact": metrics}
    return {"overall": overall, "levels": asked.tolist(), "scenes": rows}


@pytest.mark.parametrize("scenes", [1, 5, 301])
def test_dial(scenes, tmp_path):
    dial_figure(dial(scenes), tmp_path / "dial.png")
    assert_picture(tmp_path / "dial.png")


def test_dial_of_one_mode(tmp_path):
    result = dial()
    del result["overall"]["exact"]
    dial_figure(result, tmp_path / "dial.png")
    assert_picture(tmp_path / "dial.png")


@pytest.mark.parametrize("name", ["figure.jpg", "figure", "figure.png.txt"])
def test_other_suffixes_are_refused(name, tmp_path):
    with pytest.raises(OutputError, match=r"must end in \.png, \.pdf, \.svg"):
        dial_figure(dial(), tmp_path / "new" / name)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("backend", ["module://matplotlib_inline.backend_inline", "nonsense"])
def test_a_backend_that_is_not_installed(backend, tmp_path):
    """A notebook sets its own for the shells that it opens."""
    code = (
        "import os\n"
        "from legibility.figures.style import figure_file\n"
        "with figure_file('f.png', 3, 2) as figure: figure.subplots()\n"
        "print(os.environ['MPLBACKEND'])"
    )
    found = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path,
        env=os.environ | {"MPLBACKEND": backend},
    )  # fmt: skip
    assert (found.returncode, found.stdout, found.stderr) == (0, f"{backend}\n", "")
    assert (tmp_path / "f.png").stat().st_size > 1000


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
    lambda r: r["scenes"][0]["quick"].pop("achieved"),
    lambda r: r["scenes"][0]["quick"]["achieved"].pop(),
    lambda r: r["levels"].pop(),
    lambda r: r["overall"]["quick"].update(spearman=None),
    lambda r: r.update(overall={}),
    lambda r: r.update(scenes=[]),
])  # fmt: skip
def test_a_malformed_result_is_refused(spoil, tmp_path):
    result = dial()
    spoil(result)
    with pytest.raises(InvalidInputError, match="not a result of `legibility evaluate dial`"):
        dial_figure(result, tmp_path / "dial.png")
    assert not list(tmp_path.iterdir())
