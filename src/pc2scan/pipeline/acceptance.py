"""Warnings of scans that those who read them would refuse, or that show what is not there."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from pc2scan.core.consumers import CONSUMERS, judge
from pc2scan.messages.consumed import consumed_scan
from pc2scan.messages.laserscan import decode_laserscan

if TYPE_CHECKING:
    from pc2scan.core.params import ProjectionParams
    from pc2scan.model import Buffer

__all__ = ["ghosts", "refusal"]


def ghosts(params: ProjectionParams) -> list[str]:
    """Warn of parameters that put returns where nothing is."""
    if params.reduce != "mean":
        return []
    found = "reduce is mean, which puts returns where nothing is, between a near thing and a far one: "
    return [f"{found}8 % of the returns in a simulated hall. `reduce=surface` is as smooth, without them"]


def refusal(data: Buffer, serialization: str) -> str:
    """Who would ignore scans like this one, or abort: a sentence for a warning; empty if nobody.

    Only what a scan advertises counts. What its ranges do is left to `pc2scan check`: infinite ranges with an infinite
    range_max, as upstream's own defaults have them, are misplaced by most consumers, and gmapping aborts.

    Parameters
    ----------
    data
        A serialised LaserScan.
    serialization
        ``ros1`` or ``cdr``.
    """
    scan = replace(consumed_scan(decode_laserscan(data, serialization)), infinite=0, short=0)
    verdicts = [verdict for consumer in CONSUMERS if (verdict := judge(consumer, scan)).refused]
    if not verdicts:
        return ""
    first = verdicts[0]
    others = f" (so would {', '.join(verdict.consumer for verdict in verdicts[1:])})" if verdicts[1:] else ""
    return (
        f"{first.consumer} would refuse these scans{others}: {first.observed} where it allows {first.allowed}. "
        f"{first.cure[:1].upper()}{first.cure[1:]}"
    )
