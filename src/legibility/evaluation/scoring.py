"""Recorded motions by every metric, and an observer's belief over their time."""

from __future__ import annotations

import functools
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, overload

import numpy as np

from ..checks import Array, bounded
from ..curves import resample
from ..errors import InvalidInputError, InvalidSceneError
from ..intent.metrics import SCORE_POINTS, evaluate_trajectory
from ..intent.observer import DEFAULT_OBSERVER, Observer
from ..motion.archive import Archive, scene_archive
from ..motion.recording import Recording
from ..scene import Scene

TOLERANCE = 0.03
"""How far beyond a wall a recorded point may lie, over the workspace's diagonal."""


@dataclass(frozen=True, eq=False)
class Score:
    """A recorded motion, as one observer reads it.

    Attributes:
        recording: the recording.
        archive: the archive of the scene, the target and the observer, whose dial it is read off.
    """

    recording: Recording
    archive: Archive

    @property
    def achieved(self) -> float:
        """The label ℓ in [−1, 1] of the motion in the scene's archive."""
        return self.metrics["achieved_label"]

    @functools.cached_property
    def metrics(self) -> dict[str, float]:
        """Every metric by its name.

        `achieved_label`; those of `evaluate_trajectory`; `length_ratio`, over the shortest feasible
        length; `clearance` [m]; `duration` [s], if the recording has times; `start_gap` and
        `target_gap` [m], distance of the ends from the scene's; `noise` [m] and `lost`, see
        `Recording`.
        """
        recording, archive, motion = self.recording, self.archive, self.recording.motion
        scene, target = archive.scene, archive.target
        found = evaluate_trajectory(motion, archive.field, target, archive.observer.alpha)
        dense = resample(motion, 4 * SCORE_POINTS)
        goal = scene.goals[target]
        rest: dict[str, Any] = {
            "length_ratio": found["length"] / archive.shortest_length,
            "clearance": scene.clearance_at(dense, target).min(),
            "start_gap": np.linalg.norm(motion[0] - scene.start),
            "target_gap": np.linalg.norm(motion[-1] - goal),
            "noise": recording.noise,
            "lost": recording.lost,
        }
        if recording.times is not None:
            rest["duration"] = np.ptp(recording.motion_times)
        label = archive.label_of(found["legibility_score"])
        values = {"achieved_label": label, **found, **rest}
        return {name: float(value) for name, value in values.items()}

    @functools.cached_property
    def belief(self) -> Array:
        """The observer's P(g) at each of `recording.motion_times`, `(M, G)`."""
        return self.archive.field.posterior(self.recording.motion)


@overload
def score(
    recordings: Recording,
    scene: Scene,
    target: int | None = None,
    *,
    observer: Observer = DEFAULT_OBSERVER,
    tolerance: float | None = None,
) -> Score: ...
@overload
def score(
    recordings: Iterable[Recording],
    scene: Scene,
    target: int | None = None,
    *,
    observer: Observer = DEFAULT_OBSERVER,
    tolerance: float | None = None,
) -> list[Score]: ...
def score(
    recordings: Recording | Iterable[Recording],
    scene: Scene,
    target: int | None = None,
    *,
    observer: Observer = DEFAULT_OBSERVER,
    tolerance: float | None = None,
) -> Score | list[Score]:
    """Rate recorded motions in a scene; no model is needed.

    Args:
        recordings: one or several.
        scene: the scene that they were recorded in.
        target: index of the intended goal; if not given, that of each recording, or 0.
        observer: who reads the motions.
        tolerance: how far beyond a wall a point may lie [m]; if not given, 3 % of the workspace's
            diagonal.

    Returns:
        A score, or a list of them.

    Raises:
        InvalidInputError: an argument is out of its range, a recording is of another dimension,
            lies outside or does not move.
        InvalidSceneError: a motion cannot end at a target.
    """
    if isinstance(recordings, Recording):
        return score([recordings], scene, target, observer=observer, tolerance=tolerance)[0]
    if not isinstance(scene, Scene):
        raise InvalidSceneError(f"scene must be a legibility.Scene, got {type(scene).__name__}")
    if not isinstance(observer, Observer):
        raise InvalidInputError(f"observer must be a legibility.Observer, got {observer!r}")
    return [_score(r, scene, target, observer, tolerance) for r in recordings]


def _score(
    recording: Recording,
    scene: Scene,
    target: int | None,
    observer: Observer,
    tolerance: float | None,
) -> Score:
    check_inside(recording, scene, tolerance)
    goal = recording.target if target is None else target
    archive = scene_archive(scene, scene.check_target(0 if goal is None else goal), observer)
    rated = Score(recording, archive)
    rated.metrics  # noqa: B018 (what does not move raises here)
    return rated


def check_inside(recording: Recording, scene: Scene, tolerance: float | None = None) -> None:
    """Raise unless a recording lies in a scene's workspace, or beyond it by `tolerance` [m]."""
    if not isinstance(recording, Recording):
        raise InvalidInputError(f"recordings must be legibility.Recording, got {recording!r}")
    if recording.dim != scene.dim:
        raise InvalidInputError(
            f"recording {recording.name!r} is {recording.dim}D, the scene is {scene.dim}D"
        )
    share = TOLERANCE if tolerance is None else bounded("tolerance", tolerance, 0) / scene.diagonal
    inside = scene.contains(recording.positions, share)
    if not inside.all():
        index = int(np.argmin(inside))
        raise InvalidInputError(
            f"recording {recording.name!r}: point {index}, {recording.positions[index].tolist()}, "
            f"lies over {share * scene.diagonal:.3g} m outside the workspace "
            f"{scene.workspace.tolist()}"
        )
