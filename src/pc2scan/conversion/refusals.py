"""The errors of conversions that cannot be made, or whose result is of no use.

They are found before the first message, when none of many messages can be converted, and at the end.
"""

from __future__ import annotations

from collections import Counter
from contextlib import closing
from typing import TYPE_CHECKING

from pc2scan.advice.checks.request import in_another_unit
from pc2scan.bags.damage import RECOVER, Damage, count_details
from pc2scan.errors import DamageError, MissingError, ResultError, TopicError, UsageError, name_list
from pc2scan.files.places import missing_hint
from pc2scan.files.urls import exists
from pc2scan.text import agreeing, counted, stamp

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

    from pc2scan.bags.reader import Reader
    from pc2scan.model import Connection
    from pc2scan.request.options import ConvertOptions

    from .plan import Route
    from .report import Report


def refuse_unusable(options: ConvertOptions) -> None:
    """Raise if an option cannot be used, even if this conversion would not need it.

    Raises
    ------
    MissingError
        If a recording of ``tf_from`` does not exist.
    """
    for path in options.frames.tf_from:
        if not exists(path):
            raise MissingError("does not exist (from `tf_from`)", path=path, hint=missing_hint(path))


def refuse_no_messages(
    reader: Reader, converted: Sequence[Connection], start_ns: int | None, stop_ns: int | None
) -> None:
    """Raise if the topics to convert have no messages, or none in the cut.

    The index is read first. If it lists no messages, the recording is read as well, because an index may be wrong.

    Raises
    ------
    UsageError
        If the cut lies outside of the recording.
    TopicError
        If there are no messages in it.
    """
    if not converted:
        return
    counts = reader.counts(converted, start_ns, stop_ns)
    outside = _outside(reader, start_ns, stop_ns)
    if outside is None and any(counts.get(connection.id) != 0 for connection in converted):
        return
    with closing(reader.messages(converted, start_ns, stop_ns)) as messages:
        if next(messages, None) is not None:
            return
    # If the recording is damaged, this is reported instead.
    if reader.damage:
        return
    if outside is not None:
        raise outside
    topics = name_list(sorted({connection.topic for connection in converted}))
    is_cut = start_ns is not None or stop_ns is not None
    raise TopicError(
        f"there is nothing to convert: no messages on {topics}{' in the cut' if is_cut else ''}",
        hint="check `start` and `end`" if is_cut else "pc2scan info lists the topics, and how many messages they have",
    )


def refuse_outside(reader: Reader, start_ns: int | None, stop_ns: int | None) -> None:
    """Raise if the cut lies outside of the recording, unless this is damaged, which is reported instead.

    Raises
    ------
    UsageError
        If it does.
    """
    if not reader.damage and (outside := _outside(reader, start_ns, stop_ns)) is not None:
        raise outside


def _outside(reader: Reader, start_ns: int | None, stop_ns: int | None) -> UsageError | None:
    """Return the error for a cut outside of the recording; None if the cut is inside, or the times are unknown."""
    first_ns, last_ns = reader.summary.start_ns, reader.summary.end_ns
    if first_ns is None or last_ns is None or not reader.summary.message_count:
        return None
    late = start_ns is not None and start_ns > last_ns
    early = stop_ns is not None and stop_ns <= first_ns
    if not late and not early:
        return None
    name, time_ns = ("start", start_ns) if late else ("end", stop_ns)
    seconds = (last_ns - first_ns) / 1e9
    meant = in_another_unit(name, time_ns or 0, first_ns, last_ns)
    return UsageError(
        f"the cut is outside of the recording: `{name}` is {stamp(time_ns or 0)}, the recording is from "
        f"{stamp(first_ns)} to {stamp(last_ns)}",
        path=reader.path,
        hint=(f"{meant}; " if meant else "") + f"its {seconds:.3f} s are `start=0` to `end={seconds + 0.001:.3f}`",
    )


def compare_counts(
    reader: Reader, routes: Collection[Route], options: ConvertOptions, report: Report
) -> tuple[int | None, list[Damage]]:
    """Compare how many messages were read with how many the sources declare, for each connection.

    Parameters
    ----------
    reader, routes
        The source, and its connections; all their messages have been read.
    report
        How many messages were read, and the damage that explains a difference.

    Returns
    -------
    How many messages the sources declare (None: they do not, or only a part was read), and the damage of a difference
    that nothing else explains; empty without one.

    Raises
    ------
    DamageError
        With ``strict``, instead of returning damage.
    """
    if options.start is not None or options.end is not None:
        return None, []
    written = [route for route in routes if route.writes]
    declared_counts = ((route.connection, route.connection.message_count, route.messages) for route in written)
    counts = [(connection.topic, known, read) for connection, known, read in declared_counts if known is not None]
    # MCAP's writers may omit the counts by channel, and store the sum.
    declared = reader.summary.message_count if len(written) == len(reader.connections) else None
    if declared is None and len(counts) == len(written):
        declared = sum(count for _, count, _ in counts)
    if declared is None:
        return None, []
    found = report.messages_read
    lost = max(declared - found, sum(max(0, count - read) for _, count, read in counts))
    details = count_details(counts)
    if (declared == found and not details) or any(damage.loses for damage in report.damage):
        return declared, []
    missing = f"declares {counted(declared, 'message')}, {found:,} {agreeing(found, 'were')} found{details}"
    if options.strict:
        raise DamageError(missing, path=reader.path, hint=RECOVER)
    return declared, [Damage(missing, reader.path, messages_lost=max(0, lost))]


def refuse_nothing(report: Report) -> None:
    """Raise if no message was converted.

    Raises
    ------
    ResultError
        The error names the most frequent reason.
    """
    converted = report.converted
    if any(topic.messages_out for topic in converted):
        return
    read = sum(topic.messages_in for topic in converted)
    if not read and report.damage:
        place = report.damage[0]
        error = f"no message was converted: there was none to convert in a damaged recording: {place.what}"
        raise ResultError(error, path=place.path)
    joined = [topic for topic in report.topics if topic.action == "joined" and topic.messages_in]
    if not read and joined:
        raise ResultError(
            f"no message was converted: the leading topic has none, so those of "
            f"{name_list([topic.topic for topic in joined])} are in no scan",
            hint="name another topic first in `topics`; or check `start` and `end`",
        )
    if not read:
        raise ResultError(
            "no message was converted: there was none to convert", hint="check `topics`, `start` and `end`"
        )
    if not report.skipped:
        raise ResultError("no message was converted")
    reasons = Counter("" if entry.gap_ns else entry.reason for entry in report.skipped)
    ((common, count),) = reasons.most_common(1)
    # Of stamps without transforms the farthest: what helps it helps the others, too.
    shown = max(report.skipped, key=lambda entry: entry.gap_ns if not common else entry.reason == common)
    which = "" if count == len(report.skipped) else f", {count:,} of {read:,}"
    raise ResultError(f"no message was converted: all were skipped{which}: {shown.reason}", hint=shown.hint or None)


def refuse_unsatisfied(report: Report, options: ConvertOptions) -> None:
    """Raise if the result does not satisfy `fail_on` or `min_used`.

    Raises
    ------
    ResultError
        The error has the numbers and the option.
    """
    for topic in report.converted:
        if options.fail_on and topic.empty_scans:
            raise ResultError(
                f"{topic.empty_scans:,} of {counted(topic.messages_out, 'scan')} on {topic.target} "
                f"{agreeing(topic.empty_scans, 'have')} no return "
                f"(`fail_on={options.fail_on}`)",
                hint=_reason_in(report.warnings, f"on {topic.target} {agreeing(topic.empty_scans, 'have')} no return"),
            )
        share = topic.points.used / topic.points.total if topic.points.total else 0.0
        if share < options.min_used:
            raise ResultError(
                f"{share:.3%} of the points of {topic.topic} are in the scans on {topic.target}, less than "
                f"{options.min_used:.3%} (`min_used`)"
            )
    if options.fail_on != "warning":
        return
    if report.damage:
        raise ResultError("a source is damaged (`fail_on=warning`)", path=report.damage[0].path)
    if report.skipped_count:
        raise ResultError(f"{counted(report.skipped_count, 'message', 'were')} skipped (`fail_on=warning`)")
    if report.warnings:
        raise ResultError(f"{report.warnings[0]} (`fail_on=warning`)")


def _reason_in(warnings: Sequence[str], part: str) -> str | None:
    """Return the text after the first colon of the first warning that contains ``part``."""
    found = next((warning for warning in warnings if part in warning), "")
    return found.partition(": ")[2] or None
