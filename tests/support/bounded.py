"""What no input may cause: an exception that is a bug, a hang, or more memory than its bound."""

from __future__ import annotations

import signal
import sys
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from pc2scan.errors import Pc2ScanError, visible
from support.command import Finished, run

if TYPE_CHECKING:
    from collections.abc import Iterator

#: What a run may take besides four times its source. With an interpreter and its libraries these are 300 MB.
_MARGIN_BYTES = 230_000_000

_STATUS, _CLEAR = Path("/proc/self/status"), Path("/proc/self/clear_refs")


def run_bounded(
    command: str, source: str | Path, *args: str | Path, cwd: Path | None = None, margin: int = _MARGIN_BYTES
) -> Finished:
    """Run ``pc2scan COMMAND SOURCE ARGS`` as `support.command.run` does, and hold it to its bounds.

    It must end in time and without a traceback, and take four times the memory of its source and a margin at most.
    """
    with _memory_bounded(size_of(Path(cwd or "", source)), margin):
        done = run(command, source, *args, cwd=cwd)
    assert done.status in (0, 1, 2, 3, 4), done.stderr[-2000:]
    assert "Traceback" not in done.stderr, done.stderr[-2000:]
    assert done.status in (0, 3, 4) or "\nerror: " in f"\n{done.stderr}", done.stderr[-2000:]
    return done


def size_of(source: Path) -> int:
    """Bytes of a file, or of the files in a directory; 0 of what cannot be there."""
    with suppress(OSError):
        files = source.rglob("*") if source.is_dir() else [source]
        return sum(file.stat().st_size for file in files if file.is_file())
    return 0


class Hang(BaseException):
    """The input took too long; no ``except Exception`` on the way may swallow it."""


@contextmanager
def watched(size: int) -> Iterator[None]:
    """Let pass what an input of ``size`` bytes may do: succeed, or raise one of pc2scan's own errors.

    Memory is checked where the kernel reports it (Linux), and hangs where there are signals.
    """
    before = signal.signal(signal.SIGALRM, _hang)
    signal.alarm(20)
    with _memory_bounded(size):
        try:
            with refused():
                yield
        finally:
            signal.alarm(0)
            signal.signal(signal.SIGALRM, before)


@contextmanager
def refused() -> Iterator[None]:
    """Let pass pc2scan's own errors; what the user would read must be text whatever the input was."""
    try:
        yield
    except Pc2ScanError as err:
        f"{err} {visible(err.hint or '')}".encode()


def _hang(*_: object) -> None:
    raise Hang


@contextmanager
def _memory_bounded(size: int, margin: int = _MARGIN_BYTES) -> Iterator[None]:
    measured = _reset_peak()
    resident = _memory(b"VmRSS") if measured else 0
    yield
    if measured:
        taken = _memory(b"VmHWM") - resident
        allowed = 4 * size + margin
        assert taken <= allowed, f"{taken / 1e6:.0f} MB of memory for {size} bytes, allowed are {allowed / 1e6:.0f} MB"


def _reset_peak() -> bool:
    """Make the kernel forget the peak so far."""
    if sys.platform != "linux":
        return False
    try:
        _CLEAR.write_text("5")
    except OSError:
        return False
    return True


def _memory(name: bytes) -> int:
    # As bytes, because the tests of every byte ask this a hundred thousand times.
    return 1024 * int(_STATUS.read_bytes().partition(b"\n" + name + b":")[2].split(maxsplit=1)[0])
