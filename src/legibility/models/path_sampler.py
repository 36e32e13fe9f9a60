"""Paths drawn by stage 1 in scenes: in metres, on the right side of the straight line."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ..checks import Array, bounded
from ..curves import NUM_WAYPOINTS, path_curve
from ..errors import CheckpointError, InvalidInputError
from ..intent.metrics import SCORE_POINTS
from ..motion.path import straight_waypoints
from ..scene import Scene
from .configuration import PathDiffuserConfig, at_most
from .diffusion import standard_normal
from .frame import Frame
from .path_diffuser import PathDiffuser

_RETRIES = 3
_STEP_BACK = 0.03
_TOLERANCE = 0.05
_LEAST_COST = 1e-12


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

    @torch.inference_mode()
    def draw(
        self,
        scenes: Sequence[Scene],
        targets: Sequence[int],
        levels: Array,
        seed: int,
        sampling: Sampling,
    ) -> Array:
        """A path for each of `levels (B,)`, in `B` scenes or in one for all.

        Returns:
            `(B, K + 2, D)` [m]; its ends are start and goal exactly.
        """
        size, dim = len(levels), self.config.dim
        generator = torch.Generator("cpu").manual_seed(seed)
        noise = standard_normal(size, NUM_WAYPOINTS, dim, generator=generator)
        level = torch.from_numpy(levels.astype(np.float32))
        conditions = self.model.conditions(list(scenes), list(targets))
        waypoints = self.sample(conditions, level, noise, **sampling._asdict()).double().numpy()
        if not np.isfinite(waypoints).all():
            raise CheckpointError(f"the model {self.name} drew a path that is not finite")
        paths = np.empty((size, NUM_WAYPOINTS + 2, dim))
        for row, scene, target in _rows(scenes, targets, size):
            paths[row, 1:-1] = Frame.of(scene, target).frame_to_world(waypoints[row])
            paths[row, 0], paths[row, -1] = scene.start, scene.goals[target]
        return paths

    def draw_with_retries(
        self,
        scenes: Sequence[Scene],
        targets: Sequence[int],
        levels: Array,
        seed: int,
        sampling: Sampling,
    ) -> Array:
        """`draw`, and draw again what lies on the wrong side of the straight line.

        Where the best way round changes with ℓ, a draw may fall between two ways. The straight
        line's score reveals it: a legible path must not cost more, an ambiguous one not less. Each
        retry asks for a little less. A model without the field gets no help from it here either.
        """
        paths = self.draw(scenes, targets, levels, seed, sampling)
        if self.config.observer.label != "anchored" or not self.config.field:
            return paths
        for retry in range(1, _RETRIES + 1):
            wrong = self._on_wrong_side(scenes, targets, levels, paths)
            if not len(wrong):
                break
            shared = len(scenes) == 1
            paths[wrong] = self.draw(
                scenes if shared else [scenes[i] for i in wrong],
                targets if shared else [targets[i] for i in wrong],
                levels[wrong] * (1 - _STEP_BACK) ** retry,
                seed ^ retry, sampling,
            )  # fmt: skip
        return paths

    def _on_wrong_side(
        self, scenes: Sequence[Scene], targets: Sequence[int], levels: Array, paths: Array
    ) -> NDArray[np.intp]:
        """Indices of the paths that are clearly on the other side of the straight line than ℓ."""
        ratio = np.empty(len(levels))
        for row, scene, target in _rows(scenes, targets, len(levels)):
            straight = straight_waypoints(scene.start, scene.goals[target])
            curves = path_curve(np.concatenate([paths[row], straight[None]]), SCORE_POINTS)
            low, high = scene.workspace
            inside = np.minimum(np.maximum(curves, low), high)  # quicker than np.clip
            costs = _LEAST_COST - self.config.observer.score(inside, scene, target)
            ratio[row] = costs[:-1] / costs[-1]
        return np.flatnonzero(np.log(ratio) * np.sign(levels) > _TOLERANCE)


def _rows(
    scenes: Sequence[Scene], targets: Sequence[int], size: int
) -> Iterator[tuple[slice, Scene, int]]:
    """Each scene with its target and the rows of a batch of `size` that lie in it."""
    shared = len(scenes) == 1
    rows = [slice(None)] if shared else [slice(i, i + 1) for i in range(size)]
    return zip(rows, scenes, targets, strict=True)
