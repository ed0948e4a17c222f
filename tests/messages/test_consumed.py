from __future__ import annotations

from dataclasses import replace

import numpy as np

from pc2scan.messages.laserscan import scan_for_consumers
from support.scan_recordings import GOOD


def test_a_scan_as_the_rules_see_it() -> None:
    scan = scan_for_consumers(replace(GOOD, intensities=np.ones(3, np.float32)))
    assert (scan.beams, scan.returns, scan.intensities) == (9, 9, 3)
    assert (scan.angle_min, scan.angle_max, scan.range_max) == (-1, 1, 30)
    assert scan.scan_time == float(np.float32(0.1))
