"""What the texts about measurements share."""

from __future__ import annotations

import textwrap
from typing import Any

__all__ = ["WORLDS", "filled", "goals_of", "threads_of"]

WORLDS = {
    "BlockReach2D": "BlockReach2D, each robot with a gain and a lag that it does not know",
    "PandaBlockReach": "PandaBlockReach (the Panda on MuJoCo), each arm with a response and a "
    "delay that it does not know",
    "PandaGymBlockReach": "PandaGymBlockReach (the Panda of panda-gym, which was not trained in)",
}


def goals_of(config: dict[str, Any]) -> str:
    """How many goals the scenes of a configuration have."""
    low, high = config["goals"]
    return f"{low} goals" if low == high else f"{low} to {high} goals"


def threads_of(facts: dict[str, Any]) -> str:
    """On how many threads something ran."""
    return f"{facts['threads']} thread{'s' * (facts['threads'] > 1)}"


def filled(paragraph: str) -> str:
    """The paragraph in lines of at most 100 characters, as far as its words allow."""
    return textwrap.fill(paragraph, 100, break_long_words=False, break_on_hyphens=False)
