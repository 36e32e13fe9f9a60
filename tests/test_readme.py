"""What the README says: every command runs, and every number is what the results hold."""

import hashlib
import json
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from legibility.cli import main
from legibility.evaluation.comparison import METHODS
from legibility.models.pretrained import pretrained_folder, pretrained_names
from legibility.modulator import Modulator
from legibility.report.baseline_card import render_baseline_card
from legibility.report.card import (
    dial_section,
    execution_section,
    render_card,
)

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")


def blocks(language):
    return re.findall(rf"```{language}\n(.*?)```", README, re.DOTALL)


COMMANDS = [
    line.split("#")[0].strip()
    for block in blocks("sh")
    for line in block.splitlines()
    if line.startswith("legibility ")
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with the examples, in which the README's commands run one after another."""
    folder = tmp_path_factory.mktemp("readme")
    shutil.copytree(ROOT / "examples", folder / "examples")
    return folder


def test_the_readme_shows_commands():
    assert len(COMMANDS) >= 5


@pytest.mark.parametrize("command", COMMANDS)
def test_commands(command, folder, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    assert main(shlex.split(command)[1:]) == 0, capsys.readouterr().err
    for written in re.findall(r"\S+\.(?:png|gif|json)\b", command):
        assert (folder / written).stat().st_size > 100


@pytest.mark.parametrize("code", [*blocks("python"), (ROOT / "examples/plan.py").read_text()])
def test_python(code, folder):
    run = subprocess.run(
        [sys.executable, "-c", code], cwd=folder, capture_output=True, text=True, check=False
    )
    assert run.returncode == 0, run.stderr
    assert run.stdout


def test_pictures_are_there():
    for picture in re.findall(r"!\[.*?\]\((.*?)\)", README):
        assert (ROOT / picture).is_file()


def test_every_result_is_of_shipped_weights():
    files = sorted((ROOT / "results").glob("*.json"))
    assert files
    for file in files:
        content = json.loads(file.read_text())
        for model in [content["model"], *content.get("baselines", [])]:
            weights = pretrained_folder(model["name"])
            assert model == {"name": model["name"], **hashes_of(weights)}, file.name


def hashes_of(weights):
    return {
        file.stem: hashlib.sha256(file.read_bytes()).hexdigest()
        for file in weights.glob("*.safetensors")
    }


@pytest.mark.parametrize("name", pretrained_names())
def test_tables_and_card_are_what_was_measured_with_these_weights(name):
    weights = pretrained_folder(name)
    hashes = hashes_of(weights)
    sections = {
        "dial": dial_section, "closed-loop": dial_section, "execution": execution_section,
        "transfer": execution_section,
    }  # fmt: skip
    if not name.startswith("panda-block-reach"):  # there is one simulator of the plane
        del sections["transfer"]
    documents = {}
    for kind, section in sections.items():
        document = json.loads((ROOT / "results" / f"{kind}-{name}.json").read_text())
        assert document["model"] == {"name": name, **hashes}
        assert section(document) in README
        assert (ROOT / "results" / f"{kind}-{name}.md").read_text() == section(document) + "\n"
        documents[kind] = document
    config = json.loads((weights / "config.json").read_text())
    assert (weights / "README.md").read_text() == render_card(name, config, documents)


def test_comparisons_are_what_was_measured(file):
    section = COMPARED[file.stem.partition("-")[0]](json.loads(file.read_text()))
    assert section in README
    assert file.with_suffix(".md").read_text() == section + "\n"


@pytest.mark.parametrize("name", pretrained_names("goal"))
def test_card_of_a_baseline(name):
    documents = {}
    for file in sorted((ROOT / "results").glob("*.json")):
        content = json.loads(file.read_text())
        if any(b["name"] == name for b in content.get("baselines", [])):
            documents[file.stem] = content
    assert any(stem.startswith("table1") for stem in documents)
    method = next(m for m in METHODS if name.startswith(m.replace(" ", "-")))
    folder = pretrained_folder(name)
    config = json.loads((folder / "config.json").read_text())
    card = (folder / "README.md").read_text()
    assert card == render_baseline_card(name, method, config, documents)


@pytest.mark.parametrize("name", [*pretrained_names(), *pretrained_names("goal")])
def test_weights_are_small(name):
    for file in pretrained_folder(name).glob("*.safetensors"):
        assert file.stat().st_size < 6_000_000


@pytest.mark.parametrize("name", pretrained_names())
def test_shipped_weights(name):
    model = Modulator.from_pretrained(name)
    assert model.name == name
    assert model.path_policy is not None
