"""What happened to one topic of a conversion, counted while it runs."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, ClassVar

from pc2scan.core.counts import PointCounts

if TYPE_CHECKING:
    from .combine.counts import SourceCounts
    from .combine.rebinning import Rebinning
    from .conversion import ConvertedMessage
    from .options import ScanSpec


@dataclass(slots=True)
class TopicReport:
    """What happened to one topic of the source.

    Attributes
    ----------
    topic, msgtype
        In the source.
    target
        The topic in the destination: the scan's if converted, the same if it passed through, None if it was skipped.
    action
        ``converted``, ``joined`` (its messages are in the scans of another topic), ``passed``, ``re-encoded``,
        ``skipped``, or ``added`` (transforms given by the user or of level frames, and points behind ranges).
    note
        Why it was skipped, or another note; empty otherwise.
    messages_in, messages_out, skipped
        Messages in the source (within ``start`` and ``end``), messages written, and messages that are missing in
        the destination. Messages of a topic that the user dropped are not missing.
    points
        Points of all converted clouds: how many are used, and how many are rejected for which reason.
    empty_scans
        Scans without a single return.
    motions
        One for each deskewed cloud: the largest distance of the sensor from its pose at the scan's time, metres and
        radians, and the longest time between interpolated transforms, seconds.
    tilts
        One for each level scan: the angle between the z axis of the target frame and up, radians.
    joined
        Counts of a topic whose messages become scans together with others; None for all other topics.
    removed_beams
        How many beams had ``returns``, and how many of these are removed: too ``sparse`` for ``min_points`` or ``kth``,
        and by each filter of beams. Empty without any of them.
    rebinned
        Counts of beams, for scans that are made of scans; None for all others.
    clouds_kept
        Whether the converted clouds were written, too.
    lost
        Whether the topic should have been written but cannot be; ``note`` has the reason.
    advice
        Options with heights that suit the clouds, in a level frame; empty if none are needed.
    spec
        The request that the output was made by; None if the topic is not converted.
    """

    json_names: ClassVar[tuple[str, ...]] = (
        *("topic", "msgtype", "target", "action", "note", "messages_in", "messages_out", "skipped", "empty_scans"),
        *("removed_beams", "clouds_kept", "lost", "advice", "scan", "motion", "tilt", "joined", "rebinned", "points"),
    )

    topic: str
    msgtype: str
    target: str | None
    action: str
    note: str = ""
    messages_in: int = 0
    messages_out: int = 0
    skipped: int = 0
    points: PointCounts = field(default_factory=PointCounts)
    empty_scans: int = 0
    motions: list[tuple[float, float, float]] = field(default_factory=list)
    tilts: list[float] = field(default_factory=list)
    joined: SourceCounts | None = None
    removed_beams: dict[str, int] = field(default_factory=dict)
    rebinned: Rebinning | None = None
    clouds_kept: bool = False
    lost: bool = False
    advice: str = ""
    spec: ScanSpec | None = field(default=None, compare=False, repr=False)

    @property
    def scan(self) -> str:
        """The name of its output in a scans file; empty without one."""
        return self.spec.name if self.spec else ""

    @property
    def motion(self) -> dict[str, float] | None:
        """The largest and the median of the motions, and the longest gap; None if nothing was deskewed."""
        if not self.motions:
            return None
        from pc2scan.core.percentiles import median_low  # noqa: PLC0415  # only with deskewing

        metres, radians, gaps = zip(*self.motions, strict=True)
        return {
            "largest_m": max(metres),
            "median_m": median_low(metres),
            "largest_deg": math.degrees(max(radians)),
            "median_deg": math.degrees(median_low(radians)),
            "longest_gap_s": max(gaps),
        }

    @property
    def tilt(self) -> dict[str, float] | None:
        """The largest and the median of the tilts, degrees; None if nothing was made level."""
        if not self.tilts:
            return None
        from pc2scan.core.percentiles import median_low  # noqa: PLC0415  # only where scans are level

        return {
            "largest_deg": math.degrees(max(self.tilts)),
            "median_deg": math.degrees(median_low(self.tilts)),
        }

    def count(self, result: ConvertedMessage) -> None:
        """Count what a message became: its points, the motion of the sensor, and its beams."""
        self.points += result.counts
        self.empty_scans += result.empty
        if result.motion is not None:
            self.motions.append(result.motion)
        if result.level is not None:
            self.tilts.append(result.level.tilt)
        for name, number in (result.removed or {}).items():
            self.removed_beams[name] = self.removed_beams.get(name, 0) + number
        if (more := result.rebinned) is not None:
            known = self.rebinned or (0, 0, 0)
            self.rebinned = type(more)(*(one + other for one, other in zip(known, more, strict=True)))

    def skip(self, count: int) -> None:
        """Count messages of a topic that is not written; they are missing unless the user dropped the topic."""
        self.messages_in += count
        if self.lost:
            self.skipped += count
