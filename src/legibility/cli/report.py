"""`legibility report`."""

from __future__ import annotations

import contextlib
import json as json_format
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import Positional, arg

from ..bench.tables import bench_section
from ..errors import InvalidInputError
from ..evaluation.comparison import METHODS
from ..evaluation.spectrum import Spectrum
from ..figures.dial import dial_figure
from ..figures.spectrum import spectrum_figure
from ..files import read_text, write_bytes
from ..report.baseline_card import render_baseline_card
from ..report.card import (
    ablations_section,
    dial_section,
    execution_section,
    render_card,
    replace_table,
)
from ..report.tables import (
    spectrum_section,
    table1_csv,
    table1_latex,
    table1_section,
    unseen_section,
)
from .options import Folder, OutputFile
from .output import check_folder, show


def report(
    results: Annotated[Positional[Path], arg(metavar="DIR", help_behavior_hint="")],
    readme: OutputFile = None,
    weights: Folder = None,
) -> None:
    """Render what `legibility evaluate` and `bench` wrote: tables, figures and model cards.

    DIR holds, for weights NAME, dial-NAME.json of `evaluate dial`, closed-loop-NAME.json of the
    same with --closed-loop, execution-NAME.json of `evaluate execution`, of the same in another
    simulator transfer-NAME.json, and ablations-NAME.json of `evaluate ablations`; for an
    environment NAME, table1-NAME.json, unseen-NAME.json and spectrum-NAME.json of the verbs of
    those names; for a device NAME, bench-NAME.json of `bench`. Each becomes a text,
    DIR/KIND-NAME.md; dials and spectra become figures too, .png and for the latter .pdf, Table I a
    LaTeX tabular, .tex, and a .csv.

    Args:
        results: folder of the JSON files.
        readme: a Markdown file whose part between the comments `KIND-NAME` and `/KIND-NAME` is
            replaced by the text; of weights that were distilled, NAME-fast, only what is said of
            them beside NAME, between `distilled` and `/distilled`.
        weights: a folder whose subfolder NAME, if there is one, gets its model card.
    """
    check_folder(results, "report")
    found: dict[str, dict[str, dict[str, Any]]] = {}
    for kind in _KINDS:
        for file in sorted(results.glob(f"{kind}-*.json")):
            found.setdefault(file.stem.removeprefix(f"{kind}-"), {})[kind] = _read(file)
    if not found:
        raise InvalidInputError(
            f"there is no {' or '.join(f'{k}-*.json' for k in _KINDS)} in {results}"
        )

    # All is rendered before anything is written.
    page = None if readme is None else read_text(readme, "Markdown file")
    sections: list[tuple[Path, dict[str, Any], str]] = []
    figures: list[tuple[Callable[..., None], Any, Path]] = []
    texts: dict[Path, str] = {}
    for name, documents in found.items():
        for kind, document in documents.items():
            file = results / f"{kind}-{name}.json"
            with _as_is_written(f"{file} is not what `evaluate` writes"):
                section = _section(kind, file, document)
                texts |= _tables(kind, file, document)
                figures += _figures(kind, file, document["result"])
            texts[file.with_suffix(".md")] = f"{section}\n"
            sections.append((file, document, section))
            if page is not None:
                page = replace_table(page, file.stem, section)
        if weights is not None and (weights / name).is_dir():
            config = _read(weights / name / "config.json")
            with _as_is_written(f"cannot make the card of {name}"):
                texts[weights / name / "README.md"] = render_card(name, config, documents)
    if weights is not None:
        texts |= _baseline_cards(weights, found)

    for draw, content, file in figures:
        draw(content, file)
    for file, text in texts.items():
        write_bytes(file, text.encode())
    if readme is not None and page is not None:
        write_bytes(readme, page.encode())
    for file, document, section in sections:
        show(f"{file}: {document['command']}", section)


_KINDS: dict[str, Callable[[dict[str, Any]], str]] = {
    "dial": dial_section,
    "closed-loop": dial_section,
    "execution": execution_section,
    "transfer": execution_section,
    "table1": table1_section,
    "unseen": unseen_section,
    "spectrum": spectrum_section,
    "ablations": ablations_section,
    "bench": bench_section,
}


@contextlib.contextmanager
def _as_is_written(problem: str) -> Iterator[None]:
    """Say `problem` of JSON in which something else is found than was looked for."""
    try:
        yield
    except InvalidInputError:
        raise
    except (LookupError, TypeError, ValueError, AttributeError) as cause:
        raise InvalidInputError(f"{problem}: {cause!r}") from cause


def _section(kind: str, file: Path, document: dict[str, Any]) -> str:
    if document["config"].get("closed_loop", False) != (kind == "closed-loop"):
        raise InvalidInputError(f"{file} is not of the kind that its name says, {kind}")
    return _KINDS[kind](document)


def _tables(kind: str, file: Path, document: dict[str, Any]) -> dict[Path, str]:
    """Texts beside a measurement that are not Markdown."""
    if kind != "table1":
        return {}
    return {
        file.with_suffix(".tex"): table1_latex(document),
        file.with_suffix(".csv"): table1_csv(document),
    }


def _figures(
    kind: str, file: Path, result: dict[str, Any]
) -> list[tuple[Callable[..., None], Any, Path]]:
    """Pictures beside a measurement: who draws them, of what, and where to."""
    if kind in ("dial", "closed-loop"):
        return [(dial_figure, result, file.with_suffix(".png"))]
    if kind != "spectrum":
        return []
    spectra = [Spectrum.of_result(result, letter) for letter in result["targets"]]
    return [(spectrum_figure, spectra, file.with_suffix(suffix)) for suffix in (".png", ".pdf")]


def _baseline_cards(weights: Path, found: dict[str, dict[str, dict[str, Any]]]) -> dict[Path, str]:
    """Of each baseline's weights that take part in a comparison."""
    documents: dict[str, dict[str, dict[str, Any]]] = {}
    for name, kinds in found.items():
        for kind, document in kinds.items():
            with _as_is_written(f"{kind}-{name}.json is not what `evaluate` writes"):
                for used in document.get("baselines", []):
                    documents.setdefault(used["name"], {})[f"{kind}-{name}"] = document
    cards = {}
    for name, own in documents.items():
        folder = weights / name
        method = next((m for m in METHODS if name.startswith(m.replace(" ", "-"))), None)
        if method and Path(name).name == name and folder.is_dir():
            config = _read(folder / "config.json")
            with _as_is_written(f"cannot make the card of {name}"):
                cards[folder / "README.md"] = render_baseline_card(
                    name, method, config, dict(sorted(own.items()))
                )
    return cards


def _read(file: Path) -> dict[str, Any]:
    try:
        content = json_format.loads(read_text(file, "JSON file"))
    except ValueError as cause:
        raise InvalidInputError(f"{file} is not JSON: {cause}") from cause
    if not isinstance(content, dict):
        raise InvalidInputError(f"{file} is not a report: it holds no mapping")
    return content
