"""Filters of beams, held to scalar transcriptions of the rules."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from pc2scan.core.beam_filters import shadows, speckles_by_distance, speckles_by_neighbors, veiled_beams

F = np.float32


def shadow_filter(
    ranges: Any, increment: float, low: float, high: float, window: int, neighbors: int, start: bool
) -> Any:
    """``ScanShadowsFilter::update``: which ranges become NaN."""
    least, most = F(math.tan(math.radians(low))), F(math.tan(math.radians(high)))
    least, most = abs(least), -abs(most)
    step = F(increment)
    angle, sines, cosines = F(-window) * step, {}, {}
    for y in range(-window, window + 1):
        sines[y], cosines[y] = F(abs(math.sin(float(angle)))), F(math.cos(float(angle)))
        angle = angle + step
    removed = np.zeros(len(ranges), bool)
    for i in range(len(ranges)):
        for y in range(max(-i, -window), min(len(ranges) - i, window + 1)):
            if y == 0:
                continue
            r1, r2 = ranges[i], ranges[i + y]
            tangent = (r2 * sines[y]) / (r1 - r2 * cosines[y])
            if tangent < least and tangent > most:
                for index in range(max(i - neighbors, 0), min(i + neighbors, len(ranges) - 1) + 1):
                    if ranges[i] < ranges[index]:
                        removed[index] = True
                if start:
                    removed[i] = True
                break
    return removed


def speckle_filter(ranges: Any, increment: float, kind: str, max_range: float, difference: float, window: int) -> Any:
    """``LaserScanSpeckleFilter::update``: which ranges become NaN."""
    count = len(ranges)

    def by_distance(index: int) -> bool:
        if np.isnan(ranges[index]):
            return False
        for away in range(1, window):
            if index + away < count:
                other = ranges[index + away]
                if np.isnan(other) or float(abs(other - ranges[index])) > difference:
                    return False
        return True

    def by_neighbors(index: int) -> bool:
        found = 0
        r1 = ranges[index]
        for y in range(-window, window + 1):
            place = index + y
            if place < 0 or place >= count or y == 0 or np.isnan(ranges[place]):
                continue
            r2 = ranges[place]
            product = F(2) * r1 * r2 * F(math.cos(float(F(y) * F(increment))))
            square = float(r1) ** 2 + float(r2) ** 2 - float(product)
            # A negative square has a NaN for a root.
            if square >= 0 and float(F(math.sqrt(square))) <= difference:
                found += 1
        return found >= window

    check = by_distance if kind == "Distance" else by_neighbors
    valid = np.zeros(count, bool)
    for index in range(count - window + 1):
        good = check(index)
        for place in range(index, index + window):
            valid[place] |= good or float(ranges[place]) > max_range
    return ~valid


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


@pytest.mark.parametrize("start", [False, True])
@pytest.mark.parametrize(
    ("low", "high", "window", "neighbors"),
    [(10, 170, 1, 20), (5, 175, 2, 3), (0, 180, 3, 5), (90, 90, 1, 0), (30, 140, 8, 40)],
)
def test_shadows_are_those_of_laser_filters(low: float, high: float, window: int, neighbors: int, start: bool) -> None:
    total = 0
    for ranges in scans():
        increment = 2 * math.pi / 720
        with np.errstate(all="ignore"):
            expected = shadow_filter(ranges, increment, low, high, window, neighbors, start)
        found = shadows(
            ranges, increment, min_angle=low, max_angle=high, window=window, neighbors=neighbors,
            remove_shadow_start_point=start,
        )  # fmt: skip
        np.testing.assert_array_equal(found, expected)
        total += int(found.sum())
    assert total > 10 or (low, high) == (0, 180) or neighbors == 0


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


@pytest.mark.parametrize("kind", ["Distance", "RadiusOutlier"])
@pytest.mark.parametrize(
    ("most", "difference", "window"), [(2.0, 0.1, 2), (100.0, 0.05, 3), (3.0, 0.3, 1), (5.0, 0.2, 5)]
)
def test_speckles_are_those_of_laser_filters(kind: str, most: float, difference: float, window: int) -> None:
    removed = 0
    for ranges in scans():
        with np.errstate(all="ignore"):
            expected = speckle_filter(ranges, 0.01, kind, most, difference, window)
        limits: dict[str, Any] = {"max_range": most, "max_range_difference": difference, "filter_window": window}
        if kind == "Distance":
            found = speckles_by_distance(ranges, **limits)
        else:
            found = speckles_by_neighbors(ranges, 0.01, **limits)
        np.testing.assert_array_equal(found, expected)
        removed += int(found.sum())
    assert removed > 10
