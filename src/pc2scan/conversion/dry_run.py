"""Converts the first clouds of a recording, and says what a conversion would do; nothing is written."""

from __future__ import annotations

from contextlib import closing
from typing import TYPE_CHECKING, Any

from pc2scan.errors import MessageError

from .engine import items_of
from .items import Item
from .result_checks import result_findings

if TYPE_CHECKING:
    from collections.abc import Mapping

    from pc2scan.advice.survey import Span
    from pc2scan.bags.reader import Reader
    from pc2scan.request.options import ConvertOptions

    from .combine.combiner import Combiner
    from .items import OpenRoute, Output, Tally
    from .preparation import Preparation
    from .recording import OpenRecording
    from .report import Report

#: How many of the first messages of a topic are converted, not counting those that fail, and how many are read at most,
#: if there are transforms.
_CONVERTED = 3
_LOOKED_AT = 10


def convert_first(
    reader: Reader, recording: OpenRecording, options: ConvertOptions, prepared: Preparation, report: Report
) -> None:
    """Fill in a report: its points are those of the first messages, its counts those of the index.

    Raises
    ------
    TransformError
        If no transforms connect any message with the target frame.
    MessageError
        With ``strict``, if one of the first messages cannot be converted.
    """
    routes, span = recording.routes, prepared.span
    with prepared.counting(routes, report, strict=options.strict) as tally:
        for key, route in routes.items():
            if route.steps:
                _convert(reader, {key: route}, recording.combiners, span, tally)
    report.add(reader.remarks)
    report.damage += reader.damage
    report.add(*result_findings(report))
    _count(reader, routes, span, report)
    if (levels := recording.levels) is not None:
        made = (each.messages_out for each in report.topics if each.spec is not None and each.spec.level)
        levels.report.messages_out = max(made, default=0)
    for each in recording.trajectories:
        each.report.messages_out = each.count


def _convert(
    reader: Reader, routes: Mapping[int, OpenRoute], combiners: Mapping[Output, Combiner], span: Span, tally: Tally
) -> None:
    """Convert the first messages of a topic."""
    read = made = 0
    with closing(items_of(reader, routes, span, None)) as items:
        for item in items:
            # No rule allows whole chunks here.
            assert isinstance(item, Item)
            results = [(output, _scan_of_one(combiners.get(output), output, result)) for output, result in item.results]
            tally.count(item._replace(results=results))
            read += 1
            made += item.failure is None
            # Only all messages show that no transforms connect them.
            if made == _CONVERTED or (read >= _LOOKED_AT and tally.is_connected):
                break


def _scan_of_one(combiner: Combiner | None, output: Output, result: Any) -> Any:
    """Return the scan of a message alone, if it waits for others."""
    if combiner is None or output.handle < 0 or isinstance(result, MessageError):
        return result
    try:
        return combiner.alone(result)
    except MessageError as err:
        return err


def _count(reader: Reader, routes: Mapping[int, OpenRoute], span: Span, report: Report) -> None:
    """Replace the counts of the first messages by those of all messages."""
    counts = reader.counts([route.connection for route in routes.values()], span.start_ns, span.stop_ns)
    for entry in {id(entry): entry for route in routes.values() for entry in route.reports}.values():
        entry.messages_in = entry.messages_out = entry.skipped = 0
    uncounted = set()
    for key, route in routes.items():
        count = counts.get(key, route.connection.message_count)
        if count is None:
            uncounted.add(route.connection.topic)
        for entry in route.reports:
            entry.messages_in += count or 0
            entry.messages_out += (count or 0) if route.writes else 0
    first_ns, last_ns = reader.summary.start_ns, reader.summary.end_ns
    for entry in report.topics:
        every_ns = 0 if entry.spec is None else entry.spec.combining.every_ns
        if every_ns and first_ns is not None and last_ns is not None:
            length_ns = min(last_ns, span.stop_ns or last_ns) - max(first_ns, span.start_ns or first_ns)
            entry.messages_out = min(entry.messages_out, length_ns // every_ns + 1)
    if uncounted:
        report.notes.append(f"no index counts the messages on {', '.join(sorted(uncounted))}")
