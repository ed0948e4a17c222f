"""Inspects a recording: its containers, its topics, and samples of its clouds and scans."""

from __future__ import annotations

import shlex
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np

from pc2scan.advice.checks.plausibility import log_times_of_centuries
from pc2scan.advice.clocks import Clocks
from pc2scan.advice.measurements import increment_warning, time_warnings
from pc2scan.advice.odometry import turns_upright
from pc2scan.advice.survey import SAMPLES, Span, Survey, are_long
from pc2scan.bags.observers import Observer, Spread
from pc2scan.bags.opening import as_one, open_recordings
from pc2scan.bags.topics import by_topic, find_topics, message_counts, types_by_topic
from pc2scan.conversion.corrections import scaled
from pc2scan.core.params import ProjectionParams
from pc2scan.core.scene import CloudSample, far_away
from pc2scan.errors import UsageError, leading
from pc2scan.messages.clouds import CLOUDS, SCANS, usual_topics
from pc2scan.messages.imu import IMU
from pc2scan.messages.other_clouds import instead_of_clouds
from pc2scan.messages.tfmessage import TF_TYPES
from pc2scan.model import copied_message, of_types
from pc2scan.parsing import OF_FRAMES, frames_of
from pc2scan.request.point_time import PointTime
from pc2scan.result import Call, Part, Result
from pc2scan.text import Table, count, counted, height_text, size, stamp
from pc2scan.transforms.buffer import ADDS_ODOMETRY, mount_text
from pc2scan.transforms.frames import BODIES, WORLDS
from pc2scan.transforms.motion import body_in, find_body_motion
from pc2scan.transforms.mounting import unit_warning
from pc2scan.transforms.placing import FrameOptions, Placer

from .lidar import EDGE_NS, HEADERS, POINTS, Lidar, ask_facts, stamp_faults
from .proposals import odometry_doubts, proposals
from .topic_content import CloudInfo, ScanTopic, ShownCloud, TopicCheck, describe_clouds, sample_cloud

if TYPE_CHECKING:
    from collections import Counter
    from collections.abc import Callable, Iterator, Mapping, Sequence
    from pathlib import Path

    from pc2scan.advice.survey import TopicFacts
    from pc2scan.bags.damage import Damage
    from pc2scan.bags.reader import Reader
    from pc2scan.model import Connection, Summary
    from pc2scan.options.call import Options
    from pc2scan.transforms.attitude import UpEstimate
    from pc2scan.transforms.buffer import TransformBuffer
    from pc2scan.transforms.mounting import Mounting
    from pc2scan.transforms.reading import RobotTransforms

#: How many of the first messages of an IMU are read.
_MAX_IMU = 1_000

#: At how many times, spread over the recording like samples of clouds, the motion of the robot is looked at, and in how
#: many of its first seconds.
_MOMENTS = 10
_FIRST = 3

#: How many points are examined, in all clouds together; of larger clouds every second, third, ... point is used.
_MAX_POINTS = 2_000_000


class FileInfo(NamedTuple):
    """One source: its container, and the container's own description."""

    path: str
    container: str
    storage: str
    profile: str
    compression: tuple[str, ...]
    size_bytes: int


class TopicInfo(NamedTuple):
    """One topic and type.

    Attributes
    ----------
    connections
        Publishers: ROS 1 connections, MCAP channels.
    rate_hz
        Messages without the first, divided by the duration of the recording. None for fewer than two.
    """

    topic: str
    msgtype: str
    serialization: str
    messages: int
    rate_hz: float | None
    connections: int
    latched: bool

    @property
    def row(self) -> tuple[str, ...]:
        """What the table has of it."""
        kind = self.msgtype + ("" if self.serialization in ("ros1", "cdr") else f" ({self.serialization})")
        rate = "-" if self.rate_hz is None else f"{self.rate_hz:.2f}"
        return self.topic, kind, count(self.messages), rate, str(self.connections), "latched" if self.latched else ""


@dataclass(frozen=True, slots=True, repr=False)
class Info(Result):
    """The content of a recording of one or several sources.

    Attributes
    ----------
    files
        The sources.
    start_ns, end_ns
        The log times of the first and the last message; None without messages.
    messages
        How many there are, of all topics.
    topics, clouds, scans
        The topics, and what is known about those with clouds and scans.
    proposals
        Conversions that suit the clouds.
    lacking
        What SLAM and navigation need besides the scans, and the recording does not have; empty if nothing is missing.
    warnings
        Which transforms cannot be used if a target frame was given, and clouds that are not level.
    damage
        The damage that was found. If opening the recording finds any, all of it is read and counted.
    """

    kind: ClassVar[str] = "info"
    json_names: ClassVar[tuple[str, ...]] = (
        *("files", "start_ns", "end_ns", "duration_ns", "messages", "topics", "clouds", "scans", "proposals"),
    )

    files: tuple[FileInfo, ...]
    start_ns: int | None
    end_ns: int | None
    messages: int
    topics: tuple[TopicInfo, ...]
    clouds: tuple[CloudInfo, ...] = field(default=())
    scans: tuple[TopicCheck, ...] = field(default=())
    proposals: tuple[Call, ...] = field(default=())
    damage: tuple[Damage, ...] = field(default=())
    warnings: tuple[str, ...] = field(default=())
    lacking: str = ""

    @property
    def duration_ns(self) -> int:
        """Time from the first message's log time to the last's; 0 without messages."""
        return self.end_ns - self.start_ns if self.start_ns is not None and self.end_ns is not None else 0

    @property
    def exit_status(self) -> int:
        """The exit status of the command: 1 if no cloud can be moved into the target frame; 3 if there is damage."""
        if self.clouds and all(cloud.target_frame and cloud.problems and not cloud.limits for cloud in self.clouds):
            return 1
        return 3 if self.damage else 0

    def body(self, *, verbose: bool = False) -> Iterator[Part]:
        """Yield files, times and topics, the clouds and scans of each topic, and conversions that suit them."""
        for file in self.files:
            kind = " ".join(filter(None, (file.container, file.storage, file.profile)))
            yield f"{leading(file.path)}: {kind}, {'+'.join(file.compression) or 'empty'}, {size(file.size_bytes)}"
        if self.start_ns is not None and self.end_ns is not None:
            yield f"from {stamp(self.start_ns)}"
            yield f"to   {stamp(self.end_ns)}"
            yield f"{self.duration_ns / 1e9:.3f} s, {counted(self.messages, 'message')}"
        else:
            yield "no messages"
        yield ""
        columns = ("topic", "type", "messages", "Hz", "publishers", "")
        yield Table(columns, [topic.row for topic in self.topics], left=("topic", "type", ""))
        for cloud in self.clouds:
            yield ""
            yield from cloud.body()
        for scans in self.scans:
            yield ""
            yield from scans.head()
            yield from (text for finding in scans.findings for text in finding.lines())
            for outcome in dict.fromkeys(verdict.outcome for verdict in scans.consumers):
                names = (verdict.consumer for verdict in scans.consumers if verdict.outcome == outcome)
                yield f"  {outcome:<10}{', '.join(names)}"
            yield "  judged by a sample; pc2scan check reads all scans and their transforms, and explains why"
        if self.proposals:
            yield ""
            placed = (cloud.mounting for cloud in self.clouds if cloud.mounting and cloud.mounting.heights)
            yield from (f"{leading(mounting.topic)}: {_ground_text(mounting)}" for mounting in placed)
            for call in self.proposals:
                yield ""
                yield "options, and why:" if len(self.proposals) == 1 else f"options for {_topics_of(call)}, and why:"
                yield from _reasons(call)
            yield ""
            if self.lacking:
                yield self.lacking
                yield ""
            yield "ready to convert:"
            yield from self.proposals


def _topics_of(call: Call) -> str:
    topics = call.options.get("topics", "")
    return leading(topics) if isinstance(topics, str) else ", ".join(map(leading, topics))


def _reasons(call: Call) -> Iterator[str]:
    """Yield a line for each option that has a reason."""
    for name, reason in call.reasons.items():
        value = call.options[name]
        for item in value if isinstance(value, tuple) else (value,):
            shown = f"{item:.15g}" if isinstance(item, float) else shlex.quote(str(item))
            yield f"  `{name}={shown}`: {reason}"


def _ground_text(mounting: Mounting) -> str:
    """Return where floor and ceiling are, as text."""
    ground, heights = mounting.ground, mounting.heights
    if heights is None or heights.floor is None:
        return "no floor found; the heights are those around the sensor"
    frame = mounting.target_frame or mounting.judged_in
    question = f"; {heights.question}" if heights.question else ""
    ceiling = "" if heights.ceiling is None else f", ceiling at {height_text(heights.ceiling)} m"
    is_known = ground.height and mounting.frame.removeprefix("/") not in {*BODIES, *WORLDS}
    sensor = f"; the sensor is {ground.height:.2f} m above the floor" if is_known else ""
    return f"floor at z = {height_text(heights.floor)} m in frame {frame!r}{ceiling}{sensor}{question}"


def info(sources: Sequence[Path], options: Options) -> Info:
    """Inspect a recording; see `pc2scan.info`.

    Parameters
    ----------
    sources
        Recordings; several are read as one.
    options
        The options of the call.
    """
    with ExitStack() as stack:
        return info_of(open_recordings(sources, stack), options, frames_of(options))


def info_of(readers: Sequence[Reader], options: Options, frames: FrameOptions, samples: int = 10) -> Info:
    """Inspect recordings that are open.

    Parameters
    ----------
    readers
        Several are read as one.
    options
        The options of `pc2scan.info`. The proposals have those about frames and the unit of clouds, too.
    frames
        The source of transforms.
    samples
        How many clouds and scans of each topic to read, spread evenly over its time.

    Raises
    ------
    RecordingError
        If a source cannot be read.
    UsageError
        If several namespaces have transforms, and none was given.
    TopicError
        If there is no such topic.
    """
    with ExitStack() as stack:
        reader = scaled(as_one(readers), options.cloud_scale)
        counts, start_ns, end_ns = message_counts(reader)
        recorded = reader.summary._replace(start_ns=start_ns, end_ns=end_ns)
        topics = _topic_infos(reader.connections, counts, start_ns, end_ns)
        given: Mapping[str, Any] = options.among({*OF_FRAMES, "cloud_scale"})
        shown = _described(topics, options.topics, types_by_topic(reader.connections))
        survey = Survey(reader, open_recordings(frames.tf_from, stack), frames, Span(None, None, start_ns or 0))
        surveyed = _SurveyResult(shown, samples, recorded, options.target_frame, survey)
        if options.cloud_scale == 1 and 0 < len(surveyed.clouds) == len(surveyed.unit_warnings):
            # Cameras and lidars count in millimetres; the warning has the other reading.
            given = {**given, "cloud_scale": 0.001}
            surveyed.scale(0.001)
        warnings = [*log_times_of_centuries(reader.summary), *(clock.warning for clock in surveyed.clocks.values())]
        warnings += (*surveyed.unit_warnings, *surveyed.warnings)
        clouds, lidars = list[CloudInfo](), list[Lidar]()
        for topic, own in surveyed.clouds.items():
            mounting, is_own = surveyed.mountings[topic]
            cloud, placed = describe_clouds(topic, own, surveyed.places)
            clouds.append(cloud)
            if not placed or mounting is None:
                warnings.append(f"{topic}: no command is proposed: none of its first clouds can be placed")
                continue
            if mounting.heights is None and cloud.limits and not surveyed.unit_warnings:
                warnings.append(unit_warning(topic, far_away(mounting.samples[0])))
            # Where the robot moves in the frame of these points, its own body is not at one place.
            few = [(own.stamp_ns, own.points[:, :: -(-own.points.shape[1] // POINTS) or 1]) for own in placed if is_own]
            of_robot = recorded, reader.connections, surveyed.known_ns, surveyed.clocks.get(topic), surveyed.ups
            has_zeros = cloud.zero_share > 0 or any(sample.zeros for sample in surveyed.facts[topic].values(SAMPLES))
            lidar = Lidar(surveyed.facts[topic], mounting, surveyed.buffer, few, has_zeros, *of_robot)
            lidars.append(surveyed.on_robot(lidar, warnings))
            clouds[-1] = replace(cloud, mounting=lidars[-1].mounting._replace(samples=()))
        instead = instead_of_clouds(reader.connections)
        if instead and not any(topic.msgtype in {*CLOUDS, *SCANS} for topic in topics):
            warnings.append(f"the recording has no clouds, but {instead[0]}; {instead[1]}")
        # The proposed command has the frame in which recorded transforms make clouds level.
        mountings = [lidar.mounting for lidar in lidars if lidar.mounting.heights]
        warnings += (own.warning for own in mountings if own.warning and (own.static_tf or not own.target_frame))
        warnings += (f"{own.topic}: {own.heights.doubt}" for own in mountings if own.heights and own.heights.doubt)
        warnings += dict.fromkeys(text for cloud in clouds for text in surveyed.moving_frames(cloud.topic))
        warnings += (text for lidar in lidars for text in time_warnings(lidar.facts, PointTime()))
        warnings += (*filter(None, dict.fromkeys(odometry_doubts(lidars))), *reader.remarks)
        # Landmarks and the like are no lidar's, if there is one.
        given = {**given, "odom_topic": surveyed.odometry} if surveyed.odometry else given
        types = {topic.topic: [topic.msgtype] for topic in topics if topic.messages}
        usual = {lidar.topic for lidar in lidars} if options.topics else set(usual_topics(types, (*CLOUDS, *SCANS)))
        calls = proposals([lidar for lidar in lidars if lidar.topic in usual], readers, types, given, warnings)
        periods = {topic.topic: 1e9 / topic.rate_hz if topic.rate_hz else None for topic in shown}
        return Info(
            tuple(map(_file_info, readers)),
            start_ns,
            end_ns,
            sum(counts.values()),
            tuple(topics),
            tuple(clouds),
            tuple(scan.result(topic, periods[topic], scan.undecodable()) for topic, scan in surveyed.scans.items()),
            tuple(calls),
            tuple(reader.damage),
            tuple(warnings),
            "" if frames.adds_poses or frames.tf_from else _lacking(reader, counts, surveyed.odometry),
        )


def _lacking(reader: Reader, counts: Counter[int], odometry: str) -> str:
    """Return what SLAM and navigation need that no messages give; empty if nothing is missing, or a transform."""
    transforms = [tf for tf in of_types(reader.connections, TF_TYPES) if counts[tf.id]]
    lacks = {} if odometry or not all(tf.is_static for tf in transforms) else {"odometry": ADDS_ODOMETRY}
    lacks |= {} if transforms else {"the lidar's mount": "`static_tf` adds the mount"}
    text = f"SLAM and navigation also need {' and '.join(lacks)}, which the recording does not have: "
    return text + ", ".join(lacks.values()) if lacks else ""


class _SurveyResult:
    """What a survey finds that the description and the proposals depend on.

    Parameters
    ----------
    shown
        The topics to describe.
    samples
        How many clouds and scans of each to read.
    recorded
        The recording's extent.
    target_frame
        The frame in which clouds are described; empty for their own.
    survey
        The survey, which is read here.

    Attributes
    ----------
    clouds, scans
        The samples of each topic.
    facts
        The facts of each topic with clouds or scans.
    places
        The frames in which clouds are described.
    buffer
        The transforms; None if there are none.
    odometry
        The topic with poses that says how the robot moves; empty if transforms do, or none does.
    ups
        The direction of up by each IMU that knows it.
    clocks
        What is wrong with the clocks of topics.
    mountings
        Of each topic with clouds, by `mounting`.
    warnings, unit_warnings
        About transforms and stamps, and about units.
    known_ns
        All transforms are known up to the first of these log times, and from the second one on.
    """

    def __init__(
        self, shown: Sequence[TopicInfo], samples: int, recorded: Summary, target_frame: str, survey: Survey
    ) -> None:
        moved, end_ns = bool(target_frame), recorded.end_ns
        self.clouds, self.scans = _sampled(survey, shown, samples, recorded.start_ns, end_ns)
        names = {topic.topic for topic in shown}
        connections = [connection for connection in survey.reader.connections if connection.topic in names]
        clouds = survey.topics(of_types(connections, CLOUDS))
        flat = survey.topics(scan for scan in of_types(connections, SCANS) if scan.topic not in clouds)
        self.facts: Mapping[str, TopicFacts] = {**clouds, **flat}
        for facts in self.facts.values():
            facts.ask_headers(HEADERS)
            # The first clouds may lack transforms.
            facts.ask(replace(SAMPLES, are_enough=are_long) if moved else SAMPLES)
        for facts in clouds.values():
            ask_facts(facts, end_ns or 0)
        clocks = Clocks(survey, of_types(connections, CLOUDS), most=HEADERS)
        imus = {imu.topic for imu in of_types(survey.reader.connections, {IMU}) if clouds}
        readings = {topic: survey.imu(topic, _MAX_IMU) for topic in sorted(imus)}
        is_added = survey.others or survey.frames.adds_poses
        if moved or is_added:
            survey.ask_transforms((target_frame,))
        if of_types(survey.reader.connections, CLOUDS) and not is_added:
            odometry = by_topic(of_types(survey.reader.connections, {"nav_msgs/msg/Odometry"}))
            poses = next(iter(odometry.values())) if len(odometry) == 1 else ()
            survey.ask_robot(_moments(survey.span.first_ns, end_ns) if clouds and end_ns else (), poses)
        survey.read()
        self._robot, self._has_transforms = survey.robot, bool(of_types(survey.reader.connections, TF_TYPES))
        self.buffer: TransformBuffer | None = None
        self.warnings: list[str] = []
        self.odometry = ""
        self.known_ns = end_ns or 0, survey.span.first_ns
        if survey.transforms is not None:
            transforms = survey.transforms.finish()
            self.buffer, self.warnings = transforms.buffer, [*transforms.warnings, *transforms.notes]
        if survey.robot is not None:
            buffer, self.odometry = survey.robot.finish(), survey.robot.odometry
            if survey.transforms is None or self.odometry:
                until_ns = (end_ns or 0) - (0 if survey.robot.is_cut else EDGE_NS)
                self.buffer, self.known_ns = buffer, (survey.span.first_ns + _FIRST * EDGE_NS, until_ns)
        self.clocks = clocks.findings()
        # Only by corrected stamps is it known where the robot was.
        for topic, clock in self.clocks.items():
            self._change(topic, partial(_moved, clock.offset_ns))
        self.warnings += filter(None, (increment_warning(scan) for scan in flat.values()))
        self.warnings += (text for topic_facts in self.facts.values() for text in stamp_faults(topic_facts))
        self.ups: dict[str, UpEstimate] = {}
        for topic, reading in readings.items():
            with suppress(UsageError):
                self.ups[topic] = reading.up()
        buffer = self.buffer if moved else None
        self.places = Placer(target_frame, survey.frames.source_frame, buffer, ProjectionParams().tolerance_ns)
        self.mountings = {topic: self.mounting(topic) for topic in self.clouds}
        # How far a world's origin is from the sensor is not known.
        known = [own for own, _ in self.mountings.values() if own and own.judged_in.removeprefix("/") not in WORLDS]
        self.unit_warnings = [unit_warning(own.topic, far) for own in known if (far := far_away(own.samples[0]))]

    def scale(self, factor: float) -> None:
        """Multiply the coordinates of all clouds."""
        for topic in self.clouds:
            self._change(topic, partial(_scaled, factor))
        self.mountings = {topic: self.mounting(topic) for topic in self.clouds}

    def _change(self, topic: str, change: Callable[[Any], Any]) -> None:
        """Change all that is known of the clouds of a topic."""
        for values in (self.clouds[topic], *(observer.values for observer in self.facts[topic].observers)):
            values[:] = map(change, values)

    def mounting(self, topic: str, up: float = 0.0) -> tuple[Mounting | None, bool]:
        """Return how the clouds of a topic are mounted on the robot, and whether in the frame of their description.

        Clouds are judged in the given frame, unless the robot moves in it. Without one, clouds in a world's frame are
        judged in the robot's, and others in their own.
        """
        facts, target, buffer = self.facts[topic], self.places.target_frame, self.buffer
        own = self._judged(facts, target, up)
        if own is None or buffer is None:
            return own, True
        if target and (moving := find_body_motion(buffer, target, own.frame)):
            return self._judged(facts, moving.body) or own, False
        if not target and facts.frame.removeprefix("/") in WORLDS and (body := body_in(buffer, facts.frame)):
            return self._judged(facts, body), True
        return own, True

    def on_robot(self, lidar: Lidar, warnings: list[str]) -> Lidar:
        """Return a lidar with a place on the robot, upright or upside down as it turns.

        One that no transform has is as if above the robot's frame, looking ahead, and it is warned of.
        """
        own, buffer, frame = lidar.mounting, self.buffer, lidar.mounting.frame.removeprefix("/")
        body = next((name for name in BODIES if buffer is not None and name in buffer.frames), "")
        if buffer is None or self.places.target_frame or lidar.is_registered:
            return lidar
        if not (body and frame) or lidar.transform(body, frame) is not None:
            # Packets show other surroundings each.
            up = turns_upright(lidar.clouds_in(lidar.world)) if lidar.motion(0.1) and not lidar.turn else 0.0
            if up < 0 or (up and own.static_tf):
                return replace(lidar, mounting=self.mounting(lidar.topic, up)[0] or own)
            return lidar
        if self._has_transforms:
            warnings.append(f"{lidar.topic}: no transform connects {frame!r} with {body}: {mount_text(frame, [body])}")
        if self._robot is None or buffer.above(frame):
            return lidar
        placed = self._assumed(lidar, self._robot, body)
        if turns_upright(placed.clouds_in(placed.world)) < 0:
            up = 1.0 if own.ground.kind == "upside-down" else -1.0
            lidar = replace(lidar, mounting=self.mounting(lidar.topic, up)[0] or own)
            placed = self._assumed(lidar, self._robot, body, up)
        return placed

    def _assumed(self, lidar: Lidar, robot: RobotTransforms, body: str, up: float = 1.0) -> Lidar:
        own, height = lidar.mounting, lidar.mounting.ground.height * (not lidar.mounting.static_tf)
        roll = "0" if own.static_tf or up > 0 else "3.1416"
        assumed = f"{body} {own.target_frame or own.frame.removeprefix('/')} 0 0 {height:.3g} {roll} 0 0"
        added = filter(None, (own.static_tf, assumed))
        return replace(lidar, buffer=robot.reading.with_static(added), assumed=assumed)

    def _judged(self, facts: TopicFacts, frame: str, up: float = 0.0) -> Mounting | None:
        places = self.places._replace(target_frame=frame, buffer=self.buffer) if frame else self.places
        own = (places.source_frame or facts.frame).removeprefix("/")
        above = [] if self.buffer is None else self.buffer.above(own)
        body = next((name for name in BODIES if name in above), "")
        # An IMU elsewhere on the robot does not say how the lidar is mounted.
        imus = (imu for imu in self.ups.values() if not body or imu.frame.removeprefix("/") == own)
        ups = (round(imu.z_of(body or own, self.buffer)) for imu in imus)
        return facts.mounting(places, self.buffer, up or next(filter(None, ups), 0))

    def moving_frames(self, topic: str) -> Iterator[str]:
        """Yield a warning for each frame that is given for clouds of a topic, and in which the robot moves."""
        target, own = self.places.target_frame, self.facts[topic].frame
        source = self.places.source_frame.removeprefix("/")
        if self.buffer is None or not own:
            return
        if target and (moving := find_body_motion(self.buffer, target, source or own)) is not None:
            yield moving.of_target(target)
        if source and (moving := find_body_motion(self.buffer, source, own)) is not None:
            yield f"{topic}: {moving.of_source(source, own.removeprefix('/'))}"


def _scaled(factor: float, value: Any) -> Any:
    """Return what is known of a cloud with multiplied coordinates, if it has any."""
    if isinstance(value, CloudSample):
        return replace(value, points=value.points * factor)
    columns = value.points if isinstance(value, ShownCloud) else value
    if isinstance(columns, np.ndarray):
        columns[:3] *= factor
    return value


def _moved(offset_ns: int, value: Any) -> Any:
    """Return what is known of a message with a later stamp, if it has one."""
    if isinstance(value, CloudSample):
        # In place, so that its ground is not found again.
        value.stamp_ns += offset_ns
        return value
    return value._replace(stamp_ns=value.stamp_ns + offset_ns) if hasattr(value, "stamp_ns") else value


def _file_info(reader: Reader) -> FileInfo:
    own = reader.summary
    return FileInfo(str(reader.path), own.container, own.storage, own.profile, own.compression, own.size_bytes)


def _topic_infos(
    connections: Sequence[Connection], counts: Counter[int], start_ns: int | None, end_ns: int | None
) -> list[TopicInfo]:
    groups: dict[tuple[str, str, str], list[Connection]] = {}
    for c in connections:
        groups.setdefault((c.topic, c.ros_type, c.serialization), []).append(c)
    seconds = ((end_ns or 0) - (start_ns or 0)) / 1e9
    topics = []
    for (topic, msgtype, serialization), group in sorted(groups.items()):
        messages = sum(counts[c.id] for c in group)
        rate = (messages - 1) / seconds if messages > 1 and seconds > 0 else None
        is_latched = any(c.latching for c in group)
        topics.append(TopicInfo(topic, msgtype, serialization, messages, rate, len(group), is_latched))
    return topics


def _moments(start_ns: int, end_ns: int) -> list[int]:
    """Return when the motion of the robot is looked at for a second: at the begin, spread, and at the end."""
    spread = [start_ns + (end_ns - start_ns) * number // _MOMENTS for number in range(_MOMENTS)]
    first = [start_ns + number * EDGE_NS for number in range(_FIRST)]
    return [*first, *spread, max(start_ns, end_ns - EDGE_NS + 1)]


def _described(topics: Sequence[TopicInfo], names: Sequence[str], types: dict[str, set[str]]) -> list[TopicInfo]:
    """Return the topics with clouds or scans that names or globs mean; without any, all of them."""
    known = [topic for topic in topics if topic.msgtype in (*CLOUDS, *SCANS) and topic.messages]
    candidates = sorted({topic.topic for topic in known})
    matched = {topic for name in names for topic in find_topics(name, types, candidates, *CLOUDS, *SCANS)}
    return [topic for topic in known if topic.topic in matched] if names else known


def _sampled(
    survey: Survey, topics: Sequence[TopicInfo], samples: int, start_ns: int | None, end_ns: int | None
) -> tuple[dict[str, list[ShownCloud | str]], dict[str, ScanTopic]]:
    """Ask for samples of each topic, spread over the recording; return what collects them.

    A topic with clouds and scans counts as one of clouds.
    """
    clouds: dict[str, list[ShownCloud | str]] = {topic.topic: [] for topic in topics if topic.msgtype in CLOUDS}
    scans = {topic.topic: ScanTopic() for topic in topics if topic.topic not in clouds}
    if not topics or start_ns is None or end_ns is None:
        return {}, {}
    # The points are in memory until all topics have been read: of as many messages as there are, not as were asked for.
    taken = min(samples, max(topic.messages for topic in topics))
    most = _MAX_POINTS // (len(clouds) + len(scans)) // taken + 1
    for topic in (*clouds, *scans):
        kinds = CLOUDS if topic in clouds else SCANS
        own = [source for source in of_types(survey.reader.connections, kinds) if source.topic == topic]
        observer: Observer[Any] = Observer(own, copied_message, start_ns=start_ns, stop_ns=end_ns + 1)
        observer.spread = Spread.of(own, start_ns, end_ns + 1, samples)
        if topic in clouds:
            observer.take, observer.keep = partial(sample_cloud, most), clouds[topic].append
        else:
            observer.keep = scans[topic].read
        survey.observers.append(observer)
    return clouds, scans
