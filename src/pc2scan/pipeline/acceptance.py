"""Warnings about scans that consumers would not accept, or that have returns where there is no object."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from pc2scan.core.consumers import CONSUMERS, judge
from pc2scan.messages.laserscan import decode_laserscan, scan_for_consumers

if TYPE_CHECKING:
    from pc2scan.core.params import ProjectionParams
    from pc2scan.core.verdicts import Outcome, Verdict
    from pc2scan.model import Buffer

#: What a consumer does with scans by its verdict, as part of a sentence.
_DOES: dict[Outcome, str] = {
    "shifted": "would turn these scans by up to one beam",
    "misplaced": "would misplace these scans",
    "ignored": "would ignore these scans",
    "aborts": "would abort at these scans",
}


def ghosts(params: ProjectionParams) -> list[str]:
    """Return a warning for each parameter that puts returns where there is no object."""
    if params.reduce != "mean":
        return []
    found = "reduce is mean, which puts returns where nothing is, between a near and a far object: "
    return [f"{found}8 % of the returns in a simulated hall. `reduce=surface` is as smooth, without them"]


def refusal(data: Buffer, serialization: str, consumer: str = "") -> str:
    """Return a warning that names the consumers that would ignore scans like this one, or abort; empty if none would.

    The consumer that the scans are made for is checked by all its rules. The others are checked only by what a
    scan's header advertises; `pc2scan check` judges the ranges. Infinite ranges with an infinite range_max, as
    upstream's own defaults have them, are misplaced by most consumers, and gmapping aborts.

    Parameters
    ----------
    data
        A serialised LaserScan.
    serialization
        ``ros1`` or ``cdr``.
    consumer
        The consumer whose preset was chosen; empty if none was.
    """
    scan = scan_for_consumers(decode_laserscan(data, serialization))
    if consumer:
        verdict = judge(consumer, scan)
        return "" if verdict.outcome == "accepted" else f"{consumer} {_DOES[verdict.outcome]}: {_why(verdict)}"
    scan = replace(scan, infinite=0, short=0)
    verdicts = [verdict for consumer in CONSUMERS if (verdict := judge(consumer, scan)).refused]
    if not verdicts:
        return ""
    first = verdicts[0]
    others = f" (so would {', '.join(verdict.consumer for verdict in verdicts[1:])})" if verdicts[1:] else ""
    return f"{first.consumer} would ignore these scans{others}: {_why(first)}"


def _why(verdict: Verdict) -> str:
    """Return what a scan has, what the consumer allows, and how to change it."""
    return f"{verdict.observed} where it allows {verdict.allowed}. {verdict.cure[:1].upper()}{verdict.cure[1:]}"
