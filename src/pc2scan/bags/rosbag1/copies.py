"""Finds chunks of ROS 1 bags that can be copied as a whole."""

from __future__ import annotations

from operator import attrgetter
from typing import TYPE_CHECKING

from pc2scan.model import StoredChunk

from .lz4_frames import ros1_reads

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

    from pc2scan.bags.chunked.segments import Segment
    from pc2scan.model import Buffer, ChunkRule, RawMessage

    from .chunks import Places


def first_uses(segments: Collection[Segment], start_ns: int | None) -> dict[Segment, frozenset[int]]:
    """Find the connections that each chunk has to describe, because no earlier chunk does.

    ROS 1's ``rosbag reindex`` needs a connection's description in the chunk of its first message.

    Parameters
    ----------
    segments
        All segments to read.
    start_ns
        The start of the cut: a chunk across it may be written without its first messages.
    """
    uses = {}
    seen: frozenset[int] = frozenset()
    for segment in sorted(segments, key=attrgetter("start_ns", "offset")):
        ids = segment.connection_ids or frozenset()
        uses[segment] = ids - seen
        if start_ns is None or start_ns <= segment.start_ns:
            seen |= uses[segment]
    return uses


def whole_chunk(
    segment: Segment,
    stored: Buffer,
    records: Buffer,
    messages: Sequence[RawMessage],
    places: Places,
    rule: ChunkRule,
    needed: Collection[int],
) -> StoredChunk | None:
    """Return a chunk that was read as one to copy.

    Parameters
    ----------
    stored, records
        Its records, compressed and decompressed.
    messages, places
        Its messages and their offsets.
    needed
        The connections that it has to describe.

    Returns
    -------
    StoredChunk | None
        None if ``rule`` does not allow to copy it, its messages are not sorted by log time, or it contradicts the
        index. LZ4 frames that ROS 1's own reader refuses are compressed again.
    """
    if places.contradicts:
        return None
    times = [message.log_time_ns for message in messages]
    if not times or len(times) != len(places.messages) or times != sorted(times):
        return None
    if times[0] < segment.start_ns or segment.end_ns < times[-1]:
        return None
    if not places.described <= rule.connection_ids or not places.described.issuperset(needed):
        return None
    index: dict[int, list[tuple[int, int]]] = {}
    for message, place in zip(messages, places.messages, strict=True):
        index.setdefault(message.connection.id, []).append((message.log_time_ns, place))
    if not index.keys() <= rule.connection_ids:
        return None
    if segment.compression not in rule.compressions or (segment.compression == "lz4" and not ros1_reads(stored)):
        return StoredChunk("", records, len(records), 0, index)
    return StoredChunk(segment.compression, stored, len(records), 0, index)
