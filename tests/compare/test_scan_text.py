from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from pc2scan.compare.diff import open_source
from pc2scan.compare.rules import GEOMETRY
from pc2scan.compare.scan_text import is_scan_text, open_scan_text, render_messages
from pc2scan.errors import RecordingError, UsageError
from pc2scan.messages.laserscan import LASERSCAN, LaserScan, encode_laserscan
from pc2scan.messages.pointcloud2 import POINTCLOUD2, PointField, encode_pointcloud2
from pc2scan.model import Connection, RawMessage
from support.builders import CLOUD, STRING, T0, cloud, deserialized, points_of, scan, serialized, string, typestore

if TYPE_CHECKING:
    from pathlib import Path

ENCODINGS = {1: "ros1", 2: "cdr"}


def message(data: bytes, msgtype: str = LASERSCAN, ros_version: int = 2, topic: str = "/scan") -> RawMessage:
    return RawMessage(Connection(4, topic, msgtype, ENCODINGS[ros_version]), T0, data, T0)


def reread(tmp_path: Path, *messages: RawMessage) -> list[RawMessage]:
    path = tmp_path / "expected.txt"
    path.write_text(render_messages(messages))
    return list(open_scan_text(path).messages())


BITS = arrays(np.uint32, st.integers(0, 25)).map(lambda bits: bits.view(np.float32))
TEXTS = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=5)


@given(
    ranges=BITS,
    intensities=BITS,
    geometry=st.lists(st.floats(width=32), min_size=7, max_size=7),
    stamp_ns=st.integers(-(2**31) * 10**9, 2**31 * 10**9 - 1),
    frame_id=TEXTS,
)
def test_any_scan_survives_to_the_bit(
    tmp_path_factory: pytest.TempPathFactory,
    ranges: np.ndarray[tuple[int], np.dtype[np.float32]],
    intensities: np.ndarray[tuple[int], np.dtype[np.float32]],
    geometry: list[float],
    stamp_ns: int,
    frame_id: str,
) -> None:
    values = dict(zip(GEOMETRY, geometry, strict=True))
    data = encode_laserscan(LaserScan(0, stamp_ns, frame_id, **values, ranges=ranges, intensities=intensities), "cdr")
    (again,) = reread(tmp_path_factory.mktemp("text"), message(data))
    assert again.data == data
    assert again.log_time_ns == T0


KINDS = ["i1", "u1", "i2", "u2", "i4", "u4", "f4", "f8"]


@given(st.binary(min_size=0, max_size=64), st.sampled_from(range(1, 9)), st.integers(0, 2))
def test_any_cloud_survives_to_the_bit(
    tmp_path_factory: pytest.TempPathFactory, content: bytes, datatype: int, count: int
) -> None:
    step = np.dtype(KINDS[datatype - 1]).itemsize * max(count, 1)
    data = encode_pointcloud2(
        serialization="ros1",
        sequence=7,
        stamp_ns=5,
        frame_id="a  # b",
        fields=[PointField("value of it", 0, datatype, count)],
        point_step=step,
        data=content[: len(content) // step * step],
    )
    (again,) = reread(tmp_path_factory.mktemp("text"), message(data, POINTCLOUD2, 1))
    assert again.data == data


@pytest.mark.parametrize("ros_version", [1, 2])
def test_several_topics_keep_their_order(ros_version: int, tmp_path: Path) -> None:
    ranges = np.array([1.5, np.inf, np.nan, -0.0], np.float32)
    messages = [
        message(scan(ranges, ros_version, seq=3), LASERSCAN, ros_version, "/front scan"),
        message(cloud(points_of(1), ros_version, seq=4), POINTCLOUD2, ros_version, "/cloud"),
        message(scan(ranges[:2], ros_version, seq=5), LASERSCAN, ros_version, "/front scan"),
    ]
    again = reread(tmp_path, *messages)
    assert [(m.connection.topic, bytes(m.data)) for m in again] == [(m.connection.topic, m.data) for m in messages]


def test_one_changed_beam_is_one_changed_line() -> None:
    ranges = np.linspace(1, 9, 400, dtype=np.float32)
    changed = ranges.copy()
    changed[123] += 1
    before, after = (render_messages([message(scan(values, 2))]).splitlines() for values in (ranges, changed))
    differing = [(x, y) for x, y in zip(before, after, strict=True) if x != y]
    assert len(differing) == 1
    assert differing[0][0].split(":")[0].strip() == "120"
    assert max(map(len, before)) < 130


def test_a_reader_sees_what_is_in_a_scan() -> None:
    text = render_messages([message(scan(np.array([0.5, np.inf, 12.25], np.float32), 2))])
    assert "2 returns, 0.500 to 12.250 m" in text
    assert "0: 0.5 inf 12.25" in text
    assert f"stamp {T0 // 10**9}.{T0 % 10**9:09d}" in text


def altered(**changes: Any) -> bytes:
    """A cloud of four points with other parts."""
    base = deserialized(cloud(points_of(1, 4), 2), CLOUD, 2)
    return serialized(typestore(2), replace(base, **changes), CLOUD, 2)


PADDED = np.full((4, 16), 7, np.uint8)


@pytest.mark.parametrize(
    ("data", "msgtype", "refusal"),
    [
        (altered(point_step=16, row_step=64, data=PADDED.ravel()), POINTCLOUD2, "padding would be lost"),
        (altered(fields=[]), POINTCLOUD2, "points would be lost"),
        (string("hello", 2), STRING, "cannot be written as text"),
    ],
)
def test_what_text_cannot_hold_is_refused(data: bytes, msgtype: str, refusal: str) -> None:
    with pytest.raises(UsageError, match=refusal):
        render_messages([message(data, msgtype)])


def test_only_its_own_text_is_taken_for_it(tmp_path: Path) -> None:
    path = tmp_path / "notes.txt"
    path.write_text("# pc2scan notes\n")
    assert not is_scan_text(path)
    with pytest.raises(RecordingError):
        open_source(path)


SCAN_TEXT = render_messages([message(scan(np.array([1, 2, 3], np.float32), 2))])
CLOUD_TEXT = render_messages([message(cloud(np.full((2, 3), 2.5, np.float32), 2), POINTCLOUD2)])


@pytest.mark.parametrize(
    ("text", "old", "new", "blamed"),
    [
        (SCAN_TEXT, "range_max 30.0", "range_maximum 30.0", "range_maximum"),
        (SCAN_TEXT, "ranges 3", "ranges 4", "intensities 0"),
        (SCAN_TEXT, "0: 1.0 2.0 3.0", "1: 1.0 2.0 3.0", "1: 1.0"),
        (SCAN_TEXT, "0: 1.0 2.0 3.0", "0: 1.0 two 3.0", "two"),
        (SCAN_TEXT, 'topic "/scan"', '<<<<<<< ours\ntopic "/scan"', "<<<<<<<"),
        (SCAN_TEXT, 'frame_id "laser"', "frame_id laser", "frame_id"),
        (CLOUD_TEXT, 'frame_id "lidar"', "frame_id 5", ""),
        (CLOUD_TEXT, 'frame_id "lidar"', "frame_id " + "[" * 100_000, ""),
        (CLOUD_TEXT, 'message "/scan"', 'message ["/scan"]', ""),
        (CLOUD_TEXT, 'topic "/scan"', "topic 5", ""),
        (CLOUD_TEXT, "log_time 1", "log_time 99999999999991", ""),
        (CLOUD_TEXT, "height 1", "height 99999999999", ""),
        (CLOUD_TEXT, "point_step 12", "point_step 99999999999", ""),
        (CLOUD_TEXT, "point_step 12", "point_step 8", ""),
        (CLOUD_TEXT, "0 float32 1", "0 float32 99999999999", ""),
        (CLOUD_TEXT, "0 float32 1", "-4 float32 1", ""),
        (CLOUD_TEXT, "field 4 float32", "fold 4 float32", "fold"),
        (CLOUD_TEXT, "points 2", "points 0", ""),
        (CLOUD_TEXT, "points 2", "points 99999999999", ""),
        (CLOUD_TEXT, "0: 2.5 ", "0: 1e300 ", ""),
    ],
    ids=lambda text: text[:30],
)
def test_changes_by_hand_are_named_with_their_line(text: str, old: str, new: str, blamed: str, tmp_path: Path) -> None:
    assert old in text
    path = tmp_path / "expected.txt"
    path.write_text(text.replace(old, new, 1))
    lines = [number for number, line in enumerate(path.read_text().splitlines(), 1) if blamed in line]
    with pytest.raises(RecordingError, match=rf"line ({'|'.join(map(str, lines))}) has been changed") as caught:
        open_scan_text(path)
    assert "`update=True`" in (caught.value.hint or "")
    assert len(lines) == 1 or not blamed


def test_a_field_of_no_points_may_have_any_number_of_elements(tmp_path: Path) -> None:
    data = encode_pointcloud2(
        serialization="cdr",
        sequence=0,
        stamp_ns=5,
        frame_id="a",
        fields=[PointField("x", 0, 7, 1 << 29)],
        point_step=1 << 31,
        data=b"",
        height=0,
    )
    (again,) = reread(tmp_path, message(data, POINTCLOUD2))
    assert again.data == data


def test_a_cut_is_by_log_time(tmp_path: Path) -> None:
    path = tmp_path / "expected.txt"
    path.write_text(
        render_messages([message(scan(np.array([1], np.float32), 2))._replace(log_time_ns=t) for t in (5, 6, 7)])
    )
    source = open_scan_text(path)
    assert [m.log_time_ns for m in source.messages(source.connections, 6, 7)] == [6]
    assert list(source.messages([])) == []
