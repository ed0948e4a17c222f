"""Checks whether anything can be converted at all, by the index and by the first messages."""

from __future__ import annotations

from contextlib import closing
from typing import TYPE_CHECKING

from pc2scan.errors import TopicError, UnconnectedError, UsageError, name_list
from pc2scan.text import stamp

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from pc2scan.bags.reader import Reader
    from pc2scan.errors import MessageError
    from pc2scan.model import Connection
    from pc2scan.options.moment import TimeBound

#: How many of the first messages must fail before a user is warned.
_LOOKED_AT = 10


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
    meant = _meant(name, time_ns or 0, first_ns, last_ns)
    return UsageError(
        f"the cut is outside of the recording: `{name}` is {stamp(time_ns or 0)}, the recording is from "
        f"{stamp(first_ns)} to {stamp(last_ns)}",
        path=reader.path,
        hint=(f"{meant}; " if meant else "") + f"its {seconds:.3f} s are `start=0` to `end={seconds + 0.001:.3f}`",
    )


def idle_cut(reader: Reader, start: TimeBound | None, end: TimeBound | None) -> list[str]:
    """Return a warning if times of day are given as a cut, and the whole recording is within it.

    Times that count from the beginning draw none: the same cut may be used for recordings of many lengths.
    """
    first_ns, last_ns = reader.summary.start_ns, reader.summary.end_ns
    if first_ns is None or last_ns is None or not reader.summary.message_count:
        return []
    bounds = {
        name: bound.resolve(first_ns)
        for name, bound in (("start", start), ("end", end))
        if bound is not None and (bound.absolute or bound.nanoseconds)
    }
    absolute = [name for name, bound in (("start", start), ("end", end)) if bound is not None and bound.absolute]
    if not absolute or bounds.get("start", first_ns) > first_ns or bounds.get("end", last_ns + 1) <= last_ns:
        return []
    # The first message may be at the start itself.
    if bounds.get("start") == first_ns or bounds.get("end") == last_ns + 1:
        return []
    shown = " and ".join(f"`{name}` is {stamp(bounds[name])}" for name in absolute)
    meant = next(filter(None, (_meant(name, bounds[name], first_ns, last_ns) for name in absolute)), "")
    return [
        f"the cut has no effect: {shown}, the recording is from {stamp(first_ns)} to {stamp(last_ns)}"
        + (f"; {meant}" if meant else "")
    ]


def _meant(name: str, time_ns: int, first_ns: int, last_ns: int) -> str:
    """Return which option a time in another unit would be; empty if none is inside of the recording."""
    for unit, factor in (("milliseconds", 1_000_000), ("microseconds", 1_000)):
        # Text and floats count seconds since 1970, large integers nanoseconds.
        for meant_ns in (time_ns * factor, time_ns * factor // 1_000_000_000):
            if first_ns <= meant_ns <= last_ns:
                seconds = f"{meant_ns // 1_000_000_000}.{meant_ns % 1_000_000_000:09d}".rstrip("0").rstrip(".")
                return f"if it was given in {unit}: `{name}=@{seconds}`"
    return ""


class Unconnected:
    """Detects that no transforms connect the frames of any message to convert with the target frame.

    Frames may differ from message to message, so it is certain only after the last one. The first ones draw a warning.

    Parameters
    ----------
    warn
        Called with the warning; None: there is none.

    Attributes
    ----------
    is_possible
        Whether all messages so far have failed for this reason.
    """

    def __init__(self, warn: Callable[[str], None] | None = None) -> None:
        self.is_possible = True
        self._warn = warn
        self._failed = 0
        self._first: tuple[str, UnconnectedError] | None = None

    def note(self, topic: str, error: MessageError | None) -> None:
        """Count whether a message was converted."""
        if not isinstance(error, UnconnectedError):
            self.is_possible = False
            return
        self._failed += 1
        self._first = self._first or (topic, error)
        if self._failed == _LOOKED_AT and self.is_possible and self._warn is not None:
            topic, first = self._first
            advice = f"; {first.hint}" if first.hint else ""
            self._warn(f"none of the first {_LOOKED_AT} messages can be converted: {topic}: {first.message}{advice}")

    def finish(self) -> None:
        """Raise if there were messages, and all of them have failed.

        Raises
        ------
        TransformError
            The first error.
        """
        if self.is_possible and self._first is not None:
            topic, first = self._first
            raise UnconnectedError(f"nothing can be converted: {first.message}", topic=topic, hint=first.hint)
