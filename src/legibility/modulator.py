"""The two stages composed: from a scene, a target and ℓ to a path, and to a robot's motion."""

from __future__ import annotations

import logging
import tempfile
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path as FilePath
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from .checks import (
    Array,
    bounded,
    count,
    for_each,
    frame_name,
    legibility_levels,
    levels_for_each,
    one_of,
    positive,
    seed_or_entropy,
)
from .controller import Controller
from .drivers import Driver, Policy
from .envs import vector_type
from .envs.fleet import Fleet, fleet_of, is_vector
from .errors import CheckpointError, InvalidInputError, InvalidSceneError
from .files import at_home, read_text, write_bytes
from .intent.observer import Observer
from .models.configuration import BACKENDS, PathDiffuserConfig
from .models.continuation import Rest, continuation
from .models.hub import CARD, plain_card, upload
from .models.path_diffuser import PathDiffuser
from .models.path_policy import PathPolicy
from .models.path_sampler import PathSampler, Sampling, Tasks, nearest_candidates
from .models.pretrained import load_stages, pretrained_folder, save_stage
from .models.provenance import TrainingRecord
from .motion.archive import Archive, scene_archive
from .motion.path import Path
from .parts import finished
from .rollout import Rollout, follow
from .scene import Scene
from .whole_arm import checked_arm, freed, keeps_off, paths_off_obstacles

if TYPE_CHECKING:
    from .robots.arm import Arm

_LOG = logging.getLogger(__name__)


class Modulator:
    """Plans motions of any legibility, from most ambiguous (−1) to most legible (1).

    Args:
        path_diffuser: stage 1.
        path_policy: stage 2; without it motions are planned, not executed.
        name: of the weights.
        training: how each stage was made, by the names `path` and `policy`, for the model card.
        backend: what runs the networks: `torch`, or `onnx` (onnxruntime: faster for one path, the
            same results to rounding), which keeps to the present weights and to the model's own
            guidance and number of steps.
        graphs: folder that keeps the graphs of the backend `onnx`; a missing one is exported, which
            needs onnxscript and up to a minute.
        card: the model card, in Markdown.

    Raises:
        InvalidInputError: the stages have different dimensions, or an unknown backend.
        MissingExtraError: onnxruntime is asked for and not installed.
    """

    def __init__(
        self,
        path_diffuser: PathDiffuser,
        path_policy: PathPolicy | None = None,
        name: str = "unnamed",
        training: Mapping[str, TrainingRecord | None] | None = None,
        backend: str = "torch",
        graphs: FilePath | None = None,
        card: str | None = None,
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
        one_of("backend", backend, BACKENDS)
        self.name, self.training, self.card = name, training or {}, card
        sample, self._policy = path_diffuser.sample, path_policy
        if backend == "onnx":
            from .models.onnx import OnnxPathDiffuser, OnnxPathPolicy, load_graph

            sample = OnnxPathDiffuser(path_diffuser, load_graph(path_diffuser, graphs)).sample
            if path_policy is not None:
                self._policy = OnnxPathPolicy(path_policy, load_graph(path_policy, graphs))
        self.sampler = PathSampler(path_diffuser, sample, name)
        _LOG.info("%s runs by %s", name, backend)

    @property
    def config(self) -> PathDiffuserConfig:
        """The settings of stage 1."""
        return self.path_diffuser.config

    def stage_2(self) -> PathPolicy:
        """Stage 2.

        Raises:
            CheckpointError: the model has none; the message says how to get one.
        """
        if self.path_policy is None:
            raise CheckpointError(
                f"the model {self.name} has no stage 2 to move a robot with: `legibility train "
                "policy --data DIR --out DIR --weights FOLDER` adds one to those in FOLDER, and "
                "`legibility train all --out DIR` makes a model with both stages"
            )
        return self.path_policy

    @classmethod
    def from_pretrained(
        cls, name_or_folder: str | FilePath, *, revision: str | None = None, backend: str = "torch"
    ) -> Modulator:
        """Load weights that came with the package, from a folder or from the Hugging Face Hub.

        Args:
            name_or_folder: one of `pretrained_names()`, a folder with `config.json`,
                `path.safetensors` and, for stage 2, `policy.safetensors`, or such a repository on
                the Hub, `USER/REPOSITORY` or `USER/REPOSITORY@REVISION`, of which nothing else is
                downloaded.
            revision: of the repository, a branch, a tag or a commit; its main branch if not given.
            backend: what runs the networks, `torch` or `onnx`, see `Modulator`.

        Raises:
            CheckpointError: there are no such weights, or they are corrupted; `HubError`, if they
                cannot be downloaded.
            MissingExtraError: onnxruntime is asked for and not installed.
        """
        folder = pretrained_folder(name_or_folder, revision)
        stages, training = load_stages(folder)
        if "path" not in stages:
            raise CheckpointError(f"{folder} has no stage 1")
        here, card = at_home(name_or_folder), folder / CARD
        return cls(
            stages["path"], stages.get("policy"), backend=backend, graphs=folder, training=training,
            name=here.resolve().name if here.is_dir() else str(name_or_folder),
            card=read_text(card, "model card", CheckpointError) if card.is_file() else None,
        )  # fmt: skip

    def save_pretrained(self, folder: str | FilePath) -> None:
        """Write `config.json`, the weights of each stage and the card, if any, to `folder`."""
        save_stage(folder, "path", self.path_diffuser, self.training.get("path"))
        if self.path_policy is not None:
            save_stage(folder, "policy", self.path_policy, self.training.get("policy"))
        if self.card is not None:
            write_bytes(at_home(folder) / CARD, self.card.encode())

    def push_to_hub(
        self,
        repository: str,
        *,
        branch: str | None = None,
        private: bool | None = None,
        token: str | None = None,
    ) -> str:
        """Push the weights and their model card to the Hugging Face Hub, in one commit.

        `legibility report RESULTS --weights DIR` writes the card of each folder of weights in DIR,
        with the metrics that were measured; without it the card says that none were.

        Args:
            repository: `USER/REPOSITORY`, made if it is missing.
            branch: made if it is missing; the main one if not given.
            private: whether a new repository is private; the account's default if not given.
            token: of an account that may write; that of `hf auth login` or HF_TOKEN if not given.

        Returns:
            The address of the commit.

        Raises:
            HubError: there is no token, or the Hub refuses it or cannot be reached.
            InvalidInputError: `repository` is no such name.
        """
        with tempfile.TemporaryDirectory() as folder:
            self.save_pretrained(folder)
            loaded, loads = (f'from_pretrained("{name}")' for name in (self.name, repository))
            card = (self.card or plain_card(repository)).replace(loaded, loads)
            write_bytes(FilePath(folder) / CARD, card.encode())
            return upload(FilePath(folder), repository, branch=branch, private=private, token=token)

    def archive(self, scene: Scene, target: int = 0, observer: Observer | None = None) -> Archive:
        """The archive of a scene by which labels are read; cached."""
        return scene_archive(scene, target, self._observer(observer))

    @np.errstate(under="ignore")
    def plan(
        self,
        scene: Scene,
        target: int = 0,
        legibility: ArrayLike = 1.0,
        *,
        seed: int | None = 0,
        observer: Observer | None = None,
        exact: bool = False,
        refine: bool = True,
        max_detour: float | None = None,
        num_candidates: int = 1,
        guidance: float | None = None,
        steps: int | None = None,
        arm: Arm | str | None = None,
    ) -> Path:
        """A path from the scene's start to goal `target` for each ℓ.

        Args:
            scene: of the model's dimension.
            target: index of the intended goal.
            legibility: ℓ in [−1, 1], a number or `(B,)`.
            seed: of the paths drawn; None draws other paths each time.
            observer: who watches; the model's own, Dragan's, if not given. α, detour and label must
                be those that the model learned. A quick plan is least exact for those beyond the
                model's data, whose β lies from 5 to 60 and σ from 0.06 to 0.37 over the scene's
                size.
            exact: meet ℓ to its noise by the scene's archive, which is built once (about 0.2 s) and
                cached.
            refine: move paths out of contact and to the score that ℓ asks for; where that fails, or
                makes waves, a curve of the archive stands in. Without it the network's own paths
                are returned, feasible or not.
            max_detour: longest path over the shortest feasible one, from 1 on: a level that takes
                a longer one is met as nearly as it allows. Past an obstacle the shortest path,
                which keeps a little more clear than the shortest curve, is a little longer.
            num_candidates: paths drawn for each ℓ, of which the one whose achieved label is nearest
                to ℓ is returned; at ±1 the most legible or ambiguous one, even beyond the archive.
                Between, more than one needs the scene's archive.
            guidance: weight of classifier-free guidance at ±1; the model's if not given.
            steps: of the sampler; the model's if not given.
            arm: that should keep off the obstacles with all its links, or its name.

        Raises:
            InvalidInputError: an argument is out of its range.
            InvalidSceneError: the scene has another dimension than the model, a motion cannot end
                at the target, or no curve to it was found.
        """
        levels = legibility_levels(legibility)
        seed = seed_or_entropy("seed", seed)
        if (body := checked_arm(arm, self.config.dim)) is not None and scene.obstacles:
            options = {
                "exact": exact, "refine": refine, "max_detour": max_detour, "steps": steps,
                "num_candidates": num_candidates, "guidance": guidance, "observer": observer,
            }  # fmt: skip
            asked = np.atleast_1d(levels)

            def again(rows: list[int], seed: int) -> list[Path]:
                path = self.plan(scene, target, asked[rows], seed=seed, **options)
                return [path[i] for i in range(len(path))]

            paths = paths_off_obstacles([body] * len(asked), again, seed, max_detour)
            return Path.of(paths) if levels.ndim else paths[0]
        number = count("num_candidates", num_candidates)
        sampling = Sampling(guidance, steps).checked(self.config)
        tasks = self._tasks([scene], [target], [observer], np.repeat(np.atleast_1d(levels), number))
        target, observer = tasks.targets[0], tasks.observers[0]
        paths, replaced = self.sampler.plan(
            tasks, seed, sampling, exact=exact, refine=refine, candidates=number,
            max_detour=_detour(max_detour),
        )  # fmt: skip
        if number > 1:
            scores = Path.through(paths, scene, target, tasks.levels, observer).score
            best = nearest_candidates(
                tasks.levels[::number], scores.reshape(-1, number),
                lambda: self.archive(scene, target, observer),
            )  # fmt: skip
            chosen = np.arange(len(best)) * number + best
            paths, replaced = paths[chosen], replaced[chosen]
        if not levels.ndim:
            paths, replaced = paths[0], replaced[0]
        return Path(scene, target, levels, paths, observer, replaced)

    @np.errstate(under="ignore")
    def plan_many(
        self,
        scenes: Sequence[Scene],
        targets: int | Sequence[int] = 0,
        legibility: ArrayLike = 1.0,
        *,
        seed: int | None = 0,
        observer: Observer | Sequence[Observer] | None = None,
        exact: bool = False,
        refine: bool = True,
        max_detour: float | None = None,
        num_candidates: int = 1,
        guidance: float | None = None,
        steps: int | None = None,
    ) -> list[Path]:
        """One path in each of many scenes, all drawn at once if there are no candidates.

        Args:
            scenes: `B` of the model's dimension.
            targets: index of the intended goal, one for all or `(B,)`.
            legibility: ℓ in [−1, 1], one for all or `(B,)`.
            observer: who watches, one for all or a list of `B`.
            seed, exact, refine, max_detour, num_candidates, guidance, steps: see `plan`.
        """
        if not isinstance(scenes, Sequence) or not len(scenes):
            raise InvalidInputError(
                f"scenes must be a list of at least one, got {scenes!r}; plan takes a single one"
            )
        size = len(scenes)
        levels = levels_for_each(legibility, size)
        seed = seed_or_entropy("seed", seed)
        sampling = Sampling(guidance, steps).checked(self.config)
        observers: list[Any] = [observer] * size
        if isinstance(observer, list | tuple):
            observers = list(observer)
        if len(observers) != size:
            raise InvalidInputError(f"observer must be one for all or {size}, got {len(observers)}")
        tasks = self._tasks(list(scenes), for_each("targets", targets, size), observers, levels)
        if count("num_candidates", num_candidates) > 1:
            seeds = np.random.SeedSequence(seed).generate_state(size).tolist()
            options = {
                "exact": exact, "refine": refine, "max_detour": max_detour,
                "num_candidates": num_candidates, **sampling._asdict(),
            }  # fmt: skip
            return [
                self.plan(scene, target, level, seed=scene_seed, observer=watching, **options)
                for scene, target, watching, level, scene_seed in zip(*tasks, seeds, strict=True)
            ]
        paths, replaced = self.sampler.plan(
            tasks, seed, sampling, exact=exact, refine=refine, max_detour=_detour(max_detour)
        )
        return [
            Path(scene, target, level, waypoints, watching, stands_in)
            for scene, target, watching, level, waypoints, stands_in in zip(
                *tasks, paths, replaced, strict=True
            )
        ]

    def _tasks(
        self,
        scenes: Sequence[Scene],
        targets: Sequence[int],
        observers: Sequence[Observer | None],
        levels: Array,
    ) -> Tasks:
        """Paths to draw, checked."""
        for scene in scenes:
            self._check_scene(scene)
        checked = [s.check_target(t) for s, t in zip(scenes, targets, strict=True)]
        return Tasks(scenes, checked, [self._observer(o) for o in observers], levels)

    def _observer(self, observer: Observer | None) -> Observer:
        """The observer, or the model's own; the scale of ℓ must be that of the model."""
        own = self.config.observer
        if observer is None:
            return own
        if not isinstance(observer, Observer):
            raise InvalidInputError(f"observer must be a legibility.Observer, got {observer!r}")
        if observer.scale != own.scale:
            raise InvalidInputError(
                f"the model {self.name} learned alpha, detour and label {own.scale}, the observer "
                f"has {observer.scale}"
            )
        return observer

    def execute(
        self,
        env: Any,
        target: int | None = None,
        legibility: float = 1.0,
        *,
        seed: int | None = 0,
        path: Path | None = None,
        replan: bool = True,
        tolerance: float | None = None,
        observer: Observer | None = None,
        exact: bool = False,
        refine: bool = True,
        max_detour: float | None = None,
        num_candidates: int = 1,
        guidance: float | None = None,
        steps: int | None = None,
        driver: Driver | None = None,
    ) -> Rollout:
        """Plan and move one robot, closed loop, from its position until the episode ends.

        An environment that was never reset is reset with `seed` first.

        Args:
            env: an environment of this package, in any wrappers that leave actions alone, or one of
                your own that has what `legibility.envs.Environment` names.
            target: index of the intended goal; if not given, that of `path` or of the environment.
            legibility: ℓ in [−1, 1].
            seed: of the paths and actions drawn; None draws others each time.
            path: the path to follow instead of planning one; it must start at the robot.
            replan: whether to replan the rest of the motion when a push has taken the robot off
                its path by more than `tolerance`, or its goal was moved or, in an environment of
                your own, anything else in the scene: it sets out in the direction of motion, and ℓ
                is that of the whole. Without it the robot goes back to the path.
            tolerance: [m]; the largest action's length if not given.
            observer, exact, refine, max_detour, num_candidates, guidance, steps: see `plan`.
            driver: moves the robot instead of stage 2.

        Raises:
            InvalidInputError: an argument is out of its range or does not fit the environment.
            CheckpointError: the model has no stage 2.
        """
        if is_vector(env):
            raise InvalidInputError("env holds several robots: use execute_many")
        (rollout,) = self.execute_many(
            env, None if target is None else [target], legibility,
            seed=seed, paths=None if path is None else [path], replan=replan, tolerance=tolerance,
            observer=observer, exact=exact, refine=refine, max_detour=max_detour,
            num_candidates=num_candidates, guidance=guidance, steps=steps, driver=driver,
        )  # fmt: skip
        return rollout

    @np.errstate(under="ignore")
    def execute_many(
        self,
        env: Any,
        targets: int | Sequence[int] | None = None,
        legibility: ArrayLike = 1.0,
        *,
        seed: int | None = 0,
        paths: Sequence[Path] | None = None,
        replan: bool = True,
        tolerance: float | None = None,
        observer: Observer | None = None,
        exact: bool = False,
        refine: bool = True,
        max_detour: float | None = None,
        num_candidates: int = 1,
        guidance: float | None = None,
        steps: int | None = None,
        driver: Driver | None = None,
    ) -> list[Rollout]:
        """`execute` for the `B` robots of a vector, which are planned and moved together.

        Args:
            env: a vector of environments (`gymnasium.make_vec`).
            targets: index of the intended goal, one for all or `(B,)`; if not given, those of
                `paths` or of the environments.
            legibility: ℓ in [−1, 1], one for all or `(B,)`.
            paths: `B` paths to follow instead of planning; they must start at the robots.
            seed, replan, tolerance, driver: see `execute`.
            observer, exact, refine, max_detour, num_candidates, guidance, steps: see `plan`.
        """
        seed = seed_or_entropy("seed", seed)
        driver, sampling = self._driver(driver), Sampling(guidance, steps).checked(self.config)
        max_detour = _detour(max_detour)
        fleet = fleet_of(env, seed)
        self._check_fleet(fleet)
        tolerance = fleet.limit if tolerance is None else positive("tolerance", tolerance)
        levels = levels_for_each(legibility, fleet.size)
        if paths is not None:
            types = [type(path) for path in paths] if isinstance(paths, Sequence) else type(paths)
            if types != [Path] * fleet.size:
                raise InvalidInputError(
                    f"paths must be a legibility.Path for each of {fleet.size} robots, got {types}"
                )
            targets = [path.target for path in paths] if targets is None else targets
        if targets is not None:
            fleet.set_targets(for_each("targets", targets, fleet.size))

        def plan(rows: list[int], seed: int) -> list[Path]:
            scenes, positions = fleet.scenes, fleet.positions
            return self.plan_many(
                [scenes[row].starting_at(positions[row]) for row in rows],
                fleet.targets[rows].tolist(), levels[rows],
                seed=seed, observer=observer, exact=exact, refine=refine, max_detour=max_detour,
                num_candidates=num_candidates, guidance=guidance, steps=steps,
            )  # fmt: skip

        def plan_rest(row: int, rest: Rest) -> Path:
            if not refine:
                (path,) = plan([row], seed)
                return path
            parts = continuation(
                rest, self.sampler, seed, sampling, exact=exact,
                max_detour=max_detour, accepts=partial(keeps_off, arms[row]),
            )  # fmt: skip
            return freed(arms[row], finished(parts))

        arms = fleet.arms
        if paths is None:
            paths = paths_off_obstacles(arms, plan, seed, max_detour)
        return follow(fleet, list(paths), driver, plan_rest if replan else None, tolerance)

    def controller(
        self,
        scene: Scene,
        target: int = 0,
        legibility: float = 1.0,
        *,
        dt: float | None = None,
        max_displacement: float | None = None,
        tolerance: float | None = None,
        budget: float | None = 0.002,
        seed: int | None = 0,
        observer: Observer | None = None,
        exact: bool = False,
        num_candidates: int = 1,
        max_detour: float | None = None,
        guidance: float | None = None,
        steps: int | None = None,
        driver: Driver | None = None,
        arm: Arm | str | None = None,
        frame: str = "world",
    ) -> Controller:
        """A controller for a robot's own loop; the first path is planned here.

        Args:
            scene: the scene; its start is where the robot is.
            target: index of the intended goal.
            legibility: ℓ in [−1, 1], of the whole motion.
            dt: duration of a step of the loop [s]; that of the model's environment if not given.
            max_displacement: largest displacement of a step along each axis [m]; if not given, as
                fast as the robots in training.
            tolerance: distance from the path [m] beyond which the rest is replanned;
                `max_displacement` if not given.
            budget: time [s] that a step may spend on planning; None is no limit. The part that is
                begun in this time is finished: a few milliseconds more.
            seed: of the paths drawn; None draws others each time.
            observer, exact, num_candidates, max_detour, guidance, steps, arm: see `plan`; the
                candidates are of the first path.
            driver: moves the robot instead of stage 2.
            frame: of positions that come in and displacements that go out, world or the arm's base;
                scenes are always in the world, see `Arm.in_world`.

        Raises:
            InvalidInputError: an argument is out of its range or does not fit the others.
            CheckpointError: the model has no stage 2.
        """
        own = vector_type(None, self.config.dim)
        own_dt, seed = 1 / own.metadata["render_fps"], seed_or_entropy("seed", seed)
        duration = own_dt if dt is None else positive("dt", dt)
        limit = own.max_displacement * (duration / own_dt)
        if max_displacement is not None:
            limit = positive("max_displacement", max_displacement)
        body = checked_arm(arm, self.config.dim)
        path = self.plan(
            scene, target, legibility, seed=seed, observer=observer, exact=exact, arm=body,
            num_candidates=num_candidates, max_detour=max_detour, guidance=guidance, steps=steps,
        )  # fmt: skip
        if path.legibility.ndim:
            raise InvalidInputError(f"legibility must be one number, got {legibility!r}")
        return Controller(
            path, self.sampler, self._driver(driver), limit=limit, dt=duration, seed=seed,
            exact=exact, max_detour=_detour(max_detour), arm=body, frame=frame_name(frame, body),
            tolerance=limit if tolerance is None else positive("tolerance", tolerance),
            budget=np.inf if budget is None else bounded("budget", budget, 0),
            sampling=Sampling(guidance, steps).checked(self.config),
        )  # fmt: skip

    def _driver(self, driver: Driver | None) -> Driver:
        """The driver given, or stage 2."""
        if driver is not None:
            if not callable(driver):
                raise InvalidInputError(
                    f"driver must be a legibility.drivers.Driver, got {driver!r}"
                )
            return driver
        self.stage_2()
        assert self._policy is not None
        return Policy(self._policy)

    def _check_scene(self, scene: Scene) -> None:
        if not isinstance(scene, Scene):
            raise InvalidSceneError(f"scene must be a legibility.Scene, got {type(scene).__name__}")
        if scene.dim != self.config.dim:
            raise InvalidSceneError(
                f"the model {self.name} plans in {self.config.dim}D, the scene is {scene.dim}D"
            )

    def _check_fleet(self, fleet: Fleet) -> None:
        dim = fleet.workspace.shape[1]
        if dim != self.config.dim:
            raise InvalidInputError(
                f"the model {self.name} moves in {self.config.dim}D, the environment is {dim}D"
            )
        ours = type(fleet) is Fleet  # in an environment of your own a robot may take other steps
        if ours and self.path_policy is not None and fleet.limit != self.path_policy.config.limit:
            raise InvalidInputError(
                f"the model {self.name} acts within {self.path_policy.config.limit} m a step, "
                f"the environment's limit is {fleet.limit} m"
            )


def _detour(max_detour: float | None) -> float | None:
    """The detour that is allowed, checked."""
    return None if max_detour is None else bounded("max_detour", max_detour, 1)
