"""The settings of each evaluation."""

from dataclasses import dataclass

from ..checks import bounded, check_choices, choice, count, one_of, positive, random_seed
from ..data.configuration import REGIMES, SceneStream
from ..envs import ENVIRONMENTS
from ..errors import InvalidInputError
from ..models.configuration import BACKENDS
from ..robots import ARM_NAMES
from ..robots.limits import LIMITS

EVALUATED = tuple(regime for regime in REGIMES if regime != "training")
"""The regimes of held-out scenes."""

MODES = ("bare", "quick", "exact")
"""How paths are planned: as the network draws them, by default, or exactly."""

_DEFAULT_ROOM = ("paper", "dragan", "observers", "obstacles")


def _check_counts(config: object, **least: int) -> None:
    """Raise unless the named fields are integers of at least these values."""
    for name, low in least.items():
        count(name, getattr(config, name), low=low)


@dataclass(frozen=True)
class HeldOutScenes:
    """Scenes of an evaluation.

    Attributes:
        scenes: random scenes of the evaluation stream.
        regime: of scenes and observers. paper: the default workspace, empty, and the paper's
            observer; dragan: the same with Dragan's; observers: the same with any observer; rooms:
            empty rooms of any size and aspect; obstacles: the default workspace with one to four
            obstacles; all: any room and any observer, up to four obstacles.
        goals: least and most goals of a scene.
        seed: of the scenes, the plans, the actions and the robots' hidden properties.
    """

    scenes: int = 200
    regime: str = choice("dragan", EVALUATED)
    goals: tuple[int, int] = (2, 6)
    seed: int = 0

    def __post_init__(self) -> None:
        count("scenes", self.scenes)
        check_choices(self)
        self.stream(2)

    def stream(self, dim: int) -> SceneStream:
        """The scenes in D dimensions."""
        return SceneStream("evaluation", dim, self.regime, self.goals, self.seed)


@dataclass(frozen=True)
class DialConfig(HeldOutScenes):
    """Settings of the evaluation.

    Attributes:
        levels: levels of ℓ at equal steps from −1 to 1.
        samples: paths drawn for a level.
        modes: bare (the network's own paths), quick (the default) and exact; if not given, all of
            plans, and quick alone of executed motions.
        candidates: paths of which the nearest is measured as well; 0 leaves it out.
        guidance: weight of classifier-free guidance at ±1; the model's own if not given.
        steps: of the sampler; the model's own if not given.
        closed_loop: measure executed motions instead of paths, each by a robot with other hidden
            properties.
        env: environment of the execution, 2d, panda or pandagym; that of the dimension if not
            given.
        method: planners of yours, measured as well, and policies of executed motions; each is
            MODULE:NAME, of a module in this folder or installed, or FILE.py:NAME.
    """

    levels: int = 21
    samples: int = 8
    modes: tuple[str, ...] = choice((), MODES)
    candidates: int = 16
    guidance: float | None = None
    steps: int | None = None
    closed_loop: bool = False
    env: str | None = choice(None, ENVIRONMENTS)
    method: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_counts(self, levels=3, samples=1, candidates=0)
        if not self.modes:
            object.__setattr__(self, "modes", ("quick",) if self.closed_loop else MODES)
        if self.closed_loop:
            one_of("regime of executed motions", self.regime, _DEFAULT_ROOM)
        elif self.env is not None:
            raise InvalidInputError(f"env {self.env} belongs to closed_loop, which is not asked")


@dataclass(frozen=True)
class EyesConfig(HeldOutScenes):
    """Settings of the evaluation; a regime is of its scenes alone.

    Attributes:
        levels: levels of ℓ at equal steps from −1 to 1.
        samples: paths drawn for a level.
        exact: meet each level by the scene's archive.
    """

    levels: int = 11
    samples: int = 4
    exact: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_counts(self, levels=3, samples=1)


@dataclass(frozen=True)
class OptimumConfig(HeldOutScenes):
    """Settings of the evaluation.

    Attributes:
        starts: elites of the archive from which the optimiser starts.
        exact: meet each level by the scene's archive.
    """

    scenes: int = 100
    regime: str = choice("dragan", ("dragan",))
    starts: int = 8
    exact: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_counts(self, starts=1)


@dataclass(frozen=True)
class PlanningConfig:
    """Settings of the evaluation.

    Attributes:
        scenes: random scenes of each regime, of the evaluation stream.
        goals: least and most goals of a scene.
        seed: of the scenes and the plans.
        levels: levels of ℓ at equal steps from −1 to 1, a path each.
        search: numbers of random curves among which a search takes the nearest.
    """

    scenes: int = 50
    goals: tuple[int, int] = (2, 6)
    seed: int = 0
    levels: int = 11
    search: tuple[int, ...] = (64, 256, 1024, 4096, 16_384)

    def __post_init__(self) -> None:
        _check_counts(self, scenes=2, levels=3)
        self.stream("dragan", 2)
        for number in self.search:
            count("search", number)

    def stream(self, regime: str, dim: int) -> SceneStream:
        """The scenes of a regime in D dimensions."""
        return SceneStream("evaluation", dim, regime, self.goals, self.seed)


@dataclass(frozen=True)
class ExternalConfig(HeldOutScenes):
    """Settings of the evaluation.

    Attributes:
        levels: levels of ℓ at equal steps from 0 to 1, of which the best within a bound counts.
    """

    scenes: int = 100
    regime: str = choice("obstacles", ("dragan", "rooms", "obstacles"))
    levels: int = 11

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_counts(self, levels=2)


@dataclass(frozen=True)
class TimingConfig(HeldOutScenes):
    """Settings of the evaluation.

    Attributes:
        levels: levels of ℓ at equal steps from −1 to 1, a motion each.
        limits: that motions keep: point, panda, fr3 or moveit-panda; if not given, those of the
            arm, or point.
        arm: panda, or a .yaml or .json file of one; if not given, a point moves, or the Panda where
            limits are its.
    """

    regime: str = choice("dragan", ("dragan", "obstacles"))
    levels: int = 5
    limits: str | None = choice(None, LIMITS)
    arm: str | None = choice(None, ARM_NAMES, more="FILE")

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_counts(self, levels=2)


@dataclass(frozen=True)
class ControllerConfig(HeldOutScenes):
    """Settings of the evaluation.

    Attributes:
        dt: duration of a step [s]; that of the model's environment if not given.
        budget: time [s] that a step may spend on planning.
        backend: what runs the networks, torch or onnx.
    """

    regime: str = choice("dragan", ("dragan", "obstacles"))
    dt: float | None = None
    budget: float = 0.002
    backend: str = choice("torch", BACKENDS)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.dt is not None:
            positive("dt", self.dt)
        bounded("budget", self.budget, 0)


@dataclass(frozen=True)
class ExecutionConfig(HeldOutScenes):
    """Settings of the evaluation.

    Attributes:
        rollouts: total number, the same in each scene, ℓ uniform in [−1, 1].
        disturbance: of a push or a shift of the target [m]; twice the largest displacement of a
            step if not given.
        env: environment, 2d, panda or pandagym; that of the dimension if not given.
        arm: that moves in MuJoCo, a .yaml or .json file; the Panda if not given.
    """

    regime: str = choice("dragan", ("paper", "dragan", "obstacles"))
    rollouts: int = 5000
    disturbance: float | None = None
    env: str | None = choice(None, ENVIRONMENTS)
    arm: str | None = choice(None, ARM_NAMES, more="FILE")

    def __post_init__(self) -> None:
        super().__post_init__()
        if count("rollouts", self.rollouts) % self.scenes or self.rollouts < 3 * self.scenes:
            raise InvalidInputError(
                f"rollouts must be a multiple of scenes, three or more in each, "
                f"got {self.rollouts} for {self.scenes}"
            )
        if self.disturbance is not None:
            bounded("disturbance", self.disturbance, 0)
        if self.arm is not None and self.env not in (None, "panda"):
            raise InvalidInputError(f"arm {self.arm} moves in MuJoCo, env panda, not {self.env}")


@dataclass(frozen=True)
class Table1Config:
    """Settings of the evaluation.

    Attributes:
        env: environment, 2d, panda or pandagym.
        rollouts: of each method with ℓ = 1, toward either target or in each held-out scene.
        seed: of the scenes, the plans, the actions and the robots' hidden properties.
        search_candidates: curves of the first search; the second draws ten times that. 0 means as
            many as fit in the time of a plan, which is measured first.
        method: planners and policies of yours, a row each: MODULE:NAME, of a module in this folder
            or installed, or FILE.py:NAME.
    """

    env: str = choice("2d", ENVIRONMENTS)
    rollouts: int = 100
    seed: int = 0
    search_candidates: int = 0
    method: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        random_seed("seed", self.seed)
        check_choices(self)
        _check_counts(self, rollouts=2, search_candidates=0)


@dataclass(frozen=True)
class SingleSceneConfig:
    """Settings of the training and the evaluation.

    Attributes:
        env: environment, 2d or panda, in which demonstrations and motions are made.
        rollouts: of each method with ℓ = 1, toward either target.
        seed: of the data, the trainings and the rollouts.
        demonstrations: toward either target.
        training_steps: optimiser steps of each network.
        batch: steps of demonstrations, or trajectories, in a batch; a multiple of 8.
        tuning_rollouts: motions by which settings are chosen, each by another robot.
        networks: trainings of Legibility Diffuser, of which the best is taken.
    """

    env: str = choice("2d", ("2d", "panda"))
    rollouts: int = 100
    seed: int = 0
    demonstrations: int = 150
    training_steps: int = 3000
    batch: int = 256
    tuning_rollouts: int = 32
    networks: int = 3

    def __post_init__(self) -> None:
        random_seed("seed", self.seed)
        _check_counts(
            self, rollouts=2, demonstrations=3, training_steps=1, batch=8, tuning_rollouts=1,
            networks=1,
        )  # fmt: skip
        check_choices(self)
        if self.batch % 8:
            raise InvalidInputError(f"batch must be a multiple of 8, got {self.batch}")


@dataclass(frozen=True)
class UnseenConfig(Table1Config):
    """Settings of the evaluation.

    Attributes:
        scenes: random scenes of the evaluation stream.
        goals: least and most goals of a scene.
        levels: of ℓ from −1 to 1, a motion each, for methods that take an ℓ.
    """

    rollouts: int = 4
    scenes: int = 100
    goals: tuple[int, int] = (2, 6)
    levels: int = 11

    def __post_init__(self) -> None:
        check_choices(self)
        SceneStream("evaluation", goals=self.goals, seed=self.seed)
        _check_counts(self, rollouts=1, search_candidates=0, scenes=2, levels=3)


@dataclass(frozen=True)
class SpectrumConfig:
    """Settings of the evaluation.

    Attributes:
        env: environment, 2d, panda or pandagym.
        levels: of ℓ at equal steps from −1 to 1.
        rollouts: at each level toward either target.
        seed: of the plans, the actions and the robots' hidden properties.
    """

    env: str = choice("2d", ENVIRONMENTS)
    levels: int = 21
    rollouts: int = 50
    seed: int = 0

    def __post_init__(self) -> None:
        random_seed("seed", self.seed)
        check_choices(self)
        _check_counts(self, levels=3, rollouts=2)


@dataclass(frozen=True)
class AblationsConfig(HeldOutScenes):
    """Settings of the evaluation and of the small runs.

    Attributes:
        levels: levels of ℓ at equal steps from −1 to 1.
        samples: paths drawn for a level.
        sampling_steps: of the sampler, each with the first small run.
        guidance: weights of classifier-free guidance at ±1, each with the first small run.
        training_steps: optimiser steps of each small run.
        batch_scenes: scenes in a batch of them.
        training_scenes: scenes of the small runs' training.
        scene_numbers: other numbers of scenes, a small run each.
    """

    scenes: int = 50
    levels: int = 11
    samples: int = 4
    sampling_steps: tuple[int, ...] = (1, 10)
    guidance: tuple[float, ...] = (0.0, 1.0)
    training_steps: int = 2000
    batch_scenes: int = 64
    training_scenes: int = 800
    scene_numbers: tuple[int, ...] = (200, 3200)

    def __post_init__(self) -> None:
        _check_counts(self, training_steps=1, batch_scenes=1, training_scenes=1)
        for number in self.scene_numbers:
            count("scene_numbers", number)
        self.dial()  # checks the rest

    def dial(self, steps: int | None = None, guidance: float | None = None) -> DialConfig:
        """How a row is measured, `steps` and `guidance` of the sampler as in `DialConfig`."""
        return DialConfig(
            self.scenes, self.regime, self.goals, self.seed, self.levels, self.samples,
            modes=("bare", "quick"), candidates=0, guidance=guidance, steps=steps,
        )  # fmt: skip
