"""LaserScan messages as objects with arrays, read from a recording, or made from its clouds."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from pc2scan.advice.checks import request_warnings
from pc2scan.conversion.corrections import corrected_for
from pc2scan.conversion.first_clouds import judge_first
from pc2scan.conversion.plan import make_plan
from pc2scan.conversion.preparation import prepare, span_of
from pc2scan.conversion.recording import open_routes
from pc2scan.conversion.report import Report
from pc2scan.conversion.result_checks import result_findings
from pc2scan.core.unproject import UnprojectParams, unproject
from pc2scan.errors import stamp_text, visible
from pc2scan.messages.clouds import CLOUDS
from pc2scan.messages.laserscan import LASERSCAN, LaserScan, as_message, decode_laserscan
from pc2scan.result import tell_early

from .stream import Message, Stream, StreamSource

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence
    from contextlib import ExitStack
    from pathlib import Path

    from numpy.typing import NDArray

    from pc2scan.bags.reader import Reader
    from pc2scan.conversion.steps import ConvertedMessage
    from pc2scan.model import Buffer
    from pc2scan.progress import Meter
    from pc2scan.request.options import ConvertOptions
    from pc2scan.transforms.buffer import TransformBuffer

_HINT_CLOUDS = (
    CLOUDS,
    "its clouds become scans with parameters: `preset`, `params_file`, or any of them by name, `min_height=-0.3`",
)
_HINT_SCANS = ((LASERSCAN,), "it has LaserScan topics, which are read as they are without any parameters")

#: What a scan has of its message, in the order of `Scan`.
_DECODED = (
    *("stamp_ns", "frame_id", "sequence", "angle_min", "angle_max", "angle_increment", "time_increment", "scan_time"),
    *("range_min", "range_max", "ranges", "intensities"),
)


# Not frozen: made for every message, and making a frozen one takes twice as long.
@dataclass(slots=True, eq=False, repr=False)
class Scan(Message):
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
    transforms
        All transforms of the recording, if they were read for scans that are made of clouds; else None.
    damage
        The damage that the last loop found.
    skipped, skipped_count
        Messages that the last loop could not use: the first hundred, and how many.
    """

    def __init__(
        self,
        paths: Sequence[Path],
        options: ConvertOptions,
        converting: bool = False,  # for pickles
        *,
        transform_frames: Collection[str] | None = None,
        all_topics: bool = False,
        meter: Meter | None = None,
    ) -> None:
        self._converting = converting
        self._transform_frames = transform_frames
        self.transforms: TransformBuffer | None = None
        super().__init__(paths, options, all_topics=all_topics, meter=meter)

    def __reduce__(self) -> tuple[object, ...]:
        return type(self), (self._paths, self._options, self._converting)

    def _source(self, stack: ExitStack, reader: Reader) -> StreamSource:
        if self._converting:
            return self._converted(stack, reader)
        return self._recorded(
            stack, reader, (LASERSCAN,), _HINT_CLOUDS, lambda connection: partial(_decode, connection.serialization)
        )

    def _object(self, topic: str, log_time_ns: int, message: Any) -> Scan:
        return Scan(topic, log_time_ns, *map(message.__getattribute__, _DECODED))

    def _converted(self, stack: ExitStack, reader: Reader) -> StreamSource:
        """Convert clouds as `pc2scan.convert` does."""
        options = self._options
        if not options.scan.topics and not self._all_topics:
            # Raises if there are several.
            self._choose(reader, options.scan.source_types, _HINT_SCANS)
        plan = make_plan(reader.connections, options)
        reader, notes = corrected_for(reader, plan, options)
        report = Report([str(path) for path in self._paths], "", plan.specs)
        report.source_frame = options.frames.source_frame
        report.warnings += (*plan.warnings, *request_warnings(options, reader.summary))
        prepared = prepare(
            reader,
            plan,
            options,
            span_of(reader, options),
            stack,
            partial(tell_early, report.warnings, None),
            transform_frames=self._transform_frames,
            meter=self._meter,
        )
        self.transforms = prepared.transforms
        report.add((), (*notes, *prepared.notes))
        self.notes = tuple(report.notes)
        routes, report.topics = open_routes(plan, prepared.conversions, finish=_as_in_message)
        judge_first(routes, prepared, report)

        def conclude() -> None:
            report.add([label + text for label, seen in prepared.surroundings for text in seen.warnings()])
            report.add(reader.remarks)
            report.add(*result_findings(report))

        return StreamSource(
            stack,
            [reader, *prepared.others],
            tuple(dict.fromkeys(target for route in plan.routes for target in route.targets)),
            routes,
            prepared.span,
            options.jobs,
            report.warnings,
            conclude,
        )


def _decode(serialization: str, data: Buffer) -> LaserScan:
    """Return a scan that does not keep the message in memory."""
    scan = decode_laserscan(data, serialization)
    scan.ranges, scan.intensities = scan.ranges.astype(np.float32), scan.intensities.astype(np.float32)
    return scan


def _as_in_message(serialization: str, result: ConvertedMessage) -> ConvertedMessage:
    """Do the last step of a conversion to `Scan`: the numbers of the arrays become those of a message."""
    result.message = as_message(result.message, serialization)
    result.size = result.message.ranges.nbytes + result.message.intensities.nbytes
    return result
