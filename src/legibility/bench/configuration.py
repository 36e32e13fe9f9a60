"""The settings of the bench."""

from dataclasses import dataclass

from ..checks import choice, count, positive
from ..errors import InvalidInputError
from ..training.configuration import DEVICES


@dataclass(frozen=True)
class BenchConfig:
    """Sizes and durations of the measurements.

    Attributes:
        seconds: least time spent on a measurement in a round [s]; at least one call.
        rounds: number of turns of each measurement.
        threads: of PyTorch; its own default if not given.
        batches: numbers of paths planned at once in a scene of 4 goals.
        goals: numbers of goals of the scenes in which one path is planned.
        robots: 2-D robots that move at once.
        arms: arms that move at once.
        dataset: scenes of the dataset.
        training_steps: steps of stage 1 timed in a round.
        device: for training; everything else runs on the CPU.
    """

    seconds: float = 0.2
    rounds: int = 3
    threads: int | None = None
    batches: tuple[int, ...] = (1, 16, 64, 256, 1024)
    goals: tuple[int, ...] = (2, 4, 6, 12)
    robots: int = 256
    arms: int = 16
    dataset: int = 4
    training_steps: int = 16
    device: str = choice("cpu", DEVICES, more="cuda:N")

    def __post_init__(self) -> None:
        positive("seconds", self.seconds)
        for name in ("rounds", "robots", "arms", "dataset", "training_steps"):
            count(name, getattr(self, name))
        if self.threads is not None:
            count("threads", self.threads)
        for name in ("batches", "goals"):
            sizes = getattr(self, name)
            if not sizes or list(sizes) != sorted({count(name, size) for size in sizes}):
                raise InvalidInputError(f"{name} must be increasing numbers, got {sizes}")
        if self.goals[0] < 2 or self.goals[-1] > 12:
            raise InvalidInputError(f"goals must lie in [2, 12], got {self.goals}")
