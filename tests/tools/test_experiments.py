"""Results are measured when they are missing or out of date, and only then."""

import functools
import json
from pathlib import Path

import experiments
import pytest
from experiments import Experiment, main, read_experiments

from legibility import cli
from legibility.cli import verbs
from legibility.cli.output import model_record
from legibility.errors import InvalidInputError

ROOT = Path(__file__).parent.parent.parent
ENTRY = '[{}]\ncommand = "{}"\nweights = ["block-reach-2d"]\n'
COMMAND = f"plan {ROOT}/examples/paper.yaml --legibility 0"


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def write(name, arguments, **content):
    Path("results").mkdir(exist_ok=True)
    model = model_record("block-reach-2d")
    document = {"command": f"legibility {arguments} --json results/{name}.json", "model": model,
                "config": {}}  # fmt: skip
    Path(f"results/{name}.json").write_text(json.dumps(document | content))


class TestIsDone:
    experiment = Experiment("x", "plan a.yaml", ("block-reach-2d",))

    def test_by_this_command_with_these_weights(self, folder):
        assert not self.experiment.is_done()
        write("x", "plan a.yaml")
        assert self.experiment.is_done()

    def test_workers_do_not_count(self, folder):
        write("x", "plan a.yaml --workers 7")
        assert self.experiment.is_done()

    @pytest.mark.parametrize("content", [
        {"command": "legibility plan b.yaml --json results/x.json"},
        {"model": {"name": "block-reach-2d", "path": "0" * 64}},
        {"model": {**model_record("block-reach-2d"), "name": "another"}},
        {"model": {**model_record("block-reach-2d"), "settings": "0" * 64}},
        {"baselines": [{"name": "diffusion-policy-2d", "goal": "0" * 64}]},
        {"model": None}, {"command": 3}, {"config": []},
    ])  # fmt: skip
    def test_otherwise_not(self, content, folder):
        write("x", "plan a.yaml", **content)
        assert not self.experiment.is_done()

    def test_baselines_and_benched_weights_count(self, folder):
        others = [model_record("diffusion-policy-2d")]
        experiment = Experiment("x", "plan a.yaml", ("block-reach-2d", "diffusion-policy-2d"))
        for content in ({"baselines": others}, {"config": {"weights": others}}):
            write("x", "plan a.yaml", **content)
            assert experiment.is_done()
            assert not self.experiment.is_done()

    def test_of_one_stage(self, folder):
        write("x", "plan a.yaml", model=model_record("block-reach-2d", "path"))
        assert self.experiment.is_done()

    def test_without_weights(self, folder):
        write("x", "evaluate x")
        content = json.loads(Path("results/x.json").read_text())
        del content["model"]
        Path("results/x.json").write_text(json.dumps(content))
        assert Experiment("x", "evaluate x", ()).is_done()
        assert not Experiment("x", "evaluate x", ("block-reach-2d",)).is_done()

    def test_broken_file(self, folder):
        Path("results").mkdir()
        Path("results/x.json").write_text("{")
        assert not self.experiment.is_done()


def test_run_resume_and_fail(folder, capfd):
    Path("experiments.toml").write_text(
        ENTRY.format("scene", COMMAND) + ENTRY.format("broken", "plan none.yaml")
    )
    assert main([]) == 1
    first = capfd.readouterr().out
    assert f"legibility {COMMAND} --json results/scene.json" in first
    assert "FAILED: broken" in first
    assert json.loads(Path("results/scene.json").read_text())["result"]
    assert main(["scene"]) == 0
    assert capfd.readouterr().out == "done: scene\n"


def test_what_is_missing_is_said(folder, monkeypatch, capsys):
    monkeypatch.setattr(experiments, "find_spec", lambda name: None)
    entry = ENTRY.format("scene", COMMAND)
    Path("experiments.toml").write_text(entry + 'extras = ["pandagym"]\ndata = "runs/data"\n')
    assert main([]) == 0
    assert capsys.readouterr().out == (
        "SKIPPED: scene needs the extra pandagym, the folder runs/data (`make weights`)\n"
    )


def test_long_ones_run_by_name_only(folder, capsys):
    entry = ENTRY.format("scene", COMMAND)
    Path("experiments.toml").write_text(entry + "by_name = true\n")
    write("scene", COMMAND)
    assert main([]) == 0
    assert capsys.readouterr().out == ""
    assert main(["scene"]) == 0
    assert capsys.readouterr().out == "done: scene\n"
    with pytest.raises(SystemExit):
        main(["another"])


@pytest.mark.parametrize("content", ["[x", "x = 1", "[x]\nweights = []", "[x]\nwhat = 1"])
def test_malformed(content, folder):
    Path("experiments.toml").write_text(content)
    with pytest.raises(InvalidInputError, match=r"experiments\.toml is malformed"):
        read_experiments(Path("experiments.toml"))


def test_entries_of_the_project_are_commands(folder, monkeypatch):
    """Each is parsed by the command line; nothing is measured."""
    called = []

    def stub(name):
        verb = load(name)

        @functools.wraps(verb)
        def call(*_, **__):
            called.append(name)

        return call

    load = verbs.load
    monkeypatch.setattr(verbs, "load", stub)
    entries = read_experiments(ROOT / "experiments.toml")
    assert len(entries) > 10
    for experiment in entries.values():
        assert set(experiment.extras) <= set(experiments._MODULES)
        for name in experiment.weights:
            assert len(model_record(name)) > 2
        assert cli.main(experiment.arguments) == 0
        assert experiment.command.startswith(called[-1])
    assert len(called) == len(entries)
