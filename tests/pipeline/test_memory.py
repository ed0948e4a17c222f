from __future__ import annotations

import ctypes
import platform
import subprocess
import sys
from typing import Any

import pytest

from pc2scan.pipeline import memory

FAULTS = """
import resource
{prepare}
faults = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
for _ in range(50):
    parts = [bytearray(b"x") * (12 << 20) for _ in range(2)]
    del parts
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - faults)
"""


def faults(prepare: str) -> int:
    done = subprocess.run(
        [sys.executable, "-c", FAULTS.format(prepare=prepare)], capture_output=True, text=True, timeout=60, check=True
    )
    return int(done.stdout)


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="only glibc is told")
def test_freed_memory_is_used_again() -> None:
    told = "from pc2scan.pipeline.memory import keep_freed_memory\nassert keep_freed_memory()"
    # A page is 4 KiB at least: 24 MiB fifty times, or only once.
    assert 3 * faults(told) < faults("")


@pytest.mark.parametrize("missing", ["library", "function"])
def test_other_c_libraries_are_left_alone(missing: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def library(_: Any) -> object:
        if missing == "library":
            raise OSError
        return object()

    monkeypatch.setattr(platform, "libc_ver", lambda: ("glibc", "2.36"))
    monkeypatch.setattr(ctypes, "CDLL", library)
    assert not memory.keep_freed_memory.__wrapped__()
    monkeypatch.setattr(platform, "libc_ver", lambda: ("", ""))
    assert not memory.keep_freed_memory.__wrapped__()
