import json
import math
import os
import shutil
import warnings
from pathlib import Path
from unittest.mock import ANY

import numpy as np
import pytest

from legibility.cli import output
from legibility.errors import CheckpointError, InvalidInputError, OutputError
from legibility.models.pretrained import pretrained_folder


def test_report_is_plain_and_repeats_the_command(tmp_path):
    file = tmp_path / "a" / "r.json"
    token = output.ARGUMENTS.set(["plan", "my scene.yaml"])
    try:
        output.write_report(
            file,
            seed=3,
            config={"a": (1, 2), "b": Path("x")},
            result={
                "inf": math.inf,
                "nan": np.float32("nan"),
                2: np.arange(2),
                "t": np.bool_(True),
            },
        )
    finally:
        output.ARGUMENTS.reset(token)
    content = json.loads(file.read_text())
    assert list(content) == ["legibility", "command", "seed", "config", "result"]
    assert content["command"] == "legibility plan 'my scene.yaml'"
    assert content["config"] == {"a": [1, 2], "b": "x"}
    assert content["result"] == {"inf": None, "nan": None, "2": [0, 1], "t": True}


def test_no_file_no_report():
    output.write_report(None, seed=0, config={}, result={})


@pytest.mark.parametrize("name", ["f.bmp", "f", ".png", "f.png.txt", "f.eps"])
def test_figure_of_an_unknown_format(name, tmp_path):
    with pytest.raises(OutputError, match=r"\.png, \.pdf, \.svg"):
        output.check_figure(tmp_path / name)


def test_outputs_that_can_be_written(tmp_path):
    output.check_figure(tmp_path / "F.PNG")
    output.check_file(tmp_path / "a" / "b" / "c.json", "JSON file")
    output.check_file(Path(os.devnull), "JSON file")
    output.check_file(None, "JSON file")
    assert list(tmp_path.iterdir()) == []


def test_outputs_that_cannot_be_written(tmp_path):
    (tmp_path / "file").touch()
    (tmp_path / "dangling").symlink_to(tmp_path / "nowhere")
    with pytest.raises(OutputError, match="is not a folder"):
        output.check_file(tmp_path / "file" / "a.json", "JSON file")
    with pytest.raises(OutputError, match="is not a folder"):
        output.check_folder(tmp_path / "dangling" / "a", "dataset")
    with pytest.raises(OutputError, match="it is a folder"):
        output.check_file(tmp_path, "JSON file")


@pytest.mark.skipif(not os.path.isdir("/proc/self"), reason="/proc of Linux, read-only to root too")
def test_folder_that_is_read_only():
    with pytest.raises(OutputError, match="cannot write the dataset to /proc"):
        output.check_folder(Path("/proc/legibility"), "dataset")


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.5, "0.500"), (-0.00001, "-1e-05"), (0.0, "0.000"), (-1.5634, "-1.563"), (0.0123, "0.0123"),
     (math.inf, "never"), (math.nan, "–")],
)  # fmt: skip
def test_significant(value, text):
    assert output.significant(value) == text


def test_number_has_no_minus_before_zero():
    assert output.number(-0.0001) == "0.000"


def test_model_without_weights():
    with pytest.raises(CheckpointError):
        output.model_record("no-such-model")


def test_the_record_of_weights_knows_their_settings(tmp_path):
    folder = shutil.copytree(pretrained_folder("block-reach-2d"), tmp_path / "m")
    both, path = (output.model_record(str(folder), stages) for stages in ("*", "path"))
    assert list(both) == ["name", "path", "policy", "settings"]
    assert list(path) == ["name", "path", "settings"]
    config = (folder / "config.json").read_text()
    (folder / "config.json").write_text(config.replace('"execute": 1', '"execute": 4'))
    assert output.model_record(str(folder), "path") == path
    assert output.model_record(str(folder)) == both | {"settings": ANY}
    assert output.model_record(str(folder)) != both
    (folder / "config.json").write_text("{")
    with pytest.raises(CheckpointError, match="cannot read the weights"):
        output.model_record(str(folder))


def test_markup_is_text(capsys):
    output.show("[bold]a[/bold] :smile: 1")
    assert capsys.readouterr().out == "[bold]a[/bold] :smile: 1\n"


@pytest.fixture
def clock(monkeypatch):
    """A clock [s] that stands still unless it is set."""
    now = [0.0]
    monkeypatch.setattr(output.time, "monotonic", lambda: now[0])
    return now


def test_quick_work_shows_no_progress(capsys, clock):
    with output.progress_bar("things") as progress:
        for done in range(101):
            clock[0] = 0.01 * done
            progress(done, 100, "a line" if done == 50 else "")
    printed = capsys.readouterr()
    assert (printed.out, printed.err) == ("", "a line\n")


def test_progress_off_a_terminal_is_a_line_for_each_tenth(capsys, clock):
    with output.progress_bar("things") as progress:
        for done in range(101):
            clock[0] = done
            progress(done, 100)
    printed = capsys.readouterr()
    lines = [f"legibility: things {done} of 100" for done in range(10, 101, 10)]
    assert (printed.out, printed.err.splitlines()) == ("", lines)


def test_slow_work_is_heard_of_every_half_minute(capsys, clock):
    with output.progress_bar("things") as progress:
        for done in range(21):
            clock[0] = 8.0 * done
            progress(done, 1000)
    lines = [f"legibility: things {done} of 1000" for done in (4, 8, 12, 16, 20)]
    assert capsys.readouterr().err.splitlines() == lines


def test_quiet_prints_nothing(capsys, clock):
    with output.speaking(quiet=True, verbose=False), output.progress_bar("things") as progress:
        for done in range(101):
            clock[0] = 10.0 * done
            progress(done, 100, "a line")
        output.show("text", output.table("title", "column"))
        output.note("note")
        warnings.warn("warning", stacklevel=1)
    assert capsys.readouterr() == ("", "")
    output.show("text")
    assert capsys.readouterr().out == "text\n"


def test_verbose_tells_how_long_things_take(capsys, clock):
    with output.speaking(quiet=False, verbose=True):
        clock[0] = 1.5
        with output.progress_bar("things") as progress:
            clock[0] = 2.0
            progress(3, 3)
    lines = ["legibility: 2.00 s: 3 things in 0.50 s", "legibility: 2.00 s: ended"]
    assert capsys.readouterr().err.splitlines() == lines
    with output.timed("nothing"):
        pass
    assert capsys.readouterr() == ("", "")


def test_quiet_and_verbose():
    with pytest.raises(InvalidInputError, match="not both"), output.speaking(True, True):
        pass
