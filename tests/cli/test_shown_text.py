"""Tables and errors as they are printed; `tests/transcripts/shown.calls` has numbers, times and names."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pc2scan.bags.damage import Damage
from pc2scan.cli.render import say, show, show_error, show_parts
from pc2scan.errors import DecodeError, UsageError
from pc2scan.pipeline.report import Report
from pc2scan.pipeline.scan_spec import ScanSpec
from pc2scan.tables import Table, fitted


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("::error::x", r"\x3a:error::x"),
        ("  ::set-output name=a::b", r"  \x3a:set-output name=a::b"),
        ("a ##[error]b", r"a \x23\x23[error]b"),
        ("###vso[task.setvariable variable=PATH]x", r"#\x23\x23vso[task.setvariable variable=PATH]x"),
        ("##teamcity[buildStop]", r"\x23\x23teamcity[buildStop]"),
        ("std::string /a::b #1", "std::string /a::b #1"),
        ("  0.1 to 0.2 m  ####", "  0.1 to 0.2 m  ####"),
    ],
)
def test_commands_of_ci_systems_are_shown_not_obeyed(text: str, shown: str, capsys: pytest.CaptureFixture[str]) -> None:
    say(text)
    assert capsys.readouterr().out == f"{shown}\n"


def test_an_error_says_where_what_and_what_to_do(capsys: pytest.CaptureFixture[str]) -> None:
    show_error(DecodeError("data has 3 bytes", path="a.bag", topic="/p\x1b", stamp_ns=1_000_000_005, hint="look"))
    show_error(UsageError("no"))
    assert capsys.readouterr().err.splitlines() == [
        "error: a.bag, /p\\x1b, stamp 1.000000005: data has 3 bytes",
        "hint: look",
        "error: no",
    ]


def test_a_table_lines_up_and_escapes(capsys: pytest.CaptureFixture[str]) -> None:
    show_parts([Table(("topic", "in"), [("/a\x1b", "1"), ("/longer", "1,000")], left=("topic",))])
    lines = ["topic        in", "---------------", "/a\\x1b        1", "/longer   1,000"]
    assert capsys.readouterr().out.splitlines() == lines


PATH = Path("drive.bag")
CELLS = [
    ("topic", "type", "messages", "lost", "what"),
    ("/front/lidar/velodyne_points", "sensor_msgs/msg/PointCloud2", "12,000", "-", "converted with a remark of words"),
    ("/imu", "sensor_msgs/msg/Imu", "7", "-", ""),
]


NARROW = """\
topic            type              messages  what
-------------------------------------------------------------
/front/lidar/    sensor_msgs/        12,000  converted with a
velodyne_points  msg/PointCloud2             remark of words
/imu             sensor_msgs/             7
                 msg/Imu
"""


def test_a_table_that_is_too_wide_loses_no_text() -> None:
    as_it_is, wide, narrow = (list(fitted(CELLS, ("topic", "type", "what"), width)) for width in (None, 200, 61))
    assert as_it_is == wide
    assert len(wide) == 4
    # Empty columns go first, then text is wrapped, and all columns share the space.
    assert "lost" in wide[0]
    assert narrow == NARROW.splitlines()
    # At last columns on the right go, and are named.
    shown = list(fitted([["on", *"abcdefgh"], ["/scan", *["1,000,000"] * 8]], ("on",), 50))
    assert shown[-1] == "(no room for: e, f, g, h)"


@given(st.lists(st.lists(st.text("ab /", max_size=40), min_size=4, max_size=4), max_size=5), st.integers(60, 120))
def test_any_table_fits(rows: list[list[str]], width: int) -> None:
    cells = [["one", "two", "three", "four"], *rows]
    assert all(len(line) <= width for line in fitted(cells, ("one", "three"), width))


def test_many_places_are_cut_short(capsys: pytest.CaptureFixture[str]) -> None:
    damage = [Damage("is \x1b[2J", PATH, offset) for offset in range(1000)]
    show(Report(["a"], "b", (ScanSpec(),), damage=damage), quiet=True)
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 7
    assert lines[0] == r"damaged: drive.bag, byte 0: is \x1b[2J"
    assert lines[-2] == "damaged: 995 more"


@pytest.mark.parametrize(
    ("places", "declared", "found", "lost", "times"),
    [
        (
            [(1, 100, None, 5, 9), (2, 200, None, 7, 12)],
            1300,
            "1,200 of the 1,300 messages that the source declares",
            "300 B lost",
            "messages may be missing from log time 0.000000005 to 0.000000012",
        ),
        (
            [()],
            1200,
            "1,200 messages",
            "it is unknown how much is lost",
            "it is unknown at which times messages are missing",
        ),
        (
            [(1, 0, 2, 5, 9), (2, 0, 0)],
            None,
            "1,200 messages",
            "2 messages lost",
            "messages may be missing from log time 0.000000005 to 0.000000009",
        ),
        ([(1, 0, 0)], None, "1,200 messages", "no bytes are known to be lost", "no message is known to be missing"),
    ],
)
def test_a_run_says_what_was_recovered(
    places: Any, declared: int | None, found: str, lost: str, times: str, capsys: pytest.CaptureFixture[str]
) -> None:
    damage = [Damage("x", PATH, *place) for place in places]
    report = Report(["a"], "b", (ScanSpec(),), damage=damage, messages_read=1200, messages_declared=declared)
    show(report, quiet=True)
    assert capsys.readouterr().err.splitlines()[-1] == f"recovered: {found}; {lost}; {times}"
    assert report.exit_status == 3
