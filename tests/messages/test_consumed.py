from __future__ import annotations

from dataclasses import replace

import numpy as np

from pc2scan.messages.consumed import consumed_scan
from support.scan_recordings import GOOD


def test_a_scan_as_the_rules_see_it() -> None:
    scan = consumed_scan(replace(GOOD, intensities=np.ones(3, np.float32)))
    assert (scan.beams, scan.returns, scan.intensities) == (9, 9, 3)
    assert (scan.angle_min, scan.angle_max, scan.range_max) == (-1, 1, 30)
    assert scan.scan_time == float(np.float32(0.1))
