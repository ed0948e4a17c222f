"""What is left of damaged MCAP files: cut anywhere, bytes flipped anywhere."""

from __future__ import annotations

import io
import struct
from collections import Counter
from contextlib import closing
from typing import TYPE_CHECKING

import pytest
from mcap.records import DataEnd, Footer, Message, MessageIndex
from mcap.stream_reader import StreamReader

from pc2scan.bags.mcap.reader import McapReader
from pc2scan.bags.mcap.records import MAGIC
from pc2scan.cli.in_process import run_command
from pc2scan.errors import DamageError
from support.mcap_files import (
    BODY,
    LIBRARY_OPTIONS,
    content,
    encoded,
    library_file,
    raw_channel,
    raw_chunk,
    raw_file,
    raw_message,
    record,
    write,
    zstd,
)

if TYPE_CHECKING:
    from pathlib import Path

    from pc2scan.bags.damage import Damage

Rows = list[tuple[int, int, int, int, bytes]]

#: Chunks overlap in time, and the data are told from each other.
MESSAGES = [(i % 2, 1_000_000 + 10 * (i // 2) + (i * 7) % 13, b"\0\1\0\0" + bytes([i]) * (20 + i)) for i in range(9)]

CASES = {
    name: LIBRARY_OPTIONS[name] for name in ("default", "lz4", "uncompressed", "unchunked", "no summary", "no crc")
}


def recovered(path: Path) -> tuple[Rows, tuple[Damage, ...]]:
    with closing(McapReader(path)) as reader:
        rows = content(reader)
        list(reader.attachments())
        list(reader.metadata())
        return rows, reader.damage


def stretches(data: bytes) -> list[tuple[int, int, list[bytes]]]:
    """Where each chunk, or message outside chunks, is in a sound file, and the data of its messages."""
    found = []
    position = 8
    while position < len(data) - 8:
        opcode, length = struct.unpack_from("<BQ", data, position)
        stop = position + 9 + length
        if opcode in (5, 6):
            stream = StreamReader(io.BytesIO(data[position:stop] + encoded(Footer(0, 0, 0)) + MAGIC), skip_magic=True)
            inner = [r.data for r in stream.records if isinstance(r, Message)]
            found.append((position, stop, inner))
        position = stop
    return found


@pytest.mark.parametrize("case", CASES)
def test_cut_at_every_byte(tmp_path: Path, case: str) -> None:
    source = library_file(tmp_path / "a.mcap", MESSAGES, extras=True, chunk_size=300, **CASES[case])
    data = source.read_bytes()
    complete, damage = recovered(source)
    assert len(complete) == len(MESSAGES)
    assert damage == ()
    places = stretches(data)
    path = tmp_path / "b.mcap"
    most = 0
    for size in range(8, len(data)):
        path.write_bytes(data[:size])
        rows, damage = recovered(path)
        # A file whose summary lacks only its end may still be whole; everything shorter says what is missing.
        assert damage, size
        assert all(place.what for place in damage)
        # What is returned is true, and nothing that is all there is missing.
        assert Counter(rows) <= Counter(complete), size
        there = {data for _, stop, inner in places if stop <= size for data in inner}
        found = {row[4] for row in rows}
        assert there <= found, size
        assert len(found) >= most, size
        most = len(found)
        with pytest.raises(DamageError), closing(McapReader(path, strict=True)) as strict:
            content(strict)
    assert most == len(MESSAGES)


@pytest.mark.parametrize("case", ["uncompressed", "unchunked"])
def test_a_cut_loses_only_the_message_it_cuts(tmp_path: Path, case: str) -> None:
    source = library_file(tmp_path / "a.mcap", MESSAGES, chunk_size=300, **CASES[case])
    data = source.read_bytes()
    path = tmp_path / "b.mcap"
    ends = sorted(data.index(message) + len(message) for _, _, message in MESSAGES)
    for size in range(ends[0], ends[-1] + 1, 3):
        path.write_bytes(data[:size])
        rows, _ = recovered(path)
        assert len(rows) == sum(end <= size for end in ends), size


@pytest.mark.parametrize("case", CASES)
def test_any_byte_flipped(tmp_path: Path, case: str) -> None:
    source = library_file(tmp_path / "a.mcap", MESSAGES, extras=True, chunk_size=300, **CASES[case])
    data = source.read_bytes()
    places = stretches(data)
    path = tmp_path / "b.mcap"
    for position in range(8, len(data)):
        flipped = bytearray(data)
        flipped[position] ^= 0xFF if position % 2 else 0x01
        path.write_bytes(flipped)
        rows, damage = recovered(path)
        # Damage costs no more than the chunk or message that it is in, wherever it is.
        found = {row[4] for row in rows}
        for number, (start, stop, inner) in enumerate(places):
            # Without a summary, only the first chunk declares the channels.
            if case == "no summary" and number and places[0][0] <= position < places[0][1]:
                continue
            # A wrong length may by chance end where another record does.
            if case == "unchunked" and position < places[0][0]:
                continue
            # A record in front of it with a wrong length may be taken for longer; never beyond what follows.
            if not start - 1 <= position < stop:
                assert set(inner) <= found, (position, start, stop)
        # Without a CRC or an index, a flip may turn a message or a chunk into a record of another kind.
        if len(rows) < len(MESSAGES) and case not in ("no crc", "unchunked", "no summary"):
            assert damage, position


def test_an_uncompressed_chunk_with_a_wrong_crc_keeps_its_messages(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap", MESSAGES, compression="none")
    data = bytearray(path.read_bytes())
    data[data.index(bytes([7]) * 27)] ^= 1
    path.write_bytes(data)
    rows, (damage,) = recovered(path)
    assert len(rows) == len(MESSAGES)
    assert "has CRC" in damage.what
    assert (damage.bytes_lost, damage.messages_lost) == (0, 0)
    with closing(McapReader(path, verify=False)) as reader:
        assert len(content(reader)) == len(MESSAGES)
        assert reader.damage == ()


def test_a_wrong_length_inside_a_chunk_costs_that_message(tmp_path: Path) -> None:
    body = raw_channel() + b"".join(raw_message(1, t, bytes([t]) * 40) for t in range(1, 9))
    for wrong in (3, 45, 100, 1 << 40):
        broken = bytearray(body)
        at = body.index(bytes([4]) * 40) - 30
        struct.pack_into("<Q", broken, at, wrong)
        path = raw_file(tmp_path / "a.mcap", raw_chunk(bytes(broken), message_end_time=8))
        rows, (damage,) = recovered(path)
        assert {row[2] for row in rows} >= {1, 2, 3, 5, 6, 7, 8}, wrong
        assert damage.bytes_lost > 0
        assert damage.offset is not None


@pytest.mark.parametrize("wrong", [0, 21, 35, 200, 1 << 40])
def test_the_last_message_of_a_chunk_ends_with_it(tmp_path: Path, wrong: int) -> None:
    """Its length is wrong; the chunk's is not."""
    body = raw_channel() + raw_message(1, 1) + raw_message(1, 2, b"the last one")
    broken = bytearray(body)
    place = len(body) - len(raw_message(1, 2, b"the last one")) + 1
    struct.pack_into("<Q", broken, place, wrong)
    rows, (damage,) = recovered(raw_file(tmp_path / "a.mcap", raw_chunk(bytes(broken), message_end_time=2)))
    assert [(row[2], row[4]) for row in rows] == [(1, b"data"), (2, b"the last one")]
    assert damage.bytes_lost == 0


def test_a_message_with_an_impossible_time_gets_the_nearest(tmp_path: Path) -> None:
    body = bytearray(raw_channel() + b"".join(raw_message(1, 100 + t, bytes([t]) * 40) for t in range(4)))
    chunk = bytearray(raw_chunk(bytes(body), message_start_time=100, message_end_time=103))
    at = chunk.index(bytes([2]) * 40) - 16
    chunk[at + 7] = 0x7F
    path = raw_file(tmp_path / "a.mcap", bytes(chunk))
    rows, damage = recovered(path)
    assert sorted(row[2] for row in rows) == [100, 101, 103, 103]
    assert damage


@pytest.mark.parametrize("compression", ["lz4", "zstd"])
def test_of_a_chunk_that_breaks_midway_the_front_is_kept(tmp_path: Path, compression: str) -> None:
    import random

    noise = random.Random(5)
    words = (b"alpha", b"bravo", b"charlie", b"delta", b"echo")
    messages = [(0, 1000 + i, b"\0\1\0\0" + b" ".join(noise.choices(words, k=600))) for i in range(200)]
    path = write(tmp_path / "a.mcap", messages, topics=1, compression=compression)
    data = bytearray(path.read_bytes())
    at = len(data) * 3 // 4
    data[at : at + 300] = bytes(300)
    path.write_bytes(data)
    rows, damage = recovered(path)
    assert 60 <= len(rows) < 200
    assert len(damage) == 1
    # The message that the break goes through may look whole.
    assert len({row[4] for row in rows} - {message for _, _, message in messages}) <= 1
    assert damage[0].bytes_lost > 0
    assert damage[0].last_ns == 1199
    assert damage[0].first_ns is not None
    assert damage[0].first_ns >= 1000


def test_a_chunk_with_a_broken_header_is_read_by_the_index(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap", MESSAGES, chunk_size=300)
    data = bytearray(path.read_bytes())
    start = struct.unpack_from("<Q", data, len(data) - 28)[0]
    at = data.index(b"\x04\0\0\0zstd")
    data[at + 4] ^= 0xFF
    path.write_bytes(data)
    rows, damage = recovered(path)
    assert start
    assert len(rows) == len(MESSAGES)
    assert damage


def test_channels_that_nothing_describes(tmp_path: Path) -> None:
    body = raw_channel(1) + raw_message(1, 5) + raw_message(2, 6)
    path = raw_file(tmp_path / "a.mcap", raw_chunk(body, message_start_time=5, message_end_time=6))
    rows, (damage,) = recovered(path)
    assert [row[2] for row in rows] == [5]
    assert damage.messages_lost == 1
    assert "channel 2 has messages" in damage.what


def test_a_schema_that_is_missing_costs_nothing_else(tmp_path: Path) -> None:
    path = raw_file(tmp_path / "a.mcap", raw_channel(1, schema=9), raw_message(1, 5))
    with closing(McapReader(path)) as reader:
        assert [c.msgtype for c in reader.connections] == [""]
        assert len(content(reader)) == 1
        assert "has schema 9" in reader.damage[0].what


def test_a_gap_says_where_and_when(tmp_path: Path) -> None:
    chunks = [raw_chunk(raw_message(1, t), message_start_time=t, message_end_time=t) for t in (10, 20, 30)]
    index = encoded(MessageIndex(channel_id=1, records=[(10, 0)]))
    path = raw_file(tmp_path / "a.mcap", raw_channel(), chunks[0], index, b"\xee" * 500, chunks[2], index)
    at = path.read_bytes().index(b"\xee")
    rows, damage = recovered(path)
    assert [row[2] for row in rows] == [10, 30]
    (gap,) = [place for place in damage if place.bytes_lost]
    assert (gap.offset, gap.bytes_lost, gap.first_ns, gap.last_ns) == (at, 500, 10, 30)


def test_damage_is_noted_once_however_often_it_is_read(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap", MESSAGES, chunk_size=300)
    data = bytearray(path.read_bytes())
    data[data.index(b"\x04\0\0\0zstd") + 60] ^= 0xFF
    path.write_bytes(data)
    with closing(McapReader(path)) as reader:
        first = content(reader)
        assert len(reader.damage) == 1
        assert content(reader) == first
        assert content(reader, start_ns=0) == first
        assert len(reader.damage) == 1


@pytest.mark.parametrize("packed", [True, False])
def test_messages_packed_one_by_one_are_found_out(tmp_path: Path, packed: bool) -> None:
    pack = zstd if packed else bytes
    path = write(tmp_path / "a.mcap", [(i, t, pack(data)) for i, t, data in MESSAGES])
    rows, damage = recovered(path)
    assert sorted(row[4] for row in rows) == sorted(data for _, _, data in MESSAGES)
    assert damage == ()


def test_a_packed_message_that_is_broken_is_left_out(tmp_path: Path) -> None:
    packed = [(i, t, zstd(data)) for i, t, data in MESSAGES]
    packed[5] = (packed[5][0], packed[5][1], packed[5][2][:-3])
    path = write(tmp_path / "a.mcap", packed)
    rows, (damage,) = recovered(path)
    assert len(rows) == len(MESSAGES) - 1
    assert damage.messages_lost == 1
    assert damage.first_ns == packed[5][1]
    with closing(McapReader(path, strict=True)) as reader, pytest.raises(DamageError, match="full frame"):
        content(reader)


def test_messages_after_the_data_end_are_recovered(tmp_path: Path) -> None:
    path = raw_file(tmp_path / "a.mcap", raw_channel(), raw_message(1, 5), encoded(DataEnd(0)), raw_message(1, 6))
    rows, (damage,) = recovered(path)
    assert [row[2] for row in rows] == [5, 6]
    assert "the data section ends at byte" in damage.what


def test_channels_after_the_data_end_are_no_damage(tmp_path: Path) -> None:
    """Some writers repeat them, and do not say in the footer where."""
    path = raw_file(tmp_path / "a.mcap", raw_channel(), raw_message(1, 5), encoded(DataEnd(0)), raw_channel())
    rows, damage = recovered(path)
    assert [row[2] for row in rows] == [5]
    assert damage == ()


def repaired(path: Path) -> tuple[list[int], str]:
    """Repair a file by the command; returns the log times of its messages, and what is said of the damage."""
    target = path.with_name("repaired.mcap")
    ended = run_command(["repair", str(path), "-o", str(target), "--overwrite"])
    assert ended.status == 3, ended.messages
    with closing(McapReader(target, strict=True)) as reader:
        times = [row[2] for row in content(reader)]
    return times, "\n".join(line for line in ended.messages.splitlines() if line.startswith(("damaged:", "recovered:")))


def claims_all(said: str) -> bool:
    """Whether it is said that nothing is lost, anywhere or at a place."""
    return any(words in said for words in ("no bytes are known", "no message is known", "nothing lost"))


def pieces(path: Path) -> list[bytes]:
    """Split a file into its magic, its records, and its magic again."""
    data = path.read_bytes()
    found, position = [MAGIC], len(MAGIC)
    while position < len(data) - len(MAGIC):
        stop = position + 9 + struct.unpack_from("<Q", data, position + 1)[0]
        found.append(data[position:stop])
        position = stop
    return [*found, MAGIC]


@pytest.mark.parametrize("summary", ["default", "no summary"])
def test_without_a_header_the_first_chunk_is_kept(tmp_path: Path, summary: str) -> None:
    path = library_file(tmp_path / "a.mcap", MESSAGES, chunk_size=300, **LIBRARY_OPTIONS[summary])
    magic, _, *others = pieces(path)
    path.write_bytes(b"".join((magic, *others)))
    rows, damage = recovered(path)
    assert len(rows) == len(MESSAGES)
    (header,) = [place for place in damage if "HEADER" in place.what]
    # Nothing that can be read counts the messages.
    assert (header.offset, header.bytes_lost, header.messages_lost) == (len(MAGIC), 0, None)


@pytest.mark.parametrize(("summary", "lost"), [("default", 0), ("no summary", None)])
def test_of_an_overwritten_header_statistics_tell_what_is_lost(tmp_path: Path, summary: str, lost: int | None) -> None:
    path = library_file(tmp_path / "a.mcap", MESSAGES, chunk_size=300, **LIBRARY_OPTIONS[summary])
    magic, header, *others = pieces(path)
    path.write_bytes(b"".join((magic, b"\x40" + header[1:], *others)))
    rows, (damage,) = recovered(path)
    assert len(rows) == len(MESSAGES)
    assert damage.messages_lost == lost


def test_chunks_that_the_index_misplaces_are_found(tmp_path: Path) -> None:
    path = library_file(tmp_path / "a.mcap", MESSAGES, chunk_size=300)
    sound, _ = recovered(path)
    parts = pieces(path)
    chunks = [place for place, part in enumerate(parts) if part[0] == 6]
    # The message indexes of the first chunk are at the end of the data: every other chunk is elsewhere.
    moved = parts[chunks[0] + 1 : chunks[1]]
    end = next(place for place, part in enumerate(parts) if part[0] == 15)
    assert moved
    path.write_bytes(b"".join((*parts[: chunks[0] + 1], *parts[chunks[1] : end], *moved, *parts[end:])))
    rows, damage = recovered(path)
    assert rows == sound
    misplaced = [place for place in damage if "the index places a chunk at byte" in place.what]
    assert len(misplaced) == len(chunks) - 1
    assert all(place.messages_lost == 0 for place in misplaced)


@pytest.mark.parametrize(("number", "words"), [(0, "follows no chunk"), (1, "entries match no message")])
def test_a_message_index_without_its_chunk_is_damage(tmp_path: Path, number: int, words: str) -> None:
    path = library_file(
        tmp_path / "a.mcap", MESSAGES, chunk_size=300, **LIBRARY_OPTIONS["no summary but message indexes"]
    )
    parts = pieces(path)
    chunks = [place for place, part in enumerate(parts) if part[0] == 6]
    # Of a kind that no reader knows.
    parts[chunks[number]] = b"\x40" + parts[chunks[number]][1:]
    path.write_bytes(b"".join(parts))
    rows, damage = recovered(path)
    assert len(rows) < len(MESSAGES)
    assert words in damage[0].what
    assert damage[0].loses


@pytest.mark.parametrize("chunked", [False, True], ids=["outside chunks", "in a chunk"])
@pytest.mark.parametrize("delta", [-20, 7, 1000])
def test_a_channel_with_a_wrong_length_is_kept(tmp_path: Path, delta: int, chunked: bool) -> None:
    channel = raw_channel(topic="/a/topic/of/some/length")
    wrong = channel[:1] + struct.pack("<Q", len(channel) - 9 + delta) + channel[9:]
    body = [wrong, *(raw_message(1, time, bytes(100)) for time in range(5, 25))]
    chunk = [raw_chunk(b"".join(body), message_start_time=5, message_end_time=24)]
    path = raw_file(tmp_path / "a.mcap", *(chunk if chunked else body))
    with closing(McapReader(path)) as reader:
        assert [connection.topic for connection in reader.connections] == ["/a/topic/of/some/length"]
    rows, damage = recovered(path)
    # Messages that a record with a wrong length covers may be lost, but none after it.
    assert [row[2] for row in rows][-9:] == list(range(16, 25))
    assert damage


@pytest.mark.parametrize("opcode", [0x10, 0x45, 0x85])
def test_a_message_that_became_an_unknown_record_is_lost(tmp_path: Path, opcode: int) -> None:
    """Nothing but the message index tells it from a record of a later specification, of which there is one, too."""
    messages = [raw_message(1, time) for time in (5, 6, 7)]
    places = [(time, place * len(messages[0])) for place, time in enumerate((5, 6, 7))]
    changed = b"".join((messages[0], bytes([opcode]) + messages[1][1:], messages[2], record(0x20, b"later")))
    chunk = raw_chunk(changed, message_start_time=5, message_end_time=7, uncompressed_crc=0)
    index = encoded(MessageIndex(channel_id=1, records=places))
    path = raw_file(tmp_path / "a.mcap", raw_channel(), chunk, index)
    with closing(McapReader(path)) as reader:
        # Of a cut, messages are not counted.
        assert [row[2] for row in content(reader, start_ns=0, stop_ns=7)] == [5]
        assert [damage.loses for damage in reader.damage] == [True]


def test_a_chunk_of_unknown_compression_may_be_uncompressed(tmp_path: Path) -> None:
    path = raw_file(tmp_path / "a.mcap", raw_chunk(BODY, compression="zstf"))
    rows, (damage,) = recovered(path)
    assert [row[4] for row in rows] == [b"data"]
    assert "known are none, lz4 and zstd" in damage.what


@pytest.mark.parametrize("opcode", [1, 2, 8, 10, 11, 13, 14])
def test_records_that_no_data_may_have_are_damage(tmp_path: Path, opcode: int) -> None:
    """A message became one, in a file that counts nothing."""
    messages = [raw_message(1, time) for time in (5, 6, 7)]
    messages[1] = bytes([opcode]) + messages[1][1:]
    times, said = repaired(raw_file(tmp_path / "a.mcap", raw_channel(), *messages))
    assert times == [5, 7]
    assert f"is of kind {opcode}, which no data may have" in said
    assert not claims_all(said)


@pytest.mark.parametrize("zeroed", ["all but its length", "all but its first time"])
def test_a_chunk_without_records_is_not_one_with_unknown_fields(tmp_path: Path, zeroed: str) -> None:
    first = raw_chunk(BODY)
    start = 9 if zeroed == "all but its length" else 17
    path = raw_file(tmp_path / "a.mcap", first[:start] + bytes(len(first) - start), raw_chunk(BODY))
    times, said = repaired(path)
    assert times == [1]
    assert "declares no records in" in said
    assert not claims_all(said)


@pytest.mark.parametrize("compression", ["", "zstd"])
def test_a_chunk_that_declares_no_size_keeps_its_messages(tmp_path: Path, compression: str) -> None:
    packed = zstd(BODY) if compression else BODY
    chunk = raw_chunk(BODY, compression=compression, packed=packed, uncompressed_size=0, uncompressed_crc=0)
    times, said = repaired(raw_file(tmp_path / "a.mcap", chunk))
    assert times == [1]
    assert "declared" in said


@pytest.mark.parametrize("indexed", [False, True], ids=["without an index", "with one"])
def test_what_a_wrong_crc_means_only_an_index_tells(tmp_path: Path, indexed: bool) -> None:
    """A message is missing from the chunk, or none."""
    messages = [raw_message(1, time) for time in (1, 2, 3)]
    entries = [(time, (time - 1) * len(messages[0])) for time in (1, 2, 3)]
    index = [encoded(MessageIndex(channel_id=1, records=entries))] if indexed else []
    for there in (messages, messages[:2]):
        chunk = raw_chunk(b"".join(there), message_end_time=3, uncompressed_crc=1)
        times, said = repaired(raw_file(tmp_path / "a.mcap", raw_channel(), chunk, *index))
        assert times == [1, 2, 3][: len(there)]
        assert claims_all(said) == (indexed and there == messages)
    assert ("1 message lost" in said) == indexed


def test_a_message_in_the_place_of_another_is_told(tmp_path: Path) -> None:
    """There are as many messages as entries, but one of them twice and another not at all."""
    messages = [raw_message(1, time) for time in (1, 2, 3, 4)]
    entries = [(time, (time - 1) * len(messages[0])) for time in (1, 2, 3, 4)]
    there = [messages[0], messages[0], messages[1], messages[3]]
    chunk = raw_chunk(b"".join(there), message_end_time=4)
    index = encoded(MessageIndex(channel_id=1, records=entries))
    times, said = repaired(raw_file(tmp_path / "a.mcap", raw_channel(), chunk, index))
    assert times == [1, 1, 2, 4]
    assert not claims_all(said)


def test_a_misplaced_chunk_that_differs_from_its_index_is_read(tmp_path: Path) -> None:
    path = library_file(tmp_path / "a.mcap", MESSAGES, chunk_size=300, **LIBRARY_OPTIONS["only chunk indexes"])
    sound = sorted(row[2] for row in recovered(path)[0])
    parts = pieces(path)
    one, other = [place for place, part in enumerate(parts) if part[0] == 6][:2]
    # They are exchanged, and one declares another last log time.
    (last,) = struct.unpack_from("<Q", parts[one], 17)
    parts[one], parts[other] = parts[other], parts[one][:17] + struct.pack("<Q", last + 1) + parts[one][25:]
    path.write_bytes(b"".join(parts))
    times, said = repaired(path)
    assert times == sound
    assert said.count("the index places a chunk at byte") == 2


def test_a_channel_without_message_index_is_read(tmp_path: Path) -> None:
    """The chunk has the message index of a channel that nothing declares, and the file is cut off."""
    body = raw_channel(1) + raw_message(1, 1)
    index = encoded(MessageIndex(channel_id=2, records=[(1, 0)]))
    path = raw_file(tmp_path / "a.mcap", raw_channel(1), raw_chunk(body), index)
    path.write_bytes(path.read_bytes()[:-20])
    assert repaired(path)[0] == [1]


def test_messages_of_a_chunk_whose_front_is_zero_are_found(tmp_path: Path) -> None:
    """Only another chunk declares their channel, so that it is not known when they are searched for."""
    body = raw_channel() + b"".join(raw_message(1, time, bytes([time]) * 40) for time in range(1, 30))
    second = raw_chunk(b"".join(raw_message(1, time, bytes([time]) * 40) for time in range(30, 60)))
    zeroed = bytes(400) + second[400:]
    last = raw_chunk(raw_message(1, 70), message_start_time=70, message_end_time=70)
    path = raw_file(tmp_path / "a.mcap", raw_chunk(body, message_end_time=29), zeroed, last)
    times, said = repaired(path)
    assert {*range(1, 30), *range(40, 60), 70} <= set(times)
    assert not claims_all(said)


def test_a_summary_with_a_wrong_crc_still_places_chunks(tmp_path: Path) -> None:
    """One chunk has a broken header, so that nothing else tells where its records are."""
    path = library_file(tmp_path / "a.mcap", MESSAGES, chunk_size=300)
    sound = sorted(row[2] for row in recovered(path)[0])
    data = bytearray(path.read_bytes())
    place, _, _ = stretches(bytes(data))[1]
    data[place : place + 40] = b"\xff" * 40
    # A byte of the last summary offset, in front of footer and magic.
    data[-40] ^= 1
    path.write_bytes(data)
    times, said = repaired(path)
    assert sorted(times) == sound
    assert "the summary's CRC" in said


@pytest.mark.parametrize("whole", [False, True], ids=["by chance", "of a file"])
def test_a_message_that_looks_like_records_is_kept(tmp_path: Path, whole: bool) -> None:
    """What follows it is damaged. It holds what may begin a message index and a channel, or the records of a file."""
    inner = raw_file(tmp_path / "inner.mcap", raw_channel(), raw_message(1, 1), raw_message(1, 2)).read_bytes()
    chance = struct.pack("<BQHI", 7, 30, 1, 0) + bytes(24) + b"\x80" + bytes(8) + bytes(1000)
    outer = raw_message(1, 5, b"\xff" * 8 + (inner[8:-8] if whole else chance))
    path = raw_file(tmp_path / "a.mcap", raw_channel(), outer, bytes(13), raw_message(1, 6), raw_message(1, 7))
    times, said = repaired(path)
    assert times == [5, 6, 7]
    assert "has opcode 0" in said
