"""The two stages composed: from a scene, a target and ℓ to a path."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path as FilePath
from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray

from .checks import (
    Array,
    count,
    finite_array,
    legibility_levels,
    positive,
    random_seed,
    target_index,
)
from .curves import NUM_WAYPOINTS, path_curve
from .errors import CheckpointError, InvalidInputError, InvalidSceneError
from .execution import Driver, Fleet, Policy, Rollout, follow
from .intent.field import InformationPotentialField
from .intent.metrics import SCORE_POINTS, legibility_score
from .models.diffusion import standard_normal
from .models.frame import Frame
from .models.path_diffuser import PathDiffuser, PathDiffuserConfig
from .models.path_policy import PathPolicy
from .models.pretrained import load_stages, pretrained_folder, save_stage
from .motion.archive import Archive
from .path import Path, scene_archive, straight_waypoints
from .scene import MIN_SEPARATION, Scene

__all__ = ["BACKENDS", "Modulator"]

BACKENDS = ("torch", "onnx")
"""What may run the networks."""

_ATTEMPTS = 3
_LESS = 0.03
_CLEARLY = 0.05
_LEAST_COST = 1e-12
_AT_START, _BESIDE = 1e-4, 1e-5


class Modulator:
    """Plans motions of any legibility, from most ambiguous (−1) to most legible (1).

    Args:
        path_diffuser: stage 1.
        path_policy: stage 2; without it motions are planned, not executed.
        name: of the weights.
        training: how each stage was made, by the names `path` and `policy`, for the model card.
        backend: what runs the networks, `torch` or `onnx` (onnxruntime: the same results to
            rounding, sooner); `onnx` keeps to the weights of now, and to their own guidance and
            number of steps.
        graphs: folder that keeps the graphs of the backend `onnx`; one that is not there yet is
            exported, which needs onnxscript and up to a minute.

    Attributes:
        sampler: `PathDiffuser.sample`, as the backend runs it.

    Raises:
        MissingExtraError: onnxruntime is asked for and not installed.
    """

    def __init__(
        self,
        path_diffuser: PathDiffuser,
        path_policy: PathPolicy | None = None,
        name: str = "unnamed",
        training: dict[str, Any] | None = None,
        backend: str = "torch",
        graphs: FilePath | None = None,
    ) -> None:
        self.path_diffuser = path_diffuser.eval().requires_grad_(False)
        self.path_policy = path_policy
        if path_policy is not None:
            path_policy.eval().requires_grad_(False)
            if path_policy.config.dim != path_diffuser.config.dim:
                raise InvalidInputError(
                    f"the stages must have one dimension, got {path_diffuser.config.dim} and "
                    f"{path_policy.config.dim}"
                )
        self.name = name
        self.training = training or {}
        if backend not in BACKENDS:
            raise InvalidInputError(f"backend must be one of {BACKENDS}, got {backend!r}")
        self.sampler, self._actor = self.path_diffuser.sample, path_policy
        if backend == "onnx":
            from .models.onnx import OnnxPathDiffuser, OnnxPathPolicy, load_graph

            graph = load_graph(path_diffuser, graphs)
            self.sampler = OnnxPathDiffuser(path_diffuser, graph).sample
            if path_policy is not None:
                graph = load_graph(path_policy, graphs)
                self._actor = OnnxPathPolicy(path_policy, graph)

    @property
    def config(self) -> PathDiffuserConfig:
        """The settings of stage 1."""
        return self.path_diffuser.config

    @property
    def distilled(self) -> bool:
        """Whether stage 1 is a student, see `distill_path`: it draws as it learned to, not else."""
        return "teacher" in (self.training.get("path") or {})

    @classmethod
    def from_pretrained(
        cls, name_or_folder: str | FilePath, *, backend: str = "torch"
    ) -> Modulator:
        """Load weights that came with the package, or from a folder.

        Args:
            name_or_folder: one of `pretrained_names()`, or a folder with `config.json`,
                `path.safetensors` and, for stage 2, `policy.safetensors`.
            backend: what runs the networks, `torch` or `onnx`, see `Modulator`.

        Raises:
            CheckpointError: there are no such weights, or they are corrupted.
            MissingExtraError: onnxruntime is asked for and not installed.
        """
        folder = pretrained_folder(name_or_folder)
        stages, training = load_stages(folder)
        if "path" not in stages:
            raise CheckpointError(f"{folder} has no stage 1")
        return cls(
            stages["path"], stages.get("policy"),
            name=folder.resolve().name, training=training, backend=backend, graphs=folder,
        )  # fmt: skip

    def save_pretrained(self, folder: str | FilePath) -> None:
        """Write `config.json` and the weights of each stage to `folder`."""
        save_stage(folder, "path", self.path_diffuser, self.training.get("path"))
        if self.path_policy is not None:
            save_stage(folder, "policy", self.path_policy, self.training.get("policy"))

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
                achieved label is nearest to ℓ is returned; at ±1 the most legible or ambiguous
                one, whether or not the archive holds any like it. Between, more than one needs the
                scene's archive, which is built once (about 0.15 s) and kept.
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
        guidance, steps = self._sampling(guidance, steps)
        asked = np.repeat(np.atleast_1d(levels), num_candidates)
        draw = self._draw_on_its_side if num_candidates == 1 else self._draw
        drawn = draw([scene], [target], asked, seed, guidance, steps)
        if num_candidates > 1:
            scores = self._path(scene, target, asked, drawn).score.reshape(-1, num_candidates)
            best = self._nearest(scene, target, np.atleast_1d(levels), scores)
            drawn = drawn[np.arange(len(best)) * num_candidates + best]
        return self._path(scene, target, levels, drawn if levels.ndim else drawn[0])

    def plan_many(
        self,
        scenes: Sequence[Scene],
        targets: Sequence[int],
        legibility: ArrayLike,
        *,
        seed: int = 0,
        num_candidates: int = 1,
        guidance: float | None = None,
        steps: int | None = None,
    ) -> list[Path]:
        """One path in each of many scenes, all drawn at once if there are no candidates.

        Args:
            scenes: `B` of the model's dimension.
            targets: `(B,)`, index of the goal that is meant in each.
            legibility: ℓ in [−1, 1], one for all or `(B,)`.
            seed: of the paths drawn.
            num_candidates: see `plan`.
            guidance: weight of classifier-free guidance at ±1; the model's own if not given.
            steps: of the sampler; the model's own if not given.

        Raises:
            InvalidInputError: an argument is out of its range.
            InvalidSceneError: a scene has another dimension than the model.
        """
        scenes = list(scenes)
        for scene in scenes:
            self._check_scene(scene)
        if not scenes or len(targets) != len(scenes):
            raise InvalidInputError(
                f"targets must be as many as scenes, at least one, "
                f"got {len(targets)} and {len(scenes)}"
            )
        chosen = [target_index(t, s.num_goals) for s, t in zip(scenes, targets, strict=True)]
        levels = levels_for(len(scenes), legibility)
        if count("num_candidates", num_candidates) > 1:
            words = np.random.SeedSequence(random_seed("seed", seed)).generate_state(len(scenes))
            options: dict[str, Any] = {"guidance": guidance, "steps": steps}
            return [
                self.plan(
                    scene, target, level, seed=int(word), num_candidates=num_candidates, **options
                )
                for scene, target, level, word in zip(scenes, chosen, levels, words, strict=True)
            ]
        guidance, steps = self._sampling(guidance, steps)
        drawn = self._draw_on_its_side(
            scenes, chosen, levels, random_seed("seed", seed), guidance, steps
        )
        return [self._path(*each) for each in zip(scenes, chosen, levels, drawn, strict=True)]

    def execute(
        self,
        env: Any,
        target: int | Sequence[int] | None = None,
        legibility: ArrayLike = 1.0,
        *,
        seed: int = 0,
        path: Path | Sequence[Path] | None = None,
        replan: bool = True,
        tolerance: float | None = None,
        num_candidates: int = 1,
        guidance: float | None = None,
        steps: int | None = None,
        driver: Driver | None = None,
    ) -> Rollout | list[Rollout]:
        """Plan and move, closed loop, from where the environment stands until the episode ends.

        An environment that was never reset is reset with `seed` first.

        Args:
            env: an environment of this package, or a vector of them (`gymnasium.make_vec`), whose
                `B` robots are planned and moved together.
            target: index of the goal that is meant, one for all or `(B,)`; the environment's own
                if not given.
            legibility: ℓ in [−1, 1], one for all or `(B,)`.
            seed: of the paths and actions drawn.
            path: follow these, `B` of them, instead of planning; they must start at the robots.
            replan: whether to plan again, with the same ℓ for what is left of the motion, where a
                push has taken the robot off its path by more than `tolerance` or its goal was
                moved; else it goes back to the path. Nearer to the goal than training ever started
                the rest is straight.
            tolerance: [m]; the largest action's length if not given.
            num_candidates: paths drawn for each ℓ, see `plan`.
            guidance: of stage 1, see `plan`.
            steps: of stage 1's sampler, see `plan`.
            driver: moves the robots instead of stage 2.

        Returns:
            A rollout, or a list of `B` if `env` is a vector.

        Raises:
            InvalidInputError: an argument is out of its range or does not fit the environment.
            CheckpointError: the model has no stage 2.
        """
        seed = random_seed("seed", seed)
        if driver is None:
            if self._actor is None:
                raise CheckpointError(f"the model {self.name} has no stage 2 to move a robot with")
            driver = Policy(self._actor, seed)
        fleet = Fleet(env, seed)
        if fleet.workspace.shape[1] != self.config.dim:
            raise InvalidInputError(
                f"the model {self.name} moves in {self.config.dim}D, "
                f"the environment is {fleet.workspace.shape[1]}D"
            )
        if self.path_policy is not None and fleet.limit != self.path_policy.config.limit:
            raise InvalidInputError(
                f"the model {self.name} acts within {self.path_policy.config.limit} m a step, "
                f"the environment's limit is {fleet.limit} m"
            )
        off = fleet.limit if tolerance is None else positive("tolerance", tolerance)
        levels = levels_for(fleet.size, legibility)
        given = None if path is None else list(path) if isinstance(path, list | tuple) else [path]
        if given is not None and (
            len(given) != fleet.size or not all(isinstance(p, Path) for p in given)
        ):
            raise InvalidInputError(
                f"path must be a legibility.Path for each of {fleet.size} robots, got {len(given)}"
            )
        if target is not None:
            several = isinstance(target, list | tuple | np.ndarray) and np.ndim(target) > 0
            wanted: list[Any] = list(target) if several else [target] * fleet.size  # pyright: ignore
            if len(wanted) != fleet.size:
                raise InvalidInputError(
                    f"target must be one for all or {fleet.size}, got {len(wanted)}"
                )
            fleet.set_targets(wanted)
        options: dict[str, Any] = {
            "num_candidates": num_candidates, "guidance": guidance, "steps": steps
        }  # fmt: skip
        here = [
            _moved(scene, position)
            for scene, position in zip(fleet.scenes, fleet.positions, strict=True)
        ]
        paths: Any = given
        if paths is None:
            paths = self.plan_many(here, fleet.targets.tolist(), levels, seed=seed, **options)

        def plan_again(rows: list[int], positions: Array) -> list[Path]:
            scenes = fleet.scenes
            here = [_moved(scenes[r], x) for r, x in zip(rows, positions, strict=True)]
            targets = fleet.targets[rows].tolist()
            found = self.plan_many(here, targets, levels[rows], seed=seed, **options)
            return [_or_straight(p) for p in found]

        rollouts = follow(
            fleet, paths, driver,
            plan_again=plan_again if replan else None, tolerance=off,
        )  # fmt: skip
        return rollouts if hasattr(env.unwrapped, "num_envs") else rollouts[0]

    def _path(self, scene: Scene, target: int, levels: Array, drawn: Array) -> Path:
        config = self.config
        return Path.through(
            drawn, scene, target, levels,
            sigma=config.sigma, alpha=config.alpha, label=config.label,
        )  # fmt: skip

    def archive(self, scene: Scene, target: int = 0) -> Archive:
        """The archive of a scene as this model's labels mean it; the last ones are kept."""
        config = self.config
        return scene_archive(scene, target, config.sigma, config.alpha, config.label)

    def _sampling(
        self, guidance: float | None, steps: int | None
    ) -> tuple[float | None, int | None]:
        if guidance is not None:
            guidance = float(finite_array("guidance", guidance, ndim=0))
        if steps is not None and count("steps", steps) > self.config.diffusion_steps:
            raise InvalidInputError(
                f"steps must be at most {self.config.diffusion_steps}, got {steps}"
            )
        own = (self.config.guidance, self.config.sampling_steps)
        if self.distilled and (guidance not in (None, own[0]) or steps not in (None, own[1])):
            raise InvalidInputError(
                f"the model {self.name} was distilled: its guidance is {own[0]:g} and its steps "
                f"{own[1]}, got {guidance} and {steps}"
            )
        return guidance, steps

    def _draw_on_its_side(
        self,
        scenes: list[Scene],
        targets: list[int],
        levels: Array,
        seed: int,
        guidance: float | None,
        steps: int | None,
    ) -> Array:
        """`_draw`, but what lies on the wrong side of the straight line is drawn again.

        Where the best way round changes with ℓ, a draw may fall between two ways. With anchored
        labels the straight line's score tells: what is asked to be legible must not cost more than
        it, what is asked to be ambiguous not less. Each attempt asks for a little less. A model
        without the field is not helped by the field here either.
        """
        drawn = self._draw(scenes, targets, levels, seed, guidance, steps)
        if self.config.label != "anchored" or not self.config.field:
            return drawn
        for attempt in range(1, _ATTEMPTS + 1):
            wrong = self._wrong_side(scenes, targets, levels, drawn)
            if not len(wrong):
                break
            one = len(scenes) == 1
            drawn[wrong] = self._draw(
                scenes if one else [scenes[i] for i in wrong],
                targets if one else [targets[i] for i in wrong],
                levels[wrong] * (1 - _LESS) ** attempt,
                seed ^ attempt, guidance, steps,
            )  # fmt: skip
        return drawn

    def _wrong_side(
        self, scenes: list[Scene], targets: list[int], levels: Array, drawn: Array
    ) -> NDArray[np.intp]:
        """Indices of the paths that are clearly on the other side of the straight line than ℓ."""
        ratio = np.empty(len(levels))
        rows = [slice(None)] if len(scenes) == 1 else [slice(i, i + 1) for i in range(len(levels))]
        for row, scene, target in zip(rows, scenes, targets, strict=True):
            field = InformationPotentialField.of(scene, self.config.sigma)
            straight = np.linspace(scene.start, scene.goals[target], SCORE_POINTS)
            curves = np.clip(path_curve(drawn[row], SCORE_POINTS), *scene.workspace)
            curves = np.concatenate([curves, straight[None]])
            costs = -legibility_score(curves, field, target, self.config.alpha)
            ratio[row] = (costs[:-1] + _LEAST_COST) / (costs[-1] + _LEAST_COST)
        return np.flatnonzero(np.log(ratio) * np.sign(levels) > _CLEARLY)

    def _nearest(self, scene: Scene, target: int, levels: Array, scores: Array) -> NDArray[np.intp]:
        """Index `(B,)` of the candidate that is nearest to each of `levels (B,)`.

        Labels end at ±1, scores do not: there it is the most extreme one.
        """
        best = np.argmax(np.sign(levels)[:, None] * scores, axis=1)
        between = np.abs(levels) < 1
        if between.any():
            labels = self.archive(scene, target).label_of(scores[between])
            best[between] = np.argmin(np.abs(labels - levels[between, None]), axis=1)
        return best

    @torch.inference_mode()
    def _draw(
        self,
        scenes: list[Scene],
        targets: list[int],
        levels: Array,
        seed: int,
        guidance: float | None,
        steps: int | None,
    ) -> Array:
        """One path for each of `levels (B,)`, `(B, K + 2, D)` [m]; its ends are exact.

        In `B` scenes, or in one for all.
        """
        model = self.path_diffuser
        size, dim = len(levels), self.config.dim
        generator = torch.Generator("cpu").manual_seed(seed)
        noise = standard_normal(size, NUM_WAYPOINTS, dim, generator=generator)
        drawn = self.sampler(
            model.conditions(scenes, targets),
            torch.from_numpy(levels.astype(np.float32)),
            noise,
            guidance=guidance,
            steps=steps,
        )
        if not torch.isfinite(drawn).all():
            raise CheckpointError(f"the model {self.name} drew a path that is not finite")
        found = drawn.double().numpy()
        path = np.empty((size, NUM_WAYPOINTS + 2, dim))
        rows = [slice(None)] if len(scenes) == 1 else list(range(size))
        for row, scene, target in zip(rows, scenes, targets, strict=True):
            path[row, 1:-1] = Frame.of(scene, target).frame_to_world(found[row])
            path[row, 0], path[row, -1] = scene.start, scene.goals[target]
        return path

    def _check_scene(self, scene: Scene) -> None:
        if not isinstance(scene, Scene):
            raise InvalidSceneError(f"scene must be a legibility.Scene, got {type(scene).__name__}")
        if scene.dim != self.config.dim:
            raise InvalidSceneError(
                f"the model {self.name} plans in {self.config.dim}D, the scene is {scene.dim}D"
            )


def levels_for(size: int, legibility: ArrayLike) -> Array:
    """ℓ `(size,)` of one for all or of as many."""
    levels = legibility_levels(legibility)
    if levels.ndim and len(levels) != size:
        raise InvalidInputError(f"legibility must be one number or {size}, got {len(levels)}")
    return np.broadcast_to(levels, (size,)).copy()


def _moved(scene: Scene, start: Array) -> Scene:
    """The scene as it is for a robot that now stands at `start (D,)` [m].

    An arm is put at a scene's start as exactly as its joints go, and may be a little beyond a wall.
    A robot that was pushed onto a goal is taken to be just beside it.
    """
    if np.linalg.norm(start - scene.start) < _AT_START:
        return scene
    start, least = np.clip(start, *scene.workspace), _BESIDE * scene.diagonal
    if np.linalg.norm(scene.goals - start, axis=-1).min() < least:
        inward = scene.workspace.mean(axis=0) - start
        inward[0] += 1e-9  # in the very middle any way leads inward
        start = start + 2 * least * inward / np.linalg.norm(inward)
    return Scene(start, scene.goals, scene.workspace)


def _or_straight(path: Path) -> Path:
    """The path, or the straight line where the goal is nearer than in any scene of training."""
    start, goal = path.waypoints[0], path.waypoints[-1]
    if np.linalg.norm(goal - start) >= 2 * MIN_SEPARATION * path.scene.diagonal:
        return path
    return replace(path, waypoints=straight_waypoints(start, goal))
