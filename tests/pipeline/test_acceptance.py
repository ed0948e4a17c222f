from __future__ import annotations

from dataclasses import replace

import pytest

from pc2scan.messages.laserscan import encode_laserscan
from pc2scan.pipeline.acceptance import refusal
from support.scan_recordings import GOOD


@pytest.mark.parametrize("serialization", ["ros1", "cdr"])
def test_who_would_refuse_a_scan(serialization: str) -> None:
    def told(**changes: object) -> str:
        return refusal(encode_laserscan(replace(GOOD, **changes), serialization), serialization)  # type: ignore[arg-type]

    assert told() == ""
    # Mis-placed beams are no refusal.
    assert told(angle_max=1.1) == ""
    assert told(angle_max=1.25).startswith("slam_toolbox would ignore these scans: 9 ranges where it allows 10 ranges.")
    both = told(angle_max=1.25, range_max=0.0)
    assert "slam_toolbox would ignore these scans (so would cartographer, amcl)" in both
