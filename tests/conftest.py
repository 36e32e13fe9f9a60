import os
import platform
import re
from pathlib import Path

import pytest
from hypothesis import settings

settings.register_profile("legibility", derandomize=True, deadline=None, max_examples=50)
settings.load_profile("legibility")

_RESTRICTED_BY = ("ATEN_CPU_CAPABILITY", "ONEDNN_MAX_CPU_ISA", "OPENBLAS_CORETYPE")


def pytest_report_header() -> str:
    """Name the processor and its instruction sets, because rounding depends on them."""
    import torch

    information = Path("/proc/cpuinfo")
    text = information.read_text() if information.exists() else ""
    model = re.search(r"^model name\s*:\s*(.+)$", text, re.MULTILINE)
    name = model[1] if model else platform.processor() or platform.machine()
    sets = set(re.findall(r"\b(?:sse4_2|avx2|avx512f|amx_tile|asimd|sve)\b", text))
    limits = [f"{key}={os.environ[key]}" for key in _RESTRICTED_BY if key in os.environ]
    return "; ".join([
        f"processor: {name}, {os.cpu_count()} cores, {' '.join(sorted(sets))}",
        f"PyTorch {torch.__version__} with {torch.backends.cpu.get_cpu_capability()}",
        *limits,
    ])  # fmt: skip


@pytest.fixture(scope="module")
def coarsely():
    """Archives are built from fewer curves, for these tests alone."""
    from legibility.motion import archive as archives

    built = archives._built

    def small(*args):
        *start, random, most, patience = (*args, 4096, 65_536, 0.002)[:8]
        return built(*start, random, min(most, 12_288), patience)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(archives, "_built", small)
        yield
    for cache in (archives.scene_archive, archives._geometry):
        cache.cache_clear()
