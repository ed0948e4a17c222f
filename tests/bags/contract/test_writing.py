"""What every writer keeps to: what it writes is read by pc2scan and by others, and nothing else is touched."""

from __future__ import annotations

import tempfile
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pc2scan.bags.mcap.write import McapWriter
from pc2scan.bags.opening import open_recording
from pc2scan.bags.rosbag1.write import Rosbag1Writer
from pc2scan.bags.rosbag2.sqlite3.write import Sqlite3Writer
from pc2scan.errors import UnwritableError
from pc2scan.model import Definition
from support.containers import FORMATS, KINDS, connection_for, read, recorded
from support.outputs import opened

if TYPE_CHECKING:
    from pc2scan.model import Writer

T0 = 1_700_000_000_123_456_789

#: Not in the order of time, with equal times, and one that has a chunk of its own.
SMALL = [(("/a", "/b")[n % 2], T0 + (n * 37) % 50, b"\0\1\0\0" + bytes([n]) * (n * 7)) for n in range(100)]
LARGE = ("/a", T0 + 60, b"\0\1\0\0" + b"large" * 200_000)
ROWS = [*SMALL[:50], LARGE, *SMALL[50:]]
BY_TIME = sorted(ROWS, key=lambda row: row[1])


@pytest.mark.parametrize("name", KINDS)
def test_written_messages_are_read_by_all(name: str, tmp_path: Path) -> None:
    kind = KINDS[name]
    (tmp_path / "again").mkdir()
    silent = connection_for(kind.ros_version, "/silent")
    path, again = (recorded(kind, folder, ROWS, [silent]) for folder in (tmp_path, tmp_path / "again"))
    found = opened(path)
    assert [row.log_time_ns for row in found.messages] == [row[1] for row in BY_TIME]
    for topic in ("/a", "/b"):
        assert [row.data for row in found.of(topic)] == [row[2] for row in BY_TIME if row[0] == topic]
    assert sorted(publisher.topic for publisher in found.publishers) == ["/a", "/b", "/silent"]
    assert {publisher.definition for publisher in found.publishers} == {"string data\n"}
    assert [publisher.latched for publisher in found.publishers] == [kind.ros_version == 2] * 3
    files = [path] if path.is_file() else sorted(path.iterdir())
    others = [again] if path.is_file() else sorted(again.iterdir())
    assert [file.read_bytes() for file in files] == [file.read_bytes() for file in others]
    with closing(open_recording(path, strict=True)) as reader:
        assert [(m.connection.topic, m.log_time_ns, bytes(m.data)) for m in reader.messages()] == BY_TIME
        assert {c.topic: c.message_count for c in reader.connections} == {"/silent": 0, "/a": 51, "/b": 50}
        summary = reader.summary
        compression = kind.options.get("compression") or ("none" if "sqlite3" in name else "zstd")
        assert (summary.container, summary.compression) == (kind.container, (compression,))
        assert (summary.message_count, summary.start_ns, summary.end_ns) == (101, T0, T0 + 60)
        assert summary.size_bytes == sum(file.stat().st_size for file in files if file.suffix != ".yaml")
        assert reader.path == path
        assert reader.damage == ()


@pytest.mark.parametrize("kind", FORMATS.values(), ids=FORMATS)
def test_connections_are_kept_as_they_are(kind: Any, tmp_path: Path) -> None:
    is_ros1 = kind.ros_version == 1
    odd: dict[str, Any] = {
        "definition": Definition(f"ros{kind.ros_version}msg", b"# caf\xe9\r\nstring data\n"),
        "msgtype": "custom_msgs/Odd" if is_ros1 else "custom_msgs/msg/Odd",
    }
    given = [
        connection_for(kind.ros_version, "/ü?#%", **odd, callerid="/n" if is_ros1 else None),
        connection_for(kind.ros_version, "no_slash//double", latching=True),
        connection_for(kind.ros_version, "/plain", digest="*" if is_ros1 else "", qos="", latching=False),
    ]
    path = recorded(kind, tmp_path, [], given)
    names = ("topic", "msgtype", "serialization", "definition", "digest", "callerid", "latching", "qos")
    with closing(open_recording(path, strict=True)) as reader:
        summary = reader.summary
        assert (summary.message_count, summary.start_ns, summary.end_ns) == (0, None, None)
        assert list(reader.messages()) == []
        for own, other in zip(reader.connections, given, strict=True):
            for name in names:
                assert getattr(own, name) == getattr(other, name), name


@given(
    # As CDR, a message begins with a zero byte.
    rows=st.lists(st.tuples(st.integers(0, 2), st.integers(0, 6), st.binary(max_size=300).map(lambda b: b"\0" + b))),
    name=st.sampled_from(["bag", "mcap", "sqlite3"]),
    compression=st.integers(0, 2),
    chunk_size=st.sampled_from((1, 200, 1000, 1 << 20)),
    wanted=st.sets(st.integers(0, 2)),
    start=st.none() | st.integers(0, 6),
    stop=st.none() | st.integers(0, 6),
)
def test_any_recording_is_read_as_a_stable_sort(
    rows: list[tuple[int, int, bytes]],
    name: str,
    compression: int,
    chunk_size: int,
    wanted: set[int],
    start: int | None,
    stop: int | None,
) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "file"
        if name == "bag":
            writer: Writer = Rosbag1Writer(path, ("none", "lz4", "bz2")[compression], chunk_size)
        elif name == "mcap":
            writer = McapWriter(path, compression=("none", "lz4", "zstd")[compression], chunk_size=chunk_size)
        else:
            writer = Sqlite3Writer(path, compression=("none", "zstd", "none")[compression])
        handles = [writer.add_connection(connection_for(1 if name == "bag" else 2, f"/{n}")) for n in range(3)]
        for number, (index, time_ns, data) in enumerate(rows):
            writer.write(handles[index], time_ns, data, time_ns, number)
        writer.finish()
        in_order = sorted(rows, key=lambda row: row[1])
        with closing(open_recording(path, strict=True)) as reader:
            assert [(int(m.connection.topic[1:]), m.log_time_ns, bytes(m.data)) for m in reader.messages()] == in_order
            chosen = [each for each in reader.connections if int(each.topic[1:]) in wanted]
            expected = [
                row
                for row in in_order
                if row[0] in wanted and (start is None or start <= row[1]) and (stop is None or row[1] < stop)
            ]
            found = list(reader.messages(chosen, start, stop))
            assert [(int(m.connection.topic[1:]), m.log_time_ns, bytes(m.data)) for m in found] == expected
            counted = {c.topic: reader.counts(chosen, start, stop).get(c.id) for c in chosen}
            assert counted == {f"/{index}": sum(row[0] == index for row in expected) for index in wanted}


@pytest.mark.parametrize("kind", [FORMATS["bag"], KINDS["bag-lz4"], *FORMATS.values()][1:], ids=["lz4", *FORMATS])
def test_buffers_may_be_reused_after_the_call(kind: Any, tmp_path: Path) -> None:
    sizes = [10, 70_000, 3, 65_536, 65_535, 0, 900_000]
    writer = kind.writer(tmp_path)
    handle = writer.add_connection(connection_for(kind.ros_version))
    for time_ns, size in enumerate(sizes):
        buffer = bytearray(b"x" * size)
        writer.write(handle, time_ns, memoryview(buffer), time_ns)
        buffer[:] = bytes(size)
        buffer.clear()  # a view that is still held makes this a BufferError
    writer.finish()
    assert [data for _, _, data in read(tmp_path / kind.name)] == [b"x" * size for size in sizes]


# --- What cannot be written ---


#: Log time, publish time and sequence that do not fit; and the largest and smallest that do.
NUMBERS: dict[str, tuple[list[tuple[int, int, int]], list[tuple[int, int, int]], str]] = {
    "bag": (
        [(-1, 0, 0), (2**32 * 1_000_000_000, 0, 0)],
        [(0, 0, 0), (2**32 * 1_000_000_000 - 1, 0, 0)],
        "outside the 0 to 4294967295 s",
    ),
    "mcap": (
        [(-1, 0, 0), (0, -1, 0), (1 << 64, 0, 0), (0, 0, 1 << 32)],
        [(0, 0, 0), ((1 << 64) - 1, (1 << 64) - 1, (1 << 32) - 1)],
        "unsigned",
    ),
    "rosbag2-sqlite3": (
        [(2**63, 0, 0), (-(2**63) - 1, 0, 0)],
        [(-(2**63), 0, 0), (2**63 - 1, 0, 0)],
        "that rosbag2 can hold",
    ),
}


@pytest.mark.parametrize("name", NUMBERS)
def test_numbers_that_do_not_fit_are_refused(name: str, tmp_path: Path) -> None:
    refused, fitting, told = NUMBERS[name]
    writer = FORMATS[name].writer(tmp_path)
    handle = writer.add_connection(connection_for(FORMATS[name].ros_version))
    for log_time, publish_time, sequence in fitting:
        writer.write(handle, log_time, b"\0", publish_time, sequence)
    for log_time, publish_time, sequence in refused:
        with pytest.raises(UnwritableError, match=told):
            writer.write(handle, log_time, b"\0", publish_time, sequence)
    writer.finish()
    with closing(open_recording(tmp_path / FORMATS[name].name)) as reader:
        found = [(m.log_time_ns, m.publish_time_ns, m.sequence) for m in reader.messages()]
    assert [row[0] for row in found] == [row[0] for row in fitting]
    if name == "mcap":
        assert found == fitting
