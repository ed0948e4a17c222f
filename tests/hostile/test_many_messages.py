"""Few bytes that unpack to very many messages, or to messages that unpack to very many bytes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
import zstandard
from mcap.records import Schema

from support import mcap_files, rosbag1_files
from support.bounded import run_bounded
from support.command import run

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

STRING = mcap_files.encoded(Schema(id=1, name="std_msgs/msg/String", encoding="ros2msg", data=b"string data\n"))

#: As objects, of some 400 bytes each, the messages of such a chunk would take more memory than the margin.
MANY = 300_000
MARGIN = 95_000_000

EMPTY = b"\0\1\0\0\1\0\0\0\0"


def mcap(path: Path, *chunks: bytes) -> Path:
    return mcap_files.raw_file(path, STRING, mcap_files.raw_channel(schema=1), *chunks)


def chunk(rows: Iterable[tuple[int, bytes]], **changes: int) -> bytes:
    """A chunk of messages: log time, data."""
    made = list(rows)
    body = b"".join(mcap_files.raw_message(1, time_ns, data) for time_ns, data in made)
    times = {"message_start_time": min(made)[0], "message_end_time": max(made)[0]}
    return mcap_files.raw_chunk(body, compression="zstd", packed=zstandard.compress(body), **times | changes)


def test_thousands_of_equal_messages_are_no_attack(tmp_path: Path) -> None:
    source = mcap(tmp_path / "a.mcap", chunk((5, EMPTY) for _ in range(9_000)))
    assert source.stat().st_size < 2_000
    done = run("repair", source, "-o", tmp_path / "out.mcap")
    assert (done.status, "9,000" in done.stdout) == (0, True), done.stderr


@pytest.mark.slow
@pytest.mark.parametrize("changes", [{}, {"uncompressed_crc": 7}])
def test_a_chunk_of_very_many_messages(changes: dict[str, int], tmp_path: Path) -> None:
    source = mcap(tmp_path / "a.mcap", chunk(((5 + number // 2000, b"") for number in range(MANY)), **changes))
    done = run_bounded("repair", source, "-o", tmp_path / "out.mcap", margin=MARGIN)
    assert done.status == (3 if changes else 0), done.stderr
    assert f"{MANY:,}" in done.stdout


@pytest.mark.slow
def test_a_chunk_of_very_many_messages_in_a_bag(tmp_path: Path) -> None:
    payload = rosbag1_files.connection_record() + rosbag1_files.message(5, b"") * MANY
    source = rosbag1_files.simple_bag(tmp_path / "a.bag", payload, compression="lz4")
    done = run_bounded("repair", source, "-o", tmp_path / "out.bag", margin=MARGIN)
    assert f"{MANY:,}" in done.stdout


@pytest.mark.slow
def test_chunks_of_very_many_messages_that_take_turns(tmp_path: Path) -> None:
    chunks = (chunk((1 + 8 * number + place, EMPTY) for number in range(50_000)) for place in range(8))
    source = mcap(tmp_path / "a.mcap", *chunks)
    done = run_bounded("repair", source, "-o", tmp_path / "out.mcap")
    assert done.status == 0, done.stderr
    assert "400,000" in done.stdout


def test_messages_packed_one_by_one_that_unfold(tmp_path: Path) -> None:
    """Each is within what a message may unpack to; all of one chunk were unpacked at once."""
    packed = zstandard.compress(EMPTY[:4] + bytes(30_000_000))
    source = mcap(tmp_path / "a.mcap", chunk((1 + number, packed) for number in range(12)))
    done = run_bounded("repair", source, "-o", tmp_path / "out.mcap")
    assert done.status == 0, done.stderr
    assert "12" in done.stdout
