"""Whether those who read scans would take the ones that a conversion wrote."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pc2scan.core.consumers import CONSUMERS, judge
from pc2scan.messages.consumed import consumed_scan
from pc2scan.messages.laserscan import decode_laserscan

if TYPE_CHECKING:
    from pc2scan.model import Buffer

__all__ = ["refusal"]


def refusal(data: Buffer, serialization: str) -> str:
    """Who would ignore scans like this one, or die of them: a sentence for a warning; empty if nobody.

    Mis-placed beams are left to `pc2scan check`: upstream's own defaults have some in most eyes.

    Parameters
    ----------
    data
        A serialised LaserScan.
    serialization
        ``ros1`` or ``cdr``.
    """
    scan = consumed_scan(decode_laserscan(data, serialization))
    verdicts = [verdict for consumer in CONSUMERS if (verdict := judge(consumer, scan)).refused]
    if not verdicts:
        return ""
    first = verdicts[0]
    others = f" (so would {', '.join(verdict.consumer for verdict in verdicts[1:])})" if verdicts[1:] else ""
    return (
        f"{first.consumer} would refuse these scans{others}: {first.observed} where it allows {first.allowed}. "
        f"{first.cure[:1].upper()}{first.cure[1:]}"
    )
