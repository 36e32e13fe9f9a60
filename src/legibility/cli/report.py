"""`legibility report`."""

from __future__ import annotations

import os
from collections.abc import Callable
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

    DIR holds results by `KIND-NAME.json`. NAME of weights: dial of `evaluate dial`, closed-loop of
    the same with --closed-loop, execution of `evaluate execution`, transfer of the same in another
    simulator, ablations of `evaluate ablations`, tuning of `train legibility-diffuser`. NAME of an
    environment: table1, unseen and spectrum of the verbs of these names. NAME of a device: bench of
    `bench`. Pictures of dials and spectra are drawn in DIR.

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
    drawings: dict[Path, Callable[[Path], None]] = {}
    for kind, name in [(k, name) for k in KINDS for name in contents.get(k, {})]:
        document, stem = contents[kind][name], f"{kind}-{name}"
        with well_formed(f"{stem}.json is not a result of the kind {kind}"):
            draw = _picture(kind, document["result"])
        if draw:
            drawings[results / f"{stem}.png"] = draw
        if draw and tables:
            drawings[tables / f"{stem}.pdf"] = draw
        if tables:
            parts = section_of(kind, name, document)
            for number, part in enumerate((p for p in parts if isinstance(p, Table)), start=1):
                texts[tables / f"{stem}-{number}.tex"] = part.latex(document["command"])
                texts[tables / f"{stem}-{number}.csv"] = part.csv()
    for folder in {file.parent for file in texts}:
        check_folder(folder, "report")
    for file, text in texts.items():
        write_bytes(file, text.encode())
        show(str(file))
    for file, draw in drawings.items():
        with well_formed(f"cannot draw {file}"):
            draw(file)
        show(str(file))


def _picture(kind: str, result: dict[str, Any]) -> Callable[[Path], None] | None:
    """The function that draws the picture of a result, if it has one, to a file."""
    if kind in ("dial", "closed-loop"):
        from ..figures.dial import dial_figure

        return lambda file: dial_figure(result, file)
    if kind == "spectrum":
        from ..evaluation.spectrum import Spectrum
        from ..figures.spectrum import spectrum_figure

        spectra = [Spectrum.of_result(result, letter) for letter in result["targets"]]
        return lambda file: spectrum_figure(spectra, file)
    return None
