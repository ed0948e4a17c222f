"""The look ahead: reads the first messages of topics, and the transforms, once for everything that asks for them.

`info`, `check`, conversions and pages ask for the facts that they need, let the recordings be read, and then read the
facts; so they cannot disagree. A fact that is asked for twice is observed once, and one that is not asked for costs
nothing. The subjects' modules declare the facts (`Fact`), and say what follows from them.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Generic, NamedTuple, TypeVar

from pc2scan.bags.observers import Observer, observe
from pc2scan.bags.topics import by_topic
from pc2scan.core.layout import TURN
from pc2scan.core.percentiles import median_low
from pc2scan.core.points import Points
from pc2scan.core.rigid import Rigid
from pc2scan.core.scene import PARTS, CloudSample, are_enough
from pc2scan.errors import TransformError
from pc2scan.messages.clouds import SCANS, decoded
from pc2scan.transforms.attitude import ImuReading
from pc2scan.transforms.frames import BODIES, WORLDS
from pc2scan.transforms.mounting import mounting
from pc2scan.transforms.reading import RobotTransforms, TransformReading

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable, Iterable, Sequence

    from pc2scan.bags.reader import Reader
    from pc2scan.messages.laserscan import LaserScan
    from pc2scan.model import Connection, RawMessage
    from pc2scan.progress import Meter
    from pc2scan.transforms.buffer import TransformBuffer
    from pc2scan.transforms.mounting import Mounting
    from pc2scan.transforms.placing import FrameOptions, Placement, Placer

#: Clouds that are registered in a world's frame are judged from so far above the robot's frame, metres.
ABOVE_ROBOT = 0.5

#: Transforms begin so much later than clouds, nanoseconds; and how many packets are sampled until then.
_LATE_NS, _MOST_SAMPLES = 1_000_000_000, 400

_Value = TypeVar("_Value")


class Span(NamedTuple):
    """The cut in log times: ``start_ns <= t < stop_ns`` (None: no limit), and its first time."""

    start_ns: int | None
    stop_ns: int | None
    first_ns: int


@dataclass(frozen=True)
class Fact(Generic[_Value]):
    """A value that is taken from each of the first clouds of a topic; whoever requests or reads it shares this.

    Attributes
    ----------
    take
        Returns it, given a cloud and its message, of which it must keep no view. A cloud for which it is None, or
        raises a `MessageError`, is left out.
    most
        For how many clouds it is wanted.
    are_enough
        Whether the values of the first clouds are enough; None: so many clouds are wanted. Facts that differ only in
        this, and in their number, are observed once.
    """

    take: Callable[..., _Value | None]
    most: int = field(compare=False)
    are_enough: Callable[[Sequence[_Value]], bool] | None = field(default=None, compare=False)


def are_long(samples: Sequence[CloudSample]) -> bool:
    """Whether the first clouds show how a sensor is mounted, even if transforms begin later."""
    return len(samples) >= PARTS and abs(samples[-1].stamp_ns - samples[0].stamp_ns) >= _LATE_NS


def _are_enough(samples: Sequence[CloudSample]) -> bool:
    """Whether the first clouds show how a sensor is mounted; those in a world's frame depend on transforms."""
    is_placed = bool(samples) and samples[0].frame_id.removeprefix("/") in WORLDS
    return are_long(samples) if is_placed else are_enough(samples)


#: Samples of points.
SAMPLES = Fact(lambda points, _: CloudSample.of(points), _MOST_SAMPLES, are_enough=_are_enough)


def placed_sample(sample: CloudSample, place: Placement) -> CloudSample:
    """Return a sample in the frame of scans, in which it is judged.

    From where clouds in the robot's frame, or a world's, were seen is not known: from above the robot's origin.
    """
    frame, moved, own = place.frame_id, place.target_from_source, sample.frame_id.removeprefix("/")
    if own in BODIES or (own in WORLDS and moved is not None):
        above = Rigid.from_rpy(0.0, 0.0, 0.0, (0.0, 0.0, ABOVE_ROBOT * (frame.removeprefix("/") in BODIES)))
        points = (sample.points if moved is None else moved.apply(sample.points)) - above.translation
        return replace(sample, judged_in=frame, points=points, transform=above, zeros=0)
    if moved is None:
        # The ground is found once.
        return sample if frame == sample.judged_in else replace(sample, judged_in=frame)
    return replace(sample, judged_in=frame, points=moved.rotation.apply(sample.points), transform=moved)


class Header(NamedTuple):
    """The header of a message with a cloud or a scan, and its times.

    Attributes
    ----------
    log_time_ns, stamp_ns, frame_id
        Its times and its frame.
    fields
        The names of the cloud's fields; empty for a LaserScan.
    increment
        The size of the angle increment of a LaserScan, radians; None for a cloud.
    turn
        The time that a whole turn takes by a LaserScan's ``time_increment``, seconds; 0 for a cloud.
    """

    log_time_ns: int
    stamp_ns: int
    frame_id: str
    fields: tuple[str, ...] = ()
    increment: float | None = None
    turn: float = 0.0


def _header(own: Points | LaserScan, message: RawMessage) -> Header:
    time_ns = message.log_time_ns
    if isinstance(own, Points):
        return Header(time_ns, own.stamp_ns, own.frame_id, tuple(own.fields))
    increment = abs(own.angle_increment)
    turn = abs(own.time_increment) * TURN / increment if increment else 0.0
    return Header(time_ns, own.stamp_ns, own.frame_id, increment=increment, turn=turn)


_HEADERS = Fact(_header, 1)


class TopicFacts:
    """What the first messages of a topic show.

    Parameters
    ----------
    connections
        The connections of one topic, with clouds or LaserScans. LaserScans have only their headers observed.
    span
        The cut.
    """

    def __init__(self, connections: Sequence[Connection], span: Span) -> None:
        self.topic = connections[0].topic
        self.connections = connections
        self._span = span
        self._clouds = [connection for connection in connections if connection.ros_type not in SCANS]
        # By `Fact`.
        self._observers: dict[Hashable, Observer[Any]] = {}

    @property
    def observers(self) -> Sequence[Observer[Any]]:
        """The observers of all requested facts."""
        return [observer for observer in self._observers.values() if observer.connections]

    def ask_headers(self, most: int) -> None:
        """Ask for the headers of so many messages."""
        self._ask(_HEADERS, most, self.connections)

    def ask_last_headers(self, start_ns: int, most: int) -> None:
        """Ask for the headers of so many messages from a log time on."""
        last = Observer(self.connections, _header, most, start_ns, self._span.stop_ns, decoded)
        self._observers["last headers"] = last

    def ask(self, fact: Fact[Any]) -> None:
        """Ask for a fact about the first clouds; its observer begins at the first call."""
        observer = self._ask(fact, fact.most, self._clouds)
        if (are_enough := fact.are_enough) is not None:
            observer.is_needless = lambda: are_enough(observer.values)

    @property
    def headers(self) -> Sequence[Header]:
        """The headers, in the order of log time: as many as any caller of `ask_headers` wants."""
        return self._observers[_HEADERS].values

    @property
    def last_headers(self) -> Sequence[Header]:
        """The headers that `ask_last_headers` asked for."""
        return self._observers["last headers"].values

    @property
    def delay_ns(self) -> int:
        """The median time from the stamps of these messages, one at least, to their log times."""
        return median_low([header.log_time_ns - header.stamp_ns for header in self.headers])

    @property
    def frame(self) -> str:
        """The frame of the first message; empty if there is none."""
        return next((header.frame_id for header in self.headers), "")

    def values(self, fact: Fact[_Value]) -> list[_Value]:
        """Return a fact's values for the first clouds, in the order of log time, and no more than it wants."""
        return self._observers[fact].values[: fact.most]

    def samples(self, placer: Placer) -> list[CloudSample]:
        """Return as many samples as show how the sensor is mounted, in the frames of scans.

        Those that have no place there are left out.
        """
        clouds: list[CloudSample] = []
        for sample in self.values(SAMPLES):
            with suppress(TransformError):
                clouds.append(placed_sample(sample, placer.place(sample.frame_id, sample.stamp_ns)))
            if are_enough(clouds):
                break
        return clouds

    def mounting(self, placer: Placer, buffer: TransformBuffer | None, up: float) -> Mounting | None:
        """Return how the sensor is mounted, and which options suit that; None if no cloud can be judged.

        Parameters
        ----------
        placer
            The frames of the scans.
        buffer
            The robot's transforms; None if there are none.
        up
            How much z points up in the frame of the points by an IMU, -1 to 1; 0: not known.
        """
        clouds = self.samples(placer)
        return mounting(self.topic, placer.source_frame or clouds[0].frame_id, clouds, buffer, up) if clouds else None

    def _ask(self, fact: Fact[Any], most: int, connections: Sequence[Connection]) -> Observer[Any]:
        new = Observer(connections, fact.take, most, self._span.start_ns, self._span.stop_ns, decoded)
        observer = self._observers.setdefault(fact, new)
        observer.most = max(observer.most or 0, most)
        return observer


class Survey:
    """Reads the first messages of recordings once, for everything that needs them before the conversion.

    Parameters
    ----------
    reader
        The sources.
    others
        The recordings of ``tf_from``.
    frames
        The options about transforms.
    span
        The cut. It limits clouds, never transforms.

    Attributes
    ----------
    reader, others, frames, span
        As given.
    transforms
        All transforms; None if they were not requested.
    robot
        The transforms between the robot's frames; None if they were not requested.
    observers
        Further observers of the sources.
    """

    def __init__(self, reader: Reader, others: Sequence[Reader], frames: FrameOptions, span: Span) -> None:
        self.reader, self.span = reader, span
        self.others, self.frames = others, frames
        self.transforms: TransformReading | None = None
        self.robot: RobotTransforms | None = None
        self.observers: list[Observer[Any]] = []
        self._needed: tuple[str, ...] = ()
        self._use = True
        self._facts: dict[tuple[int, ...], TopicFacts] = {}
        self._imus: dict[str, ImuReading] = {}

    def ask_transforms(self, needed: Iterable[str] = (), *, use: bool = True) -> TransformReading:
        """Ask for all transforms.

        Parameters
        ----------
        needed, use
            Frames that are needed; see `TransformReading.supply`.
        """
        self.transforms = TransformReading(self.frames)
        self._needed, self._use = tuple(needed), use
        return self.transforms

    def ask_robot(self, moments: Sequence[int], poses: Sequence[Connection]) -> None:
        """Ask for the transforms between the robot's frames, and for how it moves at some further log times.

        Parameters
        ----------
        moments
            These times.
        poses
            See `RobotTransforms`.
        """
        self.robot = RobotTransforms(self.reader, self.frames, [self.span.first_ns, *moments], poses)

    def facts(self, connections: Sequence[Connection]) -> TopicFacts:
        """Return the facts about the messages of some connections of one topic."""
        key = tuple(connection.id for connection in connections)
        return self._facts.setdefault(key, TopicFacts(connections, self.span))

    def topics(self, connections: Iterable[Connection]) -> dict[str, TopicFacts]:
        """Return the facts about the topics of connections."""
        return {topic: self.facts(own) for topic, own in by_topic(connections).items()}

    def imu(self, topic: str, most: int | None = None) -> ImuReading:
        """Return the messages of an IMU: the first ones, or all.

        Raises
        ------
        TopicError
            If there is no such topic.
        """
        return self._imus.setdefault(topic, ImuReading([self.reader, *self.others], topic, most))

    def read(self, meter: Meter | None = None) -> None:
        """Read the recordings: each once, as far as anything of it is needed.

        A topic with poses that was not asked for is read separately, if only it has a frame that is needed.

        Parameters
        ----------
        meter
            Counts the bytes; None: nothing is reported.

        Raises
        ------
        RecordingError
            If one cannot be read.
        UsageError
            If it is not clear which transforms to use.
        """
        passes: list[tuple[Reader, list[Observer[Any]]]] = []
        for reader in (self.reader, *self.others):
            observers: list[Observer[Any]] = []
            if self.transforms is not None:
                observers += self.transforms.observers(reader, own=reader is self.reader)
            for imu in self._imus.values():
                observers += imu.observers(reader)
            if reader is self.reader:
                observers += [] if self.robot is None else self.robot.observers
                observers += (observer for facts in self._facts.values() for observer in facts.observers)
                observers += self.observers
            passes.append((reader, observers))
        observe(*passes, meter=meter)
        if self.transforms is not None:
            self.transforms.supply(self.reader, self._needed, use=self._use)
