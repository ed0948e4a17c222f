"""Shows the damage of recordings on standard error."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pc2scan.errors import stamp_text
from pc2scan.text import counted, size

from .render import say

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pc2scan.bags.damage import Damage
    from pc2scan.pipeline.report import Report

#: The exit status of a command that wrote what is recoverable of a damaged source.
DAMAGED = 3

#: Damaged places, and reasons for skipping, that are shown without --verbose.
SHOWN = 5


def show_damage(damage: Sequence[Damage], *, limit: int = SHOWN) -> None:
    """Show the damage, its place, and what is lost there."""
    for place in damage[:limit]:
        say(f"damaged: {place}", err=True)
    if len(damage) > limit:
        say(f"damaged: {len(damage) - limit:,} more places (--report or --json lists them)", err=True)


def show_recovery(report: Report, *, limit: int = SHOWN) -> None:
    """Show the damage of a run's sources, and how much was recovered."""
    if report.damage:
        show_damage(report.damage, limit=limit)
        say(recovery_text(report), err=True)


def recovery_text(report: Report) -> str:
    """Return how much was recovered of the damaged sources of a run, and what is missing."""
    declared = report.messages_declared
    found = counted(report.messages_read, "message")
    if declared is not None and declared > report.messages_read:
        found = f"{report.messages_read:,} of the {declared:,} messages that the source declares"
    missing = [place for place in report.damage if place.loses]
    lost = _lost(missing) if missing else "no bytes are known to be lost"
    span = _spanned(missing) if missing else "no message is known to be missing"
    return f"recovered: {found}; {lost}; {span}"


def _lost(damage: Sequence[Damage]) -> str:
    """Return how much is missing in all damaged places together."""
    if stored := sum(place.bytes_lost for place in damage):
        return f"{size(stored)} lost"
    counts = [place.messages_lost for place in damage if place.messages_lost is not None]
    if len(counts) == len(damage):
        return f"{counted(sum(counts), 'message')} lost"
    return "it is unknown how much is lost"


def _spanned(damage: Sequence[Damage]) -> str:
    """Return the times between which messages may be missing, for all damaged places together."""
    firsts = [place.first_ns for place in damage]
    lasts = [place.last_ns for place in damage]
    first = min((time for time in firsts if time is not None), default=None)
    last = None if None in lasts else max((time for time in lasts if time is not None), default=None)
    if first is None:
        return "it is unknown at which times messages are missing"
    return f"messages may be missing from log time {stamp_text(first)} " + (
        "on" if last is None else f"to {stamp_text(last)}"
    )
