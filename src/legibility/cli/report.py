"""`legibility report`."""

from __future__ import annotations

import json as json_format
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import Positional, arg

from ..errors import InvalidInputError
from ..evaluation.card import dial_section, render_card, replace_table
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

    Every DIR/dial-NAME.json becomes a text DIR/dial-NAME.md and a figure DIR/dial-NAME.png.

    Args:
        results: folder of the JSON files.
        readme: a Markdown file whose part between the comments `dial-NAME` and `/dial-NAME` is
            replaced by the text.
        weights: a folder whose subfolder NAME, if there is one, gets its model card.
    """
    check_folder(results, "report")
    files = sorted(results.glob("dial-*.json"))
    if not files:
        raise InvalidInputError(f"there is no dial-*.json in {results}")
    for file in files:
        name = file.stem.removeprefix("dial-")
        document = _read(file)
        try:
            text = dial_section(document)
            written = {file.with_suffix(".md"): text + "\n"}
            if readme is not None:
                page = read_text(readme, "Markdown file")
                written[readme] = replace_table(page, file.stem, text)
            if weights is not None and (weights / name).is_dir():
                card = render_card(name, _read(weights / name / "config.json"), document)
                written[weights / name / "README.md"] = card
        except InvalidInputError:
            raise
        except (LookupError, TypeError, ValueError) as cause:
            raise InvalidInputError(f"{file} is not what `evaluate dial` writes") from cause
        dial_figure(document["result"], file.with_suffix(".png"))
        for path, content in written.items():
            write_bytes(path, content.encode())
        show(f"{file}: {document['command']}", text)


def _read(file: Path) -> dict[str, Any]:
    try:
        content = json_format.loads(read_text(file, "JSON file"))
    except ValueError as cause:
        raise InvalidInputError(f"{file} is not JSON: {cause}") from cause
    if not isinstance(content, dict):
        raise InvalidInputError(f"{file} is not a report: it holds no mapping")
    return content
