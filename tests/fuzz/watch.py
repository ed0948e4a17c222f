"""What no input may cause: an exception that is a bug, a hang, or more memory than its bound."""

from __future__ import annotations

import signal
import sys
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from pc2scan.errors import Pc2ScanError, visible

if TYPE_CHECKING:
    from collections.abc import Iterator

__all__ = ["watched"]

_MARGIN_BYTES = 300_000_000
_STATUS, _CLEAR = Path("/proc/self/status"), Path("/proc/self/clear_refs")


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
        allowed = 4 * size + _MARGIN_BYTES
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


def _memory(name: str) -> int:
    lines = _STATUS.read_text().splitlines()
    return 1024 * int(next(line.split()[1] for line in lines if line.startswith(f"{name}:")))
