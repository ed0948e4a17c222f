"""Checks whether consumers would accept the scans of a recording."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

from pc2scan.advice.clocks import Clocks
from pc2scan.advice.survey import Span, Survey
from pc2scan.bags.damage import mention
from pc2scan.bags.observers import Observer
from pc2scan.bags.opening import as_one, open_recordings
from pc2scan.bags.topics import find_topics, unheard
from pc2scan.core.consumers import CONSUMERS
from pc2scan.core.verdicts import OUTCOMES
from pc2scan.errors import DecodeError, TopicError, leading, stamp_text
from pc2scan.messages.clouds import CLOUDS, SCANS
from pc2scan.messages.other_clouds import without
from pc2scan.model import copied_message
from pc2scan.progress import Meter
from pc2scan.result import Part, Result
from pc2scan.text import counted
from pc2scan.transforms.placing import FrameOptions
from pc2scan.transforms.reading import tf_connections
from pc2scan.transforms.robot_model import NO_MODEL

from .scan_frames import Arrivals, ScanFrames, mounting_findings
from .scan_topic import ConsumerCheck, Finding, ScanTopic

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence
    from pathlib import Path

    from pc2scan.bags.damage import Damage
    from pc2scan.bags.reader import Reader
    from pc2scan.core.verdicts import ConsumerScan
    from pc2scan.model import Connection
    from pc2scan.progress import Progress


#: How many frames are shown as text.
_MAX_SHOWN = 5


#: The defects of scans that are of no use, and the consumers to whom they are of none: Nav2 does not match scans, and
#: needs no odometry.
_UNUSABLE: dict[str, frozenset[str]] = {
    **dict.fromkeys(
        ("angles", "full-circle", "moving-frame", "no-returns", "optical-frame", "parts", "static-unheard"),
        frozenset(CONSUMERS),
    ),
    "transforms-late": frozenset({"slam_toolbox"}),
    **dict.fromkeys(
        ("few-directions", "odometry-direction", "stamps-back", "stamps-zero"), frozenset(CONSUMERS) - {"nav2"}
    ),
}


@dataclass(frozen=True, slots=True)
class TopicCheck:
    """The result of one topic.

    Attributes
    ----------
    scans
        How many were decoded.
    frames
        All ``frame_id`` of the scans.
    beams
        The smallest and the largest number of beams.
    interval_ns
        Median of the intervals between stamps, to one percent; None for fewer than two scans.
    first
        The first scan; None without any.
    consumers
        What each consumer does, in the order of `pc2scan.core.consumers.CONSUMERS`; empty without scans.
    findings
        Problems for all consumers, the defects first.
    """

    topic: str
    scans: int
    frames: tuple[str, ...]
    beams: tuple[int, int]
    interval_ns: float | None
    first: ConsumerScan | None
    consumers: tuple[ConsumerCheck, ...]
    findings: tuple[Finding, ...]

    def lines(self, asked: tuple[str, ...]) -> Iterator[str]:
        """Yield the text of a report, with the verdicts of these consumers, or of all."""
        yield f"{leading(self.topic)}: {self._summary()}"
        if self.first is not None:
            scan = self.first
            yield (
                f"  angles {scan.angle_min:.6g} to {scan.angle_max:.6g} rad by {scan.angle_increment:.6g}, "
                f"ranges {scan.range_min:.4g} to {scan.range_max:.4g} m"
            )
        yield ""
        for consumer in self.consumers:
            if not asked or consumer.consumer in asked:
                yield from consumer.lines(self.scans)
        for finding in self.findings:
            since = "" if finding.stamp_ns is None else f" (first at {stamp_text(finding.stamp_ns)})"
            yield f"  {finding.level}: {finding.text}{since}"
            if finding.hint:
                yield f"          {finding.hint}"
        yield ""

    def _summary(self) -> str:
        if not self.scans:
            return "no scans"
        low, high = self.beams
        beams = counted(high, "beam") if low == high else f"{low:,} to {high:,} beams"
        frames = ", ".join(map(repr, self.frames[:_MAX_SHOWN])) + (", ..." if self.frames[_MAX_SHOWN:] else "")
        rate = "" if self.interval_ns is None else f", {1e9 / self.interval_ns:.2f} Hz"
        return f"{counted(self.scans, 'scan')} of {beams}{rate}, in frame {frames}"


@dataclass(frozen=True, slots=True, repr=False)
class Check(Result):
    """The result of checking a recording's scans.

    Attributes
    ----------
    sources
        Paths as they were given.
    asked
        The given consumers; empty means all.
    topics
        One entry for each topic, by name.
    warnings
        Which transforms cannot be used, and why.
    damage
        The damage of the recordings; a defect.
    """

    kind: ClassVar[str] = "check"

    sources: tuple[str, ...]
    asked: tuple[str, ...]
    topics: tuple[TopicCheck, ...]
    warnings: tuple[str, ...] = ()
    damage: tuple[Damage, ...] = ()

    @property
    def counting(self) -> tuple[str, ...]:
        """Consumers whose verdicts count."""
        return self.asked or tuple(CONSUMERS)

    @property
    def accepted(self) -> bool:
        """Whether all consumers that count accept every scan of every topic; False without scans.

        Beams that are shifted, by up to one increment, count only if consumers are given: no scan satisfies both
        slam_toolbox and gmapping, unless it is a full circle.
        """
        taken = ("accepted",) if self.asked else ("accepted", "shifted")
        outcomes = [{each.consumer: each.outcome for each in topic.consumers} for topic in self.topics]
        return all(of_topic.get(consumer) in taken for of_topic in outcomes for consumer in self.counting)

    @property
    def _defects(self) -> list[str]:
        """The kinds of the defects of all topics."""
        return [each.kind for topic in self.topics for each in topic.findings if each.level == "defect"]

    @property
    def unusable(self) -> bool:
        """Whether scans are of no use: empty, parts, in a frame that is no sensor's, or at impossible angles."""
        return any(not _UNUSABLE.get(kind, frozenset()).isdisjoint(self.counting) for kind in self._defects)

    @property
    def defects(self) -> int:
        """How many findings are defects; a damaged recording counts as one."""
        return len(self._defects) + bool(self.damage)

    @property
    def exit_status(self) -> int:
        """0 if the scans are good, 1 if not.

        If consumers are given: 0 if these accept every scan of every topic, and none is `unusable`. Otherwise: 0 if all
        do, and there is no defect.
        """
        return int(not self.accepted or self.unusable or (not self.asked and self.defects > 0))

    def body(self, *, verbose: bool = False) -> Iterator[Part]:
        """Yield the results by topic, and which consumers would not accept what."""
        for topic in self.topics:
            yield from topic.lines(self.asked)
        yield self._conclusion()

    def _conclusion(self) -> str:
        """Return in one line which consumers would not accept what, the worst first."""
        several = len(self.topics) > 1
        refusing: dict[str, dict[str, list[str]]] = {}
        for topic in self.topics:
            outcomes = {consumer.consumer: consumer.outcome for consumer in topic.consumers}
            for consumer in self.counting:
                outcome = outcomes.get(consumer, "nothing to take")
                if outcome != "accepted":
                    refusing.setdefault(outcome, {}).setdefault(topic.topic, []).append(consumer)
        parts = [
            f"{outcome}{f' ({topic})' if several else ''}: {', '.join(consumers)}"
            for outcome in ("nothing to take", *reversed(OUTCOMES))
            for topic, consumers in refusing.get(outcome, {}).items()
        ]
        if self.defects:
            parts.append(counted(self.defects, "defect"))
        if not parts:
            return f"ok: accepted by {', '.join(self.counting)}"
        verdict = "not ok" if self.exit_status else "accepted" if self.defects else "ok"
        return "; ".join((verdict, *parts))

    def __repr__(self) -> str:
        return f"<Check of {', '.join(map(repr, self.sources))}: {self._conclusion()}>"


def check(
    sources: Sequence[Path],
    *,
    consumers: Iterable[str] = (),
    topics: Iterable[str] = (),
    odom_frame: str = "odom",
    base_frame: str = "",
    echo: str = "first",
    frames: FrameOptions | None = None,
    progress: Progress | None = None,
) -> Check:
    """Check what consumers would do with the scans of a recording.

    Parameters
    ----------
    sources
        Recordings; several are read as one.
    consumers
        The consumers that count, of `pc2scan.core.consumers.CONSUMERS`; empty means all, and then defects count, too.
        All are reported in any case.
    topics
        Topics of scans to check; empty means all.
    odom_frame, base_frame
        The frames that scans must be connected with; an empty ``base_frame`` means ``base_link``, or
        ``base_footprint`` if the former does not exist.
    echo
        Which echo of each beam is checked, if there are several: ``first``, ``last`` or ``strongest``.
    frames
        The source of transforms; None: the recording's ``/tf`` and ``/tf_static``.
    progress
        Called regularly; see `pc2scan.progress.Progress`. The messages are scans.

    Raises
    ------
    UsageError
        If there is no such topic, or several namespaces have transforms and none was given.
    RecordingError
        If a source cannot be read.

    Notes
    -----
    The scans are read once, and are not held in memory; the transforms are read before them.
    """
    asked = tuple(dict.fromkeys(consumers))
    options = frames or FrameOptions()
    with ExitStack() as stack:
        readers = open_recordings(sources, stack)
        reader = as_one(readers)
        try:
            chosen = _scan_connections(reader, tuple(topics))
        except TopicError as err:
            mention(reader.damage, err)
            raise
        others = open_recordings(options.tf_from, stack)
        # Consumers know no transforms but those of the recording, and what the user adds.
        known = options if options.model else replace(options, model=NO_MODEL)
        survey = Survey(reader, others, known, Span(None, None, 0))
        clouds = survey.topics(
            each for each in reader.connections if each.ros_type in CLOUDS and each.ros_version
        ).values()
        for facts in clouds:
            facts.ask_samples(moved=True)
        wanted = [each for group in chosen.values() for each in group]
        clocks = Clocks(survey, survey.topics(wanted).values())
        reading = survey.ask_transforms((odom_frame, base_frame), use=False)
        arrivals = Arrivals()
        moving = [each for each in tf_connections(reader.connections, known.tf_topics) if not each.is_static]
        survey.observers.append(Observer(moving, copied_message, keep=arrivals.add))
        meter = None
        if progress is not None:
            meter = Meter(progress)
            meter.following = reader.stored_bytes(wanted)
        survey.read(meter)
        transforms = reading.finish()
        wrong = {name: clock for name, clock in clocks.findings().items() if clock.other}
        read = {
            name: (ScanTopic(), ScanFrames(transforms.buffer, odom_frame, base_frame, wrong.get(name), arrivals))
            for name in chosen
        }
        _read_scans(reader, wanted, read, meter, echo)
        shared = [Finding("static-unheard", "defect", *each) for each in unheard(reader.connections)]
        frames_of_scans = dict.fromkeys(frame for scans, _ in read.values() for frame in scans.frames)
        tilted = mounting_findings(clouds, transforms.buffer, frames_of_scans)
        checked = []
        for name, (scans, places) in read.items():
            own = [tilted[frame] for frame in scans.frames if frame in tilted]
            checked.append(_topic_check(name, scans, places, [*own, *shared]))
        damage = tuple(place for each in (reader, *others) for place in each.damage)
    return Check(tuple(map(str, sources)), asked, tuple(checked), (*transforms.warnings, *transforms.notes), damage)


def _scan_connections(reader: Reader, topics: tuple[str, ...]) -> dict[str, list[Connection]]:
    """Return the connections of the topics to check, by topic."""
    types: dict[str, set[str]] = {}
    scans: dict[str, list[Connection]] = {}
    for connection in reader.connections:
        types.setdefault(connection.topic, set()).add(connection.ros_type)
        if connection.ros_type in SCANS and connection.ros_version is not None:
            scans.setdefault(connection.topic, []).append(connection)
    if not scans:
        if any(connection.ros_type in CLOUDS for connection in reader.connections):
            raise TopicError("the recording has no LaserScan topic", hint="pc2scan convert makes scans of its clouds")
        message, hint = without("LaserScan", reader.connections)
        raise TopicError(message, hint=hint or None)
    asked = (find_topics(topic, types, sorted(scans), *SCANS) for topic in topics)
    names = {name for found in asked for name in found} or scans.keys()
    return {name: scans[name] for name in sorted(names)}


def _read_scans(
    reader: Reader,
    wanted: Sequence[Connection],
    topics: Mapping[str, tuple[ScanTopic, ScanFrames]],
    meter: Meter | None,
    echo: str,
) -> None:
    """Read the scans once, and check them."""
    if meter is not None:
        meter.expect(reader.stored_bytes(wanted))
    for message in reader.messages(wanted, meter=meter):
        if meter is not None:
            meter.messages += 1
        scans, places = topics[message.connection.topic]
        try:
            scan = SCANS[message.connection.ros_type](message.connection.serialization, echo)(message.data)
        except DecodeError as err:
            scans.add_undecodable(message.log_time_ns, err.message)
            continue
        scans.add(scan, message.log_time_ns, places.add(scan.frame_id, scan.stamp_ns, message.log_time_ns))
    if meter is not None:
        meter.finish()


def _topic_check(name: str, scans: ScanTopic, places: ScanFrames, shared: Sequence[Finding]) -> TopicCheck:
    own, missing = list(scans.findings()), list(places.findings(scans.interval_ns)) if scans.scans else []
    if any(each.kind == "clock" for each in missing):
        # This says more than that the stamps are far from the log times.
        own = [each for each in own if each.kind != "stamps-far"]
    return TopicCheck(
        name,
        scans.scans,
        tuple(scans.frames),
        (min(scans.beams, default=0), max(scans.beams, default=0)),
        scans.interval_ns,
        scans.first,
        tuple(scans.consumers()),
        (*shared, *sorted([*own, *missing], key=lambda finding: finding.level)),
    )
