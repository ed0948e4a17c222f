"""The report of a conversion, with an entry for each topic: the table, the JSON file and the exit status read it."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar

from pc2scan.bags.formats import FORMATS
from pc2scan.core.rule import REJECTIONS, PointCounts, Rejection
from pc2scan.errors import leading
from pc2scan.options.table import PARAMETERS
from pc2scan.options.values import in_words
from pc2scan.result import Part, Remark, Result, Skipped
from pc2scan.text import Table, count, counted, duration, size

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from pc2scan.bags.damage import Damage
    from pc2scan.errors import Pc2ScanError
    from pc2scan.request.spec import ScanSpec

    from .combine.grouping import SourceCounts
    from .steps import ConvertedMessage


@dataclass(slots=True)
class StampCounts:
    """The stamps of a topic's messages, in the order of the log.

    Attributes
    ----------
    faults
        How many are wrong, by what is wrong with them.
    delay_ns
        The time from the first one to its log time; None without any.
    """

    faults: Counter[str] = field(default_factory=Counter)
    delay_ns: int | None = None
    _last_ns: int = 0

    def add(self, stamp_ns: int, log_time_ns: int) -> None:
        """Count the next stamp."""
        if stamp_ns == 0:
            self.faults["without a stamp (0)"] += 1
            return
        if self.delay_ns is None:
            self.delay_ns = log_time_ns - stamp_ns
        if stamp_ns < self._last_ns:
            self.faults["with a stamp before that of the message before"] += 1
        self._last_ns = stamp_ns

    def texts(self, topic: str) -> list[str]:
        """Return what is wrong with them, and what to do."""
        cure = "SLAM drops or mixes up such scans; `stamps=log` takes the log times"
        return [f"{topic}: {counted(number, 'message')} {what}: {cure}" for what, number in self.faults.items()]


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
    longest_gap_s
        The longest time over which transforms were interpolated to deskew a cloud, seconds.
    joined
        Counts of a topic whose messages become scans together with others; None for all other topics.
    removed_beams
        How many beams had ``returns``, and how many of these are removed: too ``sparse`` for ``min_points`` or
        ``reduce``, and by each filter of beams. Empty without any of them.
    clouds_kept
        Whether the converted clouds were written, too.
    lost
        Whether the topic should have been written but cannot be; ``note`` has the reason.
    advice
        Options with heights that suit the clouds, in a level frame; empty if none are needed.
    scan
        The name of its output in a scans file; empty without one.
    tilts
        One for each level scan: the angle between the z axis of the target frame and up, radians.
    no_returns
        The share of points that are outside the heights, and at (0, 0, 0), as drivers write for no return; of the first
        clouds.
    is_level
        Whether the first clouds have a level floor, and the heights suit it.
    stamps
        The stamps of what was converted.
    spec
        The request that the output was made by; None if the topic is not converted.
    """

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
    longest_gap_s: float = 0.0
    joined: SourceCounts | None = None
    removed_beams: dict[str, int] = field(default_factory=dict)
    clouds_kept: bool = False
    lost: bool = False
    advice: str = ""
    scan: str = ""
    tilts: list[float] = field(default_factory=list, repr=False)
    no_returns: float = field(default=0.0, compare=False, repr=False)
    is_level: bool = field(default=False, compare=False, repr=False)
    stamps: StampCounts = field(default_factory=StampCounts, compare=False, repr=False)
    spec: ScanSpec | None = field(default=None, compare=False, repr=False)

    def count(self, result: ConvertedMessage) -> None:
        """Count what a message became: its points, its frame, and its beams."""
        self.points += result.counts
        self.empty_scans += result.empty
        self.longest_gap_s = max(self.longest_gap_s, result.gap_ns / 1e9)
        if result.level is not None:
            self.tilts.append(result.level.tilt)
        for name, number in (result.removed or {}).items():
            self.removed_beams[name] = self.removed_beams.get(name, 0) + number

    def skip(self, count: int) -> None:
        """Count messages of a topic that is not written; they are missing unless the user dropped the topic."""
        self.messages_in += count
        if self.lost:
            self.skipped += count


@dataclass(slots=True, repr=False)
class Report(Result):
    """The report of a conversion.

    Attributes
    ----------
    sources, destination
        Paths as they were given; empty if the run failed before the destination was known.
    errors
        The error of a run that failed and wrote nothing; empty if it did not fail.
    dry_run
        Whether it was a dry run: counts are those of the index, and points those of the first messages.
    container, ros_version
        Container and ROS version of the destination: ``rosbag1``, ``rosbag2`` or ``mcap``, and 1 or 2; empty and 0 as
        long as they are not known.
    scans
        The request of each output; nearly always there is only one.
    topics
        One entry for each source topic and each topic that it goes to, in the source's order.
    skipped
        The first `MAX_LISTED` messages that were not converted.
    warnings
        Problems that did not stop the conversion.
    notes
        Values that were measured, or chosen by default.
    ways
        What a dry run says of each converted topic: the steps that its messages take, in words.
    damage
        Damaged places in the parts of the sources that were read.
    messages_read
        How many messages of the sources were read, of all topics that are not skipped.
    messages_declared
        How many messages the sources declare, of all topics that are not skipped; None if they do not declare it, or
        if only a part was requested.
    undelivered
        Whether the report's file could not be written; the recording is written nevertheless.
    """

    kind: ClassVar[str] = "report"

    sources: list[str]
    destination: str
    scans: tuple[ScanSpec, ...]
    topics: list[TopicReport] = field(default_factory=list)
    skipped: list[Skipped] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    ways: list[str] = field(default_factory=list)
    damage: list[Damage] = field(default_factory=list)
    messages_read: int = 0
    messages_declared: int | None = None
    undelivered: bool = field(default=False, repr=False)
    errors: list[Pc2ScanError] = field(default_factory=list)
    dry_run: bool = False
    container: str = ""
    ros_version: int = 0
    bytes_read: int = 0
    bytes_written: int = 0
    seconds: float = 0.0

    @property
    def converted(self) -> list[TopicReport]:
        """The topics whose messages became others."""
        return [topic for topic in self.topics if topic.action == "converted"]

    @property
    def skipped_count(self) -> int:
        """How many messages are missing in the destination, in all topics, listed or not."""
        return sum(topic.skipped for topic in self.topics)

    @property
    def exit_status(self) -> int:
        """The exit status of the run.

        0 for success; 4 if the recording is written, but none of its scans has a return; 3 if it is written, but a
        source is damaged, messages are missing in the destination, or the report is not written. If the run failed: the
        status of its error.
        """
        if self.errors:
            return self.errors[0].exit_status
        if self.all_empty:
            return 4
        return 3 if self.damage or self.skipped_count or self.undelivered else 0

    @property
    def all_empty(self) -> bool:
        """Whether messages were converted, and no result has a return or a point."""
        messages = sum(topic.messages_out for topic in self.converted)
        return messages > 0 and sum(topic.empty_scans for topic in self.converted) == messages

    def add(self, warnings: Sequence[str], notes: Sequence[str] = ()) -> None:
        """Add warnings, and notes that it does not have yet."""
        self.warnings += warnings
        self.notes += (note for note in notes if note not in self.notes)

    @property
    def rejections(self) -> dict[str, Rejection]:
        """Why points may be rejected, by the name of the count."""
        further = (rejection for spec in self.scans for rejection in spec.rejections)
        return {rejection.name: rejection for rejection in (*REJECTIONS, *further)}

    def body(self, *, verbose: bool = False) -> Iterator[Part]:
        """Yield the parameters (of a dry run, or if ``verbose``), the topics, the points and the destination."""
        if self.dry_run:
            yield f"dry run, nothing is written: {', '.join(self.sources)}"
            yield ""
        for spec in self.scans if verbose or self.dry_run else ():
            origins = {name: spec.origins.get(name, "default") for name in PARAMETERS}
            rows = [
                (name, in_words(getattr(spec.params, name)), origin)
                for name, origin in origins.items()
                if verbose or origin != "default"
            ]
            if spec.name and rows:
                yield f"{leading(spec.name)}:"
            if rows:
                yield Table(("parameter", "value", "from"), rows, left=("parameter", "from"))
                yield ""
        yield from [*self.ways, ""] if self.ways else ()
        yield self._topics()
        if converted := self.converted:
            yield ""
            yield self._points(converted)
        yield ""
        written, read = size(self.bytes_written), size(self.bytes_read)
        place = leading(self.destination)
        if self.dry_run:
            kind = FORMATS[self.container].readable
            yield f"{place}: {kind}, which can be written; from {read}; points: those of the first messages"
        else:
            yield f"{place}: {written} from {read} in {duration(self.seconds)}"
        if self.container == "mcap":
            # The file's name does not say which ROS version it is for.
            hint = ": `profile=ros2` for ros2 tools" if converted and self.ros_version == 1 else ""
            yield f"MCAP, ROS {self.ros_version} profile{hint}"

    def _topics(self) -> Table:
        """Return what happened to each topic."""
        rows = [
            (
                topic.topic,
                topic.target or "-",
                *map(count, (topic.messages_in, topic.messages_out, topic.skipped)),
                topic.action + " (cloud kept)" * topic.clouds_kept + (topic.note and f": {topic.note}"),
            )
            for topic in self.topics
        ]
        return Table(("topic", "to", "in", "out", "skipped", "what"), rows, left=("topic", "to", "what"))

    def _points(self, converted: Sequence[TopicReport]) -> Table:
        """Return how many points of each topic are used, and why the others are not."""
        reasons = self.rejections.values()
        rows = [
            (
                topic.target or "-",
                *map(count, (topic.points.total, topic.points.used)),
                *(count(topic.points.rejected.get(reason.name, 0)) for reason in reasons),
                count(topic.empty_scans),
            )
            for topic in converted
        ]
        headings = (reason.title or reason.name.replace("_", " ") for reason in reasons)
        columns = ("on", "points", "used", *headings, "empty")
        return Table(columns, rows, left=("on",))

    def remarks(self, *, verbose: bool = False, **_: Any) -> Iterator[Remark]:
        """Yield skipped messages, damage and what was recovered, and warnings."""
        # Topics that are skipped completely have their own warning.
        total = sum(topic.skipped for topic in self.topics if topic.action != "skipped")
        yield from Result.remarks(self, verbose=verbose, total=total)
        if self.damage:
            declared, recovered = self.messages_declared, counted(self.messages_read, "message")
            if declared is not None and declared > self.messages_read:
                recovered = f"{self.messages_read:,} of the {declared:,} messages that the source declares"
            if not (self.skipped_count or any(place.loses for place in self.damage)):
                recovered += "; nothing is known to be lost"
            yield Remark("recovered", recovered)
