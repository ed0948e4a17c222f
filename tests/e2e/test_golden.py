"""The golden cases: what the upstream nodes returned, against what the command writes."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from ruamel.yaml import YAML

from builders import CLOUD, SCAN, deserialized, serialized, typestore
from e2e.command import run
from e2e.outputs import opened
from pc2scan.bags.model import Connection, RawMessage
from pc2scan.cli.in_process import run_command
from pc2scan.compare.rules import Rules
from pc2scan.compare.scan_text import render
from pc2scan.golden.case import load_case
from pc2scan.golden.check import check_case
from support import GOLDEN, ROOT

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from e2e.outputs import Found

#: The project's own copies.
FOLDER = ROOT / "fixtures" / "golden"
CASES = sorted(path.name for path in GOLDEN.iterdir() if path.is_dir())
OWN = sorted(path.name for path in FOLDER.iterdir() if path.is_dir())
TRANSFORMED = {"tf_static", "tf_dynamic", "scan_tf"}


def test_every_kind_of_case_is_there() -> None:
    assert set(CASES) > TRANSFORMED
    assert len(CASES) >= 16


@cache
def expected(name: str) -> list[Found]:
    found = opened(GOLDEN / name / "expected.bag")
    assert found.messages
    return found.messages


def converted(name: str, destination: Path, *options: str) -> None:
    case = GOLDEN / name
    done = run(
        "convert", case / "input.bag", "-o", destination, "--params-file", case / "params.yaml", "--quiet", *options
    )
    assert done.status == 0, done.stderr


def is_reverse(name: str) -> bool:
    return "laserscan_to_pointcloud" in YAML(typ="safe").load(GOLDEN / name / "params.yaml")


@pytest.mark.parametrize("name", CASES)
def test_equal_to_the_byte(name: str, tmp_path: Path) -> None:
    destination = tmp_path / "out.bag"
    converted(name, destination, "--only-scans")
    assert opened(destination).messages == expected(name)


FIELDS = ("angle_min", "angle_max", "angle_increment", "time_increment", "scan_time", "range_min", "range_max")


def parts_of(data: bytes, msgtype: str, generation: int) -> dict[str, Any]:
    """Everything but ``seq``, which ROS 2 does not have; arrays as their bytes, so that NaN equals NaN."""
    message = deserialized(data, msgtype, generation)
    stamp = message.header.stamp
    parts = {"stamp": (stamp.sec, stamp.nanosec), "frame_id": message.header.frame_id}
    if msgtype == SCAN:
        parts |= {name: getattr(message, name) for name in FIELDS}
        return parts | {"ranges": message.ranges.tobytes(), "intensities": message.intensities.tobytes()}
    fields = [(field.name, field.offset, field.datatype, field.count) for field in message.fields]
    shape = (message.height, message.width, message.point_step, message.row_step)
    flags = (message.is_bigendian, message.is_dense)
    return parts | {"fields": fields, "shape": shape, "flags": flags, "data": message.data.tobytes()}


@pytest.mark.parametrize("name", ["fine_full_circle", "nan_and_inf_points", "scan_intensity", "tf_dynamic"])
@pytest.mark.parametrize("options", [(), ("--storage", "sqlite3"), ("--profile", "ros2")], ids=str)
def test_equal_to_the_bit_in_ros2_containers(name: str, options: tuple[str, ...], tmp_path: Path) -> None:
    if name not in CASES:
        pytest.skip(f"{name} is not among the golden cases")
    destination = tmp_path / ("out.mcap" if "--profile" in options else "out")
    converted(name, destination, "--only-scans", *options)
    output = opened(destination)
    msgtype = CLOUD if is_reverse(name) else SCAN
    assert output.generation == 2
    assert [(found.topic, found.log_time_ns) for found in output.messages] == [
        (found.topic, found.log_time_ns) for found in expected(name)
    ]
    for found, reference in zip(output.messages, expected(name), strict=True):
        assert parts_of(found.data, msgtype, 2) == parts_of(reference.data, msgtype, 1)


# --- the same by `pc2scan golden` ---


def test_the_projects_cases_pass_in_one_command() -> None:
    done = run("golden", FOLDER, "--json")
    assert done.status == 0, done.stdout
    found = json.loads(done.stdout)
    assert found["passed"] == len(OWN) == len(found["cases"])
    assert {case["name"] for case in found["cases"]} == set(OWN)
    # A comparison of nothing would pass, too.
    for case in found["cases"]:
        (topic,) = case["difference"]["topics"]
        assert topic["matched"] == len(expected(case["name"]))
        assert topic["elements"] > 100


def test_no_case_has_a_tolerance() -> None:
    assert [load_case(FOLDER / name).rules for name in OWN] == [Rules()] * len(OWN)


def checked(folder: Path) -> str:
    return check_case("case", folder, run_command).outcome.value


def with_expected(name: str, folder: Path, change: Callable[[Any], None]) -> Path:
    """A copy of a case with another expected first message, as text; ``change`` edits its float32 values."""
    case = folder / name
    shutil.copytree(FOLDER / name, case)
    msgtype = CLOUD if is_reverse(name) else SCAN
    topic, connection = ("/cloud", CLOUD) if msgtype == CLOUD else ("/scan", SCAN)
    messages = []
    for number, found in enumerate(expected(name)):
        message = deserialized(found.data, msgtype, 1)
        if number == 0:
            values = (message.data if msgtype == CLOUD else message.ranges).copy()
            change(values.view(np.float32))
            message = replace(message, **{"data" if msgtype == CLOUD else "ranges": values})
        data = serialized(typestore(1), message, msgtype, 1)
        messages.append(RawMessage(Connection(0, topic, connection, "ros1"), found.log_time_ns, data, 0))
    (case / "expected.bag").unlink()
    (case / "expected.txt").write_text(render(messages))
    return case


@pytest.mark.parametrize("name", OWN)
def test_every_case_notices_a_bit(name: str, tmp_path: Path) -> None:
    def nothing(_: Any) -> None:
        pass

    def one_bit(values: Any) -> None:
        values.view(np.uint32)[3] ^= 1

    assert checked(with_expected(name, tmp_path / "as it is", nothing)) == "passed"
    assert checked(with_expected(name, tmp_path / "one bit", one_bit)) == "failed"


def test_transformed_clouds_are_numbered_as_upstream_does() -> None:
    # tf2 gives a transformed cloud the transform's header, whose sequence number is 0; `seq` is not ignored.
    reference = [deserialized(found.data, CLOUD, 1) for found in expected("scan_tf")]
    assert {message.header.seq for message in reference} == {0}
    assert "seq" not in load_case(FOLDER / "scan_tf").rules.ignore
