"""The end of a conversion: compares counts, warns of scans that consumers refuse, and raises for useless results."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from typing import TYPE_CHECKING

from pc2scan.bags.damage import RECOVER, Damage, count_details
from pc2scan.core.consumers import CONSUMERS, judge
from pc2scan.errors import DamageError, ResultError, name_list
from pc2scan.messages.laserscan import LASERSCAN, decode_laserscan, scan_for_consumers
from pc2scan.text import agreeing, counted

from .parameters import from_preset, preset_of

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Sequence

    from pc2scan.bags.reader import Reader
    from pc2scan.core.verdicts import Outcome, Verdict
    from pc2scan.model import Buffer

    from .items import OpenRoute
    from .options import ConvertOptions
    from .report import Report
    from .topic_report import TopicReport

#: What a consumer does with scans by its verdict, as part of a sentence.
_DOES: dict[Outcome, str] = {
    "shifted": "would turn these scans by up to one beam",
    "misplaced": "would misplace these scans",
    "ignored": "would ignore these scans",
    "aborts": "would abort at these scans",
}


def conclude(
    report: Report, reader: Reader, routes: Collection[OpenRoute], serialization: str, options: ConvertOptions
) -> None:
    """Compare the counts, and add warnings about the whole conversion to its report.

    Parameters
    ----------
    reader, routes
        The source, and its connections; all their messages have been read.
    serialization
        That of the scans: ``ros1`` or ``cdr``.

    Raises
    ------
    Pc2ScanError
        If the result is not worth writing.
    """
    report.warnings += [f"{', '.join(names)}: {text}" for text, names in _refusals(routes, serialization).items()]
    _compare_counts(reader, [route for route in routes if route.writes], options, report)
    report.conclude()
    if not options.repair:
        refuse_nothing(report)
        refuse_unsatisfied(report, options)


def _compare_counts(reader: Reader, written: Sequence[OpenRoute], options: ConvertOptions, report: Report) -> None:
    """Compare how many messages were read with how many the sources declare, for each connection.

    If known damage explains a difference, the report only has both numbers.
    """
    if options.start is not None or options.end is not None:
        return
    declared_counts = ((route.connection, route.connection.message_count, route.messages) for route in written)
    counts = [(connection.topic, known, read) for connection, known, read in declared_counts if known is not None]
    # MCAP's writers may omit the counts by channel, and store the sum.
    declared = reader.summary.message_count if len(written) == len(reader.connections) else None
    if declared is None and len(counts) == len(written):
        declared = sum(count for _, count, _ in counts)
    if declared is None:
        return
    found = report.messages_read
    lost = max(declared - found, sum(max(0, count - read) for _, count, read in counts))
    report.messages_declared = declared
    details = count_details(counts)
    if (declared == found and not details) or any(damage.loses for damage in report.damage):
        return
    missing = f"declares {counted(declared, 'message')}, {found:,} {agreeing(found, 'were')} found{details}"
    if options.strict:
        raise DamageError(missing, path=reader.path, hint=RECOVER)
    report.damage.append(Damage(missing, reader.path, messages_lost=max(0, lost)))


def _refusals(routes: Iterable[OpenRoute], serialization: str) -> dict[str, list[str]]:
    """Return warnings about consumers that would refuse the written scans, each with its topics."""
    topics: dict[str, dict[str, None]] = {}
    for output in (output for route in routes for output in route.outputs):
        spec = output.report.spec
        if spec is None or spec.made_type != LASERSCAN or not output.sample:
            continue
        chosen = next((preset_of(origin) for origin in spec.origins.values() if from_preset(origin)), "")
        if text := refusal(output.sample, serialization, chosen):
            topics.setdefault(text, {})[output.report.target or ""] = None
    return {text: list(names) for text, names in topics.items()}


def refusal(data: Buffer, serialization: str, consumer: str = "") -> str:
    """Return a warning that names the consumers that would ignore scans like this one, or abort; empty if none would.

    The consumer that the scans are made for is checked by all its rules. The others are checked only by what a
    scan's header advertises; `pc2scan check` judges the ranges. Infinite ranges with an infinite range_max, as
    upstream's own defaults have them, are misplaced by most consumers, and gmapping aborts.

    Parameters
    ----------
    data
        A serialised LaserScan.
    serialization
        ``ros1`` or ``cdr``.
    consumer
        The consumer whose preset was chosen; empty if none was.
    """
    scan = scan_for_consumers(decode_laserscan(data, serialization))
    if consumer:
        verdict = judge(consumer, scan)
        return "" if verdict.outcome == "accepted" else f"{consumer} {_DOES[verdict.outcome]}: {_explanation(verdict)}"
    scan = replace(scan, infinite=0, short=0)
    verdicts = [verdict for consumer in CONSUMERS if (verdict := judge(consumer, scan)).refused]
    if not verdicts:
        return ""
    first = verdicts[0]
    others = f" (so would {', '.join(verdict.consumer for verdict in verdicts[1:])})" if verdicts[1:] else ""
    return f"{first.consumer} would ignore these scans{others}: {_explanation(first)}"


def _explanation(verdict: Verdict) -> str:
    """Return what a scan has, what the consumer allows, and how to change it."""
    return f"{verdict.observed} where it allows {verdict.allowed}. {verdict.cure[:1].upper()}{verdict.cure[1:]}"


def refuse_nothing(report: Report) -> None:
    """Raise if no message was converted.

    Raises
    ------
    ResultError
        The error names the most frequent reason.
    """
    converted = _converted_topics(report)
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
            hint="`lead` chooses another leading topic; or check `topics`, `start` and `end`",
        )
    if not read:
        raise ResultError(
            "no message was converted: there was none to convert", hint="check `topics`, `start` and `end`"
        )
    reasons = Counter(entry.reason for entry in report.skipped)
    hints = {entry.reason: entry.hint for entry in report.skipped}
    ((reason, count),) = reasons.most_common(1) or [("", 0)]
    which = "" if count == read else f", {count:,} of {read:,}"
    raise ResultError(
        f"no message was converted: all were skipped{which}: {reason}" if count else "no message was converted",
        hint=hints.get(reason) or None,
    )


def refuse_unsatisfied(report: Report, options: ConvertOptions) -> None:
    """Raise if the result does not satisfy `fail_on` or `min_used`.

    Raises
    ------
    ResultError
        The error has the numbers and the option.
    """
    for topic in _converted_topics(report):
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


def _converted_topics(report: Report) -> list[TopicReport]:
    return [topic for topic in report.topics if topic.action == "converted"]


def _reason_in(warnings: Sequence[str], part: str) -> str | None:
    """Return the text after the first colon of the first warning that contains ``part``."""
    found = next((warning for warning in warnings if part in warning), "")
    return found.partition(": ")[2] or None
