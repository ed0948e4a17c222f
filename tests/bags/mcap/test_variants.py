"""Every valid form of an MCAP file is read without damage, with what the mcap library reads."""

from __future__ import annotations

import io
from contextlib import closing
from typing import TYPE_CHECKING, Any

import pytest
from mcap.reader import NonSeekingReader, SeekingReader
from mcap.records import Attachment, Channel, Message, Metadata, Schema

from bags.mcap_variants import CONTENTS, Variant, file_of, variants
from pc2scan.bags.mcap.reader import McapReader
from pc2scan.cli.in_process import run_command

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


@pytest.mark.parametrize("name", CONTENTS)
def test_every_valid_form_is_read_without_damage(name: str, tmp_path: Path) -> None:
    content = CONTENTS[name]
    sound = expected(content)
    path = tmp_path / "a.mcap"
    for variant in variants(content):
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


@pytest.mark.parametrize("name", CONTENTS)
def test_every_valid_form_that_is_cut_off_is_recovered(name: str, tmp_path: Path) -> None:
    content = CONTENTS[name]
    sound = expected(content)
    path = tmp_path / "a.mcap"
    for variant in variants(content):
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
