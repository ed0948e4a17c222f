"""Which clouds are judged at the beginning of a conversion."""

from __future__ import annotations

from itertools import permutations

from pc2scan.advice.first_clouds import FirstClouds
from pc2scan.request.options import ScanSpec


def test_the_first_clouds_pass_in_any_order_of_threads() -> None:
    times = [10, 10, 20, 20, 30, 40]
    for order in permutations(range(len(times))):
        clouds = FirstClouds("", lambda: None).of(ScanSpec(), "/points")
        passed = {number for number in order if clouds.times.may_have(times[number])}
        # Equal times are written in the order of the file, so that either of 20 may be the third.
        assert passed >= {0, 1, 2, 3}
