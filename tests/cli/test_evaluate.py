import json
from pathlib import Path

import pytest

from legibility.cli.evaluate import _worst


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


@pytest.mark.parametrize(
    ("what", "low", "high", "worst"),
    [
        ("a; higher = better", 0.1, 0.9, "0.1000"),
        ("a; lower = better", 0.1, 0.9, "0.9000"),
        ("a; nearer to −1 = better", -0.9, -0.2, "-0.2000"),
        ("a; nearer to 0 = better", -0.3, 0.2, "-0.3000"),
        ("a without a better side", 0, 1, ""),
    ],
)
def test_worst(what, low, high, worst):
    assert _worst(what, {"min": low, "max": high}) == worst
