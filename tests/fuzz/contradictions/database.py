"""What contradicts itself in an SQLite database of rosbag2, its log or its journal: SQLite itself is asked."""

from __future__ import annotations

import sqlite3
import struct
import tempfile
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING

from fuzz.contradictions.mcap import Facts
from fuzz.mutants.database import JOURNAL_MAGIC, journal_checksum, journal_segments, wal_checksums

if TYPE_CHECKING:
    from collections.abc import Iterator

    from fuzz.mutants.database import Segment

__all__ = ["facts_of"]


def facts_of(data: bytes, log: bytes = b"", journal: bytes = b"") -> Facts:
    """Read a database with what lies beside it; its contradictions are listed."""
    facts = Facts()
    told = facts.contradictions
    page_size = int.from_bytes(data[16:18], "big")
    page_size = 65_536 if page_size == 1 else page_size
    pages = int.from_bytes(data[28:32], "big")
    if not log and not journal and (page_size < 512 or len(data) != pages * page_size):
        told.append(f"the header declares {pages} pages of {page_size} bytes, the file has {len(data)}")
    told += _log(log)
    told += _journal(journal, page_size)
    with tempfile.TemporaryDirectory(prefix="pc2scan-oracle-") as folder:
        path = Path(folder, "a.db3")
        for suffix, content in (("", data), ("-wal", log), ("-journal", journal)):
            if content:
                Path(f"{path}{suffix}").write_bytes(content)
        try:
            with closing(sqlite3.connect(path)) as database:
                _read(database, facts)
        except (sqlite3.Error, UnicodeDecodeError, MemoryError, TypeError) as err:
            told.append(f"{type(err).__name__}: {err}")
    return facts


def _read(database: sqlite3.Connection, facts: Facts) -> None:
    told = facts.contradictions
    told += [text for (text,) in database.execute("PRAGMA integrity_check") if text != "ok"]
    names = {}
    for number, name, msgtype, serialization in database.execute(
        "SELECT id, name, type, serialization_format FROM topics"
    ):
        names[number] = name
        facts.topics.setdefault(name, set()).add((msgtype, serialization))
        facts.counts[name] += 0
    for topic_id, time_ns, kind in database.execute("SELECT topic_id, timestamp, typeof(data) FROM messages"):
        if topic_id not in names:
            told.append(f"a message of topic {topic_id}, which is not described")
            continue
        if not isinstance(time_ns, int) or kind != "blob":
            told.append(f"a message with timestamp {time_ns!r} and data of kind {kind}")
            continue
        facts.counts[names[topic_id]] += 1
        facts.times.append(time_ns)
    if time_order(database) != sorted(facts.times):
        told.append("the index of timestamps")


def time_order(database: sqlite3.Connection) -> list[int]:
    """The times as the index has them."""
    try:
        return [t for (t,) in database.execute("SELECT timestamp FROM messages INDEXED BY timestamp_idx ORDER BY 1")]
    except sqlite3.OperationalError:
        # There is none.
        return [t for (t,) in database.execute("SELECT timestamp FROM messages ORDER BY 1")]


def _log(log: bytes) -> Iterator[str]:
    """A write-ahead log: frames of its salts with sums that are wrong, or bytes behind the last whole frame."""
    if not log:
        return
    if len(log) < 32 or log[:3] != b"\x37\x7f\x06" or log[3] not in (0x82, 0x83):
        yield "the log has no header"
        return
    page_size = int.from_bytes(log[8:12], "big")
    if page_size not in [1 << n for n in range(9, 17)] or wal_checksums(log[:32], page_size)[24:32] != log[24:32]:
        yield "the log's header"
        return
    frame = 24 + page_size
    if (len(log) - 32) % frame:
        yield "the log does not end with a frame"
    sound = wal_checksums(log, page_size)
    salts, valid, committed = log[16:24], True, 0
    for start in range(32, len(log) - frame + 1, frame):
        valid = valid and log[start + 8 : start + 24] == salts + sound[start + 16 : start + 24]
        if not valid and log[start + 8 : start + 16] == salts:
            yield f"the frame at {start} is of this log, and cannot be read"
        committed += valid and log[start + 4 : start + 8] != bytes(4)


def _journal(journal: bytes, page_size: int) -> Iterator[str]:
    """A rollback journal: pages whose checksums are wrong, or that its header does not count."""
    if not journal or not any(journal[:28]):
        # Zeros say that the transaction was committed.
        return
    if len(journal) < 28 or journal[:8] != JOURNAL_MAGIC:
        yield "the journal has no header"
        return
    _, _, _, _, size = struct.unpack_from(">IIIII", journal, 8)
    segments = journal_segments(journal)
    if size != page_size or not segments:
        yield "the journal's header"
        return
    for segment in segments:
        (pages,) = struct.unpack_from(">I", journal, segment.start + 8)
        if pages != len(segment.pages):
            yield f"the journal declares {pages} pages at {segment.start}, and has {len(segment.pages)}"
        for start in segment.pages:
            if not _journal_page(journal, start, segment):
                yield f"the checksum of the journal's page at {start}"
    last = segments[-1]
    if _journal_page(journal, last.stop, last):
        yield f"the journal has more pages than the {len(last.pages)} that it declares"


def _journal_page(journal: bytes, start: int, segment: Segment) -> bool:
    """Whether a page with a right checksum begins here."""
    end = start + 4 + segment.page_size
    content = journal[start + 4 : end]
    return journal[end : end + 4] == struct.pack(">I", journal_checksum(content, segment.nonce))
