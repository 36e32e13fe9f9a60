"""The two stages composed: from a scene, a target and ℓ to a path."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path as FilePath
from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike

from .checks import Array, count, finite_array, legibility_levels, random_seed, target_index
from .curves import NUM_WAYPOINTS, path_curve
from .errors import CheckpointError, InvalidInputError, InvalidSceneError
from .files import file_hash, read_text, write_json
from .intent.field import InformationPotentialField
from .intent.metrics import SCORE_POINTS, legibility_score
from .models.checkpoint import load_state, load_tensors, save_tensors
from .models.frame import Frame
from .models.path_diffuser import PathDiffuser, PathDiffuserConfig
from .motion.archive import Archive, build_archive
from .scene import Scene

__all__ = ["Modulator", "Path", "pretrained_folder", "pretrained_names"]

_FORMAT = 1
_WEIGHTS = FilePath(__file__).parent / "weights"


@dataclass(frozen=True, eq=False)
class Path:
    """One path, or `B` of them, from the start of a scene to the goal that is meant.

    Attributes:
        scene: the scene.
        target: index of the goal that is meant.
        legibility: ℓ as asked, a number or `(B,)`.
        waypoints: `(K + 2, D)` or `(B, K + 2, D)` [m]: start, K = 8 waypoints, goal; inside the
            workspace.
        clipped: bool or `(B,)`: whether the curve that the network drew left the workspace and was
            brought back to its wall.
        field: the observer.
        alpha: decay of the score's weight.
        label: how the scene's archive is labelled.
    """

    scene: Scene
    target: int
    legibility: Array
    waypoints: Array
    clipped: np.ndarray | np.bool
    field: InformationPotentialField
    alpha: float
    label: str

    def trajectory(self, num_points: int = SCORE_POINTS) -> Array:
        """The smooth curve through the waypoints, `(B?, num_points, D)` [m], in the workspace."""
        curve = path_curve(self.waypoints, count("num_points", num_points, low=2))
        curve[..., [0, -1], :] = self.waypoints[..., [0, -1], :]  # free of rounding
        return np.clip(curve, *self.scene.workspace)

    @cached_property
    def score(self) -> Array:
        """`legibility_score` of the trajectory, `(B?)`; higher = more legible."""
        return legibility_score(self.trajectory(), self.field, self.target, self.alpha)

    @property
    def archive(self) -> Archive:
        """The scene's archive, built on first use."""
        return _archive(self.scene, self.target, self.field.sigma, self.alpha, self.label)

    @cached_property
    def achieved(self) -> Array:
        """The label in [−1, 1] that the trajectory achieves in the scene's archive, `(B?)`."""
        return self.archive.label_of(self.score)


class Modulator:
    """Plans motions of any legibility, from most ambiguous (−1) to most legible (1).

    Args:
        path_diffuser: stage 1.
        name: of the weights.
        training: how they were made, for the model card.
    """

    def __init__(
        self,
        path_diffuser: PathDiffuser,
        name: str = "unnamed",
        training: dict[str, Any] | None = None,
    ) -> None:
        self.path_diffuser = path_diffuser.eval().requires_grad_(False)
        self.name = name
        self.training = training

    @property
    def config(self) -> PathDiffuserConfig:
        """The settings of stage 1."""
        return self.path_diffuser.config

    @classmethod
    def from_pretrained(cls, name_or_folder: str | FilePath) -> Modulator:
        """Load weights that came with the package, or from a folder.

        Args:
            name_or_folder: one of `pretrained_names()`, or a folder with `config.json` and
                `path.safetensors`.

        Raises:
            CheckpointError: there are no such weights, or they are corrupted.
        """
        folder = pretrained_folder(name_or_folder)
        text = read_text(folder / "config.json", "model configuration", CheckpointError)
        try:
            content = json.loads(text)
            if content["format"] != _FORMAT:
                raise CheckpointError(f"{folder} has format {content['format']}, not {_FORMAT}")
            config = PathDiffuserConfig.from_dict(content["path"])
            model, digest, training = PathDiffuser(config), content["sha256"], content["training"]
        except CheckpointError:
            raise
        except (ValueError, KeyError, TypeError, RuntimeError) as cause:
            raise CheckpointError(f"{folder} has no model configuration: {cause!r}") from cause
        weights = folder / "path.safetensors"
        load_state(model, load_tensors(weights)[0], weights)
        if file_hash(weights) != digest:
            raise CheckpointError(f"{weights} is not the file that {folder / 'config.json'} names")
        return cls(model, name=folder.resolve().name, training=training)

    def save_pretrained(self, folder: str | FilePath) -> None:
        """Write `config.json` and `path.safetensors` to `folder`."""
        folder = FilePath(folder)
        weights = folder / "path.safetensors"
        save_tensors(weights, self.path_diffuser.state_dict())
        content = {
            "format": _FORMAT,
            "path": self.config.to_dict(),
            "sha256": file_hash(weights),
            "training": self.training,
        }
        write_json(folder / "config.json", content)

    def plan(
        self,
        scene: Scene,
        target: int = 0,
        legibility: ArrayLike = 1.0,
        *,
        seed: int = 0,
        num_candidates: int = 1,
        guidance: float | None = None,
        steps: int | None = None,
    ) -> Path:
        """A path from the scene's start to goal `target` for each ℓ.

        Args:
            scene: of the model's dimension.
            target: index of the goal that is meant.
            legibility: ℓ in [−1, 1], a number or `(B,)`.
            seed: of the paths drawn.
            num_candidates: paths drawn for each ℓ; all are scored exactly and the one whose
                achieved label is nearest to ℓ is returned. More than one needs the scene's archive,
                which is built once (about 0.15 s) and kept.
            guidance: weight of classifier-free guidance at ±1; the model's own if not given.
            steps: of the sampler; the model's own if not given.

        Raises:
            InvalidInputError: an argument is out of its range.
            InvalidSceneError: the scene has another dimension than the model.
        """
        self._check_scene(scene)
        target = target_index(target, scene.num_goals)
        levels = legibility_levels(legibility)
        seed = random_seed("seed", seed)
        num_candidates = count("num_candidates", num_candidates)
        if guidance is not None:
            guidance = float(finite_array("guidance", guidance, ndim=0))
        if steps is not None and count("steps", steps) > self.config.diffusion_steps:
            raise InvalidInputError(
                f"steps must be at most {self.config.diffusion_steps}, got {steps}"
            )
        asked = np.repeat(np.atleast_1d(levels), num_candidates)
        drawn = self._draw(scene, target, asked, seed, guidance, steps)
        field = InformationPotentialField(scene.goals, self.config.sigma)

        def path(rows: Any, levels: Array) -> Path:
            low, high = scene.workspace
            inside = scene.contains(path_curve(drawn[rows], SCORE_POINTS), 1e-6).all(-1)
            return Path(
                scene, target, levels, np.clip(drawn[rows], low, high), ~inside, field,
                self.config.alpha, self.config.label,
            )  # fmt: skip

        if num_candidates > 1:
            archive = self.archive(scene, target)
            errors = np.abs(archive.label_of(path(slice(None), asked).score) - asked)
            best = np.argmin(errors.reshape(-1, num_candidates), axis=1)
            rows = np.arange(len(best)) * num_candidates + best
            return path(rows if levels.ndim else rows[0], levels)
        return path(slice(None) if levels.ndim else 0, levels)

    def archive(self, scene: Scene, target: int = 0) -> Archive:
        """The archive of a scene as this model's labels mean it; the last ones are kept."""
        config = self.config
        return _archive(scene, target, config.sigma, config.alpha, config.label)

    @torch.inference_mode()
    def _draw(
        self,
        scene: Scene,
        target: int,
        levels: Array,
        seed: int,
        guidance: float | None,
        steps: int | None,
    ) -> Array:
        """One path for each of `levels (B,)`, `(B, K + 2, D)` [m]; its ends are exact."""
        model = self.path_diffuser
        size = len(levels)
        generator = torch.Generator().manual_seed(seed)
        noise = torch.randn(size, NUM_WAYPOINTS, scene.dim, generator=generator)
        drawn = model.sample(
            model.conditions([scene], [target]),
            torch.from_numpy(levels.astype(np.float32)),
            noise,
            guidance=guidance,
            steps=steps,
        )
        if not torch.isfinite(drawn).all():
            raise CheckpointError(f"the model {self.name} drew a path that is not finite")
        path = np.empty((size, NUM_WAYPOINTS + 2, scene.dim))
        path[:, 1:-1] = Frame.of(scene, target).frame_to_world(drawn.double().numpy())
        path[:, 0], path[:, -1] = scene.start, scene.goals[target]
        return path

    def _check_scene(self, scene: Scene) -> None:
        if not isinstance(scene, Scene):
            raise InvalidSceneError(f"scene must be a legibility.Scene, got {type(scene).__name__}")
        if scene.dim != self.config.dim:
            raise InvalidSceneError(
                f"the model {self.name} plans in {self.config.dim}D, the scene is {scene.dim}D"
            )


@lru_cache(maxsize=32)
def _archive(scene: Scene, target: int, sigma: float, alpha: float, label: str) -> Archive:
    return build_archive(scene, target, sigma=sigma, alpha=alpha, label=label)


def pretrained_folder(name_or_folder: str | FilePath) -> FilePath:
    """The folder of the weights: the one that is given, or that of a name in `pretrained_names()`.

    Raises:
        CheckpointError: there is neither.
    """
    names = pretrained_names()
    if str(name_or_folder) in names:
        return _WEIGHTS / str(name_or_folder)
    if FilePath(name_or_folder).is_dir():
        return FilePath(name_or_folder)
    raise CheckpointError(
        f"there are no weights {str(name_or_folder)!r}: give a folder or one of {names}"
    )


def pretrained_names() -> list[str]:
    """Names of the weights that came with the package."""
    if not _WEIGHTS.is_dir():
        return []
    return sorted(p.name for p in _WEIGHTS.iterdir() if (p / "config.json").is_file())
