"""How damage is described; `tests/transcripts/damage.txt` has it as the command says it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from pc2scan.bags.damage import Damage
from pc2scan.cli.damage import show_damage, show_recovery
from pc2scan.pipeline.report import Report
from pc2scan.pipeline.scan_spec import ScanSpec

PATH = Path("drive.bag")


@pytest.mark.parametrize(
    ("place", "text"),
    [
        (("is cut off",), ": is cut off"),
        (
            ("is cut off", 9, 1500, None, 1_000_000_000),
            ", byte 9: is cut off (1.5 kB lost; from log time 1.000000000 on)",
        ),
        (
            ("names \x1b[2J", None, 0, 3, 1, 2_000_000_001),
            r": names \x1b[2J (3 messages lost; log time 0.000000001 to 2.000000001)",
        ),
        (
            ("has CRC 0", 9, 0, 0, 5, 5),
            ", byte 9: has CRC 0 (nothing lost, but what was read there may be wrong; log time 0.000000005)",
        ),
        (
            ("lacks a part", None, 10, 1, None, 5),
            ": lacks a part (10 B and 1 message lost; before log time 0.000000005)",
        ),
    ],
)
def test_a_place_says_what_is_lost_and_when(place: Any, text: str, capsys: pytest.CaptureFixture[str]) -> None:
    what, *details = place
    show_damage([Damage(what, PATH, *details)])
    assert capsys.readouterr() == ("", f"damaged: drive.bag{text}\n")


def test_many_places_are_cut_short(capsys: pytest.CaptureFixture[str]) -> None:
    show_damage([Damage("is broken", PATH, offset) for offset in range(1000)])
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 6
    assert "995 more places" in lines[-1]


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
        (
            [(1, 0, 0)],
            None,
            "1,200 messages",
            "no bytes are known to be lost",
            "no message is known to be missing",
        ),
    ],
)
def test_a_run_says_what_was_recovered(
    places: Any, declared: int | None, found: str, lost: str, times: str, capsys: pytest.CaptureFixture[str]
) -> None:
    damage = [Damage("x", PATH, *place) for place in places]
    report = Report(["a"], "b", (ScanSpec(),), damage=damage, messages_read=1200, messages_declared=declared)
    show_recovery(report)
    assert capsys.readouterr().err.splitlines()[-1] == f"recovered: {found}; {lost}; {times}"
    assert report.exit_status == 3
