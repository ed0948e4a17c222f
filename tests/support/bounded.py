"""What no input may cause: an exception that is a bug, a hang, or more memory than its bound."""

from __future__ import annotations

import signal
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from pc2scan.errors import Pc2ScanError, visible
from support.command import Finished, environment

if TYPE_CHECKING:
    from collections.abc import Iterator

__all__ = ["MARGIN_BYTES", "run_bounded", "size_of", "watched"]

#: What a run may take besides four times its source: the interpreter, its libraries, and what is bounded by itself.
MARGIN_BYTES = 300_000_000

_STATUS, _CLEAR = Path("/proc/self/status"), Path("/proc/self/clear_refs")

#: The command in a process of its own, which leaves behind its highest resident memory as the kernel counted it.
_PROGRAM = """
import atexit, pathlib, sys
place = pathlib.Path(sys.argv.pop(1))
atexit.register(lambda: place.write_text(pathlib.Path("/proc/self/status").read_text()))
from pc2scan.cli import main
main()
"""


def run_bounded(
    folder: Path,
    command: str,
    source: Path,
    *args: str | Path,
    seconds: float = 120,
    size: int | None = None,
    cwd: Path | None = None,
) -> Finished:
    """Run ``pc2scan COMMAND SOURCE ARGS`` in a process of its own, and hold it to its bounds.

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
        cwd=cwd,
        check=False,
    )
    # Strictly: whatever a recording holds, the output is text.
    finished = Finished(done.returncode, done.stdout.decode(), done.stderr.decode())
    assert finished.status in (0, 1, 2, 3, 4), finished.stderr[-2000:]
    assert "Traceback" not in finished.stderr, finished.stderr[-2000:]
    assert finished.status in (0, 3, 4) or finished.stderr.startswith("error: "), finished.stderr[-2000:]
    if sys.platform == "linux":
        allowed = 4 * (size_of(source) if size is None else size) + MARGIN_BYTES
        peak = _memory("VmHWM", status)
        assert peak <= allowed, f"{peak / 1e6:.0f} MB of memory, allowed are {allowed / 1e6:.0f} MB"
    return finished


def size_of(source: Path) -> int:
    """Bytes of a file, or of the files in a directory."""
    files = source.rglob("*") if source.is_dir() else [source]
    return sum(file.stat().st_size for file in files if file.is_file())


class Hang(BaseException):
    """The input took too long; no ``except Exception`` on the way may swallow it."""


@contextmanager
def watched(size: int, seconds: int = 20) -> Iterator[None]:
    """Let pass what an input of ``size`` bytes may do: succeed, or raise one of pc2scan's own errors.

    Memory is checked where the kernel reports it (Linux), and hangs where there are signals.
    """
    before = signal.signal(signal.SIGALRM, _hang)
    signal.alarm(seconds)
    measured = _reset_peak()
    resident = _memory("VmRSS") if measured else 0
    try:
        yield
    except Pc2ScanError as err:
        # What the user would read must be text whatever the input was.
        f"{err} {visible(err.hint or '')}".encode()
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)
    if measured:
        taken = _memory("VmHWM") - resident
        allowed = 4 * size + MARGIN_BYTES
        assert taken <= allowed, f"{taken / 1e6:.0f} MB of memory for {size} bytes, allowed are {allowed / 1e6:.0f} MB"


def _hang(*_: object) -> None:
    raise Hang


def _reset_peak() -> bool:
    """Make the kernel forget the peak so far."""
    if sys.platform != "linux":
        return False
    try:
        _CLEAR.write_text("5")
    except OSError:
        return False
    return True


def _memory(name: str, status: Path = _STATUS) -> int:
    if not status.exists():
        pytest.fail("the command ended without leaving its measurement")
    lines = status.read_text().splitlines()
    return 1024 * int(next(line.split()[1] for line in lines if line.startswith(f"{name}:")))
