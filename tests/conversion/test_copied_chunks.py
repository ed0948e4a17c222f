"""Chunks that are copied whole: which ones, what it costs (counted), and that the messages are the same."""

from __future__ import annotations

from contextlib import closing
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

import pc2scan
from pc2scan.bags import chunks
from pc2scan.bags.mcap.read import McapReader
from pc2scan.bags.mcap.write import McapWriter
from pc2scan.bags.rosbag1.read import Rosbag1Reader
from pc2scan.bags.rosbag1.write import Rosbag1Writer
from pc2scan.errors import DamageError
from pc2scan.messages.definitions import definition
from pc2scan.messages.pointcloud2 import POINTCLOUD2
from pc2scan.model import Connection, Definition
from support import builders, sampled
from support.outputs import opened

if TYPE_CHECKING:
    from pathlib import Path

T0 = 1_600_000_000_000_000_000
STEP = 1_000_000
CHUNK = 40_000
IMAGES_A_CHUNK = 3
ROUNDS = 4
FORMS = [(".bag", "lz4"), (".bag", "none"), (".bag", "bz2"), (".mcap", "zstd"), (".mcap", "none"), (".mcap", "lz4")]
Row = tuple[str, int, bytes]
PARAMS = pc2scan.ProjectionParams(min_height=-2, max_height=2)


@pytest.fixture(autouse=True)
def small_chunks_count(monkeypatch: pytest.MonkeyPatch) -> None:
    """Chunks of a few kB are worth copying here, lest the recordings be large."""
    monkeypatch.setattr(chunks, "MIN_WHOLE_BYTES", 20_000)


def image(number: int) -> bytes:
    """Something that compresses to about a half."""
    return np.random.default_rng(number).integers(0, 16, 12_000).astype("u1").tobytes()


def cloud(ros_version: int, number: int) -> bytes:
    points = np.random.default_rng(number).uniform(-8, 8, (20, 3)).astype("<f4")
    return builders.cloud(points, ros_version, seq=number, stamp_ns=T0 + number)


def write(path: Path, compression: str, messages: list[Row] | None = None) -> Path:
    """Write messages, those of `drive` if none are given: clouds, and two topics of images.

    They have ids as no writer of ours would choose them.
    """
    bag = path.suffix == ".bag"
    kind: Any = Rosbag1Writer if bag else McapWriter
    writer: Any = kind(path, compression, chunk_size=CHUNK)
    serialization = "ros1" if bag else "cdr"
    text, digest = definition(POINTCLOUD2, 1 if bag else 2)
    blob = Definition("ros1msg" if bag else "ros2msg", b"uint8[] data\n")
    blobs = "pc2scan_msgs/Blob" if bag else "pc2scan_msgs/msg/Blob"
    known = [
        Connection(7, "/points", POINTCLOUD2, serialization, text, digest, schema_id=4),
        Connection(3, "/left", blobs, serialization, blob, "*", schema_id=9),
        Connection(5, "/right", blobs, serialization, blob, "*", schema_id=9),
    ]
    writer.keep_ids(known)
    handles = {connection.topic: writer.add_connection(connection) for connection in known}
    for topic, time_ns, data in drive(bag=bag) if messages is None else messages:
        if topic:
            writer.write(handles[topic], time_ns, data, time_ns, 1)
        elif bag:
            writer._flush()
        else:
            writer._finish_chunk()
    writer.finish()
    return path


def drive(*, bag: bool = False) -> list[Row]:
    """Chunks of images alone, and between them chunks with a cloud and an image; a topic that is empty ends a chunk."""
    found: list[Row] = []
    for number in range(ROUNDS * (IMAGES_A_CHUNK + 2)):
        time_ns = T0 + number * STEP
        if number % (IMAGES_A_CHUNK + 2) == 0:
            found += [("", 0, b""), ("/points", time_ns, cloud(1 if bag else 2, number))]
        else:
            found.append(("/left" if number % 2 else "/right", time_ns, image(number)))
        if number % (IMAGES_A_CHUNK + 2) == 1:
            found.append(("", 0, b""))
    return found


@pytest.fixture(params=sampled([pytest.param(form, id="".join(form)[1:].replace(".", "-")) for form in FORMS], 2))
def source(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    suffix, compression = request.param
    return write(tmp_path / f"drive{suffix}", compression)


def stored_chunks(path: Path) -> list[tuple[frozenset[int] | None, str, bytes]]:
    """Connections, compression and stored bytes of every chunk."""
    reader: Any = Rosbag1Reader(path) if path.suffix == ".bag" else McapReader(path)
    with closing(reader):
        return [(s.connection_ids, s.compression, reader._file.read(s.offset, s.length)) for s in reader._segments]


def images_only(path: Path) -> list[bytes]:
    return [stored for ids, _, stored in stored_chunks(path) if ids is not None and ids <= {3, 5}]


def convert(source: Path, **options: Any) -> Path:
    destination = source.with_name(f"scans{source.suffix}")
    pc2scan.convert(source, destination, params=PARAMS, overwrite=True, **options)
    return destination


@pytest.mark.parametrize(
    "options", sampled([{}, {"keep_clouds": True}, {"compression": "lz4"}, {"start": "0.004"}], 2), ids=str
)
def test_the_bytes_do_not_depend_on_the_threads(source: Path, options: dict[str, Any]) -> None:
    alone = convert(source, jobs=1, **options).read_bytes()
    assert [convert(source, jobs=jobs, **options).read_bytes() == alone for jobs in (2, 5)] == [True, True]


@pytest.mark.parametrize("options", [{"drop": ["/right"]}, {"keep": ["/right"]}], ids=str)
def test_a_chunk_with_something_left_out_is_taken_apart(source: Path, options: dict[str, Any]) -> None:
    there = images_only(source)
    destination = convert(source, **options)
    assert not {stored for _, _, stored in stored_chunks(destination)} & set(there)
    (gone,) = options.get("drop", ["/left"])
    assert gone not in opened(destination).topics()


def test_only_chunks_inside_the_cut_are_copied(source: Path) -> None:
    there = images_only(source)
    # The cut begins and ends inside the first and the last chunk of images.
    start, end = T0 + 3 * STEP, T0 + (ROUNDS * (IMAGES_A_CHUNK + 2) - 1) * STEP
    destination = convert(source, start=str(start), end=str(end))
    written = {stored for _, _, stored in stored_chunks(destination)}
    inside = [stored for stored in there if stored in written]
    # The chunk that the cut divides may declare connections that the next one uses. So a bag's next chunk is written
    # anew: ROS 1's reindex finds every connection where it is first used.
    assert inside == there[2 if source.suffix == ".bag" else 1 : -1]
    times = [found.log_time_ns for found in opened(destination).messages]
    assert times == [start + STEP * i for i in range((end - start) // STEP)]


#: Log times of chunks in the order of a file, and which chunks are copied. Negative times are those of clouds.
LAYOUTS = {
    "unsorted inside": ([[-1], [10, 30, 20], [40, 60, 80]], [1, 2]),
    "overlapping": ([[-1], [40, 60, 80], [70, 71, 90], [72, 73, 75], [100]], [1, 2, 3, 4]),
    "not in order": ([[40, 41], [10, 20], [-50]], [0, 1]),
    "neighbours share a time": ([[-10], [10, 20], [20, 30], [30, 30], [30, 40], [-40]], [1, 2, 3, 4]),
    "a cloud inside": ([[10, 20, 30], [-25, 26], [40, 60]], [0, 2]),
    "a cloud at the end, before it in the file": ([[-30, 31], [10, 30], [40]], [1, 2]),
    "a cloud before it in time": ([[20, 30], [40, 50], [-25], [60]], [0, 3]),
    "chunks of a topic": ([[-10, -15, -20], [10, 15, 20], [-20, -25, -30], [20, 25, 30]], [1, 3]),
}


@pytest.mark.parametrize(
    ("suffix", "layout"), sampled([*product((".bag", ".mcap"), LAYOUTS)], 9), ids=lambda each: each.replace(" ", "-")
)
def test_chunks_are_copied_unless_something_belongs_between_their_messages(
    suffix: str, layout: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    times, copied = LAYOUTS[layout]
    rows: list[Row] = []
    for number, chunk in enumerate(times):
        rows.append(("", 0, b""))
        for place, time in enumerate(chunk):
            topic, data = ("/left", "/right")[place % 2], image(100 * number + place)
            if time < 0:
                topic, data = "/points", cloud(1 if suffix == ".bag" else 2, number)
            rows.append((topic, T0 + abs(time), data))
    monkeypatch.setattr(chunks, "MIN_WHOLE_BYTES", 1)
    source = write(tmp_path / f"drive{suffix}", "none", rows)
    there = [stored for _, _, stored in stored_chunks(source)]
    assert len(there) == len(times)
    results = [convert(source, jobs=jobs, keep_clouds=True) for jobs in (1, 2)]
    assert len({path.read_bytes() for path in results}) == 1
    written = [stored for _, _, stored in stored_chunks(results[0])]
    assert [number for number, stored in enumerate(there) if stored in written] == copied
    with_scans = [found for found in opened(results[0]).messages if found.topic != "/scan"]
    assert [found.data for found in with_scans] == [found.data for found in opened(source).messages]


@pytest.mark.parametrize("options", sampled([{}, {"jobs": 1}, {"compression": "none"}], 1), ids=str)
def test_damage_in_a_copied_chunk_is_found(source: Path, options: dict[str, Any]) -> None:
    if source.suffix == ".bag" and stored_chunks(source)[0][1] == "none":
        pytest.skip("an uncompressed ROS 1 bag has no checksums")
    sound = source.with_name(f"sound{source.suffix}")
    data = bytearray(source.read_bytes())
    sound.write_bytes(data)
    chunk = images_only(source)[1]
    data[data.index(chunk) + len(chunk) // 2] ^= 0x10
    source.write_bytes(data)
    with pytest.raises(DamageError):
        convert(source, strict=True, **options)
    recovered = opened(convert(source, **options))
    assert recovered.of("/scan") == opened(convert(sound, **options)).of("/scan")
    report = pc2scan.convert(source, source.with_name(f"told{source.suffix}"), params=PARAMS, **options)
    assert len(report.damage) == 1
    assert report.exit_status == 3
