from __future__ import annotations

import pytest

from pc2scan.cli.render import count, error_text, printable, size, table
from pc2scan.errors import DecodeError, UsageError, stamp_text


def test_a_terminal_is_told_nothing_that_it_would_act_upon() -> None:
    assert printable("/sc\x1b[2Jan\r\n\x07") == "/sc\\x1b[2Jan\\r\\n\\x07"
    assert printable("läser 点") == "läser 点"
    assert printable("\udcff\u202e") == "\\udcff\\u202e"


def test_an_error_says_where_what_and_what_to_do() -> None:
    err = DecodeError("data has 3 bytes", path="a.bag", topic="/p\x1b", stamp_ns=1_000_000_005, hint="look")
    assert error_text(err).splitlines() == [
        "error: a.bag, /p\\x1b, stamp 1.000000005: data has 3 bytes",
        "hint: look",
    ]
    assert error_text(UsageError("no")) == "error: no"


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
    table(("topic", "in"), [("/a\x1b", "1"), ("/longer", "1,000")], left=("topic",))
    assert capsys.readouterr().out.splitlines() == [
        "topic        in",
        "---------------",
        "/a\\x1b        1",
        "/longer   1,000",
    ]
