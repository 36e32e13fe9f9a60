"""The folder of results and the page that shows it all."""

from __future__ import annotations

import contextlib
import json
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

from ..errors import InvalidInputError
from ..files import read_text
from .bench import bench_section, measured
from .comparison import spectrum_section, table1_section, unseen_section
from .dial import ablations_section, dial_section
from .execution import execution_section
from .table import Part, Table, markdown, number
from .wording import percent

__all__ = [
    "KINDS",
    "Results",
    "headline_table",
    "read_json",
    "read_results",
    "render_page",
    "section_of",
    "well_formed",
]

Document = dict[str, Any]
Results = dict[str, dict[str, Document]]
"""By kind and then by name, the content of the file `KIND-NAME.json`."""


class Kind(NamedTuple):
    """A kind of result.

    Attributes:
        title: of its part of the page.
        section: its text and tables.
        picture: the picture's alternative text, if it has one.
    """

    title: str
    section: Callable[[Document], list[Part]]
    picture: str = ""


KINDS = {
    "dial": Kind("The dial of planned paths", dial_section, "Asked against achieved ℓ"),
    "closed-loop": Kind(
        "The dial of executed motions", dial_section, "Asked against achieved ℓ of executed motions"
    ),
    "execution": Kind("Execution", execution_section),
    "transfer": Kind("Transfer to another simulator", execution_section),
    "table1": Kind("Table I of the paper", table1_section),
    "unseen": Kind("Table I's methods on held-out scenes", unseen_section),
    "spectrum": Kind(
        "The spectrum", spectrum_section, "Motions toward R, above, and G, and their cost"
    ),
    "ablations": Kind("Ablations of stage 1", ablations_section),
    "bench": Kind("Speed and memory", bench_section),
}


def read_results(folder: Path) -> Results:
    """The results in `folder` of all `KINDS`, and of `tuning`.

    Raises:
        InvalidInputError: there are none, or a file holds something else.
    """
    results: Results = {}
    for kind in (*KINDS, "tuning"):
        for file in sorted(folder.glob(f"{kind}-*.json")):
            name = file.stem.removeprefix(f"{kind}-")
            results.setdefault(kind, {})[name] = read_json(file)
    if not results.keys() & KINDS.keys():
        names = " or ".join(f"{kind}-*.json" for kind in KINDS)
        raise InvalidInputError(f"there is no {names} in {folder}")
    return results


def section_of(kind: str, name: str, document: Document) -> list[Part]:
    """The text and tables of one result.

    Raises:
        InvalidInputError: it is not a result of that kind.
    """
    with well_formed(f"{kind}-{name}.json is not a result of the kind {kind}"):
        if document["config"].get("closed_loop", False) != (kind == "closed-loop"):
            raise ValueError("closed_loop is for closed-loop-*.json alone")
        assert isinstance(document["command"], str)
        return KINDS[kind].section(document)


def render_page(results: Results, pictures: str) -> str:
    """All results as one page of Markdown.

    Args:
        results: of `read_results`.
        pictures: folder of the pictures, relative to the page.

    Raises:
        InvalidInputError: a file holds something else than its name says.
    """
    contents, body = [], []
    for kind, (title, _, picture) in KINDS.items():
        documents = results.get(kind, {})
        if documents:
            contents.append(_entry(title))
            body.append(f"## {title}")
        for name, document in documents.items():
            heading = f"{title}: {name}"
            contents.append("  " + _entry(heading, name))
            body += [f"### {heading}", markdown(section_of(kind, name, document))]
            if picture:
                body.append(f"![{picture}]({pictures}/{kind}-{name}.png)")
            body.append(f"Measured by `{document['command']}`.")
    parts = [
        "# Results",
        "Rendered by `legibility report` from the JSON files in `results/`, each of which holds "
        "the command,\nthe seed and the hashes of the weights. `make results` measures them again.",
        "\n".join(contents),
    ]
    headline = headline_table(results)
    if headline.rows:
        parts += ["## At a glance", headline.markdown()]
    return "\n\n".join([*parts, *body]) + "\n"


def _entry(heading: str, text: str = "") -> str:
    """A line of the table of contents, linked as GitHub names headings."""
    anchor = re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")
    return f"* [{text or heading}](#{anchor})"


def headline_table(results: Results, models: dict[str, str] | None = None) -> Table:
    """The few metrics to read first; what was not measured is left out.

    Args:
        results: of `read_results`.
        models: the heads of the columns by the model's name; `plane` and `arm` if not given.
    """
    models = models or {"block-reach-2d": "plane", "panda-block-reach": "arm"}
    table = Table("metric", *models.values())
    rows = {
        "Spearman correlation of asked and achieved ℓ": _mean("dial", "spearman"),
        "mean absolute error of ℓ": _mean("dial", "error"),
        "achieved ℓ when asked 1": _mean("dial", "at_1"),
        "achieved ℓ when asked −1": _mean("dial", "at_-1"),
        "error of ℓ of the executed motion": _mean("closed-loop", "error"),
        "success of executed motions": _success,
        "one plan on one core, PyTorch / ONNX [ms]": _plan,
    }
    for text, cell in rows.items():
        with well_formed("a result is not what `legibility` writes"):
            cells = [cell(results, name) for name in models]
        if set(cells) != {"–"}:
            table.add_row(text, *cells)
    return table


def _mean(kind: str, metric: str) -> Callable[[Results, str], str]:
    def cell(results: Results, name: str) -> str:
        document = results.get(kind, {}).get(name)
        return number(document["result"]["overall"][metric]["mean"], 4) if document else "–"

    return cell


def _success(results: Results, name: str) -> str:
    document = results.get("execution", {}).get(name)
    return percent(document["result"]["rows"]["policy"]["success"]["mean"]) if document else "–"


def _plan(results: Results, name: str) -> str:
    document = results.get("bench", {}).get("cpu")
    rows = document["result"]["measurements"] if document else []
    medians = [
        measured(rows, metric="plan_one_core_ms", model=name, backend=backend).split(" ")[0]
        for backend in ("torch", "onnx")
    ]
    return "–" if set(medians) == {"–"} else " / ".join(medians)


@contextlib.contextmanager
def well_formed(problem: str) -> Iterator[None]:
    """Turn lookup errors in malformed JSON into `InvalidInputError(problem)`."""
    try:
        yield
    except (LookupError, TypeError, ValueError, AttributeError, AssertionError) as cause:
        if isinstance(cause, InvalidInputError):
            raise
        raise InvalidInputError(f"{problem}: {cause!r}") from cause


def read_json(file: Path) -> Document:
    """The mapping in a JSON file.

    Raises:
        InvalidInputError: it cannot be read or holds no mapping.
    """
    try:
        content = json.loads(read_text(file, "JSON file"))
    except ValueError as cause:
        if isinstance(cause, InvalidInputError):
            raise
        raise InvalidInputError(f"{file} is not JSON: {cause}") from cause
    if not isinstance(content, dict):
        raise InvalidInputError(f"{file} is not a result: it holds no mapping")
    return content
