"""The real command on a hostile recording: it must end in time, within its memory, and without a traceback."""

from __future__ import annotations

import subprocess
import sys
from typing import TYPE_CHECKING

import pytest

from support.command import Finished, environment

if TYPE_CHECKING:
    from pathlib import Path

__all__ = ["MARGIN_BYTES", "run_bounded", "size_of"]

#: What a run may take besides four times its source: the interpreter, its libraries, and what is bounded by itself.
MARGIN_BYTES = 300_000_000

#: The command in a process of its own, which leaves behind its highest resident memory as the kernel counted it.
_PROGRAM = """
import atexit, pathlib, sys
place = pathlib.Path(sys.argv.pop(1))
atexit.register(lambda: place.write_text(pathlib.Path("/proc/self/status").read_text()))
from pc2scan.cli import main
main()
"""


def run_bounded(
    folder: Path, command: str, source: Path, *args: str | Path, seconds: float = 30, size: int | None = None
) -> Finished:
    """Run ``pc2scan COMMAND SOURCE ARGS`` and hold it to its bounds.

    Parameters
    ----------
    folder
        For the measurement; not where the source is.
    seconds
        Many times what it should take: machines are slow at times.
    size
        Bytes that the memory is measured against; None means the source's.
    """
    status = folder / "status.txt"
    done = subprocess.run(
        [sys.executable, "-c", _PROGRAM, str(status), command, str(source), *map(str, args)],
        capture_output=True,
        timeout=seconds,
        env=environment(),
        check=False,
    )
    # Strictly: whatever a recording holds, the output is text.
    finished = Finished(done.returncode, done.stdout.decode(), done.stderr.decode())
    assert finished.status in (0, 1, 2, 3, 4), finished.stderr[-2000:]
    assert "Traceback" not in finished.stderr, finished.stderr[-2000:]
    assert finished.status in (0, 3, 4) or finished.stderr.startswith("error: "), finished.stderr[-2000:]
    if sys.platform == "linux":
        allowed = 4 * (size_of(source) if size is None else size) + MARGIN_BYTES
        peak = _peak_bytes(status)
        assert peak <= allowed, f"{peak / 1e6:.0f} MB of memory, allowed are {allowed / 1e6:.0f} MB"
    return finished


def size_of(source: Path) -> int:
    """Bytes of a file, or of the files in a directory."""
    files = source.rglob("*") if source.is_dir() else [source]
    return sum(file.stat().st_size for file in files if file.is_file())


def _peak_bytes(status: Path) -> int:
    if not status.exists():
        pytest.fail("the command ended without leaving its measurement")
    lines = status.read_text().splitlines()
    return 1024 * int(next(line.split()[1] for line in lines if line.startswith("VmHWM:")))
