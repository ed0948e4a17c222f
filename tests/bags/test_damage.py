"""What is damaged: noted once a place, told in the order of the file, or raised."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from pc2scan.bags import damage
from pc2scan.bags.damage import DamageLog
from pc2scan.errors import DamageError

if TYPE_CHECKING:
    import pytest

PATH = Path("drive.bag")


def error(what: str = "is cut off") -> DamageError:
    return DamageError(what, path=PATH)


def test_places_are_told_in_the_order_of_the_file() -> None:
    log = DamageLog()
    for offset in (300, 100, None, 200):
        log.note(error(f"at {offset}"), offset=offset)
    assert [place.offset for place in log.places] == [None, 100, 200, 300]


def test_a_place_is_noted_once_and_the_latest_word_counts() -> None:
    log = DamageLog()
    log.note(error(), offset=7)
    log.note(error("has a wrong CRC"), offset=7, bytes_lost=3)
    log.note(error(), offset=7, key="another message")
    assert [(place.what, place.bytes_lost) for place in log.places] == [("has a wrong CRC", 3), ("is cut off", 0)]


def test_places_beyond_the_limit_are_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(damage, "MAX_PLACES", 3)
    log = DamageLog()
    for offset in range(10):
        log.note(error(), offset=offset, bytes_lost=5)
    assert len(log.places) == 4
    assert "more damage" in log.places[0].what
