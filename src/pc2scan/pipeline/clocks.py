"""Compares the clock of clouds with that of the transforms or the IMU that say where the robot was at their time."""

from __future__ import annotations

from contextlib import closing
from itertools import islice
from typing import TYPE_CHECKING

from pc2scan.core.percentiles import median_low
from pc2scan.errors import MessageError
from pc2scan.messages.clouds import CLOUDS
from pc2scan.messages.imu import IMU, decode_imu
from pc2scan.messages.laserscan import LASERSCAN, decode_laserscan
from pc2scan.messages.tfmessage import TF_TYPES, decode_transforms

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    from pc2scan.bags.reader import Reader
    from pc2scan.model import Connection, RawMessage

    from .items import Span

#: How many messages of each topic are read: clouds are large, and several nodes publish transforms.
_MESSAGES = {True: 3, False: 50}

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


def clock_warnings(
    reader: Reader, sources: Iterable[Connection], others: Iterable[Connection], span: Span
) -> Iterator[str]:
    """Yield a warning for each source topic whose stamps are probably of another clock than those of other topics.

    Parameters
    ----------
    sources
        The connections with clouds or scans.
    others
        The connections with moving transforms, or of an IMU.
    span
        The cut.
    """
    own = _delays(reader, sources, span)
    known = _delays(reader, others, span)
    for topic, delays in own.items():
        delay_ns = median_low(list(delays.values()))
        for other, by_child in known.items():
            # Localisation stamps its transforms ahead of time: the nearest one is compared.
            nearest_ns = min(by_child.values(), key=lambda each: abs(delay_ns - each))
            behind_ns = delay_ns - nearest_ns
            if are_doubtful(delay_ns, nearest_ns):
                yield (
                    f"the stamps of {topic} are {abs(behind_ns) / 1e9:.3g} s "
                    f"{'behind' if behind_ns > 0 else 'ahead of'} those of {other}, compared with their log times: if "
                    "their clocks differ, points are placed as if they were measured at another time"
                )


def _delays(reader: Reader, connections: Iterable[Connection], span: Span) -> Mapping[str, Mapping[str, int]]:
    """Return the median delay from stamp to log time of each topic, for transforms by child; nanoseconds."""
    topics: dict[str, list[Connection]] = {}
    for connection in connections:
        topics.setdefault(connection.topic, []).append(connection)
    found: dict[str, dict[str, int]] = {}
    for topic, own in topics.items():
        delays: dict[str, list[int]] = {}
        most = _MESSAGES[own[0].ros_type in CLOUDS]
        with closing(reader.messages(own, span.start_ns, span.stop_ns)) as messages:
            for message in islice(messages, most):
                try:
                    for child, stamp_ns in _stamps(message):
                        delays.setdefault(child, []).append(message.log_time_ns - stamp_ns)
                except MessageError:
                    # Reported where the message is used.
                    continue
        if delays:
            found[topic] = {child: median_low(each) for child, each in delays.items()}
    return found


def _stamps(message: RawMessage) -> Iterator[tuple[str, int]]:
    """Yield the stamps in a message, and of transforms their child frame."""
    kind, serialization = message.connection.ros_type, message.connection.serialization
    if kind in TF_TYPES:
        yield from ((child, stamp_ns) for _, child, stamp_ns, *_ in decode_transforms(message.data, serialization))
    elif kind == IMU:
        yield "", decode_imu(message.data, serialization).stamp_ns
    elif kind == LASERSCAN:
        yield "", decode_laserscan(message.data, serialization).stamp_ns
    elif kind in CLOUDS:
        yield "", CLOUDS[kind](serialization)(message.data).stamp_ns
