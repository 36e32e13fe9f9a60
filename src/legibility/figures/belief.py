"""Whose belief is shown: Dragan's observer's, beside that of the one the dial is turned for."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..checks import Array
from ..intent.metrics import time_to_confidence
from ..intent.observer import DEFAULT_OBSERVER, Observer
from ..scene import Scene

if TYPE_CHECKING:
    from ..rollout import Rollout

DRAGAN = "Dragan’s observer"


class Reader(NamedTuple):
    """An observer whose belief is shown.

    Attributes:
        observer: the observer.
        short: the name beside an axis or above a column.
        title: the name in full.
    """

    observer: Observer
    short: str
    title: str

    def belief(self, rollout: Rollout) -> tuple[Array, float]:
        """P(g) at each state, `(T + 1, G)`, and the time to confidence [s], inf if never."""
        posterior = self.observer.field(rollout.path.scene).posterior(rollout.states)
        progress = float(time_to_confidence(posterior, rollout.path.target))
        return posterior, round(progress * len(rollout.actions) * rollout.step_seconds, 9)


def readers(scene: Scene, observer: Observer) -> list[Reader]:
    """Dragan's observer, and the `observer` that the dial is turned for if it reads otherwise."""
    found = [Reader(DEFAULT_OBSERVER, DRAGAN, DRAGAN)]
    if not _read_alike(scene, observer, DEFAULT_OBSERVER):
        title = f"the observer the dial is turned for ({describe(scene, observer)})"
        found.append(Reader(observer, "the dial’s observer", title))
    return found


def describe(scene: Scene, observer: Observer) -> str:
    """How an observer reads positions in a scene, as `gaussian, uniform, σ = 0.15 m`."""
    if _read_alike(scene, observer, DEFAULT_OBSERVER):
        return DRAGAN
    field = observer.field(scene)
    prior = observer.prior
    if not isinstance(prior, str):
        prior = "prior " + " : ".join(f"{weight:.3g}" for weight in prior)
    words = [observer.kind, prior]
    if observer.kind == "boltzmann":
        width = f"β = {field.beta:.3g} m⁻¹"
    else:  # the narrowest direction is that across the line of sight
        width = f"σ = {np.linalg.eigvalsh(field.precision)[-1] ** -0.5:.3g} m"
    words.append(width.replace(" ", "\N{NO-BREAK SPACE}"))
    if observer.viewpoint is not None:
        eyes = ", ".join(f"{x:.3g}" for x in observer.viewpoint).replace("-", "−")
        words.append(f"seen from ({eyes}), depth {observer.depth:g}")
    return ", ".join(words)


def _read_alike(scene: Scene, observer: Observer, other: Observer) -> bool:
    """Whether two observers have the same belief at every position in a scene."""
    a, b = observer.field(scene), other.field(scene)
    return (
        a.beta == b.beta
        and np.array_equal(a.precision, b.precision)
        and np.array_equal(a.log_prior, b.log_prior)
    )
