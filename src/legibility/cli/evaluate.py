"""`legibility evaluate …`."""

import importlib
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from tyro.conf import arg

from ..errors import InvalidInputError
from ..evaluation import configuration
from ..scene import Scene
from ..training.configuration import DEVICES
from . import output
from .options import MODEL, MODELS, InputFile, ModelName, OutputFile, Workers, choices, flags, made
from .report import result_figure

_Dial = Annotated[Any, arg(constructor=flags(configuration.DialConfig))]
_Eyes = Annotated[Any, arg(constructor=flags(configuration.EyesConfig))]
_Optimum = Annotated[Any, arg(constructor=flags(configuration.OptimumConfig, "regime"))]
_Planning = Annotated[Any, arg(constructor=flags(configuration.PlanningConfig))]
_Execution = Annotated[Any, arg(constructor=flags(configuration.ExecutionConfig))]
_Table1 = Annotated[Any, arg(constructor=flags(configuration.Table1Config))]
_Unseen = Annotated[Any, arg(constructor=flags(configuration.UnseenConfig))]
_Spectrum = Annotated[Any, arg(constructor=flags(configuration.SpectrumConfig))]
_Controller = Annotated[Any, arg(constructor=flags(configuration.ControllerConfig))]
_Timing = Annotated[Any, arg(constructor=flags(configuration.TimingConfig))]
_External = Annotated[Any, arg(constructor=flags(configuration.ExternalConfig))]
_SingleScene = Annotated[Any, arg(constructor=flags(configuration.SingleSceneConfig))]
_Ablations = Annotated[Any, arg(constructor=flags(configuration.AblationsConfig))]
_MODEL = "name of shipped weights, or a folder"
_Model = Annotated[str, choices(MODELS.values(), "DIR", help=_MODEL)]
_DiffusionPolicy = Annotated[
    str | None, choices(["diffusion-policy-2d", "diffusion-policy-panda"], "DIR")
]
_LegibilityDiffuser = Annotated[
    str | None, choices(["legibility-diffuser-2d", "legibility-diffuser-panda"], "DIR")
]
_Scene = Annotated[InputFile, arg(help="scene of your trajectories")]
_Trajectories = Annotated[InputFile, arg(help="your motions to the target, a file as of `score`")]
_Json = Annotated[
    OutputFile, arg(help="the result with its command, seed, settings and weights, as JSON")
]
_Figure = Annotated[OutputFile, arg(help="a picture of the result, .png, .pdf or .svg")]


@dataclass(frozen=True)
class Contestants:
    """Weights, each a name or a folder; if not given, those of the environment's dimension.

    Attributes:
        model: the modulator.
        diffusion_policy: the baseline Diffusion Policy.
        legibility_diffuser: the baseline Legibility Diffuser.
    """

    model: ModelName = None
    diffusion_policy: _DiffusionPolicy = None
    legibility_diffuser: _LegibilityDiffuser = None


def dial(
    evaluation: _Dial,
    workers: Workers,
    model: _Model = MODEL,
    json: _Json = None,
    figure: _Figure = None,
) -> None:
    """Measure achieved against asked legibility on held-out scenes.

    Examples:
        legibility evaluate dial --scenes 10 --seed 7 --json out/dial.json --figure out/dial.png
        legibility evaluate dial --model panda-block-reach --goals 2..4 --regime all --workers 4
    """
    _evaluate("dial", configuration.DialConfig, evaluation, model, json, figure, workers)


def eyes(evaluation: _Eyes, workers: Workers, model: _Model = MODEL, json: _Json = None) -> None:
    """Turn the dial for one observer, and measure what every other one sees of it.

    Examples:
        legibility evaluate eyes --scenes 10 --json out/eyes.json
        legibility evaluate eyes --scenes 10 --regime obstacles --exact
    """
    _evaluate("eyes", configuration.EyesConfig, evaluation, model, json, workers=workers)


def planning(
    evaluation: _Planning,
    workers: Workers,
    model: _Model = MODEL,
    json: _Json = None,
    figure: _Figure = None,
) -> None:
    """Measure the error of ℓ against the time to plan, beside random search and archives.

    In free space and past obstacles, in scenes never seen before and once planned in. Leave the
    machine alone meanwhile.

    Examples:
        legibility evaluate planning --scenes 10 --figure out/planning.png
        legibility evaluate planning --scenes 10 --search 64 256 --json out/planning.json
    """
    settings = configuration.PlanningConfig
    _evaluate("planning", settings, evaluation, model, json, figure, workers)


def optimum(
    evaluation: _Optimum, workers: Workers, model: _Model = MODEL, json: _Json = None
) -> None:
    """Compare plans at -1 and 1 with the best motions of their length, and with a certified bound.

    The best motion is what an optimiser finds from many starts; the bound needs no optimiser.

    Examples:
        legibility evaluate optimum --scenes 10 --json out/optimum.json
        legibility evaluate optimum --scenes 10 --starts 4 --exact --workers 4
    """
    settings = configuration.OptimumConfig
    _evaluate("optimum", settings, evaluation, model, json, workers=workers)


def external(
    evaluation: _External,
    workers: Workers,
    scene: _Scene = None,
    target: Annotated[int, arg(help="with --scene, index of the intended goal")] = 0,
    trajectories: _Trajectories = None,
    model: _Model = MODEL,
    json: _Json = None,
) -> None:
    """Rate the motions of all planners, and your own, by other people's definitions.

    Dragan's legibility, confidence, detachment and L_d, and the most legible of the motions that
    are short enough or keep clear. In random scenes, or with --trajectories your motions in --scene
    beside ours.

    Examples:
        legibility evaluate external --scenes 10 --regime dragan --json out/external.json
        legibility evaluate external --scene examples/paper.yaml \
            --trajectories examples/trajectories.csv
    """
    given = None
    if (scene is None) != (trajectories is None):
        raise InvalidInputError("--scene and --trajectories belong together")
    if scene is not None and trajectories is not None:
        plain, own = configuration.ExternalConfig(), made(configuration.ExternalConfig, evaluation)
        for name in ("scenes", "regime", "goals"):
            if getattr(own, name) != getattr(plain, name):
                raise InvalidInputError(f"--{name} is of random scenes, not of --scene")
        given = _your_motions(Scene.load(scene), target, trajectories)
    elif target:
        raise InvalidInputError("--target belongs to --scene")
    settings = configuration.ExternalConfig
    _evaluate("external", settings, evaluation, model, json, workers=workers, given=given)


def controller(
    evaluation: _Controller, workers: Workers, model: _Model = MODEL, json: _Json = None
) -> None:
    """Disturb motions once on their way, and see how the controller goes on.

    It is asked to replan, the robot is pushed, the target moves, or an obstacle appears; beside it,
    a new plan from there. Times are those of this machine: use one worker.

    Examples:
        legibility evaluate controller --scenes 10 --json out/controller.json
        legibility evaluate controller --scenes 10 --regime obstacles --backend onnx
    """
    settings = configuration.ControllerConfig
    _evaluate("controller", settings, evaluation, model, json, workers=workers)


def timing(
    evaluation: _Timing, workers: Workers, model: _Model = MODEL, json: _Json = None
) -> None:
    """Check that timed motions keep their limits, and what they cost.

    By finite differences at 1 kHz, as a controller sees them, of a point or of any arm.

    Examples:
        legibility evaluate timing --scenes 10 --json out/timing.json
        legibility evaluate timing --model panda-block-reach --limits fr3 --goals 2..4 --workers 4
    """
    settings = configuration.TimingConfig
    _evaluate("timing", settings, evaluation, model, json, workers=workers)


def _your_motions(scene: Scene, target: int, file: Path) -> tuple[Scene, int, dict[str, Any]]:
    """A user's motions from the start of a scene to a target."""
    from ..data.recordings import read_recordings
    from ..evaluation.scoring import check_inside

    recordings = read_recordings(file, scene.dim, output.note)
    for recording in recordings:
        check_inside(recording, scene)
    curves = {recording.name: recording.motion for recording in recordings}
    for name, curve in curves.items():
        for end, place, point in (
            ("start", scene.start, curve[0]), ("target", scene.target(target), curve[-1])
        ):  # fmt: skip
            if (gap := float(np.linalg.norm(point - place))) > _ENDS * scene.diagonal:
                raise InvalidInputError(
                    f"{file}: trajectory {name} is {gap:.3g} m off the {end}, at most "
                    f"{_ENDS * scene.diagonal:.3g} m are allowed"
                )
    return scene, target, curves


def execution(
    evaluation: _Execution, workers: Workers, model: _Model = MODEL, json: _Json = None
) -> None:
    """Measure executed motions: success, dial, deviation and safety, and the value of stage 2.

    Stage 2, also pushed and with a moving target, is compared with stage 2 without the path, the
    path's displacements in open loop, and the feedback controller of the demonstrations. All share
    scenes, plans and hidden gains.

    Examples:
        legibility evaluate execution --scenes 10 --rollouts 100 --json out/execution.json
        legibility evaluate execution --model panda-block-reach --scenes 5 --rollouts 15
    """
    settings = configuration.ExecutionConfig
    _evaluate("execution", settings, evaluation, model, json, workers=workers)


def table1(
    evaluation: _Table1, workers: Workers, contestants: Contestants, json: _Json = None
) -> None:
    """The paper's Table I: the most legible motions of every method, executed, with statistics.

    Its scene has two goals, R and G. The modulator, with one path and as the best of 64, is
    compared with Diffusion Policy, Legibility Diffuser, the straight line, random search in the
    same and in ten times the time, and the archive's most legible trajectory.

    Examples:
        legibility evaluate table1 --rollouts 10 --json out/table1.json
        legibility evaluate table1 --env panda --rollouts 10 --workers 4
    """
    settings, model = configuration.Table1Config, contestants.model
    _evaluate("table1", settings, evaluation, model, json, None, workers, contestants)


def unseen(
    evaluation: _Unseen, workers: Workers, contestants: Contestants, json: _Json = None
) -> None:
    """The methods of table1 on held-out scenes, relative to each scene's oracle.

    Examples:
        legibility evaluate unseen --scenes 10 --json out/unseen.json
        legibility evaluate unseen --env panda --scenes 10 --rollouts 2 --levels 6
    """
    settings, model = configuration.UnseenConfig, contestants.model
    _evaluate("unseen", settings, evaluation, model, json, None, workers, contestants)


def spectrum(
    evaluation: _Spectrum,
    model: Annotated[
        str | None,
        choices(MODELS.values(), "DIR", help=f"{_MODEL}; if not given, those of the environment"),
    ] = None,
    json: _Json = None,
    figure: _Figure = None,
) -> None:
    """The paper's figure 3: executed motions over the whole dial in the scene of Table I.

    Examples:
        legibility evaluate spectrum --levels 5 --rollouts 3 --figure out/spectrum.png
        legibility evaluate spectrum --env panda --rollouts 10 --json out/spectrum.json
    """
    _evaluate("spectrum", configuration.SpectrumConfig, evaluation, model, json, figure)


def ablations(
    evaluation: _Ablations,
    data: Annotated[Path, arg(metavar="DIR", help="dataset; small runs use its first scenes")],
    out: Annotated[Path, arg(metavar="DIR", help="folder of the small runs")],
    model: _Model = MODEL,
    workers: Annotated[int, arg(help="processes that make data and measure")] = 1,
    device: Annotated[
        str | None, choices(DEVICES, "cuda:N", help="if not given, a GPU where there is one")
    ] = None,
    json: _Json = None,
) -> None:
    """Measure what each part of stage 1 is worth, by small runs that lack it.

    They are trained in OUT: the reference, with other samplers, its student, without each loss,
    without the field, on rank labels, on data of any length, and on other numbers of scenes.
    Interrupted, the same command resumes.

    Examples:
        legibility evaluate ablations --data runs/data --out runs/parts --json out/parts.json
        legibility evaluate ablations --data runs/data --out runs/quick --training-steps 200
    """
    output.check_file(json, "JSON file")
    settings = made(configuration.AblationsConfig, evaluation)
    output.check_folder(out, "small runs")
    from ..data.dataset import Dataset
    from ..evaluation.ablations import evaluate_ablations

    used, dataset = output.model_record(model, "path"), Dataset.load(data)
    with output.progress_bar("scenes and training steps") as progress:
        result = evaluate_ablations(
            model, dataset, out, settings, workers=workers, device=device, progress=progress
        )
    _write("ablations", settings, result, json, model=used)


def single_scene(
    evaluation: _SingleScene,
    workers: Workers,
    out: Annotated[Path, arg(metavar="DIR", help="folder of the data and the trainings")],
    json: _Json = None,
) -> None:
    """Table I with methods that learned in its scene alone, from the same demonstrations.

    Diffusion Policy, Legibility Diffuser and both stages of the modulator are trained in OUT and
    tuned toward either target, then executed. Interrupted, the same command resumes.

    Examples:
        legibility evaluate single-scene --out runs/single-scene --json out/single-scene.json
        legibility evaluate single-scene --env panda --rollouts 20 --out runs/single-panda
    """
    output.check_file(json, "JSON file")
    settings = made(configuration.SingleSceneConfig, evaluation)
    output.check_folder(out, "trainings")
    from ..evaluation.single_scene import evaluate_single_scene

    with output.progress_bar("training steps and rollouts") as progress:
        result = evaluate_single_scene(out, settings, **vars(workers), progress=progress)
    _write("single-scene", settings, result, json)


_ENDS = 0.01

_MODULES = {"table1": "comparison", "unseen": "comparison"}
"""The modules of evaluations that have another name."""

_PLANS = ("dial", "eyes", "planning", "optimum", "external", "timing")
"""Evaluations of scenes, by stage 1 alone unless the loop is closed."""


def _evaluate(
    kind: str,
    config: type[Any],
    flags: Any,
    model: str | None,
    json: Path | None,
    figure: Path | None = None,
    workers: Workers | None = None,
    contestants: Contestants | None = None,
    **more: Any,
) -> None:
    """Check everything, evaluate under a progress bar; write, print and draw the result."""
    output.check_figure(figure)
    output.check_file(json, "JSON file")
    settings = made(config, flags)
    module = importlib.import_module(f"legibility.evaluation.{_MODULES.get(kind, kind)}")
    from ..baselines.pretrained import baseline_names, load_baselines
    from ..envs import environment_dim
    from ..modulator import Modulator

    options: dict[str, Any] = more | (vars(workers) if workers else {})
    weights: dict[str, Any] = {}
    if contestants:
        names = {
            method: getattr(contestants, method.replace(" ", "_")) or shipped
            for method, shipped in baseline_names(environment_dim(settings.env)).items()
        }
        options["policies"] = load_baselines(names)
        weights["baselines"] = [output.model_record(name) for name in names.values()]
    name = model or MODELS[environment_dim(settings.env)]
    plans = kind in _PLANS and not getattr(settings, "closed_loop", False)
    backend = getattr(settings, "backend", "torch")
    modulator = Modulator.from_pretrained(name, backend=backend)
    weights["model"] = output.model_record(name, "path" if plans else "*")
    items = "scenes" if kind in (*_PLANS, "controller") else "rollouts"
    with output.progress_bar(items) as progress:
        evaluate = getattr(module, f"evaluate_{kind}")
        result = evaluate(modulator, config=settings, **options, progress=progress)
    _write(kind, settings, result, json, **weights)
    if figure is not None:
        result_figure(kind, result, figure)


def _write(
    kind: str, settings: Any, result: dict[str, Any], json: Path | None, **weights: Any
) -> None:
    """Write and print a result of a kind that the report knows."""
    from ..report.results import KINDS

    document = {"seed": settings.seed, "config": asdict(settings), "result": result}
    output.write_report(json, **document, **weights)
    output.show(*KINDS[kind].section(document))
