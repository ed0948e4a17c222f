"""Writes ROS 1 bags that ROS 1's own tools read."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING

import lz4.frame

from pc2scan.errors import OutputError, UnwritableError
from pc2scan.files.compression import compress
from pc2scan.files.new_file import FreeIds, NewFile, WriteAhead
from pc2scan.model import StoredChunk, Writer, ros1_type

from .records import (
    BAG_HEADER,
    CHUNK,
    CHUNK_INFO,
    CONNECTION,
    FIRST_LINE,
    INDEX_DATA,
    OWN_FIELDS,
    PAIR,
    SECOND_NS,
    UINT32,
    UINT32_MAX,
    UINT64,
    USUAL_LAYOUT,
)

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence
    from pathlib import Path

    from pc2scan.model import Buffer, Connection
    from pc2scan.threads import Threads

_TRIPLE = struct.Struct("<III")


class Rosbag1Writer(Writer):
    """Writes a ROS 1 bag; see `pc2scan.model.Writer`.

    One chunk is held in memory, and a small record for each that was written. The same calls make the
    same bytes.

    Parameters
    ----------
    path
        Must not exist.
    compression
        ``none``, ``bz2`` or ``lz4``.
    chunk_size
        Bytes of records after which a chunk is closed. A message that is larger has a chunk of its own.

    Raises
    ------
    OutputError
        If the file exists or cannot be created; from every method, if it cannot be written.
    """

    def __init__(self, path: Path, compression: str = "lz4", chunk_size: int = 768 * 1024) -> None:
        self.path = path
        self._compression = compression
        self._chunk_size = chunk_size
        self._ids = FreeIds(0)
        self._connections: dict[int, bytes] = {}
        # The part of a message's record before its time, for each connection.
        self._prefixes: dict[int, bytes] = {}
        self._chunk_infos, self._chunk_count = bytearray(), 0
        self._declared: set[int] = set()
        self._chunk = _OpenChunk()
        self._ahead = WriteAhead()
        try:
            self._file = NewFile(path)
        except OSError as err:
            raise OutputError(f"cannot be created: {err.strerror}", path=path) from err
        self._file.put(FIRST_LINE, _pack_bag_header(0, 0, 0))

    def keep_ids(self, connections: Collection[Connection]) -> None:
        """Reserve the ids of these connections, so that they keep them when they are declared."""
        self._ids.keep([connection.id for connection in connections])

    def compress_ahead(self, pool: Threads) -> None:
        """Compress chunks on these threads from now on; the file stays the same."""
        self._ahead.use(pool)

    def add_connection(self, connection: Connection) -> int:
        """Declare a connection; equal ones stay apart.

        Parameters
        ----------
        connection
            With serialization ``ros1``. Its id matters only to `keep_ids`; a missing digest is written as ``*``; the
            definition is written byte for byte, and the type in ROS 1's spelling.

        Returns
        -------
        int
            The handle that `write` takes, and the connection's id in the bag: 0, 1, 2, ... where it keeps none.
        """
        handle = self._ids.take(connection.id)
        self._connections[handle] = _pack_connection(handle, connection)
        self._prefixes[handle] = UINT32.pack(handle).join(USUAL_LAYOUT[1:3])
        return handle

    def write(self, handle: int, log_time_ns: int, data: Buffer, publish_time_ns: int, sequence: int = 0) -> None:
        """Append a message; ``data`` is copied.

        Parameters
        ----------
        handle
            What `add_connection` returned.
        log_time_ns
            Nanoseconds since the epoch; whole seconds must fit 32 bits.
        data
            The serialised message.
        publish_time_ns, sequence
            Ignored: a ROS 1 bag has no place for them.

        Raises
        ------
        UnwritableError
            If the time is more than the format can hold; nothing is written then.
        OutputError
            If the file cannot be written.
        """
        del publish_time_ns, sequence
        seconds, nanoseconds = divmod(log_time_ns, SECOND_NS)
        if not 0 <= seconds <= UINT32_MAX:
            raise UnwritableError(
                f"log time {log_time_ns} ns is outside the 0 to {UINT32_MAX} s that a ROS 1 bag can hold",
                path=self.path,
            )
        declaration = b"" if handle in self._declared else self._connections[handle]
        needed = len(declaration) + USUAL_LAYOUT[0].size + len(data)
        if self._chunk.size + needed > self._chunk_size:
            self._flush()
        chunk = self._chunk
        if declaration:
            self._declared.add(handle)
            chunk.append(declaration)
        chunk.index.setdefault(handle, []).append((log_time_ns, chunk.size))
        chunk.append(self._prefixes[handle] + _TRIPLE.pack(seconds, nanoseconds, len(data)))
        if chunk.size + len(data) >= self._chunk_size:
            chunk.append(data)
            self._flush()
        else:
            # A view would keep the whole chunk in memory, and its bytes may change.
            chunk.append(bytes(data))

    def write_chunk(self, chunk: StoredChunk) -> None:
        """Append a whole chunk, compressed if it is not yet, with its index records."""
        self._flush()
        self._declared.update(chunk.index)
        if chunk.compression:
            self._ahead.put_ready(partial(self._put_chunk, chunk), len(chunk.stored))
        else:
            self._ahead.put(partial(self._compress_chunk, chunk), self._put_chunk, chunk.size)

    def finish(self) -> None:
        """Write the open chunk and the index, complete the header, and put everything on the disk."""
        self._flush()
        self._ahead.finish()
        index_pos = self._file.position
        self._file.put(*self._connections.values(), memoryview(self._chunk_infos))
        header = _pack_bag_header(index_pos, len(self._connections), self._chunk_count)
        self._file.replace(len(FIRST_LINE), header)
        self._file.finish()

    def abort(self) -> None:
        """Release the file; without its index it is not a bag."""
        self._ahead.cancel()
        self._file.abort()

    def _flush(self) -> None:
        """Queue the open chunk to be compressed and written, if it is not empty."""
        chunk = self._chunk
        if not chunk.parts:
            return
        self._chunk = _OpenChunk()
        if self._compression == "none":
            self._ahead.finish()
            self._put_chunk(StoredChunk("none", b"", chunk.size, 0, chunk.index), chunk.parts)
            return
        # Joined here: the last part may belong to the caller.
        whole = StoredChunk("", b"".join(chunk.parts), chunk.size, 0, chunk.index)
        self._ahead.put(partial(self._compress_chunk, whole), self._put_chunk, chunk.size)

    def _compress_chunk(self, chunk: StoredChunk) -> StoredChunk:
        """Compress a chunk; runs on any thread."""
        # LZ4 as ROS 1's own reader accepts it.
        pack = compress_lz4 if self._compression == "lz4" else partial(compress, self._compression)
        return replace(chunk, compression=self._compression, stored=pack(chunk.stored))

    def _put_chunk(self, chunk: StoredChunk, parts: Sequence[Buffer] = ()) -> None:
        """Write a chunk, whose records are in ``parts`` if there are any, and its index."""
        stored = parts or (chunk.stored,)
        self._chunk_infos += _pack_chunk_info(chunk, self._file.position)
        self._chunk_count += 1
        header = {"compression": chunk.compression.encode(), "size": UINT32.pack(chunk.size)}
        length = sum(len(part) for part in stored)
        self._file.put(_pack_header(CHUNK, header), UINT32.pack(length), *stored)
        self._file.put(*(_pack_index(handle, entries) for handle, entries in chunk.index.items()))


@dataclass(slots=True)
class _OpenChunk:
    """The chunk that is being filled; ``index`` has the log times and places of the messages of each connection."""

    parts: list[Buffer] = field(default_factory=list)
    size: int = 0
    index: dict[int, list[tuple[int, int]]] = field(default_factory=dict)

    def append(self, part: Buffer) -> None:
        self.parts.append(part)
        self.size += len(part)


def _pack_fields(fields: Mapping[str, bytes]) -> bytes:
    """Pack a header, its fields in alphabetical order as ROS 1's recorder has them."""
    packed = [name.encode("utf-8", "surrogateescape") + b"=" + fields[name] for name in sorted(fields)]
    return b"".join(UINT32.pack(len(item)) + item for item in packed)


def _pack_header(kind: int, fields: Mapping[str, bytes]) -> bytes:
    """Pack a record's header, with its length."""
    header = _pack_fields({"op": bytes((kind,)), **fields})
    return UINT32.pack(len(header)) + header


def _pack_record(kind: int, fields: Mapping[str, bytes], body: bytes) -> bytes:
    return _pack_header(kind, fields) + UINT32.pack(len(body)) + body


def _pack_time(time_ns: int) -> bytes:
    return PAIR.pack(*divmod(time_ns, SECOND_NS))


def _pack_bag_header(index_pos: int, connection_count: int, chunk_count: int) -> bytes:
    """Pack the bag header; padding gives it a fixed length."""
    fields = {
        "chunk_count": UINT32.pack(chunk_count),
        "conn_count": UINT32.pack(connection_count),
        "index_pos": UINT64.pack(index_pos),
    }
    # Header and padding have 4096 bytes together, without their two lengths.
    padding = 4096 - (len(_pack_header(BAG_HEADER, fields)) - 4)
    return _pack_record(BAG_HEADER, fields, b" " * padding)


def _pack_connection(identity: int, connection: Connection) -> bytes:
    """Pack a connection's record; the inverse of `parse_connection`."""
    metadata = {name: value for name, value in connection.metadata.items() if name not in OWN_FIELDS}
    header = {
        **metadata,
        "topic": connection.metadata.get("topic", connection.topic),
        "type": ros1_type(connection.msgtype),
        # ROS 1's md5sum for any type.
        "md5sum": connection.digest or "*",
    }
    if connection.callerid is not None:
        header["callerid"] = connection.callerid
    if connection.latching:
        header["latching"] = "1"
    elif "latching" in connection.metadata:
        header["latching"] = connection.metadata["latching"]
    body = {name: value.encode("utf-8", "surrogateescape") for name, value in header.items()}
    body["message_definition"] = connection.definition.data
    topic = connection.topic.encode("utf-8", "surrogateescape")
    return _pack_record(CONNECTION, {"conn": UINT32.pack(identity), "topic": topic}, _pack_fields(body))


def _pack_index(handle: int, entries: Sequence[tuple[int, int]]) -> bytes:
    """Pack the index record of one connection in one chunk: times and places, by time."""
    return _pack_record(
        INDEX_DATA,
        {"conn": UINT32.pack(handle), "count": UINT32.pack(len(entries)), "ver": UINT32.pack(1)},
        b"".join(_TRIPLE.pack(*divmod(time_ns, SECOND_NS), place) for time_ns, place in sorted(entries)),
    )


def _pack_chunk_info(chunk: StoredChunk, chunk_pos: int) -> bytes:
    """Pack the entry of a chunk in the bag's index."""
    start_ns, end_ns = chunk.span_ns()
    fields = {
        "chunk_pos": UINT64.pack(chunk_pos),
        "count": UINT32.pack(len(chunk.index)),
        "end_time": _pack_time(end_ns),
        "start_time": _pack_time(start_ns),
        "ver": UINT32.pack(1),
    }
    counts = (PAIR.pack(handle, len(entries)) for handle, entries in chunk.index.items())
    return _pack_record(CHUNK_INFO, fields, b"".join(counts))


def compress_lz4(data: Buffer) -> bytes:
    """Compress data into an LZ4 frame that ROS 1's own reader accepts: independent blocks, a checksum, and no size."""
    frame: bytes = lz4.frame.compress(
        data,
        block_size=lz4.frame.BLOCKSIZE_MAX1MB,
        block_linked=False,
        store_size=False,
        content_checksum=True,
    )
    return frame
