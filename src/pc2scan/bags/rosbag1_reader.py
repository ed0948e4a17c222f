"""Reading ROS 1 bags, one chunk at a time."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pc2scan.errors import RecordingError

from .model import Summary
from .rosbag1_chunks import messages_in, payload
from .rosbag1_contents import read_index
from .rosbag1_records import DAMAGED, REINDEX, BagFile, Damaged
from .segments import in_time_order

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Sequence
    from concurrent.futures import Executor
    from pathlib import Path

    from .model import Attachment, Connection, Metadata, RawMessage
    from .segments import Segment

__all__ = ["Rosbag1Reader"]


class Rosbag1Reader:
    """An open ROS 1 bag; a `Reader`.

    Opening reads the index and the headers of the chunks. Chunks are read and decompressed one at a time,
    when their first message is due, and their messages are views into them.

    Parameters
    ----------
    path
        A bag of format 2.0.

    Raises
    ------
    RecordingError
        If it cannot be opened, is of format 1.x, encrypted or without an index, or contradicts itself. While
        messages are read, if a chunk does.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._file = BagFile(path)
        self._bytes_read = 0
        self._pool: Executor | None = None
        try:
            self._contents = read_index(self._file)
        except Damaged as err:
            self.close()
            raise RecordingError(f"its index cannot be read: {err}", path=path, hint=REINDEX) from err
        except BaseException:
            self.close()
            raise

    @property
    def path(self) -> Path:
        """Where it was opened."""
        return self._path

    @property
    def connections(self) -> Sequence[Connection]:
        """Every connection, in the order of the index; those that only chunks describe come last."""
        return tuple(self._contents.connections.values())

    @property
    def summary(self) -> Summary:
        """What the index tells."""
        segments = self._contents.segments
        return Summary(
            container="rosbag1",
            storage="",
            compression=tuple(sorted({segment.compression for segment in segments})),
            size_bytes=self._file.size,
            message_count=sum(connection.message_count or 0 for connection in self.connections),
            start_ns=min((segment.start_ns for segment in segments), default=None),
            end_ns=max((segment.end_ns for segment in segments), default=None),
        )

    @property
    def bytes_read(self) -> int:
        """Stored bytes of the chunks that the latest call of `messages` has read so far."""
        return min(self._bytes_read, self._file.size)

    def messages(
        self,
        connections: Collection[Connection] | None = None,
        start_ns: int | None = None,
        stop_ns: int | None = None,
    ) -> Iterator[RawMessage]:
        """Messages in the order of log time; those of one log time in the order of the file.

        Parameters
        ----------
        connections
            Only messages of these; None means all. Chunks without any are not read.
        start_ns, stop_ns
            Only messages with ``start_ns <= log_time_ns < stop_ns``.

        Yields
        ------
        RawMessage
            ``data`` is a view into the decompressed chunk, and keeps it alive.

        Raises
        ------
        RecordingError
            If a chunk cannot be read, decompressed or taken apart.
        """
        known = self._contents.connections
        ids = None if connections is None else frozenset(connection.id for connection in connections)
        wanted = {key: item if ids is None or key in ids else None for key, item in known.items()}
        self._bytes_read = 0

        def load(segment: Segment) -> list[RawMessage]:
            try:
                chunk = payload(self._file, segment)
                self._bytes_read += segment.length
                return messages_in(chunk, wanted, start_ns, stop_ns)
            except Damaged as err:
                raise RecordingError(
                    f"the chunk with data at byte {segment.offset} cannot be read: {err}",
                    path=self._path,
                    hint=DAMAGED,
                ) from err

        due = [segment for segment in self._contents.segments if segment.may_hold(ids, start_ns, stop_ns)]
        return in_time_order(due, load, pool=self._pool, path=self._path)

    def read_ahead(self, pool: Executor) -> None:
        """Let the following calls of `messages` read and decompress what comes next on these threads."""
        self._pool = pool

    def attachments(self) -> Iterator[Attachment]:
        """None: a ROS 1 bag has no attachments."""
        return iter(())

    def metadata(self) -> Iterator[Metadata]:
        """None: a ROS 1 bag has no metadata records."""
        return iter(())

    def close(self) -> None:
        """Release the file. Messages that were handed out stay valid."""
        self._file.close()
