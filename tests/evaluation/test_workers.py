"""What is measured does not depend on how many processes measure it."""

import pytest

from legibility.evaluation.configuration import DialConfig, EyesConfig
from legibility.evaluation.dial import evaluate_dial
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
