"""Decides how many recordings are converted at a time: one for each core, as far as the memory is enough."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

#: Memory that is counted for a worker. A conversion with one thread takes less, unless chunks or clouds are very large.
_WORKER_BYTES = 300_000_000


def workers_for(count: int, cores: int, available: int | None) -> int:
    """Return the number of worker processes for a number of recordings.

    Parameters
    ----------
    count
        Number of recordings.
    cores
        Number of processor cores.
    available
        Free memory in bytes; None if unknown.
    """
    room = cores if available is None else available // _WORKER_BYTES
    return max(1, min(count, cores, room))


def available_bytes() -> int | None:
    """Return how many bytes of memory are free on this machine, or in the container that this process runs in."""
    free: list[int] = []
    with suppress(OSError, ValueError, LookupError):
        lines = Path("/proc/meminfo").read_text("ascii").splitlines()
        free += [int(line.split()[1]) * 1024 for line in lines if line.startswith("MemAvailable:")]
    with suppress(OSError, ValueError):
        group = Path("/sys/fs/cgroup")
        limit, used = (int((group / f"memory.{name}").read_text("ascii")) for name in ("max", "current"))
        # The cgroup counts the page cache as used, but the kernel frees it when memory is needed.
        lines = (group / "memory.stat").read_text("ascii").splitlines()
        cached = sum(int(line.split()[1]) for line in lines if line.startswith(("active_file ", "inactive_file ")))
        free.append(max(0, limit - used + cached))
    return min(free, default=None)
