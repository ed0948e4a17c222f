"""What is recovered of damaged MCAP files, where no byte changed alone shows it (`fuzz.test_campaign` does those)."""

from __future__ import annotations

import random
import struct
from contextlib import closing
from typing import TYPE_CHECKING, Any, NamedTuple

import pytest
from mcap.records import MessageIndex

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
    return times, said, any(words in said for words in ("nothing is known to be lost", "nothing lost"))


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


LONG = b"".join(raw_message(1, t, bytes([t]) * 40) for t in range(1, 9))
INNER = raw_channel() + raw_message(1, 1) + raw_message(1, 2)


def timed(time: int, body: bytes | None = None, **changes: Any) -> bytes:
    times = {"message_start_time": time, "message_end_time": time}
    return raw_chunk(raw_message(1, time) if body is None else body, **{**times, **changes})


#: Those times are all that there is.
KEPT: dict[str, Kept] = {
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
        for wrong in (3, 100)
    },
    "a channel that nothing describes": Kept(
        [timed(5, raw_channel(1) + raw_message(1, 5) + raw_message(2, 6), message_end_time=6)],
        [5],
        "channel 2 has messages",
        {"messages_lost": 1},
    ),
    "a schema that is missing": Kept([raw_channel(1, schema=9), raw_message(1, 5)], [5], "has schema 9"),
    "a message outside chunks that is longer": Kept(
        [
            raw_channel(),
            *messages(5),
            changed(raw_message(1, 6), 1, struct.pack("<Q", len(raw_message(1, 6)) - 9 + 40)),
            *messages(7, 8, 9, 10, 11),
        ],
        [5, 6, 9, 10, 11],
        whole=False,
    ),
    "an unknown compression may be none": Kept(
        [raw_chunk(BODY, compression="zstf")], [1], "known are none, lz4 and zstd"
    ),
    "a chunk of zeros is not one with unknown fields": Kept(
        [raw_chunk(BODY)[:9].ljust(len(raw_chunk(BODY)), b"\0"), raw_chunk(BODY)],
        [1],
        "declares no records in",
        whole=False,
    ),
    "a chunk that declares no size": Kept(
        [raw_chunk(BODY, compression="zstd", packed=zstd(BODY), uncompressed_size=0, uncompressed_crc=0)],
        [1],
        "declared",
    ),
    # What a wrong CRC means only an index tells.
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
    # The first bit of a message's opcode is another.
    "a message that is no record of MCAP": Kept(
        [raw_channel(), raw_message(1, 5), b"\x25" + raw_message(1, 6)[1:], raw_message(1, 7)],
        [5, 7],
        "has opcode 37, which MCAP does not have",
        {"bytes_lost": len(raw_message(1, 6))},
    ),
    "a message in a chunk that is no record of MCAP": Kept(
        [raw_chunk(INNER + b"\x25" + INNER[-34:] + INNER[-35:], message_end_time=2, uncompressed_crc=0)],
        [1, 2, 2],
        "has a record with opcode 37 in it",
        whole=False,
    ),
    # What follows the message is damaged. It holds the records of a file.
    "a message that looks like records": Kept(
        [raw_channel(), raw_message(1, 5, b"\xff" * 8 + INNER), bytes(13), *messages(6, 7)],
        [5, 6, 7],
        "has opcode 0",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", KEPT)
def test_what_is_sound_is_kept(name: str, tmp_path: Path) -> None:
    kept = KEPT[name]
    path = raw_file(tmp_path / "a.mcap", *kept.data)
    rows, damage = recovered(path)
    times = [row[2] for row in rows]
    assert times == kept.times
    fields = kept.fields or {}
    assert {field: getattr(damage[0], field) for field in fields} == fields
    again, said, whole = repaired(path)
    assert again == times
    assert kept.said in said
    assert kept.whole in (None, whole)


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


def test_chunks_that_the_index_misplaces_are_found(tmp_path: Path) -> None:
    path = made(tmp_path)
    sound, _ = recovered(path)
    parts = pieces(path)
    first, second, *_ = chunks_of(parts)
    # The message indexes of the first chunk are at the end of the data: every other chunk is elsewhere.
    moved = parts[first + 1 : second]
    end = next(place for place, part in enumerate(parts) if part[0] == 15)
    assert moved
    path.write_bytes(b"".join((*parts[: first + 1], *parts[second:end], *moved, *parts[end:])))
    rows, damage = recovered(path)
    assert rows == sound
    assert damage


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
    with closing(McapReader(path, strict=True)) as reader, pytest.raises(DamageError, match="decompressed"):
        content(reader)
