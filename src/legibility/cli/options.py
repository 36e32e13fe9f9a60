"""Arguments that verbs share, beyond tyro's own types."""

import dataclasses
import inspect
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar, get_origin, get_type_hints

import numpy as np
from tyro.conf import Positional, arg

from ..checks import FRAMES, Array, frame_name, legibility_levels, positive, random_seed
from ..errors import InvalidInputError, InvalidSceneError
from ..files import read_document
from ..intent.observer import OBSERVERS, Observer, observer_of
from ..robots import ARM_NAMES
from ..robots.limits import LIMITS
from ..scene import Scene
from ..training.configuration import DEVICES, PRECISIONS
from . import output

if TYPE_CHECKING:
    from ..motion.path import Path as Path_
    from ..motion.timed import Motion
    from ..robots.arm import Arm

MODEL = "block-reach-2d"
MODELS = {2: MODEL, 3: "panda-block-reach"}
"""The modulator's weights by dimension."""


def choices(allowed: Iterable[Any], *more: str, count: str = "", help: str | None = None) -> Any:
    """How the help shows an option of a fixed set, and perhaps `more`: `{dragan,paper,FILE}`.

    It is for display: other values are refused by whoever checks the value, in our words. `count`
    is ` ...` for several values.
    """
    shown = ",".join(map(str, (*allowed, *more)))
    return arg(metavar=f"{{{shown}}}{count}", help=help, help_behavior_hint=_default)


def _default(value: str) -> str:
    return "" if value in ("", "None") else f"(default: {value})"


SceneFile = Annotated[Positional[Path], arg(metavar="SCENE", help_behavior_hint="")]
InputFile = OutputFile = Annotated[Path | None, arg(metavar="FILE", help_behavior_hint="")]
Folder = Annotated[Path | None, arg(metavar="DIR", help_behavior_hint="")]
OptionalInt = Annotated[int | None, arg(metavar="INT", help_behavior_hint="")]
OptionalFloat = Annotated[float | None, arg(metavar="FLOAT", help_behavior_hint="")]
OptionalText = Annotated[str | None, arg(metavar="STR", help_behavior_hint="")]
DeviceName = Annotated[str | None, choices(DEVICES, "cuda:N")]
ModelName = Annotated[str | None, choices(MODELS.values(), "DIR")]

_DOCUMENTS = (".yaml", ".yml", ".json")

_FLAG_TYPES: dict[Any, Any] = {
    int | None: OptionalInt,
    float | None: OptionalFloat,
    str | None: OptionalText,
    tuple[int, int]: Annotated[str, arg(metavar="LOW..HIGH")],
}
"""Types of flags by the types of settings, where they differ."""

Settings = TypeVar("Settings")


@dataclasses.dataclass(frozen=True)
class Workers:
    """Processes that do the work; the result is the same for any number of them.

    Attributes:
        workers: processes on this machine.
        cluster: tcp://HOST:PORT, a Dask scheduler whose workers do the work instead; or local, a
            Dask cluster of --workers processes on this machine.
    """

    workers: int = 1
    cluster: Annotated[str | None, choices(["local"], "tcp://HOST:PORT")] = None


@dataclasses.dataclass(frozen=True)
class Where:
    """Device and precision of a training.

    Attributes:
        device: of the training; if not given, a GPU where there is one.
        precision: of the network's products, no (float32), bf16 or fp16; if not given, that of
            `accelerate launch`, or no.
    """

    device: DeviceName = None
    precision: Annotated[str | None, choices(PRECISIONS)] = None


@dataclasses.dataclass(frozen=True)
class Place:
    """Scene, target and observer.

    Attributes:
        scene: a file, .yaml or .json, with the keys start and goals, and optionally workspace,
            obstacles, goal_radius, clearance and observer.
        target: index of the intended goal, from 0.
        observer: who reads the motions, by name or a .yaml or .json file; if not given, that of the
            scene's file, or dragan.
    """

    scene: SceneFile
    target: int = 0
    observer: Annotated[str | None, choices(OBSERVERS, "FILE")] = None

    def situation(self) -> tuple[Scene, Observer]:
        """The scene and the observer, once the arguments are checked."""
        scene, observer = read_scene(self.scene, self.observer)
        scene.check_target(self.target)
        return scene, observer


@dataclasses.dataclass(frozen=True)
class Motions(Place):
    """Motions to plan.

    Attributes:
        legibility: from -1 (most ambiguous) to 1 (most legible); -1:1:9 gives nine equal steps.
        model: name of shipped weights, or a folder; if not given, those of the scene's dimension.
        seed: of every random draw, of paths and in execution.
        max_detour: longest path over the shortest feasible one; a level that takes a longer one is
            met as nearly as it allows.
        candidates: paths drawn for each level, of which the nearest to it is kept; at -1 and 1 the
            most extreme one.
        exact: meet each level by the scene's archive, which is built once, and not by ready-made
            curves.
        refine: move what is drawn out of contact and to its level.
    """

    legibility: Annotated[tuple[str, ...], arg(metavar="LEVEL ...")] = ("-1", "0", "1")
    model: ModelName = None
    seed: int = 0
    max_detour: OptionalFloat = None
    candidates: int = 1
    exact: bool = False
    refine: bool = True

    def read(self) -> tuple[Scene, Observer, Array, str]:
        """The scene, the observer, the levels `(B,)` and the weights, once all is checked."""
        asked = levels(self.legibility)
        random_seed("seed", self.seed)
        scene, observer = self.situation()
        return scene, observer, asked, self.model or MODELS[scene.dim]

    def options(self, observer: Observer) -> dict[str, Any]:
        """Keywords of `Modulator.plan` and `execute_many`."""
        return {
            "observer": observer,
            "exact": self.exact,
            "refine": self.refine,
            "max_detour": self.max_detour,
            "num_candidates": self.candidates,
        }


@dataclasses.dataclass(frozen=True)
class Timed:
    """Motions for a robot, over time.

    Attributes:
        out: file of the timed motion: .csv, .json or .mcap, a bag of ROS 2 (extra ros). Of several
            levels there is a file each, with the level in its name.
        rate: instants in a second.
        limits: what the motion keeps; if not given, the arm's own, or point.
        arm: that moves, by its name or a .yaml or .json file.
        frame: in which positions are written.
        max_duration: longest duration [s] that is accepted.
        profile: figure of speed, limits and belief over time, .png, .pdf or .svg.
    """

    out: OutputFile = None
    rate: float = 100.0
    limits: Annotated[str | None, choices(LIMITS)] = None
    arm: Annotated[str | None, choices(ARM_NAMES, "FILE")] = None
    frame: Annotated[str, choices(FRAMES)] = "world"
    max_duration: OptionalFloat = None
    profile: OutputFile = None

    def files(self, asked: Array, dim: int, others: Sequence[Path | None]) -> list[Path]:
        """The file of each level, once all is checked; none if no motion is to be written.

        `others` are the files that hold something else.
        """
        from ..motion.timed import mover

        if self.out is None:
            for field in dataclasses.fields(self):
                if getattr(self, field.name) != field.default:
                    flag = field.name.replace("_", "-")
                    raise InvalidInputError(f"--{flag} needs --out, the file of a timed motion")
            return []
        positive("rate", self.rate)
        if self.max_duration is not None:
            positive("max_duration", self.max_duration)
        _, arm = mover(self.limits, self.arm)
        if arm is not None and dim != 3:
            raise InvalidInputError(f"an arm moves in 3-D, the scene is {dim}-D")
        frame_name(self.frame, arm)
        if self.profile is not None:
            from ..figures.motion import check_number

            output.check_figure(self.profile)
            check_number(len(asked))
        return motion_files(self.out, asked, (*others, self.profile))

    def body(self) -> "Arm | None":
        """The arm that moves, if one does; its links keep off obstacles on planned paths."""
        from ..motion.timed import mover

        return None if self.out is None else mover(self.limits, self.arm)[1]

    def motions(self, path: "Path_") -> "list[Motion]":
        """The timed motion of each level of a path."""
        from ..motion.timed import mover

        limits, arm = mover(self.limits, self.arm)
        timed = [
            path[i].timed(limits, self.rate, arm=arm, max_duration=self.max_duration)
            for i in range(len(path))
        ]
        return [motion.in_frame(self.frame) for motion in timed]


def motion_files(out: Path, asked: Array, others: Sequence[Path | None]) -> list[Path]:
    """The file of the motion of each level, once it is checked that all can be written.

    `others` are the files that hold something else.
    """
    from ..robots import formats

    files = [out]
    if len(asked) > 1:
        files = [out.with_name(f"{out.with_suffix('').name}_{x:g}{out.suffix}") for x in asked]
    for number, file in enumerate(files):
        if file in [*files[:number], *others]:
            raise InvalidInputError(f"two outputs have the file {file}")
        output.check_file(file, "motion")
        formats.check(file)
    return files


def read_scene(file: Path, observer: str | None = None) -> tuple[Scene, Observer]:
    """The scene of a file, and who watches: `observer`, that under the file's key, or Dragan's.

    Raises:
        InvalidSceneError, InvalidInputError: the file or the observer is unreadable or wrong.
    """
    if file.suffix.lower() not in _DOCUMENTS:
        raise InvalidSceneError(f"a scene file ends in .yaml, .yml or .json, got {file}")
    content = read_document(file, "scene file", InvalidSceneError)
    own = content.pop("observer", None) if isinstance(content, dict) else None
    try:
        scene = Scene.from_dict(content)
        if observer is None:
            return scene, _fitting(observer_of(own, scene.dim, file.parent), scene)
    except (InvalidSceneError, InvalidInputError) as cause:
        raise type(cause)(f"{file}: {cause}") from cause
    return scene, _fitting(observer_of(observer, scene.dim), scene)


def _fitting(observer: Observer, scene: Scene) -> Observer:
    """The observer; raises if they do not fit the scene."""
    observer.field(scene)
    return observer


def levels(entries: Sequence[str]) -> Array:
    """Levels of legibility; an entry is a number or LOW:HIGH:COUNT, equal steps."""
    values: list[float] = []
    for entry in entries:
        try:
            first, *rest = entry.split(":")
            last, steps = rest or (first, "1")
            if not 1 <= int(steps) <= 100_000:
                raise ValueError
            ends = float(first), float(last)
        except ValueError:
            raise InvalidInputError(
                f"legibility must be numbers or LOW:HIGH:COUNT, got {entry!r}"
            ) from None
        low, high = legibility_levels(ends)
        values += np.round(np.linspace(low, high, int(steps)), 12).tolist()
    if not values:
        raise InvalidInputError("legibility must be at least one number, got none")
    return np.array(values) + 0.0  # −0 becomes 0


def span(name: str, text: str) -> tuple[int, int]:
    """A range of whole numbers: `LOW..HIGH`, or one number for both."""
    match = re.fullmatch(r"([0-9]{1,9})(?:\.\.([0-9]{1,9}))?", text.strip(), re.ASCII)
    if match is None:
        raise InvalidInputError(f"{name} must be a number or LOW..HIGH, got {text!r}")
    low, high = int(match[1]), int(match[2] or match[1])
    if low > high:
        raise InvalidInputError(f"{name} must rise from LOW to HIGH, got {text!r}")
    return low, high


def flags(settings: type, *omitted: str, **defaults: Any) -> Any:
    """The fields of a dataclass but the `omitted` ones as flags, with its docstring as their help.

    `defaults` replace its own. Flags are not checked; `made` does that, so that errors are those of
    the dataclass. A range is a text, see `span`.
    """
    types = get_type_hints(settings)
    fields: list[Any] = []
    for field in dataclasses.fields(settings):
        default: Any = defaults.get(field.name, field.default)
        if types[field.name] == tuple[int, int]:
            default = "..".join(map(str, default))
        if field.name not in omitted:
            flag = _flag_type(field, types[field.name])
            fields.append((field.name, flag, dataclasses.field(default=default)))
    namespace = {"__doc__": _documentation(settings)}
    return dataclasses.make_dataclass(settings.__name__, fields, kw_only=True, namespace=namespace)


def _flag_type(field: Any, kind: Any) -> Any:
    """The type of the flag of a field of this `kind`."""
    if "allowed" in field.metadata:
        more = filter(None, [field.metadata["more"]])
        several = " ..." if get_origin(kind) is tuple else ""
        return Annotated[kind, choices(field.metadata["allowed"], *more, count=several)]
    return _FLAG_TYPES.get(kind, kind)


def _documentation(settings: type) -> str:
    """The docstring of a dataclass, with the attributes of its bases."""
    text = inspect.cleandoc(settings.__doc__ or "")
    for base in settings.__mro__[1:]:
        if dataclasses.is_dataclass(base):
            text += "\n" + inspect.cleandoc(base.__doc__ or "").partition("Attributes:\n")[2]
    return text


def made(settings: type[Settings], parsed: Any, **rest: Any) -> Settings:
    """The dataclass `settings` of its `parsed` flags and the `rest` of its fields."""
    types = get_type_hints(settings)
    values: dict[str, Any] = {
        name: span(name, value) if types[name] == tuple[int, int] else value
        for name, value in vars(parsed).items()
    }
    return settings(**values, **rest)
