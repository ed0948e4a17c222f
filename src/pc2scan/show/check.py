"""Checks whether consumers would accept the scans of a recording, and find the transforms that they need."""

from __future__ import annotations

import math
from array import array
from bisect import bisect_left
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, ClassVar

from pc2scan.advice.clocks import Clocks
from pc2scan.advice.odometry import OTHER_ODOMETRY, odometry_of
from pc2scan.advice.survey import Span, Survey
from pc2scan.bags.damage import mention
from pc2scan.bags.observers import Observer
from pc2scan.bags.opening import as_one, open_recordings
from pc2scan.bags.topics import by_topic, find_topics, types_by_topic, unheard
from pc2scan.core.consumers import CONSUMERS, OUTCOMES, ScanTransforms
from pc2scan.core.layout import TURN
from pc2scan.errors import DecodeError, TopicError, TransformError
from pc2scan.messages.clouds import CLOUDS, SCANS
from pc2scan.messages.other_clouds import without
from pc2scan.messages.tfmessage import decode_transforms
from pc2scan.model import copied_message
from pc2scan.parsing import frames_of
from pc2scan.progress import Meter
from pc2scan.result import Part, Result
from pc2scan.text import counted
from pc2scan.transforms.buffer import ADDS_ODOMETRY, named_in_namespace, other_odometry
from pc2scan.transforms.frames import BODIES
from pc2scan.transforms.motion import find_body_motion
from pc2scan.transforms.reading import tf_connections
from pc2scan.transforms.static import RobotModel

from .topic_content import Finding, Level, ScanCount, ScanTopic, few_unplaced

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence
    from pathlib import Path

    from pc2scan.advice.clocks import Clock
    from pc2scan.bags.damage import Damage
    from pc2scan.bags.reader import Reader
    from pc2scan.core.rigid import Rigid
    from pc2scan.model import Connection, RawMessage
    from pc2scan.options.call import Options
    from pc2scan.progress import Progress
    from pc2scan.transforms.buffer import TransformBuffer

    from .topic_content import TopicCheck

#: What a consumer does with a topic without scans, and all outcomes, the worst last.
_NOTHING = "nothing to take"
_WORST = (*OUTCOMES, _NOTHING)

#: The defects that make scans useless to consumers, and those who can use them nevertheless: Nav2 does not match scans,
#: and needs no odometry; only slam_toolbox has a queue of one.
_NAV2 = frozenset({"nav2"})
_USEFUL_TO: dict[str, frozenset[str]] = {
    **dict.fromkeys(("moving-frame", "no-returns", "optical-frame", "parts", "static-unheard"), frozenset()),
    **dict.fromkeys(("odometry-direction", "stamps-back", "stamps-zero"), _NAV2),
    "transforms-late": frozenset(CONSUMERS) - {"slam_toolbox"},
}


#: A sensor is tilted if the cosine between its z axis and the robot's is below 1 by this much: 2.6 degrees.
_TILT = 0.001

#: A frame's z axis is not up if the cosine between it and the robot's is below this: 45 degrees and more.
_SIDEWAYS = math.sqrt(0.5)

_HINT = "`pc2scan tf` shows the frames; `tf_from` reads transforms from another recording"


@dataclass(frozen=True, slots=True, repr=False)
class Check(Result):
    """The result of checking a recording's scans.

    Attributes
    ----------
    sources
        Paths as they were given.
    consumers
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
    consumers: tuple[str, ...]
    topics: tuple[TopicCheck, ...]
    warnings: tuple[str, ...] = ()
    damage: tuple[Damage, ...] = ()

    @property
    def counting(self) -> tuple[str, ...]:
        """Consumers whose verdicts count."""
        return self.consumers or tuple(CONSUMERS)

    @property
    def _refused(self) -> list[tuple[str, str, str]]:
        """Outcome, topic and consumer, where a consumer that counts does not accept every scan of a topic."""
        outcomes = {topic.topic: {by.consumer: by.outcome for by in topic.consumers} for topic in self.topics}
        every = [(own.get(name, _NOTHING), topic, name) for topic, own in outcomes.items() for name in self.counting]
        return [outcome for outcome in every if outcome[0] != "accepted"]

    @property
    def _defects(self) -> list[str]:
        """The kinds of all defects."""
        kinds = [finding.kind for topic in self.topics for finding in topic.findings if finding.level == "defect"]
        return [*kinds, *["damage"] * bool(self.damage)]

    @property
    def exit_status(self) -> int:
        """0 if the scans are good, 1 if not.

        If consumers are given: 0 if these accept every scan of every topic, and no defect makes them useless. Otherwise
        0 if all consumers do, and there is no defect; but beams may be shifted by up to one increment, because no scan
        satisfies both slam_toolbox and gmapping, unless it is a full circle.
        """
        refused = any(self.consumers or outcome != "shifted" for outcome, _, _ in self._refused)
        useless = any(not _USEFUL_TO[kind].issuperset(self.counting) for kind in self._defects if kind in _USEFUL_TO)
        return int(refused or useless or (not self.consumers and bool(self._defects)))

    def body(self, *, verbose: bool = False) -> Iterator[Part]:
        """Yield the results by topic, and which consumers would not accept what."""
        for topic in self.topics:
            yield from topic.lines(self.consumers)
        yield self._conclusion()

    def _conclusion(self) -> str:
        """Return in one line which consumers would not accept what, the worst first."""
        refusing: dict[str, list[str]] = {}
        for outcome, topic, consumer in sorted(self._refused, key=lambda outcome: -_WORST.index(outcome[0])):
            of = f" ({topic})" if len(self.topics) > 1 else ""
            refusing.setdefault(f"{outcome}{of}: ", []).append(consumer)
        parts = [outcome + ", ".join(consumers) for outcome, consumers in refusing.items()]
        if defects := len(self._defects):
            parts.append(counted(defects, "defect"))
        if not parts:
            return f"ok: accepted by {', '.join(self.counting)}"
        return "; ".join(("not ok" if self.exit_status else "accepted" if defects else "ok", *parts))


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
        reader = as_one(open_recordings(sources, stack))
        try:
            chosen = scan_connections(reader, options.topics)
        except TopicError as err:
            mention(reader.damage, err)
            raise
        others = open_recordings(frames.tf_from, stack)
        # Consumers know no transforms but those of the recording, and what the user adds.
        known = frames if frames.model else replace(frames, model=RobotModel("", ()))
        survey = Survey(reader, others, known, Span(None, None, 0))
        wanted = [connection for group in chosen.values() for connection in group]
        clocks = Clocks(survey, wanted)
        reading = survey.ask_transforms((options.odom_frame, options.base_frame), use=False)
        arrivals = Arrivals()
        moving = [tf for tf in tf_connections(reader.connections, known.tf_topics) if not tf.is_static]
        survey.observers.append(Observer(moving, copied_message, keep=arrivals.add))
        meter = Meter(progress)
        meter.following = reader.stored_bytes(wanted)
        survey.read(meter)
        transforms = reading.finish()
        own_clocks, frame_names = clocks.findings(), (options.odom_frame, options.base_frame)
        places = {name: ScanFrames(transforms.buffer, *frame_names, own_clocks.get(name), arrivals) for name in chosen}
        scans = {name: ScanTopic() for name in chosen}
        meter.expect(reader.stored_bytes(wanted))
        for message in reader.messages(wanted, meter=meter):
            meter.messages += 1
            topic = message.connection.topic
            scans[topic].read(message, options.echo, places[topic].add)
        meter.finish()
        shared = [Finding("static-unheard", "defect", *texts) for texts in unheard(reader.connections)]
        checked = []
        for name, own in scans.items():
            findings = [*own.findings(), *(places[name].findings(own.interval_ns) if own.scans else ())]
            findings.sort(key=lambda finding: finding.level)
            checked.append(own.result(name, own.interval_ns, [*shared, *findings]))
        damage = tuple(place for recording in (reader, *others) for place in recording.damage)
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


# --- Frames ---


class Arrivals:
    """When transforms were logged: the stamps of each child frame, as far as they advance, and their log times.

    A message filter with a queue of one drops a scan whose transform is behind the next.
    """

    def __init__(self) -> None:
        self._frames: dict[str, tuple[array[int], array[int]]] = {}

    def add(self, message: RawMessage) -> None:
        """Add the transforms of the next message."""
        with suppress(DecodeError):
            for _, child, stamp_ns, *_ in decode_transforms(message.data, message.connection.serialization):
                stamps, logged = self._frames.setdefault(child.removeprefix("/"), (array("q"), array("q")))
                if not stamps or stamp_ns > stamps[-1]:
                    stamps.append(stamp_ns)
                    logged.append(message.log_time_ns)

    def known_ns(self, children: Iterable[str], stamp_ns: int) -> int:
        """Return the log time from which on the transforms of some frames are known at a stamp; 0 without any."""
        latest = 0
        for child in children:
            stamps, logged = self._frames.get(child, ((), ()))
            place = bisect_left(stamps, stamp_ns)
            if place < len(stamps):
                latest = max(latest, logged[place])
        return latest


@dataclass(slots=True)
class _Frame:
    """What is known of the scans in one frame.

    Attributes
    ----------
    scans
        How many there are.
    missing
        Scans without a transform to the odometry, although there are such transforms.
    pose
        The first place on the robot: x, y and yaw.
    moving
        The frames that move between this one and the odometry's.
    """

    scans: int = 0
    missing: ScanCount = field(default_factory=ScanCount)
    pose: tuple[float, float, float] | None = None
    moving: list[str] | None = None


class ScanFrames:
    """The transforms that the scans of one topic need, looked up scan by scan.

    Parameters
    ----------
    buffer
        All transforms of the recording.
    odom_frame
        The frame in which the robot drives.
    base_frame
        The robot's body; empty for the first of `BODIES` that exists.
    clock
        What is wrong with the clock of the scans, compared with that of the transforms or the log; None if nothing is.
    arrivals
        When the transforms were logged.
    """

    def __init__(
        self, buffer: TransformBuffer, odom_frame: str, base_frame: str, clock: Clock | None, arrivals: Arrivals
    ) -> None:
        self._buffer, self._clock, self._arrivals = buffer, clock, arrivals
        self._known = {frame for tree in buffer.trees for frame in tree.frames}
        self._odom = odom_frame.removeprefix("/")
        self._base = base_frame.removeprefix("/") or next((f for f in BODIES if f in self._known), BODIES[0])
        #: Without transforms of the robot, its frame may have another name.
        self._knows_base = bool(base_frame) or not self._known or self._base in self._known
        self._frames: dict[str, _Frame] = {}
        self._looked = 0
        self._tilted, self._sideways, self._late = ScanCount(), ScanCount(), ScanCount()
        self._tilt = 0.0
        #: The last scan: its stamp, and when its transform was known.
        self._waiting = (0, 0)

    def add(self, frame_id: str, stamp_ns: int, log_time_ns: int) -> ScanTransforms:
        """Look up one scan's transforms; scans are added in the order of their log times."""
        name = frame_id.removeprefix("/")
        frame = self._frames.setdefault(name, _Frame())
        frame.scans += 1
        earlier_ns, known_ns = self._waiting
        if known_ns > log_time_ns > 0:
            self._late.add(earlier_ns)
        odometry, no_odometry = self._lookup(name, self._odom, stamp_ns)
        robot, no_robot = self._lookup(name, self._base, stamp_ns)
        if no_odometry is not None and self._odom in self._known:
            frame.missing.add(stamp_ns)
        known_ns = 0
        if odometry is not None:
            if frame.moving is None:
                links = self._buffer.moving_links(self._odom, name)
                frame.moving = [self._buffer.frames[link.child] for link in links]
            known_ns = self._arrivals.known_ns(frame.moving, stamp_ns)
        self._waiting = stamp_ns, known_ns
        up, turned, moved = None, 0.0, 0.0
        if robot is not None:
            up = self._up(robot, stamp_ns)
            if odometry is not None:
                (x, y, _), yaw = robot.translation.tolist(), robot.rpy[2]
                frame.pose = frame.pose or (x, y, yaw)
                turned = math.remainder(yaw - frame.pose[2], TURN)
                moved = math.hypot(x - frame.pose[0], y - frame.pose[1])
        known = robot is not None if robot is not None or self._knows_base else None
        error = no_odometry or (None if known is None else no_robot)
        missing, cure = ("", "") if error is None else (error.message, self._cure(name, error))
        return ScanTransforms(frame_id, odometry is not None, known, up, turned, moved, missing, cure)

    def _lookup(self, frame: str, target: str, stamp_ns: int) -> tuple[Rigid | None, TransformError | None]:
        """Return the transform to a frame at a stamp, or why there is none."""
        try:
            return self._buffer.lookup(target, frame, stamp_ns), None
        except TransformError as err:
            if err.gap_ns:
                # A tolerance places scans, but does not give consumers a transform at their stamps.
                err.hint = self._gap_cure
            return None, err

    def _up(self, base_from_scan: Rigid, stamp_ns: int) -> float:
        """See `ScanTransforms.up`; counts how the sensor is tilted."""
        ahead, left, up = base_from_scan.matrix[:, 2].tolist()
        # A sensor that is upside down is level, too.
        level = min(abs(up), 1.0)
        self._looked += 1
        if level < _SIDEWAYS:
            self._sideways.add(stamp_ns)
        if level < 1 - _TILT:
            self._tilted.add(stamp_ns)
        self._tilt = max(self._tilt, math.degrees(math.acos(level)))
        # Like gmapping, which transforms (0, 0, 1 + the sensor's height) from the robot's frame to the scan's.
        x, y, _ = base_from_scan.translation.tolist()
        return float(up - x * ahead - y * left)

    def _cure(self, frame: str, error: TransformError) -> str:
        """Return what gives scans the transforms that they lack; empty if only recording transforms does."""
        if not self._known:
            return ""
        cures = []
        if frame not in self._known:
            # What the transforms say about the scan's frame alone.
            target = self._base if self._base in self._known else min(self._known)
            hint = (self._lookup(frame, target, 0)[1] or error).hint
            cures.append(f"{hint}; for scans made from clouds, with pc2scan convert")
        if self._odom not in self._known:
            other, none = other_odometry(self._buffer, self._odom), f"no transform moves {self._base}: pc2scan convert"
            cures.append(f"`odom_frame={other}`" if other else f"{none} {ADDS_ODOMETRY}")
        return "; ".join(cures) or error.hint or ""

    @property
    def _gap_cure(self) -> str:
        """What to do if there are no transforms at the time of scans."""
        if self._clock is not None:
            offset = f"`time_offset={self._clock.time_offset}`"
            return f"the clocks differ; pc2scan convert {offset} for scans made from clouds"
        return f"record /tf as long as the scans; pc2scan convert `start` and `end` leave out clouds without; {_HINT}"

    def findings(self, interval_ns: float | None) -> Iterator[Finding]:
        """Yield the problems, given the median interval between scans."""
        if self._clock is not None:
            yield Finding("clock", "notice", self._clock.text, self._gap_cure)
        if self._known and self._base not in self._known:
            namesake = named_in_namespace(self._base, self._known)
            hint = f"`base_frame={namesake}`" if namesake else f"`base_frame` names the right one; {_HINT}"
            roots = ", ".join(root for tree in self._buffer.trees for root in tree.roots)
            text = f"there is no frame {self._base!r} (robot) in the transforms; their roots: {roots}"
            yield Finding("no-robot-frame", "notice", text, hint)
        if fault := odometry_of(self._buffer, self._odom, self._base).fault:
            yield Finding("odometry-direction", "defect", fault, f"pc2scan convert {OTHER_ODOMETRY}")
        for name, frame in self._frames.items():
            # An empty name is reported with the scans themselves.
            if name:
                yield from self._frame_findings(name, frame, interval_ns)
        scans = sum(frame.scans for frame in self._frames.values())
        if self._late.count and not few_unplaced(self._late.count, scans, interval_ns):
            which = f"{self._late.count:,} of {counted(scans, 'scan')}"
            text = f"{which} have their transform to {self._odom!r} logged after the next scan: slam_toolbox drops them"
            level: Level = "defect" if 2 * self._late.count >= scans else "notice"
            hint = "publish the transforms sooner, or give slam_toolbox a larger scan_queue_size"
            yield self._late.finding("transforms-late", level, text, hint)
        hint = "for scans made from clouds: pc2scan convert `target_frame=base_link`; a scan lies in the x-y plane"
        # A tilting lidar points sideways for a moment.
        if 2 * self._sideways.count > self._looked:
            which = counted(self._sideways.count, "scan", "are")
            text = f"{which} in a frame like a camera's: z is {self._tilt:.1f} deg from that of {self._base}"
            yield self._sideways.finding("optical-frame", "defect", text, hint)
        elif self._tilted.count:
            which = counted(self._tilted.count, "scan", "are")
            text = f"{which} tilted against {self._base}, by up to {self._tilt:.1f} deg: 2D SLAM treats them as level"
            yield self._tilted.finding("tilted", "notice", text, hint)

    def _frame_findings(self, name: str, frame: _Frame, interval_ns: float | None) -> Iterator[Finding]:
        if moving := find_body_motion(self._buffer, name, self._base):
            text = f"{moving.body} moves in the scan's frame {name!r} (by {moving.metres:.2f} m)"
            hint = f"for scans made from clouds: pc2scan convert `target_frame={moving.body}`"
            yield Finding("moving-frame", "defect", text, hint, frame.scans)
        missing = frame.missing.count
        if missing and few_unplaced(missing, frame.scans, interval_ns):
            text = f"{missing:,} of {frame.scans:,} scans have no transform from {name!r} to {self._odom!r}"
            hint = f"a few at the beginning and the end are usual, and SLAM drops them; {_HINT}"
            yield frame.missing.finding("no-transform", "notice", f"{text} at their stamp", hint)
