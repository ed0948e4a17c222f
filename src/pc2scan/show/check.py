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
from pc2scan.bags.topics import by_topic, find_topics, types_by_topic, unheard
from pc2scan.core.consumers import CONSUMERS
from pc2scan.core.verdicts import OUTCOMES
from pc2scan.errors import TopicError
from pc2scan.messages.clouds import CLOUDS, SCANS
from pc2scan.messages.other_clouds import without
from pc2scan.model import copied_message
from pc2scan.progress import Meter
from pc2scan.requests import frames_of
from pc2scan.result import Part, Result
from pc2scan.text import counted
from pc2scan.transforms.reading import tf_connections
from pc2scan.transforms.static import RobotModel

from .scan_frames import Arrivals, ScanFrames
from .scan_topic import Finding, ScanTopic

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence
    from pathlib import Path

    from pc2scan.bags.damage import Damage
    from pc2scan.bags.reader import Reader
    from pc2scan.model import Connection
    from pc2scan.options.call import Options
    from pc2scan.progress import Progress

    from .scan_topic import TopicCheck


#: What a consumer does with a topic without scans, and all outcomes, the worst last.
_NOTHING = "nothing to take"
_WORST = (*OUTCOMES, _NOTHING)

#: The defects that make scans useless to consumers, and those who can use them nevertheless: Nav2 does not match scans,
#: and needs no odometry; only slam_toolbox has a queue of one.
_NAV2 = frozenset({"nav2"})
_USEFUL_TO: dict[str, frozenset[str]] = {
    **dict.fromkeys(
        ("angles", "full-circle", "moving-frame", "no-returns", "optical-frame", "parts", "static-unheard"), frozenset()
    ),
    **dict.fromkeys(("odometry-direction", "stamps-back", "stamps-zero"), _NAV2),
    "transforms-late": frozenset(CONSUMERS) - {"slam_toolbox"},
}


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
    def _refused(self) -> list[tuple[str, str, str]]:
        """Outcome, topic and consumer, where a consumer that counts does not accept every scan of a topic."""
        outcomes = {topic.topic: {each.consumer: each.outcome for each in topic.consumers} for topic in self.topics}
        every = [(own.get(name, _NOTHING), topic, name) for topic, own in outcomes.items() for name in self.counting]
        return [each for each in every if each[0] != "accepted"]

    @property
    def _defects(self) -> list[str]:
        """The kinds of all defects."""
        kinds = [each.kind for topic in self.topics for each in topic.findings if each.level == "defect"]
        return [*kinds, *["damage"] * bool(self.damage)]

    @property
    def exit_status(self) -> int:
        """0 if the scans are good, 1 if not.

        If consumers are given: 0 if these accept every scan of every topic, and no defect makes them useless. Otherwise
        0 if all consumers do, and there is no defect; but beams may be shifted by up to one increment, because no scan
        satisfies both slam_toolbox and gmapping, unless it is a full circle.
        """
        refused = any(self.asked or outcome != "shifted" for outcome, _, _ in self._refused)
        useless = any(not _USEFUL_TO[kind].issuperset(self.counting) for kind in self._defects if kind in _USEFUL_TO)
        return int(refused or useless or (not self.asked and bool(self._defects)))

    def body(self, *, verbose: bool = False) -> Iterator[Part]:
        """Yield the results by topic, and which consumers would not accept what."""
        for topic in self.topics:
            yield from topic.lines(self.asked)
        yield self._conclusion()

    def _conclusion(self) -> str:
        """Return in one line which consumers would not accept what, the worst first."""
        refusing: dict[str, list[str]] = {}
        for outcome, topic, consumer in sorted(self._refused, key=lambda each: -_WORST.index(each[0])):
            of = f" ({topic})" if len(self.topics) > 1 else ""
            refusing.setdefault(f"{outcome}{of}: ", []).append(consumer)
        parts = [outcome + ", ".join(consumers) for outcome, consumers in refusing.items()]
        if defects := len(self._defects):
            parts.append(counted(defects, "defect"))
        if not parts:
            return f"ok: accepted by {', '.join(self.counting)}"
        return "; ".join(("not ok" if self.exit_status else "accepted" if defects else "ok", *parts))

    def __repr__(self) -> str:
        return f"<Check of {', '.join(map(repr, self.sources))}: {self._conclusion()}>"


def check(sources: Sequence[Path], options: Options, progress: Progress | None = None) -> Check:
    """Check what consumers would do with the scans of a recording; see `pc2scan.check`.

    Parameters
    ----------
    sources
        Recordings; several are read as one.
    options
        The options of the call.
    progress
        Called regularly; see `pc2scan.progress.Progress`. The messages are scans.

    Notes
    -----
    The scans are read once, and are not held in memory; the transforms are read before them.
    """
    frames = frames_of(options)
    with ExitStack() as stack:
        readers = open_recordings(sources, stack)
        reader = as_one(readers)
        try:
            chosen = scan_connections(reader, options.topics)
        except TopicError as err:
            mention(reader.damage, err)
            raise
        others = open_recordings(frames.tf_from, stack)
        # Consumers know no transforms but those of the recording, and what the user adds.
        known = frames if frames.model else replace(frames, model=RobotModel("", ()))
        survey = Survey(reader, others, known, Span(None, None, 0))
        wanted = [each for group in chosen.values() for each in group]
        clocks = Clocks(survey, survey.topics(wanted).values())
        reading = survey.ask_transforms((options.odom_frame, options.base_frame), use=False)
        arrivals = Arrivals()
        moving = [each for each in tf_connections(reader.connections, known.tf_topics) if not each.is_static]
        survey.observers.append(Observer(moving, copied_message, keep=arrivals.add))
        meter = Meter(progress or (lambda *_: None))
        meter.following = reader.stored_bytes(wanted)
        survey.read(meter)
        transforms = reading.finish()
        wrong = {name: clock for name, clock in clocks.findings().items() if clock.other}
        places = {
            name: ScanFrames(transforms.buffer, options.odom_frame, options.base_frame, wrong.get(name), arrivals)
            for name in chosen
        }
        scans = {name: ScanTopic() for name in chosen}
        meter.expect(reader.stored_bytes(wanted))
        for message in reader.messages(wanted, meter=meter):
            meter.messages += 1
            topic = message.connection.topic
            scans[topic].read(message, options.echo, places[topic].add)
        meter.finish()
        shared = [Finding("static-unheard", "defect", *each) for each in unheard(reader.connections)]
        checked = []
        for name, own in scans.items():
            findings = [*own.findings(), *(places[name].findings(own.interval_ns) if own.scans else ())]
            if any(each.kind == "clock" for each in findings):
                # This says more than that the stamps are far from the log times.
                findings = [each for each in findings if each.kind != "stamps-far"]
            findings.sort(key=lambda finding: finding.level)
            checked.append(own.result(name, own.interval_ns, [*shared, *findings]))
        damage = tuple(place for each in (reader, *others) for place in each.damage)
    warnings = (*transforms.warnings, *transforms.notes)
    return Check(tuple(map(str, sources)), options.consumers, tuple(checked), warnings, damage)


def scan_connections(reader: Reader, topics: Iterable[str]) -> dict[str, list[Connection]]:
    """Return the connections with scans of the given topics, or of all, by topic."""
    types = types_by_topic(reader.connections)
    scans = by_topic(own for own in reader.connections if own.ros_type in SCANS and own.ros_version is not None)
    if not scans:
        if any(connection.ros_type in CLOUDS for connection in reader.connections):
            raise TopicError("the recording has no LaserScan topic", hint="pc2scan convert makes scans of its clouds")
        message, hint = without("LaserScan", reader.connections)
        raise TopicError(message, hint=hint or None)
    topic_lists = (find_topics(topic, types, sorted(scans), *SCANS) for topic in topics)
    names = {name for matched in topic_lists for name in matched} or scans.keys()
    return {name: scans[name] for name in sorted(names)}
