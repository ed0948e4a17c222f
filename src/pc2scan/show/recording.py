"""A recording for pictures: opened as one, its transforms, and moments that are spread over it."""

from __future__ import annotations

from collections import deque
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from datetime import datetime, timezone
from functools import partial
from itertools import islice
from typing import TYPE_CHECKING

from pc2scan.bags.damage import mention
from pc2scan.bags.observers import Observer, Spread, observing
from pc2scan.bags.opening import as_one, open_recordings
from pc2scan.conversion.cloud_scale import scaled
from pc2scan.conversion.preparation import prepare, span_of
from pc2scan.conversion.source_checks import refuse_outside
from pc2scan.conversion.stamps import corrected_transforms
from pc2scan.errors import TopicError, UsageError, stamp_text
from pc2scan.model import RawMessage, copied_message
from pc2scan.result import tell_early

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
    from pathlib import Path

    from pc2scan.bags.damage import Damage
    from pc2scan.bags.reader import Reader
    from pc2scan.conversion.plan import Plan
    from pc2scan.conversion.preparation import Preparation
    from pc2scan.model import Connection
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
    others
        The recordings of ``tf_from``, once transforms were read.
    warnings
        Those of the preparation so far.
    """

    reader: Reader
    options: ConvertOptions
    stack: ExitStack
    warn: Callable[[str], None] | None = None
    others: Sequence[Reader] = ()
    warnings: list[str] = field(default_factory=list)

    @property
    def damage(self) -> tuple[Damage, ...]:
        """The damage in the parts of the recordings that were read."""
        return tuple(damage for each in (self.reader, *self.others) for damage in each.damage)

    def log_times(self, at: Sequence[TimeBound]) -> list[int]:
        """Return moments as log times.

        Raises
        ------
        UsageError
            If one is after the end of the recording.
        """
        first_ns, last_ns = self.reader.summary.start_ns or 0, self.reader.summary.end_ns
        times = [bound.resolve(first_ns) for bound in at]
        if last_ns is not None and (late := [time for time in times if time > last_ns]):
            raise UsageError(
                f"`at` is {stamp_text(late[0])}, the recording is from {stamp_text(first_ns)} to {stamp_text(last_ns)}",
                path=self.reader.path,
                hint=f"`at=0` to `at={(last_ns - first_ns) / 1e9:.3f}` are in it",
            )
        return times

    def prepare(self, plan: Plan, options: ConvertOptions) -> Preparation:
        """Prepare a conversion, with all transforms unless it is not clear which to use, and none are needed.

        Raises
        ------
        UsageError
            If it is not clear which transforms to use, or something cannot be measured.
        """
        span, tell = span_of(self.reader, options), partial(tell_early, self.warnings, self.warn)
        request = self.reader, plan, options, span, self.stack, tell
        try:
            prepared = prepare(*request, transform_frames=())
        except UsageError:
            if plan.needs_transforms:
                raise
            prepared = prepare(*request)
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
    sources: Sequence[Path], options: ConvertOptions, warn: Callable[[str], None] | None = None
) -> Iterator[ShownRecording]:
    """Open recordings as one; for ``warn``, see `ShownRecording`.

    Raises
    ------
    RecordingError
        If one cannot be read.
    """
    with ExitStack() as stack:
        readers = open_recordings(sources, stack, strict=options.strict)
        reader = scaled(as_one(readers), options.cloud_scale)
        try:
            yield ShownRecording(reader, options, stack, warn)
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
    reader: Reader,
    topics: Mapping[str, Sequence[Connection]],
    options: ConvertOptions,
    count: int,
    at_ns: Sequence[int],
) -> Iterator[RawMessage]:
    """Yield the first message of each topic at or after each of some log times.

    Without any, ``count`` messages of each topic, evenly spread over the recording or over the cut; see `sampled`.

    Raises
    ------
    UsageError
        If the cut is empty, or lies outside of the recording.
    """
    for time_ns in sorted(at_ns):
        for connections in topics.values():
            yield from islice(reader.messages(connections, time_ns), 1)
    if at_ns:
        return
    span = span_of(reader, options)
    refuse_outside(reader, span.start_ns, span.stop_ns)
    stop_ns = max(reader.summary.start_ns or 0, reader.summary.end_ns or 0) + 1
    if span.stop_ns is not None:
        stop_ns = min(stop_ns, span.stop_ns)
    if span.first_ns < stop_ns:
        yield from sampled(reader, topics, count, span.first_ns, stop_ns)


def sampled(
    reader: Reader, topics: Mapping[str, Sequence[Connection]], samples: int, start_ns: int, stop_ns: int
) -> Iterator[RawMessage]:
    """Yield samples of every topic, as they are read: the first message of each of some equal parts of a time.

    Parameters
    ----------
    reader
        An open recording.
    topics
        The connections of each topic.
    samples
        The number of parts. If a topic has no more messages, all of them are samples.
    start_ns, stop_ns
        The time: ``start_ns <= log_time_ns < stop_ns``.

    Yields
    ------
    RawMessage
        Those of one topic by log time; they do not depend on the other topics.
    """
    messages: deque[RawMessage] = deque()
    observers = [
        Observer(
            own,
            copied_message,
            start_ns=start_ns,
            stop_ns=stop_ns,
            keep=messages.append,
            spread=spread_over(own, samples, start_ns, stop_ns),
        )
        for own in topics.values()
    ]
    for _ in observing(reader, observers):
        while messages:
            yield messages.popleft()


def spread_over(connections: Sequence[Connection], samples: int, start_ns: int, stop_ns: int) -> Spread | None:
    """Return the parts of a time for so many samples of connections; None if they have no more messages."""
    counts = [each.message_count for each in connections]
    messages = None if None in counts else sum(each or 0 for each in counts)
    return Spread.of(start_ns, stop_ns, samples, messages)
