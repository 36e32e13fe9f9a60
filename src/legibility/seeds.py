"""Seed streams: training, validation and reported evaluations never share a seed."""

import numpy as np

STREAMS = ("train", "validation", "evaluation")
"""Training data, validation data, reported evaluations."""

_USES = ("scene", "archive", "choice", "plan", "demonstration", "observer")


def stream_seed(stream: str, seed: int, index: int, use: str) -> np.random.SeedSequence:
    """The seed of one use of item `index` of a stream, independent of all others.

    Args:
        stream: one of `STREAMS`.
        seed: of the dataset or evaluation.
        index: of the item.
        use: `scene`, `archive`, `choice` (of trajectories), `plan`, `demonstration` or
            `observer`.
    """
    key = _USES.index(use)
    return np.random.SeedSequence([STREAMS.index(stream), seed, index], spawn_key=(key,))


def plan_seeds(seed: int, index: int, number: int, use: str = "plan") -> list[int]:
    """`number` seeds of plans or environments for item `index` of an evaluation."""
    words = stream_seed("evaluation", seed, index, use).generate_state(number, np.uint64)
    return [int(word >> 2) for word in words]
