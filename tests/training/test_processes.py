"""Several processes train as one does, and resume after one of them was killed."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from trainings import CPU, TINY, rows

import legibility as lg
from legibility.models.checkpoint import load_tensors
from legibility.training.configuration import PathTrainingConfig
from legibility.training.loop import CHECKPOINT, Run
from legibility.training.path import train_path

pytest.importorskip("accelerate", reason="the extra named train is not installed")
psutil = pytest.importorskip("psutil")

STEPS = 40
WORDS = (
    f"train path --steps {STEPS} --scenes 4 --per-scene 4 --warmup 2"
    " --validate-every 1000000 --checkpoint-every 1 --channels 8 16 --condition 16"
    " --encoder-width 8 --resolution 16 --device cpu"
)
ENVIRONMENT = {
    **os.environ, "PYTHONPATH": str(Path(lg.__file__).parents[1]), "OMP_NUM_THREADS": "1"
}  # fmt: skip


SCRIPT = """
import sys, weakref
from torch.distributed import distributed_c10d
from legibility.cli import main
from legibility.training.team import Team

leave = Team.leave
def watched(team):
    group = weakref.ref(distributed_c10d._get_default_group())
    import torch._dynamo  # binds the group if a module of PyTorch was imported too late
    leave(team)
    assert group() is None
Team.leave = watched
sys.exit(main(sys.argv[1:]))
"""
"""The command, which also checks that nothing is left of the group of processes that it ends."""


def start(script, *words):
    """Two processes of one run."""
    launcher = "-m torch.distributed.run --standalone --nproc-per-node=2"
    return subprocess.Popen(
        [sys.executable, *launcher.split(), *map(str, [script, *words])], env=ENVIRONMENT,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip


def finish(run):
    out, err = run.communicate(timeout=300)
    assert run.returncode == 0, err
    return out


def values(folder):
    names = ("step", "loss", "velocity", "label", "contact", "jerk")
    return [[row[name] for name in names] for row in rows(folder)]


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="no SIGKILL on this system")
def test_two_of_which_one_is_killed_resume_and_take_the_steps_of_one(folders, data, tmp_path):
    two, words = tmp_path / "two", [*WORDS.split(), "--data", folders / "train"]
    words += ["--validation", folders / "train", "--out", two]
    (script := tmp_path / "script.py").write_text(SCRIPT)
    run = start(script, *words)
    deadline = time.monotonic() + 200
    while not (two / CHECKPOINT).exists() and run.poll() is None:
        assert time.monotonic() < deadline
        time.sleep(0.05)
    (second,) = (p for p in psutil.Process(run.pid).children() if p.environ().get("RANK") == "1")
    second.kill()
    run.communicate(timeout=200)
    assert run.returncode != 0
    done = load_tensors(two / CHECKPOINT)[1]["step"]
    assert 0 < done < STEPS
    before = values(two)[:done]

    printed = finish(start(script, *words))
    assert printed.count(f"parameters after {STEPS} steps") == 1
    made = json.loads((two / "weights" / "config.json").read_text())
    assert made["path"]["training"]["processes"] == 2
    after = values(two)
    assert [row[0] for row in after] == list(range(1, STEPS + 1))
    assert after[:done] == before

    config = PathTrainingConfig(
        steps=STEPS, scenes=4, per_scene=4, warmup=2, validate_every=10**6, checkpoint_every=1
    )
    train_path(data, data, Run(tmp_path / "one", CPU), config, **TINY)
    np.testing.assert_allclose(after[:10], values(tmp_path / "one")[:10], rtol=1e-3, atol=1e-4)
