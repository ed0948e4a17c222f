"""Compares the clock of clouds with that of the transforms or the IMU that say where the robot was at their time."""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

from pc2scan.bags.observers import Observer
from pc2scan.bags.topics import by_topic
from pc2scan.core.percentiles import median, median_low
from pc2scan.errors import UsageError, stamp_text
from pc2scan.messages.clouds import CLOUDS
from pc2scan.messages.poses import POSES
from pc2scan.messages.stamps import STAMPED, stamp_in
from pc2scan.messages.tfmessage import TF_TYPES, decode_transforms
from pc2scan.model import of_types
from pc2scan.request.point_time import PointTime
from pc2scan.request.spec import TRAJECTORY
from pc2scan.text import stamp
from pc2scan.transforms.reading import tf_connections

from .measurements import times_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from pc2scan.model import Connection, RawMessage
    from pc2scan.transforms.sources import Trajectory

    from .survey import Span, Survey, TopicFacts

#: The stamps in messages, with the child frames of transforms, and the delays from these to the log times, nanoseconds.
Delays: TypeAlias = "list[tuple[str, int, int]]"

#: How many messages of each topic are read: clouds are large, and several nodes publish transforms.
CLOCK_HEADERS = 3
MOTIONS = 50

#: Clocks may differ if the delays from stamps to log times differ by this. Slow drivers delay messages, too.
_OTHER_CLOCK_NS = 500_000_000

#: No message is logged before its stamp, except by the small error of a clock. If messages of only one topic are, this
#: difference of the delays is enough.
_BEFORE_NS = -20_000_000
_SMALL_NS = 100_000_000

#: How far time scales are ahead of UTC, seconds.
_TIME_SCALES = {
    37: "PTP counts TAI, which is 37 s ahead of UTC",
    18: "GPS time is 18 s ahead of UTC",
}

#: What to type if clocks differ.
MEASURES = "`time_offset=auto` measures by how much the clocks differ, and corrects it"

_DAY_NS = 86_400_000_000_000

#: Earlier times do not count from 1970, nanoseconds.
_LONG_AGO_NS = 1_000_000_000_000_000

#: The longest time that a cloud takes, seconds.
_LONGEST_S = 1.0


def are_doubtful(one_ns: int, other_ns: int, window_ns: int = 0) -> bool:
    """Whether the clocks of two topics probably differ.

    Parameters
    ----------
    one_ns, other_ns
        The median delays from the stamps of their messages to the log times, nanoseconds.
    window_ns
        A difference that does not matter.
    """
    is_one_early = min(one_ns, other_ns) < _BEFORE_NS <= max(one_ns, other_ns)
    limit_ns = _SMALL_NS if is_one_early else _OTHER_CLOCK_NS
    return abs(one_ns - other_ns) > max(limit_ns, window_ns)


def measure_together(one: TopicFacts, other: TopicFacts) -> bool:
    """Whether the first clouds of two topics were recorded at about the same time, with stamps of one clock."""
    begin_ns = max(facts.headers[0].log_time_ns for facts in (one, other))
    end_ns = min(facts.headers[-1].log_time_ns for facts in (one, other))
    return begin_ns <= end_ns and not are_doubtful(one.delay_ns, other.delay_ns)


class Clock(NamedTuple):
    """The clock of a topic, compared with that of the rest of its recording.

    Attributes
    ----------
    other
        The topic with moving transforms that it was compared with; empty if that were the log times.
    text
        What is wrong, for users; empty if nothing is.
    time_offset
        The value of the option ``time_offset`` that corrects it.
    offset_ns
        What has to be added to its stamps, nanoseconds. A cloud is logged after its last point was measured: the offset
        is that of the message that was logged soonest.
    jitter_ns
        How far the delays of its messages differ.
    """

    other: str
    text: str = ""
    time_offset: str = ""
    offset_ns: int = 0
    jitter_ns: int = 0

    @property
    def warning(self) -> str:
        """What is wrong, and what to do."""
        return f"{self.text}; `time_offset={self.time_offset}` corrects them"


class Clocks:
    """The clocks of a recording's topics, compared in their first messages.

    Parameters
    ----------
    survey
        Asked for the messages.
    topics
        The connections of the topics.
    compared
        What says where the robot was; None: the moving transforms, or without any, all other topics.
    most
        How many messages of each topic are compared.
    """

    def __init__(
        self,
        survey: Survey,
        topics: Iterable[Connection],
        compared: Iterable[Connection] | None = None,
        most: int = CLOCK_HEADERS,
    ) -> None:
        own, connections = list(topics), survey.reader.connections
        self._clouds = survey.topics(of_types(own, CLOUDS))
        for facts in self._clouds.values():
            facts.ask(times_of(PointTime()))
        self._own = _observers(own, most, survey.span)
        motion = moving(connections, survey.frames.tf_topics) if compared is None else compared
        self._motion = _observers(motion, MOTIONS, survey.span)
        stamped = of_types(connections, STAMPED) if compared is None else []
        others = [other for other in stamped if other.ros_version and other.topic not in self._own]
        self._others = _observers(others, MOTIONS, survey.span)
        survey.observers += (*self._own.values(), *self._motion.values(), *self._others.values())

    def warnings(self) -> list[str]:
        """Return warnings about topics with another clock than the transforms or the IMU."""
        return [clock.warning for clock in self.findings().values() if clock.other]

    def findings(self) -> dict[str, Clock]:
        """Return the clocks with which something is wrong."""
        return {topic: clock for topic, clock in self.compare().items() if clock.text}

    def compare(self) -> dict[str, Clock]:
        """Return the clocks of topics, once the survey was read.

        Stamps are compared with those of moving transforms; without any, with those of other topics. If all stamps are
        far from the log times (a recording that was played back), none are wrong. A difference that a slow driver makes
        is none.
        """
        clocks = {}
        motion, others = _nearest_of(self._motion), _nearest_of(self._others)
        medians = {topic: median_low(delays_ns) for topic, delays_ns in motion.items()}
        for topic, observer in self._own.items():
            own = [delay for message in observer.values for delay in message]
            # Stamps that are all 0 are of no clock.
            if not any(stamp_ns for _, stamp_ns, _ in own):
                continue
            delay_ns = median_low([delay_ns for _, _, delay_ns in own])
            other = min(medians, key=lambda name: abs(delay_ns - medians[name]), default="")
            alike = (delays for delays in others.values() if not are_doubtful(delay_ns, median_low(delays)))
            is_played = not motion and any(alike)
            is_doubtful = are_doubtful(delay_ns, medians.get(other, 0)) and not is_played
            clocks[topic] = self._doubtful(topic, own, other, motion.get(other, [0])) if is_doubtful else Clock(other)
        return clocks

    def _doubtful(self, topic: str, own: Delays, other: str, compared: Sequence[int]) -> Clock:
        """Return the clock of a topic, given the delays of its messages, and those of the topic it differs from."""
        delays = [delay_ns for _, _, delay_ns in own]
        behind_ns = median_low(delays) - median_low(compared)
        against = f"those of {other}, compared with their log times" if other else "their log times"
        how = f"{_duration_text(behind_ns)} {'behind' if behind_ns > 0 else 'ahead of'} {against}"
        scale = next((s for s in _TIME_SCALES if abs(behind_ns + s * 1_000_000_000) < _OTHER_CLOCK_NS), None)
        cause = "" if scale is None else f" ({_TIME_SCALES[scale]})"
        if behind_ns > _DAY_NS and 0 <= own[0][1] < _LONG_AGO_NS:
            cause = " (its clock counts from its start)"
        text, option = f"the stamps of {topic} are {how}{cause}", "auto" if scale is None else f"-{scale}s"
        offset_ns = min(delays) - self._last_point_ns(topic) - min(compared)
        return Clock(other, text, option, offset_ns, max(delays) - min(delays))

    def _last_point_ns(self, topic: str) -> int:
        """Return how long after its stamp the last point of a cloud is measured, nanoseconds; 0 if it is not known."""
        times = self._clouds[topic].values(times_of(PointTime())) if topic in self._clouds else []
        return round(1e9 * min(max(0.0, median([own.high for own in times] or [0.0])), _LONGEST_S))


def _nearest_of(observers: Mapping[str, Observer[Delays]]) -> dict[str, list[int]]:
    """Return the delays of each topic that has messages; see `_nearest`."""
    delays = {topic: _nearest(observer.values) for topic, observer in observers.items()}
    return {topic: values for topic, values in delays.items() if values}


def _duration_text(duration_ns: int) -> str:
    seconds = abs(duration_ns) / 1e9
    return f"{seconds / 86400:,.0f} days" if seconds > 2 * 86400 else f"{seconds:.3g} s"


def _observers(connections: Iterable[Connection], most: int, span: Span) -> dict[str, Observer[Delays]]:
    return {
        topic: Observer(own, _delays, most, span.start_ns, span.stop_ns) for topic, own in by_topic(connections).items()
    }


def _delays(message: RawMessage) -> Delays:
    """Return the child frames and the stamps of transforms, or the stamp of another message, and the delays."""
    kind, serialization = message.connection.ros_type, message.connection.serialization
    if kind in TF_TYPES:
        transforms = decode_transforms(message.data, serialization)
        return [(child, stamp_ns, message.log_time_ns - stamp_ns) for _, child, stamp_ns, *_ in transforms]
    stamp_ns = stamp_in(message.data, serialization)
    return [("", stamp_ns, message.log_time_ns - stamp_ns)]


def refuse_other_clock(trajectory: Trajectory, topics: Iterable[TopicFacts], span: Span, end_ns: int | None) -> None:
    """Raise if the poses of a trajectory are of another time than the messages that need them.

    Parameters
    ----------
    topics
        Facts of these messages: their headers.
    span
        The cut.
    end_ns
        The log time of the last message; None if it is not known.

    Raises
    ------
    UsageError
        The error has the times of both.
    """
    last_ns = min((time_ns for time_ns in (span.stop_ns, end_ns) if time_ns is not None), default=span.first_ns)
    for facts in topics:
        if not facts.headers:
            continue
        begin_ns, end_ns = span.first_ns - facts.delay_ns, last_ns - facts.delay_ns
        if trajectory.first_ns <= end_ns and trajectory.last_ns >= begin_ns:
            return
        offset = f"`time_offset={TRAJECTORY}={stamp_text(begin_ns - trajectory.first_ns)}s`"
        raise UsageError(
            f"its poses are from {stamp(trajectory.first_ns)} to {stamp(trajectory.last_ns)}, {facts.topic} is from "
            f"{stamp(begin_ns)} to {stamp(end_ns)}: no pose has the time of a message",
            path=trajectory.name,
            hint=f"if the clocks differ, {offset} moves the first pose to the first message",
        )


def moving(connections: Sequence[Connection], tf_topics: Sequence[str]) -> list[Connection]:
    """Return the connections with moving transforms; without any, or if it is not clear which, those with poses."""
    transforms: list[Connection] = []
    with suppress(UsageError):
        transforms = [connection for connection in tf_connections(connections, tf_topics) if not connection.is_static]
    return transforms or [poses for poses in of_types(connections, POSES) if poses.ros_version is not None]


def _nearest(messages: Iterable[Delays]) -> list[int]:
    """Return the delays of the child frame whose transforms are logged closest to their stamps."""
    delays: dict[str, list[int]] = {}
    for message in messages:
        for child, _, delay_ns in message:
            delays.setdefault(child, []).append(delay_ns)
    return min(delays.values(), key=lambda values: abs(median_low(values)), default=[])
