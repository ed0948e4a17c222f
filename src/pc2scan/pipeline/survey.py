"""The look ahead of a conversion: reads the first messages, and all transforms, once for everything that needs them.

What an output needs is a list of observers, which the modules of the subjects make; the same modules draw facts, notes
and warnings from what was observed.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

from pc2scan.bags.observers import observe
from pc2scan.bags.topics import is_static
from pc2scan.tf.placing import FrameOptions, Placer
from pc2scan.tf.reading import RobotTransforms, TransformReading, tf_connections

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Mapping, Sequence

    from pc2scan.bags.observers import Observer
    from pc2scan.bags.reader import Reader
    from pc2scan.model import Connection
    from pc2scan.tf.clocks import Delays
    from pc2scan.tf.imu import ImuReading, ImuRequest, UpEstimate

    from .combine.measurements import CombinationObservers
    from .items import Span
    from .measurements import FirstCloud
    from .options import ScanSpec
    from .plan import Combination, Plan
    from .point_times import PointTimes
    from .stages.turn import TurnSample


class DeskewObservers(NamedTuple):
    """Observers of the times of points, or of the lidars' turns, by topic."""

    times: Mapping[str, Observer[PointTimes | None]]
    turns: Mapping[str, Observer[TurnSample]]


@dataclass(slots=True)
class OutputObservers:
    """What one output needs of the first messages; None and empty if it does not need it.

    Attributes
    ----------
    delays
        Delays from stamps to log times, by topic: of its sources, and of what says where the robot was.
    frame
        The frame of its first message.
    clouds
        The first clouds of each topic.
    deskew
        The times of points: for scans of one message (None), and for each combination.
    combinations
        The first messages of topics that become scans together.
    """

    delays: tuple[Mapping[str, Observer[Delays]], Mapping[str, Observer[Delays]]] | None = None
    frame: Observer[str] | None = None
    clouds: Mapping[str, Observer[FirstCloud]] = field(default_factory=dict)
    deskew: dict[Combination | None, DeskewObservers] = field(default_factory=dict)
    combinations: dict[Combination, CombinationObservers] = field(default_factory=dict)

    @property
    def all(self) -> list[Observer[Any]]:
        """All observers."""
        found: list[Observer[Any]] = [each for delays in self.delays or () for each in delays.values()]
        found += [] if self.frame is None else [self.frame]
        found += self.clouds.values()
        found += (each for pair in self.deskew.values() for observers in pair for each in observers.values())
        found += (each for joint in self.combinations.values() for each in joint.all)
        return found


class Survey:
    """What the outputs of a run need of the first messages and of the transforms, as it was recorded.

    Parameters
    ----------
    reader
        The sources.
    others
        The recordings of ``tf_from``.
    plan
        The plan of the conversion.
    asked
        The options about transforms.
    span
        The cut. It limits clouds, never transforms.
    reads_transforms
        Whether all transforms are read.

    Attributes
    ----------
    transforms
        All transforms; None if they are not needed.
    robot
        Those between the robot's frames, if not all transforms are read.
    given_frames
        The frames of the first messages, if the user gives frames.
    outputs
        For each output that makes scans.

    Raises
    ------
    UsageError
        If it is not clear which transforms to use, or an IMU does not exist.
    """

    def __init__(
        self,
        reader: Reader,
        others: Sequence[Reader],
        plan: Plan,
        asked: FrameOptions,
        span: Span,
        *,
        reads_transforms: bool,
    ) -> None:
        self._readers = [reader, *others]
        self._span = span
        self._specs = plan.specs
        self.transforms = TransformReading(asked) if reads_transforms else None
        self.robot = None if reads_transforms else RobotTransforms(reader, asked, span.first_ns)
        self.given_frames: list[Observer[str]] = []
        if asked.static or asked.source_frame:
            from .frame_checks import frame_observer  # noqa: PLC0415  # few conversions add frames

            self.given_frames = [frame_observer([route.connection], span) for route in plan.routes if route.tasks]
        #: The delays from the stamps of the sources to their log times, if a trajectory has to fit to them.
        self.stamps: dict[str, Observer[Delays]] = {}
        if asked.trajectory is not None:
            from pc2scan.tf.clocks import delay_observers  # noqa: PLC0415  # few conversions add poses

            sources = [route.connection for route in plan.routes if route.tasks]
            self.stamps = delay_observers(sources, span.start_ns, span.stop_ns)
        self._imus: dict[str, ImuReading] = {}
        for spec in plan.specs:
            if spec.imu_request:
                from pc2scan.tf.imu import ImuReading  # noqa: PLC0415  # few scans are level

                topic = spec.imu_request.topic
                self._imus.setdefault(topic, ImuReading(self._readers, topic))
        self.outputs = {spec: self._observers_of(spec, plan, asked) for spec in plan.specs if not spec.reverse}

    def _observers_of(self, spec: ScanSpec, plan: Plan, asked: FrameOptions) -> OutputObservers:
        reader, span = self._readers[0], self._span
        found = OutputObservers()
        own = [route.connection for route in plan.routes if any(task.spec is spec for task in route.tasks)]
        if spec.fixed_frame or spec.imu:
            from pc2scan.tf.clocks import delay_observers  # noqa: PLC0415  # only where times of several topics are compared

            motion = _motion_connections(reader, spec, asked)
            cut = span.start_ns, span.stop_ns
            found.delays = delay_observers(own, *cut), delay_observers(motion, *cut)
        if spec.fixed_frame:
            from .frame_checks import frame_observer  # noqa: PLC0415  # few conversions have one

            found.frame = frame_observer(own, span)
        placer = None if spec.needs_transforms else Placer(source_frame=asked.source_frame)
        for combination in (each for each in plan.combinations if each.spec is spec):
            from .combine.measurements import source_observers  # noqa: PLC0415  # few scans are of several messages

            sources = combination_sources(plan, combination)
            found.combinations[combination] = source_observers(combination, sources, placer, span)
            found.deskew[combination] = _deskew_observers(spec, sources, span)
        if converted := converted_alone(plan, spec):
            if spec.needs_measuring:
                from .measurements import cloud_observers  # noqa: PLC0415  # only if something is to be measured

                found.clouds = cloud_observers(converted, spec, placer, span.start_ns, span.stop_ns)
            found.deskew[None] = _deskew_observers(spec, converted, span)
        return found

    def read(self, frames: Collection[str] = ()) -> None:
        """Read the recordings: each once, as far as anything of it is needed.

        A topic with poses that was not asked for is read separately, if only it has a frame that is needed.

        Parameters
        ----------
        frames
            Frames that are needed besides those of the outputs.

        Raises
        ------
        RecordingError
            If one cannot be read.
        """
        for number, reader in enumerate(self._readers):
            observers: list[Observer[Any]] = []
            if self.transforms is not None:
                observers += self.transforms.observers(reader, own=number == 0)
            for imu in self._imus.values():
                observers += imu.observers(reader)
            if number == 0:
                observers += [] if self.robot is None else self.robot.observers
                observers += self.given_frames
                observers += self.stamps.values()
                observers += (each for output in self.outputs.values() for each in output.all)
            observe(reader, observers)
        if self.transforms is not None:
            needed = (frame for spec in self._specs if spec.needs_transforms for frame in spec.frames)
            self.transforms.supply(self._readers, {*frames, *needed})

    def up(self, request: ImuRequest) -> UpEstimate:
        """Estimate the direction of up by an IMU; see `ImuReading.up`."""
        return self._imus[request.topic].up(request.frame)


def combination_sources(plan: Plan, combination: Combination) -> list[Connection]:
    """Return the connections whose messages become scans together."""
    return [route.connection for route in plan.routes if any(task.combination is combination for task in route.tasks)]


def converted_alone(plan: Plan, spec: ScanSpec) -> list[Connection]:
    """Return the connections whose messages become scans by themselves."""
    return [
        route.connection
        for route in plan.routes
        if any(task.spec is spec and task.combination is None for task in route.tasks)
    ]


def _deskew_observers(spec: ScanSpec, sources: Sequence[Connection], span: Span) -> DeskewObservers:
    if not spec.deskew:
        return DeskewObservers({}, {})
    from .point_times import time_observers, turn_observers  # noqa: PLC0415  # only with deskewing
    from .stages.deskew import PointTime  # noqa: PLC0415

    where = PointTime.parse(spec.point_time)
    if where.turn is None:
        return DeskewObservers(time_observers(sources, where, span), {})
    return DeskewObservers({}, turn_observers(sources, spec.point_time, span.start_ns, span.stop_ns))


def _motion_connections(reader: Reader, spec: ScanSpec, frames: FrameOptions) -> Iterator[Connection]:
    """Yield the connections with moving transforms, and those of the IMU, that the spec uses."""
    if spec.fixed_frame:
        yield from (c for c in tf_connections(reader.connections, frames.tf_topics) if not is_static(c.topic))
    if spec.imu_request:
        from pc2scan.messages.imu import IMU  # noqa: PLC0415  # few scans are level

        topic = spec.imu_request.topic.strip("/")
        yield from (c for c in reader.connections if c.ros_type == IMU and c.topic.strip("/") == topic)
