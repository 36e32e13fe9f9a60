"""`legibility report`."""

import os
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import Positional, arg

from .options import Folder, OutputFile
from .output import check_file, check_folder, show


def report(
    results: Annotated[Positional[Path], arg(metavar="DIR", help_behavior_hint="")],
    out: OutputFile = None,
    weights: Folder = None,
    tables: Folder = None,
) -> None:
    """Render results as one page of Markdown with pictures, and as model cards.

    DIR holds results by `KIND-NAME.json`. NAME of weights: closed-loop of `evaluate dial
    --closed-loop`, planning of `evaluate planning`, optimum of `evaluate optimum`, eyes of
    `evaluate eyes`, execution of `evaluate execution`, transfer of the same in another simulator,
    ablations of `evaluate ablations`, tuning of `train legibility-diffuser`. NAME of weights and
    -REGIME: dial of `evaluate dial`, and execution past obstacles. NAME of an environment: table1,
    unseen and spectrum of the verbs of these names. NAME of a device: bench of `bench`. Pictures of
    dials and spectra are drawn in DIR.

    Args:
        results: folder of the JSON files.
        out: the page; if not given, docs/results.md beside DIR.
        weights: a folder with a subfolder for each model, each of which gets its model card.
        tables: a folder for each table as LaTeX and CSV, and the pictures as PDF.
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

    page = out or results.absolute().parent / "docs" / "results.md"
    check_file(page, "page")
    contents = read_results(results)
    pictures = os.path.relpath(results.absolute(), page.absolute().parent)
    texts = {page: render_page(contents, Path(pictures).as_posix())}
    for file in sorted(weights.glob("*/config.json")) if weights else []:
        card = render_card(file.parent.name, read_json(file), contents)
        texts[file.with_name("README.md")] = card
    drawings: list[tuple[str, dict[str, Any], Path]] = []
    for kind, name in [(k, name) for k in KINDS for name in contents.get(k, {})]:
        document, stem = contents[kind][name], f"{kind}-{name}"
        if KINDS[kind].picture:
            files = [results / f"{stem}.png", *([tables / f"{stem}.pdf"] if tables else [])]
            drawings += [(kind, document["result"], file) for file in files]
        if tables:
            parts = [p for p in section_of(kind, name, document) if isinstance(p, Table)]
            for number, part in enumerate(parts, start=1):
                texts[tables / f"{stem}-{number}.tex"] = part.latex(document["command"])
                texts[tables / f"{stem}-{number}.csv"] = part.csv()
    for folder in {file.parent for file in texts}:
        check_folder(folder, "report")
    for file, text in texts.items():
        write_bytes(file, text.encode())
        show(str(file))
    for kind, result, file in drawings:
        with well_formed(f"cannot draw {file}"):
            result_figure(kind, result, file)
        show(str(file))


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
