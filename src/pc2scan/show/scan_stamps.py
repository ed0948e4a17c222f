"""Checks the stamps of the scans of one topic: their order, their clocks and their rate."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass

from pc2scan.errors import stamp_text
from pc2scan.text import agreeing, counted

from .findings import Finding, Tally, finding

#: Intervals between stamps are counted in classes with this ratio, 1 %, so that their median needs little memory.
_CLASS = math.log(1.01)

#: An interval that differs from the median by more than this share is reported: scans are missing or repeated.
_STUTTER = 0.5

#: A ``scan_time`` that differs from the median interval by more than this share of it is reported.
_SCAN_TIME = 0.2

#: Stamps and log times farther apart than this, nanoseconds, are reported: the difference is one of clocks, not a
#: delay.
_FAR_NS = 1_000_000_000

#: A stamp that goes back by more than this, nanoseconds, or ahead of the log times by more than this, is of another
#: clock than the one before.
_JUMP_NS = 10_000_000_000

#: Maximum number of clocks that are distinguished on a topic; beyond it, the one unused for longest is dropped.
_MOST_CLOCKS = 8


@dataclass(slots=True)
class _Clock:
    """The last stamp of a clock, and its log time."""

    stamp_ns: int
    log_time_ns: int

    def shows(self, stamp_ns: int, log_time_ns: int) -> bool:
        """Whether a stamp may be this clock's: it has advanced at most as far as the log times."""
        elapsed = max(0, log_time_ns - self.log_time_ns)
        return -_JUMP_NS <= stamp_ns - self.stamp_ns <= elapsed + _JUMP_NS


class ScanStamps:
    """The stamps of the scans of one topic, added in the order of their log times.

    Intervals are those between stamps of one clock: a topic may have two publishers with different clocks, or a clock
    that is set.
    """

    def __init__(self) -> None:
        self._scans = 0
        self._back, self._repeated, self._zero, self._jumps = Tally(), Tally(), Tally(), Tally()
        self._offsets: tuple[int, int] | None = None
        self._last_ns: int | None = None
        # The clocks, the one that was read last in front.
        self._clocks: list[_Clock] = []
        self._farthest = 0
        self._returns = 0
        self._intervals: Counter[int] = Counter()
        self._totals: Counter[int] = Counter()
        self._largest = (0, 0)

    def add(self, stamp_ns: int, log_time_ns: int) -> None:
        """Add the next scan's stamp and log time."""
        self._scans += 1
        if stamp_ns == 0:
            self._zero.add(stamp_ns)
            return
        late = log_time_ns - stamp_ns
        low, high = self._offsets or (late, late)
        self._offsets = min(low, late), max(high, late)
        last, self._last_ns = self._last_ns, stamp_ns
        if last is not None and stamp_ns <= last:
            (self._repeated if stamp_ns == last else self._back).add(stamp_ns)
        self._add_interval(stamp_ns, log_time_ns)

    def _add_interval(self, stamp_ns: int, log_time_ns: int) -> None:
        """Count the time since the last stamp of the same clock."""
        clocks = self._clocks
        place = next((place for place, clock in enumerate(clocks) if clock.shows(stamp_ns, log_time_ns)), None)
        if place != 0 and clocks:
            self._jumps.add(stamp_ns)
            self._farthest = max(self._farthest, abs(stamp_ns - clocks[0].stamp_ns))
        if place is None:
            self._clocks = [_Clock(stamp_ns, log_time_ns), *clocks[: _MOST_CLOCKS - 1]]
            return
        if place:
            self._returns += 1
            clocks.insert(0, clocks.pop(place))
        clock = clocks[0]
        earlier, interval = clock.stamp_ns, stamp_ns - clock.stamp_ns
        clock.stamp_ns, clock.log_time_ns = stamp_ns, log_time_ns
        if interval > 0:
            number = round(math.log(interval) / _CLASS)
            self._intervals[number] += 1
            self._totals[number] += interval
            self._largest = max(self._largest, (interval, earlier))

    @property
    def interval_ns(self) -> float | None:
        """The median of the intervals between stamps of one clock, to one percent; None if there are none."""
        total = sum(self._intervals.values())
        seen = 0
        for number in sorted(self._intervals):
            seen += self._intervals[number]
            if 2 * seen >= total:
                return self._mean(number)
        return None

    def _mean(self, number: int) -> float:
        """Return the mean of the intervals of one class."""
        return self._totals[number] / self._intervals[number]

    def findings(self, scan_time: float) -> list[Finding]:
        """Return the problems, given the ``scan_time`` of the first scan, seconds."""
        found = []
        for kind, tally, verb, what in (
            ("stamps-back", self._back, "have", "a stamp before that of the scan before"),
            ("stamps-repeated", self._repeated, "repeat", "the stamp of the scan before"),
            ("stamps-zero", self._zero, "have", "no stamp (0)"),
        ):
            if tally.count:
                hint = (
                    "SLAM drops or mixes up such scans: a second publisher, or a clock that was set; pc2scan convert "
                    "`stamps=log` takes the log times, with `rebin` for scans of a 2D lidar"
                )
                text = f"{tally.count:,} of {counted(self._scans, 'scan')} {agreeing(tally.count, verb)} {what}"
                found.append(finding(kind, "defect", text, hint, tally))
        if self._jumps.count:
            between = f"between {len(self._clocks)} clocks" if self._returns else "to another time"
            text = (
                f"the stamps jump {counted(self._jumps.count, 'time')} {between}, by up to "
                f"{self._farthest / 1e9:,.3f} s, but the log times do not"
            )
            hint = "a second publisher with another clock, or a clock that was set; the rate is that of each clock"
            found.append(finding("clocks", "notice", text, hint, self._jumps))
        if self._offsets is not None and max(map(abs, self._offsets)) > _FAR_NS:
            side = "after" if sum(self._offsets) >= 0 else "before"
            low, high = sorted(offset / (1e9 if side == "after" else -1e9) for offset in self._offsets)
            found.append(
                Finding(
                    "stamps-far",
                    "notice",
                    f"log times lie {low:,.3f} to {high:,.3f} s {side} the stamps",
                    "transforms are looked up by stamp: they must come from the same clock",
                )
            )
        return found + self._rate_findings(scan_time * 1e9)

    def _rate_findings(self, scan_time_ns: float) -> list[Finding]:
        median = self.interval_ns
        if median is None:
            return []
        found = []
        off = sum(
            count for number, count in self._intervals.items() if abs(self._mean(number) - median) > _STUTTER * median
        )
        if off:
            longest, after = self._largest
            found.append(
                Finding(
                    "rate",
                    "notice",
                    f"the rate stutters: {off} of {sum(self._intervals.values())} intervals are not the usual "
                    f"{median / 1e9:.3f} s; the longest is {longest / 1e9:.3f} s, after {stamp_text(after)}",
                    "scans are missing, or were stamped on arrival",
                    off,
                )
            )
        if scan_time_ns > 0 and abs(scan_time_ns - median) > _SCAN_TIME * median:
            found.append(
                Finding(
                    "scan-time",
                    "notice",
                    f"scan_time is {scan_time_ns / 1e9:.4g} s, but scans come every {median / 1e9:.4g} s",
                    f"pc2scan convert `scan_time={median / 1e9:.3g}`, with `rebin` for scans of a 2D lidar",
                )
            )
        return found
