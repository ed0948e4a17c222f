"""A recording for pictures: opened as one, its transforms, and moments that are spread over it."""

from __future__ import annotations

import heapq
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from datetime import datetime, timezone
from functools import partial
from itertools import islice
from operator import attrgetter
from typing import TYPE_CHECKING

from pc2scan.bags.damage import mention
from pc2scan.bags.observers import Spread
from pc2scan.bags.opening import as_one, open_recordings
from pc2scan.conversion.corrections import corrected_transforms, scaled
from pc2scan.conversion.preparation import prepare, span_of
from pc2scan.conversion.source_checks import refuse_outside
from pc2scan.errors import TopicError, UsageError, stamp_text
from pc2scan.result import tell_early

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
    from pathlib import Path

    from pc2scan.bags.damage import Damage
    from pc2scan.bags.reader import Reader
    from pc2scan.conversion.plan import Plan
    from pc2scan.conversion.preparation import Preparation
    from pc2scan.model import Connection, RawMessage
    from pc2scan.options.moment import TimeBound
    from pc2scan.progress import Meter
    from pc2scan.request.options import ConvertOptions
    from pc2scan.transforms.reading import FoundTransforms

#: Earlier stamps are shown in seconds, not as a date: stamps of simulations begin at 0.
_FIRST_DATE_NS = 100_000_000 * 1_000_000_000


@dataclass(slots=True)
class ShownRecording:
    """A recording, which is open, and others that transforms are read from.

    Attributes
    ----------
    reader
        The recording.
    options
        The options of a conversion.
    stack
        Closes the recordings.
    warn
        Called with each warning of a preparation as soon as it is known; None: nobody waits for them.
    at_ns
        Log times of the moments to show; empty: they are spread over the recording.
    others
        The recordings of ``tf_from``, once transforms were read.
    warnings
        Those of the preparation so far.
    """

    reader: Reader
    options: ConvertOptions
    stack: ExitStack
    warn: Callable[[str], None] | None = None
    at_ns: Sequence[int] = ()
    others: Sequence[Reader] = ()
    warnings: list[str] = field(default_factory=list)

    @property
    def damage(self) -> tuple[Damage, ...]:
        """The damage in the parts of the recordings that were read."""
        return tuple(damage for each in (self.reader, *self.others) for damage in each.damage)

    def prepare(self, plan: Plan, options: ConvertOptions) -> Preparation:
        """Prepare a conversion, with all transforms.

        Raises
        ------
        UsageError
            If it is not clear which transforms to use, or something cannot be measured.
        """
        span, tell = span_of(self.reader, options), partial(tell_early, self.warnings, self.warn)
        prepared = prepare(self.reader, plan, options, span, self.stack, tell, transform_frames=())
        self.others = prepared.others
        return prepared

    def transforms(self, needed: Collection[str] = (), meter: Meter | None = None) -> FoundTransforms:
        """Read all transforms.

        Parameters
        ----------
        needed
            Frames that they must have.
        meter
            Counts the bytes; None: nothing is reported.

        Raises
        ------
        UsageError
            If it is not clear which to use.
        RecordingError
            If a recording cannot be read.
        """
        transforms, self.others = corrected_transforms(self.reader, self.options, self.stack, needed, meter)
        return transforms


@contextmanager
def open_recording(
    sources: Sequence[Path],
    options: ConvertOptions,
    warn: Callable[[str], None] | None = None,
    at: Sequence[TimeBound] = (),
) -> Iterator[ShownRecording]:
    """Open recordings as one; for ``warn``, see `ShownRecording`.

    Raises
    ------
    RecordingError
        If one cannot be read.
    UsageError
        If one of the moments ``at`` is after the end.
    """
    with ExitStack() as stack:
        readers = open_recordings(sources, stack, strict=options.strict)
        reader = scaled(as_one(readers), options.cloud_scale)
        first_ns, last_ns = reader.summary.start_ns or 0, reader.summary.end_ns
        at_ns = sorted(bound.resolve(first_ns) for bound in at)
        if last_ns is not None and at_ns and at_ns[-1] > last_ns:
            text = f"`at` is {stamp_text(at_ns[-1])}, the recording is from {stamp_text(first_ns)} to"
            hint = f"`at=0` to `at={(last_ns - first_ns) / 1e9:.3f}` are in it"
            raise UsageError(f"{text} {stamp_text(last_ns)}", path=reader.path, hint=hint)
        try:
            yield ShownRecording(reader, options, stack, warn, at_ns)
        except TopicError as err:
            mention(reader.damage, err)
            raise


def title_of(sources: Sequence[Path]) -> str:
    """Return the title of a picture of recordings."""
    return ", ".join(source.name or str(source) for source in sources)


def moment_text(stamp_ns: int) -> str:
    """Return a stamp as a date and time in UTC, to the millisecond; stamps of simulations in seconds."""
    if stamp_ns < _FIRST_DATE_NS:
        return f"{stamp_ns / 1e9:.3f} s"
    seconds, rest = divmod(stamp_ns, 1_000_000_000)
    return f"{datetime.fromtimestamp(seconds, timezone.utc):%Y-%m-%d %H:%M:%S}.{rest // 1_000_000:03d} UTC"


def chosen_messages(
    recording: ShownRecording, topics: Mapping[str, Sequence[Connection]], options: ConvertOptions, count: int
) -> Iterator[RawMessage]:
    """Yield the first message of each topic at or after each of a recording's moments.

    Without any, the first message of each of ``count`` equal parts of the recording, or of the cut. If a topic has no
    more messages, all of them are yielded.

    Raises
    ------
    UsageError
        If the cut is empty, or lies outside of the recording.
    """
    reader = recording.reader
    for time_ns in recording.at_ns:
        for connections in topics.values():
            yield from islice(reader.messages(connections, time_ns), 1)
    if recording.at_ns:
        return
    span = span_of(reader, options)
    refuse_outside(reader, span.start_ns, span.stop_ns)
    start_ns, stop_ns = span.first_ns, max(reader.summary.start_ns or 0, reader.summary.end_ns or 0) + 1
    if span.stop_ns is not None:
        stop_ns = min(stop_ns, span.stop_ns)
    if start_ns >= stop_ns:
        return

    def first_messages(own: Sequence[Connection]) -> Iterator[RawMessage]:
        spread = spread_over(own, count, start_ns, stop_ns)
        if spread is None:
            yield from reader.messages(own, start_ns, stop_ns)
            return
        for part in range(spread.parts):
            yield from islice(reader.messages(own, spread.begin_ns(part), spread.begin_ns(part + 1)), 1)

    yield from heapq.merge(*map(first_messages, topics.values()), key=attrgetter("log_time_ns"))


def spread_over(connections: Sequence[Connection], samples: int, start_ns: int, stop_ns: int) -> Spread | None:
    """Return the parts of a time for so many samples of connections; None if they have no more messages."""
    counts = [each.message_count for each in connections]
    messages = None if None in counts else sum(each or 0 for each in counts)
    return Spread.of(start_ns, stop_ns, samples, messages)
