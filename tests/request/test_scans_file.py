"""Files with several outputs: what is read, and what is refused, with its place."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import pytest

from pc2scan.core.presets import PRESETS
from pc2scan.errors import UsageError
from pc2scan.request.filters import MinHeightSlope, Where
from pc2scan.request.scans_file import load_scans
from pc2scan.request.spec import TopicRequest

FILE = Path(__file__).with_name("scans.yaml")


def test_outputs_have_what_they_say_and_else_the_defaults() -> None:
    found = load_scans(FILE)
    scan, low, moved = found.specs
    assert found.files == (FILE,)
    assert [each.name for each in found.specs] == ["/scan", "/scan_low", "/moved"]
    assert scan.topics == (TopicRequest("/points", "/scan"),)
    assert low.topics == (TopicRequest("/front", "/scan_low"), TopicRequest("/rear", "/scan_low"))
    assert (scan.params.min_height, low.params.min_height, low.params.max_height) == (0.1, -0.1, 0.1)
    assert {each.params.target_frame for each in found.specs} == {"base_link"}
    assert (scan.params.range_max, low.params.range_max) == (PRESETS["slam_toolbox"]["range_max"], 30)
    assert scan.filters == (Where("intensity > 1"),)
    assert low.filters == (Where("ring < 3"), Where("x > 0"), MinHeightSlope(-0.1, 0.05))
    assert (moved.deskew, moved.fixed_frame, moved.stamp) == (True, "odom", "middle")
    assert (moved.params.angle_min, moved.params.angle_increment) == (-math.pi / 2, math.radians(1))
    assert low.origins["min_height"] == f"{FILE}, line 11, min_height"
    assert scan.origins["min_height"] == f"{FILE}, line 5, min_height"
    assert scan.origins["range_max"] == "--preset slam_toolbox"
    assert scan.place == f"{FILE}, line 8"


def test_python_has_dicts() -> None:
    own = {"min_height": 0.2, "where": ["x > 0"]}
    forms: list[Any] = [
        {"/scan": own, "/low": {}},
        {"scans": {"scan": own, "/low": None}, "defaults": {}},
    ]
    for form in forms:
        scan, low = load_scans(form).specs
        assert (scan.name, scan.params.min_height, scan.filters) == ("/scan", 0.2, (Where("x > 0"),))
        assert (low.name, low.topics, low.filters) == ("/low", (), ())


def test_errors_in_dicts_say_where() -> None:
    with pytest.raises(UsageError, match=re.escape("scans['/scan']['max_heigt']: unknown key 'max_heigt'")):
        load_scans({"/scan": {"max_heigt": 1}})
