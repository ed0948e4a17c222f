from __future__ import annotations

import pytest

from pc2scan.cli.render import count, duration, say, show_error, show_table, size, stamp
from pc2scan.errors import DecodeError, UsageError, stamp_text, visible
from pc2scan.text import Table


def test_a_terminal_is_told_nothing_that_it_would_act_upon() -> None:
    assert visible("/sc\x1b[2Jan\r\n\x07") == "/sc\\x1b[2Jan\\r\\n\\x07"
    assert visible("läser 点") == "läser 点"
    assert visible("läser 点", ascii_only=True) == "l\\xe4ser \\u70b9"
    assert visible("\udcff\u202e") == "\\udcff\\u202e"


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
    err = DecodeError("data has 3 bytes", path="a.bag", topic="/p\x1b", stamp_ns=1_000_000_005, hint="look")
    show_error(err)
    assert capsys.readouterr().err.splitlines() == [
        "error: a.bag, /p\\x1b, stamp 1.000000005: data has 3 bytes",
        "hint: look",
    ]
    show_error(UsageError("no"))
    assert capsys.readouterr().err == "error: no\n"


@pytest.mark.parametrize(
    ("stamp_ns", "text"),
    [
        (0, "0.000000000"),
        (1604515190231374463, "1604515190.231374463"),
        (-5, "-0.000000005"),
        (-(10**9), "-1.000000000"),
    ],
)
def test_stamps_keep_every_digit(stamp_ns: int, text: str) -> None:
    assert stamp_text(stamp_ns) == text


def test_numbers() -> None:
    assert [count(0), count(1234567)] == ["-", "1,234,567"]
    assert [size(0), size(999), size(1000), size(2.5e9), size(3e15)] == [
        "0 B",
        "999 B",
        "1.0 kB",
        "2.5 GB",
        "3000.0 TB",
    ]


def test_a_table_lines_up_and_escapes(capsys: pytest.CaptureFixture[str]) -> None:
    show_table(Table(("topic", "in"), [("/a\x1b", "1"), ("/longer", "1,000")], left=("topic",)))
    assert capsys.readouterr().out.splitlines() == [
        "topic        in",
        "---------------",
        "/a\\x1b        1",
        "/longer   1,000",
    ]


@pytest.mark.parametrize(
    ("seconds", "shown"),
    [
        (0.0, "under 1 ms"),
        (0.001, "1 ms"),
        (0.9994, "999 ms"),
        (0.9996, "1.0 s"),
        (59.94, "59.9 s"),
        (59.96, "1 min 0 s"),
        (3599.6, "1 h 0 min"),
        (90061, "25 h 1 min"),
    ],
)
def test_durations(seconds: float, shown: str) -> None:
    assert duration(seconds) == shown


def test_stamps_have_dates_where_they_are_times_of_the_day() -> None:
    assert stamp(-1) == "-0.000000001"
    assert stamp(12_000_000_000) == "12.000000000"
    assert stamp(2**63 - 1) == "9223372036.854775807"
    assert stamp(1_700_000_000_999_999_999) == "1700000000.999999999 (2023-11-14 22:13:20 UTC)"
