"""More connections than are allowed: refused wherever a recording has them, and before they take memory."""

from __future__ import annotations

import sqlite3
import struct
from contextlib import closing
from typing import TYPE_CHECKING

import pytest
import zstandard
from mcap.records import Schema

from pc2scan.bags.opening import open_recording
from pc2scan.errors import RecordingError
from support import mcap_files, rosbag1_files
from support.bounded import run_bounded
from support.rosbag2_files import write_storage

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


#: The limit in these tests.
MOST = 8

LONG = 4_000_000


def records(count: int) -> bytes:
    return b"".join(rosbag1_files.connection_record(number, callerid=b"/%d" % number) for number in range(count))


def indexed_bag(path: Path, count: int) -> Path:
    return given(path / "a.bag", rosbag1_files.bag_header(rosbag1_files.FIRST_CHUNK, count, 0) + records(count))


def bag_without_index(path: Path, count: int) -> Path:
    return given(path / "a.bag", rosbag1_files.bag_header(0, 0, 0) + records(count) + rosbag1_files.message(5))


def bag_that_was_never_closed(path: Path, count: int) -> Path:
    chunk = rosbag1_files.chunk(records(count) + rosbag1_files.message(5), "bz2")
    return given(path / "a.bag", rosbag1_files.bag_header(0, 0, 0) + chunk)


def bag_that_describes_them_in_a_chunk(path: Path, count: int) -> Path:
    payload = records(count) + b"".join(rosbag1_files.message(5, identity=number) for number in range(count))
    return rosbag1_files.simple_bag(path / "a.bag", payload, counts=dict.fromkeys(range(count), 1), connections=())


def mcap_file(path: Path, count: int) -> Path:
    channels = b"".join(mcap_files.raw_channel(number, f"/{number}") for number in range(1, count + 1))
    return mcap_files.raw_file(path / "a.mcap", channels + mcap_files.raw_message(1))


def mcap_chunk(path: Path, count: int) -> Path:
    body = b"".join(mcap_files.raw_channel(number, f"/{number}") for number in range(1, count + 1))
    chunk = mcap_files.raw_chunk(body + mcap_files.raw_message(1, 1))
    return mcap_files.raw_file(path / "a.mcap", chunk)


def cut_mcap_file(path: Path, count: int) -> Path:
    file = mcap_file(path, count)
    return given(file, file.read_bytes()[:-20])


def database(path: Path, count: int) -> Path:
    file = path / "a.db3"
    write_storage(file, [(f"/{number}", number) for number in range(count)])
    return file


def damaged_database(path: Path, count: int) -> Path:
    data = bytearray(database(path, count).read_bytes())
    struct.pack_into(">I", data, 28, 1_000_000)
    return given(path / "a.db3", bytes(data))


def directory(path: Path, count: int) -> Path:
    """Its files share a topic: they are of one recording."""
    for part, numbers in enumerate((range(4), [0, *range(4, count)])):
        write_storage(path / f"a_{part}.mcap", [(f"/{number}", number) for number in numbers])
    return path


def given(path: Path, data: bytes) -> Path:
    path.write_bytes(data)
    return path


KINDS: list[Callable[[Path, int], Path]] = [
    indexed_bag,
    bag_without_index,
    bag_that_was_never_closed,
    bag_that_describes_them_in_a_chunk,
    mcap_file,
    mcap_chunk,
    cut_mcap_file,
    database,
    damaged_database,
    directory,
]


@pytest.mark.parametrize("make", KINDS, ids=lambda make: make.__name__.replace("_", " "))
def test_every_reader_keeps_the_limit_of_connections(
    make: Callable[[Path, int], Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pc2scan.bags.reader.MAX_CONNECTIONS", MOST)
    for count in (MOST, MOST + 1):
        folder = tmp_path / str(count)
        folder.mkdir()
        source = make(folder, count)
        if count > MOST:
            with pytest.raises(RecordingError, match="has more than 8 connections"):
                open_recording(source)
            return
        with closing(open_recording(source)) as reader:
            assert len(reader.connections) == MOST


def test_a_directory_of_too_many_topics_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pc2scan.bags.reader.MAX_CONNECTIONS", MOST)
    for part in range(9):
        write_storage(tmp_path / f"a_{part}.mcap", [("/0", 0)] + [(f"/{part}_{number}", number) for number in range(3)])
    with pytest.raises(RecordingError, match="has more than 8 connections"):
        open_recording(tmp_path)


def test_messages_of_more_topics_than_are_allowed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Their topics are not described: each would be damage of its own."""
    monkeypatch.setattr("pc2scan.bags.reader.MAX_CONNECTIONS", MOST)
    monkeypatch.setattr("pc2scan.bags.rosbag2.sqlite3.read.MAX_CONNECTIONS", MOST)
    source = database(tmp_path, MOST)
    with closing(sqlite3.connect(source)) as opened, opened:
        opened.execute("UPDATE messages SET topic_id = 100 WHERE id = 3")
    with closing(open_recording(source)) as reader:
        assert "of topic 100" in reader.damage[0].what
    with closing(sqlite3.connect(source)) as opened, opened:
        opened.execute("INSERT INTO messages(topic_id, timestamp, data) VALUES (101, 1, x'00')")
    with pytest.raises(RecordingError, match="has more than 8 connections"):
        open_recording(source)


def bag_of_long_definitions(path: Path) -> Path:
    chunks = (
        rosbag1_files.chunk(
            rosbag1_files.connection_record(number, message_definition=b"#" * LONG)
            + rosbag1_files.message(5, identity=number),
            "bz2",
        )
        for number in range(20)
    )
    return given(path / "a.bag", rosbag1_files.bag_header(0, 0, 0) + b"".join(chunks))


def mcap_of_long_definitions(path: Path) -> Path:
    chunks = []
    for number in range(1, 21):
        schema = Schema(id=number, name="a/msg/A", encoding="ros2msg", data=b"#" * LONG)
        body = mcap_files.encoded(schema) + mcap_files.raw_channel(number, f"/{number}", schema=number)
        body += mcap_files.raw_message(number, 5)
        chunks.append(mcap_files.raw_chunk(body, compression="zstd", packed=zstandard.compress(body)))
    return mcap_files.raw_file(path / "a.mcap", *chunks)


@pytest.mark.parametrize("make", [bag_of_long_definitions, mcap_of_long_definitions])
def test_long_definitions_in_small_chunks_are_refused(make: Callable[[Path], Path], tmp_path: Path) -> None:
    source = make(tmp_path)
    assert source.stat().st_size < 30_000
    done = run_bounded("info", source)
    assert done.status == 1
    assert "describes its connections in more than" in done.stderr


@pytest.mark.slow
def test_connections_in_a_small_chunk_take_little_memory(tmp_path: Path) -> None:
    source = bag_that_was_never_closed(tmp_path, 70_000)
    assert source.stat().st_size < 200_000
    done = run_bounded("info", source)
    assert done.status == 1
    assert "has more than 65,536 connections" in done.stderr


def test_a_header_of_very_many_fields_is_damage(tmp_path: Path) -> None:
    fields = b"".join(struct.pack("<I", 7) + b"%06x=" % number for number in range(200_000))
    body = rosbag1_files.header(topic=b"/a", type=b"a/A", md5sum=b"*", message_definition=b"")[4:] + fields
    record = rosbag1_files.record(body, op=b"\x07", conn=rosbag1_files.uint32(0), topic=b"/a")
    chunk = rosbag1_files.chunk(record + rosbag1_files.message(5), "bz2")
    source = given(tmp_path / "a.bag", rosbag1_files.bag_header(0, 0, 0) + chunk)
    done = run_bounded("info", source)
    assert "a header has more than 4096 fields" in done.stderr
