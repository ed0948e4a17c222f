"""Chunks of very many messages: the same messages in the same order, with next to none of them in memory."""

from __future__ import annotations

import struct
from array import array
from contextlib import closing
from dataclasses import replace
from typing import TYPE_CHECKING

import pytest
import zstandard

from pc2scan.bags import units
from pc2scan.bags.mcap import chunks as mcap_chunks
from pc2scan.bags.mcap import records as mcap_records
from pc2scan.bags.mcap.write import McapWriter
from pc2scan.bags.opening import open_recording
from pc2scan.bags.rosbag1 import read as rosbag1_reader
from pc2scan.bags.units import Extent, LazyItems, Unit, merge_by_time
from pc2scan.errors import RecordingError
from pc2scan.model import StoredChunk
from support import mcap_files, rosbag1_files

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from pc2scan.model import RawMessage

#: Of two topics, not in order, some at the same time.
ROWS = [
    (number % 2, 1000 + 10 * (number // 2) + (number * 7) % 40, bytes([0, 1, 0, 0, number])) for number in range(99)
]

Row = tuple[str, int, bytes]


def mcap(path: Path, compression: str) -> Path:
    return mcap_files.write(path, ROWS, compression=compression)


def mcap_packed(path: Path, _compression: str) -> Path:
    """Messages that are packed one by one, one of which is broken."""
    rows = [(index, time_ns, zstandard.compress(data)) for index, time_ns, data in ROWS]
    rows[40] = (rows[40][0], rows[40][1], rows[40][2][:-3])
    return mcap_files.write(path, rows, compression="none")


def mcap_damaged(path: Path, _compression: str) -> Path:
    """A length is wrong, and a time."""
    mcap_files.write(path, ROWS, compression="none")
    data = bytearray(path.read_bytes())
    data[data.index(ROWS[30][2]) - 31 + 1] ^= 0x40
    at = data.index(ROWS[60][2]) - 16
    data[at : at + 8] = struct.pack("<Q", 1 << 62)
    path.write_bytes(data)
    return path


def bag(path: Path, compression: str) -> Path:
    connections = [replace(rosbag1_files.connection(f"/topic{number}"), id=number) for number in range(2)]
    return rosbag1_files.write(path, connections, ROWS, compression)


def bag_damaged(path: Path, _compression: str) -> Path:
    bag(path, "none")
    data = bytearray(path.read_bytes())
    data[data.index(ROWS[30][2]) - 3] ^= 0x40
    path.write_bytes(data)
    return path


def read(path: Path, start_ns: int | None, stop_ns: int | None) -> tuple[list[Row], list[str]]:
    with closing(open_recording(path)) as reader:
        rows = [(m.connection.topic, m.log_time_ns, bytes(m.data)) for m in reader.messages(None, start_ns, stop_ns)]
        return rows, [place.what for place in reader.damage]


@pytest.mark.parametrize("cut", [(None, None), (1100, 1300)])
@pytest.mark.parametrize("compression", ["none", "lz4"])
@pytest.mark.parametrize(
    ("make", "name"),
    [(mcap, "a.mcap"), (mcap_packed, "a.mcap"), (mcap_damaged, "a.mcap"), (bag, "a.bag"), (bag_damaged, "a.bag")],
)
def test_the_messages_are_the_same(
    make: Callable[[Path, str], Path],
    name: str,
    compression: str,
    cut: tuple[int | None, int | None],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    path = make(tmp_path / name, compression)
    expected = read(path, *cut)
    made = []
    original = LazyItems.__init__

    def init(self: LazyItems[RawMessage], *args: object) -> None:
        original(self, *args)  # type: ignore[arg-type]
        made.append(self)

    monkeypatch.setattr(LazyItems, "__init__", init)
    for module in (units, mcap_chunks, mcap_records, rosbag1_reader):
        monkeypatch.setattr(module, "MAX_LISTED_ITEMS", 7)
    assert read(path, *cut) == expected
    assert any(len(each) > 7 for each in made)
    assert expected[0]
    with closing(open_recording(path)) as reader:
        loaded = [unit.load(lambda message: message, whole=False) for unit in reader.units(None, *cut)]
    assert {isinstance(each, LazyItems) for each in loaded if not isinstance(each, StoredChunk) and len(each) > 7} == {
        True
    }


def test_an_item_is_made_once_while_it_is_due() -> None:
    made = []

    def make(place: int) -> int:
        made.append(place)
        return place

    items = LazyItems(array("Q", [1, 2]), array("Q", [0, 1]), make, 0)
    assert [items[0], items[0], items[1], items[1]] == [0, 0, 1, 1]
    assert made == [0, 1]


def test_more_messages_than_bytes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A few bytes unpack to a million of messages; how many such chunks there are must not decide on the time."""
    monkeypatch.setattr(units, "_MAX_FREE_MESSAGES", 10)
    path = mcap(tmp_path / "a.mcap", "zstd")
    with closing(open_recording(path)) as reader:
        (unit,) = reader.units()
        assert isinstance(unit, Unit)
        assert isinstance(unit.extent, Extent)
        assert len(list(merge_by_time([unit]))) == 99
        few = unit._replace(extent=unit.extent._replace(length=80))
        with pytest.raises(RecordingError, match="more messages than bytes"):
            list(merge_by_time([few]))


def test_small_recordings_may_have_more_messages_than_bytes(tmp_path: Path) -> None:
    writer = McapWriter(tmp_path / "a.mcap")
    handle = writer.add_connection(mcap_files.connection())
    for _ in range(20_000):
        writer.write(handle, 1, b"", 1)
    writer.finish()
    with closing(open_recording(tmp_path / "a.mcap")) as reader:
        assert sum(unit.extent.length for unit in reader.units() if unit.extent) < 5_000
        assert len(list(reader.messages())) == 20_000
