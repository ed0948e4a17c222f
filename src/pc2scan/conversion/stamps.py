"""Corrects the stamps of lidars whose clock is not the recording's: as their messages are read, for everything else.

What a lidar on its own clock has recorded is read with corrected stamps: the look ahead, lookups of transforms, scans
and kept clouds all have these. Points' own times move along.
"""

from __future__ import annotations

from threading import Lock
from typing import TYPE_CHECKING

from pc2scan.advice.clocks import measure_offsets
from pc2scan.advice.survey import Span
from pc2scan.bags.opening import open_recordings
from pc2scan.bags.reader import ChangedReader
from pc2scan.bags.topics import by_topic, find_topic, types_by_topic
from pc2scan.errors import DecodeError
from pc2scan.messages.clouds import CLOUDS
from pc2scan.messages.stamps import STAMPED, move_times, set_stamp, stamp_in
from pc2scan.request.options import TRAJECTORY
from pc2scan.transforms.reading import read_transforms

from .preparation import span_of

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence
    from contextlib import ExitStack

    from pc2scan.bags.reader import Reader
    from pc2scan.model import Connection, RawMessage
    from pc2scan.progress import Meter
    from pc2scan.request.options import ConvertOptions, StampOptions
    from pc2scan.transforms.reading import FoundTransforms

    from .plan import Plan

#: If a constant offset leaves stamps that differ from their log times by more than this, it is not constant. One that
#: takes them farther from those of the transforms by more than this is wrong.
_CONSTANT_NS = 1_000_000_000


class _Clock:
    """The clock of one topic: corrects the stamps of its messages.

    Parameters
    ----------
    topic
        The topic.
    offset_ns
        What is added; None: stamps become log times.
    fields
        Fields with the points' times, besides the usual ones.
    remarks
        Receives warnings about the stamps.
    """

    def __init__(self, topic: str, offset_ns: int | None, fields: Sequence[str], remarks: list[str]) -> None:
        self._offset_ns = offset_ns
        self._fields = fields
        self._remarks = remarks
        self._lock = Lock()
        self._delays: tuple[int, int] | None = None
        #: Warnings that were not given yet.
        self._varying = (
            f"{topic}: with `time_offset`, the time from its stamps to its log times varies by more than "
            f"{_CONSTANT_NS / 1e9:g} s: the difference of the clocks is not constant; `stamps=log` takes log times"
        )
        self._unfitting = f"{topic}: corrected stamps do not fit into its messages, which have the nearest time"

    def correct(self, message: RawMessage) -> RawMessage:
        """Return a message with its corrected stamp; one that cannot be decoded stays as it is."""
        connection, copy = message.connection, bytearray(message.data)
        try:
            own_ns = stamp_in(copy, connection.serialization)
            stamp_ns = message.log_time_ns if self._offset_ns is None else own_ns + self._offset_ns
            if connection.ros_type in CLOUDS and stamp_ns != own_ns:
                # Before the stamp changes, which tells their unit.
                move_times(copy, connection.serialization, connection.ros_type, stamp_ns - own_ns, self._fields)
            fits = set_stamp(copy, connection.serialization, stamp_ns)
        except DecodeError:
            return message
        self._judge(message.log_time_ns - stamp_ns, fits=fits)
        return message._replace(data=bytes(copy))

    def _judge(self, delay_ns: int, *, fits: bool) -> None:
        """Add warnings about a stamp; each is given once. Messages are read on several threads, and some again."""
        with self._lock:
            least, most = self._delays or (delay_ns, delay_ns)
            self._delays = min(least, delay_ns), max(most, delay_ns)
            if self._varying and self._delays[1] - self._delays[0] > _CONSTANT_NS:
                self._remarks.append(self._varying)
                self._varying = ""
            if self._unfitting and not fits:
                self._remarks.append(self._unfitting)
                self._unfitting = ""


def corrected(
    reader: Reader,
    converted: Sequence[Connection],
    clock: StampOptions,
    tf_topics: Sequence[str],
    *,
    start_ns: int | None = None,
    stop_ns: int | None = None,
    fields: Sequence[str] = (),
) -> tuple[Reader, list[str]]:
    """Return a recording with corrected stamps, and notes about offsets that were measured.

    Parameters
    ----------
    converted
        The connections whose messages are converted.
    clock
        How stamps are corrected.
    tf_topics
        The topics of the transforms, whose clock offsets are measured against; see `FrameOptions`.
    start_ns, stop_ns
        The cut: offsets are measured in its first messages.
    fields
        Fields with the points' times, besides the usual ones.

    Raises
    ------
    TopicError
        If there is no topic of a name, or it has no stamps.
    """
    offsets: dict[str, int | None] = dict.fromkeys((each.topic for each in converted), clock.offset_ns)
    own = _named_topics(reader.connections, clock)
    offsets |= own
    topics = by_topic(each for each in reader.connections if each.topic in offsets and _is_stamped(each))
    notes: list[str] = []
    by_log = clock.by_log
    remarks: list[str] = []
    wanted = {
        topic: topics[topic]
        for topic, offset in offsets.items()
        if topic in topics and (offset is None or abs(offset) > _CONSTANT_NS)
    }
    measured = measure_offsets(reader, wanted, tf_topics, Span(start_ns, stop_ns, 0)) if wanted else {}
    for topic, fit in measured.items():
        if (given_ns := offsets[topic]) is None:
            offsets[topic] = fit.offset_ns
            notes.append(fit.note)
        elif fit.reference and abs(given_ns - fit.offset_ns) > abs(fit.offset_ns) + _CONSTANT_NS:
            remarks.append(
                f"{topic}: `time_offset` takes its stamps farther from those of {fit.reference}: without it they "
                f"{_fit(fit.offset_ns)}, with it they are {abs(given_ns - fit.offset_ns) / 1e9:.3g} s off; "
                f"`time_offset={topic}=auto` measures what corrects them"
            )
    clocks = {
        topic: _Clock(topic, None if by_log and topic not in own else offset_ns, fields, remarks)
        for topic, offset_ns in offsets.items()
        if offset_ns != 0 or (by_log and topic not in own)
    }
    changes = {each.id: clocks[topic].correct for topic, group in topics.items() if topic in clocks for each in group}
    return (ChangedReader(reader, changes, remarks) if changes else reader), notes


def _fit(offset_ns: int) -> str:
    return f"are {abs(offset_ns) / 1e9:.3g} s off" if offset_ns else "fit"


def corrected_for(reader: Reader, plan: Plan, options: ConvertOptions) -> tuple[Reader, list[str]]:
    """Return the recording of a conversion with corrected stamps, and notes; see `corrected`."""
    if not options.clock:
        return reader, []
    span = span_of(reader, options)
    fields = [spec.point_time.partition(":")[0] for spec in plan.specs if spec.point_time]
    return corrected(
        reader,
        plan.converted,
        options.clock,
        options.frames.tf_topics,
        start_ns=span.start_ns,
        stop_ns=span.stop_ns,
        fields=fields,
    )


def corrected_transforms(
    reader: Reader, options: ConvertOptions, stack: ExitStack, needed: Collection[str], meter: Meter | None = None
) -> tuple[FoundTransforms, Sequence[Reader]]:
    """Return all transforms of a recording, and the opened recordings of ``tf_from``, which have some of them.

    Parameters
    ----------
    stack
        Closes these.
    needed
        Frames that they must have.
    meter
        Counts the bytes; None: nothing is reported.
    """
    others = open_recordings(options.frames.tf_from, stack, strict=options.strict)
    if options.clock:
        # Of topics with poses that have an offset of their own.
        reader, _ = corrected(reader, [], options.clock, options.frames.tf_topics)
    return read_transforms([reader, *others], options.frames, needed=needed, meter=meter), others


def _is_stamped(connection: Connection) -> bool:
    return connection.ros_version is not None and connection.ros_type in (*CLOUDS, *STAMPED)


def _named_topics(connections: Sequence[Connection], clock: StampOptions) -> dict[str, int | None]:
    """Return the offsets of topics that have their own, by the names in the recording."""
    types = types_by_topic(connections)
    known = sorted({connection.topic for connection in connections if _is_stamped(connection)})
    return {
        find_topic(name, types, known, *CLOUDS, *sorted(STAMPED)): offset_ns
        for name, offset_ns in clock.by_topic.items()
        if name != TRAJECTORY
    }
