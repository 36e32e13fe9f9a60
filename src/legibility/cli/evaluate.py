"""`legibility evaluate …`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tyro.conf import arg

from ..evaluation.configuration import (
    AblationsConfig,
    DialConfig,
    ExecutionConfig,
    SpectrumConfig,
    Table1Config,
    UnseenConfig,
)
from .options import MODEL, MODELS, OptionalText, OutputFile, Workers, flags, made
from .output import (
    check_figure,
    check_file,
    check_folder,
    model_record,
    progress_bar,
    show,
    write_report,
)

if TYPE_CHECKING:
    from ..report.table import Part

_Dial = flags(DialConfig)
_Execution = flags(ExecutionConfig)
_Table1 = flags(Table1Config)
_Unseen = flags(UnseenConfig)
_Spectrum = flags(SpectrumConfig)
_Ablations = flags(AblationsConfig)

Model = Annotated[str, arg(help="name of shipped weights, or a folder")]
RobotModel = Annotated[
    OptionalText,
    arg(help="name of shipped weights, or a folder; those of the environment if not given"),
]


@dataclass(frozen=True)
class Report:
    """Output files.

    Attributes:
        json: the result with its command, seed, settings and weights, as JSON.
    """

    json: OutputFile = None

    def __post_init__(self) -> None:
        check_file(self.json, "JSON file")

    def write(
        self,
        section: Callable[[dict[str, Any]], list[Part]],
        settings: Any,
        result: dict[str, Any],
        model: dict[str, str],
        baselines: list[dict[str, str]] | None = None,
    ) -> None:
        """Write the JSON file, if any, and print the `section` of the result."""
        document: dict[str, Any] = {
            "seed": settings.seed, "config": asdict(settings), "result": result
        }  # fmt: skip
        write_report(self.json, model=model, baselines=baselines, **document)
        show(*section(document))


@dataclass(frozen=True)
class DrawnReport(Report):
    """Output files.

    Attributes:
        json: the result with its command, seed, settings and weights, as JSON.
        figure: a picture of the result, .png, .pdf or .svg.
    """

    figure: OutputFile = None

    def __post_init__(self) -> None:
        super().__post_init__()
        check_figure(self.figure)


@dataclass(frozen=True)
class Contestants:
    """Weights, each a name or a folder; those of the environment's dimension if not given.

    Attributes:
        model: the modulator.
        diffusion_policy: the baseline Diffusion Policy.
        legibility_diffuser: the baseline Legibility Diffuser.
    """

    model: OptionalText = None
    diffusion_policy: OptionalText = None
    legibility_diffuser: OptionalText = None


def dial(
    evaluation: Annotated[Any, arg(constructor=_Dial)],
    workers: Workers,
    output: DrawnReport,
    model: Model = MODEL,
) -> None:
    """Measure achieved against asked legibility on held-out scenes."""
    settings = made(DialConfig, evaluation)
    from ..evaluation.dial import evaluate_dial
    from ..modulator import Modulator
    from ..report.dial import dial_section

    modulator, used = Modulator.from_pretrained(model), model_record(model)
    with progress_bar("scenes") as progress:
        result = evaluate_dial(modulator, settings, **vars(workers), progress=progress)
    output.write(dial_section, settings, result, used)
    if output.figure is not None:
        from ..figures.dial import dial_figure

        dial_figure(result, output.figure)


def execution(
    evaluation: Annotated[Any, arg(constructor=_Execution)],
    workers: Workers,
    output: Report,
    model: Model = MODEL,
) -> None:
    """Measure executed motions: success, dial, deviation and safety, and the value of stage 2.

    Stage 2, also pushed and with a moving target, is compared with stage 2 without the path, the
    path's displacements in open loop, and the feedback controller of the demonstrations. All share
    scenes, plans and hidden gains.
    """
    settings = made(ExecutionConfig, evaluation)
    from ..evaluation.execution import evaluate_execution
    from ..modulator import Modulator
    from ..report.execution import execution_section

    modulator, used = Modulator.from_pretrained(model), model_record(model)
    with progress_bar("rollouts") as progress:
        result = evaluate_execution(modulator, settings, **vars(workers), progress=progress)
    output.write(execution_section, settings, result, used)


def table1(
    evaluation: Annotated[Any, arg(constructor=_Table1)],
    workers: Workers,
    contestants: Contestants,
    output: Report,
) -> None:
    """The paper's Table I: the most legible motions of every method, executed, with statistics.

    Its scene has two goals, R and G. The modulator, with one path and as the best of 64, is
    compared with Diffusion Policy, Legibility Diffuser, the straight line, random search in the
    same and in ten times the time, and the archive's most legible trajectory.
    """
    settings = made(Table1Config, evaluation)
    from ..evaluation.table1 import evaluate_table1
    from ..report.comparison import table1_section

    _compare(evaluate_table1, table1_section, settings, workers, contestants, output)


def unseen(
    evaluation: Annotated[Any, arg(constructor=_Unseen)],
    workers: Workers,
    contestants: Contestants,
    output: Report,
) -> None:
    """The methods of table1 on held-out scenes, relative to each scene's oracle."""
    settings = made(UnseenConfig, evaluation)
    from ..evaluation.unseen import evaluate_unseen
    from ..report.comparison import unseen_section

    _compare(evaluate_unseen, unseen_section, settings, workers, contestants, output)


def _compare(
    evaluate: Callable[..., dict[str, Any]],
    section: Callable[[dict[str, Any]], list[Part]],
    settings: Table1Config | UnseenConfig,
    workers: Workers,
    contestants: Contestants,
    output: Report,
) -> None:
    from ..baselines.pretrained import baseline_names, load_baselines
    from ..envs import environment_dim
    from ..modulator import Modulator

    dim = environment_dim(settings.env)
    names = baseline_names(dim)
    for method in names:
        names[method] = getattr(contestants, method.replace(" ", "_")) or names[method]
    policies = load_baselines(names)
    name = contestants.model or MODELS[dim]
    modulator, used = Modulator.from_pretrained(name), model_record(name)
    with progress_bar("rollouts") as progress:
        result = evaluate(modulator, policies, settings, **vars(workers), progress=progress)
    output.write(section, settings, result, used, list(map(model_record, names.values())))


def spectrum(
    evaluation: Annotated[Any, arg(constructor=_Spectrum)],
    output: DrawnReport,
    model: RobotModel = None,
) -> None:
    """The paper's figure 3: executed motions over the whole dial in the scene of Table I."""
    settings = made(SpectrumConfig, evaluation)
    from ..envs import environment_dim
    from ..evaluation.spectrum import Spectrum, evaluate_spectrum
    from ..modulator import Modulator
    from ..report.comparison import spectrum_section

    name = model or MODELS[environment_dim(settings.env)]
    modulator, used = Modulator.from_pretrained(name), model_record(name)
    with progress_bar("rollouts") as progress:
        result = evaluate_spectrum(modulator, settings, progress=progress)
    output.write(spectrum_section, settings, result, used)
    if output.figure is not None:
        from ..figures.spectrum import spectrum_figure

        spectra = [Spectrum.of_result(result, letter) for letter in result["targets"]]
        spectrum_figure(spectra, output.figure)


def ablations(
    evaluation: Annotated[Any, arg(constructor=_Ablations)],
    data: Annotated[Path, arg(metavar="DIR", help="dataset; small runs use its first scenes")],
    out: Annotated[Path, arg(metavar="DIR", help="folder of the small runs and measured rows")],
    output: Report,
    model: Model = MODEL,
    workers: Annotated[int, arg(help="processes that make data")] = 1,
    device: Annotated[OptionalText, arg(help="cpu or cuda; if not given, a GPU if any")] = None,
) -> None:
    """Measure the dial of the weights under other samplers, and of small runs that lack a part.

    Small runs are trained in OUT: the reference, without the field, on rank labels, and on other
    numbers of scenes. Interrupted, the same command resumes.
    """
    settings = made(AblationsConfig, evaluation)
    check_folder(out, "small runs")
    from ..data.dataset import Dataset
    from ..evaluation.ablations import evaluate_ablations
    from ..report.dial import ablations_section

    used, dataset = model_record(model), Dataset.load(data)
    with progress_bar("scenes and training steps") as progress:
        result = evaluate_ablations(
            model, dataset, out, settings, workers=workers, device=device, progress=progress
        )
    output.write(ablations_section, settings, result, used)
