"""Few bytes that unpack to very many messages, or to messages that unpack to very many bytes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import zstandard
from mcap.records import Schema

from support import mcap_files
from support.bounded import run_bounded
from support.command import run

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

STRING = mcap_files.encoded(Schema(id=1, name="std_msgs/msg/String", encoding="ros2msg", data=b"string data\n"))

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


def test_a_chunk_of_more_messages_than_any_has(tmp_path: Path) -> None:
    source = mcap(tmp_path / "a.mcap", chunk((5, b"") for _ in range(600_000)))
    done = run_bounded("repair", source, "-o", tmp_path / "out.mcap", margin=300_000_000)
    assert done.status == 1, done.stderr
    assert "a chunk has more than 524,288 messages" in done.stderr


def test_messages_packed_one_by_one_that_unfold(tmp_path: Path) -> None:
    """Each is within what a message may unpack to; all of one chunk were unpacked at once."""
    packed = zstandard.compress(EMPTY[:4] + bytes(30_000_000))
    source = mcap(tmp_path / "a.mcap", chunk((1 + number, packed) for number in range(12)))
    done = run_bounded("repair", source, "-o", tmp_path / "out.mcap")
    assert done.status == 1
    assert "unpack to more than" in done.stderr
