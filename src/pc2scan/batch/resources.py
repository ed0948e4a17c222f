"""How many recordings are converted at a time: as many as there are cores, and memory for."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

__all__ = ["available_bytes", "workers_for"]

#: A conversion with one thread takes less, unless chunks or clouds are very large.
_WORKER_BYTES = 300_000_000


def workers_for(count: int, cores: int, available: int | None) -> int:
    """Return how many worker processes convert so many recordings.

    Parameters
    ----------
    count
        Recordings.
    cores
        Processor cores.
    available
        Bytes of memory; None if nobody knows.
    """
    room = cores if available is None else available // _WORKER_BYTES
    return max(1, min(count, cores, room))


def available_bytes() -> int | None:
    """Return how much memory is free on this machine, or to the container that this process is in."""
    free: list[int] = []
    with suppress(OSError, ValueError, LookupError):
        lines = Path("/proc/meminfo").read_text("ascii").splitlines()
        free += [int(line.split()[1]) * 1024 for line in lines if line.startswith("MemAvailable:")]
    with suppress(OSError, ValueError):
        group = Path("/sys/fs/cgroup")
        limit, used = (int((group / f"memory.{name}").read_text("ascii")) for name in ("max", "current"))
        # What is cached of files is given back when it is needed.
        lines = (group / "memory.stat").read_text("ascii").splitlines()
        cached = sum(int(line.split()[1]) for line in lines if line.startswith(("active_file ", "inactive_file ")))
        free.append(max(0, limit - used + cached))
    return min(free, default=None)
