import json
from pathlib import Path


def test_dial(here, weights, cli, capsys):
    flags = "--scenes 2 --goals 2..3 --seed 1 --levels 5 --samples 2 --candidates 2"
    assert cli(f"evaluate dial {flags} --json e.json --figure e.svg --model", weights) == 0
    text = capsys.readouterr().out
    content = json.loads(Path("e.json").read_text())
    assert content["command"].startswith("legibility evaluate dial --scenes 2 ")
    assert content["seed"] == 1
    assert content["config"]["goals"] == [2, 3]
    assert content["config"]["guidance"] is None
    assert content["model"]["name"] == weights
    assert len(content["result"]["scenes"]) == 2
    for name, figures in content["result"]["overall"].items():
        assert name in text
        assert len(figures["interval"]) == 2
    assert "<svg" in Path("e.svg").read_text()
