"""What is damaged: noted once a place, told in the order of the file, or raised."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from pc2scan.bags import damage
from pc2scan.bags.chunks import Segment, Segments, times_around
from pc2scan.bags.damage import DamageLog
from pc2scan.errors import DamageError, RecordingError
from pc2scan.result import json_value

PATH = Path("drive.bag")


def error(what: str = "is cut off") -> DamageError:
    return DamageError(what, path=PATH)


def test_places_are_told_in_the_order_of_the_file() -> None:
    log = DamageLog()
    for offset in (300, 100, None, 200):
        log.note(error(f"at {offset}"), offset=offset)
    assert [place.offset for place in log.found] == [None, 100, 200, 300]


def test_a_place_is_noted_once_and_the_latest_word_counts() -> None:
    log = DamageLog()
    log.note(error(), offset=7)
    log.note(error("has a wrong CRC"), offset=7, bytes_lost=3)
    log.note(error(), offset=7, key="another message")
    assert [(place.what, place.bytes_lost) for place in log.found] == [("has a wrong CRC", 3), ("is cut off", 0)]


def test_strict_raises_what_was_noted() -> None:
    problem = error()
    with pytest.raises(RecordingError) as caught:
        DamageLog(strict=True).note(problem, offset=7)
    assert caught.value is problem


def test_places_beyond_the_limit_are_added_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(damage, "MAX_PLACES", 3)
    log = DamageLog()
    for offset in range(10):
        log.note(error(), offset=offset, bytes_lost=5)
    assert len(log.found) == 4
    assert log.found[-1].bytes_lost == 35
    assert "more damage" in log.found[-1].what


def test_damage_is_json() -> None:
    log = DamageLog()
    log.note(error(), offset=7, bytes_lost=3, messages_lost=1, first_ns=10, last_ns=20)
    assert json.loads(json.dumps(json_value(log.found[0]))) == {
        "what": "is cut off", "path": "drive.bag", "offset": 7, "bytes_lost": 3, "messages_lost": 1,
        "first_ns": 10, "last_ns": 20,
    }  # fmt: skip


def test_times_around_a_place() -> None:
    around = times_around(
        Segments(
            Segment(offset, 10, 10, start_ns, end_ns)
            for offset, start_ns, end_ns in ((0, 1, 12), (20, 5, 9), (40, 30, 35), (60, 25, 40), (80, 0, 0))
        )
    )
    assert around(30, 40) == {"first_ns": 12, "last_ns": 25}
    assert around(0, 0) == {"first_ns": None, "last_ns": 1}
    assert around(70, 100) == {"first_ns": 40, "last_ns": None}
    assert times_around(Segments())(0, 9) == {"first_ns": None, "last_ns": None}
