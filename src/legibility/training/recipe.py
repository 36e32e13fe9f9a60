"""The settings of every stage of one model, from its data to its student."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any

from ..data.configuration import DatasetConfig, DemonstrationsConfig
from ..errors import InvalidInputError
from ..intent.observer import Observer
from ..models.configuration import PathDiffuserConfig, PathPolicyConfig
from .configuration import (
    FIXED_BY_DATA,
    DistillationConfig,
    PathTrainingConfig,
    PolicyTrainingConfig,
)

_SECTIONS: dict[str, tuple[type, ...]] = {
    "observer": (Observer,),
    "data": (DatasetConfig,),
    "demonstrations": (DatasetConfig, DemonstrationsConfig),
    "path": (PathTrainingConfig, PathDiffuserConfig),
    "policy": (PolicyTrainingConfig, PathPolicyConfig),
    "student": (DistillationConfig,),
}
"""The dataclasses whose fields a section has."""

_SCALE = {"alpha", "detour", "label"}
_GIVEN = {
    Observer: {field.name for field in fields(Observer)} - _SCALE,
    DatasetConfig: {"dim", "seed", "stream", "observer", "given"},
    PathTrainingConfig: {"seed"},
    PathDiffuserConfig: {*FIXED_BY_DATA, "distilled"},
    PolicyTrainingConfig: {"seed"},
    PathPolicyConfig: {"dim", "limit"},
    DistillationConfig: {"seed", "dropout"},
}
"""The fields that a section does not have, since something else fixes them."""

_DEFAULTS: dict[str, dict[str, Any]] = {
    "data": {"scenes": 4096, "views": 4, "per_scene": 25},
    "demonstrations": {"scenes": 3200, "regime": "dragan", "views": 1, "demonstrations": 4},
}
"""Where the shipped weights differ from the defaults of each command."""


@dataclass(frozen=True)
class Recipe:
    """The settings of every stage of one model.

    Attributes:
        data: of stage 1 and its student.
        shown: of the dataset whose paths are demonstrated to stage 2.
        demonstrations: of these paths.
        path: the training of stage 1, the teacher.
        path_network: its network, without what the data fix.
        policy: the training of stage 2.
        policy_network: its network, without what the data fix.
        student: the distillation of the teacher.
    """

    data: DatasetConfig
    shown: DatasetConfig
    demonstrations: DemonstrationsConfig
    path: PathTrainingConfig
    path_network: dict[str, Any]
    policy: PolicyTrainingConfig
    policy_network: dict[str, Any]
    student: DistillationConfig

    @classmethod
    def of(cls, *layers: Mapping[str, Any], dim: int = 2, seed: int = 0) -> Recipe:
        """The recipe of the shipped weights, with other settings in some sections.

        Args:
            layers: settings by section, of which the last that is not None counts. The sections are
                `observer`, what ℓ means (α, detour, label); `data`; `demonstrations`, of their
                dataset and of the controller; `path` and `policy`, of training and network;
                `student`.
            dim: 2 or 3.
            seed: of the data and of every training.

        Raises:
            InvalidInputError: a section or a setting is unknown or out of its range.
        """
        parts = _parts(layers)
        scale = Observer(**parts["observer"][0])
        common = {"dim": dim, "seed": seed, "observer": scale}
        try:
            (data,), (shown, controller) = parts["data"], parts["demonstrations"]
            (path, path_network), (policy, policy_network) = parts["path"], parts["policy"]
            source = DatasetConfig(**shown, **common)
            demonstrations = DemonstrationsConfig(**controller)
            demonstrations.within(source)
            PathDiffuserConfig(dim=dim, observer=scale, **path_network)
            PathPolicyConfig(dim=dim, **policy_network)
            return cls(
                data=DatasetConfig(**data, **common),
                shown=source,
                demonstrations=demonstrations,
                path=PathTrainingConfig(**path, seed=seed),
                path_network=path_network,
                policy=PolicyTrainingConfig(**policy, seed=seed),
                policy_network=policy_network,
                student=DistillationConfig(**parts["student"][0], seed=seed),
            )
        except TypeError as cause:
            raise InvalidInputError(f"a setting is of the wrong type: {cause}") from cause

    def to_dict(self) -> dict[str, Any]:
        """Plain values, for a report."""
        return {
            "data": self.data.to_dict(),
            "demonstrations": {**self.shown.to_dict(), **asdict(self.demonstrations)},
            "path": {**asdict(self.path), **self.path_network},
            "policy": {**asdict(self.policy), **self.policy_network},
            "student": asdict(self.student),
        }


def _parts(layers: Sequence[Mapping[str, Any]]) -> dict[str, list[dict[str, Any]]]:
    """The settings of each section, with the defaults, apart by their dataclasses."""
    for layer in layers:
        if not isinstance(layer, Mapping) or not all(
            isinstance(section, Mapping) for section in layer.values()
        ):
            raise InvalidInputError(f"settings must be sections of settings, got {layer!r}")
        if unknown := sorted(set(map(str, layer)) - set(_SECTIONS)):
            raise InvalidInputError(
                f"settings have sections {', '.join(_SECTIONS)}, got {', '.join(unknown)}"
            )
    parts = {}
    for section, types in _SECTIONS.items():
        settings = {
            name: tuple(value) if isinstance(value, list) else value
            for layer in (_DEFAULTS, *layers)
            for name, value in layer.get(section, {}).items()
            if value is not None
        }
        known = [{f.name for f in fields(kind)} - _GIVEN.get(kind, set()) for kind in types]
        names = set().union(*known)
        if unknown := sorted(set(map(str, settings)) - names):
            raise InvalidInputError(
                f"the section {section} has {', '.join(sorted(names))}, got {', '.join(unknown)}"
            )
        parts[section] = [{k: v for k, v in settings.items() if k in own} for own in known]
    return parts
