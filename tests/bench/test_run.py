import subprocess
import sys
from unittest.mock import Mock

import pytest

from legibility.bench import BenchConfig, measure, run_bench
from legibility.errors import InvalidInputError, MissingExtraError
from legibility.modulator import Modulator


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"seconds": 0}, "seconds must be"),
        ({"rounds": 0}, "rounds must be"),
        ({"threads": 0}, "threads must be"),
        ({"robots": 0}, "robots must be"),
        ({"batches": (16, 1)}, "batches must be increasing"),
        ({"batches": ()}, "batches must be increasing"),
        ({"batches": (0, 1)}, "batches must be"),
        ({"goals": (1, 2)}, r"goals must lie in \[2, 12\]"),
        ({"goals": (2, 13)}, r"goals must lie in \[2, 12\]"),
    ],
)
def test_refuses(settings, message):
    with pytest.raises(InvalidInputError, match=message):
        BenchConfig(**settings)


def test_no_models():
    with pytest.raises(InvalidInputError, match="models must be at least one"):
        run_bench([])


def test_missing_parts_are_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    for name in ("plans", "data", "training", "processes"):
        monkeypatch.setattr(measure, name, lambda *_: [])
    Modulator(Modulator.from_pretrained("block-reach-2d").path_diffuser).save_pretrained(tmp_path)
    onnx, motions = run_bench([str(tmp_path)])["skipped"]
    assert "pip install" in onnx
    assert motions == f"motions of {tmp_path}: it has no stage 2"


def test_a_missing_simulator_is_named(monkeypatch):
    monkeypatch.setattr(measure, "BACKENDS", ("torch",))
    for name in ("plans", "data", "training", "processes"):
        monkeypatch.setattr(measure, name, lambda *_: [])
    monkeypatch.setattr(measure, "vector_type", Mock(side_effect=MissingExtraError("no MuJoCo")))
    assert run_bench(["block-reach-2d"])["skipped"] == ["no MuJoCo"]


def test_importing_the_bench_loads_no_torch():
    code = "import sys, legibility.cli.bench; print('torch' in sys.modules)"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "False"
