"""Reads the logs beside a database (write-ahead log ``-wal``, rollback journal ``-journal``), and merges them with it.

SQLite itself never opens them here: it would write to them, and delete a file that a journal names.
"""

from __future__ import annotations

import shutil
import struct
from typing import TYPE_CHECKING

from pc2scan.files.source import SourceFile, file_beside

from .journal import read_journal
from .page_log import PageLog
from .wal import read_write_ahead

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path


def page_size_of(head: bytes) -> int:
    """Return the page size in the first bytes of a database; SQLite's default if it is impossible."""
    (size,) = struct.unpack_from(">H", head.ljust(18, b"\0"), 16)
    size = 65536 if size == 1 else size
    return size if size >= 512 and size & (size - 1) == 0 else 4096


def side_logs(path: Path) -> list[PageLog]:
    """Read the logs beside a database, in the order in which they apply. The caller closes their files.

    Parameters
    ----------
    path
        The database.

    Raises
    ------
    OSError
        If the database cannot be read.
    RecordingError
        If a log cannot be read.
    """
    logs: list[PageLog] = []
    try:
        for suffix, read in (("-journal", read_journal), ("-wal", read_write_ahead)):
            side = _beside(path, suffix)
            if side is not None:
                with path.open("rb") as file:
                    page_size = page_size_of(file.read(100))
                logs.append(PageLog(SourceFile(side), page_size, path.stat().st_size // page_size))
                read(logs[-1])
    except BaseException:
        for log in logs:
            log.file.close()
        raise
    return logs


def missing_bytes(logs: Sequence[PageLog]) -> int | None:
    """Count the bytes that neither a database nor its logs have; None if no log has the database's size."""
    last = next((log for log in reversed(logs) if log.page_count is not None), None)
    if last is None or last.page_count is None:
        return None
    logged = {number for log in logs for number in log.places if last.stored < number <= last.page_count}
    return max(0, last.page_count - last.stored - len(logged)) * last.page_size


def write_merged(path: Path, logs: Sequence[PageLog], target: Path) -> None:
    """Write the database merged with its logs, which must be sound.

    Raises
    ------
    OSError
        If the database cannot be read, or the target not written.
    """
    shutil.copyfile(path, target)
    with target.open("r+b") as out:
        for log in logs:
            count, size = log.page_count, log.page_size
            if count is None:
                continue
            for number, place in log.places.items():
                if 0 < number <= count:
                    out.seek((number - 1) * size)
                    out.write(log.file.read(place, size))
            out.truncate(count * size)


def _beside(path: Path, suffix: str) -> Path | None:
    """Return a log that is not empty; for a database that is a link, also one beside its target, as SQLite does."""
    for place in (path, path.resolve()):
        side = file_beside(place, suffix)
        if side is not None and side.stat().st_size:
            return side
    return None
