"""Warnings of scans that those who read them would refuse, or that show what is not there."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from pc2scan.core.consumers import CONSUMERS, judge
from pc2scan.messages.consumed import consumed_scan
from pc2scan.messages.laserscan import decode_laserscan

if TYPE_CHECKING:
    from pc2scan.core.consumers import Outcome, Verdict
    from pc2scan.core.params import ProjectionParams
    from pc2scan.model import Buffer

__all__ = ["ghosts", "refusal"]


#: What a consumer does with scans that it does not accept.
_DOES: dict[Outcome, str] = {
    "shifted": "would turn these scans by up to one beam",
    "misplaced": "would misplace these scans",
    "ignored": "would refuse these scans",
    "aborts": "would abort at these scans",
}


def ghosts(params: ProjectionParams) -> list[str]:
    """Warn of parameters that put returns where nothing is."""
    if params.reduce != "mean":
        return []
    found = "reduce is mean, which puts returns where nothing is, between a near thing and a far one: "
    return [f"{found}8 % of the returns in a simulated hall. `reduce=surface` is as smooth, without them"]


def refusal(data: Buffer, serialization: str, consumer: str = "") -> str:
    """Who would ignore scans like this one, or abort: a sentence for a warning; empty if nobody.

    Of a consumer that the scans are made for, everything counts. Of the others only what a scan advertises: what its
    ranges do is left to `pc2scan check`. Infinite ranges with an infinite range_max, as upstream's own defaults have
    them, are misplaced by most consumers, and gmapping aborts.

    Parameters
    ----------
    data
        A serialised LaserScan.
    serialization
        ``ros1`` or ``cdr``.
    consumer
        Whose preset was chosen; empty: nobody's.
    """
    scan = consumed_scan(decode_laserscan(data, serialization))
    if consumer:
        verdict = judge(consumer, scan)
        return "" if verdict.outcome == "accepted" else f"{consumer} {_DOES[verdict.outcome]}: {_why(verdict)}"
    scan = replace(scan, infinite=0, short=0)
    verdicts = [verdict for consumer in CONSUMERS if (verdict := judge(consumer, scan)).refused]
    if not verdicts:
        return ""
    first = verdicts[0]
    others = f" (so would {', '.join(verdict.consumer for verdict in verdicts[1:])})" if verdicts[1:] else ""
    return f"{first.consumer} would refuse these scans{others}: {_why(first)}"


def _why(verdict: Verdict) -> str:
    """What a scan has, what it should have, and what to do."""
    return f"{verdict.observed} where it allows {verdict.allowed}. {verdict.cure[:1].upper()}{verdict.cure[1:]}"
