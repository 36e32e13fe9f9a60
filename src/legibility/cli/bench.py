"""`legibility bench`."""

from dataclasses import asdict
from typing import Annotated, Any

from tyro.conf import arg

from ..bench import BenchConfig, run_bench
from ..errors import InvalidInputError
from .options import MODELS, OutputFile, choices, flags, made
from .output import check_file, model_record, progress_bar, show, write_report

_NAMES = tuple(MODELS.values())
_Models = Annotated[tuple[str, ...], choices(_NAMES, "DIR", count=" ...")]


def bench(
    measured: Annotated[Any, arg(constructor=flags(BenchConfig))],
    model: _Models = _NAMES,
    json: OutputFile = None,
) -> None:
    """Measure the speed of planning, control, data and training on this machine, and memory.

    It takes about two minutes. Leave the machine alone meanwhile: other programs slow it down.

    Args:
        measured: sizes and durations.
        model: names of shipped weights, or folders.
        json: all measurements as JSON.

    Examples:
        legibility bench --json out/bench.json
        legibility bench --model block-reach-2d --rounds 1 --batches 1 64
    """
    settings = made(BenchConfig, measured)
    check_file(json, "JSON file")
    if not model:
        raise InvalidInputError("model must be at least one name, got none")
    used = [model_record(name) for name in model]
    with progress_bar("parts") as progress:
        result = run_bench(model, settings, progress=progress)
    from ..report.sections import bench_section

    config = {**asdict(settings), "weights": used}
    write_report(json, seed=None, config=config, model=used[0], result=result)
    show(*bench_section({"config": config, "result": result}))
