"""How a motion under way goes on when its robot was pushed or its scene has changed.

The rest of the path followed so far, moved to where robot and goal are now, is tried first. Where
it cannot be brought to the ℓ of the whole motion, stage 1 draws rests of all levels. All set out in
the direction of motion, and what was already said counts. Where nothing else is out of contact, the
archive's nearest curve from here takes over, whatever its direction.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..checks import Array
from ..curves import NUM_WAYPOINTS, arc_length, path_curve, resample, turning
from ..intent.metrics import SCORE_POINTS
from ..motion.archive import Archive, scene_archive
from ..motion.path import Path, least_margin, straight_waypoints
from ..motion.rough_archive import rough_archive
from ..parts import Parts
from ..scene import MIN_SEPARATION, TOUCH, Scene
from .path_sampler import PathSampler, Sampling, Tasks, detour_of, nearest_path
from .projection import Begun, headed, projected, smoothed, start_turns

_MISSED, _WAVES, _EXCESS = 0.02, 0.4, 0.01  # faults, as those of a plan
_TOO_LONG = 100.0  # added to the fault of a motion that is
_LEVELS = np.linspace(-1, 1, 9)  # of the rests drawn
_TRIED = 3  # of them, those nearest to the score wanted
_SPARE = 1.05  # by which a rest may be longer than the straight line if no length is left


@dataclass(frozen=True)
class Rest:
    """A motion under way that needs a new rest.

    Attributes:
        begun: the motion so far, its scene as it is now.
        now: the same scene, whatever its start: where something has come to the motion's start, a
            scene that starts there keeps clear of less.
        remaining: `(K + 2, D)` [m], what is left of the path followed, to where its goal was.
        path: the path followed; the ℓ asked for, the target and the observer are its own.
    """

    begun: Begun
    now: Scene
    remaining: Array
    path: Path

    @cached_property
    def scene(self) -> Scene:
        """The scene from the present position."""
        return self.now.starting_at(self.begun.states[-1])

    def follow(self, waypoints: Array, *, replaced: bool = False) -> Path:
        """The path through `waypoints (K + 2, D)` [m] from here."""
        path = self.path
        return Path(
            self.scene, path.target, path.legibility, waypoints, path.observer, np.bool_(replaced)
        )


def moved_rest(rest: Rest) -> Array:
    """What is left of the path, moved to where robot and goal are now, `(K + 2, D)` [m]."""
    old, scene = rest.remaining, rest.scene
    share = np.linspace(0, 1, NUM_WAYPOINTS + 2)[:, None]
    goal = scene.goals[rest.path.target]
    moved = old + (1 - share) * (scene.start - old[0]) + share * (goal - old[-1])
    moved[0], moved[-1] = scene.start, goal
    return moved


def caught_up(rest: Rest) -> Path:
    """What is left of the path, moved, for a robot that has gone on a little since it was clear.

    In the direction of motion, unless only the path as it is keeps clear.
    """
    plain = moved_rest(rest)[None]
    paths = np.concatenate([headed(plain, rest.begun.heading), plain])
    return rest.follow(paths[np.argmax(_free(rest.scene, rest.path.target, paths))])


def mended(rest: Rest) -> Parts[Path | None]:
    """What is left of the path, moved and out of contact, its score as it is.

    None if it cannot be brought out of contact.
    """
    path = caught_up(rest)
    scene, target, waypoints = path.scene, path.target, path.waypoints[None]
    if _free(scene, target, waypoints)[0]:
        return path
    paths, clear = yield from projected(waypoints, scene, target, path.observer, begun=rest.begun)
    if clear[0] or _free(scene, target, paths)[0]:
        return rest.follow(paths[0])
    return None


def brought(
    rest: Rest, archive: Archive, max_detour: float | None = None
) -> Parts[tuple[Path, float]]:
    """What is left of the path, moved, out of contact and brought to the ℓ of the whole motion.

    Args:
        rest: that is to be replaced.
        archive: by which ℓ is read.
        max_detour: see `continuation`.

    Returns:
        The path and its fault: one up to 1 is none, inf is in contact.
    """
    wanted = archive.score_of(np.atleast_1d(rest.path.legibility))
    paths, faults = yield from _Judge(rest, archive, max_detour).brought(
        moved_rest(rest)[None], wanted
    )
    return rest.follow(paths[0]), float(faults[0])


def continuation(
    rest: Rest,
    sampler: PathSampler,
    seed: int,
    sampling: Sampling,
    *,
    exact: bool = False,
    max_detour: float | None = None,
    accepts: Callable[[Path], Parts[bool]] | None = None,
) -> Generator[Path | None, None, Path]:
    """The new rest of a motion, in parts, between which better and better ones may come.

    Args:
        rest: that is to be replaced.
        sampler: of stage 1.
        seed: of the rests drawn.
        sampling: of them.
        exact: whether the ℓ of the whole is read by the scene's archive, not by a rough one.
        max_detour: longest motion over the shortest, as far as what was done allows.
        accepts: whether a whole arm, say, can follow a path, in parts; one that it refuses is
            returned only if it refuses all.

    Raises:
        InvalidSceneError: no curve to the target was found.
    """
    begun, target, observer = rest.begun, rest.path.target, rest.path.observer
    scene, level = rest.scene, float(rest.path.legibility)
    rest.now.check_target(target)
    archive_of = scene_archive if exact else rough_archive
    archive = yield from archive_of.parts(begun.scene, target, observer)
    judge = _Judge(rest, archive, max_detour)
    first = moved_rest(rest)[None]
    paths, faults = yield from judge.brought(first, archive.score_of(np.array([level])))
    found = rest.follow(paths[0])
    if np.isfinite(faults[0]):
        accepted = accepts is None or (yield from accepts(found))
        if accepted and faults[0] <= 1:
            return found
        yield found if accepted else None
    goal = scene.goals[target]
    if np.linalg.norm(goal - scene.start) < 2 * MIN_SEPARATION * scene.diagonal:
        # Nearer than any start in training.
        drawn = straight_waypoints(scene.start, goal)[None]
    else:
        yield from rough_archive.parts(scene, target, observer)
        tasks = Tasks([scene], [target], [observer], _LEVELS)
        drawn = smoothed((yield from sampler.drawn(tasks, seed, sampling)))
    yield
    plain = headed(first, begun.heading)  # as it is, where its score cannot be helped
    more, theirs = yield from judge.brought(plain, judge.scores(plain))
    paths, faults = np.concatenate([paths, more]), np.append(faults, theirs)
    yield
    drawn = headed(drawn, begun.heading)
    scores = judge.scores(drawn)
    reachable = np.append(scores, judge.scores(paths))
    wanted = np.clip(archive.score_of(level), reachable.min(), reachable.max())
    order = np.argsort(np.abs(archive.label_of(scores) - archive.label_of(wanted)), kind="stable")
    for i in order[:_TRIED]:
        more, theirs = yield from judge.brought(drawn[[i]], wanted[None])
        paths, faults = np.concatenate([paths, more]), np.append(faults, theirs)
        yield
    clear = [rest.follow(paths[i]) for i in np.argsort(faults, kind="stable") if faults[i] < np.inf]
    for found in clear:
        if accepts is None or (yield from accepts(found)):
            return found
    if clear:
        return clear[0]
    for made in (rough_archive, scene_archive):
        elites = yield from made.parts(scene, target, observer)
        path = nearest_path(elites, level)
        yield
        if _free(scene, target, path[None])[0]:
            break
    return rest.follow(path, replaced=True)


class _Judge:
    """Judges new rests of a motion by what the whole will be."""

    def __init__(self, rest: Rest, archive: Archive, max_detour: float | None) -> None:
        self.begun, self.archive, self.scene = rest.begun, archive, rest.scene
        self.target, self.observer = rest.path.target, rest.path.observer
        self.level = float(rest.path.legibility)
        gone = float(arc_length(self.begun.states))
        straight = float(np.linalg.norm(self.scene.goals[self.target] - self.scene.start))
        allowed = detour_of(self.observer, max_detour) * archive.shortest_length
        self.longest = max(allowed, gone + _SPARE * straight)
        self.before = np.empty((0, self.scene.dim))
        if gone > 0:
            self.before = resample(self.begun.states, SCORE_POINTS)[:-1]
        self.least = self._turned(moved_rest(rest)[None])

    def scores(self, paths: Array) -> Array:
        """The score of the motion so far and each of `paths (B, K + 2, D)` after it, `(B,)`."""
        before = np.broadcast_to(self.before, (len(paths), *self.before.shape))
        motions = np.concatenate([before, path_curve(paths, SCORE_POINTS)], axis=1)
        return self.observer.score(motions, self.begun.scene, self.target)

    def brought(self, paths: Array, wanted: Array) -> Parts[tuple[Array, Array]]:
        """Paths out of contact with the score `wanted (B,)` of the whole, and their faults.

        A fault is inf for one in contact.
        """
        heading, observer = self.begun.heading, self.observer
        moved, clear = yield from projected(
            headed(paths, heading), self.scene, self.target, observer, wanted, self.longest,
            self.begun,
        )  # fmt: skip
        clear[~clear] = _free(self.scene, self.target, moved[~clear])
        missed = np.abs(self.archive.label_of(self.scores(moved)) - self.level)
        curves = path_curve(moved, SCORE_POINTS)
        length = float(arc_length(self.begun.states)) + arc_length(curves)
        turned = self._turned(moved)
        waves, excess = turned - self.least, length / self.longest - 1
        fault = missed / _MISSED
        for over, allowed in ((waves, _WAVES), (excess, _EXCESS)):
            fault += np.maximum(over / allowed, 0)
        fault += _TOO_LONG * (excess > _EXCESS)
        return moved, np.where(clear, fault, np.inf)

    def _turned(self, paths: Array) -> Array:
        """Angles `(B,)` [rad] that paths turn through, also from the direction of motion."""
        turned = turning(path_curve(paths, SCORE_POINTS))
        if self.begun.heading.any():
            turned += start_turns(paths, self.begun.heading)
        return turned


def _free(scene: Scene, target: int, paths: Array) -> NDArray[np.bool]:
    """Whether each of `paths (B, K + 2, D)` keeps clear of everything, `(B,)`."""
    return least_margin(scene, target, paths) >= -TOUCH * scene.diagonal
