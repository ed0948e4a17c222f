"""Compares the clock of clouds with that of the transforms or the IMU that say where the robot was at their time."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

from pc2scan.bags.observers import Observer
from pc2scan.bags.topics import by_topic, is_static
from pc2scan.core.percentiles import median_low
from pc2scan.messages.imu import IMU, decode_imu
from pc2scan.messages.tfmessage import TF_TYPES, decode_transforms
from pc2scan.tf.reading import tf_connections

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    from pc2scan.model import Connection, RawMessage
    from pc2scan.tf.placing import FrameOptions

    from .options import ScanSpec
    from .survey import Survey, TopicFacts

#: Delays from stamps in a message to its log time, nanoseconds, with the child frames of transforms.
Delays: TypeAlias = "list[tuple[str, int]]"

#: How many messages of each topic are read: clouds are large, and several nodes publish transforms.
CLOCK_HEADERS = 3
_MOTIONS = 50

#: Clocks may differ if the delays from stamps to log times differ by this. Slow drivers delay messages, too.
_OTHER_CLOCK_NS = 500_000_000

#: No message is logged before its stamp, except by the small error of a clock. If messages of only one topic are, this
#: difference of the delays is enough.
_BEFORE_NS = -20_000_000
_SMALL_NS = 100_000_000


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


def ask_motion(survey: Survey, frames: FrameOptions, spec: ScanSpec) -> dict[str, Observer[Delays]]:
    """Ask for the delays of what says where the robot was: moving transforms, and an IMU; return their observers."""
    connections = survey.reader.connections
    found: list[Connection] = []
    if spec.fixed_frame:
        found += (each for each in tf_connections(connections, frames.tf_topics) if not is_static(each.topic))
    if spec.imu_request:
        name = spec.imu_request.topic.strip("/")
        found += (each for each in connections if each.ros_type == IMU and each.topic.strip("/") == name)
    start_ns, stop_ns = survey.span.start_ns, survey.span.stop_ns
    observers = {topic: Observer(own, _delays, _MOTIONS, start_ns, stop_ns) for topic, own in by_topic(found).items()}
    survey.observers += observers.values()
    return observers


def clock_warnings(topics: Iterable[TopicFacts], motion: Mapping[str, Observer[Delays]]) -> Iterator[str]:
    """Yield a warning for each topic whose stamps are probably of another clock than those of what says where it was.

    Parameters
    ----------
    topics
        Facts of topics with clouds or scans: their headers.
    motion
        What was observed of the topics with moving transforms, or of an IMU.
    """
    known = {topic: _medians(observer.found) for topic, observer in motion.items()}
    for facts in topics:
        if not facts.headers:
            continue
        delay_ns = median_low([each.delay_ns for each in facts.headers[:CLOCK_HEADERS]])
        for other, by_child in known.items():
            if not by_child:
                continue
            # Localisation stamps its transforms ahead of time: the nearest one is compared.
            nearest_ns = min(by_child.values(), key=lambda each: abs(delay_ns - each))
            behind_ns = delay_ns - nearest_ns
            if are_doubtful(delay_ns, nearest_ns):
                yield (
                    f"the stamps of {facts.topic} are {abs(behind_ns) / 1e9:.3g} s "
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
    elif kind == IMU:
        stamps = [("", decode_imu(message.data, serialization).stamp_ns)]
    return [(child, message.log_time_ns - stamp_ns) for child, stamp_ns in stamps]
