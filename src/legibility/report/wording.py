"""Phrases that the texts about measurements share."""

from __future__ import annotations

from typing import Any

__all__ = ["WORLDS", "goals_of", "percent", "scenes_of", "threads_of"]

WORLDS = {
    "BlockReach2D": "BlockReach2D, where each robot has a gain and a lag that it does not know",
    "PandaBlockReach": "PandaBlockReach (the Panda on MuJoCo), where each arm has a response and a "
    "delay that it does not know",
    "PandaGymBlockReach": "PandaGymBlockReach (the Panda of panda-gym, never used in training)",
}


def goals_of(config: dict[str, Any]) -> str:
    """How many goals the scenes of a configuration have."""
    low, high = config["goals"]
    return f"{low} goals" if low == high else f"{low} to {high} goals"


def scenes_of(document: dict[str, Any]) -> str:
    """The held-out scenes of an evaluation."""
    config = document["config"]
    return (
        f"{config['scenes']:,} held-out random scenes with {goals_of(config)} "
        f"(seed {document['seed']})"
    )


def threads_of(facts: dict[str, Any]) -> str:
    """The number of threads that something ran on."""
    return f"{facts['threads']} thread{'s' * (facts['threads'] > 1)}"


def percent(share: float) -> str:
    """A share in percent with two decimals."""
    return f"{share:.2%}"
