"""MultiEchoLaserScan, held to rosbags' encoding, and to laser_proc's rules one beam at a time."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from pc2scan.errors import DecodeError
from pc2scan.messages.multi_echo import decode_multi_echo
from support.builders import T0
from support.clouds import ECHO_INTENSITIES as INTENSITIES
from support.clouds import ECHO_RANGES as RANGES
from support.clouds import multi_echo

if TYPE_CHECKING:
    from collections.abc import Sequence

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


@pytest.mark.parametrize("ros_version", [1, 2])
def test_messages_that_end_too_early_or_contradict_themselves_are_errors(ros_version: int) -> None:
    data, serialization = multi_echo(ros_version), SERIALIZATIONS[ros_version]
    for size in range(len(data)):
        with pytest.raises(DecodeError):
            decode_multi_echo(data[:size], serialization)
    with pytest.raises(DecodeError, match="as many intensities as ranges"):
        decode_multi_echo(multi_echo(ros_version, intensities=RANGES[::-1]), serialization)
    with pytest.raises(DecodeError, match="no echo is the strongest"):
        decode_multi_echo(multi_echo(ros_version, intensities=()), serialization, "strongest")
    empty = decode_multi_echo(multi_echo(ros_version, (), ()), serialization, "strongest")
    assert empty.ranges.size == empty.intensities.size == 0
