"""What the dial is worth: one regime, all regimes side by side, and to whose eyes."""

from collections.abc import Iterable
from typing import Any

from ..evaluation.configuration import EVALUATED, MODES
from ..evaluation.dial import METRICS
from ..evaluation.eyes import EYES
from .table import Part, Table, number, significant

REGIMES = {
    "paper": "the default workspace, empty, and the paper's observer",
    "dragan": "the default workspace, empty, and Dragan's observer",
    "observers": "the default workspace, empty, and any observer",
    "rooms": "empty rooms of any size and aspect, and Dragan's observer",
    "obstacles": "the default workspace with one to four obstacles, and Dragan's observer",
    "all": "any room with up to four obstacles, and any observer",
}
"""The scenes and observers of each regime."""

_LIMIT_OF = {"spearman": "spearman", "error": "noise", "waves": "waves"}
"""The limits that stand beside a metric, by its name."""


def goals_of(config: dict[str, Any]) -> str:
    """How many goals the scenes of a configuration have."""
    low, high = config["goals"]
    return f"{low} goals" if low == high else f"{low} to {high} goals"


def scenes_of(document: dict[str, Any]) -> str:
    """The scenes of a result."""
    config, seed = document["config"], document["seed"]
    # Rooms of any size have any number of goals.
    goals = "" if config.get("regime") in ("rooms", "all") else f" with {goals_of(config)}"
    return f"{config['scenes']:,} held-out random scenes{goals} (seed {seed})"


def percent(share: float) -> str:
    """A share in percent with two decimals."""
    return f"{share:.2%}"


def means(metrics: dict[str, Any], names: Iterable[str], digits: int = 4) -> list[str]:
    """The means of some metrics, – for those that were not measured."""
    return [number(metrics[n]["mean"], digits) if n in metrics else "–" for n in names]


def sound(result: dict[str, Any]) -> dict[str, Any]:
    """The metrics in the scenes whose labels mean something, or in all if there are none."""
    return result["sound"] or result["overall"]


def dial_section(document: dict[str, Any]) -> list[Part]:
    """The metrics of `legibility evaluate dial`, of planned paths or of executed motions."""
    config, result = document["config"], document["result"]
    overall = result["overall"]
    modes = [mode for mode in (*MODES, *config.get("method", ())) if mode in overall]
    if config["closed_loop"]:
        how = f"Stage 2 executes every path in {result['env']}, to within 2 cm of the target."
    else:
        how = f"Only the row “with candidates” takes the nearest of {config['candidates']} paths."
    chief = "quick" if "quick" in modes else modes[0]
    heads: list[str] = []
    for mode in modes:
        spread = (f"{mode}: 95 % interval", f"{mode}: of single scenes") if mode == chief else ()
        heads += [f"{mode}: mean", *spread]
    table = Table("metric", *heads, "limit")
    for name in [n for n in METRICS if any(n in overall[mode] for mode in modes)]:
        cells: list[str] = []
        for mode in modes:
            cells += means(overall[mode], [name])
            if mode == chief:
                cells += _spread(overall[mode].get(name))
        limit = _LIMIT_OF.get(name)
        cells += means(overall["limits"], [limit]) if limit else [""]
        table.add_row(METRICS[name], *cells)
    parts: list[Part] = [
        f"{scenes_of(document)}: {REGIMES[config['regime']]}. {config['levels']} levels of ℓ, "
        f"{config['samples']} samples of each. {how}",
        table,
        _ranges(overall["limits"]),
    ]
    return [*parts, *_degenerate(result, modes)]


def _spread(values: dict[str, Any] | None) -> list[str]:
    """The interval of a mean, and the least and greatest value."""
    if values is None:
        return ["–", "–"]
    low, high, least, most = (
        number(value, 4) for value in (*values["interval"], values["min"], values["max"])
    )
    return [f"{low} to {high}", f"{least} to {most}"]


def _ranges(limits: dict[str, Any]) -> str:
    """How many nats the dials of the scenes span."""
    spans = []
    for side in ("below", "above"):
        median, least = (significant(limits[side][key]) for key in ("median", "min"))
        spans.append(f"{median} nats {side} ℓ = 0 (at least {least})")
    return f"The dial of the median scene spans {' and '.join(spans)}."


def _degenerate(result: dict[str, Any], modes: list[str]) -> list[Part]:
    """The scenes whose labels mean little, apart from the others."""
    if result["degenerate"] is None:
        return []
    table = Table("scenes", *(f"{m}: {text}" for m in modes for text in ("Spearman", "error")))
    for key, text in (("sound", "the others"), ("degenerate", "a side below 0.05 nats")):
        if result[key] is not None:
            cells = [c for mode in modes for c in means(result[key][mode], ("spearman", "error"))]
            table.add_row(f"{text} ({result[key]['scenes']})", *cells)
    return ["Where a side spans less than 0.05 nats its labels rank little:", table]


def regimes_tables(documents: dict[str, dict[str, Any]]) -> list[Table]:
    """One row for each regime and mode of a model: how exact its dial is, and the shape of curves.

    Of scenes whose labels mean something, see `sound`.

    Args:
        documents: results of `legibility evaluate dial` by regime.
    """
    labels = Table(
        "regime", "mode", "scenes", "Spearman: mean", "Spearman: worst scene", "Spearman: limit",
        "error of ℓ: mean", "error of ℓ: limit", "error in all scenes", "asked 1", "asked −1",
        "worst scene at ±1", "neighbours in order", "Dragan’s rises",
        left=range(2),
    )  # fmt: skip
    shapes = Table(
        "regime", "mode", "feasible", "replaced", "waves", "waves: archive", "length: asked 1",
        "length: asked −1", "of the optimum", left=range(2),
    )  # fmt: skip
    for regime in [r for r in EVALUATED if r in documents]:
        result = documents[regime]["result"]
        counted, limits = sound(result), sound(result)["limits"]
        for mode in [m for m in MODES if m in counted]:
            metrics = counted[mode]
            shares = {n: percent(v["mean"]) for n, v in metrics.items()}
            labels.add_row(
                regime,
                mode,
                f"{counted['scenes']} of {result['overall']['scenes']}",
                number(metrics["spearman"]["mean"], 4),
                number(metrics["spearman"]["min"]),
                number(limits["spearman"]["mean"], 4),
                number(metrics["error"]["mean"], 4),
                number(limits["noise"]["mean"], 4),
                number(result["overall"][mode]["error"]["mean"], 4),
                *means(metrics, ("at_1", "at_-1"), 3),
                number(min(metrics["at_1"]["min"], -metrics["at_-1"]["max"])),
                shares["adjacent_order"],
                shares["dragan_rises"],
            )
            shapes.add_row(
                regime,
                mode,
                *(shares[name] for name in ("feasible", "replaced", "waves")),
                percent(limits["waves"]["mean"]) if "waves" in limits else "–",
                *means(metrics, ("length_ratio_at_1", "length_ratio_at_-1"), 2),
                number(metrics["optimum"]["median"], 2) if "optimum" in metrics else "–",
            )
    return [labels, shapes]


def eyes_section(document: dict[str, Any]) -> list[Part]:
    """Whose eyes: rank correlations of ℓ with what other observers see."""
    config, rows = document["config"], document["result"]["rows"]
    how = "met exactly" if config["exact"] else "quick plans"
    parts: list[Part] = [
        f"{scenes_of(document)}, {config['levels']} levels of ℓ, {config['samples']} samples of "
        f"each, {how}. The dial is turned for the observer of a row; the cells hold the rank "
        "correlation of ℓ with the legibility that the observer of the column sees, its mean over "
        "scenes. “Dragan’s rises” is the share of scenes in which Dragan’s legibility, by code of "
        "its own, rises over ℓ = −1, −0.6, …, 1."
    ]
    for part, text in (("score", "The score L_p:"), ("posterior", "The posterior legibility:")):
        table = Table("turned for", *(f"seen by: {name}" for name in EYES), "Dragan’s rises")
        for name, row in rows.items():
            cells = (number(row["seen_by"][other][part]["mean"]) for other in EYES)
            table.add_row(EYES[name], *cells, percent(row["dragan_rises"]["mean"]))
        parts += [text, table]
    return parts
