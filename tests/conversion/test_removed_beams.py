"""Beams that are removed: what they read then, and how it is asked for."""

from __future__ import annotations

import numpy as np
import pytest

from pc2scan.conversion.steps import ConvertedMessage, remove_beams
from pc2scan.core.rule import PointCounts
from pc2scan.messages.laserscan import LaserScan


def result(ranges: list[float], intensities: list[float] | None = None, increment: float = 0.01) -> ConvertedMessage:
    lit = np.array(intensities or [], np.float32)
    values = np.array(ranges, np.float32)
    last = increment * (len(ranges) - 1)
    scan = LaserScan(0, 5, "lidar", 0.0, last, increment, 0.0, 0.1, 0.0, 9.0, values, lit)
    return ConvertedMessage(scan, PointCounts(), False)


@pytest.mark.parametrize("empty", [np.inf, np.nan, 10.0, 0.0])
def test_a_removed_beam_has_no_return(empty: float) -> None:
    made = remove_beams(["speckles"], empty, result([1.0, 1.0, 0.5, 1.0, 1.0, empty], [1, 2, 3, 4, 5, 0]))
    np.testing.assert_array_equal(made.message.ranges, np.array([1, 1, empty, 1, 1, empty], np.float32))
    np.testing.assert_array_equal(made.message.intensities, [1, 2, 0, 4, 5, 0])
    assert made.removed == {"returns": 5, "speckles": 1}
    assert not made.empty


def test_the_last_beam_of_a_full_circle_is_beside_the_first() -> None:
    increment = 2 * np.pi / 100
    ranges = [1.0] * 99 + [1.25]
    ranges[0] = 1.2
    circle = ["speckles"]
    assert remove_beams(circle, np.inf, result(ranges, increment=increment)).removed == {"returns": 100, "speckles": 0}
    assert remove_beams(circle, np.inf, result(ranges, increment=increment / 2)).removed == {
        "returns": 100,
        "speckles": 2,
    }
