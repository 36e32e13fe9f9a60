import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

import legibility
from legibility.cli import main
from legibility.cli.verbs import VERBS


def command(*arguments: str, **options) -> subprocess.CompletedProcess[str]:
    line = [sys.executable, "-m", "legibility", *arguments]
    return subprocess.run(line, capture_output=True, text=True, timeout=60, **options)


def test_version(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"legibility {legibility.__version__}\n"


def test_help_names_every_verb_and_loads_nothing_heavy():
    code = (
        "import sys; from legibility.cli import main; main(['--help']); print(sorted(sys.modules))"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    text, modules = found.stdout.rsplit("\n[", 1)
    for verb in ("plan", "score", "data", "train", "evaluate"):
        assert f"• {verb} " in text
    for module in ("torch", "pyarrow", "matplotlib", "scipy", "diffusers"):
        assert f"'{module}'" not in modules


def test_help_of_a_group(capsys):
    assert main(["evaluate", "--help"]) == 0
    text = capsys.readouterr().out
    assert "Measure a model on held-out scenes." in text
    for verb in (
        "dial",
        "eyes",
        "planning",
        "execution",
        "table1",
        "external",
        "single-scene",
        "unseen",
        "spectrum",
        "ablations",
    ):
        assert f"• {verb} " in text


@pytest.mark.parametrize(
    ("line", "verb"), [("", "plan"), ("nothing", "plan"), ("evaluate", "dial")]
)
def test_mistaken_verb_is_answered_with_the_list(line, verb, capsys):
    assert main(line.split()) == 2
    output = capsys.readouterr()
    assert output.out == ""
    assert f"{verb}, " in output.err


@pytest.mark.parametrize(
    ("verb", "flags"),
    [
        ("plan", ["--legibility", "--figure", "--json", "--csv", "--candidates", "--guidance"]),
        ("score", ["--observer", "--target", "--json"]),
        (
            "data",
            [
                "--regime",
                "--goals LOW..HIGH",
                "--views",
                "--candidates",
                "--info",
                "--detour",
                "--label",
            ],
        ),
        (
            "train path",
            [
                "--data",
                "--validation",
                "--steps",
                "--contact-weight",
                "--jerk-weight",
                "--channels",
            ],
        ),
        ("evaluate dial", ["--model", "--scenes", "--levels", "--samples", "--candidates"]),
    ],
)
def test_help_of_a_verb(verb, flags, capsys):
    assert main([*verb.split(), "--help"]) == 0
    text = capsys.readouterr().out
    for flag in flags:
        assert flag in text


@pytest.mark.parametrize("verb", VERBS)
def test_help_is_light(verb):
    code = (
        "import sys, time; from legibility.cli import main; main(sys.argv[1:]);"
        "heavy = {'torch', 'matplotlib', 'scipy.stats', 'diffusers', 'mujoco'} & set(sys.modules);"
        "sys.exit(f'{heavy} {time.process_time()}' if heavy or time.process_time() > 0.6 else 0)"
    )
    words = [*verb.split(), "--help"]
    for _ in range(5):  # the fastest counts
        run = subprocess.run([sys.executable, "-c", code, *words], capture_output=True, text=True)
        if run.returncode == 0:
            break
    assert (run.returncode, run.stderr) == (0, "")
    assert "--json" in run.stdout or verb in ("report", "completion")


def test_settings_explain_themselves_and_leave_out_what_the_data_fixes(capsys):
    main(["train", "path", "--help"])
    text = capsys.readouterr().out
    assert "optimiser steps" in text
    assert "--observer" not in text


def test_data_fix_what_a_level_means_and_nothing_else_of_an_observer(capsys):
    main(["data", "--help"])
    text = capsys.readouterr().out
    for flag in ("--alpha", "--detour", "--label"):
        assert flag in text
    for flag in ("--kind", "--prior", "--sigma", "--beta", "--viewpoint", "--depth"):
        assert flag not in text


@pytest.mark.parametrize(
    "arguments",
    [[], ["nothing"], ["plan"], ["train"], ["train", "nothing"], ["plan", "s.yaml", "--nothing"],
     ["evaluate", "dial", "--scenes", "many"]],
)  # fmt: skip
def test_wrong_usage_is_status_2(arguments, capsys):
    assert main(arguments) == 2
    output = capsys.readouterr()
    assert output.out == ""
    assert "Traceback" not in output.err


def test_import_is_fast_and_loads_no_torch():
    code = (
        "import time; s = time.process_time(); import legibility, sys;"
        "print(time.process_time() - s, any(m in sys.modules for m in"
        " ('torch', 'scipy', 'matplotlib', 'pyarrow', 'diffusers')))"
    )
    times = []
    for _ in range(5):
        found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
        seconds, heavy = found.stdout.split()
        assert heavy == "False"
        times.append(float(seconds))
        if times[-1] < 0.3:
            break
    assert min(times) < 0.3


def test_interrupt_says_what_resumes(monkeypatch, tmp_path, capsys):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("legibility.data.dataset.generate", interrupted)
    assert main(["-q", "data", "--out", str(tmp_path / "data")]) == 130
    assert capsys.readouterr().err == "legibility: interrupted; the same command resumes\n"


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_interrupt_from_the_keyboard(here, request):
    words = (
        "data --scenes 100000 --goals 2 --cells 6 --per-scene 3 --candidates 4096 --regime dragan"
        " --views 1 --workers 2 --out d"
    )
    line = [sys.executable, "-m", "legibility", *words.split()]
    process = subprocess.Popen(
        line, stderr=subprocess.PIPE, text=True, start_new_session=True,
        # Whoever runs the tests in the background of a shell has them ignore it.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )  # fmt: skip
    request.addfinalizer(process.kill)  # which does nothing to one that has ended
    deadline = time.monotonic() + 120
    # Until both workers are at work: one that is still starting would tell of the interrupt itself.
    while len(list(Path().glob("d/*.parquet"))) < 3 and time.monotonic() < deadline:
        time.sleep(0.05)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does: to the workers as well
    _, errors = process.communicate(timeout=120)
    assert process.returncode == 130
    lines = [line for line in errors.splitlines() if not line.startswith("legibility: shards")]
    assert lines == ["legibility: interrupted; the same command resumes"]


@pytest.mark.skipif(os.name != "posix", reason="pipes of POSIX")
def test_reader_that_leaves_early_is_no_error(here):
    Path("paths.csv").write_text("x,y\n0,0.5\n0.8,0.6\n")
    line = [
        sys.executable,
        "-m",
        "legibility",
        "score",
        "paths.csv",
        "scene.yaml",
        "--json",
        "j.json",
    ]
    process = subprocess.Popen(line, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None
    process.stdout.close()
    assert process.wait(timeout=60) == 0
    assert process.stderr is not None
    assert process.stderr.read() == ""
    process.stderr.close()
    assert Path("j.json").exists()


def test_output_that_knows_only_ascii(here):
    Path("paths.csv").write_text("trajectory,x,y\nß,0,0.5\nß,0.8,0.6\n", encoding="utf-8")
    found = command(
        "score", "paths.csv", "scene.yaml", env={**os.environ, "PYTHONIOENCODING": "ascii"}
    )
    assert (found.returncode, found.stderr) == (0, "")
    assert "length over shortest" in " ".join(found.stdout.split())


@pytest.mark.skipif(os.name != "posix", reason="a shell of POSIX")
@pytest.mark.parametrize("closed", [">&-", "2>&-", "<&- >&- 2>&-"])
def test_streams_that_the_shell_closed(here, closed):
    Path("paths.csv").write_text("x,y\n0,0.5\n0.8,0.6\n")
    line = f"'{sys.executable}' -m legibility score paths.csv {{}} --json j.json {closed}"
    for scene, status in (("none.yaml", 2), ("scene.yaml", 0)):
        finished = subprocess.run(["sh", "-c", line.format(scene)], timeout=60, capture_output=True)
        assert finished.returncode == status
        assert Path("j.json").exists() == (status == 0)


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere file names are Unicode")
def test_file_names_that_are_no_utf8(here, capsys):
    scene, report = os.fsdecode(b"caf\xe9.yaml"), os.fsdecode(b"j\xe9.json")
    Path("scene.yaml").rename(scene)
    Path("paths.csv").write_text("x,y\n0,0.5\n0.8,0.6\n")
    found = command("score", "paths.csv", scene, "--json", report)
    assert (found.returncode, found.stderr) == (0, "")
    assert "caf?.yaml" in found.stdout
    assert scene in json.loads(Path(report).read_text(encoding="utf-8"))["command"]
    found = command("score", "paths.csv", scene[1:])
    assert (found.returncode, found.stderr.count("\n")) == (2, 1)


def test_home_folder(here, monkeypatch):
    monkeypatch.setenv("HOME", str(here))
    monkeypatch.setenv("USERPROFILE", str(here))
    Path("paths.csv").write_text("x,y\n0,0.5\n0.8,0.6\n")
    assert main(["score", "~/paths.csv", "~/scene.yaml", "--json=~/j.json"]) == 0
    assert "'--json=~/j.json'" in json.loads(Path("j.json").read_text())["command"]
    assert not Path("~").exists()


def test_backend_of_a_notebook(here, dataset):
    found = command(
        "data", "--info", str(dataset), "--figure", "f.png",
        env={**os.environ, "MPLBACKEND": "module://not_installed.backend_inline"},
    )  # fmt: skip
    assert (found.returncode, found.stderr) == (0, "")
    assert Path("f.png").exists()


def test_numbers_are_written_before_pictures(here, weights, monkeypatch, capsys):
    from legibility.errors import OutputError

    def no_picture(*_, **__):
        raise OutputError("no picture")

    monkeypatch.setattr("legibility.figures.paper.figure_file", no_picture)
    line = ["plan", "scene.yaml", "--model", weights, "--figure", "f.png"]
    assert main([*line, "--json", "j.json", "--csv", "c.csv"]) == 2
    assert capsys.readouterr().err == "legibility: error: no picture\n"
    assert Path("j.json").exists()
    assert Path("c.csv").exists()
    line = ["evaluate", "dial", "--scenes", "1", "--model", weights, "--figure", "f.png"]
    assert main([*line, "--json", "d.json"]) == 2
    assert Path("d.json").exists()


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="/dev/full of Linux")
def test_full_disk_behind_the_output(here):
    Path("paths.csv").write_text("x,y\n0,0.5\n0.8,0.6\n")
    line = [sys.executable, "-m", "legibility", "score", "paths.csv", "scene.yaml"]
    with open("/dev/full", "w") as full:
        found = subprocess.run(line, stdout=full, stderr=subprocess.PIPE, text=True, timeout=60)
    assert found.returncode == 2
    assert found.stderr.count("\n") == 1
    assert found.stderr.startswith("legibility: error: ")
