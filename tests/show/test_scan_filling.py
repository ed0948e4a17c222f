from __future__ import annotations

import cmath
import math
from itertools import pairwise

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from pc2scan.core.verdicts import ConsumerScan
from pc2scan.show.scan_filling import ScanFilling


def kinds(content: list[set[int]], beams: int, frames: int = 1) -> set[str]:
    """What is found in scans of this many beams with returns in these, of some frames in turn."""
    filling = ScanFilling()
    for number, filled in enumerate(content):
        ranges = np.full(beams, np.inf, np.float32)
        ranges[list(filled)] = 5.0
        scan = ConsumerScan.of(ranges, angle_min=0, angle_max=1, angle_increment=0.1, range_min=0.1, range_max=30)
        filling.add(f"laser{number % frames}", scan, ranges, number)
    return {finding.kind for finding in filling.findings()}


def sector(filled: set[int], beams: int) -> tuple[int, int]:
    """The first beam and the size of the smallest sector with all beams that are filled, by trying all."""
    sizes = ((max((beam - first) % beams for beam in filled) + 1, first) for first in sorted(filled))
    size, first = min(sizes)
    return first, size


def expected(content: list[set[int]], beams: int) -> bool:
    """Whether scans are parts: most have a sector of their own, which moves by steps that are alike."""
    content = [filled for filled in content if filled]
    steps = []
    for last, filled in pairwise(content):
        (other, other_size), (first, size) = sector(last, beams), sector(filled, beams)
        fewest = min(len(last), len(filled))
        if fewest >= 4 and 2 * len(last & filled) < fewest and 2 * max(size, other_size) < beams:
            steps.append(cmath.rect(1, (first - other) / beams * 2 * math.pi))
    return len(steps) > (len(content) - 1) / 2 and abs(sum(steps)) > 0.5 * len(steps)


@given(st.data(), st.integers(3, 40))
def test_parts_are_those_of_brute_force(data: st.DataObject, beams: int) -> None:
    size, step = data.draw(st.integers(1, beams)), data.draw(st.integers(-beams, beams))
    content = []
    for number in range(data.draw(st.integers(1, 12))):
        left_out = data.draw(st.sets(st.integers(0, size - 1), max_size=2))
        filled = {(number * step + beam) % beams for beam in range(size) if beam not in left_out}
        # Of several smallest sectors either may be taken, so a scan has one.
        sizes = [max((beam - first) % beams for beam in filled) for first in filled]
        if not filled or sizes.count(min(sizes)) == 1:
            content.append(filled)
    assert ("parts" in kinds(content, beams)) == expected(content, beams)


@given(st.lists(st.integers(0, 99), max_size=12), st.integers(1, 3))
def test_few_directions_are_counted_over_all_scans(filled: list[int], frames: int) -> None:
    found = kinds([{beam} for beam in filled], 100, frames)
    ever = [set(filled[frame::frames]) for frame in range(min(frames, len(filled)))]
    few = 0 < sum(map(len, ever)) < 5 * len(ever)
    assert ("few-directions" in found) == (few and "parts" not in found)
    # One scan with more is enough.
    assert "few-directions" not in kinds([*({beam} for beam in filled), set(range(5))], 100, frames)


def test_two_lidars_on_one_topic_are_looked_at_apart() -> None:
    front, rear = set(range(40)), set(range(180, 220))
    assert kinds([front, rear] * 10, 360, frames=2) == set()
    assert kinds([front, rear] * 10, 360) == {"parts"}


def test_scans_in_very_many_frames_are_read_in_bounded_memory() -> None:
    assert kinds([{number % 360} for number in range(5000)], 360, frames=5000) == {"few-directions"}
    assert kinds([*({0} for _ in range(999)), set(range(360))], 360, frames=1000) == set()


def test_two_posts_that_a_turning_robot_sees_are_no_part_of_a_turn() -> None:
    assert kinds([{30 * n % 360, (30 * n + 5) % 360} for n in range(20)], 360) == set()
