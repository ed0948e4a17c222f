"""Tables and errors as they are printed; `tests/transcripts/shown.calls` has numbers, times and names."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from pc2scan.bags.damage import Damage
from pc2scan.cli.render import say, show, show_error
from pc2scan.conversion.report import Report
from pc2scan.errors import DecodeError, UsageError
from pc2scan.options.call import Options
from pc2scan.request.spec import ScanSpec
from pc2scan.text import Table
from support.tables import rows

TABLES = Path(__file__).with_name("shown_text.txt")


@pytest.mark.parametrize(("text", "shown"), rows(TABLES, "commands of CI systems"))
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


PATH = Path("drive.bag")
CELLS = (
    ("topic", "type", "messages", "lost", "what"),
    ("/front/lidar/velodyne_points", "sensor_msgs/msg/PointCloud2", "12,000", "-", "converted with a remark of words"),
    ("/imu", "sensor_msgs/msg/Imu", "7", "-", ""),
)


NARROW = """\
topic            type              messages  what
-------------------------------------------------------------
/front/lidar/ve  sensor_msgs/msg/    12,000  converted with a
lodyne_points    PointCloud2                 remark of words
/imu             sensor_msgs/msg/         7
                 Imu
"""


def test_a_table_that_is_too_wide_loses_no_text() -> None:
    table = Table(CELLS[0], CELLS[1:], ("topic", "type", "what"))
    as_it_is, wide, narrow = (list(table.lines(width)) for width in (None, 200, 61))
    assert as_it_is == wide
    assert len(wide) == 4
    # Empty columns go first, then text is wrapped, and all columns share the space.
    assert "lost" in wide[0]
    assert narrow == NARROW.splitlines()
    # Numbers are shown, even if they do not fit.
    numbers = list(Table(["on", *"abcdefgh"], [["/scan", *["1,000,000"] * 8]], ("on",)).lines(50))
    assert numbers[-1].count("1,000,000") == 8


@pytest.mark.parametrize(("places", "declared", "recovered"), rows(TABLES, "recovered"))
def test_a_run_says_what_was_recovered(
    places: Any, declared: int | None, recovered: str, capsys: pytest.CaptureFixture[str]
) -> None:
    damage = [Damage("x", PATH, *place) for place in places]
    report = Report(["a"], "b", (ScanSpec(),), damage=damage, messages_read=1200, messages_declared=declared)
    show(report, Options("convert", {"quiet": True}))
    assert capsys.readouterr().err.splitlines()[-1] == f"recovered: {recovered}"
    assert report.exit_status == 3
