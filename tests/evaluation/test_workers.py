"""What is measured does not depend on how many processes measure it."""

import pytest

from legibility.envs.block_reach_2d import BlockReach2DVector
from legibility.evaluation import execution
from legibility.evaluation.configuration import DialConfig, ExecutionConfig, EyesConfig
from legibility.evaluation.dial import evaluate_dial
from legibility.evaluation.execution import ROWS, evaluate_execution
from legibility.evaluation.eyes import evaluate_eyes

CONFIGS = {
    evaluate_dial: DialConfig(scenes=2, levels=3, samples=1, candidates=0, regime="all"),
    evaluate_eyes: EyesConfig(scenes=2, levels=3, samples=1),
}


@pytest.mark.parametrize("evaluate", CONFIGS)
def test_the_same_for_any_number_of_workers(evaluate, tiny):
    seen = []
    alone = evaluate(tiny, CONFIGS[evaluate])
    shared = evaluate(
        tiny, CONFIGS[evaluate], workers=2, progress=lambda *count: seen.append(count)
    )
    assert shared == alone
    assert seen == [(n, 2) for n in range(3)]


def test_motions_and_their_progress_too(exact, monkeypatch):
    some = {name: ROWS[name] for name in ("policy", "policy, pushed", "open loop")}
    monkeypatch.setattr(execution, "ROWS", some)
    monkeypatch.setattr(BlockReach2DVector, "at_once", 2)
    config = ExecutionConfig(scenes=1, rollouts=5)
    total = 1 + 5 * len(some)

    def measured(workers):
        counts = []
        found = evaluate_execution(
            exact, config, workers=workers, progress=lambda *count: counts.append(count)
        )
        assert counts[-1] == (total, total)
        assert len(counts) == 1 + 3 * len(some)
        assert counts == sorted(counts)
        return found["rows"]

    assert measured(1) == measured(2)
