from legibility.bench.tables import bench_section, bench_tables


def row(metric, median, **conditions):
    return {
        "metric": metric, **conditions,
        "median": median, "low": median / 2, "high": 2 * median, "calls": 9,
    }  # fmt: skip


TORCH = {"model": "plane", "backend": "torch"}
ONNX = {"model": "plane", "backend": "onnx"}
DOCUMENT = {
    "command": "legibility bench",
    "config": {
        "rounds": 3, "seconds": 0.2, "batches": [1, 1024], "goals": [2, 4],
        "robots": 256, "arms": 16,
    },
    "result": {
        "machine": {
            "cpu": "Z80", "cores": 1, "threads": 1, "device": "cpu", "torch": "2.13", "load": 0.5,
        },
        "skipped": ["onnxruntime is not installed"],
        "measurements": [
            row("plan_ms", 2, **TORCH, batch=1, goals=4),
            row("plan_ms", 4000, **TORCH, batch=1024, goals=4),
            row("plan_ms", 3, **TORCH, batch=1, goals=2),
            row("plan_ms", 1, **ONNX, batch=1, goals=4),
            row("plan_one_core_ms", 0.5, **ONNX),
            row("archive_ms", 64.04, dim=2),
            row("training_steps_per_second", 16, dim=2, precision="bf16"),
            row("import_ms", 100),
        ],
    },
}  # fmt: skip


def test_tables():
    planning, goals, motion, making, process = bench_tables(DOCUMENT)
    head = ["model", "backend", "1 path [ms]", "1,024 paths [ms]", "1 path on one core [ms]"]
    assert planning[1] == head
    assert planning[2] == [
        ["plane", "torch", "2.00 (1.00 to 4.00)", "4,000 (2,000 to 8,000)", "–"],
        ["plane", "onnx", "1.00 (0.500 to 2.00)", "–", "0.500 (0.250 to 1.00)"],
    ]
    assert planning[3][0].startswith("Z80, 1 cores, 1 thread, PyTorch 2.13, load 0.5.")
    assert planning[3][1] == "Skipped: onnxruntime is not installed."
    assert goals[2][0] == ["plane", "torch", "3.00 (1.50 to 6.00)", "2.00 (1.00 to 4.00)"]
    assert motion[2] == process[2] == []
    archive, steps = "64.0 (32.0 to 128)", "16.0 (8.00 to 32.0)"
    assert making[2] == [["2", archive, "–", "–", "–", steps]]
    assert "takes 100 (50.0 to 200) ms" in process[3][0]


def test_section():
    section = bench_section(DOCUMENT)
    assert "| 2 goals [ms] | 4 goals [ms] |\n| --- | --- | --- | --- |\n| plane |" in section
    assert section.endswith("\n\nMeasured by `legibility bench`.")
