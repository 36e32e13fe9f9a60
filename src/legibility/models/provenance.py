"""How weights were made, as `config.json` records it beside them."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any


@dataclass(frozen=True)
class Source:
    """The data that a model learned from.

    Attributes:
        data: settings of the dataset.
        digest: hash of the dataset, or of the demonstrations for a policy.
        demonstrations: settings and number of the demonstrations, for a policy.
        teacher: of a distilled model.
    """

    data: dict[str, Any]
    digest: str
    demonstrations: dict[str, Any] | None = None
    teacher: TeacherRecord | None = None


@dataclass(frozen=True, kw_only=True)
class TrainingRecord(Source):
    """How the weights of one stage were made: from a `Source`, by a training.

    Attributes:
        training: settings of the training.
        parameters: number of parameters.
        seconds: duration of the training, validation included [s].
        step_seconds: duration of a step, the fastest tenth of the log [s].
        device: device of the training.
        processes: number of processes that trained together.
        precision: of the network's products.
        threads: of each process.
        torch: version of PyTorch.
    """

    training: dict[str, Any]
    parameters: int
    seconds: float
    step_seconds: float
    device: str
    processes: int
    precision: str
    threads: int
    torch: str

    def to_dict(self) -> dict[str, Any]:
        """Plain values, without those that do not apply."""
        return asdict(self, dict_factory=lambda items: {k: v for k, v in items if v is not None})

    @classmethod
    def from_dict(cls, content: dict[str, Any]) -> TrainingRecord:
        """The inverse of `to_dict`.

        Raises:
            TypeError: a key is missing or unknown.
        """
        if teacher := content.get("teacher"):
            training = teacher.get("training") and cls.from_dict(teacher["training"])
            content = {**content, "teacher": TeacherRecord(**{**teacher, "training": training})}
        return cls(**content)


@dataclass(frozen=True)
class TeacherRecord:
    """The model that a student was distilled from.

    Attributes:
        sha256: of its weights.
        sampling_steps: of its sampler.
        guidance: its weight of classifier-free guidance.
        training: its own record; None if unknown.
    """

    sha256: str
    sampling_steps: int
    guidance: float
    training: TrainingRecord | None = None
