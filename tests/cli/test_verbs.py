"""What all verbs share: examples, choices, suggestions, --quiet and --verbose."""

import json
import re
import shlex
import shutil
from importlib import import_module
from pathlib import Path

import pytest

from legibility.cli import main
from legibility.cli.verbs import GROUPS, VERBS, call, examples, help_of, load, members

EXAMPLES = Path(__file__).parents[2] / "examples"
PARSED = [name for name in VERBS if name not in ("score", "doctor", "completion")]
"""Verbs that first load, make or measure something."""


class Started(Exception):
    """All arguments were accepted."""


@pytest.fixture
def started(here, monkeypatch):
    """Whatever takes time raises `Started`."""

    def start(*_, **__):
        raise Started

    for module in ("bench.measure", "baselines.pretrained", "evaluation.ablations",
                   "evaluation.single_scene"):  # fmt: skip
        import_module(f"legibility.{module}")  # which keeps the functions that are replaced below
    for place in (
        "modulator.Modulator.from_pretrained", "models.pretrained.pretrained_folder",
        "data.dataset.generate", "data.dataset.Dataset.load",
        "data.demonstrations.Demonstrations.load", "baselines.pretrained.load_baselines",
        "evaluation.single_scene.evaluate_single_scene", "report.results.read_results",
        "cli.bench.run_bench",
    ):  # fmt: skip
        monkeypatch.setattr(f"legibility.{place}", start)
    shutil.copytree(EXAMPLES, "examples")


def words(example):
    return shlex.split(example.partition(" > ")[0])[1:]


@pytest.mark.parametrize("name", VERBS)
def test_help_ends_with_two_commands_of_the_verb(name, capsys):
    commands = examples(load(name))
    assert len(commands) == 2
    assert all(command.startswith(f"legibility {name}") for command in commands)
    assert max(map(len, commands)) <= 100
    assert main([*name.split(), "--help"]) == 0
    assert capsys.readouterr().out.endswith("examples:\n  {}\n  {}\n".format(*commands))


@pytest.mark.parametrize("name", PARSED)
def test_arguments_of_examples_are_accepted(name, started):
    for example in examples(load(name)):
        with pytest.raises(Started):
            call(words(example))


def test_examples_that_need_no_model_run(here, capsys):
    shutil.copytree(EXAMPLES, "examples")
    for example in examples(load("score")):
        assert main(words(example)) == 0
        assert capsys.readouterr().out


@pytest.mark.parametrize(
    ("line", "options"),
    [
        ("plan", ["--observer {dragan,paper,FILE}", "--limits {panda,fr3,moveit-panda,point}",
                  "--arm {panda,FILE}", "--frame {world,base}",
                  "--model {block-reach-2d,panda-block-reach,DIR}"]),
        ("execute", ["--env {2d,panda,pandagym}"]),
        ("score", ["--observer {dragan,paper,FILE}"]),
        ("data", ["--regime {paper,dragan,observers,rooms,obstacles,all,training}",
                  "--dim {2,3}", "--stream {train,validation}", "--label {anchored,rank}",
                  "--cluster {local,tcp://HOST:PORT}"]),
        ("train path", ["--device {cpu,cuda,cuda:N}", "--precision {no,bf16,fp16}"]),
        ("train distill", ["--teacher {block-reach-2d,panda-block-reach,DIR}"]),
        ("evaluate dial", ["--modes {bare,quick,exact} ...", "--env {2d,panda,pandagym}"]),
        ("evaluate controller", ["--regime {dragan,obstacles}", "--backend {torch,onnx}"]),
        ("evaluate single-scene", ["--env {2d,panda}"]),
        ("evaluate unseen", ["{diffusion-policy-2d,diffusion-policy-panda,DIR}"]),
        ("bench", ["--device {cpu,cuda,cuda:N}"]),
        ("completion", ["{bash,zsh}"]),
    ],
)  # fmt: skip
def test_choices_are_shown(line, options):
    text = help_of(line)
    for option in options:
        assert option in text


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("plan scene.yaml --observer dragon", "dragan, paper or a file, .yaml or .json, got"
         " 'dragon'; did you mean dragan?"),
        ("plan scene.yaml --model block-reach-2D", "did you mean block-reach-2d?"),
        ("plan solid.yaml --out m.csv --arm Panda", "one of panda, or a YAML or JSON file, got"
         " 'Panda'; did you mean panda?"),
        ("plan solid.yaml --out m.csv --limits fr4", "limits must be one of panda, fr3,"
         " moveit-panda, point, got 'fr4'; did you mean fr3?"),
        ("plan solid.yaml --out m.csv --arm panda --frame word", "did you mean world?"),
        ("execute scene.yaml --env 2-d", "got '2-d'; did you mean 2d?"),
        ("data --out d --regime obstacle", "did you mean obstacles?"),
        ("data --out d --label ranked", "label must be one of anchored, rank, got 'ranked'"),
        ("data --out d --cluster locale", "did you mean local?"),
        ("evaluate dial --modes quick exakt", "modes must be one of bare, quick, exact, got"
         " 'exakt'; did you mean exact?"),
        ("evaluate dial --closed-loop --regime all", "of executed motions must be one of paper"),
        ("evaluate controller --backend onx", "one of torch, onnx, got 'onx'; did you mean onnx?"),
        ("evaluate table1 --env pander", "did you mean panda?"),
        ("evaluate table1 --diffusion-policy difusion-policy-2d",
         "did you mean diffusion-policy-2d?"),
        ("completion bsh", "shell must be one of bash, zsh, got 'bsh'; did you mean bash?"),
    ],
)  # fmt: skip
def test_a_wrong_choice_is_told_with_the_right_ones(line, message, refused):
    assert message in refused(line)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("", "a verb is missing, one of plan, execute, "),
        ("train", "a verb of train is missing, one of all, path, distill, "),
        ("pln scene.yaml", "there is no verb 'pln', only plan, execute, "),
        ("pln scene.yaml", "; did you mean plan?"),
        ("evalute dial", "; did you mean evaluate?"),
        ("dial", "; did you mean evaluate dial?"),
        ("evaluate dail", "there is no verb of evaluate 'dail', only dial, "),
        ("evaluate dail", "; did you mean evaluate dial?"),
        ("train dial", "there is no verb of train 'dial', only all, path, "),
    ],
)
def test_a_misspelt_verb(line, message, refused):
    assert message in refused(line)


def test_an_unknown_verb_that_resembles_none(refused):
    assert "did you mean" not in refused("xxxxxxxx")


@pytest.mark.parametrize(
    ("line", "flag"),
    [("plan s.yaml --legiblity 1", "--legibility"), ("evaluate dial --scene 3", "--scenes"),
     ("data --out d --worker 2", "--workers")],
)  # fmt: skip
def test_a_misspelt_option(line, flag, here, refused):
    assert f"; did you mean {flag}?" in refused(line)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("plan", "missing from legibility plan: SCENE (legibility plan --help tells more)"),
        ("plan s.yaml --arm", "missing value for argument '--arm'. Expected 1 values."),
        ("plan s.yaml t.yaml", "unrecognized options: t.yaml"),
        ("evaluate dial --scenes s.yaml", "error parsing --scenes: invalid literal for int()"),
        ("train path --out x", "missing from legibility train path: --data DIR"),
    ],
)
def test_mistakes_are_told_in_one_line(line, message, refused):
    assert message in refused(line)


@pytest.mark.parametrize("group", GROUPS)
def test_a_group_lists_its_verbs(group, capsys):
    assert main([group, "--help"]) == 0
    text = capsys.readouterr().out
    for name, summary in members(group).items():
        assert f"• {name}" in text
        assert summary.split()[0] in text


CSV = "x,y,weight\n0,0.5,1\n0.8,0.6,2\n"


@pytest.mark.parametrize("line", ["score t.csv scene.yaml --json j.json --quiet",
                                  "score t.csv scene.yaml --json j.json -q",
                                  "--quiet score t.csv scene.yaml --json j.json"])  # fmt: skip
def test_quiet_writes_files_alone(line, here, capsys):
    Path("t.csv").write_text(CSV)
    assert main(line.split()) == 0
    assert capsys.readouterr() == ("", "")
    assert json.loads(Path("j.json").read_text())["command"] == f"legibility {line}"


def test_quiet_still_tells_errors(refused):
    assert "cannot read the trajectory file" in refused("score none.csv scene.yaml --quiet")


def test_verbose_tells_what_is_read_and_written(here, capsys):
    Path("t.csv").write_text(CSV)
    line = "score t.csv scene.yaml --json j.json"
    assert main([*line.split(), "--verbose"]) == 0
    loud = capsys.readouterr()
    lines = [re.sub(r"\d+\.\d+ s", "T", text) for text in loud.err.splitlines()]
    assert lines == [
        "legibility: T: read the scene file scene.yaml",
        "legibility: T: read the trajectory file t.csv",
        "legibility: t.csv: columns ignored: weight",
        "legibility: T: built the archives and rated the trajectories in T",
        "legibility: T: wrote j.json",
        "legibility: T: ended",
    ]
    assert main(line.split()) == 0
    normal = capsys.readouterr()
    assert normal.out == loud.out
    assert normal.err == "legibility: t.csv: columns ignored: weight\n"


def test_verbose_tells_what_is_loaded(here, capsys):
    assert main(["plan", "scene.yaml", "-v"]) == 0
    errors = capsys.readouterr().err
    for text in ("path.safetensors", "block-reach-2d runs by torch", "planned 3 paths in "):
        assert text in errors


def test_quiet_and_verbose_exclude_each_other(refused):
    assert "give --quiet or --verbose, not both" in refused("doctor --quiet --verbose")
