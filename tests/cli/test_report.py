import json
import shutil
from pathlib import Path

import pytest

from legibility.files import file_hash

pytestmark = pytest.mark.usefixtures("coarsely")

KINDS = ("dial", "closed-loop", "execution")
NAMES = ("dial-tiny-dragan", "dial-tiny-all", "closed-loop-tiny", "execution-tiny")


@pytest.fixture(scope="module")
def measured(cli, one_thread, executable, tmp_path_factory):
    """Results of a model, and its weights in models/tiny."""
    folder = tmp_path_factory.mktemp("measured")
    dial = "evaluate dial --scenes 1 --seed 1 --levels 3 --samples 1 --candidates 0"
    for name, words in {
        "dial-tiny-dragan": dial,
        "dial-tiny-all": f"{dial} --regime all",
        "closed-loop-tiny": f"{dial} --closed-loop",
        "execution-tiny": "evaluate execution --scenes 1 --rollouts 3",
    }.items():
        file = folder / "results" / f"{name}.json"
        assert cli(f"{words} --model {executable} --json", file) == 0
    shutil.copytree(executable, folder / "models" / "tiny")
    (folder / "models" / "tiny" / "README.md").unlink(missing_ok=True)
    return folder


@pytest.fixture
def results(measured, here, capsys):
    shutil.copytree(measured, here, dirs_exist_ok=True)
    capsys.readouterr()
    return here


REPORT = "report results --out docs/results.md --pictures results --weights models"


def test_report(results, cli, capsys):
    assert cli(REPORT) == 0
    written = capsys.readouterr().out.split()
    assert all(Path(file).stat().st_size for file in written)
    page = Path("docs/results.md").read_text()
    for name in NAMES:
        command = json.loads(Path(f"results/{name}.json").read_text())["command"]
        assert f"Measured by `{command}`." in page
    for name in NAMES[:-1]:
        assert f"(../results/{name}.png)" in page
        assert Path(f"results/{name}.png").read_bytes().startswith(b"\x89PNG")
    assert "| stage 2 without the path | " in page
    assert "`docs/results.md`" in Path("models/tiny/README.md").read_text()
    assert cli(REPORT) == 0
    assert Path("docs/results.md").read_text() == page


def test_page_elsewhere_links_the_pictures(results, cli):
    assert cli("report results --out a/b/page.md --pictures results") == 0
    assert "(../../results/dial-tiny-dragan.png)" in Path("a/b/page.md").read_text()
    assert not Path("docs").exists()
    assert not Path("models/tiny/README.md").exists()


def test_nothing_is_written_that_was_not_named(results, cli, refused):
    assert "name an output: --out, --pictures, --weights or --tables" in refused("report results")
    assert cli("report results --out page.md") == 0
    assert ".png" not in Path("page.md").read_text()
    assert not list(results.rglob("*.png"))
    assert not Path("docs").exists()


def test_tables(results, cli):
    assert cli("report results --tables build") == 0
    for name in NAMES:
        assert r"\toprule" in Path(f"build/{name}-1.tex").read_text()
        assert Path(f"build/{name}-1.csv").read_text().count("\n") > 5
    assert Path("build/dial-tiny-dragan.pdf").read_bytes().startswith(b"%PDF")


def test_texts_are_written_before_a_picture_fails(results, cli, monkeypatch):
    def fail(*_):
        raise KeyError("no font")

    monkeypatch.setattr("legibility.figures.paper.dial_figure", fail)
    assert cli(REPORT) == 2
    assert Path("docs/results.md").exists()
    assert Path("models/tiny/README.md").exists()


def test_weights_that_were_just_trained(results, executable, cli):
    shutil.rmtree("models/tiny")
    shutil.copytree(executable, "models/tiny")
    hashes = {f.stem: file_hash(f) for f in Path("models/tiny").glob("*.safetensors")}
    for file in Path("results").glob("*.json"):
        content = json.loads(file.read_text())
        file.write_text(json.dumps({**content, "model": hashes}))
    assert cli(REPORT) == 0
    card = " ".join(Path("models/tiny/README.md").read_text().split())
    assert "4 random scenes (regime `observers`, stream `train`" in card
    assert "8 demonstrations, 2 in each of 4 scenes" in card
    assert "20 batches of 16 moments of demonstrations" in card


def test_page_is_a_folder(results, refused):
    assert "cannot write the page results" in refused("report results --out results")


@pytest.mark.parametrize("name", NAMES)
def test_missing_result(name, results, refused):
    Path(f"results/{name}.json").unlink()
    assert f"there is no {name}.json" in refused(REPORT)


@pytest.mark.parametrize(
    ("name", "stage"), [("dial-tiny-all", "path"), ("execution-tiny", "policy")]
)
def test_result_of_other_weights(name, stage, results, refused):
    file = Path(f"results/{name}.json")
    content = json.loads(file.read_text())
    content["model"][stage] = "0" * 64
    file.write_text(json.dumps(content))
    assert f"{name}.json is a result of other weights" in refused(REPORT)


@pytest.mark.parametrize(("kind", "other"), [("dial", "closed-loop"), ("closed-loop", "dial"),
                                             ("execution", "dial"), ("dial", "execution"),
                                             ("closed-loop", "execution")])  # fmt: skip
def test_result_of_another_kind(kind, other, results, refused):
    names = {name.partition("-tiny")[0]: name for name in NAMES}
    shutil.copy(f"results/{names[other]}.json", f"results/{names[kind]}.json")
    message = refused(REPORT)
    assert f"{names[kind]}.json is not a result of the kind {kind}" in message or (
        f"a {kind} of tiny is not what `legibility` writes" in message  # the card reads it first
    )


@pytest.mark.parametrize("spoil", [
    lambda entry: entry.pop("training"),
    lambda entry: entry.update(training=None),
    lambda entry: entry.update(training={"steps": 3}),
    lambda entry: entry.pop("config"),
], ids=["none", "unknown", "partial", "shape"])  # fmt: skip
def test_weights_of_unknown_training(spoil, results, refused):
    file = Path("models/tiny/config.json")
    content = json.loads(file.read_text())
    spoil(content["path"])
    file.write_text(json.dumps(content))
    assert "tiny" in refused(REPORT)


def test_no_results(here, refused):
    message = refused("report . --out page.md")
    assert all(f"{kind}-*.json" in message for kind in KINDS)


@pytest.mark.parametrize("kind", [*KINDS, "ablations"])
@pytest.mark.parametrize("content", ["", "[1]", "{}", '{"result": {}}', '{"config": 3}'])
def test_broken_results(kind, content, here, refused):
    Path(f"{kind}-x.json").write_text(content)
    assert f"{kind}-x.json is not" in refused("report . --out page.md")
