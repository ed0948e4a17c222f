"""What a conversion reads, copies and holds, counted: the half of speed that no machine can blur."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pytest

import pc2scan
from pc2scan.bags.mcap import read as mcap_reader
from pc2scan.bags.mcap.read import McapReader
from pc2scan.bags.mcap.write import McapWriter
from pc2scan.bags.rosbag1 import read as rosbag1_reader
from pc2scan.bags.rosbag1.read import Rosbag1Reader
from pc2scan.bags.rosbag1.write import Rosbag1Writer
from pc2scan.conversion import cloud_to_scan
from pc2scan.core.project import Projector
from pc2scan.core.scene import JUDGED_CLOUDS
from pc2scan.files import source as files
from pc2scan.messages.definitions import definition
from pc2scan.messages.pointcloud2 import POINTCLOUD2
from pc2scan.model import Connection
from support import sampled
from support.builders import cloud, transforms

if TYPE_CHECKING:
    from pathlib import Path

    from pc2scan.bags.chunks import Segment

CLOUDS = 6
#: How often each cloud is read: the first ones, whose floor is not level, are judged before.
READS = [2] * JUDGED_CLOUDS + [1] * (CLOUDS - JUDGED_CLOUDS)
T0 = 1_600_000_000_000_000_000
CLOUD_BYTES = 32_000
FORMS = [
    pytest.param(form, id="".join(form)[1:].replace(".", "-"))
    for form in ((".bag", "lz4"), (".bag", "none"), (".mcap", "zstd"), (".mcap", "none"), (".mcap", "lz4"))
]
TF = "tf2_msgs/msg/TFMessage"
PARAMS = pc2scan.ProjectionParams(min_height=-2, max_height=2)


def record(folder: Path, suffix: str, compression: str, size: int = CLOUD_BYTES) -> Path:
    """Three kinds of chunks: the converted clouds, other clouds, and transforms in a chunk of their own."""
    path = folder / f"drive{suffix}"
    serialization, ros_version = ("ros1", 1) if suffix == ".bag" else ("cdr", 2)
    writer: Any = (
        Rosbag1Writer(path, compression, chunk_size=8_000)
        if ros_version == 1
        else McapWriter(path, compression, chunk_size=8_000)
    )
    handles = []
    for topic, msgtype in (("/points", POINTCLOUD2), ("/other", POINTCLOUD2), ("/tf", TF)):
        text, digest = definition(msgtype, ros_version)
        handles.append(writer.add_connection(Connection(0, topic, msgtype, serialization, text, digest)))
    for number in range(CLOUDS):
        for place, handle in enumerate(handles[:2]):
            points = np.random.default_rng(10 * number + place).uniform(-8, 8, (size // 16, 4)).astype("<f4")
            data = cloud(points, ros_version, seq=number, stamp_ns=T0 + 10 * number + place, names=("x", "y", "z", "w"))
            writer.write(handle, T0 + 1000 * number + place, data, 0)
        moved = transforms([("base_link", "lidar", T0 + number, (0.0, 0.0, 1.0))], ros_version, number)
        writer.write(handles[2], T0 + 1000 * number + 2, moved, 0)
    writer.finish()
    return path


class Extent(NamedTuple):
    """Bytes of a file that were read."""

    offset: int
    length: int

    def covers(self, segment: Segment) -> bool:
        return self.offset <= segment.offset and self.offset + self.length >= segment.offset + segment.length


@pytest.fixture
def extents(monkeypatch: pytest.MonkeyPatch) -> list[Extent]:
    """Everything that is read of any source, in order."""
    found: list[Extent] = []
    original = files.SourceFile.read

    def counting(self: files.SourceFile, offset: int, length: int) -> bytes:
        found.append(Extent(offset, length))
        return original(self, offset, length)

    monkeypatch.setattr(files.SourceFile, "read", counting)
    return found


def segments(path: Path) -> dict[str, list[Segment]]:
    """The chunks of each topic; every chunk here has one."""
    reader: Any = Rosbag1Reader(path) if path.suffix == ".bag" else McapReader(path)
    topics = {connection.id: connection.topic for connection in reader.connections}
    found: dict[str, list[Segment]] = {topic: [] for topic in topics.values()}
    for segment in reader._segments:
        (identity,) = segment.connection_ids
        found[topics[identity]].append(segment)
    reader.close()
    return found


@pytest.fixture(params=sampled(FORMS, 2))
def drive(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    return record(tmp_path, *request.param)


def times_read(extents: list[Extent], chunks: list[Segment]) -> list[int]:
    return [sum(extent.covers(chunk) for extent in extents) for chunk in chunks]


def convert(source: Path, **options: Any) -> pc2scan.Report:
    destination = source.with_name(f"scans{source.suffix}")
    options = {"params": PARAMS, "topics": ["/points"], "only_scans": True, "overwrite": True, **options}
    return pc2scan.convert(source, destination, **options)


@pytest.mark.parametrize("jobs", [1, 2])
def test_chunks_that_nobody_wants_are_not_read(drive: Path, jobs: int, extents: list[Extent]) -> None:
    chunks = segments(drive)
    assert [len(chunks[topic]) for topic in ("/points", "/other", "/tf")] == [CLOUDS] * 3
    extents.clear()
    assert convert(drive, jobs=jobs).topics[0].messages_out == CLOUDS
    assert times_read(extents, chunks["/points"]) == READS
    # Transforms are small: a look at the header behind them may take them along.
    assert times_read(extents, chunks["/other"]) == [0] * CLOUDS
    stored = sum(chunk.length * reads for chunk, reads in zip(chunks["/points"], READS, strict=True))
    assert sum(extent.length for extent in extents) < stored + chunks["/other"][0].length * CLOUDS


@pytest.mark.parametrize("form", sampled(FORMS, 1))
def test_the_thread_that_decompressed_clouds_projects_them(
    form: tuple[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drive = record(tmp_path, *form, size=1 << 20)
    chunks: dict[int, Any] = {}
    reader = rosbag1_reader if drive.suffix == ".bag" else mcap_reader
    original = reader.borrow_payload
    there: list[bool] = []

    def spying(file: Any, segment: Segment, **options: Any) -> Any:
        payload = original(file, segment, **options)
        chunks[threading.get_ident()] = payload
        return payload

    class Spy:
        def __init__(self, params: pc2scan.ProjectionParams) -> None:
            self._project = Projector(params)

        def __call__(self, x: Any, *more: Any) -> Any:
            chunk = np.frombuffer(chunks[threading.get_ident()], np.uint8)
            there.append(np.may_share_memory(x, chunk))
            return self._project(x, *more)

    alone = convert(drive, jobs=1)
    expected = drive.with_name(f"scans{drive.suffix}").read_bytes()
    monkeypatch.setattr(reader, "borrow_payload", spying)
    monkeypatch.setattr(cloud_to_scan, "Projector", Spy)
    together = convert(drive, jobs=2)
    # Not those of the first clouds, which are judged before.
    assert there[JUDGED_CLOUDS:] == [True] * CLOUDS
    assert together.topics == alone.topics
    assert drive.with_name(f"scans{drive.suffix}").read_bytes() == expected
