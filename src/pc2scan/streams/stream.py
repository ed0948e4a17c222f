"""Reads the messages of a recording one after the other: opens it, applies the cut, and closes it."""

from __future__ import annotations

import warnings
from abc import ABC, abstractmethod
from contextlib import ExitStack, closing, suppress
from dataclasses import dataclass
from importlib import import_module
from itertools import chain
from typing import TYPE_CHECKING, Any, Generic, NamedTuple, Protocol, TypeVar
from weakref import WeakSet, finalize

import numpy as np

from pc2scan.bags.opening import as_one, open_recordings
from pc2scan.bags.topics import find_topics, short_types
from pc2scan.bags.units import merge_by_time
from pc2scan.errors import MessageError, RecordingWarning, TopicError, UsageError, name_list, visible
from pc2scan.pipeline.options import ConvertOptions
from pc2scan.pipeline.refusals import refuse_no_messages
from pc2scan.pipeline.run import span_of
from pc2scan.result import MAX_LISTED, Skipped

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Generator, Sequence
    from pathlib import Path
    from types import TracebackType

    from typing_extensions import Self

    from pc2scan.bags.damage import Damage
    from pc2scan.bags.reader import Reader
    from pc2scan.model import Connection, RawMessage
    from pc2scan.options.moment import TimeBound
    from pc2scan.pipeline.combine.combiner import Arrival, CombinedScan, Combiner
    from pc2scan.pipeline.conversion import EncodedMessage
    from pc2scan.pipeline.stream import Progress


def import_pandas() -> Any:
    """Return the package pandas; raise an ImportError with what to install if it is missing."""
    return _package("pandas", "to_dataframe")


def import_xarray() -> Any:
    """Return the package xarray; raise an ImportError with what to install if it is missing."""
    return _package("xarray", "to_xarray")


def _package(name: str, method: str) -> Any:
    try:
        return import_module(name)
    except ModuleNotFoundError as err:
        if err.name != name:
            raise
        raise ImportError(f"{method}() needs the package {name}: pip install {name}", name=name) from err


#: The smallest of 64 bits is NumPy's "not a time".
_MAX_INT64 = 2**63 - 1


def datetime64(nanoseconds: int) -> np.datetime64:
    """Return nanoseconds since 1970 as ``numpy.datetime64``; ``NaT`` for values beyond 64 bits."""
    return np.datetime64(nanoseconds, "ns") if abs(nanoseconds) <= _MAX_INT64 else np.datetime64("NaT", "ns")


class NumpyTimes:
    """A message whose times are also NumPy's."""

    __slots__ = ()

    if TYPE_CHECKING:

        @property
        def log_time_ns(self) -> int:
            """The time of recording, nanoseconds since 1970."""

        @property
        def stamp_ns(self) -> int:
            """``header.stamp``, nanoseconds since 1970."""

    @property
    def stamp(self) -> np.datetime64:
        """``header.stamp`` as ``numpy.datetime64`` in nanoseconds."""
        return datetime64(self.stamp_ns)

    @property
    def log_time(self) -> np.datetime64:
        """The time of recording as ``numpy.datetime64`` in nanoseconds; ``NaT`` if that cannot represent it."""
        return datetime64(self.log_time_ns)


Item = TypeVar("Item")

#: How many topics ``repr`` names.
_SHOWN = 3

#: How many messages are between two calls of a progress function.
_PROGRESS_EVERY = 64


@dataclass(frozen=True, slots=True, kw_only=True)
class Selection:
    """The messages that are requested.

    Attributes
    ----------
    paths
        Recordings; several are read as one.
    topics
        The requested topics; empty means the only one of its type.
    start, end
        The cut, by log time.
    on_error
        What to do with a message that cannot be used: ``skip`` it, or ``fail``.
    verify, strict
        As for `pc2scan.bags.opening.open_recording`.
    """

    paths: tuple[Path, ...]
    topics: tuple[str, ...] = ()
    start: TimeBound | None = None
    end: TimeBound | None = None
    on_error: str = "skip"
    verify: bool = True
    strict: bool = False

    def __post_init__(self) -> None:
        if self.on_error not in ("skip", "fail"):
            raise UsageError(f"on_error is {self.on_error!r}, it must be skip or fail")

    def select_connections(
        self, reader: Reader, kinds: Collection[str], hint: Callable[[Reader], str | None]
    ) -> dict[str, list[Connection]]:
        """Return the connections of the topics to read, by topic.

        Parameters
        ----------
        reader
            The recording.
        kinds
            The types of the topics, in ROS 2's spelling.
        hint
            Returns the hint for a recording without such topics.

        Raises
        ------
        TopicError
            If a topic is missing or has another type, or if none was requested and there is not exactly one.
        """
        types: dict[str, set[str]] = {}
        found: dict[str, list[Connection]] = {}
        for connection in reader.connections:
            types.setdefault(connection.topic, set()).add(connection.ros_type)
            if connection.ros_type in kinds and connection.ros_version is not None:
                found.setdefault(connection.topic, []).append(connection)
        if not found:
            topics = [f"{topic} ({', '.join(sorted(kinds))})" for topic, kinds in sorted(types.items())]
            others = f"its topics are: {name_list(topics)}" if topics else "it has no topics"
            raise TopicError(
                f"the recording has no {short_types(kinds)} topic; {others}", path=reader.path, hint=hint(reader)
            )
        if not self.topics and len(found) > 1:
            raise TopicError(
                f"the recording has {len(found)} {short_types(kinds)} topics: {name_list(sorted(found))}",
                path=reader.path,
                hint=f'choose: topic="{min(found)}", or a list of several',
            )
        try:
            requested = [find_topics(topic, types, sorted(found), *kinds) for topic in self.topics]
            names = list(dict.fromkeys(name for several in requested for name in several)) or list(found)
        except TopicError as err:
            err.path = reader.path
            if names_a_type := hint(reader):
                err.hint = names_a_type
            raise
        return {name: found[name] for name in dict.fromkeys(names)}


class MessageResult(NamedTuple):
    """The result of a message: its items, or the error; for a conversion, also the counts of its points.

    ``arrived`` is its part of a scan of several messages. ``is_joint`` is whether this is such a scan, whose connection
    is the one that leads.
    """

    connection: Connection
    log_time_ns: int
    size: int
    items: tuple[object, ...] = ()
    error: MessageError | None = None
    converted: EncodedMessage | None = None
    arrived: tuple[Arrival, ...] = ()
    is_joint: bool = False


class ResultCounter(Protocol):
    """Counts the results of all messages."""

    def note(self, message: MessageResult) -> None:
        """Count a message."""
        ...

    def finish(self) -> None:
        """Raise a `MessageError` if, in the end, no message could be used."""
        ...

    def early_warnings(self) -> Sequence[str]:
        """Return new warnings for the user, after any message; `warnings` returns them, too."""
        ...

    def warnings(self) -> Sequence[str]:
        """Return warnings for the user, at the end."""
        ...


class StreamSource(NamedTuple):
    """An open recording, ready to be read.

    Attributes
    ----------
    readers
        The recording, and others that were opened for it; all are closed with ``stack``.
    topics
        The topics of the items.
    connections
        The connections that are read.
    start_ns, stop_ns
        The cut: ``start_ns <= log_time_ns < stop_ns``.
    read
        Makes the items of a message.
    latched
        Connections whose messages that are latched at the beginning of the cut are read, too.
    account
        Counts the result of each message; None if not needed.
    joints
        What makes scans of several messages.
    read_joint
        Makes the items of such scans.
    """

    stack: ExitStack
    readers: Sequence[Reader]
    topics: tuple[str, ...]
    connections: Sequence[Connection]
    start_ns: int | None
    stop_ns: int | None
    read: Callable[[RawMessage], MessageResult]
    latched: Collection[Connection] = ()
    account: ResultCounter | None = None
    joints: Sequence[Combiner] = ()
    read_joint: Callable[[CombinedScan], MessageResult] | None = None

    @property
    def damage(self) -> tuple[Damage, ...]:
        """The damage in the parts of the recordings that were read."""
        return tuple(damage for reader in self.readers for damage in reader.damage)

    def messages(self) -> Generator[MessageResult]:
        """Yield the results of the messages, by log time; a scan of several follows the last of them."""
        if self.read_joint is None:
            yield from self._results()
            return
        from pc2scan.pipeline.combine.combiner import add_scans  # noqa: PLC0415  # few scans are made of several messages

        with closing(add_scans(self._results(), _arrivals, self.joints, None)) as found:
            for each in found:
                yield each if isinstance(each, MessageResult) else self.read_joint(each)
                del each

    def _results(self) -> Generator[MessageResult]:
        reader = self.readers[0]
        parts = [reader.units(self.connections, self.start_ns, self.stop_ns)]
        if self.latched and self.start_ns is not None:
            from pc2scan.pipeline.stream import latched_at  # noqa: PLC0415  # few streams have them

            parts.insert(0, [latched_at(reader.messages(self.latched, None, self.start_ns), self.start_ns)])
        for units in parts:
            with closing(merge_by_time(units, self.read, path=reader.path)) as found:
                # Readers yield whole chunks only if they are given a rule for them, which is not the case here.
                yield from found  # type: ignore[misc]


def _arrivals(read: MessageResult | CombinedScan) -> tuple[int, int, tuple[Arrival, ...]]:
    assert isinstance(read, MessageResult)
    return read.log_time_ns, read.size, read.arrived


class Stream(ABC, Generic[Item]):
    """The messages of a recording, read as they are iterated over.

    The recording is opened immediately, so that a wrong request raises here and not in the loop.
    Each loop reads it from the beginning. Its files are closed when the loop ends, is left and forgotten, or with
    `close` or a ``with`` statement.

    Attributes
    ----------
    topics
        The topics that are read.
    damage
        The damage that the last loop found.
    skipped
        The first hundred messages that the last loop could not use.
    skipped_count
        How many these were.
    """

    def __init__(self, selection: Selection) -> None:
        self._selection = selection
        self._live: WeakSet[Generator[Item]] = WeakSet()
        self.skipped: list[Skipped] = []
        self.skipped_count = 0
        #: Receives the warnings of a conversion, instead of Python's warnings; its owner reports the rest.
        self.listener: Callable[[str], None] | None = None
        #: Called regularly with bytes read, bytes in all, and messages read.
        self.progress: Callable[[int, int, int], None] | None = None
        source = self._open()
        self._prepared: StreamSource | None = source
        #: Closes the open files if the object is never iterated over.
        self._release = finalize(self, source.stack.close)
        self._release.atexit = False
        self.topics = source.topics
        self.damage: tuple[Damage, ...] = source.damage

    @abstractmethod
    def _source(self, stack: ExitStack, reader: Reader) -> StreamSource:
        """Return what is read from an open recording."""

    def _source_of_type(
        self,
        stack: ExitStack,
        reader: Reader,
        msgtype: str,
        hint: Callable[[Reader], str | None],
        item_of: Callable[[RawMessage], Item],
    ) -> StreamSource:
        """Return the messages of a type, each of which becomes one item; see `Selection.select_connections`."""
        selection = self._selection
        chosen = selection.select_connections(reader, (msgtype,), hint)
        span = span_of(reader, ConvertOptions(start=selection.start, end=selection.end))
        connections = list(chain.from_iterable(chosen.values()))

        def read(message: RawMessage) -> MessageResult:
            connection, log_time_ns = message.connection, message.log_time_ns
            try:
                item = item_of(message)
            except MessageError as err:
                return MessageResult(connection, log_time_ns, 0, error=err)
            return MessageResult(connection, log_time_ns, message.size, (item,))

        return StreamSource(stack, [reader], tuple(chosen), connections, span.start_ns, span.stop_ns, read)

    def _open(self) -> StreamSource:
        selection = self._selection
        with ExitStack() as stack:
            readers = open_recordings(selection.paths, stack, verify=selection.verify, strict=selection.strict)
            source = self._source(stack, as_one(readers))
            # A topic without messages gives an empty loop, but a cut outside of the recording is an error.
            if source.start_ns is not None or source.stop_ns is not None:
                with suppress(TopicError):
                    refuse_no_messages(source.readers[0], source.connections, source.start_ns, source.stop_ns)
            # No error: the files stay open.
            return source._replace(stack=stack.pop_all())

    def __iter__(self) -> Generator[Item]:
        items = self._items(self._take_source())
        self._live.add(items)
        # From here on the generator closes the files in any case.
        next(items)
        return items

    def reads(self, progress: Progress | None = None) -> Generator[MessageResult]:
        """Yield the result of each message, for callers that report it themselves: Python's warnings are not used.

        At the end, `listener` receives the warnings of a conversion.

        Parameters
        ----------
        progress
            Called regularly with bytes read, total bytes, and messages read.

        Raises
        ------
        MessageError
            If it is certain that no message can be used.
        """
        source = self._take_source()
        with source.stack, closing(_count_results(source)) as messages:
            reader = source.readers[0]
            total = reader.summary.size_bytes
            for number, message in enumerate(messages):
                if progress is not None and number % _PROGRESS_EVERY == 0:
                    progress(min(reader.bytes_read, total), total, number)
                yield message
                del message
            self.damage = source.damage
            if source.account is not None and self.listener is not None:
                for text in source.account.warnings():
                    self.listener(text)

    def _take_source(self) -> StreamSource:
        """Return the open recording; the caller closes it."""
        source, self._prepared = self._prepared, None
        if source is None:
            return self._open()
        self._release.detach()
        return source

    def _items(self, source: StreamSource) -> Generator[Item]:
        """Yield the items, after a first None: once the generator has begun, it closes the files in any case."""
        with source.stack:
            yield None  # type: ignore[misc]
            self.skipped, self.skipped_count = [], 0
            self.damage = source.damage
            warned = 0 if self.listener else _warn_of_damage(self.damage, 0)
            told: set[str] = set()
            with closing(_count_results(source)) as messages:
                for number, message in enumerate(messages):
                    if self.progress is not None and number % _PROGRESS_EVERY == 0:
                        first = source.readers[0]
                        self.progress(first.bytes_read, first.summary.size_bytes, number)
                    if source.account is not None and not self.listener:
                        for text in source.account.early_warnings():
                            told.add(text)
                            warnings.warn(text, RecordingWarning, stacklevel=2)
                    if message.error is None:
                        yield from message.items  # type: ignore[misc]
                    else:
                        self._skip(message)
                    del message
            self.damage = source.damage
            if not self.listener:
                _warn_of_damage(self.damage, warned)
            for text in () if source.account is None else source.account.warnings():
                if self.listener:
                    self.listener(text)
                elif text not in told:
                    warnings.warn(text, RecordingWarning, stacklevel=2)

    def _skip(self, message: MessageResult) -> None:
        """Count a message that cannot be used; warn of the first one, list the others."""
        error = message.error
        assert error is not None
        error.topic = message.connection.topic
        if self._selection.on_error == "fail":
            raise error
        if not self.skipped_count and not self.listener:
            hint = f" ({error.hint})" if error.hint else ""
            text = f"skipped: {error}{hint}; see .skipped for all such messages; on_error='fail' makes them errors"
            warnings.warn(text, RecordingWarning, stacklevel=3)
        self.skipped_count += 1
        if len(self.skipped) < MAX_LISTED:
            found = Skipped(error.topic, message.log_time_ns, error.stamp_ns, error.message, error.hint or "")
            self.skipped.append(found)

    def __reduce__(self) -> tuple[object, ...]:
        """Return how to open the recording anew, for copies, and for processes that read it, too."""
        return type(self), (self._selection,)

    def close(self) -> None:
        """Close the files, and end the loops that are not finished. A new loop opens them again."""
        for items in tuple(self._live):
            items.close()
        self._prepared = None
        self._release()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def __repr__(self) -> str:
        paths = ", ".join(repr(str(path)) for path in self._selection.paths)
        more = ", ..." if len(self.topics) > _SHOWN else ""
        return f"<{type(self).__name__} on {', '.join(map(visible, self.topics[:_SHOWN]))}{more} of {paths}>"


def _count_results(source: StreamSource) -> Generator[MessageResult]:
    """Yield the result of each message, after the account has counted it."""
    with closing(source.messages()) as messages:
        for message in messages:
            if source.account is not None:
                source.account.note(message)
            yield message
            del message
    if source.account is not None:
        source.account.finish()


def _warn_of_damage(damage: tuple[Damage, ...], warned: int) -> int:
    """Warn of damage that has not been reported yet; return how many places there are now."""
    if len(damage) > warned:
        first = damage[0]
        place = f"{first.path}" + ("" if first.offset is None else f", byte {first.offset}")
        more = f" and {len(damage) - 1} more places" if len(damage) > 1 else ""
        text = (
            f"damaged: {place}: {first.what}{more}; see .damage. The rest is read; strict=True refuses such recordings"
        )
        warnings.warn(text, RecordingWarning, stacklevel=3)
    return len(damage)
