"""The look ahead: reads the first messages of topics, and the transforms, once for everything that asks for them.

`info`, `check`, conversions and pages ask for the facts that they need, let the recordings be read, and then read the
facts; so they cannot disagree. The subjects' modules say what follows from the facts.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from pc2scan.bags.observers import observe
from pc2scan.bags.topics import by_topic, is_static
from pc2scan.tf.reading import RobotTransforms, TransformReading, tf_connections

from .facts import TopicFacts

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from pc2scan.bags.observers import Observer
    from pc2scan.bags.reader import Reader
    from pc2scan.model import Connection
    from pc2scan.tf.imu import ImuReading
    from pc2scan.tf.placing import FrameOptions

    from .clocks import Delays
    from .items import Span


class Survey:
    """What is asked for of recordings before anything else is done with them.

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
    reader, span
        As given.
    transforms
        All transforms; None if they were not asked for.
    robot
        Those between the robot's frames; None if they were not asked for.
    observers
        Further observers of the sources.
    """

    def __init__(self, reader: Reader, others: Sequence[Reader], frames: FrameOptions, span: Span) -> None:
        self.reader, self.span = reader, span
        self._others, self._frames = others, frames
        self.transforms: TransformReading | None = None
        self.robot: RobotTransforms | None = None
        self.observers: list[Observer[Any]] = []
        self._facts: dict[tuple[int, ...], TopicFacts] = {}
        self._imus: dict[str, ImuReading] = {}
        self._motion: dict[tuple[int, ...], Mapping[str, Observer[Delays]]] = {}

    def ask_transforms(self) -> TransformReading:
        """Ask for all transforms."""
        self.transforms = TransformReading(self._frames)
        return self.transforms

    def ask_robot(self) -> RobotTransforms:
        """Ask for the transforms between the robot's frames."""
        self.robot = RobotTransforms(self.reader, self._frames, self.span.first_ns)
        return self.robot

    def facts(self, connections: Sequence[Connection]) -> TopicFacts:
        """Return the facts about the messages of some connections of one topic."""
        key = tuple(each.id for each in connections)
        if key not in self._facts:
            self._facts[key] = TopicFacts(connections, self.span)
        return self._facts[key]

    def topics(self, connections: Iterable[Connection]) -> dict[str, TopicFacts]:
        """Return the facts about the topics of connections."""
        return {topic: self.facts(own) for topic, own in by_topic(connections).items()}

    def motion(self, *, by_transforms: bool, imu: str = "") -> Mapping[str, Observer[Delays]]:
        """Return the observers of the clocks of what says where the robot was: moving transforms, and an IMU."""
        from .clocks import motion_observers  # noqa: PLC0415  # only where times of several topics are compared

        found: list[Connection] = []
        if by_transforms:
            known = tf_connections(self.reader.connections, self._frames.tf_topics)
            found += (each for each in known if not is_static(each.topic))
        if imu:
            from pc2scan.messages.imu import IMU  # noqa: PLC0415  # few scans are level

            name = imu.strip("/")
            found += (c for c in self.reader.connections if c.ros_type == IMU and c.topic.strip("/") == name)
        key = tuple(each.id for each in found)
        if key not in self._motion:
            self._motion[key] = motion_observers(found, self.span)
        return self._motion[key]

    def imu(self, topic: str, most: int | None = None) -> ImuReading:
        """Return the messages of an IMU: the first ones, or all.

        Raises
        ------
        TopicError
            If there is no such topic.
        """
        if topic not in self._imus:
            from pc2scan.tf.imu import ImuReading  # noqa: PLC0415  # few recordings have one

            self._imus[topic] = ImuReading([self.reader, *self._others], topic, most)
        return self._imus[topic]

    def read(self) -> None:
        """Read the recordings: each once, as far as anything of it is needed.

        Raises
        ------
        RecordingError
            If one cannot be read.
        UsageError
            If it is not clear which transforms to use.
        """
        for reader in (self.reader, *self._others):
            observers: list[Observer[Any]] = []
            if self.transforms is not None:
                observers += self.transforms.observers(reader)
            for imu in self._imus.values():
                observers += imu.observers(reader)
            if reader is self.reader:
                observers += [] if self.robot is None else self.robot.observers
                observers += (each for facts in self._facts.values() for each in facts.observers)
                observers += (each for motion in self._motion.values() for each in motion.values())
                observers += self.observers
            observe(reader, observers)
