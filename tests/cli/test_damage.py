"""What the command reports about damage."""

from __future__ import annotations

from pathlib import Path

import pytest

from pc2scan.bags.damage import Damage
from pc2scan.cli.damage import show_damage, show_recovery
from pc2scan.pipeline.report import Report
from pc2scan.pipeline.scan_spec import ScanSpec
from pc2scan.pipeline.topic_report import TopicReport

PATH = Path("drive.bag")


def told(capsys: pytest.CaptureFixture[str]) -> list[str]:
    captured = capsys.readouterr()
    assert captured.out == ""
    return captured.err.splitlines()


@pytest.mark.parametrize(
    ("place", "text"),
    [
        (Damage("is cut off", PATH), "damaged: drive.bag: is cut off"),
        (
            Damage("is cut off", PATH, 9, 1500, None, 1_000_000_000),
            "damaged: drive.bag, byte 9: is cut off (1.5 kB lost; from log time 1.000000000 on)",
        ),
        (
            Damage("names \x1b[2J", PATH, None, 0, 3, 1, 2_000_000_001),
            r"damaged: drive.bag: names \x1b[2J (3 messages lost; log time 0.000000001 to 2.000000001)",
        ),
        (
            Damage("has CRC 0", PATH, 9, 0, 0, 5, 5),
            "has CRC 0 (nothing lost, but what was read there may be wrong; log time 0.000000005)",
        ),
        (Damage("lacks a part", PATH, None, 10, 1, None, 5), "(10 B and 1 message lost; before log time 0.000000005)"),
    ],
)
def test_a_place(place: Damage, text: str, capsys: pytest.CaptureFixture[str]) -> None:
    show_damage([place])
    (line,) = told(capsys)
    assert line.endswith(text)


def test_many_places_are_cut_short(capsys: pytest.CaptureFixture[str]) -> None:
    show_damage([Damage("is broken", PATH, offset) for offset in range(1000)])
    lines = told(capsys)
    assert len(lines) == 6
    assert "995 more places" in lines[-1]


def report(*damage: Damage, declared: int | None = None) -> Report:
    topics = [TopicReport("/a", "", "/a", "passed", messages_in=1200)]
    damaged = list(damage)
    return Report(
        ["a"], "b", (ScanSpec(),), topics=topics, damage=damaged, messages_read=1200, messages_declared=declared
    )


def test_nothing_is_told_of_a_sound_source(capsys: pytest.CaptureFixture[str]) -> None:
    show_recovery(report())
    assert told(capsys) == []
    assert report().exit_status == 0


def test_what_was_recovered(capsys: pytest.CaptureFixture[str]) -> None:
    places = (Damage("x", PATH, 1, 100, None, 5, 9), Damage("y", PATH, 2, 200, None, 7, 12))
    show_recovery(report(*places, declared=1300))
    assert told(capsys)[-1] == (
        "recovered: 1,200 of the 1,300 messages that the source declares; 300 B lost; "
        "messages may be missing from log time 0.000000005 to 0.000000012"
    )
    show_recovery(report(Damage("x", PATH), declared=1200))
    assert told(capsys)[-1] == (
        "recovered: 1,200 messages; it is unknown how much is lost; it is unknown at which times messages are missing"
    )
    show_recovery(report(Damage("x", PATH, 1, 0, 2, 5, 9), Damage("y", PATH, 2, 0, 0)))
    assert told(capsys)[-1] == (
        "recovered: 1,200 messages; 2 messages lost; messages may be missing from log time 0.000000005 to 0.000000009"
    )
    show_recovery(report(Damage("x", PATH, 1, 0, 0)))
    assert told(capsys)[-1] == (
        "recovered: 1,200 messages; no bytes are known to be lost; no message is known to be missing"
    )
    assert report(*places).exit_status == 3
