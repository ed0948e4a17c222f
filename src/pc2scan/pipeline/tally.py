"""What is compared, warned of and refused once the whole recording has been read."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from pc2scan.bags.damage import RECOVER, Damage, count_details
from pc2scan.errors import DamageError
from pc2scan.messages.laserscan import LASERSCAN
from pc2scan.text import agreeing, counted

from .acceptance import refusal
from .demands import refuse_nothing, refuse_unsatisfied
from .parameters import from_preset, preset_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence
    from pathlib import Path

    from pc2scan.bags.reader import Reader

    from .options import ConvertOptions
    from .report import Report
    from .routes import OpenRoute


class Tally(NamedTuple):
    """What is compared and reported once the whole recording has been read.

    Attributes
    ----------
    path
        The source.
    counts
        For each connection that is written its topic, its declared number of messages, and how many were read.
    declared
        How many messages the source declares; None if it does not say, or not all are written.
    refusals
        Warnings that consumers would refuse the scans, each with the topics that it is about.
    """

    path: Path
    counts: Sequence[tuple[str, int | None, int]]
    declared: int | None
    refusals: Mapping[str, Sequence[str]]


def tally_of(reader: Reader, routes: Mapping[int, OpenRoute], serialization: str) -> Tally:
    """Return what is compared and reported at the end."""
    written = [route for route in routes.values() if route.writes]
    return Tally(
        reader.path,
        [(route.connection.topic, route.connection.message_count, route.messages) for route in written],
        # MCAP's writers may omit the counts by channel, and store the sum.
        reader.summary.message_count if len(written) == len(reader.connections) else None,
        _refusals(routes.values(), serialization),
    )


def conclude(report: Report, tally: Tally, options: ConvertOptions) -> None:
    """Add to a report what is known only of the whole conversion.

    Raises
    ------
    Pc2ScanError
        If the result is not worth writing.
    """
    report.warnings += [f"{', '.join(names)}: {text}" for text, names in tally.refusals.items()]
    _compare_counts(tally, options, report)
    report.conclude()
    if not options.repair:
        refuse_nothing(report)
        refuse_unsatisfied(report, options)


def _compare_counts(tally: Tally, options: ConvertOptions, report: Report) -> None:
    """Compare how many messages were read with how many the sources declare, for each connection.

    If known damage explains a difference, the report only has both numbers.
    """
    if options.start is not None or options.end is not None:
        return
    counts = [(topic, known, read) for topic, known, read in tally.counts if known is not None]
    declared = tally.declared
    if declared is None and len(counts) == len(tally.counts):
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
        raise DamageError(missing, path=tally.path, hint=RECOVER)
    report.damage.append(Damage(missing, tally.path, messages_lost=max(0, lost)))


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
