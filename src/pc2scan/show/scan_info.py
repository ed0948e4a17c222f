"""The properties of the LaserScans of a topic, from a sample spread over the recording."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from pc2scan.core.consumers import CONSUMERS, judge
from pc2scan.core.verdicts import OUTCOMES, Outcome
from pc2scan.errors import DecodeError, leading
from pc2scan.messages.clouds import SCANS
from pc2scan.messages.laserscan import scan_for_consumers
from pc2scan.text import agreeing, counted

from .spread import Spread, count_range, spread_of, spread_table

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from pc2scan.core.verdicts import ConsumerScan
    from pc2scan.model import RawMessage
    from pc2scan.result import Part


@dataclass(frozen=True, slots=True)
class ScanInfo:
    """The properties of the scans of one topic, from a sample spread over the recording.

    Attributes
    ----------
    sampled
        How many scans were read.
    rate_hz
        Messages without the first, divided by the duration of the recording; None for fewer than two.
    frames
        All ``frame_id`` of these scans.
    beams_min, beams_max
        Lengths of ``ranges``.
    angle_min, angle_max, angle_increment, range_min, range_max, scan_time, time_increment
        Values of the first of these scans, as in the message: radians, metres and seconds. None without any.
    intensities
        Whether the first scan has any.
    return_share, infinite_share, nan_share, short_share, long_share
        Shares of the ranges that are within the limits, +inf, NaN, below ``range_min``, and finite above ``range_max``.
    range
        Spread of the ranges that are within the limits.
    empty
        How many scans have no return.
    consumers
        The worst outcome for each consumer, without considering transforms: see `pc2scan.core.consumers`.
    problems
        Why sampled scans cannot be decoded, each reason once.
    """

    topic: str
    sampled: int = 0
    rate_hz: float | None = None
    frames: tuple[str, ...] = ()
    beams_min: int = 0
    beams_max: int = 0
    angle_min: float | None = None
    angle_max: float | None = None
    angle_increment: float | None = None
    range_min: float | None = None
    range_max: float | None = None
    scan_time: float | None = None
    time_increment: float | None = None
    intensities: bool = False
    return_share: float = 0.0
    infinite_share: float = 0.0
    nan_share: float = 0.0
    short_share: float = 0.0
    long_share: float = 0.0
    range: Spread | None = None
    empty: int = 0
    consumers: dict[str, Outcome] = field(default_factory=dict)
    problems: tuple[str, ...] = ()

    def body(self) -> Iterator[Part]:
        """Yield the parts of `Info` about the scans."""
        rate = "" if self.rate_hz is None else f", {self.rate_hz:.2f} Hz"
        yield f"{leading(self.topic)}: {counted(self.sampled, 'scan')} sampled{rate}"
        for problem in self.problems:
            yield f"  cannot be decoded: {problem}"
        if self.angle_min is None or self.angle_max is None or self.angle_increment is None:
            return
        degrees = [math.degrees(angle) for angle in (self.angle_min, self.angle_max, self.angle_increment)]
        yield f"  frame   {', '.join(repr(frame) for frame in self.frames)}"
        beams = count_range(self.beams_min, self.beams_max)
        yield f"  beams   {beams}, {degrees[0]:.2f} to {degrees[1]:.2f} deg by {degrees[2]:.4f} deg"
        yield f"          ({self.angle_min:.6g} to {self.angle_max:.6g} rad by {self.angle_increment:.6g})"
        yield (
            f"  limits  {self.range_min:.4g} to {self.range_max:.4g} m; scan_time {self.scan_time:.4g} s, "
            f"time_increment {self.time_increment:.4g} s"
        )
        empty = (
            f"; {self.empty} of {counted(self.sampled, 'scan')} {agreeing(self.empty, 'have')} none"
            if self.empty
            else ""
        )
        yield (
            f"  returns {self.return_share:.1%} of the beams{empty}; {'with' if self.intensities else 'no'} intensities"
        )
        others = [
            (self.infinite_share, "inf"),
            (self.nan_share, "NaN"),
            (self.short_share, "below range_min"),
            (self.long_share, "above range_max"),
        ]
        if any(share for share, _ in others):
            yield "          " + ", ".join(f"{name} {share:.1%}" for share, name in others if share)
        if self.range is not None:
            yield ""
            yield spread_table({"range": self.range})
        outcomes: dict[str, list[str]] = {}
        for consumer, outcome in self.consumers.items():
            outcomes.setdefault(outcome, []).append(consumer)
        yield ""
        yield "  consumers"
        for name, consumers in outcomes.items():
            yield f"  {name:<10}{', '.join(consumers)}"
        yield "  pc2scan check explains why, and checks all scans and their transforms"


class ScanLook:
    """Collects the properties of a topic's sampled scans.

    Parameters
    ----------
    topic
        The topic's name.
    most
        How many ranges of a scan are used; of longer scans every second, third, ... range is used.
    """

    def __init__(self, topic: str, most: int) -> None:
        self._topic = topic
        self._most = most
        self._sampled = 0
        self._scans: list[ConsumerScan] = []
        self._first_of: dict[str, ConsumerScan] = {}
        self._worst: dict[str, Outcome] = {}
        self._returns: list[NDArray[np.float32]] = []
        self._problems: dict[str, None] = {}

    def add(self, message: RawMessage) -> None:
        """Add a scan."""
        self._sampled += 1
        try:
            decoded = SCANS[message.connection.ros_type](message.connection.serialization, "first")(message.data)
        except DecodeError as err:
            self._problems[err.message] = None
            return
        scan = scan_for_consumers(decoded)
        self._scans.append(scan)
        first = self._first_of.setdefault(decoded.frame_id, scan)
        for consumer in CONSUMERS:
            outcome = judge(consumer, scan, None if scan is first else first).outcome
            self._worst[consumer] = max(outcome, self._worst.get(consumer, outcome), key=OUTCOMES.index)
        ranges = decoded.ranges[:: -(-len(decoded.ranges) // self._most) or 1]
        low, high = np.float32(scan.range_min), np.float32(scan.range_max)
        self._returns.append(ranges[(ranges >= low) & (ranges <= high) & (ranges < np.inf)].copy())

    def described(self, rate_hz: float | None) -> ScanInfo:
        """Return the properties; ``rate_hz`` is the rate of the topic."""
        problems = tuple(self._problems)
        if not self._scans:
            return ScanInfo(self._topic, self._sampled, rate_hz, problems=problems)
        first = self._scans[0]
        beams = [scan.beams for scan in self._scans]
        total = max(1, sum(beams))
        return ScanInfo(
            self._topic,
            sampled=self._sampled,
            rate_hz=rate_hz,
            frames=tuple(self._first_of),
            beams_min=min(beams),
            beams_max=max(beams),
            angle_min=first.angle_min,
            angle_max=first.angle_max,
            angle_increment=first.angle_increment,
            range_min=first.range_min,
            range_max=first.range_max,
            scan_time=first.scan_time,
            time_increment=first.time_increment,
            intensities=first.intensities > 0,
            return_share=sum(scan.returns for scan in self._scans) / total,
            infinite_share=sum(scan.infinite for scan in self._scans) / total,
            nan_share=sum(scan.nan for scan in self._scans) / total,
            short_share=sum(scan.short for scan in self._scans) / total,
            long_share=sum(scan.long for scan in self._scans) / total,
            range=spread_of(np.concatenate(self._returns, dtype=np.float64)),
            empty=sum(not scan.returns for scan in self._scans),
            consumers=self._worst,
            problems=problems,
        )
