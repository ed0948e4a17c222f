"""Checks whether the result of a conversion is good enough to be written."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

from pc2scan.errors import ResultError, name_list
from pc2scan.text import agreeing, counted

if TYPE_CHECKING:
    from collections.abc import Sequence

    from .options import ConvertOptions
    from .report import Report
    from .topic_report import TopicReport


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
