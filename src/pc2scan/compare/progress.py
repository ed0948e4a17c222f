"""Reports the progress of a comparison."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pc2scan.bags.reader import Reader

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from .match import OpenRecording

#: Pairs of messages between two reports.
_EVERY = 32


class Counted:
    """Reports the progress of the comparison of two recordings, topic by topic.

    Parameters
    ----------
    progress
        Takes the bytes read so far, the total bytes, and the messages compared so far. None: nothing is reported.
    sources
        The recordings that are compared. Each topic reads both of them.
    """

    def __init__(self, progress: Callable[[int, int, int], None] | None, sources: Sequence[OpenRecording]) -> None:
        self._progress = progress
        self._readers = [source for source in sources if isinstance(source, Reader)]
        self._size = sum(reader.summary.size_bytes for reader in self._readers)
        self._topics = 0
        self._topic = 0
        self._messages = 0
        self._before: list[int] = []

    def begin(self, topic: int, topics: int) -> None:
        """Begin with a topic; ``topics`` is the number of all topics."""
        self._topic, self._topics = topic, topics
        self._before = [reader.bytes_read for reader in self._readers]

    def count(self) -> None:
        """Count a pair of messages."""
        self._messages += 1
        if self._progress is None or self._messages % _EVERY:
            return
        # Some readers continue to count in each pass, others start again at 0.
        passed = [(reader.bytes_read, before) for reader, before in zip(self._readers, self._before, strict=True)]
        read = sum(now - before if now >= before else now for now, before in passed)
        done = self._topic * self._size + min(read, self._size)
        self._progress(done, max(1, self._topics) * self._size, self._messages)
