"""Every valid form of an MCAP file is read without damage, with what the mcap library reads."""

from __future__ import annotations

import io
from contextlib import closing
from typing import TYPE_CHECKING, Any

import lz4.frame
import pytest
from mcap.reader import NonSeekingReader, SeekingReader
from mcap.records import Attachment, Channel, Message, MessageIndex, Metadata, Schema

from bags.mcap_variants import CONTENTS, Variant, file_of, variants
from pc2scan.bags.mcap.reader import McapReader
from pc2scan.cli.in_process import run_command
from support import stepped
from support.mcap_files import BODY, encoded, raw_channel, raw_chunk, raw_file, raw_message, record, zstd

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from bags.mcap_variants import Item

    #: Messages, attachments and metadata records.
    Content = tuple[list[Any], list[Any], list[Any]]


def expected(content: Sequence[Item]) -> Content:
    """What is in a file, by what it was made of."""
    schemas = {item.id: item for item in content if isinstance(item, Schema)}
    channels = {item.id: item for item in content if isinstance(item, Channel)}
    messages = []
    for item in content:
        if isinstance(item, Message):
            channel = channels[item.channel_id]
            schema = schemas.get(channel.schema_id)
            messages.append(row(schema, channel, item))
    return (
        sorted(messages, key=by_time),
        [attachment(item) for item in content if isinstance(item, Attachment)],
        [(item.name, item.metadata) for item in content if isinstance(item, Metadata)],
    )


def row(schema: Schema | None, channel: Channel, message: Message) -> tuple[Any, ...]:
    kind = (schema.name, schema.encoding, schema.data) if schema else ("", "", b"")
    numbers = (message.log_time, message.publish_time, message.sequence)
    return (*numbers, channel.topic, channel.message_encoding, channel.metadata, *kind, message.data)


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
        assert ours(path, strict=True, verify=False) == sound, variant
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
    variant = Variant("zstd", True, True, True, True, True, True, True, True, padding, True)
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
    assert [message[-1] for message in ours(target, strict=True)[0]] == [b"data"]
