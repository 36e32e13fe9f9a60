"""How fast it is, rendered from the JSON of `legibility bench`."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from ..report.wording import filled, threads_of

__all__ = ["bench_section"]


def bench_section(document: dict[str, Any]) -> str:
    """Times, the published configuration beside ours, the machine's limit, in Markdown."""
    config, result = document["config"], document["result"]
    parts = [_machine(config, result), _planning(result), _floor(result), _published(result)]
    parts += [_growth(result), _making(result), _processes(result)]
    if result["skipped"]:
        left_out = "; ".join(f"{what}: {why}" for what, why in result["skipped"].items())
        parts.append(filled(f"Left out: {left_out}."))
    return "\n\n".join([*parts, f"Measured by `{document['command']}`."])


def _machine(config: dict[str, Any], result: dict[str, Any]) -> str:
    machine = result["machine"]
    loads = [machine["load_before"], machine["load_after"]]
    busy = "" if None in loads else f", load {loads[0]:.1f} before and {loads[1]:.1f} after"
    device = "" if machine["device"] == "cpu" else f"; stage 1 on {machine['device']}"
    return filled(f"""\
{machine["cpu"]}, {machine["cores"]} cores, {threads_of(machine)}, PyTorch
{machine["torch"]}{device}{busy}. Medians with 95 % intervals over {config["rounds"]} rounds of
{config["seconds"]:g} s or one call, all that is compared in turns and after a warm-up. A plan is
all from scene to checked path.""")


def _planning(result: dict[str, Any]) -> str:
    batches = list(next(iter(result["models"].values()))["floor"])
    head = ["model", "backend", *(f"{int(b):,} at once [ms]" for b in batches)]
    head += [
        f"paths a second, {int(batches[-1]):,} at once",
        "one, on one core [ms]",
        "control step [ms]",
        "rollouts a second",
    ]
    rows = []
    for name, backend, own in _each(result):
        plans = own["growth"]["batch"]["ms"]
        rows.append([
            name, backend, *(_shown(plans[b]) for b in batches),
            f"{own['paths_per_second'][batches[-1]]:,.0f}", _shown(own["plan_one_core_ms"]),
            *(_shown(own.get(key)) for key in ("step_ms", "rollouts_per_second")),
        ])  # fmt: skip
    return _table(head, rows)


def _floor(result: dict[str, Any]) -> str:
    batches = list(next(iter(result["models"].values()))["floor"])
    head = ["model", "operations and memory of one path", "floor of one [ms]"]
    head += [f"floor of {int(batches[-1]):,} [ms]", "backend"]
    head += [f"{int(b):,} drawn [ms]" for b in (batches[0], batches[-1])]
    head += [f"over the floor, {int(b):,}" for b in batches]
    rows, limits = [], []
    for name, model in result["models"].items():
        first, last = model["floor"][batches[0]], model["floor"][batches[-1]]
        flops, moved = (model["limit"][key]["median"] for key in model["limit"])
        limits.append(f"{flops / 1e9:.3g} GFLOP/s and {moved / 1e9:.3g} GB/s")
        for backend, own in model["backends"].items():
            drawn = own["draw_ms"]
            rows.append([
                name, f"{first['flops'] / 1e6:.1f} MFLOP, {first['bytes'] / 1e6:.1f} MB",
                _short(first["ms"]), _short(last["ms"]), backend,
                _shown(drawn[batches[0]]), _shown(drawn[batches[-1]]),
                *(f"{own['over_floor'][b]:.1f}" for b in batches),
            ])  # fmt: skip
    text = filled(f"""\
The floor is the time that the operations of stage 1 need at least at the speed of a matrix product
here (by the quicker of PyTorch's libraries), or its numbers at that of a copy, whichever is longer
({"; ".join(limits)}, measured beside each model). Held against it is drawing alone, without the
scene's images before and the checks after it.""")
    return f"{text}\n\n{_table(head, rows)}"


def _published(result: dict[str, Any]) -> str:
    found = result["published"]
    parameters = found["parameters"]
    rows = [
        [
            f"{int(batch):,}",
            _shown(theirs),
            name,
            backend,
            _shown(ours[batch]),
            _shown(ratio[batch]),
        ]
        for batch, theirs in found["plan_ms"].items()
        for name, backends in found["ours_ms"].items()
        for backend, ours in backends.items()
        for ratio in [found["ratio"][name][backend]]
    ]
    head = ["paths", "published [ms]", "ours", "backend", "ours [ms]", "times faster"]
    text = filled(f"""\
The published configuration ({parameters["unet"] / 1e6:.1f} million parameters and an encoder of
{parameters["encoder"] / 1e6:.1f} million, {found["steps"]} steps) in turns with ours in the same
run; the ratio is that of each round. What differs: {"; ".join(found["differences"])}.""")
    return f"{text}\n\n{_table(head, rows)}"


def _growth(result: dict[str, Any]) -> str:
    axes = list(next(_each(result))[2]["growth"])
    rows = [
        [name, backend, *(_power(own["growth"][axis]) for axis in axes)]
        for name, backend, own in _each(result)
    ]
    text = filled("""\
How the time of planning grows: the exponent b of a power law sizeᵇ and the range that it was fitted
over; 1 is in proportion, 0 is not at all. Candidates are drawn in a scene whose archive is there
already.""")
    return f"{text}\n\n{_table(['model', 'backend', *axes], rows)}"


def _making(result: dict[str, Any]) -> str:
    head = ["dimension", "archive [ms]", "candidates a second", "growth with candidates"]
    head += ["scenes a second", "growth with scenes", "training steps a second", "in bf16"]
    head += ["memory [MB]"]
    rows = []
    for dim, archive in result["archive"].items():
        dataset, training = result["dataset"][dim], result["training"][dim]
        memory = [_peak(x["process"]) for x in (archive, dataset, training)]
        rows.append([
            f"{dim}-D", _shown(archive["archive_ms"]), _shown(archive["candidates_per_second"]),
            _power(archive["growth"]), _shown(dataset["scenes_per_second"]),
            _power(dataset["growth"]), _shown(training["steps_per_second"]),
            _shown(training["steps_per_second_bf16"]), " / ".join(memory),
        ])  # fmt: skip
    batch = next(iter(result["training"].values()))["batch"]
    text = filled(f"""\
What the weights are made from: archives and scenes of a dataset by one process, and steps of stage
1 with batches of {batch:,}. Memory is the peak above Python (archive) or Python with PyTorch
(dataset, training).""")
    return f"{text}\n\n{_table(head, rows)}"


def _processes(result: dict[str, Any]) -> str:
    steps = list(next(_each(result))[2]["process"]["ms"])
    names = {"above": "import torch", "import": "import legibility", "code": "the modulator's code"}
    names |= {"load": "weights"}
    head = ["model", "backend", *(f"{names.get(s, s)} [ms]" for s in steps)]
    head += ["memory after each of the last [MB]", "of rollouts [MB]"]
    rows = []
    for name, backend, own in _each(result):
        process = own["process"]
        memory = " / ".join(f"{m['median']:.0f}" for m in process["megabytes"].values()) or "–"
        moving = _peak(own["rollouts_process"]) if "rollouts_process" in own else "–"
        times = [f"{process['ms'][s]['median']:.0f}" for s in steps]
        rows.append([name, backend, *times, memory, moving])
    text = filled(f"""\
A fresh process that plans, step by step; memory is its peak above that of Python with PyTorch. By
itself `import legibility` takes {_shown(result["import_ms"])} ms, and the published configuration
{_peak(result["published"]["process"])} MB for one path.""")
    return f"{text}\n\n{_table(head, rows)}"


def _each(result: dict[str, Any]) -> Iterator[tuple[str, str, dict[str, Any]]]:
    for name, model in result["models"].items():
        for backend, own in model["backends"].items():
            yield name, backend, own


def _shown(figure: dict[str, Any] | None) -> str:
    """A median with its interval."""
    if figure is None:
        return "–"
    median, (low, high) = figure["median"], figure["interval"]
    return f"{_short(median)} ({_short(low)} to {_short(high)})"


def _short(value: float) -> str:
    """Three significant digits."""
    return f"{value:,.0f}" if value >= 100 else f"{value:#.3g}".rstrip(".")


def _power(curve: dict[str, Any]) -> str:
    sizes = list(curve["ms"])
    if curve["exponent"] is None:
        return "–"
    return f"{curve['exponent']:.2f} ({int(sizes[0]):,} to {int(sizes[-1]):,})"


def _peak(process: dict[str, Any]) -> str:
    """Most memory [MB] that a process had above its base."""
    return f"{max(process['megabytes'].values()):.0f}" if process["megabytes"] else "–"


def _table(head: list[str], rows: list[list[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)
