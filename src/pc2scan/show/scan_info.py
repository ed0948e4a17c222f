"""The properties of the LaserScans of a topic, from a sample spread over the recording."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from pc2scan.core.verdicts import Outcome, ScanTransforms
from pc2scan.errors import DecodeError, leading
from pc2scan.messages.clouds import SCANS
from pc2scan.text import counted

from .cloud_info import count_range
from .scan_topic import ScanTopic

if TYPE_CHECKING:
    from collections.abc import Iterator

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
        yield ""
        yield "  consumers"
        for outcome in dict.fromkeys(self.consumers.values()):
            yield f"  {outcome:<10}{', '.join(name for name, own in self.consumers.items() if own == outcome)}"
        yield "  pc2scan check explains why, and checks all scans and their transforms"


class ScanLook:
    """Collects the properties of a topic's sampled scans."""

    def __init__(self, topic: str) -> None:
        self._topic = topic
        self._sampled = 0
        self._scans = ScanTopic()
        self._problems: dict[str, None] = {}

    def add(self, message: RawMessage) -> None:
        """Add a scan."""
        self._sampled += 1
        try:
            scan = SCANS[message.connection.ros_type](message.connection.serialization, "first")(message.data)
        except DecodeError as err:
            self._problems[err.message] = None
        else:
            self._scans.add(scan, message.log_time_ns, ScanTransforms())

    def described(self, rate_hz: float | None) -> ScanInfo:
        """Return the properties; ``rate_hz`` is the rate of the topic."""
        scans = self._scans
        return ScanInfo(
            topic=self._topic,
            sampled=self._sampled,
            rate_hz=rate_hz,
            frames=tuple(scans.frames),
            beams=(min(scans.beams, default=0), max(scans.beams, default=0)),
            first=scans.first,
            return_share=scans.ranges["returns"] / max(1, scans.ranges["beams"]),
            consumers={each.consumer: each.outcome for each in scans.consumers()},
            problems=tuple(self._problems),
        )
