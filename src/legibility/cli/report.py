"""`legibility report`."""

from __future__ import annotations

import json as json_format
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import Positional, arg

from ..errors import InvalidInputError
from ..evaluation.card import (
    ablations_section,
    dial_section,
    execution_section,
    render_card,
    replace_table,
)
from ..evaluation.figures import dial_figure
from ..files import read_text, write_bytes
from .options import Folder, OutputFile
from .output import check_folder, show


def report(
    results: Annotated[Positional[Path], arg(metavar="DIR", help_behavior_hint="")],
    readme: OutputFile = None,
    weights: Folder = None,
) -> None:
    """Render what `legibility evaluate` wrote: tables, figures and model cards.

    DIR holds, for weights NAME, dial-NAME.json of `evaluate dial`, closed-loop-NAME.json of the
    same with --closed-loop, execution-NAME.json of `evaluate execution`, of the same in another
    simulator transfer-NAME.json, and ablations-NAME.json of `evaluate ablations`. Each becomes a
    text, DIR/KIND-NAME.md, the first two a figure DIR/KIND-NAME.png too.

    Args:
        results: folder of the JSON files.
        readme: a Markdown file whose part between the comments `KIND-NAME` and `/KIND-NAME` is
            replaced by the text.
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
    cards: dict[Path, str] = {}
    for name, documents in found.items():
        for kind, document in documents.items():
            file = results / f"{kind}-{name}.json"
            section = _section(kind, file, document)
            sections.append((file, document, section))
            if page is not None:
                page = replace_table(page, file.stem, section)
        if weights is not None and (weights / name).is_dir():
            cards[weights / name / "README.md"] = _card(name, weights / name, documents)

    for file, document, section in sections:
        if "levels" in document["result"]:
            dial_figure(document["result"], file.with_suffix(".png"))
        write_bytes(file.with_suffix(".md"), f"{section}\n".encode())
    for file, card in cards.items():
        write_bytes(file, card.encode())
    if readme is not None and page is not None:
        write_bytes(readme, page.encode())
    for file, document, section in sections:
        show(f"{file}: {document['command']}", section)


_KINDS: dict[str, Callable[[dict[str, Any]], str]] = {
    "dial": dial_section,
    "closed-loop": dial_section,
    "execution": execution_section,
    "transfer": execution_section,
    "ablations": ablations_section,
}


def _section(kind: str, file: Path, document: dict[str, Any]) -> str:
    try:
        if document["config"].get("closed_loop", False) != (kind == "closed-loop"):
            raise InvalidInputError(f"{file} is not of the kind that its name says, {kind}")
        return _KINDS[kind](document)
    except InvalidInputError:
        raise
    except (LookupError, TypeError, ValueError, AttributeError) as cause:
        raise InvalidInputError(f"{file} is not what `evaluate` writes: {cause!r}") from cause


def _card(name: str, folder: Path, documents: dict[str, dict[str, Any]]) -> str:
    config = _read(folder / "config.json")
    try:
        return render_card(name, config, documents)
    except InvalidInputError:
        raise
    except (LookupError, TypeError, ValueError, AttributeError) as cause:
        raise InvalidInputError(f"cannot make the card of {name}: {cause!r}") from cause


def _read(file: Path) -> dict[str, Any]:
    try:
        content = json_format.loads(read_text(file, "JSON file"))
    except ValueError as cause:
        raise InvalidInputError(f"{file} is not JSON: {cause}") from cause
    if not isinstance(content, dict):
        raise InvalidInputError(f"{file} is not a report: it holds no mapping")
    return content
