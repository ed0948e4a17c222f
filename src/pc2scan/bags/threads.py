"""The threads of a conversion, and how much may be held for them ahead of its turn."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

__all__ = ["Threads"]


class Threads(ThreadPoolExecutor):
    """A pool that says how much work it can be given ahead, so that memory grows with the threads and nothing else.

    Parameters
    ----------
    jobs
        How many threads.

    Attributes
    ----------
    ahead
        Pieces of work that may wait, or have a result that waits for its turn.
    ahead_bytes
        Bytes that these may take; one larger piece may always.
    """

    def __init__(self, jobs: int) -> None:
        super().__init__(jobs, thread_name_prefix="pc2scan")
        self.ahead = 4 * jobs
        self.ahead_bytes = jobs << 23
