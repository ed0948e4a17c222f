"""The properties of the LaserScans of a topic, from a sample spread over the recording."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pc2scan.core.consumers import CONSUMERS, judge
from pc2scan.core.verdicts import OUTCOMES, Outcome, are_returns
from pc2scan.errors import DecodeError, leading
from pc2scan.messages.clouds import SCANS
from pc2scan.messages.laserscan import scan_for_consumers
from pc2scan.text import counted

from .spread import Spread, count_range, spread_of, spread_table

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from pc2scan.core.verdicts import ConsumerScan
    from pc2scan.model import RawMessage
    from pc2scan.result import Part


@dataclass(frozen=True, slots=True, kw_only=True)
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
    beams
        The smallest and the largest length of ``ranges``.
    first
        The first of these scans; None without any.
    return_share
        Share of the ranges that are returns.
    range
        Spread of the returns.
    consumers
        The worst outcome for each consumer, without considering transforms: see `pc2scan.core.consumers`.
    problems
        Why sampled scans cannot be decoded, each reason once.
    """

    topic: str
    sampled: int
    rate_hz: float | None
    frames: tuple[str, ...]
    beams: tuple[int, int]
    first: ConsumerScan | None
    return_share: float
    range: Spread | None
    consumers: dict[str, Outcome]
    problems: tuple[str, ...]

    def body(self) -> Iterator[Part]:
        """Yield the parts of `Info` about the scans."""
        rate = "" if self.rate_hz is None else f", {self.rate_hz:.2f} Hz"
        yield f"{leading(self.topic)}: {counted(self.sampled, 'scan')} sampled{rate}"
        for problem in self.problems:
            yield f"  cannot be decoded: {problem}"
        scan = self.first
        if scan is None:
            return
        low, high, step = (math.degrees(angle) for angle in (scan.angle_min, scan.angle_max, scan.angle_increment))
        yield f"  frame   {', '.join(map(repr, self.frames))}"
        yield f"  beams   {count_range(*self.beams)}, {low:.2f} to {high:.2f} deg by {step:.4f} deg"
        yield f"          ({scan.angle_min:.6g} to {scan.angle_max:.6g} rad by {scan.angle_increment:.6g})"
        yield (
            f"  limits  {scan.range_min:.4g} to {scan.range_max:.4g} m; scan_time {scan.scan_time:.4g} s, "
            f"time_increment {scan.time_increment:.4g} s"
        )
        yield f"  returns {self.return_share:.1%} of the beams; {'with' if scan.intensities else 'no'} intensities"
        if self.range is not None:
            yield ""
            yield spread_table({"range": self.range})
        yield ""
        yield "  consumers"
        for outcome in dict.fromkeys(self.consumers.values()):
            yield f"  {outcome:<10}{', '.join(name for name, own in self.consumers.items() if own == outcome)}"
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
        self._returns: list[NDArray[np.float32]] = [np.empty(0, np.float32)]
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
        self._returns.append(ranges[are_returns(ranges, scan.range_min, scan.range_max)])

    def described(self, rate_hz: float | None) -> ScanInfo:
        """Return the properties; ``rate_hz`` is the rate of the topic."""
        beams = [scan.beams for scan in self._scans]
        return ScanInfo(
            topic=self._topic,
            sampled=self._sampled,
            rate_hz=rate_hz,
            frames=tuple(self._first_of),
            beams=(min(beams, default=0), max(beams, default=0)),
            first=self._scans[0] if self._scans else None,
            return_share=sum(scan.returns for scan in self._scans) / max(1, sum(beams)),
            range=spread_of(np.concatenate(self._returns, dtype=np.float64)),
            consumers=self._worst,
            problems=tuple(self._problems),
        )
