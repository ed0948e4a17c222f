"""Clouds at the edges of a recording that no transform places: the cut that leaves them out."""

from __future__ import annotations

from typing import TYPE_CHECKING

from .lidar import EDGE_NS, TOLERANCE

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from pc2scan.advice.survey import Header

    from .lidar import Lidar

#: A cut has so many digits at least: hundredths of a second.
_DIGITS = 2


def edge_cuts(lidars: Sequence[Lidar], fixed: str) -> Iterator[tuple[str, float, str]]:
    """Yield ``start`` or ``end``, seconds, and why, so that the first and last clouds have transforms; or nothing.

    Parameters
    ----------
    lidars
        The topics with clouds that become one scan.
    fixed
        The frame that does not move; empty if there is none.

    Notes
    -----
    A cloud is skipped if there is no transform at its stamp, or at none of its points' times. Clouds that lack
    transforms for longer than `EDGE_NS` are left as they are: they may have transforms that are not known here.
    """
    buffer, (start_ns, end_ns) = lidars[0].buffer, lidars[0].span_ns
    if not fixed or buffer is None:
        return
    tolerance_ns = round(TOLERANCE * 1e9)
    lost: list[list[tuple[int, int]]] = [[], []]
    kept: list[list[int]] = [[], []]
    for lidar in lidars:
        links, (before, after) = buffer.moving_links(fixed, lidar.mounting.frame), lidar.reach
        if not links:
            return
        begin_ns, stop_ns = max(link.first_ns for link in links), min(link.last_ns for link in links)
        for header in lidar.facts.headers:
            if header.stamp_ns + tolerance_ns < begin_ns or _point_ns(header, after) < begin_ns:
                lost[0].append((header.log_time_ns, begin_ns - _point_ns(header, min(before, 0.0))))
            else:
                kept[0].append(header.log_time_ns)
        for header in lidar.facts.last_headers:
            if header.stamp_ns - tolerance_ns > stop_ns or _point_ns(header, before) > stop_ns:
                lost[1].append((header.log_time_ns, _point_ns(header, max(after, 0.0)) - stop_ns))
            else:
                kept[1].append(header.log_time_ns)
    if lost[0]:
        last_ns, by_ns = max(lost[0])[0], max(by for _, by in lost[0])
        later = [time_ns for time_ns in kept[0] if time_ns > last_ns]
        if later and last_ns < start_ns + EDGE_NS:
            seconds = _between(last_ns - start_ns, min(later) - start_ns)
            yield "start", seconds, f"transforms to {fixed} begin {_seconds(by_ns)} after the first cloud"
    if lost[1] and lidars[0].knows_end:
        first_ns, by_ns = min(lost[1])[0], max(by for _, by in lost[1])
        earlier = [time_ns for time_ns in kept[1] if time_ns < first_ns]
        if earlier and first_ns > end_ns - EDGE_NS:
            seconds = _between(max(earlier) - start_ns, first_ns - start_ns)
            yield "end", seconds, f"transforms to {fixed} end {_seconds(by_ns)} before the last cloud"


def _point_ns(header: Header, seconds: float) -> int:
    return header.stamp_ns + round(seconds * 1e9)


def _between(after_ns: int, until_ns: int) -> float:
    """Return a time with few digits that is later than one time, and no later than another, seconds."""
    for digits in range(_DIGITS, 9):
        step_ns: int = 10 ** (9 - digits)
        found_ns = (after_ns // step_ns + 1) * step_ns
        if found_ns <= until_ns:
            return found_ns / 1e9
    return until_ns / 1e9


def _seconds(duration_ns: int) -> str:
    return f"{duration_ns / 1e9:.2g} s"
