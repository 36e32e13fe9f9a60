"""Random scenes, datasets and demonstrations by settings, which fix every byte with the code."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np

from ..checks import bounded, check_choices, choice, count, one_of, positive, random_seed
from ..errors import DatasetError, InvalidInputError
from ..intent.observer import Observer
from ..motion.archive import Archive, build_archive, passable
from ..robots import ARM_NAMES
from ..scene import Scene
from ..seeds import STREAMS, stream_seed
from .rooms import add_obstacles, default_like, random_observer, random_room

VALIDATION_SCENES = 128
_NOISE, _PUSH = 0.06, 2.0
_CELLS = {2: 20, 3: 8}


REGIMES = ("paper", "dragan", "observers", "rooms", "obstacles", "all", "training")
"""Kinds of scenes and observers:

* `paper`: the default workspace, empty; the paper's observer;
* `dragan`: the same, the default observer;
* `observers`: the same, any observer;
* `rooms`: empty rooms of any size and aspect, the default observer;
* `obstacles`: the default workspace with one to four obstacles, the default observer;
* `all`: any room with up to four obstacles, any observer;
* `training`: a mixture of all of these.
"""

FORMATS = ("torch", "lerobot", "csv")
"""Formats of an export."""

_ANY_GOALS = (2, 8)
_OF_GIVEN = {"given", "recordings", "mix"}


def targets_of(scene: Scene) -> tuple[Scene, ...]:
    """A scene with each of its goals as the target, goal 0, in turn."""
    return tuple(with_target_first(scene, target) for target in range(scene.num_goals))


def with_target_first(scene: Scene, target: int) -> Scene:
    """The scene with goal `target` as goal 0."""
    goals = np.concatenate([scene.goals[[target]], np.delete(scene.goals, target, axis=0)])
    return replace(scene, goals=goals)


@dataclass(frozen=True)
class SceneStream:
    """Random scenes and observers by index; the target is goal 0 in each scene.

    Attributes:
        stream: seed stream, one of `seeds.STREAMS`; no two share a scene.
        dim: 2 or 3.
        regime: of scenes and observers: paper, dragan, observers, rooms, obstacles, all, or
            training, a mixture of these; see `REGIMES`.
        goals: least and most goals of a scene, from 2 to 12.
        seed: of the scenes and their archives.
    """

    stream: str
    dim: int = choice(2, (2, 3))
    regime: str = choice("dragan", REGIMES)
    goals: tuple[int, int] = (2, 6)
    seed: int = 0

    def __post_init__(self) -> None:
        one_of("stream", self.stream, STREAMS)
        check_choices(self)
        random_seed("seed", self.seed)
        goals = [count("goals", n, low=2) for n in self.goals] if np.iterable(self.goals) else []
        if len(goals) != 2 or not goals[0] <= goals[1] <= 12:
            raise InvalidInputError(
                f"goals must be two integers from 2 to 12, rising, got {self.goals}"
            )

    def scene(self, index: int) -> Scene:
        """Scene `index`, in which a curve leads to the target."""
        rng = np.random.default_rng(stream_seed(self.stream, self.seed, index, "scene"))
        while True:
            scene = self._draw(rng)
            if passable(scene, 0):
                return scene

    def _draw(self, rng: np.random.Generator) -> Scene:
        regime = self.regime
        anywhere = regime in ("rooms", "all") or (regime == "training" and rng.random() < 0.5)
        obstacles = (0, 0)
        if regime == "obstacles" or (regime == "training" and rng.random() < 0.5):
            obstacles = (1, 4)
        elif regime == "all":
            obstacles = (0, 4)
        if anywhere:
            goals = (min(self.goals[0], _ANY_GOALS[0]), max(self.goals[1], _ANY_GOALS[1]))
            return random_room(rng, dim=self.dim, goals=goals, obstacles=obstacles)
        num_goals = int(rng.integers(self.goals[0], self.goals[1] + 1))
        scene = Scene.random(rng, dim=self.dim, num_goals=num_goals)
        return add_obstacles(rng, scene, obstacles) if obstacles[1] else scene

    def observer_of(self, index: int, scene: Scene, like: Observer, view: int = 0) -> Observer:
        """The observer of scene `index`, with the α, detour and label of `like`.

        `view` counts several observers of one scene.
        """
        seed = stream_seed(self.stream, self.seed, index, "observer")
        rng = np.random.default_rng([*seed.generate_state(4), view])
        draw = rng.random() if self.regime == "training" else 1.0
        if self.regime == "paper" or draw < 0.2:
            alpha, detour, label = like.scale
            paper = Observer.paper(self.dim)
            if self.regime == "training":  # the same share of the scene as in the paper's own
                paper = replace(paper, sigma=float(rng.uniform(0.1, 0.27)) * scene.size)
            return replace(paper, alpha=alpha, detour=detour, label=label)
        if self.regime in ("observers", "all") or 0.55 <= draw < 1:
            return random_observer(rng, scene, like)
        return default_like(like)

    def archive(self, index: int, like: Observer, **settings: Any) -> Archive:
        """The archive of scene `index` for its observer; `settings` are of `build_archive`."""
        scene = self.scene(index)
        seed = stream_seed(self.stream, self.seed, index, "archive")
        observer = self.observer_of(index, scene, like)
        return build_archive(scene, observer=observer, seed=seed, **settings)


@dataclass(frozen=True)
class DatasetConfig(SceneStream):
    """The settings of a dataset.

    Attributes:
        scenes: number of random scenes.
        views: observers of each scene, whose labels differ.
        per_scene: trajectories chosen from each archive for each observer, at equal steps of ℓ.
        efficiency: among trajectories of nearly the same ℓ, one that is longer than the shortest by
            `|ℓ|` times this share of the straight line is chosen e times less often; so ℓ = 0 is
            the straight line, and no level takes a needless detour.
        cells: the archive's cells along the straight line; 0 means 20 in 2D and 8 in 3D, coarser
            than an archive that judges, to afford more scenes.
        candidates: most curves tried for an archive.
        observer: its α, detour and label are those of all observers.
        given: instead of random scenes these; the target is goal 0 in each, see `targets_of`.
        recordings: hash of recorded motions in the given scenes, from which the trajectories are
            chosen; none, and they are chosen from each archive.
        mix: with recorded motions, share of the trajectories that is chosen from the archive, where
            the motions leave gaps on the dial.
    """

    stream: str = choice("train", ("train", "validation"))
    regime: str = choice("training", REGIMES)
    scenes: int = 1000
    views: int = 3
    per_scene: int = 65
    efficiency: float = 0.1
    cells: int = 0
    candidates: int = 24_576
    observer: Observer = field(default_factory=Observer)
    given: tuple[Scene, ...] = ()
    recordings: str = ""
    mix: float = 0.0

    def __post_init__(self) -> None:
        if self.given:
            numbers = [scene.num_goals for scene in self.given]
            object.__setattr__(self, "given", tuple(self.given))
            object.__setattr__(self, "dim", self.given[0].dim)
            object.__setattr__(self, "goals", (min(numbers), max(numbers)))
            object.__setattr__(self, "scenes", min(self.scenes, len(self.given)))
            if {scene.dim for scene in self.given} != {self.dim}:
                raise InvalidInputError("all scenes must be 2D, or all 3D, got both")
        super().__post_init__()
        if self.recordings and not self.given:
            raise InvalidInputError("recordings need the scenes that they were recorded in")
        if bounded("mix", self.mix, 0, 1) and not self.recordings:
            raise InvalidInputError(f"mix belongs to recordings, got {self.mix:g} without any")
        count("scenes", self.scenes)
        count("views", self.views)
        count("per_scene", self.per_scene, low=3)
        object.__setattr__(self, "goals", tuple(self.goals))
        if not isinstance(self.observer, Observer):
            raise InvalidInputError(
                f"observer must be a legibility.Observer, got {self.observer!r}"
            )
        if count("cells", self.cells, low=0) == 0:
            object.__setattr__(self, "cells", _CELLS[self.dim])
        count("cells", self.cells, low=2)
        count("candidates", self.candidates, low=4096)
        positive("efficiency", self.efficiency)

    def scene(self, index: int) -> Scene:
        """See `SceneStream`; the target is goal 0 in a given scene, too."""
        return self.given[index] if self.given else super().scene(index)

    def to_dict(self) -> dict[str, Any]:
        """Plain values for the manifest; those of given scenes only if there are any."""
        content = {f.name: getattr(self, f.name) for f in fields(self) if f.name not in _OF_GIVEN}
        plain = {"goals": list(self.goals), "observer": self.observer.to_dict()}
        given = {"given": [scene.to_dict() for scene in self.given]} if self.given else {}
        shown = {"recordings": self.recordings, "mix": self.mix} if self.recordings else {}
        return {**content, **plain, **given, **shown}

    @classmethod
    def from_dict(cls, content: dict[str, Any]) -> DatasetConfig:
        """The inverse of `to_dict`; keys must match exactly."""
        if strange := (set(content) | _OF_GIVEN) ^ {f.name for f in fields(cls)}:
            raise DatasetError(f"dataset settings missing or unknown: {sorted(strange)}")
        try:
            observer = Observer.from_dict(content["observer"])
            given = tuple(map(Scene.from_dict, content.get("given", ())))
            return cls(**{**content, "observer": observer, "given": given})
        except (TypeError, InvalidInputError) as cause:
            raise DatasetError(f"the settings of a dataset are not ours: {cause}") from cause

    def for_validation(self) -> DatasetConfig:
        """The same settings for scenes of the validation stream, each with one observer.

        They are 128, or as many as these if there are fewer; of given scenes they are other
        trajectories in them, from their archives.
        """
        other = {"stream": "validation", "scenes": min(self.scenes, VALIDATION_SCENES), "views": 1}
        return replace(self, **other, recordings="", mix=0.0)


@dataclass(frozen=True)
class DemonstrationsConfig:
    """The settings of demonstrations.

    Attributes:
        demonstrations: number in each scene; 0 makes none.
        demonstrated: number of scenes, the first ones of the dataset; 0 means all.
        noise: standard deviation of the noise on each step's displacement [m], which shows the way
            back to the path; 6 % of the largest displacement if not given.
        pushed: share of the demonstrations with one push.
        push: distance of a push [m]; twice the largest displacement if not given.
        arm: that demonstrates in MuJoCo, a .yaml or .json file; the Panda if not given. What is
            stored is its name.
    """

    demonstrations: int = 0
    demonstrated: int = 0
    noise: float | None = None
    pushed: float = 0.25
    push: float | None = None
    arm: str | None = choice(None, ARM_NAMES, more="FILE")

    def __post_init__(self) -> None:
        count("demonstrations", self.demonstrations, low=0)
        count("demonstrated", self.demonstrated, low=0)
        bounded("pushed", self.pushed, 0, 1)
        for name in ("noise", "push"):
            if getattr(self, name) is not None:
                bounded(name, getattr(self, name), 0)

    def within(self, source: DatasetConfig) -> DemonstrationsConfig:
        """The same settings with the defaults of the robot that demonstrates in a dataset.

        Raises:
            InvalidInputError: the dataset has fewer scenes or trajectories, or the noise is larger
                than a displacement.
        """
        count("demonstrations", self.demonstrations)
        for name, most in (("demonstrations", source.per_scene), ("demonstrated", source.scenes)):
            if getattr(self, name) > most:
                raise InvalidInputError(
                    f"{name} must be at most {most}, as in the dataset, got {getattr(self, name)}"
                )
        from ..envs import vector_type

        limit = vector_type(None, source.dim).max_displacement
        noise = bounded("noise", _NOISE * limit if self.noise is None else self.noise, 0, limit)
        return replace(self, noise=noise, push=_PUSH * limit if self.push is None else self.push)
