"""The script of `legibility completion`, run by bash."""

import contextlib
import io
import re
import shutil
import subprocess

import pytest

from legibility.cli import main
from legibility.cli.verbs import VERBS, help_of, members

pytestmark = pytest.mark.skipif(shutil.which("bash") is None, reason="bash is NOT TESTED: missing")

_ASK = """
ask() {
    COMP_WORDS=("$@") COMP_CWORD=$(($# - 1)) COMPREPLY=()
    _legibility
    echo "${COMPREPLY[*]-}"
}
"""


def run(script):
    done = subprocess.run(["bash", "-uc", script], capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout


@pytest.fixture(scope="module")
def script():
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        assert main(["completion", "bash"]) == 0
    return printed.getvalue()


@pytest.fixture
def offered(script):
    """What bash offers for the last word of each line."""

    def ask(*lines):
        asked = [f"ask legibility {line}" for line in lines]
        return [line.split() for line in run("\n".join([script, _ASK, *asked])).splitlines()]

    return ask


def test_verbs(offered):
    assert offered("''", "p", "train ''", "evaluate s", "--v") == [
        [*members("")], ["plan"], [*members("train")], ["single-scene", "spectrum"], ["--version"]
    ]  # fmt: skip


def test_every_option_of_every_verb(offered):
    for name, words in zip(VERBS, offered(*(f"{name} --" for name in VERBS)), strict=True):
        shown = re.findall(r"(?:^│ |^  |, )(?:-\w, )?(--[a-z][\w-]*)", help_of(name), re.MULTILINE)
        assert set(words) == set(shown)
        assert {"--help", "--quiet", "--verbose"} <= set(words)


def test_values(offered):
    lines = {
        "plan s.yaml --observer ''": ["dragan", "paper"],
        "plan s.yaml --observer p": ["paper"],
        "plan s.yaml --observer = dr": ["dragan"],
        "plan s.yaml --json out/j.json --frame ''": ["world", "base"],
        "evaluate controller --backend ''": ["torch", "onnx"],
        "train path --precision b": ["bf16"],
        "data --dim ''": ["2", "3"],
        "completion ''": ["bash", "zsh"],
    }
    assert offered(*lines) == list(lines.values())


def test_files_are_left_to_the_shell(offered):
    assert offered("plan ''", "plan exam", "plan s.yaml --json o", "score t.csv ''") == [[]] * 4


def test_a_verb_without_files_offers_its_options(offered):
    (words,) = offered("evaluate dial ''")
    assert "--levels" in words


def test_the_script_registers_itself(script, capsys):
    registered = "complete -o bashdefault -o default -F _legibility legibility\n"
    assert run(f"{script}\ncomplete -p legibility") == registered
    assert main(["completion", "zsh"]) == 0
    assert capsys.readouterr().out.endswith(script)  # by way of zsh's bashcompinit
