"""A model that was loaded and used before a fork plans in the child, where it must not hang."""

import os
import signal
import subprocess
import sys

import pytest

LOAD = """
import os, sys, warnings
import numpy as np, torch
import legibility as lg
from legibility.modulator import Modulator
warnings.simplefilter("ignore")  # Python's own, about threads and forks

torch.set_num_threads(2)
model = Modulator.from_pretrained("block-reach-2d", backend=sys.argv[1])
scene, levels = lg.Scene([0, .5], [[.8, .6], [1, .3]]), np.linspace(-1, 1, 64)
paths = model.plan(scene, 0, levels).waypoints
torch.randn(512, 512) @ torch.randn(512, 512)  # the threads of the pool have begun
"""
FORK = """
child = os.fork()
if not child:
    same = np.allclose(model.plan(scene, 0, levels).waypoints, paths, atol=1e-5)
    os._exit(0 if same else 3)
assert os.waitpid(child, 0)[1] == 0
"""
POOL = """
import multiprocessing
with multiprocessing.get_context("fork").Pool(2) as pool:
    for path in pool.starmap(model.plan, [(scene, 0, levels)] * 2):
        np.testing.assert_allclose(path.waypoints, paths, atol=1e-5)
"""
AFTER = """
assert torch.get_num_threads() == 2
np.testing.assert_allclose(model.plan(scene, 0, levels).waypoints, paths, atol=1e-5)
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system does not fork")
@pytest.mark.parametrize("backend", ["torch", "onnx"])
def test_a_forked_child_plans_the_same(backend):
    if backend == "onnx":
        pytest.importorskip("onnxruntime", reason="the extra named onnx is not installed")
    with subprocess.Popen(
        [sys.executable, "-c", LOAD + FORK + POOL + AFTER, backend],
        stderr=subprocess.PIPE, text=True, start_new_session=True,
    ) as process:  # fmt: skip
        try:
            _, errors = process.communicate(timeout=60)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            pytest.fail("the forked child hangs")
    assert process.returncode == 0, errors
