"""Moments of a recording: as text for users, and the choice of those that a page shows."""

from __future__ import annotations

from datetime import datetime, timezone
from typing import TYPE_CHECKING

from pc2scan.inspect.sampling import sampled
from pc2scan.pipeline.beforehand import refuse_outside
from pc2scan.pipeline.run import span_of

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from pc2scan.bags.reader import Reader
    from pc2scan.model import Connection, RawMessage
    from pc2scan.pipeline.options import ConvertOptions

#: Earlier stamps are shown in seconds, not as a date: stamps of simulations begin at 0.
_FIRST_DATE_NS = 100_000_000 * 1_000_000_000


def moment(stamp_ns: int) -> str:
    """Return a stamp as a date and time in UTC, to the millisecond; stamps of simulations in seconds."""
    if stamp_ns < _FIRST_DATE_NS:
        return f"{stamp_ns / 1e9:.3f} s"
    seconds, rest = divmod(stamp_ns, 1_000_000_000)
    return f"{datetime.fromtimestamp(seconds, timezone.utc):%Y-%m-%d %H:%M:%S}.{rest // 1_000_000:03d} UTC"


def spread(
    reader: Reader, topics: Mapping[str, Sequence[Connection]], options: ConvertOptions, count: int
) -> Iterator[RawMessage]:
    """Yield messages of each topic, evenly spread over the recording or over the cut; see `sampled`.

    Raises
    ------
    UsageError
        If the cut is empty, or lies outside of the recording.
    """
    span = span_of(reader, options)
    refuse_outside(reader, span.start_ns, span.stop_ns)
    start_ns = span.first_ns
    stop_ns = max(reader.summary.start_ns or 0, reader.summary.end_ns or 0) + 1
    if span.stop_ns is not None:
        stop_ns = min(stop_ns, span.stop_ns)
    if start_ns >= stop_ns:
        return
    for message in sampled(reader, topics, count, start_ns, stop_ns - 1):
        # The first message after the last moment may be outside of the cut.
        if message.log_time_ns < stop_ns:
            yield message
