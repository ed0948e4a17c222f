"""Numbers, times, names and tables as they are printed."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pc2scan.cli.fitting import table_lines
from pc2scan.cli.render import count, duration, say, show_error, show_table, size, stamp
from pc2scan.errors import DecodeError, UsageError, name_list, stamp_text, visible
from pc2scan.shown import Table


@pytest.mark.parametrize(
    ("shown", "expected"),
    [
        (visible("/sc\x1b[2Jan\r\n\x07"), "/sc\\x1b[2Jan\\r\\n\\x07"),
        (visible("läser 点"), "läser 点"),
        (visible("läser 点", ascii_only=True), "l\\xe4ser \\u70b9"),
        (visible("\udcff\u202e"), "\\udcff\\u202e"),
        (stamp_text(0), "0.000000000"),
        (stamp_text(1604515190231374463), "1604515190.231374463"),
        (stamp_text(-5), "-0.000000005"),
        (stamp_text(-(10**9)), "-1.000000000"),
        # Stamps have dates where they are times of the day.
        (stamp(-1), "-0.000000001"),
        (stamp(12_000_000_000), "12.000000000"),
        (stamp(2**63 - 1), "9223372036.854775807"),
        (stamp(1_700_000_000_999_999_999), "1700000000.999999999 (2023-11-14 22:13:20 UTC)"),
        (count(0), "-"),
        (count(1234567), "1,234,567"),
        (size(0), "0 B"),
        (size(999), "999 B"),
        (size(1000), "1.0 kB"),
        (size(2.5e9), "2.5 GB"),
        (size(3e15), "3000.0 TB"),
        (duration(0.0), "under 1 ms"),
        (duration(0.001), "1 ms"),
        (duration(0.9994), "999 ms"),
        (duration(0.9996), "1.0 s"),
        (duration(59.94), "59.9 s"),
        (duration(59.96), "1 min 0 s"),
        (duration(3599.6), "1 h 0 min"),
        (duration(90061), "25 h 1 min"),
        (name_list([]), "none"),
        (name_list(["/a", "/b", "/c"], limit=2), "/a, /b and 1 more"),
    ],
)
def test_numbers_times_and_names_are_shown_so(shown: str, expected: str) -> None:
    assert shown == expected


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
    show_table(Table(("topic", "in"), [("/a\x1b", "1"), ("/longer", "1,000")], left=("topic",)))
    lines = ["topic        in", "---------------", "/a\\x1b        1", "/longer   1,000"]
    assert capsys.readouterr().out.splitlines() == lines


CELLS = [
    ("topic", "type", "messages", "lost", "what"),
    ("/front/lidar/velodyne_points", "sensor_msgs/msg/PointCloud2", "12,000", "-", "converted with a remark of words"),
    ("/imu", "sensor_msgs/msg/Imu", "7", "-", ""),
]


def test_a_table_that_is_too_wide_loses_no_text() -> None:
    wide, narrow = (list(table_lines(CELLS, ("topic", "type", "what"), width)) for width in (None, 80))
    assert wide == list(table_lines(CELLS, ("topic", "type", "what"), 200))
    assert len(wide) == 4
    # Empty columns go first, then text is wrapped.
    assert "lost" in wide[0]
    assert "lost" not in narrow[0]
    assert narrow[1] == "-" * len(narrow[1])
    assert all(word in " ".join(narrow) for word in ("/front/", "velodyne_points", "PointCloud2", "remark", "12,000"))
    # At last columns on the right go, and are named.
    shown = list(table_lines([["on", *"abcdefgh"], ["/scan", *["1,000,000"] * 8]], ("on",), 50))
    assert shown[-1] == "(no room for: e, f, g, h)"


@given(st.lists(st.lists(st.text("ab /", max_size=40), min_size=4, max_size=4), max_size=5), st.integers(60, 120))
def test_any_table_fits(rows: list[list[str]], width: int) -> None:
    cells = [["one", "two", "three", "four"], *rows]
    assert all(len(line) <= width for line in table_lines(cells, ("one", "three"), width))
