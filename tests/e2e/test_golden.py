"""The golden cases: what the upstream nodes returned, against what the command writes."""

from __future__ import annotations

import json
from functools import cache
from typing import TYPE_CHECKING

import pytest

import pc2scan
from pc2scan.compare.golden import load_case
from pc2scan.compare.rules import Rules
from support import GOLDEN, ROOT, sampled
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


@pytest.mark.parametrize("folder", sampled(FOLDERS, 1), ids=lambda folder: folder.name)
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
