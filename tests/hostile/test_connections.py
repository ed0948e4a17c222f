"""More connections than are allowed: refused wherever a recording has them, and before they take memory."""

from __future__ import annotations

from contextlib import closing
from typing import TYPE_CHECKING

import pytest

from pc2scan.bags.opening import open_recording
from pc2scan.errors import RecordingError
from support import mcap_files, rosbag1_files
from support.rosbag2_files import write_storage

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


#: The limit in these tests.
MOST = 8


def records(count: int) -> bytes:
    return b"".join(rosbag1_files.connection_record(number, callerid=b"/%d" % number) for number in range(count))


def indexed_bag(path: Path, count: int) -> Path:
    return given(path / "a.bag", rosbag1_files.bag_header(rosbag1_files.FIRST_CHUNK, count, 0) + records(count))


def mcap_file(path: Path, count: int) -> Path:
    channels = b"".join(mcap_files.raw_channel(number, f"/{number}") for number in range(1, count + 1))
    return mcap_files.raw_file(path / "a.mcap", channels + mcap_files.raw_message(1))


def database(path: Path, count: int) -> Path:
    file = path / "a.db3"
    write_storage(file, [(f"/{number}", number) for number in range(count)])
    return file


def directory(path: Path, count: int) -> Path:
    """Its files share a topic: they are of one recording."""
    for part, numbers in enumerate((range(4), [0, *range(4, count)])):
        write_storage(path / f"a_{part}.mcap", [(f"/{number}", number) for number in numbers])
    return path


def given(path: Path, data: bytes) -> Path:
    path.write_bytes(data)
    return path


KINDS: list[Callable[[Path, int], Path]] = [indexed_bag, mcap_file, database, directory]


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
