"""The documents: every command runs, every number is in the results, every link leads somewhere."""

import functools
import re
import shlex
import shutil
from pathlib import Path

import pytest
from experiments import current_record, read_experiments

from legibility.cli import main, verbs
from legibility.models.pretrained import pretrained_folder, pretrained_names
from legibility.modulator import Modulator
from legibility.report.card import render_card
from legibility.report.results import headline_table, read_json, read_results, render_page

ROOT = Path(__file__).parent.parent
DOCUMENTS = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
README = (ROOT / "README.md").read_text(encoding="utf-8")
WEIGHTS = [*pretrained_names(), *pretrained_names("goal")]


EXAMPLES = sorted((ROOT / "examples").glob("*.py"))


def blocks(document):
    """The blocks of code of a document in their order, as pairs of language and text."""
    return re.findall(r"```(\w+)\n(.*?)```", document.read_text(encoding="utf-8"), re.DOTALL)


def commands(block):
    """The commands `legibility …` of a block."""
    lines = block.replace("\\\n", "")
    calls = re.findall(r"^(?:.* -m )?(legibility [^#'\n]+)", lines, re.MULTILINE)
    return list(dict.fromkeys(call.strip() for call in calls))


def pages(*languages):
    """The documents with such blocks; the Python of `clusters.md` needs a cluster."""
    return [
        pytest.param(document, id=document.stem)
        for document in DOCUMENTS
        if any(language in languages for language, _ in blocks(document))
    ]


LONG = [command for page in DOCUMENTS for language, block in blocks(page) if language == "bash"
        for command in commands(block)]  # fmt: skip
"""Commands that would take hours, or need a cluster or the Hub."""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder with the examples, where the reader is."""
    shutil.copytree(ROOT / "examples", tmp_path / "examples")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture(scope="module")
def results():
    return read_results(ROOT / "results")


def test_the_readme_is_short():
    assert len(README.splitlines()) <= 220


@pytest.mark.parametrize("document", pages("sh", "python", "console"))
def test_what_a_page_shows_runs(document, folder, monkeypatch, capsys):
    """One after another: commands succeed, Python prints, mistakes are answered as shown."""
    monkeypatch.setattr("legibility.evaluation.contest._TIMED", 1)
    for language, block in blocks(document):
        if language == "sh":
            for command in commands(block):
                assert main(shlex.split(command)[1:]) == 0, (command, capsys.readouterr().err)
                for written in re.findall(r"\S+\.(?:png|gif|json|csv)\b", command):
                    assert (folder / written).stat().st_size > 100
        elif language == "python" and document.stem != "clusters":
            capsys.readouterr()
            exec(block, {"__name__": "__main__"})
            assert capsys.readouterr().out, block
        elif language == "console":
            capsys.readouterr()
            for call in re.split(r"^\$ ", block, flags=re.MULTILINE)[1:]:
                command, _, answer = call.partition("\n")
                assert main(shlex.split(command)[1:]) == 2
                assert " ".join(capsys.readouterr().err.split()) == " ".join(answer.split())


@pytest.mark.parametrize("command", LONG)
def test_commands_that_take_long_are_parsed(command, monkeypatch, capsys):
    called, load = [], verbs.load

    def stand_in(name):
        return functools.wraps(load(name))(lambda *args, **kwargs: called.append(name))

    monkeypatch.setattr(verbs, "load", stand_in)
    assert main(shlex.split(command)[1:]) == 0, capsys.readouterr().err
    assert called


SHORT = {"your_data.py": ["out/your-data", "2", "1"]}
"""Arguments of examples that take minutes without them."""


@pytest.mark.parametrize("file", EXAMPLES, ids=lambda file: file.name)
def test_examples(file, folder, monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", [str(file), *SHORT.get(file.name, [])])
    exec(compile(file.read_text("utf-8"), file, "exec"), {"__name__": "__main__"})
    assert capsys.readouterr().out


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda file: file.name)
def test_links_lead_to_files(document):
    for target in re.findall(r"\]\(([^)#]+?)(?:#[^)]*)?\)", document.read_text(encoding="utf-8")):
        if not target.startswith("https://"):
            assert (document.parent / target).is_file(), target


def test_page_of_results(results):
    page = (ROOT / "docs" / "results.md").read_text(encoding="utf-8")
    assert page == render_page(results, "../results"), "run `make report`"


def test_headline(results):
    """Every number of the table is in the results, from which it is rendered."""
    assert headline_table(results).markdown() in README


def test_every_result_is_of_shipped_weights():
    files = sorted((ROOT / "results").glob("*.json"))
    assert files
    for file in files:
        content = read_json(file)
        used = [*content.get("baselines", []), *content["config"].get("weights", [])]
        for model in used + ([content["model"]] if "model" in content else []):
            assert model == current_record(model), file.name


def test_measurements_stand_in_tables(results):
    """What is measured stands in tables, which are rendered, but for the shares checked here."""
    shares = []
    for regime in ("dragan", "all"):
        for model in ("block-reach-2d", "panda-block-reach"):
            dial = results["dial"][f"{model}-{regime}"]["result"]
            shares.append(int(100 * dial["degenerate"]["scenes"] / len(dial["scenes"]) + 0.5))
    two, arm, *any_room = shares
    prose = " ".join(README.split())
    assert f"({two} % of them in 2-D, {arm} % on the Panda, " in prose
    assert "{} and {} % with any room and observer)".format(*any_room) in prose
    settings = {"README": {"3.11", "0.05"}, "start": {"3.11"}, "training": {"0.05"},
                "clusters": {"1.15"}, "arm": {"0.5", "0.96", "0.8", "0.27", "1.3"},
                "method": {"0.15", "0.08", "2.5", "0.05", "0.02", "0.4"}}  # fmt: skip
    for document in DOCUMENTS:
        if document.stem == "results":
            continue
        text = re.sub(r"```.*?```|`[^`]*`", "", document.read_text(encoding="utf-8"), flags=re.S)
        lines = text.splitlines()
        if document.stem == "README":
            lines = [line for line in lines if not line.startswith("|")]
        numbers = set(re.findall(r"\b\d+\.\d+\b", "\n".join(lines)))
        assert numbers <= settings.get(document.stem, set()), document
        percentages = re.findall(r"\d+(?: and \d+)? ?%", "\n".join(lines))
        assert len(percentages) == (3 if document.stem == "README" else 0), document


def test_every_result_is_an_experiment():
    names = set(read_experiments(ROOT / "experiments.toml"))
    for file in (ROOT / "results").glob("*.json"):
        assert file.stem in names or file.stem.startswith("tuning-"), file.name


@pytest.mark.parametrize("name", WEIGHTS)
def test_cards(name, results):
    weights = pretrained_folder(name)
    card = (weights / "README.md").read_text(encoding="utf-8")
    assert card == render_card(name, read_json(weights / "config.json"), results)


@pytest.mark.parametrize("name", WEIGHTS)
def test_weights_are_small(name):
    for file in pretrained_folder(name).glob("*.safetensors"):
        assert file.stat().st_size < 5_000_000


@pytest.mark.parametrize("name", pretrained_names())
def test_shipped_weights(name):
    model = Modulator.from_pretrained(name)
    assert model.name == name
    assert model.path_policy is not None
