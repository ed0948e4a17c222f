from __future__ import annotations

import ctypes
import gc
import platform
import subprocess
import sys
from types import SimpleNamespace
from typing import Any

import pytest

from pc2scan import memory
from pc2scan.cli import main

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
    told = "from pc2scan.memory import keep_freed_memory\nassert keep_freed_memory()"
    # A page is 4 KiB at least: 24 MiB fifty times, or only once.
    assert 3 * faults(told) < faults("")


def test_the_command_keeps_freed_memory(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    calls: list[int] = []
    monkeypatch.setattr(memory, "keep_freed_memory", lambda: calls.append(1))
    monkeypatch.setattr(sys, "argv", ["pc2scan", "--version"])
    monkeypatch.setattr(gc, "set_threshold", lambda _: None)
    monkeypatch.setattr(gc, "freeze", lambda: None)
    with pytest.raises(SystemExit):
        main()
    assert capsys.readouterr().out.startswith("pc2scan ")
    assert calls == [1]


@pytest.mark.parametrize("missing", ["library", "handle", "glibc", "function"])
def test_other_c_libraries_are_left_alone(missing: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def library(_: Any) -> object:
        if missing in {"library", "handle"}:
            raise OSError if missing == "library" else TypeError
        # Without glibc's own function, calling mallopt would raise.
        return SimpleNamespace(**{"mallopt" if missing == "glibc" else "gnu_get_libc_version": 1})

    monkeypatch.setattr(ctypes, "CDLL", library)
    assert not memory.keep_freed_memory()
