from documents import bench

from legibility.report.sections import bench_section


def test_every_measurement_is_a_row():
    document = bench()
    *_, table = bench_section(document)
    assert len(table.rows) == len(document["result"]["measurements"])
    assert table.rows[0] == (
        "plan_ms", "m", "torch", "batch 1, goals 4", "2.00", "1.00 to 4.00"
    )  # fmt: skip
    assert table.rows[1][3:] == ("batch 1024, goals 4", "4,000", "2,000 to 8,000")
    assert table.rows[5][3:5] == ("mode exact, scene known", "0.750")
    assert table.rows[6] == ("archive_ms", "", "", "dim 2", "64.0", "32.0 to 128")
    assert table.rows[7][3] == "dim 2, precision bf16"
    assert table.rows[8] == ("import_ms", "", "", "", "100", "50.0 to 200")


def test_text():
    conditions, skipped, _ = bench_section(bench())
    assert isinstance(conditions, str)
    assert conditions.startswith("Z80, 1 cores, 1 thread, PyTorch 2.13, load 0.5; training on cpu.")
    assert skipped == "Skipped: onnxruntime is not installed."
