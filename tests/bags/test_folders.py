"""Which files are the parts of one recording, and which are several."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from pc2scan.bags.folders import are_named_as_parts, overlap_warnings, recordings_in
from pc2scan.bags.opening import open_recording
from pc2scan.errors import UsageError
from support.rosbag2_files import write_metadata, write_storage

SECOND = 1_000_000_000
MINUTE = 60 * SECOND


@pytest.mark.parametrize(
    ("names", "parts"),
    [
        (["anything.mcap"], True),
        (["drive_0.mcap", "drive_1.mcap", "drive_10.mcap"], True),
        (["drive_0.mcap.zstd", "drive_1.mcap.zstd"], True),
        (["drive_0.bag", "drive_1.bag.active"], True),
        (["x_2020-11-04-18-39-50_0.bag", "x_2020-11-04-18-42-50_1.bag"], True),
        (["2020-11-04-18-39-50_0.bag", "2020-11-04-18-42-50_1.bag"], True),
        (["x_2020-11-04-18-39-50.bag", "x_2020-11-04-18-42-50.bag"], False),
        (["rosbag2_2020_11_04-18_39_50_0.mcap", "rosbag2_2020_11_04-18_42_50_0.mcap"], False),
        (["drive_0.mcap", "walk_1.mcap"], False),
        (["drive_0.mcap", "drive_1.db3"], False),
        (["drive_0.mcap", "drive_0.mcap.zst"], False),
        (["0.mcap", "1.mcap"], False),
        (["a.mcap", "b.mcap"], False),
        (["here/drive_0.bag", "there/drive_1.bag"], False),
    ],
)
def test_names_of_parts(names: list[str], parts: bool) -> None:
    assert are_named_as_parts(map(Path, names)) is parts


def test_recordings_of_a_folder(tmp_path: Path) -> None:
    for name in ("b10.bag", "b9.bag", "c.BAG.active", "d.mcap.zst", "e.db3", "e.db3-wal", "notes.txt", "._b9.bag"):
        (tmp_path / name).touch()
    for name in ("f", "g", "empty"):
        (tmp_path / name).mkdir()
    write_metadata(tmp_path / "f", 8, ["f_0.db3"])
    (tmp_path / "g" / "g_0.mcap").touch()
    names = [path.name for path in recordings_in(tmp_path)]
    assert names == ["b9.bag", "b10.bag", "c.BAG.active", "d.mcap.zst", "e.db3", "f", "g"]


@pytest.mark.parametrize(
    ("first", "second", "why"),
    [
        ({"messages": [("/a", 5)]}, {"messages": [("/a", 6)]}, ""),
        # A part that is missing leaves a gap; a topic may begin late.
        ({"messages": [("/a", 5)]}, {"messages": [("/a", 5 + MINUTE), ("/b", 6 + MINUTE)]}, ""),
        # A recorder's threads may write messages late.
        (
            {"messages": [("/a", 0), ("/a", 9 * SECOND)]},
            {"messages": [("/a", 8 * SECOND), ("/a", 19 * SECOND)]},
            "",
        ),
        (
            {"messages": [("/a", 0), ("/a", SECOND)]},
            {"messages": [("/a", 0), ("/a", SECOND)]},
            "x_1.mcap does not begin where x_0.mcap ends",
        ),
        ({"messages": [("/a", 5)]}, {"messages": []}, ""),
        ({"messages": [("/a", 5)]}, {"messages": [("/b", 6)]}, "have no topic in common"),
        (
            {"messages": [("/a", 5)]},
            {"messages": [("/a", 6)], "msgtype": "std_msgs/msg/Bool"},
            "/a has other types in x_0.mcap and x_1.mcap",
        ),
        ({"messages": [("/a", 2 * SECOND)]}, {"messages": [("/a", 5)]}, "x_1.mcap does not begin where x_0.mcap ends"),
        (
            {"messages": [("/a", 5)]},
            {"messages": [("/a", 6 + MINUTE)]},
            r"x_1.mcap begins 60.000 s after the end of x_0.mcap",
        ),
    ],
)
def test_parts_without_metadata(tmp_path: Path, first: dict[str, Any], second: dict[str, Any], why: str) -> None:
    for number, content in enumerate((first, second)):
        write_storage(tmp_path / f"x_{number}.mcap", **content)
    if not why:
        with closing(open_recording(tmp_path)) as reader:
            assert len(list(reader.messages())) == len(first["messages"]) + len(second["messages"])
        return
    with pytest.raises(UsageError, match="holds 2 recordings") as caught:
        open_recording(tmp_path)
    assert why in caught.value.message


def test_a_part_may_be_missing(tmp_path: Path) -> None:
    write_storage(tmp_path / "x_0.mcap", [("/a", 5)])
    write_storage(tmp_path / "x_2.mcap", [("/a", 5 + 10 * MINUTE)])
    with closing(open_recording(tmp_path)) as reader:
        assert reader.summary.message_count == 2


def warnings_of(*paths: Path) -> list[str]:
    readers = [open_recording(path) for path in paths]
    try:
        return overlap_warnings(readers)
    finally:
        for reader in readers:
            reader.close()


def test_recordings_that_overlap(tmp_path: Path) -> None:
    one, other, later = (tmp_path / f"{name}.mcap" for name in "abc")
    write_storage(one, [("/a", 0), ("/a", 2 * SECOND)], qos="")
    write_storage(other, [("/a", SECOND), ("/a", 3 * SECOND)], qos="")
    write_storage(later, [("/a", 4 * SECOND)], qos="")
    (warning,) = warnings_of(one, other, later)
    assert warning.startswith(f"{one} and {other} overlap in time, by up to 1.000 s, on /a: ")
    assert warnings_of(one, later) == warnings_of(other, later) == warnings_of(one) == []


def test_recordings_that_may_overlap(tmp_path: Path) -> None:
    paths = [tmp_path / name for name in ("x_0.mcap", "x_1.mcap", "other.mcap", "latched.mcap")]
    write_storage(paths[0], [("/a", 0), ("/a", 2 * SECOND)], qos="")
    write_storage(paths[1], [("/a", 2 * SECOND - 1), ("/a", 3 * SECOND)], qos="")
    write_storage(paths[2], [("/b", 0), ("/b", 3 * SECOND)], qos="")
    write_storage(paths[3], [("/a", 0), ("/a", 3 * SECOND)])
    assert warnings_of(*paths) == []
