"""The golden cases: what the upstream nodes returned, against what the command writes."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
import pytest
from ruamel.yaml import YAML

import pc2scan
from pc2scan.compare.golden.case import load_case
from pc2scan.compare.rules import Rules
from pc2scan.compare.scan_text import render_scans
from pc2scan.model import Connection, RawMessage
from support import GOLDEN, ROOT, sampled
from support.builders import CLOUD, SCAN, Item, Recording, Stream, deserialized, serialized, typestore, write_rosbag1
from support.command import run
from support.outputs import opened

if TYPE_CHECKING:
    from pathlib import Path

    from support.outputs import Found

#: The project's own copies.
FOLDERS = (ROOT / "fixtures" / "golden", ROOT / "fixtures" / "golden_exact")
OWN = {path.name: path for folder in FOLDERS for path in sorted(folder.iterdir()) if path.is_dir()}
CASES = OWN | {path.name: path for path in sorted(GOLDEN.iterdir()) if path.is_dir()}
MOVED = {"tf_static", "tf_dynamic", "scan_tf", "tf_tilted_2", "tf_typed_1", "tf_chain_0"}
MOVED |= {"reverse_tilted_0", "reverse_deskew_1"}


def test_every_kind_of_case_is_there_without_tolerances() -> None:
    assert set(CASES) > MOVED
    assert len(CASES) >= 30
    assert all("target_frame" in (CASES[name] / "params.yaml").read_text() for name in MOVED)
    assert [Rules.of(load_case(folder).comparison) for folder in OWN.values()] == [Rules()] * len(OWN)


@cache
def expected(name: str) -> list[Found]:
    found = opened(CASES[name] / "expected.bag")
    assert found.messages
    return found.messages


def converted(name: str, destination: Path, *options: str) -> None:
    case, folder = load_case(CASES[name]), CASES[name]
    files = (folder / "input.bag", "-o", destination, "--params-file", folder / "params.yaml")
    done = run("convert", *files, "--only-scans", *case.arguments, "--quiet", *options)
    assert done.status == case.exit_status, done.stderr


def is_reverse(name: str) -> bool:
    return "laserscan_to_pointcloud" in YAML(typ="safe").load(CASES[name] / "params.yaml")


@pytest.mark.parametrize("name", sampled(CASES, 12))
def test_equal_to_the_byte(name: str, tmp_path: Path) -> None:
    converted(name, tmp_path / "out.bag")
    assert opened(tmp_path / "out.bag").messages == expected(name)


@pytest.mark.parametrize(
    ("name", "options"),
    sampled(
        (
            (name, options)
            for name in ("fine_full_circle", "nan_and_inf_points", "tf_chain_1", "tf_dynamic")
            if name in CASES
            for options in ("", "--storage sqlite3", "--profile ros2")
        ),
        4,
    ),
)
def test_equal_to_the_bit_in_ros2_containers(name: str, options: str, tmp_path: Path) -> None:
    destination = tmp_path / ("out.mcap" if "--profile" in options else "out")
    converted(name, destination, *options.split())
    output = opened(destination)
    assert output.ros_version == 2
    assert [(m.topic, m.log_time_ns) for m in output.messages] == [(m.topic, m.log_time_ns) for m in expected(name)]
    # Every bit but `seq`, which ROS 2 does not have.
    found = pc2scan.diff(CASES[name] / "expected.bag", destination)
    assert found.same, str(found)
    assert sum(topic.matched for topic in found.topics) == len(expected(name))


# --- the same by `pc2scan golden` ---


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda folder: folder.name)
def test_the_projects_cases_pass_in_one_command(folder: Path) -> None:
    done = run("golden", folder, "--json")
    assert done.status == 0, done.stdout
    found = json.loads(done.stdout)
    names = {name for name, path in OWN.items() if path.parent == folder}
    assert found["counts"]["passed"] == len(names) == len(found["cases"])
    assert {case["name"] for case in found["cases"]} == names
    # A comparison of nothing would pass, too.
    for case in found["cases"]:
        (topic,) = case["difference"]["topics"]
        assert topic["matched"] == len(expected(case["name"]))
        assert topic["elements"] > 100


def outcome_of(name: str, folder: Path, bit: int) -> str:
    """The outcome of a case with its expected output as text, of which a value of the first message is changed."""
    case = folder / str(bit)
    shutil.copytree(OWN[name], case)
    msgtype, topic, part = (CLOUD, "/cloud", "data") if is_reverse(name) else (SCAN, "/scan", "ranges")
    messages = []
    for number, found in enumerate(expected(name)):
        message = deserialized(found.data, msgtype, 1)
        values = getattr(message, part).copy()
        values.view(np.uint32)[3] ^= bit if number == 0 else 0
        data = serialized(typestore(1), replace(message, **{part: values}), msgtype, 1)
        messages.append(RawMessage(Connection(0, topic, msgtype, "ros1"), found.log_time_ns, data, 0))
    (case / "expected.bag").unlink()
    if is_reverse(name):
        streams = (Stream(topic, msgtype),)
        items = [Item(streams[0], each.log_time_ns, {1: bytes(each.data)}) for each in messages]
        write_rosbag1(case / "expected.bag", Recording(streams, tuple(items)))
    else:
        (case / "expected.txt").write_text(render_scans(messages))
    (checked,) = pc2scan.golden(case).cases
    return checked.outcome


@pytest.mark.parametrize("name", sampled(OWN, 4))
def test_every_case_notices_a_bit(name: str, tmp_path: Path) -> None:
    assert [outcome_of(name, tmp_path, bit) for bit in (0, 1)] == ["passed", "failed"]
