"""The folder of results and the page that shows it all."""

import contextlib
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from ..errors import InvalidInputError
from ..files import read_document
from .comparisons import external_section, single_scene_section, table1_section, unseen_section
from .dials import dial_section, eyes_section, percent, regimes_tables, sound
from .sections import (
    NOTES,
    ablations_section,
    bench_section,
    controller_section,
    execution_section,
    optimum_section,
    planning_section,
    spectrum_section,
    timing_section,
)
from .table import Part, Table, markdown, number, three_digits

Document = dict[str, Any]
Results = dict[str, dict[str, Document]]
"""By kind and then by name, the content of the file `KIND-NAME.json`."""


class Kind(NamedTuple):
    """A kind of result: its title, text and tables, and the picture's alternative text if any."""

    title: str
    section: Callable[[Document], list[Part]]
    picture: str = ""


KINDS = {
    "dial": Kind("The dial of planned paths", dial_section, "Asked against achieved ℓ"),
    "closed-loop": Kind(
        "The dial of executed motions", dial_section, "Asked against achieved ℓ of executed motions"
    ),
    "eyes": Kind("Whose eyes?", eyes_section),
    "planning": Kind(
        "Error against time",
        planning_section,
        "Error of ℓ against the time to plan, in free space and past obstacles",
    ),
    "optimum": Kind("Of what is possible", optimum_section),
    "external": Kind("By other people's definitions", external_section),
    "timing": Kind("Timed motions", timing_section),
    "controller": Kind("Disturbed on the way", controller_section),
    "execution": Kind("Execution", execution_section),
    "transfer": Kind("Transfer to another simulator", execution_section),
    "unseen": Kind("Table I's methods on held-out scenes", unseen_section),
    "table1": Kind("Table I of the paper", table1_section),
    "single-scene": Kind("Table I, learned in its scene alone", single_scene_section),
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


def render_page(results: Results, pictures: str | None) -> str:
    """All results as one page of Markdown; `pictures` is their folder, if any, as it is linked.

    Raises:
        InvalidInputError: a file holds something else than its name says.
    """
    parts = [
        "# Results",
        "Rendered by `legibility report` from the JSON files in `results/`, each of which holds "
        "the command,\nthe seed and the hashes of the weights. `make results` measures them again.",
    ]
    headline = headline_table(results)
    if headline.rows:
        parts += ["## At a glance", headline.markdown()]
    parts += ["## Metrics", markdown(NOTES)]
    for model, documents in by_model(results).items():
        with well_formed(f"a dial of {model} is not what `legibility` writes"):
            tables = regimes_tables(documents)
        if tables[0].rows:
            parts += [f"## Regimes: {model}", markdown(tables)]
    for kind, (title, _, picture) in KINDS.items():
        if kind in results:
            parts.append(f"## {title}")
        for name, document in results.get(kind, {}).items():
            parts += [f"### {title}: {name}", markdown(section_of(kind, name, document))]
            if picture and pictures is not None:
                parts.append(f"![{picture}]({pictures}/{kind}-{name}.png)")
            parts.append(f"Measured by `{document['command']}`.")
    return "\n\n".join(parts) + "\n"


def by_model(results: Results) -> dict[str, dict[str, Document]]:
    """The results `dial-MODEL-REGIME.json` by model and regime."""
    found: dict[str, dict[str, Document]] = {}
    for name, document in results.get("dial", {}).items():
        model, _, regime = name.rpartition("-")
        found.setdefault(model, {})[regime] = document
    return found


class Metric(NamedTuple):
    """A metric to read first.

    Attributes:
        text: its name, in a table below the metrics before it.
        identifier: its key in `NAMES`.
        kind: of the result that has it.
        regime: in which the name of that result ends, if in any.
        value: from the content of that result.
        share: whether it is shown in percent.
    """

    text: str
    identifier: str
    kind: str
    regime: str
    value: Callable[[Any], float]
    share: bool = False

    def document(self, results: Results, model: str) -> Document | None:
        """The result of a model that has the metric, if there is one."""
        name = f"{model}-{self.regime}" if self.regime else model
        return results.get(self.kind, {}).get(name)


NAMES = {
    "spearmanr": "Spearman correlation of asked and achieved ℓ",
    "mae": "mean absolute error of ℓ",
    "mae_exact": "mean absolute error of ℓ, exact",
    "achieved_at_1": "achieved ℓ when asked 1",
    "achieved_at_-1": "achieved ℓ when asked −1",
    "feasible": "share of paths that touch nothing",
    "success": "success of executed motions",
}
"""Names of metrics by the identifiers that model cards have on the Hugging Face Hub."""


def _mean(metric: str, mode: str = "quick") -> Callable[[Any], float]:
    return lambda result: sound(result)[mode][metric]["mean"]


def _success(result: Any) -> float:
    return result["rows"]["policy"]["success"]["mean"]


_ANYWHERE = "any room, any observer, obstacles"

HEADLINE = (
    Metric(NAMES["spearmanr"], "spearmanr", "dial", "dragan", _mean("spearman")),
    Metric(NAMES["mae"], "mae", "dial", "dragan", _mean("error")),
    Metric("the same, exact", "mae_exact", "dial", "dragan", _mean("error", "exact")),
    Metric(NAMES["achieved_at_1"], "achieved_at_1", "dial", "dragan", _mean("at_1")),
    Metric(NAMES["achieved_at_-1"], "achieved_at_-1", "dial", "dragan", _mean("at_-1")),
    Metric(f"{_ANYWHERE}: Spearman correlation", "spearmanr", "dial", "all", _mean("spearman")),
    Metric(f"{_ANYWHERE}: mean absolute error", "mae", "dial", "all", _mean("error")),
    Metric(f"{_ANYWHERE}: the same, exact", "mae_exact", "dial", "all", _mean("error", "exact")),
    Metric(
        f"{_ANYWHERE}: share of paths that touch nothing", "feasible", "dial", "all",
        lambda result: result["overall"]["quick"]["feasible"]["mean"], True,
    ),
    Metric("error of ℓ of the executed motion", "mae", "closed-loop", "", _mean("error")),
    Metric(NAMES["success"], "success", "execution", "", _success, True),
    Metric("the same, past obstacles", "success", "execution", "obstacles", _success, True),
)  # fmt: skip
"""The few metrics to read first, in their order."""


def headline_table(results: Results, models: dict[str, str] | None = None) -> Table:
    """The few metrics to read first, of shipped weights or of `models`, with their heads by name.

    Rows that were not measured are left out.
    """
    models = models or {"block-reach-2d": "2-D", "panda-block-reach": "Panda"}
    table = Table("metric", *models.values())
    with well_formed("a result is not what `legibility` writes"):
        for metric in HEADLINE:
            documents = [metric.document(results, model) for model in models]
            values = [None if d is None else metric.value(d["result"]) for d in documents]
            if any(value is not None for value in values):
                shown = percent if metric.share else partial(number, digits=4)
                table.add_row(metric.text, *("–" if v is None else shown(v) for v in values))
        bench = results.get("bench", {}).get("cpu", {"result": {"measurements": []}})
        plans = {
            (row["model"], row["backend"]): three_digits(row["median"])
            for row in bench["result"]["measurements"]
            if row["metric"] == "plan_one_core_ms" and row["model"] in models
        }
        if plans:
            cells = [[plans.get((m, b), "–") for b in ("torch", "onnx")] for m in models]
            shown = map(" / ".join, cells)
            table.add_row("one plan on one core, PyTorch / ONNX [ms]", *shown)
    return table


def model_index(results: Results, name: str) -> list[dict[str, Any]]:
    """The headline metrics of the weights `name` as the metadata of a model card has them.

    The form is that of the Hugging Face Hub, `model-index`, which it shows beside the card.
    """
    found: dict[tuple[str, str], dict[str, Any]] = {}
    with well_formed("a result is not what `legibility` writes"):
        for metric in HEADLINE:
            if (document := metric.document(results, name)) is None:
                continue
            config = document["config"]
            scenes = f"{config['scenes']} held-out random scenes (seed {document['seed']})"
            entry = found.setdefault(
                (metric.kind, metric.regime),
                {
                    "task": {"type": "robotics", "name": KINDS[metric.kind].title},
                    "dataset": {"type": "legibility", "name": scenes, "config": config["regime"]},
                    "metrics": [],
                },
            )
            value = round(float(metric.value(document["result"])), 4)
            text = NAMES[metric.identifier]
            entry["metrics"].append({"type": metric.identifier, "value": value, "name": text})
    return [{"name": name, "results": list(found.values())}]


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
    content = read_document(file, "JSON file")
    if not isinstance(content, dict):
        raise InvalidInputError(f"{file} is not a result: it holds no mapping")
    return content
