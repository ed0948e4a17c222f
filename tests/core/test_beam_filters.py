"""Filters of beams, held to scalar transcriptions of the rules."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from pc2scan.core.beam_filters import speckles, veiled_beams

F = np.float32


def scans() -> list[Any]:
    random = np.random.default_rng(8)
    found = []
    for count in (5, 90, 360):
        steps = np.where(random.random(count) < 0.1, random.normal(0, 2, count), random.normal(0, 0.05, count))
        ranges = np.abs(2 + np.cumsum(steps)).astype(F)
        ranges[random.random(count) < 0.1] = np.inf
        ranges[random.random(count) < 0.05] = np.nan
        ranges[random.random(count) < 0.05] += F(0.4)
        found.append(ranges)
    return [*found, np.full(20, np.inf, F), np.full(20, 1.0, F)]


def is_between_surfaces(ranges: Any, beam: int, increment: float, closed: bool) -> bool:
    """The rule of `veiled_beams`, for one beam."""
    count = len(ranges)

    def returns(place: int) -> bool:
        return (closed or 0 <= place < count) and math.isfinite(ranges[place % count]) and ranges[place % count] > 0

    def next_return(place: int, step: int) -> tuple[int, int] | None:
        """The next beam with a return, and how far away it is."""
        found = (away for away in range(1, 4) if returns(place + step * away))
        away = next(found, None)
        return None if away is None else ((place + step * away) % count, away)

    def continues(place: int, step: int, more: int) -> bool:
        """Whether the return is on a line with the next ones."""
        first = next_return(place, step)
        second = None if first is None else next_return(first[0], step)
        if first is None or second is None:
            return False
        own, one, two = (float(ranges[each]) for each in (place, first[0], second[0]))
        change, noise = (1 / one - 1 / two) * first[1] / second[1], 0.1 / own**2
        if not min(0.0, 2 * change) - noise <= 1 / own - 1 / one <= max(0.0, 2 * change) + noise:
            return False
        return more == 0 or continues(first[0], step, more - 1)

    if not returns(beam):
        return False
    own, nearer, farther = float(ranges[beam]), [], []
    for step in (-1, 1):
        found = next_return(beam, step)
        if found is None or continues(beam, step, max(0, min(10, math.ceil(0.006 / increment)) - 2)):
            return False
        other = float(ranges[found[0]])
        limit = max(0.1, min(own, other) * found[1] * increment / math.tan(math.radians(15)))
        nearer.append(own - other > limit)
        farther.append(other - own > limit)
    return (nearer[0] and farther[1]) or (farther[0] and nearer[1])


@pytest.mark.parametrize("closed", [False, True])
@pytest.mark.parametrize("increment", [0.0003, 0.0014, 0.005, 2 * math.pi / 360])
def test_returns_between_surfaces_are_those_of_the_rule(increment: float, closed: bool) -> None:
    total = 0
    for ranges in (*scans(), np.full(3, 2.0, F), np.array([1.0, 2.0], F), np.array([4.0], F), np.empty(0, F)):
        expected = [is_between_surfaces(ranges, beam, increment, closed) for beam in range(ranges.size)]
        found = veiled_beams(ranges, increment, closed=closed)
        np.testing.assert_array_equal(found, np.array(expected, bool))
        total += int(found.sum())
    assert total > 3


def speckle_filter(ranges: Any, max_range: float, difference: float, window: int) -> Any:
    """``LaserScanSpeckleFilter::update``, by distance: which ranges become NaN."""
    valid = np.zeros(len(ranges), bool)
    for index in range(len(ranges) - window + 1):
        run = ranges[index : index + window]
        good = not np.isnan(run).any() and not (np.abs(run[1:] - run[0]).astype(float) > difference).any()
        for place in range(index, index + window):
            valid[place] |= good or float(ranges[place]) > max_range
    return ~valid


@pytest.mark.parametrize(
    ("most", "difference", "window"), [(2.0, 0.1, 2), (100.0, 0.05, 3), (3.0, 0.3, 1), (5.0, 0.2, 5)]
)
def test_speckles_are_those_of_laser_filters(most: float, difference: float, window: int) -> None:
    removed = 0
    for ranges in scans():
        with np.errstate(all="ignore"):
            expected = speckle_filter(ranges, most, difference, window)
        found = speckles(ranges, max_range=most, max_range_difference=difference, filter_window=window)
        np.testing.assert_array_equal(found, expected)
        removed += int(found.sum())
    assert removed > 10
