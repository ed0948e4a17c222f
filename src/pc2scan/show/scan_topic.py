"""Checks the scans of one topic; keeps only counts and the first scan of each kind."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from pc2scan.core.consumers import CONSUMERS, has_angles, judge
from pc2scan.core.layout import TURN
from pc2scan.core.timing import IN_SECONDS, increment_doubt
from pc2scan.core.verdicts import OUTCOMES, ConsumerScan, Outcome, ScanTransforms, Verdict
from pc2scan.messages.laserscan import scan_for_consumers
from pc2scan.text import agreeing, counted

from .findings import Finding, Tally, few_unplaced, finding
from .scan_filling import ScanFilling
from .scan_stamps import ScanStamps

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pc2scan.messages.laserscan import LaserScan

    from .findings import Level

#: A median range from here on is taken for millimetres: no lidar sees half a kilometre in most directions.
_MILLIMETRES = 500.0

#: Rounding of a driver's ``time_increment``.
_ROUNDING = 1.01


@dataclass(slots=True)
class ConsumerVerdicts:
    """A consumer's verdicts on the scans: the number of each outcome, and its first verdict."""

    counts: Counter[Outcome] = field(default_factory=Counter)
    firsts: dict[Outcome, tuple[Verdict, int]] = field(default_factory=dict)
    unplaced: Tally = field(default_factory=Tally)
    reason: Verdict | None = None

    def add(self, verdict: Verdict, stamp_ns: int) -> None:
        """Count the verdict on one more scan, without considering its transforms."""
        self.counts[verdict.outcome] += 1
        self.firsts.setdefault(verdict.outcome, (verdict, stamp_ns))

    def add_unplaced(self, verdict: Verdict, stamp_ns: int) -> None:
        """Count a scan that is ignored because of its transforms."""
        self.unplaced.add(stamp_ns)
        self.reason = self.reason or verdict

    def worst(self, interval_ns: float | None) -> tuple[Verdict, int, int] | None:
        """Return the worst verdict, the number of scans with it, and the first one's stamp; None without scans.

        A few missing transforms do not count, see `few_unplaced`. Problems of the scans themselves come first.

        Parameters
        ----------
        interval_ns
            The median interval between scans.
        """
        if not self.counts:
            return None
        outcome = max(self.counts, key=OUTCOMES.index)
        verdict, stamp_ns = self.firsts[outcome]
        missing = self.unplaced.count
        if (
            self.reason is not None
            and outcome in {"accepted", "shifted"}
            and not few_unplaced(missing, self.counts.total(), interval_ns)
        ):
            return self.reason, missing, self.unplaced.stamp_ns or 0
        return verdict, self.counts[outcome], stamp_ns


class ScanTopic:
    """The scans of one topic, added in the order of their log times.

    Attributes
    ----------
    scans
        How many were decoded.
    first
        The first of them.
    frames
        All ``frame_id``, with their numbers of scans.
    beams
        All lengths of ``ranges``, with their numbers of scans.
    judged
        The verdicts by consumer.
    """

    def __init__(self) -> None:
        self.scans = 0
        self.first: ConsumerScan | None = None
        self.frames: Counter[str] = Counter()
        self.beams: Counter[int] = Counter()
        self.judged = {consumer: ConsumerVerdicts() for consumer in CONSUMERS}
        self._undecodable = Tally()
        self._reason = ""
        self._first_of: dict[str, ConsumerScan] = {}
        self._kept_of: dict[tuple[str, str], ConsumerScan] = {}
        self._stamps = ScanStamps()
        self._filling = ScanFilling()
        self._empty, self._intensities, self._length = Tally(), Tally(), Tally()
        self._slow, self._no_frame, self._times, self._turned = Tally(), Tally(), Tally(), Tally()
        self._angles = Tally()
        self._at_sensor = 0
        self._spread = (0.0, 0.0, 0.0)
        self._ranges: Counter[str] = Counter()

    def add_undecodable(self, log_time_ns: int, reason: str) -> None:
        """Count a message that cannot be decoded; its log time is used as its stamp."""
        self._undecodable.add(log_time_ns)
        self._reason = self._reason or reason

    def add(self, message: LaserScan, log_time_ns: int, placed: ScanTransforms | None = None) -> None:
        """Add the next scan; without ``placed``, transforms are not considered."""
        stamp_ns = message.stamp_ns
        scan = scan_for_consumers(message)
        self.scans += 1
        if self.first is None:
            self.first, self._spread = scan, _spread(message.ranges)
        self.frames[message.frame_id] += 1
        self.beams[scan.beams] += 1
        first = self._first_of.setdefault(message.frame_id, scan)
        for consumer, judged in self.judged.items():
            key = consumer, message.frame_id
            kept = self._kept_of.get(key)
            verdict = judge(consumer, scan, kept, placed)
            if verdict.unplaced:
                judged.add_unplaced(verdict, stamp_ns)
                verdict = judge(consumer, scan, kept)
            else:
                self._kept_of.setdefault(key, scan)
            judged.add(verdict, stamp_ns)
        self._at_sensor += scan.zero * (scan.range_min <= 0)
        for name in ("beams", "returns", "infinite", "nan", "zero", "short", "long"):
            self._ranges[name] += getattr(scan, name)
        for wrong, tally in (
            (not message.frame_id, self._no_frame),
            (not scan.returns, self._empty),
            (scan.intensities not in (0, scan.beams), self._intensities),
            (scan.beams != first.beams, self._length),
            (not has_angles(scan), self._angles),
            (has_angles(scan) and _turn(scan) > TURN * _ROUNDING, self._turned),
            (scan.time_increment * (scan.beams - 1) > scan.scan_time * _ROUNDING > 0, self._slow),
            (not (0 <= scan.scan_time < math.inf and abs(scan.time_increment) < math.inf), self._times),
        ):
            if wrong:
                tally.add(stamp_ns)
        self._filling.add(message.frame_id, scan, message.ranges, stamp_ns)
        self._stamps.add(stamp_ns, log_time_ns)

    @property
    def interval_ns(self) -> float | None:
        """The median of the intervals between stamps of one clock, to one percent; None if there are none."""
        return self._stamps.interval_ns

    def worst(self, consumer: str) -> tuple[Verdict, int, int] | None:
        """Return a consumer's worst verdict, see `ConsumerVerdicts.worst`."""
        return self.judged[consumer].worst(self.interval_ns)

    def findings(self) -> list[Finding]:
        """Return the problems of the scans, the defects first."""
        found = [
            *self._message_findings(),
            *self._stamps.findings(self.first.scan_time if self.first is not None else 0.0),
            *self._time_findings(),
            *self._filling.findings(),
            *self._range_findings(),
        ]
        return sorted(found, key=lambda finding: finding.level)

    def _message_findings(self) -> list[Finding]:
        found = []
        if self._undecodable.count:
            found.append(
                finding(
                    "undecodable",
                    "defect",
                    f"{counted(self._undecodable.count, 'message')} cannot be read as a scan: {self._reason}",
                    "",
                    self._undecodable,
                )
            )
        elif not self.scans:
            found.append(Finding("no-scans", "defect", "the topic has no messages"))
        if self._no_frame.count:
            found.append(
                finding(
                    "no-frame",
                    "defect",
                    f"{self._of(self._no_frame, 'have')} an empty frame_id",
                    "pc2scan convert `source_frame` names it for scans made from clouds",
                    self._no_frame,
                )
            )
        if len(self.frames) > 1:
            named = ", ".join(repr(name) for name in list(self.frames)[:5])
            found.append(
                Finding(
                    "frames",
                    "notice",
                    f"{len(self.frames)} frames on one topic: {named}",
                    "use a topic for each sensor",
                )
            )
        if self._length.count:
            found.append(
                finding(
                    "length",
                    "defect",
                    f"{self._of(self._length, 'have')} another number of beams than the first: "
                    f"{min(self.beams):,} to {max(self.beams):,}",
                    "pc2scan convert `rebin=True` gives all scans one number of beams",
                    self._length,
                )
            )
        if self._angles.count and self.first is not None:
            first = self.first
            found.append(
                finding(
                    "angles",
                    "defect",
                    f"{self._of(self._angles, 'have')} no angles: angle_min {first.angle_min:.6g}, angle_max "
                    f"{first.angle_max:.6g}, angle_increment {first.angle_increment:.6g} rad for "
                    f"{counted(first.beams, 'beam')}",
                    "beam i is at angle_min + i * angle_increment",
                    self._angles,
                )
            )
        if self._turned.count and self.first is not None:
            found.append(
                finding(
                    "full-circle",
                    "defect",
                    f"{self._of(self._turned, 'cover')} more than a full circle: "
                    f"{counted(self.first.beams, 'beam')} by {math.degrees(self.first.angle_increment):.4g} deg, from "
                    f"angle_min {self.first.angle_min:.6g} to angle_max {self.first.angle_max:.6g} rad",
                    "angles in degrees? At most 2 pi (6.28319 rad) are a circle",
                    self._turned,
                )
            )
        if self._intensities.count:
            found.append(
                finding(
                    "intensities",
                    "defect",
                    f"{self._of(self._intensities, 'have')} intensities, but not one a beam",
                    "write no intensities, or one for every beam",
                    self._intensities,
                )
            )
        return found

    def _time_findings(self) -> list[Finding]:
        found = []
        first, interval_ns, doubt = self.first, self.interval_ns, ""
        if first is not None and interval_ns is not None and has_angles(first) and _turn(first):
            turn = abs(first.time_increment) * (first.beams - 1) / min(1.0, _turn(first) / TURN)
            doubt = increment_doubt(turn, interval_ns / 1e9)
            if doubt:
                hint = f"{IN_SECONDS}; pc2scan convert `rebin=True` writes 0"
                level: Level = "defect" if turn > interval_ns / 1e9 else "notice"
                found.append(Finding("time-increment", level, doubt, hint))
        if self._slow.count and not doubt:
            found.append(
                finding(
                    "time-increment",
                    "notice",
                    f"{self._of(self._slow, 'take')} longer from the first beam to the last (time_increment) than "
                    "from one scan to the next (scan_time)",
                    "time_increment * (beams - 1) should be at most scan_time",
                    self._slow,
                )
            )
        if self._times.count:
            found.append(
                finding(
                    "times",
                    "notice",
                    f"{self._of(self._times, 'have')} a scan_time or time_increment that is not a valid duration",
                    "",
                    self._times,
                )
            )
        return found

    def _range_findings(self) -> list[Finding]:
        found = []
        if self._empty.count:
            every = 2 * self._empty.count > self.scans
            found.append(
                finding(
                    "no-returns",
                    "defect" if every else "notice",
                    f"{self._of(self._empty, 'have')} no return at all",
                    "for scans made from clouds the summary of pc2scan convert names the parameter to blame",
                    self._empty,
                )
            )
        low, middle, high = self._spread
        if middle >= _MILLIMETRES:
            text = f"ranges of the first scan are {low:,.0f} to {high:,.0f} m (median {middle:,.0f} m)"
            hint = "ranges are metres; if the clouds are in millimetres: pc2scan convert `cloud_scale=0.001`"
            found.append(Finding("units", "notice", text, hint))
        total = self._ranges["beams"]
        zero, short = self._ranges["zero"], self._ranges["short"]
        if short:
            found.append(
                Finding(
                    "ranges-short",
                    "notice",
                    f"{_share(short, total)} of the ranges are below range_min"
                    + (f" ({_share(zero, total)} are 0)" if zero else ""),
                    "a beam without a return should be +inf",
                )
            )
        # Zeros that are not below range_min are returns.
        if self._at_sensor:
            found.append(
                Finding(
                    "ranges-zero",
                    "notice",
                    f"{_share(self._at_sensor, total)} of the ranges are 0, and range_min is 0 m or less: consumers "
                    "take them for obstacles at the sensor",
                    "for scans made from clouds: pc2scan convert `range_min=0.1`",
                )
            )
        if long := self._ranges["long"]:
            hint = "no consumer treats them as returns; +inf would be clearer"
            found.append(
                Finding("ranges-long", "notice", f"{_share(long, total)} of the ranges are above range_max", hint)
            )
        if nan := self._ranges["nan"]:
            hint = "NaN means an erroneous measurement; a beam without a return should be +inf"
            found.append(Finding("ranges-nan", "notice", f"{_share(nan, total)} of the ranges are NaN", hint))
        return found

    def _of(self, tally: Tally, verb: str = "") -> str:
        """Return "N of M scans", with the verb in singular or plural."""
        of = f"{tally.count:,} of {counted(self.scans, 'scan')}"
        return f"{of} {agreeing(tally.count, verb)}" if verb else of


def _spread(ranges: NDArray[np.floating[Any]]) -> tuple[float, float, float]:
    """Return the smallest, the median and the largest of the finite ranges; zeros if there are none."""
    found = np.sort(ranges[np.isfinite(ranges)])
    return (float(found[0]), float(found[len(found) // 2]), float(found[-1])) if len(found) else (0.0, 0.0, 0.0)


def _turn(scan: ConsumerScan) -> float:
    """Return the angle from a scan's first beam to its last, or between its advertised angles, radians."""
    return max(abs(scan.angle_max - scan.angle_min), (scan.beams - 1) * abs(scan.angle_increment))


def _share(count: int, total: int) -> str:
    return f"{count / total:.1%}" if count / total >= 0.001 else f"{count:,} of {total:,}"
