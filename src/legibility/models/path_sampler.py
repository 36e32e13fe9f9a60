"""Paths drawn by stage 1 in scenes: in metres, feasible, at the ℓ asked for."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ..checks import Array, bounded
from ..curves import NUM_WAYPOINTS, arc_length, path_curve, turning
from ..errors import CheckpointError, InvalidInputError
from ..frame import Frame
from ..intent.metrics import SCORE_POINTS
from ..intent.observer import Observer
from ..motion.archive import Archive, scene_archive, shortest_curve
from ..motion.bezier import bezier_trajectories
from ..motion.path import least_margin
from ..motion.rough_archive import rough_archive
from ..parts import Parts, finished
from ..scene import TOUCH, Scene
from .configuration import PathDiffuserConfig, at_most
from .diffusion import standard_normal
from .path_diffuser import DIAL_LEVELS, PathDiffuser, dial_of
from .projection import project, smoothed

# Faults: an error of ℓ, an angle [rad] turned more than the archive's curves, and a length over the
# longest allowed.
_MISSED, _WAVES, _EXCESS = 0.02, 0.4, 0.01
_ELITES, _TRIED = 16, 4  # looked at as they are, of the nearest and of the smoothest; and brought


class Sampling(NamedTuple):
    """How paths are sampled.

    Attributes:
        guidance: weight of classifier-free guidance at ℓ = ±1; the model's if not given.
        steps: of the sampler; the model's if not given.
    """

    guidance: float | None = None
    steps: int | None = None

    def checked(self, config: PathDiffuserConfig) -> Sampling:
        """The same; raises if a model of these settings cannot sample so."""
        guidance, steps = self
        if guidance is not None:
            guidance = bounded("guidance", guidance, -1e3, 1e3)
        if steps is not None:
            at_most("steps", steps, config.diffusion_steps)
        fixed = config.guidance, config.sampling_steps
        if config.distilled and (guidance not in (None, fixed[0]) or steps not in (None, fixed[1])):
            raise InvalidInputError(
                f"a distilled model samples with guidance {fixed[0]:g} in {fixed[1]} steps only, "
                f"got guidance {guidance} and steps {steps}"
            )
        return Sampling(guidance, steps)


class Tasks(NamedTuple):
    """Paths to draw: `B` levels, in `B` scenes or in one for all.

    Attributes:
        scenes, targets, observers: `B` or 1 of each.
        levels: ℓ `(B,)`.
    """

    scenes: Sequence[Scene]
    targets: Sequence[int]
    observers: Sequence[Observer]
    levels: Array

    def __len__(self) -> int:
        return len(self.levels)

    def of(self, rows: NDArray[np.intp]) -> Tasks:
        """Those of some rows."""
        levels = self.levels[rows]
        if len(self.scenes) == 1:
            return Tasks(self.scenes, self.targets, self.observers, levels)
        scenes, targets, observers = ([values[i] for i in rows] for values in self[:3])
        return Tasks(scenes, targets, observers, levels)

    def rows(self) -> Iterator[tuple[slice, Scene, int, Observer]]:
        """Each scene, with its target and observer, and the rows that lie in it."""
        if len(self.scenes) == 1:
            yield slice(None), self.scenes[0], self.targets[0], self.observers[0]
            return
        for i, row in enumerate(zip(*self[:3], strict=True)):
            yield slice(i, i + 1), *row

    def margin(self, paths: Array) -> Array:
        """Least margin [m] of the curves through `paths (B, K + 2, D)`, `(B,)`, 0 if feasible."""
        margin = np.empty(len(self))
        for row, scene, target, _ in self.rows():
            least = least_margin(scene, target, paths[row])
            margin[row] = np.where(least < -TOUCH * scene.diagonal, least, 0.0)
        return margin


class PathSampler:
    """Draws paths in scenes with stage 1.

    Args:
        model: stage 1.
        sample: `PathDiffuser.sample`, as a backend runs it.
        name: of the weights, for messages.
    """

    def __init__(self, model: PathDiffuser, sample: Callable[..., Tensor], name: str) -> None:
        self.model, self.sample, self.name = model, sample, name
        self.config = model.config

    def plan(
        self,
        tasks: Tasks,
        seed: int,
        sampling: Sampling,
        *,
        exact: bool,
        refine: bool,
        candidates: int = 1,
        max_detour: float | None = None,
    ) -> tuple[Array, np.ndarray]:
        """A path for each task, out of contact and with the score that its ℓ asks for.

        That is the score by the scene's archive, a rough one unless `exact`. Where the path drawn
        misses it, waves or is too long, curves of the archive compete with it. Of several
        `candidates` for a level, which follow each other, the others keep the score that they drew.
        So do all paths of a model without the field. None is longer than `max_detour` times the
        shortest motion, where that is given.

        Returns:
            `(B, K + 2, D)` [m], and whether a curve of the archive stands in for the path drawn,
            `(B,)` bool.
        """
        if exact and not refine:
            raise InvalidInputError("exact plans are refined: leave refine as it is")
        paths, replaced = self.draw(tasks, seed, sampling), np.zeros(len(tasks), dtype=bool)
        if max_detour is not None and not refine:
            raise InvalidInputError("paths of a max_detour are refined: leave refine as it is")
        if not refine:
            return paths, replaced
        archive_of = scene_archive if exact else rough_archive
        meeting = np.arange(len(tasks)) % candidates == 0
        for row, scene, target, observer in tasks.rows():
            # The waves of recorded motions are their style.
            drawn = paths[row] if self.config.recorded else smoothed(paths[row])
            first = meeting[row] & self.config.field
            if first.any():
                archive = archive_of(scene, target, observer)
                drawn[first], replaced[row][first] = _met(
                    archive, drawn[first], tasks.levels[row][first],
                    detour_of(observer, max_detour), self.config.recorded,
                )  # fmt: skip
            if not first.all():
                own = observer.score(path_curve(paths[row][~first], SCORE_POINTS), scene, target)
                longest = detour_of(observer, max_detour) * shortest_curve(scene, target)[1]
                drawn[~first] = project(drawn[~first], scene, target, observer, own, longest)[0]
            paths[row] = drawn
        if candidates > 1:  # one that is too long counts as the first of its level
            (scene,), (target,), (observer,) = tasks[:3]
            longest = (1 + _EXCESS) * observer.detour * shortest_curve(scene, target)[1]
            long = np.flatnonzero(arc_length(path_curve(paths, SCORE_POINTS)) > longest)
            first = long - long % candidates
            paths[long], replaced[long] = paths[first], replaced[first]
        for fallback in (archive_of, scene_archive):
            touching = np.flatnonzero(~(tasks.margin(paths) >= 0))
            replaced[touching] = True
            for i in touching:
                one = tasks.of(np.array([i]))
                archive = fallback(one.scenes[0], one.targets[0], one.observers[0])
                paths[i] = nearest_path(archive, float(one.levels[0]))
        if max_detour is not None:
            self._shorten(tasks, paths, replaced, max_detour, archive_of)
        return paths, replaced

    def _shorten(
        self,
        tasks: Tasks,
        paths: Array,
        replaced: NDArray[np.bool],
        max_detour: float,
        archive_of: Callable[[Scene, int, Observer], Archive],
    ) -> None:
        """Replace the paths that are longer than `max_detour` times the shortest motion."""
        for row, scene, target, observer in tasks.rows():
            longest = max_detour * shortest_curve(scene, target)[1]
            long = arc_length(path_curve(paths[row], SCORE_POINTS)) > longest
            for i in np.arange(len(tasks))[row][long]:
                archive = archive_of(scene, target, observer)
                paths[i] = nearest_path(archive, float(tasks.levels[i]), longest)
                replaced[i] = True

    def draw(self, tasks: Tasks, seed: int, sampling: Sampling) -> Array:
        """A path for each task, `(B, K + 2, D)` [m], whose ends are start and goal exactly."""
        return finished(self.drawn(tasks, seed, sampling))

    @torch.inference_mode()
    def drawn(self, tasks: Tasks, seed: int, sampling: Sampling) -> Parts[Array]:
        """`draw` in parts."""
        size, dim = len(tasks), self.config.dim
        generator = torch.Generator("cpu").manual_seed(seed)
        noise = standard_normal(size, NUM_WAYPOINTS, dim, generator=generator)
        level = torch.from_numpy(tasks.levels.astype(np.float32))
        conditions = self.model.conditions(tasks.scenes, tasks.targets, tasks.observers)
        dial = None
        if self.config.field:
            scores = [rough_archive(*row).score_of(DIAL_LEVELS) for _, *row in tasks.rows()]
            dial = torch.from_numpy(dial_of(np.stack(scores)))
        yield
        drawn = self.sample(conditions, level, noise, dial=dial, **sampling._asdict())
        waypoints = drawn.double().numpy()
        if not np.isfinite(waypoints).all():
            raise CheckpointError(f"the model {self.name} drew a path that is not finite")
        paths = np.empty((size, NUM_WAYPOINTS + 2, dim))
        for row, scene, target, _ in tasks.rows():
            paths[row, 1:-1] = Frame.of(scene, target).frame_to_world(waypoints[row])
            paths[row, 0], paths[row, -1] = scene.start, scene.goals[target]
        return paths


def detour_of(observer: Observer, max_detour: float | None) -> float:
    """The longest motion over the shortest: the observer's, or less if less is asked for.

    Projection keeps a length to 1 % only, so it aims as much below a limit that is asked for.
    """
    if max_detour is None:
        return observer.detour
    return min(observer.detour, (1 - _EXCESS) * max_detour)


def _met(
    archive: Archive, paths: Array, levels: Array, detour: float, waves: bool = False
) -> tuple[Array, NDArray[np.bool]]:
    """Paths `(B, K + 2, D)` brought to `levels (B,)`, and whether an elite stands in, `(B,)`.

    It does so where the path drawn misses its level, is too long or, unless it may, `waves`, and an
    elite near the level, as it is or brought there, is less at fault.
    """
    scene, target, observer = archive.scene, archive.target, archive.observer
    longest = detour * archive.shortest_length

    def fault(paths: Array, levels: Array, turned: Array) -> Array:
        curves = path_curve(paths, SCORE_POINTS)
        missed = archive.label_of(observer.score(curves, scene, target)) - levels
        excess, more = arc_length(curves) / longest - 1, turning(curves) - turned
        return np.stack([np.abs(missed) / _MISSED, more / _WAVES, excess / _EXCESS]).max(0)

    def free(paths: Array) -> NDArray[np.bool]:
        return least_margin(scene, target, paths) >= -TOUCH * scene.diagonal

    def brought(paths: Array, levels: Array, turned: Array) -> tuple[Array, Array]:
        wanted = archive.score_of(levels)
        paths, clear = project(paths, scene, target, observer, wanted, longest)
        clear[~clear] = free(paths[~clear])
        return paths, np.where(clear, fault(paths, levels, turned), np.inf)

    asked, which = np.unique(levels, return_inverse=True)
    turned = np.array([np.inf if waves else archive.turning_near(x).mean() for x in asked])
    paths, faults = brought(paths, levels, turned[which])
    replaced = np.zeros(len(paths), dtype=bool)
    for i in np.unique(which[faults > 1]):
        level = float(asked[i])
        gaps = np.argsort(np.abs(archive.labels - level), kind="stable")
        near = np.unique(np.append(gaps[:_ELITES], archive.near(level)[:_ELITES]))
        elites = bezier_trajectories(archive.controls[near], NUM_WAYPOINTS + 2)
        theirs = fault(elites, np.full(len(elites), level), turned[i])
        best = np.argsort(theirs, kind="stable")[:_TRIED]
        moved, after = brought(elites[best], np.full(len(best), level), turned[i])
        theirs = np.append(np.where(free(elites[best]), theirs[best], np.inf), after)
        elites = np.concatenate([elites[best], moved])
        rows = np.flatnonzero((which == i) & (faults > max(1, theirs.min())))
        paths[rows], replaced[rows] = elites[np.argmin(theirs)], True
    return paths, replaced


def nearest_path(archive: Archive, level: float, longest: float = np.inf) -> Array:
    """The feasible path `(K + 2, D)` [m] of an elite, nearest to a level among the first found.

    None longer than `longest` [m] counts. If no elite's is feasible, what projection makes of the
    motion at ℓ = 0.
    """
    scene, target, observer = archive.scene, archive.target, archive.observer
    order = np.argsort(np.abs(archive.labels - level), kind="stable")
    for few in np.array_split(order, max(1, len(order) // 64)):
        paths = bezier_trajectories(archive.controls[few], NUM_WAYPOINTS + 2)
        paths = paths[arc_length(path_curve(paths, SCORE_POINTS)) <= longest * (1 + 1e-9)]
        paths = paths[least_margin(scene, target, paths) >= -TOUCH * scene.diagonal]
        if len(paths):
            scores = observer.score(path_curve(paths, SCORE_POINTS), scene, target)
            return paths[np.argmin(np.abs(archive.label_of(scores) - level))]
    shortest = bezier_trajectories(archive.anchor[None], NUM_WAYPOINTS + 2)
    return project(shortest, scene, target, observer)[0][0]


def nearest_candidates(
    levels: Array, scores: Array, archive: Callable[[], Archive]
) -> NDArray[np.intp]:
    """Index `(B,)` of the candidate nearest to each of `levels (B,)`, of `scores (B, N)`.

    Labels end at ±1, scores do not: there it is the most extreme one, and no archive is needed.
    """
    best = np.argmax(np.sign(levels)[:, None] * scores, axis=1)
    between = np.abs(levels) < 1
    if between.any():
        labels = archive().label_of(scores[between])
        best[between] = np.argmin(np.abs(labels - levels[between, None]), axis=1)
    return best
