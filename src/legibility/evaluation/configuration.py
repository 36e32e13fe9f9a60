"""The settings of each evaluation."""

from __future__ import annotations

from dataclasses import dataclass

from ..checks import bounded, count, random_seed
from ..data.scenes import SceneStream
from ..errors import InvalidInputError

__all__ = [
    "AblationsConfig",
    "DialConfig",
    "ExecutionConfig",
    "SpectrumConfig",
    "Table1Config",
    "UnseenConfig",
]


@dataclass(frozen=True)
class DialConfig:
    """Settings of the evaluation.

    Attributes:
        scenes: random scenes of the evaluation stream.
        goals: least and most goals of a scene.
        seed: of the scenes and of the plans.
        levels: levels of ℓ at equal steps from −1 to 1.
        samples: paths drawn for a level.
        candidates: paths of which the nearest is measured as well; 0 leaves it out.
        guidance: weight of classifier-free guidance at ±1; the model's own if not given.
        steps: of the sampler; the model's own if not given.
        closed_loop: measure executed motions instead of paths, each by a robot with other hidden
            properties.
        env: environment of the execution, 2d, panda or pandagym; that of the dimension if not
            given.
    """

    scenes: int = 200
    goals: tuple[int, int] = (2, 6)
    seed: int = 0
    levels: int = 21
    samples: int = 8
    candidates: int = 16
    guidance: float | None = None
    steps: int | None = None
    closed_loop: bool = False
    env: str | None = None

    def __post_init__(self) -> None:
        count("scenes", self.scenes)
        SceneStream("evaluation", goals=self.goals, seed=self.seed)
        count("levels", self.levels, low=3)
        count("samples", self.samples)
        count("candidates", self.candidates, low=0)
        if self.env is not None and not self.closed_loop:
            raise InvalidInputError(f"env {self.env} belongs to closed_loop, which is not asked")


@dataclass(frozen=True)
class ExecutionConfig:
    """Settings of the evaluation.

    Attributes:
        scenes: random scenes of the evaluation stream.
        goals: least and most goals of a scene.
        seed: of the scenes, the plans and the environments.
        rollouts: total number, the same in each scene, ℓ uniform in [−1, 1].
        disturbance: of a push or a shift of the target [m]; twice the largest displacement of a
            step if not given.
        env: environment, 2d, panda or pandagym; that of the dimension if not given.
    """

    scenes: int = 200
    goals: tuple[int, int] = (2, 6)
    seed: int = 0
    rollouts: int = 5000
    disturbance: float | None = None
    env: str | None = None

    def __post_init__(self) -> None:
        count("scenes", self.scenes)
        SceneStream("evaluation", goals=self.goals, seed=self.seed)
        if count("rollouts", self.rollouts) % self.scenes or self.rollouts < 3 * self.scenes:
            raise InvalidInputError(
                f"rollouts must be a multiple of scenes, three or more in each, "
                f"got {self.rollouts} for {self.scenes}"
            )
        if self.disturbance is not None:
            bounded("disturbance", self.disturbance, 0)


@dataclass(frozen=True)
class Table1Config:
    """Settings of the evaluation.

    Attributes:
        env: environment, 2d, panda or pandagym.
        rollouts: of each method toward either target.
        seed: of the plans, the actions and the robots' hidden properties.
        search_candidates: curves of the first search; the second draws ten times that. 0 means as
            many as fit in the time of a plan, which is measured first.
    """

    env: str = "2d"
    rollouts: int = 100
    seed: int = 0
    search_candidates: int = 0

    def __post_init__(self) -> None:
        count("rollouts", self.rollouts, low=2)
        random_seed("seed", self.seed)
        count("search_candidates", self.search_candidates, low=0)


@dataclass(frozen=True)
class UnseenConfig:
    """Settings of the evaluation.

    Attributes:
        env: environment, 2d, panda or pandagym.
        scenes: random scenes of the evaluation stream.
        goals: least and most goals of a scene.
        rollouts: of each method in each scene with ℓ = 1.
        levels: of ℓ from −1 to 1, a motion each, for methods that take an ℓ.
        seed: of the scenes, the plans, the actions and the robots' hidden properties.
        search_candidates: curves of the first search; the second draws ten times that. 0 means as
            many as fit in the time of a plan, which is measured first.
    """

    env: str = "2d"
    scenes: int = 100
    goals: tuple[int, int] = (2, 6)
    rollouts: int = 4
    levels: int = 11
    seed: int = 0
    search_candidates: int = 0

    def __post_init__(self) -> None:
        count("scenes", self.scenes, low=2)
        SceneStream("evaluation", goals=self.goals, seed=self.seed)
        count("rollouts", self.rollouts)
        count("levels", self.levels, low=3)
        count("search_candidates", self.search_candidates, low=0)


@dataclass(frozen=True)
class SpectrumConfig:
    """Settings of the evaluation.

    Attributes:
        env: environment, 2d, panda or pandagym.
        levels: of ℓ at equal steps from −1 to 1.
        rollouts: at each level toward either target.
        seed: of the plans, the actions and the robots' hidden properties.
    """

    env: str = "2d"
    levels: int = 21
    rollouts: int = 50
    seed: int = 0

    def __post_init__(self) -> None:
        count("levels", self.levels, low=3)
        count("rollouts", self.rollouts, low=2)
        random_seed("seed", self.seed)


@dataclass(frozen=True)
class AblationsConfig:
    """Settings of the evaluation and of the small runs.

    Attributes:
        scenes: random scenes of the evaluation stream.
        goals: least and most goals of a scene.
        seed: of the scenes and of the plans.
        levels: levels of ℓ at equal steps from −1 to 1.
        samples: paths drawn for a level.
        sampling_steps: of the sampler, each with the shipped weights.
        guidance: weights of classifier-free guidance at ±1, each with the shipped weights.
        training_steps: optimiser steps of each small run.
        training_scenes: scenes of the small runs' training.
        scene_numbers: other numbers of scenes, a small run each.
    """

    scenes: int = 50
    goals: tuple[int, int] = (2, 6)
    seed: int = 0
    levels: int = 11
    samples: int = 4
    sampling_steps: tuple[int, ...] = (1, 2, 4, 8, 100)
    guidance: tuple[float, ...] = (0.0, 0.3, 1.0, 3.0)
    training_steps: int = 3000
    training_scenes: int = 3200
    scene_numbers: tuple[int, ...] = (200, 800, 12800)

    def __post_init__(self) -> None:
        count("training_steps", self.training_steps)
        count("training_scenes", self.training_scenes)
        for number in self.scene_numbers:
            count("scene_numbers", number)
        self.dial()  # checks the rest

    def dial(self, steps: int | None = None, guidance: float | None = None) -> DialConfig:
        """How a row is measured, `steps` and `guidance` of the sampler as in `DialConfig`."""
        return DialConfig(
            scenes=self.scenes, goals=self.goals, seed=self.seed, levels=self.levels,
            samples=self.samples, candidates=0, guidance=guidance, steps=steps,
        )  # fmt: skip
