from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pc2scan.messages.laserscan import encode_laserscan
from pc2scan.pipeline.acceptance import described, refusal
from scan_recordings import GOOD


@pytest.mark.parametrize("serialization", ["ros1", "cdr"])
def test_who_would_refuse_a_scan(serialization: str) -> None:
    def told(**changes: object) -> str:
        return refusal(encode_laserscan(replace(GOOD, **changes), serialization), serialization)  # type: ignore[arg-type]

    assert told() == ""
    # Mis-placed beams are no refusal.
    assert told(angle_max=1.1) == ""
    assert told(angle_max=1.25).startswith("slam_toolbox would refuse these scans: 9 ranges where it allows 10 ranges.")
    both = told(angle_max=1.25, range_max=0.0)
    assert "slam_toolbox would refuse these scans (so would cartographer, amcl)" in both


def test_a_scan_as_the_rules_see_it() -> None:
    scan = described(replace(GOOD, intensities=np.ones(3, np.float32)))
    assert (scan.beams, scan.returns, scan.intensities) == (9, 9, 3)
    assert (scan.angle_min, scan.angle_max, scan.range_max) == (-1, 1, 30)
    assert scan.scan_time == float(np.float32(0.1))
