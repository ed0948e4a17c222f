"""Compares the index entries of a chunk with its messages: each entry has the time and the offset of a message.

Checksums do not detect wrong entries: ROS 1 bags have none, and a program may have changed messages and not the index.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    import struct
    from collections.abc import Sequence

    from pc2scan.model import Buffer

#: For more entries than this, NumPy is faster.
_FEW = 32


class EntryForm(NamedTuple):
    """The layout of a container's index entries, and of the messages that they point to.

    An entry begins with the log time, in the same eight bytes as in the message.

    Attributes
    ----------
    entry
        An entry: eight bytes of time, and the message's place in the chunk.
    identity
        The connection's id in a message.
    id_at, time_at
        Offsets of id and time in a message's record.
    """

    entry: struct.Struct
    identity: struct.Struct
    id_at: int
    time_at: int


class IndexCheck(NamedTuple):
    """The result of comparing index entries with their chunk, except for the number of messages.

    Entries are compared before the chunk is scanned: that is nearly free, since the scan finds the messages' headers
    in the processor's cache. After the scan it costs up to 6 % of a conversion of small messages.

    Attributes
    ----------
    problem
        What is wrong with the entries; None if nothing is.
    total
        How many there are; None if there is no index.
    astray
        How many of them match no message.
    """

    problem: str | None = None
    total: int | None = None
    astray: int = 0

    def trouble(self, found: int | None) -> str | None:
        """Return what is wrong, given the number of messages in the chunk; None if not all were counted."""
        if self.problem is None and self.total is not None and found is not None and self.total != found:
            return f"it has entries for {self.total} messages, the chunk has {found}"
        return self.problem

    def lost(self, found: int | None) -> int | None:
        """Return how many messages of a chunk in trouble are missing.

        That is unknown (None) if the chunk has fewer messages than entries, or if several entries match none: the
        chunk may be another, or have lost some and others twice.
        """
        if self.total is None:
            return 0
        fewer = found is None or found < self.total
        return None if fewer or self.astray > 1 else 0


def entries_astray(records: Buffer, groups: Sequence[tuple[int, Buffer]], form: EntryForm) -> int:
    """Count the wrong entries: those without a message of their connection and time, and repeated ones.

    Parameters
    ----------
    records
        The decompressed records of the chunk.
    groups
        Connection ids, each with all its entries.
    form
        The layout of the entries.
    """
    total = sum(len(entries) for _, entries in groups) // form.entry.size
    return (_few_astray if total <= _FEW else _many_astray)(records, groups, form)


def _few_astray(records: Buffer, groups: Sequence[tuple[int, Buffer]], form: EntryForm) -> int:
    entry, identity, id_at, time_at = form.entry, form.identity, form.id_at, form.time_at
    last = len(records) - max(id_at + identity.size, time_at + 8)
    # Usually the entries of a connection are in the order of its messages. Then no entry is repeated.
    for number, entries in groups:
        own = identity.pack(number)
        after = -1
        for time, place in entry.iter_unpack(entries):
            if not (
                after < place <= last
                and records[place + time_at : place + time_at + 8] == time
                and records[place + id_at : place + id_at + identity.size] == own
            ):
                return _many_astray(records, groups, form)
            after = place
    return 0


def _many_astray(records: Buffer, groups: Sequence[tuple[int, Buffer]], form: EntryForm) -> int:
    import numpy as np  # noqa: PLC0415  # only chunks of small messages need it

    size, last = form.entry.size, len(records) - max(form.id_at + form.identity.size, form.time_at + 8)
    if last < 0:
        return sum(len(entries) for _, entries in groups) // size
    entries = np.frombuffer(
        b"".join(part for _, part in groups), np.dtype([("time", "<u8"), ("place", f"<u{size - 8}")])
    )
    counts = [len(part) // size for _, part in groups]
    ids = np.repeat(np.array([number for number, _ in groups], np.uint32), counts)
    inside = entries["place"] <= last
    places = np.where(inside, entries["place"], 0).astype(np.int64)
    # Numbers at every offset of the chunk, aligned or not.
    times = np.ndarray((last + 1,), "<u8", records, form.time_at, (1,))[places]
    owners = np.ndarray((last + 1,), f"<u{form.identity.size}", records, form.id_at, (1,))[places]
    sound = int(np.count_nonzero(inside & (times == entries["time"]) & (owners == ids)))
    if sound < len(entries):
        return len(entries) - sound
    places.sort()
    return int(np.count_nonzero(places[1:] == places[:-1]))
