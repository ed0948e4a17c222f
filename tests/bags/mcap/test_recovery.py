"""What is recovered of damaged MCAP files, where no byte changed alone shows it (`fuzz.test_every_byte` does those)."""

from __future__ import annotations

import random
import struct
from contextlib import closing
from typing import TYPE_CHECKING, Any, NamedTuple

import pytest
from mcap.records import DataEnd, MessageIndex

from pc2scan.bags.mcap.read import McapReader
from pc2scan.bags.mcap.records import MAGIC
from pc2scan.errors import DamageError
from support.bounded import watched
from support.command import run
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
    write,
    zstd,
)

if TYPE_CHECKING:
    from pathlib import Path

    from pc2scan.bags.damage import Damage

Rows = list[tuple[int, int, int, int, bytes]]

#: Chunks overlap in time, and the data are told from each other.
MESSAGES = [(i % 2, 1_000_000 + 10 * (i // 2) + (i * 7) % 13, b"\0\1\0\0" + bytes([i]) * (20 + i)) for i in range(9)]


def recovered(path: Path) -> tuple[Rows, tuple[Damage, ...]]:
    rows: Rows = []
    damage: tuple[Damage, ...] = ()
    with watched(path.stat().st_size), closing(McapReader(path)) as reader:
        rows = content(reader)
        list(reader.attachments())
        list(reader.metadata())
        damage = reader.damage
    return rows, damage


def repaired(path: Path) -> tuple[list[int], str, bool]:
    """Repair by the command; returns the log times of the messages, what is said, and if that is: nothing is lost."""
    target = path.with_name("repaired.mcap")
    ended = run("repair", path, "-o", target, "--overwrite")
    assert ended.status == 3, ended.stderr
    with closing(McapReader(target, strict=True)) as reader:
        times = [row[2] for row in content(reader)]
    said = "\n".join(line for line in ended.stderr.splitlines() if line.startswith(("damaged:", "recovered:")))
    return times, said, any(words in said for words in ("no bytes are known", "no message is known", "nothing lost"))


class Kept(NamedTuple):
    """Records, and what must be recovered of them.

    Attributes
    ----------
    times
        Log times of the messages.
    said
        By the command.
    fields
        Of the first damage.
    whole
        Whether it is said that nothing is lost; None where that is not looked at.
    """

    data: list[bytes]
    times: list[int]
    said: str = ""
    fields: dict[str, Any] | None = None
    whole: bool | None = None


def changed(data: bytes, place: int, new: bytes) -> bytes:
    return data[:place] + new + data[place + len(new) :]


def messages(*times: int) -> list[bytes]:
    return [raw_message(1, time) for time in times]


def index(*times: int) -> bytes:
    """The index of messages of that order, one behind the other."""
    size = len(raw_message(1, 1))
    return encoded(MessageIndex(channel_id=1, records=[(time, place * size) for place, time in enumerate(times)]))


def with_length(delta: int, *, chunked: bool) -> Kept:
    """A channel with a wrong length, and 20 messages; those that it seems to cover may be lost."""
    channel = raw_channel(topic="/a/topic/of/some/length")
    wrong = changed(channel, 1, struct.pack("<Q", len(channel) - 9 + delta))
    body = [wrong, *(raw_message(1, time, bytes(100)) for time in range(5, 25))]
    chunk = raw_chunk(b"".join(body), message_start_time=5, message_end_time=24)
    return Kept([chunk] if chunked else body, list(range(16, 25)))


LONG = b"".join(raw_message(1, t, bytes([t]) * 40) for t in range(1, 9))
LAST = raw_channel() + raw_message(1, 1) + raw_message(1, 2, b"the last one")
LAST_LENGTH = len(LAST) - len(raw_message(1, 2, b"the last one")) + 1
FRONT = b"".join(raw_message(1, time, bytes([time]) * 40) for time in range(1, 30))
SECOND = raw_chunk(b"".join(raw_message(1, time, bytes([time]) * 40) for time in range(30, 60)))
INNER = raw_channel() + raw_message(1, 1) + raw_message(1, 2)
CHANCE = struct.pack("<BQHI", 7, 30, 1, 0) + bytes(24) + b"\x80" + bytes(8) + bytes(1000)


def timed(time: int, body: bytes | None = None, **changes: Any) -> bytes:
    times = {"message_start_time": time, "message_end_time": time}
    return raw_chunk(raw_message(1, time) if body is None else body, **{**times, **changes})


#: Those times are all that there is.
KEPT: dict[str, Kept] = {
    **{
        f"the last message of a chunk ends with it, whatever its length: {wrong}": Kept(
            [raw_chunk(changed(LAST, LAST_LENGTH, struct.pack("<Q", wrong)), message_end_time=2)],
            [1, 2],
            fields={"bytes_lost": 0},
        )
        for wrong in (0, 21, 35, 200, 1 << 40)
    },
    **{
        f"a wrong length inside a chunk is made good by its index: {wrong}": Kept(
            [
                raw_channel(),
                raw_chunk(changed(LONG, 3 * 71 + 1, struct.pack("<Q", wrong)), message_end_time=8),
                encoded(MessageIndex(channel_id=1, records=[(time, 71 * (time - 1)) for time in range(1, 9)])),
            ],
            [1, 2, 3, 4, 5, 6, 7, 8],
            fields={"messages_lost": 0},
        )
        for wrong in (3, 45, 100, 1 << 40)
    },
    "a channel that nothing describes": Kept(
        [timed(5, raw_channel(1) + raw_message(1, 5) + raw_message(2, 6), message_end_time=6)],
        [5],
        "channel 2 has messages",
        {"messages_lost": 1},
    ),
    "a schema that is missing": Kept([raw_channel(1, schema=9), raw_message(1, 5)], [5], "has schema 9"),
    **{
        f"a message outside chunks longer by {delta}": Kept(
            [
                raw_channel(),
                *messages(5),
                changed(raw_message(1, 6), 1, struct.pack("<Q", len(raw_message(1, 6)) - 9 + delta)),
                *messages(7, 8, 9, 10, 11),
            ],
            [5, 7, 8, 9, 10, 11],
            whole=False,
        )
        for delta in (40, 1000)
    },
    "messages after the end of the data": Kept(
        [raw_channel(), *messages(5), encoded(DataEnd(0)), *messages(6)], [5, 6], "the data section ends at byte"
    ),
    "an unknown compression may be none": Kept(
        [raw_chunk(BODY, compression="zstf")], [1], "known are none, lz4 and zstd"
    ),
    # A message became one, in a file that counts nothing.
    **{
        f"a record that no data may have: {opcode}": Kept(
            [raw_channel(), *messages(5), bytes([opcode]) + raw_message(1, 6)[1:], *messages(7)],
            [5, 7],
            f"is of kind {opcode}, which no data may have",
            whole=False,
        )
        for opcode in (1, 2, 8, 10, 11, 13, 14)
    },
    **{
        f"a chunk of zeros behind {what} is not one with unknown fields": Kept(
            [raw_chunk(BODY)[:start].ljust(len(raw_chunk(BODY)), b"\0"), raw_chunk(BODY)],
            [1],
            "declares no records in",
            whole=False,
        )
        for what, start in (("its length", 9), ("its first time", 17))
    },
    **{
        f"a chunk that declares no size, compression {name!r}": Kept(
            [raw_chunk(BODY, compression=name, packed=packed, uncompressed_size=0, uncompressed_crc=0)], [1], "declared"
        )
        for name, packed in (("", BODY), ("zstd", zstd(BODY)))
    },
    # What a wrong CRC means only an index tells.
    "a wrong CRC without an index": Kept(
        [raw_channel(), raw_chunk(b"".join(messages(1, 2, 3)), message_end_time=3, uncompressed_crc=1)],
        [1, 2, 3],
        whole=False,
    ),
    "a wrong CRC with an index": Kept(
        [raw_channel(), raw_chunk(b"".join(messages(1, 2, 3)), message_end_time=3, uncompressed_crc=1),
         index(1, 2, 3)],
        [1, 2, 3],
        whole=True,
    ),
    "a message less than in the index": Kept(
        [raw_channel(), raw_chunk(b"".join(messages(1, 2)), message_end_time=3, uncompressed_crc=1), index(1, 2, 3)],
        [1, 2],
        "1 message lost",
        whole=False,
    ),
    "a message less without an index": Kept(
        [raw_channel(), raw_chunk(b"".join(messages(1, 2)), message_end_time=3, uncompressed_crc=1)],
        [1, 2],
        whole=False,
    ),
    # What follows the message is damaged. It holds what may begin an index and a channel, or the records of a file.
    **{
        f"a message that looks like records {name}": Kept(
            [raw_channel(), raw_message(1, 5, b"\xff" * 8 + inner), bytes(13), *messages(6, 7)],
            [5, 6, 7],
            "has opcode 0",
        )
        for name, inner in (("of a file", INNER), ("by chance", CHANCE))
    },
}  # fmt: skip

#: There may be more than these times.
AT_LEAST: dict[str, Kept] = {
    # Only another chunk declares their channel, so that it is not known when they are searched for.
    "a chunk whose front is zero": Kept(
        [raw_chunk(raw_channel() + FRONT, message_end_time=29), bytes(400) + SECOND[400:], timed(70)],
        [*range(1, 30), *range(40, 60), 70],
        whole=False,
    ),
    **{
        f"a channel longer by {delta}, {'in a chunk' if chunked else 'outside chunks'}": with_length(
            delta, chunked=chunked
        )
        for delta in (-20, 7, 1000)
        for chunked in (False, True)
    },
}


@pytest.mark.parametrize("name", [*KEPT, *AT_LEAST])
def test_what_is_sound_is_kept(name: str, tmp_path: Path) -> None:
    kept = (KEPT | AT_LEAST)[name]
    path = raw_file(tmp_path / "a.mcap", *kept.data)
    rows, damage = recovered(path)
    times = [row[2] for row in rows]
    assert times == kept.times if name in KEPT else set(kept.times) <= set(times)
    fields = kept.fields or {}
    assert {field: getattr(damage[0], field) for field in fields} == fields
    assert name in KEPT or damage[0].offset is not None
    again, said, whole = repaired(path)
    assert again == times
    assert kept.said in said
    assert kept.whole in (None, whole)


def test_channels_after_the_data_end_are_no_damage(tmp_path: Path) -> None:
    """Some writers repeat them, and do not say in the footer where."""
    path = raw_file(tmp_path / "a.mcap", raw_channel(), raw_message(1, 5), encoded(DataEnd(0)), raw_channel())
    rows, damage = recovered(path)
    assert ([row[2] for row in rows], damage) == ([5], ())


def test_a_channel_without_message_index_is_read(tmp_path: Path) -> None:
    """The chunk has the message index of a channel that nothing declares, and the file is cut off."""
    body = raw_channel(1) + raw_message(1, 1)
    path = raw_file(
        tmp_path / "a.mcap", raw_channel(1), raw_chunk(body), encoded(MessageIndex(channel_id=2, records=[(1, 0)]))
    )
    path.write_bytes(path.read_bytes()[:-20])
    assert repaired(path)[0] == [1]


def test_a_gap_says_where_and_when(tmp_path: Path) -> None:
    entry = encoded(MessageIndex(channel_id=1, records=[(10, 0)]))
    path = raw_file(tmp_path / "a.mcap", raw_channel(), timed(10), entry, b"\xee" * 500, timed(30), entry)
    rows, damage = recovered(path)
    assert [row[2] for row in rows] == [10, 30]
    (gap,) = [place for place in damage if place.bytes_lost]
    at = path.read_bytes().index(b"\xee")
    assert (gap.offset, gap.bytes_lost, gap.first_ns, gap.last_ns) == (at, 500, 10, 30)


# --- Damage in files of writers ---


def pieces(path: Path) -> list[bytes]:
    """Split a file into its magic, its records, and its magic again."""
    data = path.read_bytes()
    found, position = [MAGIC], len(MAGIC)
    while position < len(data) - len(MAGIC):
        stop = position + 9 + struct.unpack_from("<Q", data, position + 1)[0]
        found.append(data[position:stop])
        position = stop
    return [*found, MAGIC]


def chunks_of(parts: list[bytes]) -> list[int]:
    return [place for place, part in enumerate(parts) if part[0] == 6]


def made(path: Path, options: str = "default") -> Path:
    return library_file(path / "a.mcap", MESSAGES, chunk_size=300, **LIBRARY_OPTIONS[options])


@pytest.mark.parametrize(("options", "lost"), [("default", 0), ("no summary", None)])
@pytest.mark.parametrize("header", ["removed", "overwritten"])
def test_without_a_header_everything_is_kept(header: str, options: str, lost: int | None, tmp_path: Path) -> None:
    path = made(tmp_path, options)
    magic, first, *others = pieces(path)
    path.write_bytes(b"".join((magic, *([b"\x40" + first[1:]] if header == "overwritten" else []), *others)))
    rows, damage = recovered(path)
    assert len(rows) == len(MESSAGES)
    if header == "overwritten":
        # Only statistics tell that it was no message.
        assert [place.messages_lost for place in damage] == [lost]
    else:
        (place,) = [place for place in damage if "HEADER" in place.what]
        assert (place.offset, place.bytes_lost, place.messages_lost) == (len(MAGIC), 0, None)


def test_chunks_that_the_index_misplaces_are_found(tmp_path: Path) -> None:
    path = made(tmp_path)
    sound, _ = recovered(path)
    parts = pieces(path)
    first, second, *others = chunks_of(parts)
    # The message indexes of the first chunk are at the end of the data: every other chunk is elsewhere.
    moved = parts[first + 1 : second]
    end = next(place for place, part in enumerate(parts) if part[0] == 15)
    assert moved
    path.write_bytes(b"".join((*parts[: first + 1], *parts[second:end], *moved, *parts[end:])))
    rows, damage = recovered(path)
    assert rows == sound
    misplaced = [place for place in damage if "the index places a chunk at byte" in place.what]
    assert [place.messages_lost for place in misplaced] == [0] * (1 + len(others))


def test_a_misplaced_chunk_that_differs_from_its_index_is_read(tmp_path: Path) -> None:
    path = made(tmp_path, "only chunk indexes")
    sound = sorted(row[2] for row in recovered(path)[0])
    parts = pieces(path)
    one, other = chunks_of(parts)[:2]
    # They are exchanged, and one declares another last log time.
    (last,) = struct.unpack_from("<Q", parts[one], 17)
    parts[one], parts[other] = parts[other], changed(parts[one], 17, struct.pack("<Q", last + 1))
    path.write_bytes(b"".join(parts))
    times, said, _ = repaired(path)
    assert times == sound
    assert "the index and the chunk at byte" in said


@pytest.mark.parametrize(("number", "words"), [(0, "follows no chunk"), (1, "is the second of channel")])
def test_a_message_index_without_its_chunk_is_damage(number: int, words: str, tmp_path: Path) -> None:
    path = made(tmp_path, "no summary but message indexes")
    parts = pieces(path)
    place = chunks_of(parts)[number]
    # Of a kind that no reader knows.
    parts[place] = b"\x40" + parts[place][1:]
    path.write_bytes(b"".join(parts))
    rows, damage = recovered(path)
    assert len(rows) < len(MESSAGES)
    assert words in damage[0].what
    assert damage[0].loses


def test_a_chunk_with_a_broken_header_is_read_by_the_index(tmp_path: Path) -> None:
    path = made(tmp_path)
    sound = sorted(row[2] for row in recovered(path)[0])
    parts = pieces(path)
    place = chunks_of(parts)[1]
    parts[place] = b"\xff" * 40 + parts[place][40:]
    path.write_bytes(b"".join(parts))
    assert sorted(repaired(path)[0]) == sound


def test_a_plain_chunk_with_a_wrong_crc_keeps_its_messages(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap", MESSAGES, compression="none")
    data = path.read_bytes()
    path.write_bytes(changed(data, data.index(bytes([7]) * 27), b"\6"))
    rows, (damage,) = recovered(path)
    assert len(rows) == len(MESSAGES)
    assert "has CRC" in damage.what
    assert (damage.bytes_lost, damage.messages_lost) == (0, 0)


@pytest.mark.parametrize("compression", ["lz4", "zstd"])
def test_of_a_chunk_that_breaks_midway_the_front_is_kept(compression: str, tmp_path: Path) -> None:
    noise = random.Random(5)
    words = (b"alpha", b"bravo", b"charlie", b"delta", b"echo")
    stored = [(0, 1000 + i, b"\0\1\0\0" + b" ".join(noise.choices(words, k=600))) for i in range(200)]
    path = write(tmp_path / "a.mcap", stored, topics=1, compression=compression)
    data = path.read_bytes()
    path.write_bytes(changed(data, len(data) * 3 // 4, bytes(300)))
    rows, (damage,) = recovered(path)
    assert 60 <= len(rows) < 200
    # The message that the break goes through may look whole.
    assert len({row[4] for row in rows} - {message for _, _, message in stored}) <= 1
    assert damage.bytes_lost > 0
    assert damage.last_ns == 1199
    assert (damage.first_ns or 0) >= 1000


def test_damage_is_noted_once_however_often_it_is_read(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap", MESSAGES, chunk_size=300)
    data = bytearray(path.read_bytes())
    data[data.index(b"\x04\0\0\0zstd") + 60] ^= 0xFF
    path.write_bytes(data)
    with closing(McapReader(path)) as reader:
        first = content(reader)
        assert content(reader) == content(reader, start_ns=0) == first
        assert len(reader.damage) == 1


@pytest.mark.parametrize("pack", [zstd, bytes])
def test_messages_packed_one_by_one_are_found_out(pack: Any, tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap", [(i, t, pack(data)) for i, t, data in MESSAGES])
    rows, damage = recovered(path)
    assert sorted(row[4] for row in rows) == sorted(data for _, _, data in MESSAGES)
    assert damage == ()


def test_a_packed_message_that_is_broken_is_left_out(tmp_path: Path) -> None:
    packed = [(i, t, zstd(data)[: -3 if n == 5 else None]) for n, (i, t, data) in enumerate(MESSAGES)]
    path = write(tmp_path / "a.mcap", packed)
    rows, (damage,) = recovered(path)
    assert len(rows) == len(MESSAGES) - 1
    assert (damage.messages_lost, damage.first_ns) == (1, packed[5][1])
    with closing(McapReader(path, strict=True)) as reader, pytest.raises(DamageError, match="it ends after"):
        content(reader)
