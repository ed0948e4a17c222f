"""Files with several outputs: what is read, and what is refused, with its place."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import Any

import pytest

from pc2scan.core.presets import PRESETS
from pc2scan.errors import UsageError
from pc2scan.options.table import PARAMETERS, output_options
from pc2scan.request.ground import MinHeightSlope
from pc2scan.request.options import Combining, ScanSpec, TopicRequest
from pc2scan.request.parameters import Setting
from pc2scan.request.scans_file import load_scans
from pc2scan.request.where import Where
from support import ROOT


def written(folder: Path, text: str) -> Path:
    path = folder / "scans.yaml"
    path.write_text(text)
    return path


FILE = Path(__file__).with_name("scans.yaml").read_text("utf-8")


def test_outputs_have_what_they_say_and_else_the_defaults(tmp_path: Path) -> None:
    path = written(tmp_path, FILE)
    found = load_scans(path)
    scan, low, moved = found.specs
    assert found.files == (path,)
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
    assert low.origins["min_height"] == f"{path}, line 11, min_height"
    assert scan.origins["min_height"] == f"{path}, line 5, min_height"
    assert scan.origins["range_max"] == "--preset slam_toolbox"
    assert scan.place == f"{path}, line 8"


def test_parameters_beside_the_file_beat_all_outputs(tmp_path: Path) -> None:
    settings = [Setting("min_height", -0.5, "--min-height")]
    found = load_scans(written(tmp_path, FILE), settings)
    assert {each.params.min_height for each in found.specs} == {-0.5}
    assert {each.origins["min_height"] for each in found.specs} == {"--min-height"}


def test_of_two_ways_to_say_the_same_the_outputs_own_counts() -> None:
    (spec,) = load_scans({"defaults": {"beams": 720}, "scans": {"/scan": {"angle_increment": 0.01}}}).specs
    assert (spec.params.beams, spec.params.angle_increment) == (0, 0.01)
    with pytest.raises(UsageError, match="set the same thing in two ways"):
        load_scans({"/scan": {"angle_increment": 0.01, "beams": 720}})


def test_python_has_dicts_and_lists() -> None:
    own = {"min_height": 0.2, "where": ["x > 0"]}
    forms: list[Any] = [
        {"/scan": own, "/low": {}},
        {"scans": {"/scan": own, "/low": {}}, "defaults": {}},
        {"scans": {"/scan": own, "/low": None}},
        [{"topic": "/scan", **own}, {"topic": "low"}],
        {"scans": [{"topic": "scan", **own}, {"topic": "/low"}]},
    ]
    for form in forms:
        scan, low = load_scans(form).specs
        assert (scan.name, scan.params.min_height, scan.filters) == ("/scan", 0.2, (Where("x > 0"),))
        assert (low.name, low.topics, low.filters) == ("/low", (), ())


def test_json_and_a_parameter_file_beside_it(tmp_path: Path) -> None:
    (tmp_path / "robot.yaml").write_text(
        "front:\n  ros__parameters: {min_height: 0.3, range_max: 9.0}\nrear:\n  ros__parameters: {min_height: 0.4}\n"
    )
    path = tmp_path / "scans.json"
    own = {"params_file": "robot.yaml", "node": "front", "preset": "gmapping", "range_max": 8}
    path.write_text(json.dumps({"scans": {"/scan": own}}))
    found = load_scans(path)
    (spec,) = found.specs
    assert (spec.params.min_height, spec.params.range_max, spec.params.geometry) == (0.3, 8, "half-open")
    assert found.files == (path, tmp_path / "robot.yaml")


def test_the_example_of_the_page_is_one(tmp_path: Path) -> None:
    page = (ROOT / "docs" / "scans-file.md").read_text(encoding="utf-8")
    example = page.split("```yaml\n", 1)[1].split("```", 1)[0]
    specs = load_scans(written(tmp_path, example)).specs
    assert [spec.name for spec in specs] == ["/scan", "/scan_low", "/scan_lidar"]
    assert specs[2].filters == (Where("ring in (6, 7, 8)"), Where("intensity > 2"))


def test_errors_in_dicts_say_where() -> None:
    with pytest.raises(UsageError, match=re.escape("scans['/scan']['max_heigt']: unknown key 'max_heigt'")):
        load_scans({"/scan": {"max_heigt": 1}})
    with pytest.raises(TypeError, match="has the key 1, it must be text"):
        load_scans({"/scan": {1: 2}})


#: The keys of an output that are no parameters of the projection.
KEYS = {"sources", *output_options()}


def test_the_file_has_whatever_an_output_has() -> None:
    """A choice that `ScanSpec` gets is an entry in the table."""
    elsewhere = {"name", "place", "topics", "origins", "params", "filters", "reverse", "channels"}
    elsewhere |= {"combining", "imu_request"}
    assert set(Combining._fields) - {"window_ns", "span_ns", "count", "every_ns", "is_bare"} <= KEYS
    assert ScanSpec.__dataclass_fields__.keys() - elsewhere <= KEYS


@pytest.mark.parametrize("name", [*sorted(KEYS), *PARAMETERS])
def test_an_error_names_the_key(name: str) -> None:
    with pytest.raises(UsageError, match=name):
        load_scans({"/scan": {name: {"x": 1}}})
