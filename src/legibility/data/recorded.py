"""Datasets of recorded motions, labelled on the dial of the scene that each was recorded in."""

from __future__ import annotations

import hashlib
import itertools
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..checks import Array
from ..curves import NUM_WAYPOINTS, cumulative_length, path_curve, resample
from ..errors import InvalidInputError, InvalidSceneError
from ..files import read_document
from ..intent.metrics import SCORE_POINTS
from ..motion.archive import passable
from ..motion.recording import Recording
from ..scene import Scene
from .configuration import with_target_first

ENDS, NEAR = 0.05, 0.01
"""How far a recording may begin from the start or end from its target, over the diagonal, and how
far without a word."""


def read_scenes(file: str | Path) -> dict[str, Scene]:
    """The scenes of a file by their names: one scene, or several under the key `scenes`.

    Several are a mapping of names to scenes, or a list, whose names are 0, 1, ….

    Raises:
        InvalidSceneError: the file is unreadable, holds no scene, or one of them is wrong.
    """
    content = read_document(file, "scene file", InvalidSceneError)
    if isinstance(content, list):  # as an export has it
        content = {"scenes": content}
    if not isinstance(content, dict) or "scenes" not in content:
        return {"": Scene.load(file)}
    several = content["scenes"]
    if isinstance(several, list):
        several = dict(enumerate(several))
    if not isinstance(several, dict) or not several or len(content) > 1:
        raise InvalidSceneError(
            f"{file}: scenes must be a list, or a mapping of names to scenes, and the only key"
        )
    found = {}
    for name, scene in several.items():
        try:
            found[str(name)] = Scene.from_dict(scene)
        except InvalidSceneError as cause:
            raise InvalidSceneError(f"{file}: scene {name}: {cause}") from cause
    if len({scene.dim for scene in found.values()}) > 1:
        raise InvalidSceneError(f"{file}: all scenes must be 2D, or all 3D")
    return found


class RecordedPaths:
    """Recorded motions as paths, by the scene and the target that each belongs to.

    Attributes:
        scenes: each with the target as goal 0, in the order of the recordings.
        paths: of each scene, `(M, K + 2, D)` [m]: start, waypoints at equal arc length, goal.
        touching: names of recordings that were left out since they touch something.
        off: names of recordings whose ends lie off the scene's by over `NEAR` of the diagonal.
        digest: hash of all paths and scenes.
    """

    def __init__(self, recordings: Sequence[Recording], scenes: Mapping[str, Scene]) -> None:
        """Assign every recording to its scene and target.

        The scene is that of the recording's name for it, or the only one. The target is that of the
        recording, or the goal nearest to its end. Ends near those of the scene (`ENDS`) are moved
        onto them, with what lies between in proportion.

        Raises:
            InvalidInputError: a recording names no scene, or its ends lie elsewhere.
            InvalidSceneError: no curve leads to a target.
        """
        groups: dict[tuple[str, int], list[Array]] = {}
        self.touching: list[str] = []
        self.off: list[str] = []
        for recording in recordings:
            name = _scene_of(recording, scenes)
            scene = scenes[name]
            target = _target_of(recording, scene)
            path = _path(recording, scene, target)
            gaps = np.linalg.norm(path[[0, -1]] - recording.motion[[0, -1]], axis=-1)
            if gaps.max() > NEAR * scene.diagonal:
                self.off.append(recording.name)
            if scene.feasible(path_curve(path[None], SCORE_POINTS), target)[0]:
                groups.setdefault((name, target), []).append(path)
            else:
                self.touching.append(recording.name)
        if not groups:
            raise InvalidInputError("there is no recording that keeps clear of everything")
        for name, target in groups:
            if not passable(scenes[name], target):
                raise InvalidSceneError(f"scene {name}: no curve was found to goals[{target}]")
        self.scenes = [with_target_first(scenes[name], target) for name, target in groups]
        self.paths = [np.stack(paths) for paths in groups.values()]
        content = (p.tobytes() for p in self.paths)
        named = (repr(scene.to_dict()).encode() for scene in self.scenes)
        self.digest = hashlib.sha256(b"".join(itertools.chain(content, named))).hexdigest()

    def config(self) -> dict[str, Any]:
        """What of a `DatasetConfig` the recordings decide."""
        return {"given": tuple(self.scenes), "scenes": len(self.scenes), "recordings": self.digest}


def _scene_of(recording: Recording, scenes: Mapping[str, Scene]) -> str:
    """The name of the recording's scene, which a longer text may tell as `scene NAME`."""
    if len(scenes) == 1:
        return next(iter(scenes))
    text = recording.scene or ""
    if text in scenes:
        return text
    named = [name for name in scenes if re.search(rf"\bscene {re.escape(name)}\b", text)]
    if len(named) != 1:
        got = "none" if recording.scene is None else repr(recording.scene)
        raise InvalidInputError(
            f"recording {recording.name!r} must name one of the scenes "
            f"{', '.join(list(scenes)[:10])}, got {got}"
        )
    return named[0]


def _target_of(recording: Recording, scene: Scene) -> int:
    """The index of the recording's target: its own, or the goal nearest to its end."""
    if recording.dim != scene.dim:
        raise InvalidInputError(
            f"recording {recording.name!r} is {recording.dim}D, its scene is {scene.dim}D"
        )
    if recording.target is not None:
        return scene.check_target(recording.target)
    return int(np.argmin(np.linalg.norm(scene.goals - recording.motion[-1], axis=-1)))


def _path(recording: Recording, scene: Scene, target: int) -> Array:
    """The motion as a path `(K + 2, D)` [m] between the scene's start and its target."""
    motion = recording.motion
    ends = np.stack([scene.start, scene.goals[target]])
    gaps = ends - motion[[0, -1]]
    for which, gap in zip(("start", f"target goals[{target}]"), gaps, strict=True):
        if (apart := float(np.linalg.norm(gap))) > ENDS * scene.diagonal:
            raise InvalidInputError(
                f"recording {recording.name!r} is {apart:.3g} m off the {which}, at most "
                f"{ENDS * scene.diagonal:.3g} m are allowed"
            )
    progress = cumulative_length(motion)[:, None] / cumulative_length(motion)[-1]
    path = resample(motion + (1 - progress) * gaps[0] + progress * gaps[1], NUM_WAYPOINTS + 2)
    path[[0, -1]] = ends
    return np.concatenate([path[:1], np.clip(path[1:-1], *scene.workspace), path[-1:]])
