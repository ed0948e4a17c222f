"""Compares the clock of clouds with that of the transforms or the IMU that say where the robot was at their time."""

from __future__ import annotations

import re
from contextlib import suppress
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from pc2scan.bags.observers import Observer, observe
from pc2scan.bags.topics import by_topic, is_static
from pc2scan.core.percentiles import median_low
from pc2scan.core.timing import TIME_FIELDS, point_times
from pc2scan.errors import UsageError, stamp_text
from pc2scan.messages.clouds import CLOUDS
from pc2scan.messages.poses import POSES
from pc2scan.messages.stamps import STAMPED, stamp_in
from pc2scan.messages.tfmessage import TF_TYPES, decode_transforms
from pc2scan.text import counted, stamp

from .reading import tf_connections

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from pc2scan.bags.reader import Reader
    from pc2scan.model import Connection, RawMessage

    from .trajectory import Trajectory

#: Delays from stamps in a message to its log time, nanoseconds, with the child frames of transforms.
Delays: TypeAlias = "list[tuple[str, int]]"

#: How many messages of each topic are read: clouds are large, and several nodes publish transforms.
_MESSAGES = {True: 3, False: 50}

#: The name of a trajectory among topics, in options.
TRAJECTORY = "trajectory"

#: Earlier times do not count from 1970, nanoseconds.
_LONG_AGO_NS = 1_000_000_000_000_000

#: The largest offset: three centuries, as stamps of 64 bits have.
_MOST_NS = 2**63 - 1

_SIGNED = re.compile(r"([+-]?)(.*)")

#: In how many messages of each topic an offset is measured, and the longest time that a cloud takes, seconds.
_MEASURED = 50
_LONGEST_S = 1.0

#: Clocks may differ if the delays from stamps to log times differ by this. Slow drivers delay messages, too.
_OTHER_CLOCK_NS = 500_000_000

#: No message is logged before its stamp, except by the small error of a clock. If messages of only one topic are, this
#: difference of the delays is enough.
_BEFORE_NS = -20_000_000
_SMALL_NS = 100_000_000


@dataclass(frozen=True, slots=True)
class StampOptions:
    """How stamps are corrected.

    Attributes
    ----------
    by_log
        Whether the stamps of converted messages become their log times.
    offset_ns
        What is added to the stamps of converted messages, nanoseconds; None: it is measured.
    by_topic
        The same for single topics, which may be any that are read; ``trajectory`` stands for the poses of a file.
    """

    by_log: bool = False
    offset_ns: int | None = 0
    by_topic: Mapping[str, int | None] = field(default_factory=dict)

    def __bool__(self) -> bool:
        return self.by_log or self.offset_ns != 0 or bool(self.by_topic.keys() - {TRAJECTORY})

    def __hash__(self) -> int:
        return hash((self.by_log, self.offset_ns, tuple(self.by_topic.items())))

    @property
    def trajectory_ns(self) -> int:
        """What is added to the stamps of a trajectory, nanoseconds."""
        return self.by_topic.get(TRAJECTORY) or 0

    @classmethod
    def of(cls, stamps: str, time_offset: Iterable[str]) -> StampOptions:
        """Read the options ``stamps`` and ``time_offset``.

        Raises
        ------
        UsageError
            If an offset is not one, or they contradict each other.
        """
        general: int | None = 0
        by_topic: dict[str, int | None] = {}
        for text in time_offset:
            name, _, value = text.rpartition("=")
            if name in by_topic or (not name and general != 0):
                raise UsageError(f"`time_offset` is given twice for {name or 'all topics'}")
            offset_ns = _offset_of(text, value)
            if name:
                by_topic[name] = offset_ns
            else:
                general = offset_ns
        if TRAJECTORY in by_topic and by_topic[TRAJECTORY] is None:
            raise UsageError("`time_offset`: the offset of a trajectory is not measured; give it in seconds")
        by_log = stamps == "log"
        if by_log and general != 0:
            raise UsageError("`stamps=log` takes log times, which `time_offset` would change; give only one of them")
        return cls(by_log, general, by_topic)


def _offset_of(text: str, value: str) -> int | None:
    """Return an offset in nanoseconds, exact to the last digit; None for ``auto``."""
    from pc2scan.core.quantities import duration_ns  # noqa: PLC0415  # few clocks are corrected

    if value == "auto":
        return None
    sign, number = _SIGNED.fullmatch(value.strip()).groups()  # type: ignore[union-attr]
    found = duration_ns(number if re.search("[a-z]", number) else f"{number}s")
    if found is None or found > _MOST_NS:
        raise UsageError(
            f"`time_offset`: {text!r} is not an offset",
            hint="write seconds (3.2, -37s), milliseconds (120ms), auto, or with a topic /rear=0.12s",
        )
    return -found if sign == "-" else found


def logged_early(one_ns: int, other_ns: int) -> bool:
    """Whether messages of only one of two topics are logged before their stamps, given their delays."""
    return min(one_ns, other_ns) < _BEFORE_NS <= max(one_ns, other_ns)


def are_doubtful(one_ns: int, other_ns: int, window_ns: int = 0) -> bool:
    """Whether the clocks of two topics probably differ.

    Parameters
    ----------
    one_ns, other_ns
        The median delays from the stamps of their messages to the log times, nanoseconds.
    window_ns
        A difference that does not matter.
    """
    limit_ns = _SMALL_NS if logged_early(one_ns, other_ns) else _OTHER_CLOCK_NS
    return abs(one_ns - other_ns) > max(limit_ns, window_ns)


def delay_observers(
    connections: Iterable[Connection], start_ns: int | None = None, stop_ns: int | None = None
) -> dict[str, Observer[Delays]]:
    """Return the observers of the delays from the stamps of topics to their log times.

    Parameters
    ----------
    connections
        Those with clouds or scans, with moving transforms, or of an IMU.
    start_ns, stop_ns
        The cut.
    """
    return {
        topic: Observer(own, _delays, _MESSAGES[own[0].ros_type in CLOUDS], start_ns, stop_ns)
        for topic, own in by_topic(connections).items()
    }


def clock_warnings(sources: Mapping[str, Observer[Delays]], others: Mapping[str, Observer[Delays]]) -> Iterator[str]:
    """Yield a warning for each source topic whose stamps are probably of another clock than those of other topics.

    Parameters
    ----------
    sources
        What was observed of the topics with clouds or scans.
    others
        ... and of those with moving transforms, or of an IMU.
    """
    known = {topic: _medians(observer.found) for topic, observer in others.items()}
    for topic, observer in sources.items():
        if not (delays := _medians(observer.found)):
            continue
        delay_ns = median_low(list(delays.values()))
        for other, by_child in known.items():
            if not by_child:
                continue
            # Localisation stamps its transforms ahead of time: the nearest one is compared.
            nearest_ns = min(by_child.values(), key=lambda each: abs(delay_ns - each))
            behind_ns = delay_ns - nearest_ns
            if are_doubtful(delay_ns, nearest_ns):
                yield (
                    f"the stamps of {topic} are {abs(behind_ns) / 1e9:.3g} s "
                    f"{'behind' if behind_ns > 0 else 'ahead of'} those of {other}, compared with their log times: if "
                    "their clocks differ, points are placed as if they were measured at another time"
                )


def _medians(messages: Iterable[Delays]) -> dict[str, int]:
    """Return the median delay of a topic, for transforms by child; nanoseconds."""
    delays: dict[str, list[int]] = {}
    for message in messages:
        for child, delay_ns in message:
            delays.setdefault(child, []).append(delay_ns)
    return {child: median_low(each) for child, each in delays.items()}


def _delays(message: RawMessage) -> Delays:
    """Return the delays from the stamps in a message to its log time, and of transforms their child frames."""
    kind, serialization = message.connection.ros_type, message.connection.serialization
    stamps: list[tuple[str, int]] = []
    if kind in TF_TYPES:
        stamps = [(child, stamp_ns) for _, child, stamp_ns, *_ in decode_transforms(message.data, serialization)]
    elif kind in STAMPED or kind in CLOUDS:
        stamps = [("", stamp_in(message.data, serialization))]
    return [(child, message.log_time_ns - stamp_ns) for child, stamp_ns in stamps]


def refuse_other_clock(
    trajectory: Trajectory, sources: Mapping[str, Observer[Delays]], first_ns: int, last_ns: int
) -> None:
    """Raise if the poses of a trajectory are of another time than all messages that need them.

    Parameters
    ----------
    sources
        What was observed of the topics that need them.
    first_ns, last_ns
        The log times of the first and the last message, nanoseconds.

    Raises
    ------
    UsageError
        The error has the times of both.
    """
    for topic, observer in sources.items():
        if not (delays := _medians(observer.found)):
            continue
        delay_ns = median_low(list(delays.values()))
        begin_ns, end_ns = first_ns - delay_ns, last_ns - delay_ns
        if trajectory.first_ns <= end_ns and trajectory.last_ns >= begin_ns:
            return
        offset = f"`time_offset={TRAJECTORY}={stamp_text(begin_ns - trajectory.first_ns)}s`"
        is_relative = trajectory.first_ns < _LONG_AGO_NS <= begin_ns
        why = "its times count from its beginning" if is_relative else "the clocks differ"
        raise UsageError(
            f"its poses are from {stamp(trajectory.first_ns)} to {stamp(trajectory.last_ns)}, {topic} is from "
            f"{stamp(begin_ns)} to {stamp(end_ns)}: no pose is of the time of a message",
            path=trajectory.name,
            hint=f"if {why}, {offset} moves the first pose to the first message",
        )


# --- Offsets between clocks ---


def measure_offsets(
    reader: Reader,
    topics: Mapping[str, Sequence[Connection]],
    tf_topics: Sequence[str] = (),
    start_ns: int | None = None,
    stop_ns: int | None = None,
) -> dict[str, tuple[int, str]]:
    """Measure how far the stamps of topics are off those of the moving transforms, or the log times without any.

    Messages are compared by their log times. A cloud is logged after its last point was measured: the offset is that of
    the message that was logged soonest. A difference that a slow driver makes is no offset.

    Parameters
    ----------
    topics
        The connections of each topic.
    tf_topics
        See `tf_connections`. If it is not clear which transforms to use, log times are.
    start_ns, stop_ns
        The cut, in whose first messages it is measured.

    Returns
    -------
    dict[str, (int, str)]
        What has to be added to the stamps of each topic, whole milliseconds in nanoseconds, and a note.
    """
    moving: list[Connection] = []
    with suppress(UsageError):
        moving = [each for each in tf_connections(reader.connections, tf_topics) if not is_static(each.topic)]
    if not moving:
        moving = [each for each in reader.connections if each.ros_type in POSES and each.ros_version is not None]
        moving = [each for each in moving if each.topic not in topics]
    ends = {topic: Observer(own, _delay_of_end, _MEASURED, start_ns, stop_ns) for topic, own in topics.items()}
    references = delay_observers(moving, start_ns, stop_ns)
    observe(reader, [*ends.values(), *references.values()])
    known = {topic: _nearest(observer.found) for topic, observer in references.items()}
    fitting = {topic: delays for topic, delays in known.items() if delays}
    reference = min(fitting, key=lambda topic: abs(median_low(fitting[topic])), default="")
    others = fitting.get(reference, [0])
    found = {}
    for topic, observer in ends.items():
        delays = observer.found
        against = f"the stamps of {reference}" if reference else "the log times"
        number = counted(len(delays), "message")
        if not delays or not are_doubtful(median_low(delays), median_low(others)):
            found[topic] = 0, f"{topic}: time_offset is 0: its first stamps fit to {against} ({number})"
            continue
        offset_ns = round((min(delays) - min(others)) / 1e6) * 1_000_000
        note = (
            f"{topic}: time_offset is {offset_ns / 1e9:.3f} s, measured against {against} in the first {number}, whose "
            f"delays differ by {(max(delays) - min(delays)) / 1e9:.3f} s; `time_offset={topic}={offset_ns / 1e9:.3f}s`"
        )
        found[topic] = offset_ns, note
    return found


def _nearest(messages: Iterable[Delays]) -> list[int]:
    """Return the delays of the child frame whose transforms are logged closest to their stamps."""
    delays: dict[str, list[int]] = {}
    for message in messages:
        for child, delay_ns in message:
            delays.setdefault(child, []).append(delay_ns)
    return min(delays.values(), key=lambda each: abs(median_low(each)), default=[])


def _delay_of_end(message: RawMessage) -> int:
    """Return the delay from the time of a message's last point to its log time; of others from their stamp."""
    kind, serialization = message.connection.ros_type, message.connection.serialization
    stamp_ns, last_s = stamp_in(message.data, serialization), 0.0
    if kind in CLOUDS:
        points = CLOUDS[kind](serialization)(message.data)
        name = next((name for name in TIME_FIELDS if name in points.fields), "")
        times = point_times(points.field(name), stamp_ns) if name else None
        if times is not None and times.size:
            last_s = float(np.fmax.reduce(times, initial=0.0))
    return message.log_time_ns - stamp_ns - round(min(last_s, _LONGEST_S) * 1e9)
