"""What other readers get of a damaged recording before they give up: the least that pc2scan must recover.

Only libraries other than pc2scan are used: ``mcap`` by the index and from end to end, and ``rosbags``.
"""

from __future__ import annotations

import io
from collections import Counter
from contextlib import suppress
from typing import TYPE_CHECKING, TypeAlias

from mcap.reader import NonSeekingReader, SeekingReader
from rosbags.rosbag1 import Reader

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

__all__ = ["Messages", "by_index", "in_order"]

#: How often there is a message of a topic, a log time and these bytes.
Messages: TypeAlias = "Counter[tuple[str, int, bytes]]"


def in_order(files: Mapping[str, bytes]) -> Messages:
    """Messages that are found by reading an MCAP file from end to end."""
    data = _only(files, ".mcap")
    return _taken(_mcap(NonSeekingReader, data)) if data is not None else Counter()


def by_index(files: Mapping[str, bytes], path: Path) -> Messages:
    """Messages that are found by the index; if it names a record twice, they are, too."""
    data = _only(files, ".mcap")
    if data is not None:
        return _taken(_mcap(SeekingReader, data))
    return _taken(_bag(path)) if _only(files, ".bag") is not None else Counter()


def _only(files: Mapping[str, bytes], suffix: str) -> bytes | None:
    ((name, data), *more) = files.items()
    return data if not more and name.endswith(suffix) else None


def _taken(messages: Iterator[tuple[str, int, bytes]]) -> Messages:
    """All messages up to the first error, whatever it is."""
    found: Messages = Counter()
    with suppress(Exception):
        for message in messages:
            found[message] += 1
    return found


def _mcap(kind: type[NonSeekingReader | SeekingReader], data: bytes) -> Iterator[tuple[str, int, bytes]]:
    for _, channel, message in kind(io.BytesIO(data)).iter_messages(log_time_order=False):
        yield channel.topic, message.log_time, message.data


def _bag(path: Path) -> Iterator[tuple[str, int, bytes]]:
    with Reader(path) as reader:
        for connection, log_time_ns, data in reader.messages():
            yield connection.topic, log_time_ns, bytes(data)
