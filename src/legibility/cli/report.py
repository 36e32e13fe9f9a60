"""`legibility report`."""

import os
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import Positional, arg

from ..errors import InvalidInputError
from .options import Folder, OutputFile
from .output import check_file, check_folder, show


def report(
    results: Annotated[Positional[Path], arg(metavar="DIR", help_behavior_hint="")],
    out: OutputFile = None,
    pictures: Folder = None,
    weights: Folder = None,
    tables: Folder = None,
) -> None:
    """Render results as one page of Markdown with pictures, and as model cards.

    DIR holds results by `KIND-NAME.json`. NAME of weights: closed-loop of `evaluate dial
    --closed-loop`, planning of `evaluate planning`, optimum of `evaluate optimum`, eyes of
    `evaluate eyes`, execution of `evaluate execution`, transfer of the same in another simulator,
    ablations of `evaluate ablations`, tuning of `train legibility-diffuser`. NAME of weights and
    -REGIME: dial of `evaluate dial`, and execution past obstacles. NAME of an environment: table1,
    unseen and spectrum of the verbs of these names. NAME of a device: bench of `bench`.

    Args:
        results: folder of the JSON files.
        out: the page.
        pictures: a folder for pictures of dials, planning and spectra, which the page shows.
        weights: a folder with a subfolder for each model, each of which gets its model card.
        tables: a folder for each table as LaTeX and CSV, and the pictures as PDF.

    Examples:
        legibility report results --out docs/results.md --pictures results
        legibility report results --tables out/tables --weights src/legibility/weights
    """
    from ..files import write_bytes
    from ..report.card import render_card
    from ..report.results import (
        KINDS,
        read_json,
        read_results,
        render_page,
        section_of,
        well_formed,
    )
    from ..report.table import Table

    if not any((out, pictures, weights, tables)):
        raise InvalidInputError("name an output: --out, --pictures, --weights or --tables")
    check_file(out, "page")
    contents = read_results(results)
    texts = {} if out is None else {out: render_page(contents, _link(out, pictures))}
    for file in sorted(weights.glob("*/config.json")) if weights else []:
        card = render_card(file.parent.name, read_json(file), contents)
        texts[file.with_name("README.md")] = card
    drawings: list[tuple[str, dict[str, Any], Path]] = []
    for kind, name in [(k, name) for k in KINDS for name in contents.get(k, {})]:
        document, stem = contents[kind][name], f"{kind}-{name}"
        if KINDS[kind].picture:
            places = ((pictures, ".png"), (tables, ".pdf"))
            files = [folder / f"{stem}{suffix}" for folder, suffix in places if folder]
            drawings += [(kind, document["result"], file) for file in files]
        if tables:
            parts = [p for p in section_of(kind, name, document) if isinstance(p, Table)]
            for number, part in enumerate(parts, start=1):
                texts[tables / f"{stem}-{number}.tex"] = part.latex(document["command"])
                texts[tables / f"{stem}-{number}.csv"] = part.csv()
    for folder in {file.parent for file in (*texts, *(file for _, _, file in drawings))}:
        check_folder(folder, "report")
    for file, text in texts.items():
        write_bytes(file, text.encode())
        show(str(file))
    for kind, result, file in drawings:
        with well_formed(f"cannot draw {file}"):
            result_figure(kind, result, file)
        show(str(file))


def _link(page: Path, pictures: Path | None) -> str | None:
    """The folder of the pictures as the page links it."""
    if pictures is None:
        return None
    return Path(os.path.relpath(pictures.absolute(), page.absolute().parent)).as_posix()


def result_figure(kind: str, result: dict[str, Any], file: Path) -> None:
    """Draw the picture of a result of an evaluation."""
    if kind == "planning":
        from ..figures.paper import planning_figure

        planning_figure(result, file)
    elif kind == "spectrum":
        from ..evaluation.spectrum import Spectrum
        from ..figures.paper import spectrum_figure

        spectrum_figure([Spectrum.of_result(result, target) for target in result["targets"]], file)
    else:
        from ..figures.paper import dial_figure

        dial_figure(result, file)
