"""MultiEchoLaserScan, held to rosbags' encoding, and to laser_proc's rules one beam at a time."""

from __future__ import annotations

import math
import struct
from contextlib import closing
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

import pc2scan
from pc2scan.bags.opening import open_recording
from pc2scan.errors import DecodeError
from pc2scan.messages.multi_echo import decode_multi_echo
from support import RECORDINGS, builders
from support.builders import T0
from support.clouds import ECHO_INTENSITIES as INTENSITIES
from support.clouds import ECHO_RANGES as RANGES
from support.clouds import MULTI_ECHO as KIND
from support.clouds import multi_echo

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

ECHOES = ("first", "last", "strongest")
SERIALIZATIONS = {1: "ros1", 2: "cdr"}


def beam(ranges: Sequence[float], intensities: Sequence[float], echo: Any) -> tuple[float, float]:
    """LaserProc.cpp: getFirstValue, getLastValue and getMostIntenseValue."""
    if not len(ranges):
        return math.nan, 0.0
    index = {"first": 0, "last": len(ranges) - 1, "strongest": int(np.argmax(intensities))}[echo]
    return float(ranges[index]), float(intensities[index])


@pytest.mark.parametrize("ros_version", [1, 2])
@pytest.mark.parametrize("echo", ECHOES)
def test_the_echo_of_each_beam_is_laser_procs(echo: Any, ros_version: int) -> None:
    scan = decode_multi_echo(multi_echo(ros_version, seq=4), SERIALIZATIONS[ros_version], echo)
    assert (scan.sequence, scan.stamp_ns, scan.frame_id) == (4 if ros_version == 1 else 0, T0, "laser")
    assert (scan.angle_min, scan.angle_max, scan.range_min, scan.range_max) == (-1.0, 1.0, 0.5, 20.0)
    expected = np.array([beam(*each, echo) for each in zip(RANGES, INTENSITIES, strict=True)], np.float32)
    np.testing.assert_array_equal(np.stack([scan.ranges, scan.intensities], axis=1), expected)


def test_the_layout_is_that_of_the_definition() -> None:
    """By hand, big-endian too: counts and values are words of four bytes in both wire formats."""
    for order, flag in (("<", b"\0\1\0\0"), (">", b"\0\0\0\0")):
        body = (
            struct.pack(f"{order}iII", 10, 20, 2) + b"f\0" + bytes(2) + struct.pack(f"{order}7f", 0, 1, 1, 0, 0, 0, 9)
        )
        body += struct.pack(f"{order}IIffIf", 2, 2, 1.5, 2.5, 1, 3.5) + struct.pack(f"{order}I", 0)
        scan = decode_multi_echo(flag + body, "cdr", "last")
        assert (scan.stamp_ns, scan.frame_id) == (10_000_000_020, "f")
        assert (scan.ranges.tolist(), scan.intensities.size) == ([2.5, 3.5], 0)


@pytest.mark.parametrize("ros_version", [1, 2])
def test_messages_that_end_too_early_or_contradict_themselves_are_errors(ros_version: int) -> None:
    data, serialization = multi_echo(ros_version), SERIALIZATIONS[ros_version]
    for size in range(len(data)):
        with pytest.raises(DecodeError):
            decode_multi_echo(data[:size], serialization)
    with pytest.raises(DecodeError, match="other numbers of intensities"):
        decode_multi_echo(multi_echo(ros_version, intensities=RANGES[::-1]), serialization)
    with pytest.raises(DecodeError, match="no echo is the strongest"):
        decode_multi_echo(multi_echo(ros_version, intensities=()), serialization, "strongest")
    empty = decode_multi_echo(multi_echo(ros_version, (), ()), serialization, "strongest")
    assert empty.ranges.size == empty.intensities.size == 0


def test_a_real_recording_has_the_echoes_that_rosbags_reads(tmp_path: Path) -> None:
    source = RECORDINGS / "backpack_multi_echo.bag"
    if not source.exists():
        pytest.skip("needs the real recordings")
    with closing(open_recording(source)) as reader:
        own = [each for each in reader.connections if each.ros_type == KIND]
        messages = [bytes(each.data) for each in reader.messages(own)]
    assert len(messages) == 222
    for data in messages[::10]:
        theirs = builders.deserialized(data, KIND, 1)
        for echo in ECHOES:
            found = decode_multi_echo(data, "ros1", echo)
            beams = zip(theirs.ranges, theirs.intensities, strict=True)
            expected = np.array([beam(a.echoes, b.echoes, echo) for a, b in beams], np.float32)
            np.testing.assert_array_equal(np.stack([found.ranges, found.intensities], axis=1), expected)
    report = pc2scan.convert(source, tmp_path / "clouds.bag", reverse=True)
    (topic,) = (each for each in report.topics if each.action == "converted")
    assert (topic.topic, topic.messages_out) == ("horizontal_laser_2d", 222)
