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
        out: the page; docs/results.md beside DIR if not given.
        weights: a folder with a subfolder for each model, each of which gets its model card.
        tables: a folder for each table as LaTeX and CSV, and the pictures as PDF.
    """
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
        name = file.parent.name
        texts[file.with_name("README.md")] = render_card(name, read_json(file), contents)
    drawings: list[tuple[Callable[..., None], Any, Path]] = []
    for kind in KINDS:
        for name, document in contents.get(kind, {}).items():
            stem, number = f"{kind}-{name}", 0
            with well_formed(f"{stem}.json is not a result of the kind {kind}"):
                pictures_of = _pictures(kind, document["result"])
            for draw, content in pictures_of:
                drawings.append((draw, content, results / f"{stem}.png"))
                if tables:
                    drawings.append((draw, content, tables / f"{stem}.pdf"))
            for part in section_of(kind, name, document) if tables else []:
                if tables and isinstance(part, Table):
                    number += 1
                    texts[tables / f"{stem}-{number}.tex"] = part.latex(document["command"])
                    texts[tables / f"{stem}-{number}.csv"] = part.csv()
    _write(texts, drawings)


def _pictures(kind: str, result: dict[str, Any]) -> list[tuple[Callable[..., None], Any]]:
    """The functions that draw the pictures of a result, and what they draw."""
    if kind in ("dial", "closed-loop"):
        from ..figures.dial import dial_figure

        return [(dial_figure, result)]
    if kind == "spectrum":
        from ..evaluation.spectrum import Spectrum
        from ..figures.spectrum import spectrum_figure

        spectra = [Spectrum.of_result(result, letter) for letter in result["targets"]]
        return [(spectrum_figure, spectra)]
    return []


def _write(texts: dict[Path, str], drawings: list[tuple[Callable[..., None], Any, Path]]) -> None:
    """Write texts first, then pictures, which may fail."""
    from ..files import write_bytes
    from ..report.results import well_formed

    for folder in {file.parent for file in texts}:
        check_folder(folder, "report")
    for file, text in texts.items():
        write_bytes(file, text.encode())
        show(str(file))
    for draw, content, file in drawings:
        with well_formed(f"cannot draw {file}"):
            draw(content, file)
        show(str(file))
