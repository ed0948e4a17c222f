"""Scans and clouds as Python objects, read or made on the way."""

from __future__ import annotations

import copy
import gc
import pickle
import tracemalloc
from contextlib import suppress
from itertools import islice, product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

import pc2scan
from benchmarks.clouds import FORMS, write_recording
from pc2scan.errors import DamageError, DecodeError, MessageError, RecordingError, TopicError, UsageError
from pc2scan.messages.laserscan import encode_laserscan
from support import ROOT, sampled
from support.builders import SCAN, Item, Recording, Stream, write_mcap
from support.scan_recordings import START, STEP, scans
from support.tables import rows

if TYPE_CHECKING:
    from collections.abc import Callable

TABLES = Path(__file__).with_name("streams.txt")
FIXTURES = ROOT / "fixtures"
HALL = FIXTURES / "hall.bag"
CONTAINERS = ("hall.bag", "hall.mcap", "hall")

#: The first log time of the fixtures.
FIRST_NS = 1_700_000_000_005_000_000


def open_files(path: Path) -> int:
    """How many descriptors of this process are of files under a path."""
    found = 0
    for link in Path("/proc/self/fd").iterdir():
        with suppress(OSError):
            found += str(link.readlink()).startswith(str(path))
    return found


needs_proc = pytest.mark.skipif(not Path("/proc/self/fd").is_dir(), reason="open files are counted in /proc")


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """A recording with scans and clouds."""
    path = tmp_path / "both.mcap"
    pc2scan.convert(FIXTURES / "hall.mcap", path, keep_clouds=True, min_height=-0.3, intensity_field="intensity")
    return path


@pytest.mark.parametrize("container", sampled(CONTAINERS, 1))
def test_clouds_come_from_every_container(container: str) -> None:
    clouds = list(pc2scan.clouds(FIXTURES / container, topics="/points"))
    assert [cloud.stamp_ns for cloud in clouds] == [1_700_000_000_000_000_000 + i * 10**8 for i in range(5)]
    assert [cloud.log_time_ns for cloud in clouds] == [FIRST_NS + i * 10**8 for i in range(5)]
    first = clouds[0]
    assert (first.topic, first.frame, len(first), first.is_dense) == ("/points", "lidar", 3840, False)
    assert first.fields == ("x", "y", "z", "intensity", "ring", "time")
    assert first.stamp == np.datetime64(first.stamp_ns, "ns")
    assert first.log_time == np.datetime64(first.log_time_ns, "ns")
    xyz = first.xyz()
    assert xyz.shape == (3840, 3)
    assert xyz.dtype == np.float32
    for index, name in enumerate("xyz"):
        assert np.array_equal(xyz[:, index], first[name], equal_nan=True)
    assert first["intensity"].shape == (3840,)
    with pytest.raises(KeyError, match="x, y, z, intensity, ring, time"):
        first["reflectivity"]


@pytest.mark.parametrize("suffix", sampled([".bag", ".mcap", ""], 1))
def test_scans_are_those_of_the_messages(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"scans{suffix}"
    pc2scan.convert(HALL, path, min_height=-0.3, intensity_field="intensity", only_scans=True)
    stream = pc2scan.scans(str(path))
    assert stream.topics == ("/scan",)
    scans = list(stream)
    assert [scan.log_time_ns for scan in scans] == [FIRST_NS + i * 10**8 for i in range(5)]
    scan = scans[0]
    assert (scan.topic, scan.frame, len(scan.ranges)) == ("/scan", "lidar", 360)
    assert scan.ranges.dtype == scan.intensities.dtype == np.float32
    assert scan.stamp == np.datetime64("2023-11-14T22:13:20", "ns")
    assert scan.angles[0] == np.float32(-np.pi)
    assert scan.angles[1] - scan.angles[0] == pytest.approx(np.pi / 180)
    xy = scan.xy()
    assert xy.shape == (np.count_nonzero(np.isfinite(scan.ranges)), 2)
    assert np.allclose(np.hypot(*xy.T), scan.ranges[scan.valid])
    looks = np.stack([np.cos(scan.angles[scan.valid]), np.sin(scan.angles[scan.valid])], axis=1)
    assert np.allclose(xy, scan.ranges[scan.valid, np.newaxis] * looks, atol=1e-6)
    # They are the user's own.
    scan.ranges[0] = 1.0
    assert "360 beams" in repr(scan)


HOW: list[dict[str, Any]] = [
    *(how for (how,) in rows(TABLES, "ways to make scans")),
    {"params": pc2scan.ProjectionParams(min_height=-0.3, intensity_field="intensity"), "range_max": 4.0},
]


@pytest.mark.parametrize(("how", "container"), sampled(product(HOW, CONTAINERS), 6))
@pytest.mark.filterwarnings("ignore::pc2scan.RecordingWarning")
def test_scans_made_on_the_way_are_those_that_convert_writes(
    how: dict[str, Any], container: str, tmp_path: Path
) -> None:
    pc2scan.convert(FIXTURES / container, tmp_path / "scans.mcap", only_scans=True, **how)
    made = pc2scan.scans(FIXTURES / container, **how)
    written = list(pc2scan.scans(tmp_path / "scans.mcap", made.topics))
    found = list(made)
    assert len(found) == len(written) >= 2
    for one, other in zip(found, written, strict=True):
        for name in one.__slots__:
            a, b = getattr(one, name), getattr(other, name)
            if name == "sequence":
                continue  # ROS 2 has none
            assert a.tobytes() == b.tobytes() if isinstance(a, np.ndarray) else a == b, name


def test_each_loop_begins_anew() -> None:
    stream = pc2scan.clouds(HALL, start=0)
    first = [cloud.stamp_ns for cloud in stream]
    assert stream.damage == ()
    assert [cloud.stamp_ns for cloud in stream] == first
    assert len(first) == 5
    together = zip(stream, stream, strict=True)
    assert all(a.stamp_ns == b.stamp_ns for a, b in together)


@needs_proc
def test_files_are_closed_whatever_becomes_of_the_loop(recording: Path, tmp_path: Path) -> None:
    stream = pc2scan.scans(recording)

    def exhausted() -> None:
        list(stream)

    def left() -> None:
        for _ in stream:
            assert open_files(recording)
            break

    def closed() -> None:
        items = iter(stream)
        next(items)
        items.close()

    def closed_with_the_stream() -> None:
        items = iter(stream)
        stream.close()
        assert list(items) == []

    def in_a_block() -> None:
        with stream:
            next(iter(stream))

    def forgotten() -> None:
        other = pc2scan.scans(recording)
        assert open_files(recording)
        next(iter(other))
        del other
        gc.collect()

    def wrong() -> None:
        with pytest.raises(TopicError):
            pc2scan.clouds(recording, topics="/none")

    def failing() -> None:
        with pytest.raises(DecodeError):
            list(pc2scan.scans(path, strict=True))

    path = broken(tmp_path)
    for end in (exhausted, left, closed, closed_with_the_stream, in_a_block, forgotten, wrong, failing):
        end()
        assert open_files(tmp_path) == 0, end


def broken(folder: Path) -> Path:
    """A recording whose third scan ends too early."""
    path = folder / "broken.mcap"
    stream = Stream("/scan", SCAN)
    items = [Item(stream, scan.stamp_ns, {2: encode_laserscan(scan, "cdr")}) for scan in scans(5)]
    items[2] = Item(stream, items[2].log_time_ns, {2: items[2].data[2][:30]})
    write_mcap(path, Recording((stream,), tuple(items)))
    return path


def test_what_cannot_be_used_is_skipped_or_an_error(tmp_path: Path) -> None:
    path = broken(tmp_path)
    stream = pc2scan.scans(path)
    with pytest.warns(pc2scan.RecordingWarning, match="skipped: /scan.*strict=True") as warned:
        found = list(stream)
    assert [w.filename for w in warned] == [__file__]
    assert [(scan.stamp_ns - START) // STEP for scan in found] == [0, 1, 3, 4]
    assert stream.skipped_count == 1
    assert [(s.topic, s.log_time_ns) for s in stream.skipped] == [("/scan", START + 2 * STEP)]
    with pytest.raises(MessageError, match="/scan"):
        list(pc2scan.scans(path, strict=True))


@pytest.mark.parametrize(("how", "told", "taken"), rows(TABLES, "doubtful requests, and what is said"), ids=str)
def test_doubtful_requests_draw_the_warning_of_convert(
    how: dict[str, Any], told: str, taken: int, tmp_path: Path
) -> None:
    """A loop that ends early is warned, too."""
    report = pc2scan.convert(HALL, tmp_path / "a.mcap", **how)
    assert any(told in text for text in report.warnings)
    with pytest.warns(pc2scan.RecordingWarning) as warned:
        assert len(list(islice(pc2scan.scans(HALL, **how), taken))) == min(taken, 5)
    assert [w.filename for w in warned if told in str(w.message)] == [__file__]


@pytest.mark.parametrize("container", ["hall.bag", "hall.mcap"])
def test_the_rest_of_a_damaged_recording_is_read_and_warned_of(container: str, tmp_path: Path) -> None:
    path = tmp_path / container
    data = (FIXTURES / container).read_bytes()
    path.write_bytes(data[: len(data) * 4 // 5])
    report = pc2scan.repair(path, tmp_path / f"sound_{container}")
    assert report.exit_status == 3
    stream = pc2scan.clouds(path)
    with pytest.warns(pc2scan.RecordingWarning, match="damaged: .*strict=True"):
        found = [cloud.stamp_ns for cloud in stream]
    assert stream.damage
    assert found == [cloud.stamp_ns for cloud in pc2scan.clouds(tmp_path / f"sound_{container}")]
    with pytest.raises(DamageError):
        list(pc2scan.clouds(path, strict=True))


def test_the_only_topic_is_taken_and_others_are_pointed_out(recording: Path, tmp_path: Path) -> None:
    path, no_clouds = tmp_path / "two.mcap", tmp_path / "scans.mcap"
    pc2scan.convert(HALL, path, topics=["/points:=/front", "/points:=/back"], only_scans=True)
    pc2scan.convert(recording, no_clouds, topics="/points:=/again")
    assert {scan.topic for scan in pc2scan.scans(path, "/front")} == {"/front"}
    assert {scan.topic for scan in pc2scan.scans(path, topics=["back", "/front"])} == {"/front", "/back"}
    wrong: list[tuple[Callable[[], object], str, str]] = [
        (lambda: pc2scan.scans(path), r"2 LaserScan topics: /back, /front", 'topics="/back"'),
        (lambda: pc2scan.scans(path, "/frnt"), "no topic /frnt", "did you mean /front?"),
        (lambda: pc2scan.scans(HALL), "no LaserScan topic", "min_height"),
        (lambda: pc2scan.clouds(no_clouds), "no PointCloud2 topic", "pc2scan.scans()"),
        (lambda: pc2scan.scans(no_clouds, min_height=0.1), "topic", "LaserScan"),
    ]
    for call, message, hint in wrong:
        with pytest.raises(TopicError, match=message) as raised:
            call()
        assert hint in str(raised.value.hint)
    with pytest.raises(RecordingError, match="does not exist"):
        pc2scan.scans(tmp_path / "none.bag")


def test_parameters_of_the_reverse_node_make_no_scans(tmp_path: Path) -> None:
    file = tmp_path / "params.yaml"
    file.write_text("laserscan_to_pointcloud:\n  ros__parameters:\n    queue_size: 5\n", "utf-8")
    with pytest.raises(UsageError, match="laserscan_to_pointcloud, which does not make scans"):
        pc2scan.scans(HALL, params_file=file)


@pytest.mark.parametrize("form", sampled(FORMS, 1))
@pytest.mark.filterwarnings("ignore::pc2scan.RecordingWarning")
def test_memory_stays_bounded(form: str, tmp_path: Path) -> None:
    source = write_recording(tmp_path, FORMS[form], 60_000_000)
    # Memory for the chunks of another recording, which are smaller, is in nobody's way.
    (tmp_path / "small").mkdir()
    list(pc2scan.clouds(write_recording(tmp_path / "small", FORMS[form], 10_000_000, points=20_000), "/points"))
    tracemalloc.start()
    try:
        for cloud in pc2scan.clouds(source, "/points"):
            size = cloud.xyz().nbytes
        clouds = tracemalloc.get_traced_memory()[1]
        tracemalloc.reset_peak()
        kept = list(pc2scan.scans(source, "/points", min_height=-100.0))
        scans = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert len(kept) * size * 2 > 30_000_000
    assert clouds < 30_000_000
    # Scans that are kept do not keep what they were made of.
    assert scans < 30_000_000


@pytest.mark.parametrize("container", sampled(CONTAINERS, 1))
def test_messages_and_streams_go_to_other_processes(container: str) -> None:
    clouds, scans = pc2scan.clouds(FIXTURES / container), pc2scan.scans(FIXTURES / container, min_height=-0.3)
    cloud, scan = next(iter(clouds)), next(iter(scans))
    for copied in (pickle.loads(pickle.dumps(cloud)), copy.deepcopy(cloud)):
        assert repr(copied) == repr(cloud)
        assert copied.log_time == cloud.log_time
        assert all(np.array_equal(copied[name], cloud[name], equal_nan=True) for name in cloud.fields)
    restored = pickle.loads(pickle.dumps(scan))
    assert repr(restored) == repr(scan)
    assert np.array_equal(restored.ranges, scan.ranges)
    for stream in (scans, clouds):
        for other in (pickle.loads(pickle.dumps(stream)), copy.copy(stream)):
            assert type(other) is type(stream)
            assert [item.stamp_ns for item in other] == [item.stamp_ns for item in stream]
