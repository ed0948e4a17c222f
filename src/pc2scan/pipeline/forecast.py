"""Estimates what a conversion would do, without writing: its topics, and about how many messages and bytes."""

from __future__ import annotations

from contextlib import closing
from typing import TYPE_CHECKING, Any, NamedTuple

from pc2scan.errors import MessageError

from .checks import result_findings
from .conversion import ConvertedMessage
from .engine import items_of
from .items import Item

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from pc2scan.bags.destinations import Destination
    from pc2scan.bags.reader import Reader
    from pc2scan.model import Connection

    from .combine.combiner import Combiner
    from .items import OpenRoute, Output, Span, Tally
    from .options import ConvertOptions
    from .preparation import Preparation
    from .recording import OpenRecording
    from .report import Report

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
    target: Destination,
    recording: OpenRecording,
    options: ConvertOptions,
    prepared: Preparation,
    report: Report,
) -> None:
    """Fill in a report like a conversion, estimated from the indexes and the first messages.

    Its points and skipped messages are those of the first messages.

    Raises
    ------
    TransformError
        If no transforms connect any message with the target frame.
    MessageError
        With ``on_error`` ``fail``, if one of the first messages cannot be converted.
    """
    routes, span = recording.routes, prepared.span
    with prepared.counting(routes, options.on_error, report) as tally:
        sizes: dict[int, _MeanSizes] = _converted_sizes(
            reader, routes, recording.combiners, span, tally, is_packed=target.compression != "none"
        )
    report.damage += reader.damage
    report.add(*result_findings(report))
    counts = reader.counts([route.connection for route in routes.values()], span.start_ns, span.stop_ns)
    _fill_in(routes, counts, report)
    sizes |= _correct_intervals(reader, routes, sizes, span.start_ns, span.stop_ns)
    others = [key for key in routes if key not in sizes]
    sizes |= _other_sizes(reader, [routes[key].connection for key in others])
    if (levels := recording.levels) is not None:
        made = (each.messages_out for each in report.topics if each.spec is not None and each.spec.level)
        levels.report.messages_out = max(made, default=0)
    for each in recording.trajectories:
        each.report.messages_out = each.count
    report.bytes_written = _written_size(reader, target, routes, counts, sizes)


def _converted_sizes(
    reader: Reader,
    routes: Mapping[int, OpenRoute],
    combiners: Mapping[Output, Combiner],
    span: Span,
    tally: Tally,
    *,
    is_packed: bool,
) -> dict[int, _MeanSizes]:
    """Convert the first messages of each topic."""
    sizes: dict[int, _MeanSizes] = {}
    for key, route in routes.items():
        if not route.steps:
            continue
        read, made = list[int](), list[int]()
        with closing(items_of(reader, {key: route}, span, None)) as items:
            for found in items:
                # No rule allows whole chunks here.
                assert isinstance(found, Item)
                results = [
                    (output, _scan_of_one(combiners.get(output), output, result)) for output, result in found.results
                ]
                item = found._replace(results=results)
                read.append(item.size_in)
                tally.count(item)
                if item.failure is None:
                    made.append(sum(_size(output, result, is_packed) for output, result in item.results))
                # Only all messages show that no transforms connect them.
                if len(made) == _CONVERTED or (len(read) >= _LOOKED_AT and tally.is_connected):
                    break
        kept = _mean(read) if route.passing_handle >= 0 else 0.0
        sizes[key] = _MeanSizes(_mean(read), kept, _mean(made))
    return sizes


def _scan_of_one(combiner: Combiner | None, output: Output, result: Any) -> Any:
    """Return the scan of a message alone, if it waits for others; if it leads them, its size counts for all."""
    if combiner is None or output.handle < 0 or isinstance(result, MessageError):
        return result
    try:
        return combiner.alone(result)
    except MessageError as err:
        return err


def _size(output: Output, result: object, is_packed: bool) -> int:
    """Return how many bytes of a result are written to an output."""
    if not isinstance(result, ConvertedMessage):
        return 0
    data = (result.used or b"") if output.used else result.message
    return _compressed_size(data) if is_packed else len(data)


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
        entry.messages_in = entry.messages_out = entry.skipped = 0
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
            if output.used or output.handle < 0 or spec is None or not spec.combining.every_ns:
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
