"""Whether those who read scans would take the ones that a conversion wrote."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from pc2scan.core.consumers import CONSUMERS, judge
from pc2scan.messages.consumed import consumed_scan
from pc2scan.messages.laserscan import decode_laserscan

if TYPE_CHECKING:
    from pc2scan.model import Buffer

__all__ = ["refusal"]


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
