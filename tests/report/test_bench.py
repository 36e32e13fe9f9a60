from documents import bench

from legibility.report.bench import bench_section
from legibility.report.table import Table


def test_tables():
    section = bench_section(bench())
    planning, goals, motion, making, process = (p for p in section if isinstance(p, Table))
    assert [column.text for column in planning.columns] == [
        "model", "backend", "1 path [ms]", "1,024 paths [ms]", "1 path on one core [ms]"
    ]  # fmt: skip
    assert planning.rows == [
        ("m", "torch", "2.00 (1.00 to 4.00)", "4,000 (2,000 to 8,000)", "–"),
        ("m", "onnx", "1.00 (0.500 to 2.00)", "–", "0.500 (0.250 to 1.00)"),
    ]
    assert goals.rows[0] == ("m", "torch", "3.00 (1.50 to 6.00)", "2.00 (1.00 to 4.00)")
    assert motion.rows == process.rows == []
    assert making.rows == [("2", "64.0 (32.0 to 128)", "–", "–", "–", "16.0 (8.00 to 32.0)")]


def test_text():
    conditions, skipped, *_, last = bench_section(bench())
    assert isinstance(conditions, str)
    assert conditions.startswith("Z80, 1 cores, 1 thread, PyTorch 2.13, load 0.5.")
    assert skipped == "Skipped: onnxruntime is not installed."
    assert isinstance(last, str)
    assert "takes 100 (50.0 to 200) ms" in last
