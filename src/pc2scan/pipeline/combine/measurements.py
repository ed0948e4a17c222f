"""Measures the first messages of topics that become scans together: their periods, and whether they share a clock."""

from __future__ import annotations

import math
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

from pc2scan.bags.observers import Observer, observe
from pc2scan.core.percentiles import median_low
from pc2scan.core.timing import median_interval_ns
from pc2scan.errors import ParameterError, UsageError, name_list
from pc2scan.messages.clouds import CLOUDS
from pc2scan.messages.laserscan import LASERSCAN, LaserScan, decode_laserscan
from pc2scan.pipeline.conversion import Measurements
from pc2scan.tf.clocks import are_doubtful, logged_early

from .grouping import Grouper
from .rules import Interval, Nearest, Recent

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

    from pc2scan.bags.reader import Reader
    from pc2scan.core.points import Points
    from pc2scan.model import Buffer, Connection, RawMessage
    from pc2scan.pipeline.items import Span
    from pc2scan.pipeline.measurements import FirstCloud
    from pc2scan.pipeline.options import Combining
    from pc2scan.pipeline.plan import Combination
    from pc2scan.tf.placing import Placer

    from .conversion import Contribution
    from .rules import Rule

#: How many messages of a topic are read to measure its period, and how many are needed at least.
_LOOKED_AT = 6
_FEWEST = 3

#: Half a period, nanoseconds, for topics without two different stamps.
_HALF_PERIOD_NS = 50_000_000

#: Two topics have different clocks if the delays from their stamps to their log times differ by this.
_SURELY_ANOTHER_NS = 2_000_000_000

#: At the beginning of each of so many parts of the recording, clocks are compared that differ in the first messages.
_QUARTERS = 4

#: A window of more periods was probably meant in milliseconds.
_MOST_PERIODS = 5

#: So are seconds in one scan, if they are this long and of more messages of a topic.
_LONG_NS = 10_000_000_000
_MOST_MESSAGES = 300

#: Numbers without a unit that may be meant as numbers of clouds.
_FEW = range(2, 100)

#: The fields that the beams of a LaserScan have.
_BEAM_FIELDS = ("x", "y", "z", "intensity", "index")


class _TopicStart(NamedTuple):
    """The first messages of a topic: stamps, delays from stamp to log time, and angle increments of LaserScans."""

    stamps: list[int]
    delays: list[int]
    increments: list[float]

    @property
    def period_ns(self) -> int | None:
        """The median interval."""
        return median_interval_ns(self.stamps)


class MessageHeader(NamedTuple):
    """The times of a message, and the angle increment of a LaserScan."""

    topic: str
    log_time_ns: int
    stamp_ns: int
    increment: float | None


class CombinationObservers(NamedTuple):
    """Observers of the topics of a combination.

    Attributes
    ----------
    connections
        The connections of each topic.
    span
        The cut.
    clouds
        Of the first clouds of each topic, if anything is measured in them.
    together
        Of the first messages of all topics; None if they are not needed.
    late
        Of the first messages of each topic, if there are too few of it among those.
    """

    connections: Mapping[str, Sequence[Connection]]
    span: Span
    clouds: Mapping[str, Observer[FirstCloud]]
    together: Observer[MessageHeader] | None
    late: Mapping[str, Observer[MessageHeader]]

    @property
    def all(self) -> list[Observer[Any]]:
        """All of them."""
        return [*self.clouds.values(), *([] if self.together is None else [self.together]), *self.late.values()]


def source_observers(
    combination: Combination, connections: Sequence[Connection], placer: Placer | None, span: Span
) -> CombinationObservers:
    """Return the observers of what scans of several messages need.

    Parameters
    ----------
    connections
        The connections of the combination's sources.
    placer
        See `pc2scan.pipeline.measurements.cloud_observers`.
    span
        The cut.

    Raises
    ------
    ParameterError
        If a field is requested that the beams of LaserScans do not have.
    """
    spec, topics = combination.spec, combination.sources
    asked, params = spec.combining, spec.params
    own = {topic: [each for each in connections if each.topic == topic] for topic in topics}
    clouds = {topic: [each for each in found if each.ros_type != LASERSCAN] for topic, found in own.items()}
    flat = [topic for topic in topics if len(clouds[topic]) < len(own[topic])]
    measured: Mapping[str, Observer[FirstCloud]] = {}
    if spec.needs_measuring:
        from pc2scan.pipeline.measurements import cloud_observers  # noqa: PLC0415  # only if something is to be measured

        others = [each for found in clouds.values() for each in found]
        measured = cloud_observers(others, spec, placer, span.start_ns, span.stop_ns)
    if not (
        len(topics) > 1
        or asked.every_ns
        or asked.span_ns >= _LONG_NS
        or (flat and "auto" in (params.scan_time, params.beams))
    ):
        return CombinationObservers(own, span, measured, None, {})
    everything = [connection for found in own.values() for connection in found]
    together = _header_observer(everything, span.start_ns, span.stop_ns, _LOOKED_AT * len(own))

    def late(topic: str) -> Observer[MessageHeader]:
        found = _header_observer(own[topic], span.start_ns, span.stop_ns, _LOOKED_AT)
        found.is_needless = lambda: together.is_done and sum(each.topic == topic for each in together.found) >= _FEWEST
        return found

    return CombinationObservers(own, span, measured, together, {topic: late(topic) for topic in own})


def measure_sources(
    reader: Reader, combination: Combination, observers: CombinationObservers, placer: Placer
) -> tuple[Measurements, Callable[[], Grouper[Contribution]] | None, list[str], list[str]]:
    """Measure what scans of several messages need.

    Parameters
    ----------
    reader
        The recording: later messages are read if the clocks of the first ones differ.
    observers
        What was observed of the first messages.

    Returns
    -------
    Measured
        The measurements of the leading topic.
    callable
        Makes the grouper of messages; None: each message becomes a scan by itself.
    list of str, list of str
        Notes and warnings.

    Raises
    ------
    ParameterError
        If a field is missing, or a parameter that is ``auto`` cannot be measured.
    UsageError
        If the stamps of the topics are of different clocks.
    """
    spec, topics = combination.spec, combination.sources
    asked = spec.combining
    notes: list[str] = []
    timing: Mapping[str, Measurements] = {}
    if spec.needs_measuring:
        from pc2scan.pipeline.measurements import measure  # noqa: PLC0415  # only if something is to be measured

        timing, notes = measure(observers.clouds, spec, placer)
        kept = [note for note in notes if note.startswith(f"{topics[0]}: ")]
        notes = kept
    flat = [topic for topic in topics if any(each.ros_type == LASERSCAN for each in observers.connections[topic])]
    if flat:
        _require_fields(flat, combination)
    firsts = _first_messages(observers)
    lead = firsts.get(topics[0])
    found = timing.get(topics[0]) or _of_scans(combination, lead, notes)
    if asked.every_ns and spec.origins.get("scan_time", "default") == "default":
        found = Measurements(asked.every_ns / 1e9, found.time_increment, 0, found.azimuth_step)
    warnings = _doubtful(asked, reader, topics, firsts)
    later = partial(_sample_delays, reader, observers)
    grouper: Callable[[], Grouper[Contribution]]
    if asked.accumulates:
        # The first message is in the middle of an interval: near its edge, jitter would move messages to the next.
        half_ns = 0 if lead is None else (lead.period_ns or 0) // 2
        rule: Rule = Recent(asked.every_ns, half_ns, asked.span_ns, asked.count)
        if not (asked.span_ns or asked.count):
            rule = Interval(asked.every_ns, half_ns)
        grouper = partial(Grouper, rule, len(topics))
        return found, grouper, notes, [*warnings, *_clocks(firsts, topics, None, later)]
    if len(topics) == 1:
        return found, None, notes, warnings
    windows = _windows(firsts, topics, asked.window_ns)
    warnings += _clocks(firsts, topics, windows, later)
    joined = ", ".join(
        f"{topic} (within {window / 1e9:.4g} s)" for topic, window in zip(topics[1:], windows[1:], strict=True)
    )
    notes.append(f"{combination.target}: has the stamps of {topics[0]}, and the nearest messages of {joined}")
    grouper = partial(Grouper, Nearest(windows_ns=tuple(windows)), len(topics), apart_ns=asked.window_ns or 0)
    return found, grouper, notes, warnings


def _doubtful(asked: Combining, reader: Reader, topics: Sequence[str], firsts: Mapping[str, _TopicStart]) -> list[str]:
    """Return warnings of times that were probably meant in milliseconds."""
    start_ns, end_ns = reader.summary.start_ns, reader.summary.end_ns
    length_ns = 0 if start_ns is None or end_ns is None else end_ns - start_ns
    found = []
    gathered_ns = asked.span_ns or (0 if asked.count else asked.every_ns)
    for name, value_ns in (("every", asked.every_ns), ("accumulate", asked.span_ns), ("window", asked.window_ns or 0)):
        seconds = value_ns / 1e9
        why = ""
        if seconds >= 1 and value_ns > length_ns > 0:
            why = f"the recording takes {length_ns / 1e9:.3g} s"
        elif name == "window" and seconds >= 1:
            periods = [firsts[topic].period_ns or value_ns for topic in topics if topic in firsts]
            if periods and value_ns > _MOST_PERIODS * max(periods):
                why = f"messages of {topics[0]} come every {periods[0] / 1e9:.3g} s"
        elif value_ns == gathered_ns >= _LONG_NS:
            why = _crowded(firsts, topics[0], value_ns, _MOST_MESSAGES)
        meant = f"milliseconds were meant: `{name}={seconds:g}ms`" if why else ""
        if name == "accumulate" and asked.is_bare and seconds in _FEW:
            why = why or _crowded(firsts, topics[0], value_ns, 1)
            meant += (", if clouds: " if meant else "clouds were meant: ") + f"`{name}={seconds:g}clouds`"
        if why:
            found.append(f"`{name}` is {seconds:g} s, but {why}; if {meant}")
    return found


def _crowded(firsts: Mapping[str, _TopicStart], topic: str, span_ns: int, most: int) -> str:
    """Return how many messages a scan of this length has, if these are more than ``most``; else nothing."""
    period_ns = firsts[topic].period_ns if topic in firsts else None
    if not period_ns or span_ns <= most * period_ns:
        return ""
    return f"messages of {topic} come every {period_ns / 1e9:.3g} s: {span_ns // period_ns:,} in a scan"


def _first_messages(observers: CombinationObservers) -> dict[str, _TopicStart]:
    """Return the first messages of each topic: those of all topics together, or its own if they have too few."""
    if observers.together is None:
        return {}
    found = {topic: _start(topic, observers.together) for topic in observers.connections}
    return {
        topic: start if len(start.stamps) >= _FEWEST else _start(topic, observers.late[topic])
        for topic, start in found.items()
    }


def _start(topic: str, observer: Observer[MessageHeader]) -> _TopicStart:
    """Return the first messages of a topic among those that were observed."""
    own = [each for each in observer.found if each.topic == topic]
    return _TopicStart(
        [each.stamp_ns for each in own],
        [each.log_time_ns - each.stamp_ns for each in own],
        [each.increment for each in own if each.increment is not None],
    )


def _header_observer(
    connections: Sequence[Connection], start_ns: int | None, stop_ns: int | None, most: int
) -> Observer[MessageHeader]:
    decoders: dict[int, Callable[[Buffer], Points | LaserScan]] = {
        each.id: partial(decode_laserscan, serialization=each.serialization)
        if each.ros_type == LASERSCAN
        else CLOUDS[each.ros_type](each.serialization)
        for each in connections
    }

    def header(message: RawMessage) -> MessageHeader:
        decoded = decoders[message.connection.id](message.data)
        increment = abs(decoded.angle_increment) if isinstance(decoded, LaserScan) else None
        return MessageHeader(message.connection.topic, message.log_time_ns, decoded.stamp_ns, increment)

    return Observer(connections, header, most, start_ns, stop_ns)


def _windows(firsts: Mapping[str, _TopicStart], topics: Sequence[str], window_ns: int | None) -> list[int]:
    """Return the window of each topic: half its own period or half the leading topic's, whichever is longer."""
    if window_ns is not None:
        return [window_ns] * len(topics)
    periods = [firsts[topic].period_ns or 2 * _HALF_PERIOD_NS for topic in topics]
    return [max(period, periods[0]) // 2 for period in periods]


def _sample_delays(reader: Reader, observers: CombinationObservers, topics: Sequence[str]) -> Iterator[list[int]]:
    """Yield the median delays of topics at some places of the recording where all of them have messages."""
    start_ns, stop_ns = observers.span.start_ns, observers.span.stop_ns
    first_ns, last_ns = reader.summary.start_ns, reader.summary.end_ns
    if first_ns is None or last_ns is None:
        return
    first_ns = first_ns if start_ns is None else max(first_ns, start_ns)
    last_ns = last_ns if stop_ns is None else min(last_ns, stop_ns)
    for quarter in range(1, _QUARTERS):
        begin_ns = first_ns + (last_ns - first_ns) * quarter // _QUARTERS
        own = {topic: _header_observer(observers.connections[topic], begin_ns, stop_ns, _LOOKED_AT) for topic in topics}
        observe(reader, own.values())
        delays = [_start(topic, observer).delays for topic, observer in own.items()]
        if all(delays):
            yield list(map(median_low, delays))


def _clocks(
    firsts: Mapping[str, _TopicStart],
    topics: Sequence[str],
    windows: Sequence[int] | None,
    later: Callable[[Sequence[str]], Iterable[Sequence[int]]],
) -> list[str]:
    """Compare the clocks of the topics: return warnings if they may differ, and raise if they do.

    ``later`` yields the delays of topics at places after the first messages: a clock that is wrong only at first is no
    other clock.
    """
    warnings = []
    lead = firsts.get(topics[0])
    for number, topic in enumerate(topics[1:], 1):
        own = firsts.get(topic)
        if lead is None or own is None or not lead.stamps or not own.stamps:
            continue
        own_ns, lead_ns = median_low(own.delays), median_low(lead.delays)
        window_ns = 0 if windows is None else windows[number]
        if abs(own_ns - lead_ns) > max(window_ns, _SURELY_ANOTHER_NS):
            places = [(own_ns, lead_ns), *later((topic, topics[0]))]
            own_ns, lead_ns = min(places, key=lambda each: abs(each[0] - each[1]))
        behind_ns = own_ns - lead_ns
        if not are_doubtful(own_ns, lead_ns, window_ns):
            continue
        how = f"{abs(behind_ns) / 1e9:.4g} s {'behind' if behind_ns > 0 else 'ahead of'}"
        said = f"the stamps of {topic} are {how} those of {topics[0]}, compared with their log times"
        if abs(behind_ns) > _SURELY_ANOTHER_NS:
            wider = math.ceil(abs(behind_ns) / 1e8) / 10
            still = "" if windows is None else f"; or `window={wider:g}`, if the robot did not move"
            raise UsageError(
                f"{said}: they are of different clocks",
                hint=f"convert them to scans of their own: `topics={topic}:=/scan_2`{still}",
            )
        if logged_early(own_ns, lead_ns):
            which = topic if behind_ns < 0 else topics[0]
            early = f"messages of {which} are logged {-min(own_ns, lead_ns) / 1e9:.3g} s before their stamps"
            warnings.append(f"{said}: {early}, so their clocks differ, and a scan has what was measured that far apart")
            continue
        warnings.append(f"{said}: if their clocks differ, a scan has what was measured that far apart")
    return warnings


def _of_scans(combination: Combination, lead: _TopicStart | None, notes: list[str]) -> Measurements:
    """Return the measurements of a leading topic that has LaserScans, or no messages."""
    params, topic = combination.spec.params, combination.sources[0]
    scan_time, step = params.scan_time, 0.0
    if scan_time == "auto":
        period_ns = None if lead is None else lead.period_ns
        scan_time = (period_ns or 0) / 1e9
        notes.append(f"{topic}: scan_time is {scan_time:.6g} s, the median interval of its first stamps")
    if params.beams == "auto":
        known = [each for each in lead.increments if 0 < each < math.inf] if lead is not None else []
        if not known:
            raise ParameterError(
                f"beams is auto, but no scan on {topic} has an angle_increment",
                name="beams",
                hint="give a number of `beams`, or an `angle_increment`",
            )
        step = median_low(known)
        count = params.at_resolution(step).layout.count
        notes.append(f"{topic}: beams is {count:,}: the scans have one every {math.degrees(step):.4g} deg")
    return Measurements(scan_time, 0.0, 0, step)


def _require_fields(flat: Sequence[str], combination: Combination) -> None:
    """Raise if a requested field is not one that the beams of LaserScans have."""
    spec = combination.spec
    name = spec.params.intensity_field
    asked = [("intensity_field", f"intensity_field is {name!r}", name)] if name else []
    asked += [
        (each.name, f"`{each.name}` needs the field {field!r}", field) for each in spec.filters for field in each.fields
    ]
    for option, request, field in asked:
        if field not in _BEAM_FIELDS:
            raise ParameterError(
                f"{request}, which the scans on {name_list(flat)} do not have",
                name=option,
                hint="the beams of a LaserScan have intensity, index, x and y",
            )
