"""LaserScan messages as objects with arrays, read from a recording, or made from its clouds."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from pc2scan.core.unproject import UnprojectParams, unproject
from pc2scan.errors import MessageError, UsageError, stamp_text, visible
from pc2scan.messages.clouds import CLOUDS
from pc2scan.messages.laserscan import LASERSCAN, decode_laserscan
from pc2scan.pipeline.checks import TransformCheck, cut_warnings, option_warnings, refuse_unusable
from pc2scan.pipeline.conversion import EncodedMessage
from pc2scan.pipeline.first_clouds import Candidate, FirstClouds, SharedSample
from pc2scan.pipeline.plan import make_plan
from pc2scan.pipeline.preparation import prepare_conversions
from pc2scan.pipeline.report import Report
from pc2scan.pipeline.routes import combiner_of
from pc2scan.pipeline.run import robot_transforms, span_of
from pc2scan.pipeline.topic_report import TopicReport

from .stream import MessageResult, NumpyTimes, Stream, StreamSource, import_pandas, import_xarray

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from contextlib import ExitStack

    from numpy.typing import NDArray

    from pc2scan.bags.reader import Reader
    from pc2scan.model import Buffer, RawMessage
    from pc2scan.pipeline.combine.combiner import Arrival, CombinedScan, Combiner
    from pc2scan.pipeline.options import ConvertOptions
    from pc2scan.pipeline.plan import Combination, Route

    from .stream import Selection

#: The attributes that all scans of one Dataset must share, because they describe the beams.
_GEOMETRY = ("angle_min", "angle_max", "angle_increment")
_LIMITS = ("range_min", "range_max", "time_increment", "scan_time")


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Scan(NumpyTimes):
    """A LaserScan message.

    Attributes
    ----------
    topic
        The topic that it was published on.
    log_time_ns
        The time of recording, nanoseconds since 1970.
    stamp_ns
        ``header.stamp``, nanoseconds since 1970.
    frame
        ``header.frame_id``.
    sequence
        ``header.seq``; 0 from ROS 2.
    angle_min, angle_max, angle_increment
        Radians.
    time_increment, scan_time
        Seconds from one beam to the next, and from one scan to the next.
    range_min, range_max
        Metres.
    ranges
        float32, shape (beams,), metres.
    intensities
        float32, shape (beams,), or (0,) for a scan without any.
    """

    topic: str
    log_time_ns: int
    stamp_ns: int
    frame: str
    sequence: int
    angle_min: float
    angle_max: float
    angle_increment: float
    time_increment: float
    scan_time: float
    range_min: float
    range_max: float
    ranges: NDArray[np.float32]
    intensities: NDArray[np.float32]

    @property
    def angles(self) -> NDArray[np.float64]:
        """The direction of each beam, shape (beams,), radians: ``angle_min + i * angle_increment``."""
        angles: NDArray[np.float64] = self.angle_min + np.arange(len(self.ranges)) * np.float64(self.angle_increment)
        return angles

    @property
    def valid(self) -> NDArray[np.bool_]:
        """Which beams have a return, shape (beams,): ``range_min <= range < range_max``, which NaN and inf are not."""
        with np.errstate(invalid="ignore"):  # a NaN may be a signalling one
            valid: NDArray[np.bool_] = (self.ranges >= np.float64(self.range_min)) & (
                self.ranges < np.float64(self.range_max)
            )
        return valid & np.isfinite(self.ranges)

    def xy(self) -> NDArray[np.float32]:
        """The points of the beams that have a return, as laser_geometry computes them.

        Returns
        -------
        numpy.ndarray
            float32, shape (returns, 2), metres in `frame`, in the order of the beams: those of `valid`.

        Raises
        ------
        DecodeError
            If the angles are not finite.
        """
        points = unproject(
            self.ranges,
            np.empty(0, np.float32),
            angle_min=self.angle_min,
            angle_increment=self.angle_increment,
            range_min=self.range_min,
            range_max=self.range_max,
            params=UnprojectParams(index=False),
        )
        return points.xyz[np.isfinite(self.ranges[points.beams]), :2].copy()

    def to_dataframe(self) -> Any:
        """Return a ``pandas.DataFrame`` with a row for each beam.

        Columns: ``angle``, ``range`` and, if the scan has them, ``intensity``; the index is ``beam``.

        Raises
        ------
        ImportError
            If pandas is not installed.
        """
        pandas = import_pandas()
        index = pandas.RangeIndex(len(self.ranges), name="beam")
        return pandas.DataFrame(self._columns(), index)

    def _columns(self) -> dict[str, NDArray[Any]]:
        columns: dict[str, NDArray[Any]] = {"angle": self.angles, "range": self.ranges}
        if len(self.intensities) == len(self.ranges) and len(self.ranges):
            columns["intensity"] = self.intensities
        return columns

    def to_xarray(self) -> Any:
        """Return an ``xarray.Dataset`` of this scan; see `Scans.to_xarray`.

        Raises
        ------
        ImportError
            If xarray is not installed.
        """
        return _dataset([self]).squeeze("time")

    def __repr__(self) -> str:
        returns = np.count_nonzero(self.valid)
        return (
            f"<Scan on {visible(self.topic)} at {stamp_text(self.stamp_ns)} in {self.frame!r}: "
            f"{len(self.ranges)} beams, {returns} with a return>"
        )


class Scans(Stream[Scan]):
    """The scans of a recording, read as they are iterated over; `pc2scan.scans` makes it.

    The recording is opened immediately, so that a wrong request raises here and not in the loop.
    Each loop reads from the beginning. The files are closed when the loop ends or is left, or with `close` or a
    ``with`` statement.

    Attributes
    ----------
    topics
        The topics of the scans.
    notes
        Values that were measured, or chosen by default, for scans that are made of clouds.
    damage
        The damage that the last loop found.
    skipped, skipped_count
        Messages that the last loop could not use: the first hundred, and how many.
    """

    def __init__(
        self,
        selection: Selection,
        conversion: ConvertOptions | None = None,
    ) -> None:
        self._conversion = conversion
        self.notes: tuple[str, ...] = ()
        super().__init__(selection)

    def __reduce__(self) -> tuple[object, ...]:
        return type(self), (self._selection, self._conversion)

    def _source(self, stack: ExitStack, reader: Reader) -> StreamSource:
        if self._conversion is not None:
            return self._converting(stack, reader, self._conversion)
        return self._source_of_type(stack, reader, LASERSCAN, _hint_clouds, _read_scan)

    def _converting(self, stack: ExitStack, reader: Reader, options: ConvertOptions) -> StreamSource:
        """Convert clouds as `pc2scan.convert` does."""
        if not options.scan.topics:
            # Returns the only topic, or raises.
            self._selection.select_connections(reader, options.scan.source_types, _hint_scans)
        refuse_unusable(options)
        plan = make_plan(reader.connections, options)
        span = span_of(reader, options)
        sources = [str(path) for path in self._selection.paths]
        report = Report(sources, "", plan.specs)
        report.source_frame = options.frames.source_frame
        report.warnings += (
            *option_warnings(options),
            *cut_warnings(reader, options.start, options.end),
            *plan.warnings,
        )
        early: list[str] = []
        transforms = partial(robot_transforms, self._selection.paths, options, span)
        firsts = FirstClouds(report, early.append, transforms)
        conversions, others, buffer, notes, warnings = prepare_conversions(
            reader, plan, options, span, stack, firsts.of
        )
        report.notes += notes
        report.warnings += warnings
        if buffer is not None:
            firsts.buffer, firsts.static = buffer, options.frames.static
        early[:0] = report.warnings
        self.notes = tuple(report.notes)
        routes: dict[int, list[_Task]] = {}
        joints: dict[Combination, Combiner] = {}
        for route in plan.routes:
            connection = route.connection
            serial = connection.serialization
            for task in route.tasks:
                conversion = conversions[task.key]
                convert = conversion.for_topic(connection.topic, serial, serial, connection.ros_type)
                joint = combiner_of(joints, task, conversion, serial)
                routes.setdefault(connection.id, []).append(_Task(convert, task.targets, joint))

        def read(message: RawMessage) -> MessageResult:
            return _convert(routes[message.connection.id], message)

        connections = [route.connection for route in plan.routes if route.targets]
        topics = tuple(dict.fromkeys(target for route in plan.routes for target in route.targets))
        latched = [connection for connection in connections if connection.latching]
        account = _ConversionCounter(report, plan.routes, joints, firsts, early)
        return StreamSource(
            stack,
            [reader, *others],
            topics,
            connections,
            span.start_ns,
            span.stop_ns,
            read,
            latched,
            account,
            tuple(joints.values()),
            _joint_result if joints else None,
        )

    def to_dataframe(self) -> Any:
        """Return a ``pandas.DataFrame`` with a row for each beam of each scan. Reads all scans into memory.

        Columns: ``stamp``, ``beam``, ``angle``, ``range``, ``intensity`` if all scans have it, and ``topic`` if
        there are several.

        Raises
        ------
        ImportError
            If pandas is not installed.
        """
        pandas = import_pandas()
        parts = [(scan, scan._columns()) for scan in self]  # noqa: SLF001  # they make one table
        names = ["angle", "range", "intensity"]
        if not all("intensity" in columns for scan, columns in parts if len(scan.ranges)):
            names.remove("intensity")
        lengths = [len(scan.ranges) for scan, _ in parts]
        table: dict[str, Any] = {
            "stamp": np.repeat(np.array([scan.stamp for scan, _ in parts], "datetime64[ns]"), lengths),
            "beam": np.concatenate([np.arange(length) for length in [*lengths, 0]]),
        }
        for name in names:
            kind = np.float64 if name == "angle" else np.float32
            table[name] = np.concatenate([*(c.get(name, np.empty(0)) for _, c in parts), np.empty(0)], dtype=kind)
        if len(self.topics) > 1:
            table["topic"] = pandas.Categorical(np.repeat([scan.topic for scan, _ in parts], lengths))
        return pandas.DataFrame(table)

    def to_xarray(self) -> Any:
        """Return an ``xarray.Dataset`` of all scans. Reads them into memory.

        Variables: ``ranges`` and, if all scans have them, ``intensities``, with the dimensions ``time`` and ``beam``.
        Coordinates: ``time`` (the stamps), ``log_time``, ``angle`` (of each beam), and ``topic`` if there are several.
        Attributes: ``frame``, ``angle_min`` and the other numbers of the messages, as far as all scans agree in them.

        Raises
        ------
        ImportError
            If xarray is not installed.
        UsageError
            If there is no scan, or the beams of the scans are not the same. `to_dataframe` accepts any scans.
        """
        import_xarray()
        return _dataset(list(self))


def _dataset(scans: Sequence[Scan]) -> Any:
    xarray = import_xarray()
    if not scans:
        raise UsageError("there is no scan to make a Dataset of", hint="check topic, `start` and `end`")
    first = scans[0]
    for scan in scans:
        if len(scan.ranges) != len(first.ranges) or any(getattr(scan, n) != getattr(first, n) for n in _GEOMETRY):
            raise UsageError(
                f"the scans do not have the same beams: {_layout_text(first)}, but {_layout_text(scan)}",
                hint="to_dataframe() accepts any scans; or choose one with topic=",
            )
    data = {"ranges": (("time", "beam"), np.stack([scan.ranges for scan in scans]), {"units": "m"})}
    if all(len(scan.intensities) == len(first.ranges) for scan in scans):
        data["intensities"] = (("time", "beam"), np.stack([scan.intensities for scan in scans]), {})
    coordinates: dict[str, Any] = {
        "time": ("time", np.array([scan.stamp for scan in scans], "datetime64[ns]")),
        "log_time": ("time", np.array([scan.log_time for scan in scans], "datetime64[ns]")),
        "angle": ("beam", first.angles, {"units": "rad"}),
    }
    if len({scan.topic for scan in scans}) > 1:
        coordinates["topic"] = ("time", np.array([scan.topic for scan in scans], object))
    common = {
        name: getattr(first, name)
        for name in ("topic", "frame", *_GEOMETRY, *_LIMITS)
        if len({getattr(scan, name) for scan in scans}) == 1
    }
    return xarray.Dataset(data, coordinates, common)


def _layout_text(scan: Scan) -> str:
    return (
        f"{len(scan.ranges)} from {scan.angle_min:.6g} to {scan.angle_max:.6g} rad on {scan.topic} "
        f"at {stamp_text(scan.stamp_ns)}"
    )


def _scan(topic: str, log_time_ns: int, data: Buffer, serialization: str) -> Scan:
    decoded = decode_laserscan(data, serialization)
    return Scan(
        topic,
        log_time_ns,
        decoded.stamp_ns,
        decoded.frame_id,
        decoded.sequence,
        decoded.angle_min,
        decoded.angle_max,
        decoded.angle_increment,
        decoded.time_increment,
        decoded.scan_time,
        decoded.range_min,
        decoded.range_max,
        # Copies: a view would keep the whole chunk in memory that the message was in.
        decoded.ranges.astype(np.float32),
        decoded.intensities.astype(np.float32),
    )


def _read_scan(message: RawMessage) -> Scan:
    connection = message.connection
    return _scan(connection.topic, message.log_time_ns, message.data, connection.serialization)


class _Task(NamedTuple):
    """A conversion, and the topics of its scans; ``joint`` makes a scan of a message and others."""

    convert: Callable[[Buffer], Any]
    targets: Sequence[str]
    joint: Combiner | None


def _convert(tasks: Sequence[_Task], message: RawMessage) -> MessageResult:
    connection, log_time_ns = message.connection, message.log_time_ns
    scans: list[Scan] = []
    arrived: list[Arrival] = []
    alone: EncodedMessage | None = None
    try:
        for convert, targets, joint in tasks:
            made = convert(message.data)
            if isinstance(made, EncodedMessage) and isinstance(made.sample, Candidate):
                made.sample = made.sample.sample(log_time_ns)
            if joint is None:
                alone = made
                scans += _scans_of(made, targets, log_time_ns, connection.serialization)
            else:
                from pc2scan.pipeline.combine.combiner import Arrival  # noqa: PLC0415  # few scans are of several messages

                arrived.append(Arrival(joint, (connection, targets), made, message.sequence))
    except MessageError as err:
        return MessageResult(connection, log_time_ns, 0, error=err)
    size = 0 if alone is None else len(alone.data)
    converted = None if alone is None else replace(alone, data=b"")
    return MessageResult(connection, log_time_ns, size, tuple(scans), converted=converted, arrived=tuple(arrived))


def _joint_result(scan: CombinedScan) -> MessageResult:
    """Return a scan of several messages as the result of the message that leads it."""
    (connection, targets), log_time_ns, _, _, made = scan
    if isinstance(made, MessageError):
        return MessageResult(connection, log_time_ns, 0, error=made, is_joint=True)
    scans = _scans_of(made, targets, log_time_ns, connection.serialization)
    return MessageResult(
        connection, log_time_ns, len(made.data), tuple(scans), converted=replace(made, data=b""), is_joint=True
    )


def _scans_of(made: EncodedMessage, targets: Sequence[str], log_time_ns: int, serialization: str) -> list[Scan]:
    first = _scan(targets[0], log_time_ns, made.data, serialization)
    return [first, *(replace(first, topic=target) for target in targets[1:])]


class _ConversionCounter:
    """Counts the results of a conversion, as `pc2scan.convert` does."""

    def __init__(
        self,
        report: Report,
        routes: Sequence[Route],
        joints: Mapping[Combination, Combiner],
        firsts: FirstClouds,
        early: list[str],
    ) -> None:
        self._report, self._firsts, self._early = report, firsts, early
        self._unconnected = TransformCheck()
        entries: dict[tuple[str, str], TopicReport] = {}
        #: The entries of each connection, and whether their scans are made of several messages.
        self._entries: dict[int, list[tuple[TopicReport, bool]]] = {}
        for route in routes:
            topic, found = route.connection.topic, self._entries.setdefault(route.connection.id, [])
            for task in route.tasks:
                joint = joints.get(task.combination) if task.combination is not None else None
                number = 0 if task.combination is None else task.combination.sources.index(topic)
                for target in task.targets:
                    entry = TopicReport(
                        topic, route.connection.ros_type, target, "joined" if number else "converted", spec=task.spec
                    )
                    entry = entries.setdefault((topic, target), entry)
                    found.append((entry, joint is not None))
                    if joint is not None:
                        joint.reports[number] = entry
        report.topics += entries.values()

    def note(self, message: MessageResult) -> None:
        """Count a message; see `ResultCounter`."""
        made = message.converted
        if made is not None and isinstance(made.sample, SharedSample):
            made.sample.add(made.counts)
        if not message.is_joint:
            self._unconnected.note(message.connection.topic, message.error)
        for entry, is_joint in self._entries[message.connection.id]:
            if message.is_joint and not is_joint:
                continue
            entry.messages_in += not message.is_joint
            if message.error is not None:
                entry.skipped += 1
            elif message.converted is not None and message.is_joint == is_joint:
                entry.messages_out += 1
                entry.count(message.converted)

    def finish(self) -> None:
        """Raise if nothing could be converted; see `ResultCounter`."""
        self._unconnected.finish()

    def early_warnings(self) -> Sequence[str]:
        """Return new warnings about the first clouds; see `ResultCounter`."""
        if not self._early:
            return ()
        found = tuple(self._early)
        self._early.clear()
        return found

    def warnings(self) -> Sequence[str]:
        """Return warnings for the user; see `ResultCounter`."""
        self._firsts.finish()
        self._report.conclude()
        return self._report.warnings


def _hint_clouds(reader: Reader) -> str | None:
    """Return the hint for a recording that has clouds, but no scans."""
    if not any(connection.ros_type in CLOUDS for connection in reader.connections):
        return None
    return "its clouds become scans with parameters: `preset`, `params_file`, or any of them by name, `min_height=-0.3`"


def _hint_scans(reader: Reader) -> str | None:
    if not any(connection.ros_type == LASERSCAN for connection in reader.connections):
        return None
    return "it has LaserScan topics, which are read as they are without any parameters"
