"""Estimates what a conversion would do, without writing: its topics, and about how many messages and bytes."""

from __future__ import annotations

from contextlib import closing
from typing import TYPE_CHECKING, Any, NamedTuple, cast

from pc2scan.errors import MessageError
from pc2scan.result import Skipped

from .checks import result_findings
from .declarations import Declarations
from .first_clouds import Candidate, SharedSample
from .refusals import TransformCheck
from .routes import count_skipped, open_routes

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from pc2scan.bags.destinations import Destination
    from pc2scan.bags.reader import Reader
    from pc2scan.model import Connection

    from .conversion import Conversion, EncodedMessage
    from .first_clouds import FirstClouds
    from .options import ConvertOptions
    from .plan import Combination, Plan
    from .report import Report
    from .routes import OpenRoute
    from .scan_spec import ScanSpec

#: How many of the first messages of a topic are converted, not counting those that fail, and how many are read at most,
#: if there are transforms.
_CONVERTED = 3
_LOOKED_AT = 10
#: How many of the first messages of all other topics are read to estimate the sizes of the rest.
_MEASURED = 500


#: Bytes that an index entry takes, the description of a topic, and the fixed parts of a container.
_INDEXED = 40
_DECLARED = 1_500
_FRAME = 4_000


class _MeanSizes(NamedTuple):
    """The mean size of a connection's messages: as read, as passed on, and as converted."""

    read: float
    passed: float
    made: float


def forecast(
    reader: Reader,
    plan: Plan,
    target: Destination,
    conversions: Mapping[ScanSpec | Combination, Conversion],
    options: ConvertOptions,
    start_ns: int | None,
    stop_ns: int | None,
    report: Report,
    firsts: FirstClouds,
) -> float:
    """Fill in a report like a conversion, estimated from the indexes and the first messages.

    Its points and skipped messages are those of the first messages. Returns an estimate of the written messages' bytes
    before compression.

    Raises
    ------
    TransformError
        If no transforms connect any message with the target frame.
    MessageError
        With ``on_error`` ``fail``, if one of the first messages cannot be converted.
    """
    declared = Declarations()
    routes = open_routes(plan.routes, conversions, target, target.same_kind(reader.summary), options, declared, report)
    routes = count_skipped(routes, reader, start_ns, stop_ns)
    try:
        sizes: dict[int, _MeanSizes] = _converted_sizes(
            reader, routes, options, start_ns, stop_ns, report, firsts, is_packed=target.compression != "none"
        )
        firsts.finish()
    finally:
        report.add(firsts.warnings, firsts.notes, firsts.advice)
    report.damage += reader.damage
    report.add(*result_findings(report))
    counts = reader.counts([route.connection for route in routes.values()], start_ns, stop_ns)
    _fill_in(routes, counts, report)
    sizes |= _correct_intervals(reader, routes, sizes, start_ns, stop_ns)
    others = [key for key in routes if key not in sizes]
    sizes |= _other_sizes(reader, [routes[key].connection for key in others])
    report.bytes_written = _written_size(reader, target, routes, counts, sizes)
    return sum((counts.get(key) or 0) * (size.passed + size.made + _INDEXED) for key, size in sizes.items())


def _converted_sizes(
    reader: Reader,
    routes: Mapping[int, OpenRoute],
    options: ConvertOptions,
    start_ns: int | None,
    stop_ns: int | None,
    report: Report,
    firsts: FirstClouds,
    *,
    is_packed: bool,
) -> dict[int, _MeanSizes]:
    """Convert the first messages of each topic."""
    converting = {key: route for key, route in routes.items() if route.convert is not None}
    unconnected = TransformCheck(firsts.warn)
    sizes: dict[int, _MeanSizes] = {}
    for key, route in converting.items():
        connection, read, sizes_made = route.connection, list[int](), list[int]()
        with closing(reader.messages([connection], start_ns, stop_ns)) as messages:
            for message in messages:
                read.append(len(message.data))
                assert route.convert is not None  # only such routes are chosen
                converted: Sequence[EncodedMessage | MessageError]
                try:
                    converted = route.convert(message.data)
                except MessageError as err:
                    converted = [err] * (1 + max(output.place for output in route.outputs))
                errors = {id(error): error for error in converted if isinstance(error, MessageError)}
                for error in errors.values():
                    error.topic = connection.topic
                    if options.on_error == "fail":
                        raise error
                    skipped = Skipped(
                        connection.topic, message.log_time_ns, error.stamp_ns, error.message, error.hint or ""
                    )
                    report.list_skipped(skipped)
                size = 0
                for output in route.outputs:
                    output.report.messages_in += 1
                    result = converted[output.place]
                    if output.combiner is not None and not isinstance(result, MessageError):
                        if output.handle < 0:
                            # Its size counts with the topic that leads the scan.
                            output.report.messages_out += 1
                            continue
                        result = output.combiner.alone(cast("Any", result))
                    if not isinstance(result, MessageError):
                        data = (result.used or b"") if output.used else result.data
                        size += _compressed_size(data) if is_packed else len(data)
                        output.report.messages_out += 1
                    if not isinstance(result, MessageError) and not output.used:
                        output.report.points += result.counts
                        output.report.empty_scans += result.empty
                        _judge(result, message.log_time_ns)
                failed = all(isinstance(result, MessageError) for result in converted)
                if not failed:
                    sizes_made.append(size)
                unconnected.note(connection.topic, next(iter(errors.values())) if failed else None)
                # Only all messages show that no transforms connect them.
                if len(sizes_made) == _CONVERTED or (len(read) >= _LOOKED_AT and not unconnected.is_possible):
                    break
        kept = _mean(read) if route.passing_handle >= 0 else 0.0
        sizes[key] = _MeanSizes(_mean(read), kept, _mean(sizes_made))
    unconnected.finish()
    return sizes


def _judge(result: EncodedMessage, log_time_ns: int) -> None:
    """Add a cloud to the checks of the first ones, once if it is written to several topics."""
    sample, result.sample = result.sample, None
    if isinstance(sample, Candidate):
        sample = sample.sample(log_time_ns)
    if isinstance(sample, SharedSample):
        sample.add(result.counts)


def _compressed_size(data: bytes) -> int:
    """Return an estimate of a message's size after compression."""
    import zlib  # noqa: PLC0415  # dry runs only

    return len(zlib.compress(data, 1))


def _other_sizes(reader: Reader, connections: Sequence[Connection]) -> dict[int, _MeanSizes]:
    """Return the mean sizes of messages that are not converted, from the first messages of the recording."""
    found: dict[int, list[int]] = {connection.id: [] for connection in connections}
    if connections:
        with closing(reader.messages(connections)) as messages:
            for _, message in zip(range(_MEASURED), messages, strict=False):
                found[message.connection.id].append(len(message.data))
    return {key: _MeanSizes(_mean(sizes), _mean(sizes), 0.0) for key, sizes in found.items()}


def _mean(values: Sequence[int]) -> float:
    return sum(values) / len(values) if values else 0.0


def _fill_in(routes: Mapping[int, OpenRoute], counts: Mapping[int, int], report: Report) -> None:
    """Replace the counts of the sampled messages by the counts of all messages."""
    entries = {id(entry): entry for route in routes.values() for entry in route.reports}
    for entry in entries.values():
        entry.messages_in = entry.messages_out = 0
    uncounted = []
    for key, route in routes.items():
        count = counts.get(key, route.connection.message_count)
        if count is None:
            uncounted.append(route.connection.topic)
            continue
        for entry in route.reports:
            entry.messages_in += count
            entry.messages_out += count if route.writes else 0
    if uncounted:
        report.notes.append(f"no index counts the messages on {', '.join(sorted(set(uncounted)))}")


def _correct_intervals(
    reader: Reader,
    routes: Mapping[int, OpenRoute],
    sizes: Mapping[int, _MeanSizes],
    start_ns: int | None,
    stop_ns: int | None,
) -> dict[int, _MeanSizes]:
    """Correct the number of scans, and their mean size, if there is one scan for each interval of time."""
    first_ns, last_ns = reader.summary.start_ns, reader.summary.end_ns
    found: dict[int, _MeanSizes] = {}
    if first_ns is None or last_ns is None:
        return found
    duration_ns = min(last_ns, stop_ns or last_ns) - max(first_ns, start_ns or first_ns)
    for key, route in routes.items():
        for output in route.outputs:
            spec, entry = output.report.spec, output.report
            if output.combiner is None or output.handle < 0 or spec is None or not spec.combining.every_ns:
                continue
            scans = min(entry.messages_out, duration_ns // spec.combining.every_ns + 1)
            found[key] = sizes[key]._replace(made=sizes[key].made * scans / max(1, entry.messages_in))
            entry.messages_out = scans
    return found


def _written_size(
    reader: Reader,
    target: Destination,
    routes: Mapping[int, OpenRoute],
    counts: Mapping[int, int],
    sizes: Mapping[int, _MeanSizes],
) -> int:
    """Return an estimate of the destination's size in bytes, by the compression ratio of the source."""
    whole = sum((route.connection.message_count or 0) * sizes[key].read for key, route in routes.items())
    ratio = min(1.0, reader.summary.size_bytes / whole) if whole and target.compression != "none" else 1.0
    stored = sum((counts.get(key) or 0) * (size.passed * ratio + size.made + _INDEXED) for key, size in sizes.items())
    return round(stored + _DECLARED * len(routes) + _FRAME)
