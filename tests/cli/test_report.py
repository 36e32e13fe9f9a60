import json
import shutil
from pathlib import Path

import pytest

from legibility.files import file_hash
from legibility.models.pretrained import pretrained_folder

KINDS = ("dial", "closed-loop", "execution")
PAGE = "before\n" + "".join(f"<!-- {k}-tiny -->\nold\n<!-- /{k}-tiny -->\n" for k in KINDS)


@pytest.fixture(scope="module")
def measured(cli, one_thread, tmp_path_factory):
    """Measurements of the shipped model, its weights in models/tiny, and a page."""
    folder = tmp_path_factory.mktemp("measured")
    dial = "evaluate dial --scenes 1 --seed 1 --levels 3 --samples 1 --candidates 0"
    for kind, words in {
        "dial": dial,
        "closed-loop": f"{dial} --closed-loop",
        "execution": "evaluate execution --scenes 1 --rollouts 3",
    }.items():
        assert cli(f"{words} --json", folder / "results" / f"{kind}-tiny.json") == 0
    shutil.copytree(pretrained_folder("block-reach-2d"), folder / "models" / "tiny")
    (folder / "models" / "tiny" / "README.md").unlink(missing_ok=True)
    (folder / "page.md").write_text(PAGE)
    return folder


@pytest.fixture
def results(measured, here, capsys):
    shutil.copytree(measured, here, dirs_exist_ok=True)
    capsys.readouterr()
    return here


REPORT = "report results --readme page.md --weights models"


def test_report(results, cli, capsys):
    assert cli(REPORT) == 0
    text, expected = capsys.readouterr().out, "before\n"
    card = Path("models/tiny/README.md").read_text()
    for kind in KINDS:
        section = Path(f"results/{kind}-tiny.md").read_text().strip()
        assert "Measured by `legibility evaluate " in section
        assert section in text
        assert section in card
        expected += f"<!-- {kind}-tiny -->\n{section}\n<!-- /{kind}-tiny -->\n"
    assert Path("page.md").read_text() == expected
    assert "| Spearman correlation of asked and achieved ℓ | " in expected
    assert "| stage 2 without the path | " in expected
    for kind in ("dial", "closed-loop"):
        assert Path(f"results/{kind}-tiny.png").read_bytes().startswith(b"\x89PNG")
    assert cli("report results --readme page.md") == 0
    assert Path("page.md").read_text() == expected


def test_distilled_weights_are_shown_beside_their_teacher(results, cli):
    for kind in KINDS:
        shutil.copy(f"results/{kind}-tiny.json", f"results/{kind}-tiny-fast.json")
    page = Path("page.md")
    page.write_text(PAGE + "<!-- distilled -->\n<!-- /distilled -->\n")
    assert cli("report results --readme page.md") == 0
    section = Path("results/distilled.md").read_text().strip()
    assert "| tiny-fast | " in section
    assert f"<!-- distilled -->\n{section}\n<!-- /distilled -->" in page.read_text()
    assert Path("results/dial-tiny-fast.md").read_text() == Path("results/dial-tiny.md").read_text()


def test_without_page_and_weights(results, cli):
    Path("results/execution-tiny.json").unlink()
    assert cli("report results") == 0
    assert Path("page.md").read_text() == PAGE
    assert not Path("models/tiny/README.md").exists()
    assert not Path("results/execution-tiny.md").exists()


def test_weights_that_were_just_trained(results, executable, cli):
    shutil.rmtree("models/tiny")
    shutil.copytree(executable, "models/tiny")
    hashes = {f.stem: file_hash(f) for f in Path("models/tiny").glob("*.safetensors")}
    for file in Path("results").glob("*.json"):
        content = json.loads(file.read_text())
        file.write_text(json.dumps({**content, "model": hashes}))
    assert cli(REPORT) == 0
    card = " ".join(Path("models/tiny/README.md").read_text().split())
    assert "4 random scenes with 2 to 3 goals" in card
    assert "8 demonstrations, 2 in each of 4 scenes" in card
    assert "20 batches of 16 moments of demonstrations" in card


@pytest.mark.parametrize("kind", KINDS)
def test_page_without_a_place(kind, results, refused):
    Path("page.md").write_text(PAGE.replace(f"<!-- {kind}-tiny -->", ""))
    assert f"<!-- {kind}-tiny -->" in refused(REPORT)


def test_no_page(results, refused):
    Path("page.md").unlink()
    assert "cannot read the Markdown file page.md" in refused(REPORT)


@pytest.mark.parametrize("kind", KINDS)
def test_missing_measurement(kind, results, refused):
    Path(f"results/{kind}-tiny.json").unlink()
    assert f"there is no {kind}-tiny.json" in refused(REPORT)


@pytest.mark.parametrize(("kind", "stage"), [("dial", "path"), ("execution", "policy")])
def test_measurement_of_other_weights(kind, stage, results, refused):
    file = Path(f"results/{kind}-tiny.json")
    content = json.loads(file.read_text())
    content["model"][stage] = "0" * 64
    file.write_text(json.dumps(content))
    assert f"the measurement {kind}-tiny.json is of other weights" in refused(REPORT)


@pytest.mark.parametrize(("kind", "other"), [("dial", "closed-loop"), ("closed-loop", "dial"),
                                             ("execution", "dial"), ("dial", "execution"),
                                             ("closed-loop", "execution")])  # fmt: skip
def test_measurement_of_another_kind(kind, other, results, refused):
    shutil.copy(f"results/{other}-tiny.json", f"results/{kind}-tiny.json")
    assert f"results/{kind}-tiny.json is not" in refused(REPORT)


@pytest.mark.parametrize("spoil", [
    lambda entry: entry.pop("training"),
    lambda entry: entry.update(training=None),
    lambda entry: entry.update(training={"steps": 3}),
    lambda entry: entry.pop("config"),
], ids=["none", "unknown", "partial", "shape"])  # fmt: skip
def test_weights_that_nobody_knows(spoil, results, refused):
    file = Path("models/tiny/config.json")
    content = json.loads(file.read_text())
    spoil(content["policy" if "policy" in content else "path"])
    spoil(content["path"])
    file.write_text(json.dumps(content))
    assert "tiny" in refused(REPORT)


def test_no_results(here, refused):
    message = refused("report .")
    assert all(f"{kind}-*.json" in message for kind in KINDS)


@pytest.mark.parametrize("kind", [*KINDS, "ablations"])
@pytest.mark.parametrize("content", ["", "[1]", "{}", '{"result": {}}', '{"config": 3}'])
def test_broken_results(kind, content, here, refused):
    Path(f"{kind}-x.json").write_text(content)
    assert f"{kind}-x.json is not" in refused("report .")
