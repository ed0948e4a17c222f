"""Scans as text, to the bit."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from pc2scan.compare.scan_text import is_scan_text, open_scan_text, render_scans
from pc2scan.errors import RecordingError, UsageError
from pc2scan.messages.laserscan import LASERSCAN, LaserScan, encode_laserscan
from pc2scan.model import Connection, RawMessage
from support.builders import STRING, T0, scan, string

if TYPE_CHECKING:
    from pathlib import Path

ENCODINGS = {1: "ros1", 2: "cdr"}


def message(data: bytes, msgtype: str = LASERSCAN, ros_version: int = 2, topic: str = "/scan") -> RawMessage:
    return RawMessage(Connection(4, topic, msgtype, ENCODINGS[ros_version]), T0, data, T0)


def reread(tmp_path: Path, *messages: RawMessage) -> list[RawMessage]:
    path = tmp_path / "expected.txt"
    path.write_text(render_scans(messages))
    assert is_scan_text(path)
    return list(open_scan_text(path).messages())


BITS = arrays(np.uint32, st.integers(0, 25)).map(lambda bits: bits.view(np.float32))
TEXTS = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=5)


STAMPS = st.integers(-(2**31) * 10**9, 2**31 * 10**9 - 1)
GEOMETRIES = [st.floats(width=32)] * 7


@given(st.builds(LaserScan, st.just(0), STAMPS, TEXTS | st.just("a  # b"), *GEOMETRIES, BITS, BITS))
def test_any_scan_survives_to_the_bit(tmp_path_factory: pytest.TempPathFactory, scan: LaserScan) -> None:
    data = encode_laserscan(scan, "cdr")
    (again,) = reread(tmp_path_factory.mktemp("text"), message(data))
    assert (again.data, again.log_time_ns) == (data, T0)


def test_a_reader_sees_what_is_in_a_scan_and_which_beam_has_changed() -> None:
    ranges = np.linspace(1, 9, 400, dtype=np.float32)
    changed = ranges.copy()
    changed[123] = np.inf
    before, after = (render_scans([message(scan(values, 2))]).splitlines() for values in (ranges, changed))
    assert [x.split(":")[0] for x, y in zip(before, after, strict=True) if x != y] == [
        "  ranges 400  # 400 returns, 1.000 to 9.000 m",
        "     120",
    ]
    assert f"  stamp {T0 // 10**9}.{T0 % 10**9:09d}" in before
    with pytest.raises(UsageError, match="cannot be written as text"):
        render_scans([message(string("hello", 2), STRING)])


@pytest.mark.parametrize(
    ("old", "new", "blamed"),
    [
        ("range_max 30.0", "range_maximum 30.0", "range_maximum"),
        ("ranges 3", "ranges 4", "ranges 4"),
        ("0: 1.0 2.0 3.0", "1: 1.0 2.0 3.0", "1: 1.0"),
        ("0: 1.0 2.0 3.0", "0: 1.0 two 3.0", "two"),
        ('topic "/scan"', '<<<<<<< ours\ntopic "/scan"', "<<<<<<<"),
        ('frame_id "laser"', "frame_id 5", ""),
        ('frame_id "laser"', "frame_id " + "[" * 100_000, ""),
        ("log_time 1", "log_time one", "log_time"),
    ],
    ids=lambda text: text[:30],
)
def test_changes_by_hand_are_named_with_their_line(old: str, new: str, blamed: str, tmp_path: Path) -> None:
    text = render_scans([message(scan(np.array([1, 2, 3], np.float32), 2))])
    assert old in text
    path = tmp_path / "expected.txt"
    path.write_text(text.replace(old, new, 1))
    lines = [number for number, line in enumerate(path.read_text().splitlines(), 1) if blamed in line]
    with pytest.raises(RecordingError, match=rf"line ({'|'.join(map(str, lines))}) has been changed") as caught:
        open_scan_text(path)
    assert "`update=True`" in (caught.value.hint or "")
    assert len(lines) == 1 or not blamed
