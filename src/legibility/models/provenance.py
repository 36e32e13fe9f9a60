"""How weights were made, as `config.json` records it beside them."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any


@dataclass(frozen=True)
class TrainingRecord:
    """How the weights of one stage were made.

    Attributes:
        data: settings of the dataset.
        digest: hash of the data, or of the demonstrations that were learned from.
        training: settings of the training.
        parameters: number of parameters.
        seconds: duration of the training, validation included [s].
        step_seconds: duration of a step, the fastest tenth of the log [s].
        device: where it ran.
        processes: how many trained together.
        precision: of the network's products.
        threads: of each process.
        torch: version of PyTorch.
        demonstrations: settings and number of the demonstrations, of a policy.
        teacher: of a model that was distilled.
    """

    data: dict[str, Any]
    digest: str
    training: dict[str, Any]
    parameters: int
    seconds: float
    step_seconds: float
    device: str
    processes: int
    precision: str
    threads: int
    torch: str
    demonstrations: dict[str, Any] | None = None
    teacher: TeacherRecord | None = None

    def to_dict(self) -> dict[str, Any]:
        """Plain values, without those that do not apply."""
        return asdict(self, dict_factory=_without_none)

    @classmethod
    def from_dict(cls, content: dict[str, Any]) -> TrainingRecord:
        """The inverse of `to_dict`.

        Raises:
            TypeError: a key is missing or unknown.
        """
        if teacher := content.get("teacher"):
            if training := teacher.get("training"):
                teacher = {**teacher, "training": cls.from_dict(training)}
            content = {**content, "teacher": TeacherRecord(**teacher)}
        return cls(**content)


@dataclass(frozen=True)
class TeacherRecord:
    """The model that a student was distilled from.

    Attributes:
        sha256: of its weights.
        sampling_steps: of its sampler.
        guidance: its weight of classifier-free guidance.
        training: how it was made itself; None if that is not known.
    """

    sha256: str
    sampling_steps: int
    guidance: float
    training: TrainingRecord | None = None


def _without_none(items: list[tuple[str, Any]]) -> dict[str, Any]:
    return {name: value for name, value in items if value is not None}
