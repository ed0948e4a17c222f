"""Every valid form of an MCAP file is read without damage, with what the mcap library reads.

In all combinations of what the specification leaves to writers, as its conformance files have them: chunks, indexes,
statistics, repeated schemas and channels, summary offsets, and bytes after the known fields of records. Beyond these:
compressions, several chunks, records of unknown kinds, and files without CRCs.
"""

from __future__ import annotations

import io
from contextlib import closing
from dataclasses import replace
from itertools import product
from typing import TYPE_CHECKING, Any, NamedTuple

import lz4.frame
import mcap.records
import pytest
from mcap.data_stream import RecordBuilder
from mcap.reader import NonSeekingReader, SeekingReader
from mcap.records import Attachment, Channel, Footer, Message, MessageIndex, Metadata, Schema, Statistics
from mcap.writer import CompressionType, IndexType, Writer

from pc2scan.bags.mcap.read import McapReader
from pc2scan.cli.in_process import run_command
from support import stepped
from support.mcap_files import BODY, encoded, raw_channel, raw_chunk, raw_file, raw_message, record, zstd

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from pathlib import Path

    Item = Schema | Channel | Message | Attachment | Metadata
    #: Messages, attachments and metadata records.
    Content = tuple[list[Any], list[Any], list[Any]]


def message(channel: int, sequence: int, log_time: int) -> Message:
    return Message(
        channel_id=channel, log_time=log_time, data=bytes([1, 2, 3]), publish_time=log_time + 1, sequence=sequence
    )


def schema(number: int) -> Schema:
    return Schema(id=number, name=f"Example{number}", encoding="c", data=bytes([4, 5, 6]))


def channel(number: int, schema_id: int) -> Channel:
    metadata = {"foo": "bar"} if schema_id else {}
    return Channel(id=number, topic=f"/topic{number}", message_encoding="a", metadata=metadata, schema_id=schema_id)


ATTACHMENT = Attachment(create_time=1, log_time=2, name="file", media_type="application/octet-stream", data=b"\1\2\3")
METADATA = Metadata(name="myMetadata", metadata={"foo": "bar"})
TEN = [message(1, number, time) for number, time in enumerate((1, 3, 2, 4, 4, 6, 5, 8, 9, 10))]

#: What the files hold.
CONTENTS: dict[str, Sequence[Item]] = {
    "nothing": [],
    "a message without a schema": [channel(1, 0), message(1, 10, 2)],
    "a message": [schema(1), channel(1, 1), message(1, 10, 2)],
    "an attachment": [ATTACHMENT],
    "metadata": [METADATA],
    "ten messages": [schema(1), channel(1, 1), *TEN],
    "everything": [
        schema(1),
        channel(1, 1),
        channel(2, 0),
        *(replace(each, channel_id=1 + each.sequence % 2) for each in TEN[:6]),
        ATTACHMENT,
        schema(2),
        channel(3, 2),
        *(replace(each, channel_id=3, log_time=each.log_time + 20) for each in TEN),
        METADATA,
        replace(ATTACHMENT, name="another"),
        message(1, 11, 40),
    ],
}

#: Bytes after the fields of a record that a later specification may define; its records, and private ones.
PADDING = b"\x01\xff\xff"
UNKNOWN = record(0x10, b"later") + record(0x7F, b"") + record(0x80, b"private") + record(0xFF, b"\x05" * 9)


class Variant(NamedTuple):
    """How a file is written: options of the library's writer, and what it does not write of itself.

    Attributes
    ----------
    padding
        Which records have bytes after their fields: none, those outside chunks, or those in chunks, too.
    unknown
        Whether there are records of unknown kinds.
    """

    options: dict[str, Any]
    padding: str
    unknown: bool

    @property
    def can_seek(self) -> bool:
        """Whether the library's seeking reader finds the messages."""
        found = IndexType.CHUNK in self.options["index_types"] or not self.options["use_chunking"]
        return bool(self.options["repeat_schemas"] and self.options["repeat_channels"] and found)


def variants(content: Sequence[Item]) -> Iterator[Variant]:
    """Every way to write a content, as far as it makes a difference."""
    kinds = {type(item) for item in content}
    number = 0
    for flags in product((False, True), repeat=8):
        chunked, messages, chunks, extras, schemas, channels, statistics, offsets = flags
        if (
            ((chunked or channels) and Channel not in kinds)
            or ((messages or chunks) and not chunked)
            or (schemas and Schema not in kinds)
            or (extras and not kinds & {Attachment, Metadata})
            or (offsets and not any(flags[2:7]))
        ):
            continue
        indexes = IndexType.NONE
        for wanted, kind in (
            (messages, IndexType.MESSAGE),
            (chunks, IndexType.CHUNK),
            (extras, IndexType.ATTACHMENT | IndexType.METADATA),
        ):
            indexes |= kind if wanted else IndexType.NONE
        for padding in ("", "outside chunks", "everywhere") if chunked else ("", "outside chunks"):
            number += 1
            options = {
                "chunk_size": 150,
                "use_chunking": chunked,
                "index_types": indexes,
                "repeat_schemas": schemas,
                "repeat_channels": channels,
                "use_statistics": statistics,
                "use_summary_offsets": offsets,
                # What no other choice depends on alternates.
                "compression": list(CompressionType)[number // 2 % 3],
                "enable_crcs": number % 5 != 0,
                "enable_data_crcs": number % 5 != 0,
            }
            yield Variant(options, padding, number % 2 == 0)


class ChunkBuilder(RecordBuilder):
    """Where the records of a chunk are written."""


def written(original: Callable[[Any, RecordBuilder], None], variant: Variant) -> Callable[..., None]:
    """A record's method to write itself, in a variant."""

    def write(self: Any, stream: RecordBuilder) -> None:
        builder = RecordBuilder()
        original(self, builder)
        data = builder.end()  # type: ignore[no-untyped-call]
        # "The Footer and Message records will not be extended."
        is_padded = variant.padding == "everywhere" or (variant.padding and not isinstance(stream, ChunkBuilder))
        if is_padded and not isinstance(self, Message | Footer):
            data = record(data[0], data[9:] + PADDING)
        stream.write(data)
        if variant.unknown and isinstance(self, Schema | Channel | Message | Statistics):
            stream.write(UNKNOWN)

    return write


def file_of(content: Sequence[Item], variant: Variant) -> bytes:
    """Write a content in a way."""
    file = io.BytesIO()
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr("mcap._chunk_builder.RecordBuilder", ChunkBuilder)
        for kind in mcap.records.McapRecord.__subclasses__():
            patched.setattr(kind, "write", written(kind.write, variant))
        writer = Writer(file, **variant.options)
        writer.start("", "")
        for item in content:
            # Their numbers are their places.
            if isinstance(item, Schema):
                writer.register_schema(item.name, item.encoding, item.data)
            elif isinstance(item, Channel):
                writer.register_channel(item.topic, item.message_encoding, item.schema_id, item.metadata)
            elif isinstance(item, Message):
                writer.add_message(item.channel_id, item.log_time, item.data, item.publish_time, item.sequence)
            elif isinstance(item, Attachment):
                writer.add_attachment(item.create_time, item.log_time, item.name, item.media_type, item.data)
            else:
                writer.add_metadata(item.name, item.metadata)
        writer.finish()  # type: ignore[no-untyped-call]
    return file.getvalue()


def expected(content: Sequence[Item]) -> Content:
    """What is in a file, by what it was made of."""
    schemas = {item.id: item for item in content if isinstance(item, Schema)}
    channels = {item.id: item for item in content if isinstance(item, Channel)}
    messages = []
    for item in content:
        if isinstance(item, Message):
            own = channels[item.channel_id]
            messages.append(row(schemas.get(own.schema_id), own, item))
    return (
        sorted(messages, key=by_time),
        [attachment(item) for item in content if isinstance(item, Attachment)],
        [(item.name, item.metadata) for item in content if isinstance(item, Metadata)],
    )


def row(of: Schema | None, on: Channel, item: Message) -> tuple[Any, ...]:
    kind = (of.name, of.encoding, of.data) if of else ("", "", b"")
    numbers = (item.log_time, item.publish_time, item.sequence)
    return (*numbers, on.topic, on.message_encoding, on.metadata, *kind, item.data)


def attachment(item: Attachment) -> tuple[Any, ...]:
    return item.name, item.media_type, item.log_time, item.create_time, item.data


def by_time(row: tuple[Any, ...]) -> int:
    return int(row[0])


def ours(path: Path, **options: Any) -> Content:
    with closing(McapReader(path, **options)) as reader:
        messages = [
            (
                *(m.log_time_ns, m.publish_time_ns, m.sequence, m.connection.topic, m.connection.serialization),
                *(m.connection.metadata, m.connection.msgtype, m.connection.definition.encoding),
                *(m.connection.definition.data, bytes(m.data)),
            )
            for m in reader.messages()
        ]
        attachments = [
            (a.name, a.media_type, a.log_time_ns, a.create_time_ns, bytes(a.data)) for a in reader.attachments()
        ]
        return messages, attachments, [(m.name, m.entries) for m in reader.metadata()]


def theirs(kind: type[NonSeekingReader | SeekingReader], data: bytes) -> Content:
    messages = [row(*found) for found in kind(io.BytesIO(data)).iter_messages(log_time_order=False)]
    return (
        sorted(messages, key=by_time),
        [attachment(item) for item in kind(io.BytesIO(data)).iter_attachments()],
        [(item.name, item.metadata) for item in kind(io.BytesIO(data)).iter_metadata()],
    )


@pytest.mark.parametrize(("name", "step"), stepped(CONTENTS, 5))
def test_every_valid_form_is_read_without_damage(name: str, step: int, tmp_path: Path) -> None:
    content = CONTENTS[name]
    sound = expected(content)
    path = tmp_path / "a.mcap"
    for variant in list(variants(content))[::step]:
        data = file_of(content, variant)
        path.write_bytes(data)
        # Any damage would be an error.
        assert ours(path, strict=True) == sound, variant
        # The library does not skip what follows the fields of a record in a chunk.
        if variant.padding != "everywhere":
            assert theirs(NonSeekingReader, data) == sound, variant
            if variant.can_seek:
                assert theirs(SeekingReader, data)[0] == sound[0], variant


@pytest.mark.parametrize(("name", "step"), stepped(CONTENTS, 5))
def test_every_valid_form_that_is_cut_off_is_recovered(name: str, step: int, tmp_path: Path) -> None:
    content = CONTENTS[name]
    sound = expected(content)
    path = tmp_path / "a.mcap"
    for variant in list(variants(content))[::step]:
        # Without the footer.
        path.write_bytes(file_of(content, variant)[:-37])
        assert ours(path) == sound, variant


@pytest.mark.parametrize("padding", ["outside chunks", "everywhere"])
def test_padded_records_are_no_damage_to_the_command(padding: str, tmp_path: Path) -> None:
    content = CONTENTS["everything"]
    *_, variant = (each for each in variants(content) if each.padding == padding and each.unknown)
    source, target = tmp_path / "a.mcap", tmp_path / "b.mcap"
    source.write_bytes(file_of(content, variant))
    ended = run_command(["repair", str(source), "-o", str(target)])
    assert (ended.status, "damaged" in ended.messages) == (0, False), ended.messages
    assert ours(target, strict=True) == expected(content)


def chunk_of_nothing(compression: str, packed: bytes) -> bytes:
    return raw_chunk(b"", compression=compression, packed=packed, message_start_time=0, message_end_time=0)


INDEX = encoded(MessageIndex(channel_id=1, records=[(1, len(raw_channel()))]))

#: Data sections with one message, of forms that few writers use.
RARE = {
    "an empty chunk": [chunk_of_nothing("", b""), raw_chunk(BODY)],
    "an empty lz4 frame": [chunk_of_nothing("lz4", lz4.frame.compress(b"")), raw_chunk(BODY)],
    "an empty zstd frame": [chunk_of_nothing("zstd", zstd(b"")), raw_chunk(BODY)],
    "an empty zstd frame without a size": [chunk_of_nothing("zstd", zstd(b"", size=False)), raw_chunk(BODY)],
    "no bytes of zstd": [chunk_of_nothing("zstd", b""), raw_chunk(BODY)],
    "zstd without a size": [raw_chunk(BODY, compression="zstd", packed=zstd(BODY, size=False))],
    "a chunk of declarations": [
        raw_chunk(raw_channel(), message_start_time=0, message_end_time=0),
        raw_chunk(raw_message()),
    ],
    "a schema without a number": [encoded(Schema(id=0, name="", encoding="", data=b"")), raw_chunk(BODY)],
    "an empty message index": [raw_chunk(BODY), INDEX, encoded(MessageIndex(channel_id=9, records=[]))],
    "unknown records around a message index": [raw_chunk(BODY), record(0x80, b"a"), INDEX, record(0x20, b"b")],
    "unknown records between messages": [raw_channel(), record(0x80, b"a"), raw_message(), record(0x20, b"b")],
}


@pytest.mark.parametrize("name", RARE)
def test_rare_forms_are_read_without_damage(name: str, tmp_path: Path) -> None:
    path, target = raw_file(tmp_path / "a.mcap", *RARE[name]), tmp_path / "b.mcap"
    ended = run_command(["repair", str(path), "-o", str(target)])
    assert (ended.status, "damaged" in ended.messages) == (0, False), ended.messages
    for each in (path, target):
        assert [(message[6], message[-1]) for message in ours(each, strict=True)[0]] == [("", b"data")]
        with closing(McapReader(each)) as reader:
            assert (reader.summary.start_ns, reader.summary.end_ns) == (1, 1)
